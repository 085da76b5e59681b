"""What do measured records show that simulated ones do not? The figures of docs/measured_lessons.md.

    python -m fits.studies.measured_lessons FOLDER [--docs docs]

FOLDER holds the rigs of `fits.studies.measured_rigs`. Three figures: the acceleration of gravity that the video of
heavy balls shows, the constants
of a weighed pendulum as fits have them and what each friction leaves, and how deep the answers on measured rigs were certain (from the
page of measured certainty).
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import greybox as gb
from fits.studies.measured_rigs import RIGS, ball, falling_ball, pendulum, swing

# The acceleration of gravity where the balls fell, m/s^2.
GRAVITY = 9.79
HEAVY = ("baseball", "golf_ball", "bowling_ball")
# What was weighed of the pendulum: its inertia in kg m^2, and m g l in N m.
WEIGHED = {"J": 0.147, "mgl": 2.98}
# Seconds of an arc: each has an initial state of its own, so that a drift of the torque does not add up.
ARC = 1.0
FRICTIONS = ("coulomb_friction", "load_dependent_friction")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--docs", type=Path, default=Path(__file__).resolve().parents[2] / "docs")
    chosen = arguments.parse_args()
    figures = {
        "lesson_scale": draw_gravity(chosen.folder / RIGS["heavy ball"].folder),
        "lesson_torque": draw_torque(chosen.folder / RIGS["pendulum"].folder),
        "lesson_depth": draw_depths(chosen.docs / "studies" / "measured_certainty.md"),
    }
    for name, figure in figures.items():
        figure.savefig(chosen.docs / "figures" / f"{name}.svg", metadata={"Date": None})


# 1. The scale of a video bends: heavy balls fall too slowly, and an effect that explains it has the wrong sign.


def draw_gravity(folder: Path) -> Figure:
    """Acceleration of gravity and drag with their intervals, each fitted to one fall of a ball that hardly feels the air."""
    drag = gb.effect("quadratic_damping")
    model = (falling_ball() + drag).free("g").bound(B2=(-1.0, 1.0))
    labels, gravity, drags = [], [], []
    for name in HEAVY:
        for drop in (1, 2):
            fit = gb.fit(model, ball(folder / f"{name}_drop{drop}.csv"))
            labels.append(f"{name.replace('_', ' ')}, fall {drop}")
            gravity.append((fit.parameters["g"].value, fit.parameters["g"].std or 0.0))
            drags.append((fit.parameters["B2"].value, fit.parameters["B2"].std or 0.0))
            print(f"{labels[-1]}: g {gravity[-1][0]:.2f} +- {gravity[-1][1]:.2f} m/s^2, drag {drags[-1][0]:.4f} 1/m")
    figure, (left, right) = start_figure(8.0, 3.2, 2)
    rows = np.arange(len(labels))[::-1]
    for axis, values, truth, label in (
        (left, gravity, GRAVITY, "acceleration of gravity, m/s²"),
        (right, drags, 0.0, "drag, 1/m"),
    ):
        value, std = np.array(values).T
        axis.errorbar(value, rows, xerr=2 * std, fmt="o", markersize=4, capsize=2)
        axis.axvline(truth, color="0.5", linewidth=1)
        axis.set_xlabel(label)
        axis.set_yticks(rows, labels if axis is left else [])
    left.set_title("grey: known", fontsize="medium")
    right.set_title("a drag below zero drives the ball", fontsize="medium")
    return figure


# 2. The torque of a drive is computed from its current: it may be off by a factor, and which friction its gear has one record hardly says.


def draw_torque(folder: Path) -> Figure:
    """What a fit says of weighed constants, and what each friction leaves of two swing-ups, both over arcs of a second."""
    figure, (left, right) = start_figure(8.0, 2.8, 2)
    arcs = gb.FitOptions(arc_length=ARC)
    for k, name in enumerate(("ddp", "direct_collocation")):
        record, title = swing(folder / f"{name}.csv"), name.replace("_", " ")
        fits = [gb.fit(pendulum(), record, options=arcs)]
        fits += [gb.fit(pendulum() + gb.effect(friction), record, options=arcs) for friction in FRICTIONS]
        dry = fits[1]
        ratios = {n: dry.parameters[n].value / weighed for n, weighed in WEIGHED.items()}
        spread = [2 * (dry.parameters[n].std or 0.0) / weighed for n, weighed in WEIGHED.items()]
        errors = [1e3 * fit.misfit["q"].rmse for fit in fits]
        print(f"{title}: fitted over weighed {ratios}, rms of the angle {errors} mrad")
        rows = np.arange(2) + 0.2 * k
        left.errorbar(list(ratios.values()), rows, xerr=spread, fmt="o", markersize=4, capsize=2, label=title)
        right.barh(np.arange(len(fits)) + 0.4 * k, errors, 0.38, label=title)
    left.axvline(1.0, color="0.5", linewidth=1)
    left.set_yticks([0.1, 1.1], ["inertia", "weight × lever"])
    left.set(xlabel="fitted, over weighed", xlim=(0.9, None), ylim=(-0.4, 1.7))
    right.set_yticks([0.2, 1.2, 2.2], ["viscous alone", "and dry", "and dry, by load"])
    right.set_xlabel("rms error of the angle, mrad")
    right.set_xlim(0, 1.5 * right.get_xlim()[1])  # room for the legend beside the bars
    right.legend(fontsize="small", loc="upper right")
    return figure


# 3. How deep an answer is certain: the place before the variables, these before the name.


def draw_depths(page: Path) -> Figure:
    """What was established on the measured rigs at each depth, right and wrong, as the page of measured certainty counts it."""
    # The first of the tables by depth is that of what was established.
    rows = re.findall(
        r"^\| (place|variables|family|name) \| (\d+) \| (\d+) \|", page.read_text(encoding="utf-8"), re.M
    )[:4]
    figure, (axis,) = start_figure(5.0, 2.4, 1)
    for k, (depth, right, wrong) in enumerate(rows):
        axis.barh(-k, int(right), color="C0", label="right" if not k else None)
        axis.barh(-k, int(wrong), left=int(right), color="C3", label="wrong" if not k else None)
        print(f"{depth}: {right} established and right, {wrong} wrong")
    axis.set_yticks([-k for k in range(len(rows))], [row[0] for row in rows])
    axis.set_xlabel("established claims on measured rigs")
    axis.legend(loc="lower right")
    axis.xaxis.get_major_locator().set_params(integer=True)
    return figure


def start_figure(width: float, height: float, panels: int) -> tuple[Figure, list]:
    """A figure with panels side by side."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(np.atleast_1d(figure.subplots(1, panels)))


if __name__ == "__main__":
    main()
