"""The page and the figure of the study of hidden effects, from what its folder holds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from greybox.discovery.claims import Depth
from greybox.discovery.decision import Grade

Row = Mapping[str, Any]
VISIBLE = 1.1  # misfit of the plain model over the noise from which an effect counts as visible
NOTHING, UNKNOWN = "(nothing)", "(unknown)"
Z95 = 1.96
MOST_TIED = 4
FAILED: Row = {
    "verdict": "error",
    "said": [],
    "effects": [],
    "alternatives": [],
    "seconds": 0.0,
    "closed": 0.0,
    "constants": [],
}
# What effects are functions of, and how the plants call it.
DEPENDS_ON = {
    "speed": (
        *("coulomb_friction", "stribeck_friction", "lugre_friction", "quadratic_damping", "cubic_damping"),
        *("creeping_friction", "power_damping", "asymmetric_friction", "viscous_friction"),
    ),
    "position": (
        *("cubic_stiffness", "quadratic_stiffness", "quintic_stiffness", "return_spring", "end_stop", "end_stops"),
        *("cogging", "magnet", "bouc_wen_hysteresis", "backlash", "position_dependent_volume", "force_constant_droop"),
    ),
    "drive": (
        *(
            "input_saturation",
            "soft_saturation",
            "input_dead_zone",
            "valve_dead_zone",
            "soft_dead_zone",
            "gain_by_sign",
        ),
        *("input_play", "input_hysteresis", "spool_play", "valve_hysteresis", "coarse_drive"),
    ),
    "content": ("radiation", "radiation_loss", "convection", "natural_convection", "overflow", "linear_leak"),
}
VARIABLES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "micro_actuator": {"speed": ("v",), "position": ("x",), "drive": ("u",)},
    "pneumatic_cylinder": {"speed": ("v",), "position": ("s",), "drive": ("u",)},
    "rotary_drive": {"speed": ("w",), "drive": ("u",)},
    "two_mass": {"speed": ("w1", "w2"), "position": ("a1", "a2"), "drive": ("T",)},
    "stage": {"speed": ("v",), "position": ("x",), "drive": ("i",)},
    "cylinder": {"speed": ("v",), "position": ("x",), "drive": ("u",)},
    "thermal": {"drive": ("P",), "content": ("T",)},
    "tanks": {"drive": ("u",), "content": ("h1", "h2")},
}


def write(rows: Sequence[Row], docs: Path, length: int, note: str = "") -> None:
    """``discovery_study.md`` and ``figures/discovery_study.svg`` in ``docs``; ``note`` says what the rates are of."""
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    _figure(rows).savefig(docs / "figures" / "discovery_study.svg", metadata={"Date": None})
    rigs = sum("correlation" in row for row in rows)
    text = [
        "# How often the hidden effect is named",
        f"{len(rows)} cases, drawn at random: {rigs} on the two rigs (`fits/studies/hidden_cases.py`), the others on six everyday plants"
        " (`fits/studies/plant_cases.py`), simulated by programs that share no code with greybox;"
        f" mostly {length} samples for learning, {length} for judging. `greybox.discover` sees what a user has: records, some known"
        " constants, start values up to 40 % off, and in about half of the cases the noise."
        f" A share is known to about {100 / max(len(rows), 1) ** 0.5:.0f} percentage points. The sparse regression can"
        " only name seven effects (`fits/studies/hidden_baselines.py`). Written by `python -m fits.studies.hidden_study FOLDER --page`."
        + f" {note}".rstrip(),
        _scores(rows),
        "## With the truth taken away",
        "Each case again, without the true effect and its family among the candidates. An answer is wrong if it is `named`, or an"
        " effect is `established` and not there. Place: the answer gives the true site, among others perhaps. Shape: it gives the"
        " variable that the true effect depends on.",
        _left_out_scores(rows),
        "## By plant",
        _by_plant(rows),
        "## Truth against answer",
        "Rows: what was hidden, where the plain model shows it (misfit at least 1.1 times the noise). Columns: what was said; a question"
        " mark: with the verdict unknown.",
        "![Truth against answer](figures/discovery_study.svg)",
    ]
    (docs / "discovery_study.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def _answer(row: Row) -> Row:
    """The answer with every effect among the candidates."""
    return next((a for a in row["answers"] if not a["left_out"]), FAILED)


def right(row: Row) -> bool:
    """Whether the names are right: each true effect (or one of its family) and nothing else."""
    said = _answer(row)["said"]
    hit = all(any(name in names for name in said) for names in row["right"])
    return hit and all(any(name in names for names in row["right"]) for name in said)


def is_exact(row: Row) -> bool:
    """Right, and said with certainty: nothing is left, or other effects are as probable."""
    return right(row) and _answer(row)["verdict"] in ("named", "partly")


def is_falsely_certain(row: Row, answer: Row) -> bool:
    """Whether an effect is given as certain that is not there, or a part of the effects as the whole."""
    certain = {e["name"] for e in answer["effects"] if e["grade"] == "established"}
    whole = answer["verdict"] == "named"
    incomplete = whole and not all(any(name in names for name in answer["said"]) for names in row["right"])
    not_there = (set(answer["said"]) if whole else certain) - {name for names in row["right"] for name in names}
    return bool(incomplete or not_there)


def tied(row: Row) -> bool:
    """Right, or right within a declared tie of at most four."""
    answer = _answer(row)
    group = {name for alternative in answer["alternatives"] for name in alternative} | set(answer["said"])
    held = all(any(name in names for name in group) for names in row["right"])
    return right(row) or (answer["verdict"] == "ambiguous" and held and len(answer["alternatives"]) < MOST_TIED)


def knows_place(row: Row) -> bool:
    """Whether the answer without the truth gives the site of the true effect."""
    answer = _left_out(row)
    suspected = {label.rpartition(" ")[2] for label in answer["sites"]}  # "balance force", "input u", "sensor of s"
    return bool(set(row["true_sites"]) & (suspected | {e["site"] for e in answer["effects"]}))


def knows_shape(row: Row) -> bool:
    """Whether it gives the variable that the true effect depends on; of effects with a memory of their own nothing is asked."""
    answer = _left_out(row)
    wanted = {variable for name in row["truth"] for variable in _variables(row, name)}
    given = {*answer["variables"]} | {v for e in answer["effects"] for v in _variables(row, e["name"])}
    return not wanted or bool(wanted & given)


def _established(answer: Row, depth: Depth) -> list[bool]:
    """Whether each claim of this depth that is established is right; those left out of which nobody knows."""
    return [
        c["right"]
        for c in answer["claims"]
        if c["depth"] == depth and c["grade"] == Grade.ESTABLISHED and c["right"] is not None
    ]


def _has_listed(row: Row) -> bool:
    return any(name in row["right"][0] for name in _answer(row)["said"])


def _left_out(row: Row) -> Row:
    return next(a for a in row["answers"] if a["left_out"])


def _variables(row: Row, name: str) -> tuple[str, ...]:
    """Names of the variables in the plant's model that an effect is a function of."""
    kind = next((kind for kind, names in DEPENDS_ON.items() if name.partition("_at_")[0] in names), "")
    return VARIABLES[row["plant"]].get(kind, ())


