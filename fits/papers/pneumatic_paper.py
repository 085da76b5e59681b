"""Do the tables and figures of the pneumatic ARX paper come out, and what do its numbers mean?

On a stand-in for the rig (`fits.papers.pneumatic_twin`: generated, not measured) the nine experiments of section
10.3, and for each the nine ARX
models of Tables 10.3 to 10.5. "Simulation focus" is read as least squares whose rows are prefiltered once by 1 / A (Steiglitz and
McBride), with zeros before the record; best fit and MSE belong to the free run from rest, the loss to the one-step error.

    python -m fits.papers.pneumatic_page [--output docs/studies]

writes the part on this paper of `docs/studies/paper_tables.md` and five figures.

What to expect: Table 10.2 exactly, with the amplitudes that belong to it; the variance of position within 10 %; the second input
fitted best and the first worst; the loss of two and three poles. Not the dips of (3,3) and (4,4) with the third input, nor the
loss of (4,4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fits.papers import pneumatic_printed as printed
from fits.papers.pneumatic_nine_experiments import AMPLITUDES
from fits.papers.pneumatic_printed import Cell
from fits.papers.pneumatic_twin import DURATION, in_volts, nine_experiments, voltage
from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.data.experiment import Experiment

PASSES = (0, 1, 2)
SHOWN = "u2_3"  # the experiment of equation 10.12 and figures 10.8 and 10.9


@dataclass(frozen=True, eq=False)
class Study:
    """``cells[nk][experiment][order]`` as the printed tables; ``losses[passes][order]`` by input (medians over its experiments, nk =
    0); ``models[nk]`` the second-order models of experiment `SHOWN`; ``inputs`` the four statistics of Table 10.2.
    """

    inputs: dict[str, tuple[float, float, float, float]]
    records: dict[str, Experiment]
    cells: dict[int, dict[str, dict[int, Cell]]]
    losses: dict[int, dict[int, list[float]]]
    models: dict[int, PolynomialModel]


def identified(record: Experiment, order: int, nk: int, passes: int = 1) -> PolynomialModel:
    """One model of the tables."""
    return arx(
        record,
        na=order,
        nb=order,
        nk=nk,
        history="zero",
        focus="simulation" if passes else "prediction",
        passes=passes or 1,
    )


def judged(model: PolynomialModel, record: Experiment) -> Cell:
    """Best fit, loss and MSE as the paper's section 10.3.5 defines them, the loss read as the one-step error's."""
    y = record.outputs["y"]
    error = y - model.simulate(record, initial="zero")["y"]
    fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
    return Cell(float(fit), float(np.nanmean(model.errors(record, initial="measured") ** 2)), float(np.mean(error**2)))


def statistics(name: str) -> tuple[float, float, float, float]:
    """Mean, largest and smallest value, and variance (N - 1) of an input over the record (Table 10.2)."""
    u = voltage(name)
    return float(u.mean()), float(u.max()), float(u.min()), float(u.var(ddof=1))


def study(duration: float = DURATION, report: Callable[[], None] | None = None) -> Study:
    """All tables on the nine records, of ``duration`` seconds each."""
    records, cells = {}, {nk: {} for nk in printed.DELAYS}
    for record in nine_experiments(duration):
        records[record.name] = volts = in_volts(record)
        for nk in printed.DELAYS:
            cells[nk][record.name] = {n: judged(identified(volts, n, nk), volts) for n in printed.ORDERS}
        if report is not None:
            report()
    losses = {p: {n: _losses(records, n, p) for n in printed.ORDERS} for p in PASSES}
    models = {nk: identified(records[SHOWN], 2, nk) for nk in printed.DELAYS}
    return Study({u: statistics(u) for u in AMPLITUDES}, records, cells, losses, models)


def _losses(records: dict[str, Experiment], order: int, passes: int) -> list[float]:
    every = {name: judged(identified(r, order, 0, passes), r).loss for name, r in records.items()}
    return [float(np.median([v for name, v in every.items() if name.startswith(u)])) for u in AMPLITUDES]


def by_input(cells: dict[str, dict[int, Cell]], order: int) -> dict[str, float]:
    """Median best fit of each input's experiments."""
    return {
        u: float(np.median([row[order].best_fit for name, row in cells.items() if name.startswith(u)]))
        for u in AMPLITUDES
    }


def verdict(s: Study) -> None:
    """What must come out of any such records."""
    for name, row in printed.TABLE_10_2.items():
        assert np.all(np.abs(np.array(s.inputs[name]) - row) <= [5e-6, 5e-5, 5e-5, 5e-5]), name
    for name, record in s.records.items():
        ours, theirs = float(record.outputs["y"].var()), printed.variance(name).mean()
        assert abs(ours / theirs - 1) < 0.10, name
    for table in (printed.TABLES[0], s.cells[0]):
        fits = by_input(table, 2)
        assert fits["u2"] > fits["u3"] > fits["u1"]
    for order in (2, 3):
        ratio = np.array(s.losses[1][order]) / printed.median_losses(order)
        assert np.all((ratio > 0.6) & (ratio < 1.6)), order
    for model in s.models.values():
        # an integrator, to within what the record's drift makes of it, and a lag
        assert abs(model.poles[0] - 1) < 1e-3 and 0.97 < model.poles[1].real < 0.999
