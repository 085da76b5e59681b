"""A discovery in figures: the error before and after, the signal that the model lacks, where and when, and the candidates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from greybox.base.figure import (
    Area,
    Axis,
    Bars,
    Curve,
    Dash,
    Figure,
    Height,
    Panel,
    Points,
    Reference,
    Role,
    Scale,
    Series,
)
from greybox.discovery.decision import Verdict
from greybox.discovery.localisation import ResidualLocalisation, estimate_residual_spectrum
from greybox.show.figures.figure import draw_sizes, scale_to_prefix, size_axis, typeset_exponents
from greybox.show.figures.records import FREQUENCY, TIME
from greybox.show.sentences.discovery import surrogate_title
from greybox.show.sentences.wording import capitalise, change_text, percent_text, value_with_unit

if TYPE_CHECKING:
    from greybox.discovery import Dependence, Discovery, EffectSignal, HoldoutError, Surrogate


def plot_holdout_error(discovery: Discovery) -> Figure:
    """Rms error on the validation records with the plain model, the extended one and the surrogate, beside the noise; by output."""
    extended = " + ".join(effect.name for effect in discovery.best.model.effects)
    surrogate = discovery.surrogate
    panels, description = [], []
    for output, error in discovery.holdout.items():
        steps = [("plain model", error.before, Role.BASELINE)]
        if extended:
            steps.append((f"with {extended}", error.after, Role.EXTENDED))
        if surrogate is not None and output in surrogate.holdout:
            steps.append((f"with {surrogate_title(surrogate)}", surrogate.holdout[output].after, Role.SURROGATE))
        if error.is_floor_known:
            steps.append(("noise", error.floor, Role.MEASURED))
        names, sizes, roles = zip(*steps, strict=True)
        factor, unit = scale_to_prefix(error.unit, np.array(sizes))
        lengths = factor * np.array(sizes)
        texts = [_error_text(size, error) for size in sizes]
        x = size_axis(f"rms error of {output}", unit, lengths)
        y = Axis(scale=Scale.CATEGORY, reversed=True)
        series = draw_sizes(names, lengths, roles, x, texts=texts)
        panels.append(Panel(output, series, x, y, height=Height.PER_CATEGORY))
        judged = errors_to_judge(discovery)[output]
        description.append(
            f"{output}: the error falls from {change_text(error.before, judged.after, error.unit)} ({100 * judged.share:.0f} % less)"
        )
    return Figure(
        "gap",
        tuple(panels),
        "Rms error of the free run on the validation records, before and after.",
        tuple(description),
    )


def errors_to_judge(discovery: Discovery) -> Mapping[str, HoldoutError]:
    """Error of each output before and after; after with the surrogate, where no effect came near."""
    surrogate = discovery.surrogate
    if surrogate is None or discovery.best.model.effects:
        return discovery.holdout
    return {**discovery.holdout, **surrogate.holdout}


def _error_text(size: float, error: HoldoutError) -> str:
    """An error beside its bar: over the noise where that is known, else its share of the plain model's error."""
    if error.is_floor_known:
        return typeset_exponents(f"{size / error.floor:.3g} × noise")
    return percent_text(size / error.before, 3)


def plot_effect_signal(signal: EffectSignal, name: str) -> Figure:
    """The signal that a named effect stands for, from the records and from the model: against its variable, and over time."""
    x, across = scale_to_prefix(signal.variable_unit, signal.variable)
    y, unit = scale_to_prefix(signal.unit, signal.value)
    axis = Axis(f"missing at the {signal.site}", unit)
    against = Panel(
        f"against {signal.variable_name}",
        (
            Points(x * signal.variable, y * signal.value, Role.MEASURED, "from the records", size=5, opacity=0.7),
            Points(x * signal.variable, y * signal.modelled, Role.EXTENDED, signal.effect, size=4),
            _bins(signal.dependence, x, y, float(signal.value.mean())),
        ),
        Axis(signal.variable_name, across),
        axis,
        height=Height.TALL,
    )
    in_time = Panel(
        "over time",
        (
            Area(
                signal.time, y * (signal.value - 2 * signal.std), y * (signal.value + 2 * signal.std), label="95 % band"
            ),
            Curve(signal.time, y * signal.value, Role.MEASURED, "from the records", 2.4),
            Curve(signal.time, y * signal.modelled, Role.EXTENDED, signal.effect, 1.4),
        ),
        TIME,
        axis,
        height=Height.TALL,
    )
    dependence = str(signal.dependence) if signal.dependence.is_relevant else "a function of no single variable"
    description = (
        f"Beside the other constants of the extended model a signal of {value_with_unit(y * signal.rms, unit)} rms is missing at"
        f" the {signal.site}. {signal.effect} explains {100 * signal.explained:.1f} % of its variance. The signal is {dependence}"
    )
    caption = f"The signal that the plain model lacks at the {signal.site}, estimated from the records, and the signal of {signal.effect}."
    return Figure(name, (against, in_time), caption, (description,))


