"""Writes the page on the controller studies: `python -m fits.control_page [--output docs]`, tables and a figure for each rig."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fits.control_study import BLACK, COMPENSATED, FAMILY, GENTLER, KNOWING, LEVEL, PLAIN, Study
from fits.paper_page import MODELS, docs_folder, legend, markdown, picture, save

PAGE = "control.md"
MEASURES = (
    "settling time of each move [s]", "overshoot", "steady error",
    "slowest settling of the family [s]", "worst steady error of the family",
    "gain margin", "phase margin", "distance from -1", "distance, least of the family", f"distance, worst of the {100 * LEVEL:.0f} % set",
)  # fmt: skip
ORDER = (BLACK, PLAIN, KNOWING, COMPENSATED)
COLOURS = dict(zip(ORDER, MODELS, strict=True))
TITLE = f"""# What the constants are for: controllers

Does it help a controller to know the friction that `greybox discover` has found? Each rig below has dry friction that its model
does not have. From two of its records come a fit of the plain model, a fit with the effect that `discover` names, and the best black
box that the library's own scan finds. One rule makes a controller of each (`fits/control_design.py`: linear-quadratic with an
integral, and a Kalman observer, through python-control; the weights are sizes of output and voltage, so they mean the same for
physical and for black-box states), reading the position alone. The compensated one has besides what only a model with friction can
give: a force against the friction, in the direction of the wanted motion, and an observer that sticks where the body sticks.

Each controller then runs on the rig itself, friction and all, integrated by equations and a method of its own
(`fits/rig_twins.py`); and on {FAMILY} rigs drawn from what the records leave open (`greybox.family`). Everything is **generated,
not measured**. A dash: it never stays within the band, or there is no margin. Margins are those of the linear loop (the compensation
is outside it) on the linear rig; "distance from -1" is the least of the loop's Nyquist curve, on the rig, over the family, and over
the confidence set of the constants.

This page is written by `python -m fits.control_page`; the studies are `fits/control_micro_actuator.py` and `fits/control_pneumatic.py`,
whose `judge_comparison` asserts what is said here.
"""


def rows_of(found: Study) -> list[list[str]]:
    """A row for each of `MEASURES`, a column for each design."""
    unit, size = found.setting.shown
    columns = []
    for name in ORDER:
        verdict, m, spread = found.verdicts[name], found.margins[name], found.spread[name]
        columns.append([
            ", ".join(map(seconds, verdict.settling)), f"{100 * verdict.overshoot:.0f} %", f"{verdict.steady / size:.2g} {unit}",
            seconds(max(v.slowest for v in spread.verdicts)), f"{max(v.steady for v in spread.verdicts) / size:.2g} {unit}",
            f"{m.gain:.2f}" if m.stable else "-", f"{m.phase:.0f}°" if m.stable else "-", distance(m.distance if m.stable else -1.0),
            distance(spread.distance), distance(spread.worst),
        ])  # fmt: skip
    return [[measure, *values] for measure, values in zip(MEASURES, zip(*columns, strict=True), strict=True)]


def gentler_rows(found: Study) -> list[list[str]]:
    """Steady error and slowest settling time of each design, at the weights of the study and at gentler ones."""
    unit, size = found.setting.shown
    columns = [found.verdicts, *(found.gentler[factor] for factor in GENTLER)]
    return [
        [name, *(f"{seconds(column[name].slowest)}, {column[name].steady / size:.2g} {unit}" for column in columns)]
        for name in ORDER
    ]


def seconds(value: float) -> str:
    """A settling time, or a dash where it never settles."""
    return f"{value:.3g}" if np.isfinite(value) else "-"


def distance(value: float) -> str:
    """A distance from -1, which is negative where the loop is unstable."""
    return f"{value:.2f}" if value > 0 else "unstable"


def printed(found: Study) -> None:
    """The tables on the terminal."""
    from greybox.result.summary import format_table

    lines = [found.found.story, "", *format_table(["", *ORDER], rows_of(found)), ""]
    lines += format_table(gentler_head(), gentler_rows(found))
    sys.stdout.write("\n".join(lines) + "\n")


def gentler_head() -> list[str]:
    """Of the table of gentler weights."""
    return [
        "slowest settling [s], steady error",
        "weights of the study",
        *(f"voltage counts {f:g} times" for f in GENTLER),
    ]


def section(title: str, name: str, words: str, found: Study, folder: Path) -> str:
    """One rig's part of the page; its figure is written beside it."""
    draw(found, folder, name)
    moves, (unit, size) = found.setting.moves, found.setting.shown
    targets = ", ".join(f"{t / size:g}" for t in moves.targets)
    return "\n\n".join([
        f"## {title}", words,
        f"What `discover` says: {found.found.story}",
        f"Targets {targets} {unit}, {moves.hold:g} s each and {moves.rise:g} s on the way; within {moves.band / size:g} {unit} is there.",
        markdown(["", *ORDER], rows_of(found)),
        "It is no matter of the weights; with the voltage counted more:",
        markdown(gentler_head(), gentler_rows(found)),
        f"![{title}: positions and errors of each design](figures/{name}.png)",
    ])  # fmt: skip


def draw(found: Study, folder: Path, name: str) -> None:
    """Positions, errors about the target, and the errors of the compensated design and its rival over the family."""
    unit, size = found.setting.shown
    figure, (above, middle, below) = picture(3, height=2.6)
    run = found.runs[BLACK]
    above.plot(run.time, run.target / size, color="black", lw=0.8, ls=":", label="target")
    for design in ORDER:
        run = found.runs[design]
        above.plot(run.time, run.position / size, color=COLOURS[design], lw=1.1, label=design)
        middle.plot(run.time, (run.position - run.target) / size, color=COLOURS[design], lw=1.1)
    for design in (PLAIN, COMPENSATED):
        error = (found.spread[design].positions - run.target) / size
        below.fill_between(
            run.time, error.min(axis=0), error.max(axis=0), color=COLOURS[design], alpha=0.4, lw=0, label=design
        )
    band = found.setting.moves.band / size
    for axis in (middle, below):
        axis.axhspan(-band, band, color="black", alpha=0.08, lw=0)
        axis.set_ylim(-6 * band, 6 * band)
    legend(above, "", f"position [{unit}]", "on the rig", columns=2)
    legend(middle, "", f"error [{unit}]", "what is missing to the target; grey: within it is there")
    legend(below, "time [s]", f"error [{unit}]", f"the same on {FAMILY} rigs that the records leave open", columns=2)
    save(figure, folder, name)


def main() -> None:
    """Both studies, their verdicts, and the page."""
    from fits import control_micro_actuator, control_pneumatic

    folder, parts = docs_folder("control_page"), []
    for title, module in (("Micro-motion actuator", control_micro_actuator), ("Pneumatic cylinder", control_pneumatic)):
        found = module.study(module.SETTING)
        printed(found)
        module.verdict(found)
        parts.append(section(title, module.__name__.rpartition(".")[2], module.WORDS, found, folder))
    (folder / PAGE).write_text("\n\n".join([TITLE.rstrip(), *parts]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
