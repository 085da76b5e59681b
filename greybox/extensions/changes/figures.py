"""What has changed, in figures: each constant before and after, machines of a kind, and the course over time."""

from __future__ import annotations

import math

import numpy as np

from greybox.base.figure import Axis, Band, Curve, Figure, Height, Panel, Points, Reference, Role, Scale, Series
from greybox.extensions.changes.result import ChangeDetection, ConstantChange
from greybox.show.figures.figure import typeset_unit
from greybox.show.sentences.wording import CHANGE_REACH, join_names, percent_text


def is_determined(change: ConstantChange) -> bool:
    """Whether the interval of a change is one whose figures say something."""
    if change.interval is None:
        return False
    reach = max(map(abs, change.interval))
    return math.isfinite(reach) and (not change.before or reach <= CHANGE_REACH * abs(change.before))


def plot_changes(change: ChangeDetection) -> Figure | None:
    """Each determined constant's change in percent with its interval about zero; None where nothing was compared."""
    shown = {n: c for n, c in change.constants.items() if is_determined(c) and c.before}
    if not shown:
        return None
    percent = {n: 100 * (c.after - c.before) / abs(c.before) for n, c in shown.items()}
    # Half of the interval, in percent of the constant before.
    half = {n: 50 * (c.interval[1] - c.interval[0]) / abs(c.before) for n, c in shown.items() if c.interval}
    series: list[Series] = [Reference(0.0)]
    moved = [n for n, c in shown.items() if c.moved]
    # The others first, and behind: this keeps the order of the constants along the axis.
    for role, label, names in ((Role.OTHER, "as before", list(shown)), (Role.BASELINE, "changed", moved)):
        if names:
            values, bars = (np.array([of[n] for n in names]) for of in (percent, half))
            series.append(Points(names, values, role, label, size=9, half_bars=bars))
    panel = Panel(
        "changes", tuple(series), Axis(scale=Scale.CATEGORY), Axis("change since the fit", "%"), height=Height.MEDIUM
    )
    description = "; ".join(f"{name} {'+' * (size > 0)}{percent_text(size / 100)}" for name, size in percent.items())
    missing = [n for n in change.constants if n not in shown]
    return Figure(
        "changes",
        (panel,),
        (
            "Change of each constant since the fit, with 95 % intervals that hold together. Zero is as before."
            + (f" Not drawn, as the table tells why: {join_names(missing)}." if missing else "")
        ),
        (description,),
    )


def plot_population(change: ChangeDetection) -> Figure | None:
    """Each constant of each machine with its 95 % interval, over the band in which 95 % of such machines lie."""
    panels = []
    for name, common in change.population.items():
        # Two deviations to both sides; of a spread in the logarithm as factors.
        low, high = (
            (common.mean * math.exp(s * 2 * common.spread) for s in (-1, 1))
            if common.relative
            else (common.mean + s * 2 * common.spread for s in (-1, 1))
        )
        series: list[Series] = [Band(low, high, label="95 % of such machines"), Reference(common.mean)]
        known = [m for m in change.machines if m.constants[name]["std"] is not None]
        outside = [m for m in known if name in m.outlying]
        for role, label, machines in ((Role.RESIDUAL, "belongs", known), (Role.BASELINE, "falls out", outside)):
            if machines:
                values = np.array([m.constants[name]["value"] for m in machines])
                bars = 2 * np.array([m.constants[name]["std"] for m in machines])
                series.append(Points([m.name for m in machines], values, role, label, size=9, half_bars=bars))
        axis = Axis(name, typeset_unit(common.unit))
        panels.append(Panel(name, tuple(series), Axis(scale=Scale.CATEGORY), axis))
    if not panels:
        return None
    outlying = {name for m in change.machines for name in m.outlying}
    # What stands out comes first.
    panels.sort(key=lambda panel: panel.name not in outlying)
    return Figure(
        "machines",
        tuple(panels),
        "Each machine with its 95 % interval. The line is the mean of those that belong together, the band holds 95 % of such machines.",
    )


def plot_course(change: ChangeDetection) -> Figure | None:
    """Each constant over the records with its 95 % interval, its mean between jumps, and the jumps."""
    if not change.records:
        return None
    panels = []
    for name in change.records[0].constants:
        places, values, bars = [], [], []
        for t, record in enumerate(change.records):
            value, interval = record.constants.get(name, (math.nan, None))
            if interval is not None and all(map(math.isfinite, interval)):
                places.append(t)
                values.append(value)
                bars.append((interval[1] - interval[0]) / 2)
        if not places:
            continue
        jumps = [c for c in change.change_points if c.constant == name]
        series: list[Series] = [
            Points(np.array(places), np.array(values), Role.RESIDUAL, "records", size=6, half_bars=np.array(bars))
        ]
        if jumps:
            # A level reaches from half a record before its first one to half a record behind its last.
            edges = [-0.5, *(c.number - 0.5 for c in jumps), len(change.records) - 0.5]
            levels = [jumps[0].before, *(c.after for c in jumps)]
            x = np.repeat(edges, 2)[1:-1]
            series.append(Curve(x, np.repeat(levels, 2), Role.BASELINE, "mean between jumps", 1.6))
        unit = change.reference.parameters[name].unit
        panels.append(Panel(name, tuple(series), Axis("record, 0 is the fit"), Axis(name, typeset_unit(unit))))
    if not panels:
        return None
    jumped = {c.constant for c in change.change_points}
    panels.sort(key=lambda panel: panel.name not in jumped)
    return Figure(
        "course", tuple(panels), "Each record with its 95 % interval, in the order of time; record 0 is the fit."
    )
