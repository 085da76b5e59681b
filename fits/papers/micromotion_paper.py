"""Do Tables 1 to 3 and figures 4, 6 and 7 of Wang's paper come out, and what did its black-box pipeline cost?

On a stand-in for the rig (`fits.papers.micromotion_twin`: generated, not measured) the paper's whole pipeline: twelve ARX models, twelve
ARMAX models, Monte-Carlo smoothing, least squares on the smoothed (S-E) and on the raw response (D-E) for seven numerators, and
the s-domain. All errors are mean squares of the free run over the whole record in um^2 (equation 1).

    python -m fits.papers.micromotion_page [--output docs/studies]

writes the part on this paper of `docs/studies/paper_tables.md` and three figures.

What to expect: Table 1 and the D-E row of Table 3 within 10 % of print, the pattern of Table 2 (ARMAX better than ARX, best at
na = 4 and nk = 3), the spectral peak to every digit. S-E with two or one numerator coefficients depends on which draws were lucky.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fits.papers import micromotion_printed as printed
from fits.papers.micromotion_smoothing import (
    MonteCarloSmoothing,
    NumeratorComparison,
    SmoothingProgress,
    compare_numerators,
    estimate_spectrum,
    find_resonance,
    monte_carlo_smoothing,
)
from fits.papers.micromotion_twin import ROWS, SAMPLING_TIME, SEED, in_micrometres, step_record
from fits.papers.paper_page import rms_log
from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.polynomial import PolynomialModel
from greybox.comparison.blackbox.prediction_error_models import armax, output_error
from greybox.data.experiment import Experiment

EVALUATIONS = 20
OTHER_SEEDS = range(1, 21)


@dataclass(frozen=True, eq=False)
class Study:
    """The pipeline on one record: models and errors of Tables 1 and 2 (rows nk, columns na), the smoothing, Table 3, figure 6.

    ``printed_structures`` is Table 3 with the constants that the paper prints for equation 17; ``optimum`` the least-squares
    optimum of equation 17 without intervals, ``seconds`` of smoothing and Table 3.
    """

    record: Experiment
    arx: list[list[PolynomialModel]]
    armax: list[list[PolynomialModel]]
    table_1: np.ndarray
    table_2: np.ndarray
    smoothing: MonteCarloSmoothing
    structures: tuple[NumeratorComparison, ...]
    printed_structures: tuple[NumeratorComparison, ...]
    from_data: MonteCarloSmoothing
    optimum: float
    frequencies: np.ndarray
    density: np.ndarray
    seconds: float


def error(model: PolynomialModel | MonteCarloSmoothing, record: Experiment) -> float:
    """Mean square of the free run's error (equation 1) in um^2; the record begins at rest."""
    return float(np.mean((record.outputs["x"] - model.simulate(record, initial="zero")["x"]) ** 2))


def table_1(record: Experiment) -> list[list[PolynomialModel]]:
    """ARX models by nk and na, rows with a measured history."""
    return [[arx(record, na=na, nb=1, nk=nk) for na in printed.ORDERS] for nk in printed.DELAYS]


def table_2(record: Experiment) -> list[list[PolynomialModel]]:
    """ARMAX models by nk and na, nb = nc = 1; zeros before the record, which begins at rest."""
    return [[armax(record, na=na, nb=1, nc=1, nk=nk, history="zero") for na in printed.ORDERS] for nk in printed.DELAYS]


def smoothed(
    record: Experiment, seed: int, report: Callable[[SmoothingProgress], None] | None = None
) -> tuple[MonteCarloSmoothing, tuple[NumeratorComparison, ...]]:
    """Section 4.2 with the paper's intervals and specification, and Table 3."""
    smoothing = monte_carlo_smoothing(
        record,
        seed=seed,
        intervals=printed.INTERVALS,
        specification=printed.SPECIFICATION,
        evaluations=EVALUATIONS,
        units={"x": "um"},
        report=report,
    )
    return smoothing, compare_numerators(record, smoothing)


def study(seed: int = SEED, report: Callable[[SmoothingProgress], None] | None = None) -> Study:
    """Everything, on the record with this seed."""
    record = in_micrometres(step_record(seed))
    first, second = table_1(record), table_2(record)
    began = time.perf_counter()
    smoothing, structures = smoothed(record, seed, report)
    seconds = time.perf_counter() - began
    w, density = estimate_spectrum(record.outputs["x"], SAMPLING_TIME)
    return Study(
        record,
        first,
        second,
        errors(first, record),
        errors(second, record),
        smoothing,
        structures,
        compare_numerators(record, printed.smoothing(ROWS)),
        monte_carlo_smoothing(record, seed=seed),
        error(output_error(record, nb=3, nf=2, nk=0, history="zero"), record),
        w,
        density,
        seconds,
    )


def errors(models: list[list[PolynomialModel]], record: Experiment) -> np.ndarray:
    """Errors of a table of models."""
    return np.array([[error(m, record) for m in row] for row in models])


def spread(seeds: range = OTHER_SEEDS) -> tuple[np.ndarray, np.ndarray]:
    """Distance (rms of the logarithm) of Table 1 and of the D-E row from print, for other seeds."""
    first, direct = [], []
    for seed in seeds:
        record = in_micrometres(step_record(seed))
        first.append(rms_log(errors(table_1(record), record), printed.TABLE_1))
        rows = compare_numerators(record, printed.smoothing(ROWS))
        direct.append(rms_log([r.direct for r in rows], printed.TABLE_3_DIRECT))
    return np.array(first), np.array(direct)


def verdict(s: Study) -> None:
    """What must come out of any such record."""
    assert rms_log(s.table_1, printed.TABLE_1) < 0.15
    assert rms_log([r.direct for r in s.structures], printed.TABLE_3_DIRECT) < 0.15
    assert_pattern_of_table_2(s)
    assert abs(find_resonance(s.frequencies, s.density) - printed.SPECTRAL_PEAK) < 5e-5
    assert s.smoothing.met and s.smoothing.error < s.table_2.min() < s.table_1.min()
    exact = s.structures[4].smoothed
    assert exact is not None and abs(exact / s.smoothing.error - 1) < 1e-6
    assert s.optimum < s.smoothing.error
    assert s.seconds < 5


def assert_pattern_of_table_2(s: Study) -> None:
    """ARMAX beats ARX everywhere; more delay is better in every column; the best is na = 4 with nk = 3, as printed."""
    assert np.all(s.table_2 < s.table_1)
    assert np.all(np.diff(s.table_2, axis=0) < 0) and np.all(np.diff(printed.TABLE_2, axis=0) < 0)
    assert np.argmin(s.table_2) == np.argmin(printed.TABLE_2)
