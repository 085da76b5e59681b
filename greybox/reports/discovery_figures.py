"""A discovery as figures: the gap step by step, what is left before and after, the missing signal, where and when, the candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from greybox.discovery import Discovery, EffectSignal, RankedCandidate, ResidualLocalisation, Surrogate
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix
from greybox.reports.axes import amplitude_density, axes, band, line, rms, thin_spectrum, uniform_sampling_time
from greybox.reports.page import Figure, View
from greybox.reports.record_figures import known_noise, signals_of
from greybox.reports.typography import typeset_number
from greybox.result import Trace

CANDIDATES = 15  # that are drawn
DOTS = 1500  # points of a cloud
PARTS = 60  # of a variable's range, whose averages make a curve
LOOPING = 0.12  # share that the direction of motion explains, from which a curve is drawn as a loop
BEFORE, AFTER = "--model", "--fourth"


def gap_figure(found: Discovery) -> Figure:
    """Misfit over noise on the judging records: plain, with what was found, and noise; a button for each output."""
    data, views, words = [], {}, []
    extended = " + ".join(found.best.model.title.split(" + ")[1:]) or "the same model"
    for k, (output, gap) in enumerate(found.gap.items()):
        steps = [("plain model", gap.before, BEFORE), (f"with {extended}", gap.after, AFTER)]
        curve = found.surrogate
        if curve is not None and output in curve.gap:
            steps.append((f"with {curve.title}", curve.gap[output].after, "--third"))
        steps.append(("noise", gap.floor, "--measured"))
        steps = steps[::-1]
        factor, text = scale_to_prefix(gap.unit, np.array([s[1] for s in steps]))
        sizes = [factor * s[1] for s in steps]
        data.append({
            "type": "bar", "orientation": "h", "x": sizes, "y": [s[0] for s in steps], "marker": {"color": [s[2] for s in steps]},
            "text": [typeset_number(f"{v / (factor * gap.floor):.3g} × noise") for v in sizes],
            "textposition": "outside", "cliponaxis": False, "hovertemplate": "%{y}: %{x:.4g} " + text + "<extra></extra>",
        })  # fmt: skip
        high, low = np.log10(max(sizes)), np.log10(min(s for s in sizes if s > 0))
        reach = max(float(high - low), 0.3)
        spread = [float(low - 0.35 * reach), float(high + 0.55 * reach)]
        views[output] = View(
            [k], {"xaxis": {"title": {"text": axis_label(f"rms misfit of {output}", text)}, "range": spread}}
        )
        words.append(
            f"{output}: from {gap.before / gap.floor:.3g} to {gap.after / gap.floor:.3g} times the noise,"
            f" {100 * min(gap.explained_fraction, 1.0):.1f} % of the gap is closed"
        )
    layout = axes("", "", logarithmic="x") | {"showlegend": False, "hovermode": "closest"}
    layout["yaxis"] |= {"type": "category"}
    return Figure(
        "gap", "The gap between model and rig on records that nothing was fitted to, before and after.", "; ".join(words) + ".",
        data, layout, height=300, views=views,
    )  # fmt: skip


def steps_of(found: Discovery) -> list[tuple[str, float]]:
    """Names of the models on the way to the best one, one effect after the other, with their misfit over noise where they were fitted."""
    wanted = {e.name for e in found.best.model.effects}
    way = [("plain model", max((m.noise_ratio for m in found.base.misfit.values()), default=np.nan))]
    held: set[str] = set()
    while held != wanted:
        nearer = [r for r in found.ranking if held < set(r.effects) <= wanted and len(r.effects) == len(held) + 1]
        if not nearer:
            break
        step: RankedCandidate = min(nearer, key=lambda r: r.misfit)
        new = set(step.effects) - held
        held |= new
        way.append((f"+ {', '.join(sorted(new))}", step.misfit))
    return way


def before_after_figures(
    before: Trace,
    after: Trace,
    units: Mapping[str, str],
    noise: Mapping[str, float],
    name: str,
    most: int,
    extended: str,
) -> list[Figure]:
    """The residual of one record with the plain model and with the extended one, and both spectra; a button for each output."""
    time = before.time
    step = uniform_sampling_time(time) or float(np.median(np.diff(time)))
    runs: list[dict[str, Any]] = []
    spectra: list[dict[str, Any]] = []
    over, under, words = {}, {}, []
    for output in before.measured:
        std = known_noise(noise.get(output))
        pair = [
            (before.residual(output), "plain model", BEFORE),
            (after.residual(output), extended, AFTER),
        ]
        factor, text = scale_to_prefix(units[output], pair[0][0], np.array([2 * std]))
        first, start = len(runs), len(spectra)
        for residual, title, colour in pair:
            runs.append(line(*min_max_envelope(time, factor * residual, most), title, colour, width=1.0))
            spectra.append(
                line(*thin_spectrum(*amplitude_density(factor * residual, step), most), title, colour, width=1.0)
            )
        layout: dict[str, Any] = {"yaxis": {"title": {"text": axis_label(f"residual of {output}", text)}}, "shapes": []}
        if std > 0:
            layout["shapes"] = [band(factor * 2 * std)]
            f = (
                np.array([spectra[start]["x"][0], spectra[start]["x"][-1]])
                if len(spectra[start]["x"])
                else np.array([])
            )
            floor = np.full(len(f), factor * std * np.sqrt(2 * step))
            spectra.append(line(f, floor, "noise", "--soft", dash="dash"))
        linked = [(residual, f"spectra-{name}", start + k) for k, (residual, _, _) in enumerate(pair)]
        over[output] = View([first, first + 1], layout, signals_of(time, linked, factor))
        under[output] = View(
            list(range(start, len(spectra))), {"yaxis": {"title": {"text": axis_label(output, f"{text}/√Hz")}}}
        )
        words.append(
            f"residual of {output}: rms {factor * rms(pair[0][0]):.3g} {text} before, {factor * rms(pair[1][0]):.3g} {text} after"
        )
    said = "; ".join(words) + "."
    return [
        Figure(
            f"left-{name}",
            f"What is left of record {before.name}, before and after; the grey band is two standard deviations of the noise.",
            said, runs, axes("time [s]", ""), height=320, group=name, views=over, switch=name,
        ),
        Figure(
            f"spectra-{name}", "Spectra of both. Zoom into the residual in time: the spectra become those of the stretch.", said, spectra,
            axes("frequency [Hz]", "", logarithmic="xy"), height=280, views=under, switch=name,
        ),
    ]  # fmt: skip


def missing_figure(found: EffectSignal, name: str) -> Figure:
    """The missing signal against the variable that it depends on, with the named effect's curve through it; and in time."""
    x, across = scale_to_prefix(found.variable_unit, found.variable)
    y, unit = scale_to_prefix(found.unit, found.value)
    kept = np.unique(np.linspace(0, len(found.time) - 1, DOTS).astype(int)) if len(found.time) else np.array([], int)
    curve = _through(found.variable, found.modelled, ordered=found.region.loop <= LOOPING)
    data = [
        _cloud(x * found.variable[kept], y * found.value[kept], "from the data"),
        line(x * curve[0], y * curve[1], found.effect, AFTER, width=2.4),
        line(found.time, y * found.value, "from the data", "--measured", width=2.4),
        line(found.time, y * found.modelled, found.effect, AFTER, width=1.4),
    ]
    title = {"yaxis": {"title": {"text": axis_label("missing signal", unit)}}}
    views = {
        f"against {found.variable_name}": View(
            [0, 1], title | {"xaxis": {"title": {"text": axis_label(found.variable_name, across)}}}
        ),
        "in time": View([2, 3], title | {"xaxis": {"title": {"text": "time [s]"}}}),
    }
    words = (
        f"At the {found.site} a signal of {y * rms(found.value):.3g} {unit} rms is missing. {found.effect} explains"
        f" {100 * found.explained:.1f} % of its variance. It is {found.region}."
    )
    return Figure(
        name, f"The signal that the plain model lacks at the {found.site}, as the data show it, and {found.effect} through it.",
        words, data, axes("", "") | {"hovermode": "closest"}, height=380, views=views,
    )  # fmt: skip


