"""Least squares on the measured and on the smoothed response, for several numerators (equations 18 and 19, Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.blackbox.arx import arx
from greybox.blackbox.monte_carlo_smoothing.result import MonteCarloSmoothing
from greybox.blackbox.polynomial import PolynomialModel
from greybox.errors import DataError
from greybox.experiment import Experiment

# Order of the denominator, first and last lag of the numerator: the seven columns of Table 3.
NUMERATOR_STRUCTURES = ((3, 0, 3), (3, 1, 3), (3, 2, 3), (3, 3, 3), (2, 0, 2), (2, 1, 2), (2, 2, 2))


@dataclass(frozen=True, eq=False)
class NumeratorComparison:
    """One structure: ``order`` of the denominator, ``lags`` of the numerator, and what least squares makes of it.

    ``direct`` (D-E) and ``smoothed`` (S-E) are mean squares of the measured response less the free run from rest, in the
    output's unit squared, of ``direct_model`` and ``smoothed_model``. An error is None where the equations are collinear or
    their solution is unstable; ``remark`` then says which.
    """

    order: int
    lags: tuple[int, ...]
    direct: float | None
    smoothed: float | None
    direct_model: PolynomialModel | None
    smoothed_model: PolynomialModel | None
    remark: str = ""

    @property
    def label(self) -> str:
        """``b1 b2 over a1 a2``."""
        return f"{' '.join(f'b{k}' for k in self.lags)} over {' '.join(f'a{k}' for k in range(1, self.order + 1))}"


def compare_numerators(
    experiment: Experiment,
    smoothing: MonteCarloSmoothing,
    structures: Sequence[tuple[int, int, int]] = NUMERATOR_STRUCTURES,
) -> tuple[NumeratorComparison, ...]:
    """Least squares on the record itself (D-E) and on its smoothed response (S-E), judged on the record.

    ``y(k) = -a1 y(k-1) - ... + b0 u(k) + b1 u(k-1) + ...`` with the rows of the record's first instants, zeros before it: a step
    has no others that tell the lags of its input apart. The smoothed response obeys a second-order equation exactly, so a third
    order on it leaves its coefficients open. ``structures``: order, first and last lag.
    """
    edge = int(np.flatnonzero(experiment.inputs[smoothing.input])[0])
    rows = np.arange(experiment.rows) - edge
    smooth = experiment.with_outputs({smoothing.output: smoothing.response(rows * smoothing.sampling_time)})
    return tuple(_structure(experiment, smooth, smoothing, *s) for s in structures)


def _structure(
    measured: Experiment, smooth: Experiment, smoothing: MonteCarloSmoothing, order: int, first: int, last: int
) -> NumeratorComparison:
    direct, direct_model, problem = _fit_arx(measured, measured, smoothing, order, first, last)
    smoothed, smoothed_model, other = _fit_arx(smooth, measured, smoothing, order, first, last)
    remark = "; ".join(f"{name}: {text}" for name, text in (("D-E", problem), ("S-E", other)) if text)
    return NumeratorComparison(
        order, tuple(range(first, last + 1)), direct, smoothed, direct_model, smoothed_model, remark
    )


def _fit_arx(
    record: Experiment, measured: Experiment, smoothing: MonteCarloSmoothing, order: int, first: int, last: int
) -> tuple[float | None, PolynomialModel | None, str]:
    """Least squares on ``record``: the mean square error on ``measured``, the model, and what went wrong."""
    y, u = smoothing.output, smoothing.input
    try:
        model = arx(record, na=order, nb=last - first + 1, nk=first, history="zero", output=y, inputs=u)
    except DataError as problem:
        return None, None, str(problem)
    if not model.stable:
        return None, model, f"unstable, a pole of size {abs(model.poles[0]):.4g}"
    run = model.simulate(measured, initial="zero")[y]
    return float(np.mean((measured.outputs[y] - run) ** 2)), model, ""