def _scores(rows: Sequence[Row]) -> str:
    kinds = {
        kind: [r for r in rows if r["kind"] == kind]
        for kind in ("single", "pair", "complete", "foreign", "relative", "mixed")
    }
    visible = {kind: [r for r in rows if r["base"] >= VISIBLE] for kind, rows in kinds.items()}
    effects = [r for r in rows if r["kind"] != "complete"]
    both = [r for r in visible["pair"] if r["each"] and all(left >= VISIBLE for left in r["each"])]
    faint = [r for r in visible["pair"] if r not in both]
    named = [r for r in visible["single"] + visible["pair"] + visible["relative"] if right(r)]
    closed = [_answer(r)["closed"] for r in named]
    constants = [c for r in rows if right(r) for c in _answer(r)["constants"] if c["truth"]]
    errors = [abs(c["value"] / c["truth"] - 1) for c in constants]
    inside = [abs(c["value"] - c["truth"]) <= Z95 * c["std"] for c in constants if c["std"]]
    singles, seconds = visible["single"], [a["seconds"] for r in rows for a in r["answers"]]
    compared = [r for r in singles if "correlation" in r]
    lines = [
        ("one effect, visible: exact name", _share(map(right, singles))),
        ("one effect, visible: exact name, or a declared tie of at most four", _share(map(tied, singles))),
        ("one effect, visible: exact name, as `named` or `established`", _share(map(is_exact, singles))),
        ("on the rigs, by correlation of the residual", _share([r["correlation"] in r["truth"] for r in compared])),
        (
            "on the rigs, by sparse regression of the acceleration (pysindy)",
            _share([r["sparse"] in r["truth"] for r in compared]),
        ),
        ("complete models left alone", _share([_answer(r)["verdict"] == "complete" for r in kinds["complete"]])),
        ("wrong or incomplete name given as certain", _share([is_falsely_certain(r, _answer(r)) for r in effects])),
        (
            "effect that the catalogue does not have, visible: nothing wrong given as certain",
            _share([not is_falsely_certain(r, _answer(r)) for r in visible["foreign"]]),
        ),
        (
            "relative of a catalogued effect, visible: family named and nothing else",
            _share(map(right, visible["relative"])),
        ),
        (
            "an effect beside one that the catalogue does not have: it is among the names, and nothing wrong is certain",
            _share([_has_listed(r) and not is_falsely_certain(r, _answer(r)) for r in visible["mixed"]]),
        ),
        ("two effects, each visible beside the other: both and nothing else", _share(map(right, both))),
        (
            "two effects, one hardly visible beside the other: nothing certain that is not there",
            _share([not is_falsely_certain(r, _answer(r)) or right(r) for r in faint]),
        ),
        ("gap closed on the judging record where named rightly: median, tenth percentile", _two(closed)),
        (
            "constants of effects named rightly: median relative error",
            f"{np.median(errors):.3f} ({len(errors)})" if errors else "-",
        ),
        ("constants inside their 95 % interval", _share(inside)),
        (
            "processor seconds a search, both answers: median, 95th percentile, worst",
            f"{np.median(seconds):.1f}, {np.percentile(seconds, 95):.1f}, {max(seconds):.1f}",
        ),
        ("searches that ended with an error", str(sum("error" in r for r in rows))),
        ("not visible in the records (left out above)", str(sum(r["base"] < VISIBLE for r in effects))),
    ]
    return _table("what | result", lines)