def _through(variable: np.ndarray, values: np.ndarray, *, ordered: bool) -> tuple[np.ndarray, np.ndarray]:
    """A curve through a cloud: averages over stretches of the variable; in the order of time where it is a loop."""
    if not ordered or len(variable) < 2 * PARTS:
        order = np.argsort(variable, kind="stable") if ordered else np.arange(len(variable))
        return variable[order], values[order]
    order = np.argsort(variable, kind="stable")
    edges = np.linspace(0, len(order), PARTS + 1).astype(int)[:-1]
    count = np.diff([*edges, len(order)])
    return np.add.reduceat(variable[order], edges) / count, np.add.reduceat(values[order], edges) / count


def stand_in_figure(found: Surrogate) -> Figure:
    """The curve or tone that stands in for an unknown effect, over the signal that the data show."""
    x, across = scale_to_prefix(found.variable_unit, found.values)
    y, unit = scale_to_prefix(found.unit, found.curve, found.signal.value)
    data = [
        _cloud(x * found.seen, y * found.signal.value, "from the data"),
        line(x * found.values, y * found.curve, found.title.removeprefix("a "), "--third", width=2.6),
    ]
    layout = axes(axis_label(found.variable, across), axis_label("missing signal", unit)) | {"hovermode": "closest"}
    what = "A smooth curve" if found.tone is None else "A tone, whatever the motion,"
    return Figure(
        "stand-in", f"{what} stands in for the effect that the catalogue does not have.", f"{found}.", data, layout, height=360
    )  # fmt: skip


