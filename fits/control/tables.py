"""The tables of the controller studies: each design on the rig, over the family, and at gentler weights."""

from __future__ import annotations

import sys

import numpy as np

from fits.control.study import BLACK, COMPENSATED, GENTLER, KNOWING, LEVEL, PLAIN, Study
from greybox.show.printers.text import table_lines

MEASURES = (
    "settling time of each move [s]",
    "overshoot",
    "steady error",
    "slowest settling of the family [s]",
    "worst steady error of the family",
    "gain margin",
    "phase margin",
    "distance from -1",
    f"distance, worst of the {100 * LEVEL:.0f} % set",
)
ORDER = (BLACK, PLAIN, KNOWING, COMPENSATED)


def rows_of(results: Study) -> list[list[str]]:
    """A row for each of `MEASURES`, a column for each design."""
    unit, size = results.setting.shown
    columns = []
    for name in ORDER:
        verdict, m, spread = results.verdicts[name], results.margins[name], results.spread[name]
        columns.append(
            [
                ", ".join(map(seconds, verdict.settling)),
                f"{100 * verdict.overshoot:.0f} %",
                f"{verdict.steady / size:.2g} {unit}",
                seconds(max(v.slowest for v in spread.verdicts)),
                f"{max(v.steady for v in spread.verdicts) / size:.2g} {unit}",
                f"{m.gain:.2f}" if m.stable else "-",
                f"{m.phase:.0f}°" if m.stable else "-",
                distance(m.distance if m.stable else -1.0),
                distance(spread.worst),
            ]
        )
    return [[measure, *values] for measure, values in zip(MEASURES, zip(*columns, strict=True), strict=True)]


def gentler_rows(results: Study) -> list[list[str]]:
    """Steady error and slowest settling time of each design, at the weights of the study and at gentler ones."""
    unit, size = results.setting.shown
    columns = [results.verdicts, *(results.gentler[factor] for factor in GENTLER)]
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


def print_tables(results: Study) -> None:
    """The tables on the terminal."""
    lines = [results.discovery.story, "", *table_lines(["", *ORDER], rows_of(results)), ""]
    lines += table_lines(gentler_head(), gentler_rows(results))
    sys.stdout.write("\n".join(lines) + "\n")


def gentler_head() -> list[str]:
    """Of the table of gentler weights."""
    return [
        "slowest settling [s], steady error",
        "weights of the study",
        *(f"voltage counts {f:g} times" for f in GENTLER),
    ]