def _left_out_scores(rows: Sequence[Row]) -> str:
    again = [r for r in rows if any(a["left_out"] for a in r["answers"])]
    visible = [r for r in again if r["base"] >= VISIBLE]
    singles = [r for r in visible if r["kind"] == "single"]
    certain = [tuple(_established(_left_out(r), d) for d in (Depth.PLACE, Depth.VARIABLES)) for r in singles]
    lines = [
        ("wrong as certain", _share([is_falsely_certain(r, _left_out(r)) for r in again])),
        ("place, one visible effect", _share(map(knows_place, singles))),
        ("place and shape, one visible effect", _share([knows_place(r) and knows_shape(r) for r in singles])),
        ("place established and right, one visible effect", _share([any(places) for places, _ in certain])),
        (
            "place and variables established and right, one visible effect",
            _share([any(places) and any(variables) for places, variables in certain]),
        ),
        (
            "a place or its variables established and wrong, one visible effect",
            _share([not all((*places, *variables)) for places, variables in certain]),
        ),
        (
            "share of the error that the answer takes on the judging record: median",
            f"{np.median([_left_out(r)['share'] for r in visible]):.2f}" if visible else "-",
        ),
    ]
    return _table("what | result", lines)


def _by_plant(rows: Sequence[Row]) -> str:
    lines = []
    for plant in sorted({r["plant"] for r in rows}):
        of_plant = [r for r in rows if r["plant"] == plant]
        visible = [r for r in of_plant if r["base"] >= VISIBLE]
        answers = [(r, a) for r in of_plant for a in r["answers"]]
        lines.append(
            (
                plant,
                _share([tied(r) for r in visible if r["kind"] == "single"]),
                _share([tied(r) for r in visible if r["kind"] == "pair"]),
                _share([_answer(r)["verdict"] == "complete" for r in of_plant if r["kind"] == "complete"]),
                _share([is_falsely_certain(r, a) for r, a in answers]),
                f"{np.median([a['seconds'] for _, a in answers]):.1f}" if answers else "-",
            )
        )
    return _table(
        "plant | one effect, or a declared tie | pair | complete | wrong as certain, both answers | seconds", lines
    )


def _table(head: str, lines: Sequence[Sequence[str]]) -> str:
    rule = "|".join(["---"] * (head.count("|") + 1))
    return "\n".join([f"| {head} |", f"|{rule}|", *("| " + " | ".join(line) + " |" for line in lines)])


def _share(values: Any) -> str:
    values = list(values)
    return f"{sum(values)}/{len(values)} = {100 * np.mean(values):.0f} %" if values else "-"


def _two(values: Sequence[float]) -> str:
    return f"{np.median(values):.3f}, {np.percentile(values, 10):.3f} ({len(values)})" if values else "-"


def _pairs(rows: Sequence[Row]) -> Counter[tuple[str, str]]:
    """(truth, answer) of every visible case with at most one true effect."""
    counts: Counter[tuple[str, str]] = Counter()
    for r in rows:
        if r["kind"] in ("pair", "mixed") or (r["kind"] != "complete" and r["base"] < VISIBLE):
            continue
        truth = NOTHING if r["kind"] == "complete" else next(iter(r["truth"]))
        answer = _answer(r)
        name = " + ".join(answer["said"]) or (NOTHING if answer["verdict"] == "complete" else UNKNOWN)
        counts[truth, f"{name}?" if answer["verdict"] == "unknown" and answer["said"] else name] += 1
    return counts


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