def signal_figure(look: ResidualLocalisation) -> Figure | None:
    """The unexplained signal at the likeliest place, against each variable; a button for each."""
    signal = look.signal
    if signal is None or not signal.variables:
        return None
    y, unit = scale_to_prefix(signal.unit, signal.value)
    ranked = [r.variable for r in look.dependences if r.variable in signal.variables]
    names = [*ranked, *(n for n in signal.variables if n not in ranked)]
    data, views = [], {}
    for k, variable in enumerate(names):
        x, across = scale_to_prefix(signal.units[variable], signal.variables[variable])
        data.append(_cloud(x * signal.variables[variable], y * signal.value, variable))
        views[variable] = View([k], {"xaxis": {"title": {"text": axis_label(variable, across)}}})
    layout = axes("", axis_label("unexplained", unit)) | {"hovermode": "closest", "showlegend": False}
    words = "; ".join(str(r) for r in look.dependences[:3]) or "no function of any one variable"
    return Figure(
        "unexplained", f"What the fitted plain model leaves unexplained at the {signal.site}, against each variable. Its constants have"
        " absorbed what they could.", words + ".", data, layout, height=330, views=views,
    )  # fmt: skip


def when_figure(look: ResidualLocalisation) -> Figure | None:
    """The misfit of each window of time."""
    if not look.windows:
        return None
    records = list(dict.fromkeys(w.record for w in look.windows))
    data, views = [], {}
    for k, record in enumerate(records):
        own = [w for w in look.windows if w.record == record]
        data.append({
            "type": "bar", "x": [(w.start + w.end) / 2 for w in own], "width": [0.95 * (w.end - w.start) for w in own],
            "y": [w.misfit for w in own], "marker": {"color": BEFORE}, "name": record,
            "customdata": [100 * w.share for w in own],
            "hovertemplate": "%{y:.3g} × noise, %{customdata:.1f} % of all misfit<extra></extra>",
        })  # fmt: skip
        views[record] = View([k])
    layout = axes("time [s]", "misfit over noise") | {"showlegend": False, "hovermode": "closest"}
    worst = max(look.windows, key=lambda w: w.share)
    words = f"Most of it in one window: {100 * worst.share:.0f} % from {worst.start:.4g} to {worst.end:.4g} s of {worst.record}."
    return Figure("when", "When the plain model fails.", words, data, layout, height=230, views=views)


def candidates_figure(ranking: Sequence[RankedCandidate], chosen: Sequence[str]) -> Figure | None:
    """Misfit over noise of the best candidates on the records that they were fitted to."""
    if not ranking:
        return None
    best = list(ranking[:CANDIDATES])[::-1]
    names = [("✓ " if set(r.effects) == set(chosen) else "") + " + ".join(r.effects) for r in best]
    colours = [AFTER if set(r.effects) == set(chosen) else "--measured" for r in best]
    data = [{
        "type": "bar", "orientation": "h", "x": [r.misfit for r in best], "y": names, "marker": {"color": colours},
        "text": [f"{r.misfit:.3g}" for r in best], "textposition": "outside", "cliponaxis": False,
        "hovertemplate": "%{y}: %{x:.4g} × noise<extra></extra>",
    }]  # fmt: skip
    known = [np.log10(r.misfit) for r in best if np.isfinite(r.misfit) and r.misfit > 0] or [0.0]
    reach = max(max(known) - min(known), 0.3)
    layout = axes("misfit over noise where it was fitted (1: only noise is left)", "", logarithmic="x")
    layout |= {"showlegend": False, "hovermode": "closest"}
    layout["xaxis"] |= {"range": [float(min(known) - 0.3 * reach), float(max(known) + 0.15 * reach)]}
    layout["yaxis"] |= {"type": "category"}
    words = "; ".join(f"{' + '.join(r.effects)} {r.misfit:.3g}" for r in ranking[:CANDIDATES])
    return Figure(
        "candidates", "The candidates, best first by Schwarz's criterion; a tick marks the chosen one.", typeset_number(words) + ".", data,
        layout, height=110 + 26 * len(best),
    )  # fmt: skip


def _cloud(x: np.ndarray, y: np.ndarray, name: str) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "markers", "x": x, "y": y, "name": name,
        "marker": {"color": "--residual", "size": 5, "opacity": 0.5},
    }  # fmt: skip
