"""A discovery in pictures: the missing signal with the effect's curve through it, candidates in order, the gap before and after."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from greybox.discovery import Discovery, EffectSignal, Surrogate
from greybox.discovery.surrogate import describe_explained_share
from greybox.plots.discovery_residual import draw_residuals
from greybox.plots.files import save_figure
from greybox.plots.layout import HEADING, NAMES, NUMBERS, legends, panels, settle
from greybox.plots.several import both
from greybox.plots.units import axis_label, scale_to_prefix, typeset_exponents

DATA, EFFECT, BEFORE, AFTER, FLOOR = "#8a8a8a", "#c0392b", "#b7950b", "#1f5a8a", "#dcdcdc"
CANDIDATES = 12  # of the ranking that are shown


def discovery_figures(found: Discovery, directory: str | Path) -> list[Path]:
    """Draw ``found`` into ``directory``, each picture as PNG and SVG; returns the files.

    ``missing-EFFECT`` (or ``missing-unknown``): the unexplained signal against the variable it depends on, with the curve of the effect
    (of the stand-in) through it. ``residuals``: the validation error in time and by frequency, before and after, with the noise.
    ``candidates``: misfit over noise of the refitted candidates. ``gap``: rms misfit before and after beside the noise floor.
    """
    drawings: dict[str, Callable[[], Figure]]
    drawings = {f"missing-{_file(m.effect)}": partial(_missing, m) for m in found.missing}
    if found.surrogate is not None:
        drawings["missing-unknown"] = partial(_unknown, found.surrogate)
    drawings["residuals"] = partial(draw_residuals, found)
    if found.ranking:
        drawings["candidates"] = partial(_candidates, found)
    drawings["gap"] = partial(_gap, found)
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [folder / f"{name}.png" for name in drawings]
    both([partial(_draw, *one) for one in zip(drawings.values(), pictures, strict=True)])
    return [file for picture in pictures for file in (picture, picture.with_suffix(".svg"))]


def _draw(drawing: Callable[[], Figure], picture: Path) -> None:
    save_figure(drawing(), picture)


def _file(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name)


def _missing(m: EffectSignal) -> Figure:
    figure, axes = panels(10, 4.2, columns=2)
    left, right = axes[0]
    factor, unit = scale_to_prefix(m.unit, m.value)
    across, variable_unit = scale_to_prefix(m.variable_unit, m.variable)
    left.plot(across * m.variable, factor * m.value, ".", color=DATA, ms=3, label="from the data")
    left.plot(across * m.variable, factor * m.modelled, ".", color=EFFECT, ms=2, label=m.effect)
    _bins(left, across, factor, m.region.centres, m.region.mean, m.region.std)
    left.set_xlabel(axis_label(m.variable_name, variable_unit), fontsize=NAMES)
    left.set_ylabel(axis_label(f"missing at the {m.site}", unit), fontsize=NAMES)
    few = slice(0, min(len(m.time), 150))
    right.fill_between(
        m.time[few], factor * (m.value - 2 * m.std)[few], factor * (m.value + 2 * m.std)[few], color=FLOOR, lw=0
    )
    right.plot(m.time[few], factor * m.value[few], color=DATA, lw=1.6, label="from the data, ± 2 std")
    right.plot(m.time[few], factor * m.modelled[few], color=EFFECT, lw=0.9, label=m.effect)
    right.set_xlabel("time [s]", fontsize=NAMES)
    legends(left, right)
    heading = f"{m.effect} explains {100 * m.explained:.1f} % of the missing signal in {m.record}"
    settle(figure, axes, heading, widths=(1.1, 1), above=1)
    return figure


def _unknown(curve: Surrogate) -> Figure:
    figure, axes = panels(7, 4.2)
    axis = axes[0, 0]
    factor, unit = scale_to_prefix(curve.unit, curve.signal.value)
    across, variable_unit = scale_to_prefix(curve.variable_unit, curve.seen)
    axis.plot(across * curve.seen, factor * curve.signal.value, ".", color=DATA, ms=3, label="unexplained by the model")
    if curve.tone is None:
        _bins(axis, across, factor, curve.region.centres, curve.region.mean, curve.region.std)
    axis.plot(across * curve.values, factor * curve.curve, color=EFFECT, lw=1.6, label=f"{curve.title} (stand-in)")
    axis.set_xlabel(axis_label(curve.variable, variable_unit), fontsize=NAMES)
    axis.set_ylabel(axis_label(f"missing at the {curve.site}", unit), fontsize=NAMES)
    legends(axis)
    settle(figure, axes, f"unknown effect; {curve.title} {describe_explained_share(curve.explained_fraction)}", above=1)
    return figure


def _bins(axis: Axes, across: float, factor: float, centres: np.ndarray, mean: np.ndarray, std: np.ndarray) -> None:
    axis.errorbar(
        across * centres, factor * mean, 2 * factor * std, fmt="o", ms=4, color="black", lw=0.8, label="mean in bins, ± 2 std"
    )  # fmt: skip


def _candidates(found: Discovery) -> Figure:
    shown = list(found.ranking)[:CANDIDATES]
    figure, axes = panels(8.5, 1.3 + 0.3 * len(shown))
    axis = axes[0, 0]
    chosen = tuple(found.best.model.effects[k].name for k in range(len(found.best.model.effects)))
    rivals = [tuple(a) for a in found.alternatives]
    for row, rank in enumerate(reversed(shown)):
        colour = EFFECT if rank.effects == chosen else BEFORE if rank.effects in rivals else DATA
        axis.barh(row, rank.misfit, color=colour, height=0.6)
        behind = typeset_exponents(f" +{rank.behind:.3g}") if rank.behind else " best"
        axis.annotate(behind, (rank.misfit, row), va="center", fontsize=NUMBERS)
    axis.axvline(1.0, color="black", lw=0.8, ls=":")
    axis.set_yticks(range(len(shown)), [" + ".join(r.effects) for r in reversed(shown)], fontsize=NUMBERS)
    axis.set_xscale("log")
    axis.set_xlim(min(0.8, axis.get_xlim()[0]), axis.get_xlim()[1] * 1.6)
    axis.set_xlabel("misfit over noise on the estimation records (dotted: noise)", fontsize=NAMES)
    named = "candidates; red: the answer" + ("; yellow: explains as well" if rivals else "")
    settle(figure, axes, f"{found.verdict}: {named}; numbers: criterion behind the best", grid=False)
    return figure


def _gap(found: Discovery) -> Figure:
    figure, axes = panels(1.5 + 2.6 * len(found.gap), 3.6, columns=len(found.gap))
    for axis, (output, gap) in zip(axes[0], found.gap.items(), strict=True):
        bars = {"before": (gap.before, BEFORE), "after": (gap.after, AFTER)}
        if found.surrogate is not None:
            bars["stand-in"] = (found.surrogate.gap[output].after, EFFECT)
        factor, unit = scale_to_prefix(gap.unit, np.array([v for v, _ in bars.values()]))
        for place, (size, colour) in enumerate(bars.values()):
            axis.bar(place, factor * size, color=colour, width=0.6)
        axis.set_xticks(range(len(bars)), list(bars))
        axis.axhline(factor * gap.floor, color="black", lw=1, ls=":")
        axis.set_ylabel(axis_label(f"rms misfit of {output}", unit), fontsize=NAMES)
        explained_fraction = (
            f"{100 * gap.explained_fraction:.1f} % closed" if gap.before > 1.02 * gap.floor else "no gap"
        )
        axis.set_title(f"{output}: {explained_fraction}", fontsize=HEADING)
    settle(figure, axes, "validation records, free run; dotted: noise", above=1, grid=False)
    return figure