def plot_surrogate(surrogate: Surrogate) -> Figure:
    """The curve or tone that represents an unknown effect, over the signal that the records show."""
    x, across = scale_to_prefix(surrogate.variable_unit, surrogate.values)
    y, unit = scale_to_prefix(surrogate.unit, surrogate.curve, surrogate.signal.value)
    series: list[Series] = [
        Points(x * surrogate.measured, y * surrogate.signal.value, Role.MEASURED, "from the records", opacity=0.7)
    ]
    if surrogate.tone is None:
        series.append(_bins(surrogate.dependence, x, y, float(surrogate.signal.value.mean())))
    label = surrogate_title(surrogate).removeprefix("a ")
    known = x * surrogate.values, y * surrogate.curve
    # Between a few levels nothing was seen.
    levels = surrogate.levels
    series.append(
        Curve(*known, Role.SURROGATE, label, 2.4) if levels is None else Points(*known, Role.SURROGATE, label)
    )
    axes = Axis(surrogate.variable, across), Axis(f"missing at the {surrogate.site}", unit)
    panel = Panel(surrogate.variable, tuple(series), *axes, height=Height.TALL)
    caption = (
        "A tone represents the unknown effect."
        if surrogate.tone is not None
        else "A smooth curve represents the unknown effect."
    )
    description = f"{surrogate!s}"
    return Figure("surrogate", (panel,), caption, (description,))


def plot_unexplained_signal(localisation: ResidualLocalisation) -> Figure | None:
    """The unexplained signal at the likeliest site against each variable; None where there is none."""
    signal = localisation.signal
    if signal is None or not signal.variables:
        return None
    y, unit = scale_to_prefix(signal.unit, signal.value)
    ranked = [d.variable for d in localisation.dependences if d.variable in signal.variables]
    panels = []
    for variable in dict.fromkeys([*ranked, *signal.variables]):
        x, across = scale_to_prefix(signal.units[variable], signal.variables[variable])
        points = Points(x * signal.variables[variable], y * signal.value, Role.RESIDUAL, opacity=0.5)
        panels.append(
            Panel(variable, (points,), Axis(variable, across), Axis(f"unexplained at the {signal.site}", unit))
        )
    statements = [str(d) for d in localisation.dependences if d.is_relevant][:3]
    caption = (
        f"The signal that the fitted plain model does not explain at the {signal.site}, against each variable."
        " Its parameters have absorbed part of the effect."
    )
    return Figure(
        "unexplained",
        tuple(panels),
        caption,
        (
            (
                "The signal is " + "; ".join(statements)
                if statements
                else "The signal is a function of no single variable"
            ),
        ),
    )


def plot_misfit_windows(localisation: ResidualLocalisation) -> Figure | None:
    """The misfit of each window of time, a panel for each record; None where nothing is missing."""
    windows = localisation.windows
    if not windows:
        return None
    panels = []
    for record in dict.fromkeys(w.record for w in windows):
        of_record = [w for w in windows if w.record == record]
        bars = Bars(
            np.array([(w.start + w.end) / 2 for w in of_record]),
            np.array([w.misfit for w in of_record]),
            [Role.BASELINE] * len(of_record),
            width=np.array([0.95 * (w.end - w.start) for w in of_record]),
            remarks=[f"{100 * w.share:.1f} % of all misfit" for w in of_record],
        )
        panels.append(Panel(record, (bars,), TIME, Axis("misfit / noise"), height=Height.LOW))
    worst = max(windows, key=lambda w: w.share)
    description = f"{100 * worst.share:.0f} % of the misfit lies between {worst.start:.4g} s and {worst.end:.4g} s of {worst.record}"
    return Figure("when", tuple(panels), "Misfit of the plain model along each record.", (description,))


