"""Single shooting: the model runs freely over each record, from parameters and initial states alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.integrators import Step
from greybox.kernel import Kernel, Record
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.experiment_view import ExperimentView


@dataclass(frozen=True)
class Evaluation:
    """Cost ``sum of squared weighted residuals`` at one point, its gradient (n,) and Gauss-Newton matrix (n, n), ``2 J'J``.

    ``count`` residuals went into it; ``squares`` and ``counts`` (ny,) are the same by output. Priors of constants count in the cost and
    its derivatives, not in ``squares``. Where the simulation overflowed the cost is infinite and ``failed`` says in which experiment
    and at which sample.
    """

    cost: float
    gradient: np.ndarray
    hessian: np.ndarray
    squares: np.ndarray
    counts: np.ndarray
    failed: tuple[int, int] | None = None

    @property
    def count(self) -> int:
        """Number of residuals."""
        return int(self.counts.sum())


class SingleShooting:
    """Cost of the free-run simulation error over one or more records.

    ``weight`` (ny,) is one over the noise standard deviation of each output; ``share`` of every record is used (the beginning).
    """

    def __init__(
        self,
        variables: DecisionVector,
        step: Step,
        kernel: Kernel,
        records: Sequence[Record],
        weight: np.ndarray,
        share: float = 1.0,
    ):
        self.variables = variables
        self.step = step
        self.kernel = kernel
        self.records = tuple(_seen(r, step) for r in records)
        self.weight = weight
        self.rows = [max(2, round(share * len(r.u))) for r in records]
        self._last: tuple[tuple[bytes, bytes, bytes], tuple[np.ndarray, np.ndarray]] | None = None

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives at ``z``."""
        v = self.variables
        ny = len(self.weight)
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        free = v.constants(z)
        for e, (record, lanes) in enumerate(zip(self.records, self._lanes, strict=True)):
            p, dp, x0, dx0 = lanes.at(z, free)
            q, dq = self._coefficients(record, p, dp)
            sums = self.kernel.sums(record, q, dq, p, dp, x0, dx0, self.weight, self.rows[e])
            if not np.isfinite(sums.cost):
                return Evaluation(np.inf, gradient, hessian, squares, counts, (e, sums.failed_at or 0))
            gradient[lanes.columns] += 2 * sums.gradient
            hessian[lanes.square] += 2 * sums.gauss_newton
            squares += sums.squares
            counts += sums.counts.astype(int)
        return add_prior_penalty(v, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts))

    def residuals(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record the weighted residuals (N, ny), measured minus model, and their Jacobian (N, ny, L) along `columns`.

        N samples: rows between them, of a band-limited input, have none.
        """
        found = []
        for e, record in enumerate(self.records):
            q, dq, p, dp, x0, dx0 = self._arguments(z, self.variables.parameters(z, e), e)
            r, jacobian = self.kernel.residuals(record, q, dq, p, dp, x0, dx0, self.weight)
            found.append((record.samples(r), record.samples(jacobian)))
        return found

    def simulate(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record outputs (N, ny) and states (N, nx) of the model."""
        runs = []
        for e, record in enumerate(self.records):
            p = self.variables.parameters(z, e)
            q, _, _, x0, _ = self.at(z, p, e)
            runs.append(self.kernel.simulate(record, q, p, x0))
        return runs

    def at(
        self, z: np.ndarray, p: np.ndarray, e: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the kernel needs for experiment ``e``: coefficients and slopes, parameter slopes, initial state and slopes."""
        v = self.variables
        x0, dx0 = v.compute_initial_state(z, p, e)
        dp = np.zeros((len(p), dx0.shape[1]))
        dp[v.which, np.arange(len(v.which))] = v.slopes(p, e)
        q, dq = self._coefficients(self.records[e], p, dp)
        return q, dq, dp, x0, dx0

    def _arguments(self, z: np.ndarray, p: np.ndarray, e: int) -> tuple:
        q, dq, dp, x0, dx0 = self.at(z, p, e)
        return q, dq, p, dp, x0, dx0

    @cached_property
    def _lanes(self) -> list[ExperimentView]:
        return [ExperimentView(self.variables, e) for e in range(len(self.records))]

    def _coefficients(self, record: Record, p: np.ndarray, dp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The step's coefficients; records with the same intervals (the arcs of one record) share one matrix exponential."""
        key = p.tobytes(), dp.tobytes(), record.lengths.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.kernel.coefficients(record, p, dp)
        return self._last[1]


def add_prior_penalty(variables: DecisionVector, z: np.ndarray, evaluation: Evaluation) -> Evaluation:
    """``evaluation``, whose first entries are the constants, with what their priors add (`DecisionVector.penalty`)."""
    if not variables.held.any() or not np.isfinite(evaluation.cost):
        return evaluation
    n = len(variables.which)
    cost, slope, curvature = variables.penalty(z)
    gradient, hessian = evaluation.gradient.copy(), evaluation.hessian.copy()
    gradient[:n] += slope
    hessian[np.arange(n), np.arange(n)] += curvature
    return replace(evaluation, cost=evaluation.cost + cost, gradient=gradient, hessian=hessian)


def _seen(record: Record, step: Step) -> Record:
    """The record as the step reads it; a piece of such a record has the past of a delayed input with it already."""
    wide = step.past is not None and record.u.shape[1] == step.advance.size1_in(1)
    return record if wide else record.read_by(step)
