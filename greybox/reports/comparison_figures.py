"""Models side by side as figures: their errors as bars, their runs and what each leaves over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from greybox.comparison import Comparison, ComparisonEntry, ComparisonRun
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.reports.axes import SERIES, axes, envelope_length, line, rms
from greybox.reports.page import Figure, View
from greybox.reports.typography import typeset_number

FAR = 2.0  # ranges of the measured signal beyond which a run that grows away is cut off
LONGEST = 34  # letters of a name beside a bar


def colours_of(entries: Sequence[ComparisonEntry]) -> dict[str, str]:
    """A colour for each model: grey boxes first, in the colour of models elsewhere."""
    ordered = sorted(entries, key=lambda e: e.kind != "grey")
    return {e.name: SERIES[k % len(SERIES)] for k, e in enumerate(ordered)}


def errors_figure(comparison: Comparison) -> Figure:
    """Free-run error of each model as a bar, best on top, and its error one sample ahead as a mark; a button for each output."""
    colours, data, views, words = colours_of(comparison.entries), [], {}, []
    for k, (output, unit) in enumerate(comparison.outputs.items()):
        scores = {e.name: s for e in comparison.entries if (s := comparison.judged(e).get(output)) is not None}
        factor, text = scale_to_prefix(unit, np.array([_finite(s.rmse) for s in scores.values()] or [np.nan]))
        ranked = sorted(scores, key=lambda n: -_finite(scores[n].rmse) if np.isfinite(scores[n].rmse) else -np.inf)
        sizes = np.array([factor * _finite(scores[n].rmse) for n in ranked])
        ahead = np.array([factor * _finite(scores[n].one_step_rmse) for n in ranked])
        shown = [short(n) for n in ranked]
        told = [
            f"\u2003{scores[n].best_fit_percent:.1f} %" if np.isfinite(scores[n].rmse) else "\u2003grows away"
            for n in ranked
        ]
        data.append({
            "type": "bar", "orientation": "h", "x": sizes, "y": shown, "marker": {"color": [colours[n] for n in ranked]},
            "name": "free run, with best fit", "text": told, "textposition": "outside", "cliponaxis": False,
            "hovertemplate": "%{y}: %{x:.4g} " + text + "<extra>free run</extra>",
        })  # fmt: skip
        data.append({
            "type": "scatter", "mode": "markers", "x": ahead, "y": shown, "name": "one sample ahead",
            "marker": {"symbol": "diamond", "size": 10, "color": "--paper", "line": {"color": "--ink", "width": 1.5}},
            "hovertemplate": "%{y}: %{x:.4g} " + text + "<extra>one sample ahead</extra>",
        })  # fmt: skip
        views[output] = View([2 * k, 2 * k + 1], _bar_layout(f"rms error of {output}", text, sizes, ahead))
        said = ", ".join(
            f"{n} {s:.3g} {text}" if np.isfinite(s) else f"{n} grows away"
            for n, s in zip(ranked[::-1], sizes[::-1], strict=True)
        )
        words.append(f"{output}, free run, best first: {said}")
    layout = axes("", "", logarithmic="x") | {"hovermode": "closest", "showlegend": False}
    layout["yaxis"] |= {"type": "category"}
    return Figure(
        "errors", "Error of the free run (bars, with the best fit in percent) and one sample ahead (diamonds): further to the left is"
        " better.", typeset_number(". ".join(words)) + ".", data, layout, height=120 + 34 * len(comparison.entries), views=views,
    )  # fmt: skip


def _bar_layout(title: str, unit: str, *values: np.ndarray) -> dict[str, Any]:
    every = np.concatenate(values)
    known = every[np.isfinite(every) & (every > 0)]
    low, high = (float(np.log10(known.min())), float(np.log10(known.max()))) if len(known) else (0.0, 1.0)
    reach = max(high - low, 0.5)
    return {"xaxis": {"title": {"text": axis_label(title, unit)}, "range": [low - 0.15 * reach, high + 0.25 * reach]}}


def short(name: str) -> str:
    """A name that fits beside a bar."""
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 1]}…"


def runs_figures(
    comparison: Comparison, record: str, colours: Mapping[str, str], name: str, records: int
) -> list[Figure]:
    """Runs over one record, and what each model leaves over; a button for each output, both zoom together."""
    found = {(e.name, r.output): r for e in comparison.entries for r in _of(comparison, e) if r.record == record}
    most = envelope_length(records * (2 * len(found) + len(comparison.outputs)))
    top: list[dict[str, Any]] = []
    bottom: list[dict[str, Any]] = []
    over, under, words = {}, {}, []
    for output, unit in comparison.outputs.items():
        runs = {n: r for (n, o), r in found.items() if o == output}
        if not runs:
            continue
        first = next(iter(runs.values()))
        factor, text = scale_to_prefix(unit, first.measured)
        small, small_text = scale_to_prefix(
            unit, np.array([_finite(rms(r.measured - r.simulated)) for r in runs.values()])
        )
        starts = len(top), len(bottom)
        top.append(
            line(*min_max_envelope(first.time, factor * first.measured, most), "measured", "--measured", width=3.0)
        )
        for n, r in runs.items():
            top.append(
                line(
                    *min_max_envelope(r.time, _cut(factor * r.simulated, factor * r.measured), most),
                    short(n),
                    colours[n],
                )
            )
            error = _cut(small * (r.measured - r.simulated), small * r.measured)
            bottom.append(line(*min_max_envelope(r.time, error, most), short(n), colours[n], width=1.0))
        over[output] = View(list(range(starts[0], len(top))), {"yaxis": {"title": {"text": axis_label(output, text)}}})
        under[output] = View(
            list(range(starts[1], len(bottom))),
            {
                "yaxis": {
                    "title": {"text": axis_label(f"error of {output}", small_text)},
                    "range": _range(runs.values(), small),
                }
            },
        )
        left = [f"{n} leaves over {small * rms(r.measured - r.simulated):.3g} {small_text}" for n, r in runs.items()]
        words.append(f"{output}: {', '.join(left)}")
    return [
        Figure(f"runs-{name}", f"Record {record}: measured, and the free run of every model.", ". ".join(words) + ".", top,
               axes("time [s]", ""), height=380, group=name, views=over, switch=name),
        Figure(f"leftover-{name}", f"Record {record}: measured minus simulated.", ". ".join(words) + ".", bottom,
               axes("time [s]", ""), height=300, group=name, views=under, switch=name),
    ]  # fmt: skip


def _range(runs: Iterable[ComparisonRun], factor: float) -> list[float]:
    """Four times the largest typical error, so that one model that grows away does not hide the others."""
    sizes = [size for r in runs if np.isfinite(size := rms(r.measured - r.simulated)) and size < 1e100]
    reach = 4 * factor * max(sizes, default=1.0) or 1.0
    return [-reach, reach]


def _of(comparison: Comparison, entry: ComparisonEntry) -> tuple[ComparisonRun, ...]:
    return entry.validation_runs if comparison.validation else entry.training_runs


def _cut(values: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """A run without what lies far outside the measured signal."""
    low, high = np.nanmin(measured), np.nanmax(measured)
    reach = FAR * (high - low) or 1.0
    inside = np.isfinite(values) & (values > low - reach) & (values < high + reach)
    return np.where(inside, values, np.nan)


def _finite(value: float) -> float:
    return value if np.isfinite(value) and value > 0 else np.nan