# Best candidates of a discovery that are drawn.
DRAWING_CANDIDATES = 15


def plot_candidates(discovery: Discovery) -> Figure | None:
    """Misfit over noise of the best candidates on the records that they were fitted to; None where there are none."""
    shown = discovery.ranking[:DRAWING_CANDIDATES]
    if not shown:
        return None
    roles = _candidate_roles(discovery)
    names, misfits = [" + ".join(c.effects) for c in shown], np.array([c.misfit for c in shown])
    texts = [typeset_exponents(f"+{c.behind:.3g}") if c.behind else "best" for c in shown]
    x = size_axis("misfit / noise", "", misfits)
    marks = draw_sizes(names, misfits, roles, x, texts=texts)
    series = (Reference(1.0, upright=True, dash=Dash.DOTTED), *marks)
    panel = Panel("candidates", series, x, Axis(scale=Scale.CATEGORY, reversed=True), height=Height.PER_CATEGORY)
    sizes = dict(zip(names, misfits.tolist(), strict=True))
    description = "Misfit over noise: " + "; ".join(f"{name} {misfit:.3g}" for name, misfit in sizes.items())
    return Figure(
        "candidates",
        (panel,),
        f"Candidates on the estimation records, best first by Schwarz's criterion. {describe_candidates(discovery)}.",
        (description,),
    )


def _candidate_roles(discovery: Discovery) -> list[Role]:
    """How each candidate that is drawn is coloured: the chosen one, its rivals, the others."""
    chosen = {effect.name for effect in discovery.best.model.effects}
    rivals = [set(names) for names in discovery.alternatives]
    return [
        Role.EXTENDED if set(c.effects) == chosen else Role.RIVAL if set(c.effects) in rivals else Role.OTHER
        for c in discovery.ranking[:DRAWING_CANDIDATES]
    ]


def describe_candidates(discovery: Discovery) -> str:
    """What the colours and numbers of the drawn candidates say."""
    meaning = {Role.EXTENDED: "green: chosen", Role.RIVAL: "orange: explains the records as well"}
    roles = _candidate_roles(discovery)
    colours = capitalise("; ".join(text for role, text in meaning.items() if role in roles))
    return (
        f"{colours}. Numbers: difference of the criterion from the best"
        if colours
        else "Numbers: difference of the criterion from the best"
    )


def plot_average_spectra(discovery: Discovery) -> Figure:
    """Averaged spectra of the error on the validation records, before and after, with the noise in its colour; by output."""
    known = discovery.verdict is not Verdict.UNKNOWN
    panels = []
    for output, error in discovery.holdout.items():
        before, after = (
            estimate_residual_spectrum(f, output, coloured=known) for f in (discovery.base, discovery.extended)
        )
        factor, unit = scale_to_prefix(error.unit, before.density)
        series = (
            Curve(before.frequency, factor * np.maximum(before.density, 1e-300), Role.BASELINE, "plain model", 1.3),
            Curve(after.frequency, factor * np.maximum(after.density, 1e-300), Role.EXTENDED, "extended model", 1.3),
            Curve(before.frequency, factor * before.floor, Role.REFERENCE, "noise", 1.3, Dash.DOTTED),
        )
        panels.append(Panel(output, series, FREQUENCY, Axis("amplitude per line", unit, Scale.LOG)))
    return Figure(
        "average-spectra", tuple(panels), "Averaged spectra of the error on the validation records, before and after."
    )


def _bins(dependence: Dependence, x: float, y: float, mean: float) -> Points:
    """The signal's mean in bins of the variable; a dependence is that of the signal without its ``mean``."""
    return Points(
        x * dependence.centres,
        y * (dependence.mean + mean),
        Role.REFERENCE,
        "mean in bins, 95 %",
        size=6,
        half_bars=2 * y * dependence.std,
    )
