"""The page and the figure of the study of hidden effects, from what its folder holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Row = Mapping[str, Any]
VISIBLE = 1.1  # misfit of the plain model over the noise from which an effect counts as visible
NOTHING, OUTSIDE, UNKNOWN = "(nothing)", "(outside the catalogue)", "(unknown)"
Z95 = 1.96
MOST_TIED = 4


def write(rows: Sequence[Row], docs: Path, length: int) -> None:
    """``discovery_study.md`` and ``figures/discovery_study.svg`` in ``docs``."""
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    _figure(rows).savefig(docs / "figures" / "discovery_study.svg", metadata={"Date": None})
    text = [
        "# How often the hidden effect is named",
        f"{len(rows)} cases of both rigs, drawn at random (`fits/hidden_cases.py`), simulated by `fits/rig_twins.py`, which shares no code"
        f" with greybox; {length} samples for learning, {length} for judging. `greybox.discover` sees what a user has: records, some known"
        " constants, start values up to 40 % off, and in half of the cases the noise. No threshold was tuned on these cases. Written by"
        " `python -m fits.hidden_study FOLDER`.",
        f"A share of {len(rows)} cases is known to about {100 / max(len(rows), 1) ** 0.5:.0f} percentage points: more cases are a matter of"
        " processor time, and a folder begun is gone on with. The baselines refit nothing; the sparse regression can only name the seven"
        " effects that its library holds a function for (`fits/hidden_baselines.py`).",
        _scores(rows),
        "## Confusion",
        "Rows: what was hidden, where the plain model shows it (misfit at least 1.1 times the noise). Columns: what was said.",
        _confusion(rows),
        "![Truth against answer](figures/discovery_study.svg)",
        "## What went wrong",
        _wrong(rows),
    ]
    (docs / "discovery_study.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def right(row: Row) -> bool:
    """Whether the names are right: each true effect (or one of its family) and nothing else."""
    answer = row["said"]
    hit = all(any(name in names for name in answer) for names in row["right"])
    return hit and all(any(name in names for names in row["right"]) for name in answer)


def _part(row: Row) -> bool:
    """Whether nothing was said that is not true, or nothing was named."""
    return row["verdict"] != "named" or all(any(name in names for names in row["right"]) for name in row["said"])


def tied(row: Row) -> bool:
    """Right, or right within a declared tie of at most four."""
    group = {name for alternative in row["alternatives"] for name in alternative} | set(row["said"])
    held = all(any(name in names for name in group) for names in row["right"])
    return right(row) or (row["verdict"] == "ambiguous" and held and len(row["alternatives"]) < MOST_TIED)


def _scores(rows: Sequence[Row]) -> str:
    kinds = {
        kind: [r for r in rows if r["kind"] == kind] for kind in ("single", "pair", "complete", "outside", "relative")
    }
    seen = {kind: [r for r in rows if r["base"] >= VISIBLE] for kind, rows in kinds.items()}
    effects = [r for r in rows if r["kind"] != "complete"]
    both = [r for r in kinds["pair"] if all(left >= VISIBLE for left in r["each"])]
    faint = [r for r in kinds["pair"] if r not in both]
    closed = [r["closed"] for r in seen["single"] + seen["pair"] + seen["relative"] if right(r)]
    constants = [c for r in rows if right(r) for c in r["constants"] if c["truth"]]
    errors = [abs(c["value"] / c["truth"] - 1) for c in constants]
    inside = [abs(c["value"] - c["truth"]) <= Z95 * c["std"] for c in constants if c["std"]]
    singles, seconds = seen["single"], [r["seconds"] for r in rows]
    lines = [
        ("one effect, visible: exact name", _share(map(right, singles))),
        ("one effect, visible: exact name, or a declared tie of at most four", _share(map(tied, singles))),
        ("the same by correlation of the residual", _share([r["correlation"] in r["truth"] for r in singles])),
        (
            "the same by sparse regression of the acceleration (pysindy)",
            _share([r["sparse"] in r["truth"] for r in singles]),
        ),
        ("complete models left alone", _share([r["verdict"] == "complete" for r in kinds["complete"]])),
        (
            "wrong or incomplete name with the verdict `named`",
            _share([r["verdict"] == "named" and not right(r) for r in effects]),
        ),
        (
            "effect outside the catalogue, visible: not falsely named",
            _share([r["verdict"] != "named" for r in seen["outside"]]),
        ),
        (
            "relative of a catalogued effect, visible: family named and nothing else",
            _share(map(right, seen["relative"])),
        ),
        ("two effects, each visible beside the other: both and nothing else", _share(map(right, both))),
        (
            "two effects, one hardly visible beside the other: nothing named that is not there",
            _share(map(_part, faint)),
        ),
        ("gap closed on the judging record where named rightly: median, tenth percentile", _two(closed)),
        (
            "constants of effects named rightly: median relative error",
            f"{np.median(errors):.3f} ({len(errors)})" if errors else "-",
        ),
        ("constants inside their 95 % interval", _share(inside)),
        ("processor seconds a case: median, worst", f"{np.median(seconds):.1f}, {max(seconds):.1f}"),
        ("not visible in the records (left out above)", str(sum(r["base"] < VISIBLE for r in effects))),
    ]
    return "\n".join(["| what | result |", "|---|---|", *(f"| {what} | {value} |" for what, value in lines)])


def _share(values: Any) -> str:
    values = list(values)
    return f"{sum(values)}/{len(values)} = {100 * np.mean(values):.0f} %" if values else "-"


def _two(values: Sequence[float]) -> str:
    return f"{np.median(values):.3f}, {np.percentile(values, 10):.3f} ({len(values)})" if values else "-"


def _pairs(rows: Sequence[Row]) -> Counter[tuple[str, str]]:
    """(truth, answer) of every visible case with at most one true effect."""
    counts: Counter[tuple[str, str]] = Counter()
    for r in rows:
        if r["kind"] == "pair" or (r["kind"] != "complete" and r["base"] < VISIBLE):
            continue
        truth = NOTHING if r["kind"] == "complete" else OUTSIDE if r["kind"] == "outside" else next(iter(r["truth"]))
        answer = " + ".join(r["said"]) or (NOTHING if r["verdict"] == "complete" else UNKNOWN)
        counts[truth, f"{answer}?" if r["verdict"] == "unknown" and r["said"] else answer] += 1
    return counts


def _confusion(rows: Sequence[Row]) -> str:
    counted = _pairs(rows)
    lines = ["| hidden | said (a question mark: with the verdict unknown) |", "|---|---|"]
    for truth in sorted({t for t, _ in counted}):
        answers = sorted(((n, s) for (t, s), n in counted.items() if t == truth), reverse=True)
        lines.append(f"| {truth} | {', '.join(f'{answer} {n}' for n, answer in answers)} |")
    return "\n".join(lines)


def _wrong(rows: Sequence[Row]) -> str:
    lines = ["| case | hidden | said | verdict | plain model over noise | gap closed |", "|---|---|---|---|---|---|"]
    for r in rows:
        fine = r["verdict"] == "complete" if r["kind"] == "complete" else right(r) or tied(r)
        fine = (
            fine
            or (r["kind"] == "outside" and r["verdict"] == "unknown")
            or (r["base"] < VISIBLE and r["verdict"] == "complete")
        )
        if not fine:
            lines.append(
                f"| {r['name']} | {' + '.join(r['truth']) or NOTHING} | {' + '.join(r['said']) or NOTHING} | {r['verdict']}"
                f" | {r['base']:.2f} | {r['closed']:.2f} |"
            )
    return "\n".join(lines) if len(lines) > 2 else "Nothing in these cases."


def _figure(rows: Sequence[Row]) -> Figure:
    counted = _pairs(rows)
    truths, answers = sorted({t for t, _ in counted}), sorted({s for _, s in counted})
    answers = [t for t in truths if t in answers] + [s for s in answers if s not in truths]
    table = np.array([[counted[t, s] for s in answers] for t in truths], float)
    figure = Figure(figsize=(3.5 + 0.33 * len(answers), 2.5 + 0.3 * len(truths)), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.imshow(
        np.where(table > 0, table / np.maximum(table.sum(axis=1, keepdims=True), 1), np.nan),
        cmap="Blues",
        vmin=0,
        vmax=1.3,
    )
    for (row, column), count in np.ndenumerate(table):
        if count:
            axis.text(column, row, f"{count:.0f}", ha="center", va="center", fontsize=8)
    axis.set_xticks(range(len(answers)), answers, rotation=90, fontsize=8)
    axis.set_yticks(range(len(truths)), truths, fontsize=8)
    axis.set_xlabel("said")
    axis.set_ylabel("hidden")
    return figure
