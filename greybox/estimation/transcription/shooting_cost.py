"""The simulation error: the model runs freely over each record, from parameters and initial states alone.

Three costs of it: squares in units of white noise, squares of the error whitened by the noise's own colour, and a
robust loss that outliers cannot pull.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from greybox.base import AT_BOUND, NUMBERS_AT_A_TIME, ROWS_AT_A_TIME
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.options import RobustLoss
from greybox.estimation.transcription.decision_vector import DecisionVector, ExperimentView
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import Kernel, KernelPoint
from greybox.simulation.kernel.record import Record


@dataclass(frozen=True)
class Evaluation(QuadraticModel):
    """The cost at one point with its derivatives: the sum of the squared weighted residuals, and its Gauss-Newton matrix ``2 J'J``.

    The cost is infinite where the simulation overflowed. Priors of constants count in the cost and its derivatives, not in ``squares``.
    """

    squares: np.ndarray
    """The squared residuals of each output (ny,)."""

    counts: np.ndarray
    """How many residuals of each output there are (ny,)."""

    failed: tuple[int, int] | None = None
    """In which experiment and at which sample the simulation overflowed."""

    @classmethod
    def failure(cls, size: int, outputs: int, at: tuple[int, int]) -> Evaluation:
        """The evaluation of a point that cannot be simulated."""
        return cls(np.inf, np.zeros(size), np.zeros((size, size)), np.zeros(outputs), np.zeros(outputs, int), at)

    @property
    def count(self) -> int:
        """Number of residuals."""
        return int(self.counts.sum())

    @property
    def noise_ratio(self) -> float:
        """Misfit over noise: the root of chi-square over its residuals."""
        return float(np.sqrt(self.cost / max(self.count, 1)))


@dataclass(eq=False, repr=False)
class SingleShooting:
    """Cost of the free-run simulation error over one or more records.

    Parameters
    ----------
    variables
        The decision vector: free constants and initial states.
    step, kernel
        The discrete step, and what runs it over a record.
    records
        The measured records.
    weight
        One over the noise standard deviation of each output (ny,).
    share
        Share of every record that is used, from its beginning.
    """

    variables: DecisionVector
    step: Step
    kernel: Kernel
    records: Sequence[Record]
    weight: np.ndarray
    share: float = 1.0

    def __post_init__(self) -> None:
        step, records = self.step, self.records
        # A piece of a record that the step has read carries the past of a delayed input already.
        has_history = [step.past is not None and r.u.shape[1] == step.advance.size1_in(1) for r in records]
        self.records = tuple(r if has else r.read_by(step) for r, has in zip(records, has_history, strict=True))
        self.rows = [max(2, round(self.share * len(r.u))) for r in records]
        self._last_coefficients: tuple[tuple[bytes, bytes, bytes], tuple[np.ndarray, np.ndarray]] | None = None

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives at ``z``."""
        v = self.variables
        ny = len(self.weight)
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        free = v.constants(z)
        for e, (record, view) in enumerate(zip(self.records, self.views, strict=True)):
            sums = self.kernel.sums(record, self.at(z, e, free), self.weight, self.rows[e])
            if not np.isfinite(sums.cost):
                return Evaluation.failure(v.size, ny, (e, sums.failed_at or 0))
            # cost = sum r^2: its gradient is 2 J'r, and 2 J'J the Gauss-Newton matrix.
            gradient[view.columns] += 2 * sums.gradient
            hessian[view.square] += 2 * sums.gauss_newton
            squares += sums.squares
            counts += sums.counts.astype(int)
        return add_prior_penalty(v, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts))

    def residuals(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record the residuals (N, ny) whose squares are the cost, and their Jacobian (N, ny, L) along `DecisionVector.columns`.

        N samples: rows between them, of a band-limited input, have none.
        """
        return self.reweigh(self.compute_weighted_errors(z))

    def linearise(
        self, z: np.ndarray
    ) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[tuple[np.ndarray, np.ndarray]]]:
        """The outputs (N, ny) of the model with its first states (1, nx), and `residuals`, from one pass where nothing is missing."""
        errors = self.compute_weighted_errors(z)
        runs = []
        for e, record in enumerate(self.records):
            if record.rows_per_sample != 1 or not np.isfinite(record.y).all():
                runs.append(self._simulate(z, e))
                continue
            x0, _ = self.variables.compute_initial_state(z, self.variables.parameters(z, e), e)
            # yhat = y - s r. No name is left for the errors of a record: reweighing gives their memory back.
            runs.append((record.y - errors[e][0] / self.weight, x0[None]))
        return runs, self.reweigh(errors)

    def reweigh(self, errors: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Residuals and Jacobian of weighted errors and theirs."""
        return errors

    def compute_weighted_errors(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record measured minus model over the noise (N, ny), and its Jacobian (N, ny, L)."""
        result = []
        for e, record in enumerate(self.records):
            r, slopes = self.kernel.residuals(record, self.at(z, e), self.weight)
            result.append((record.samples(r), self.views[e].spread(record.samples(slopes))))
        return result

    def simulate(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each record outputs (N, ny) and states (N, nx) of the model."""
        return [self._simulate(z, e) for e in range(len(self.records))]

    def _simulate(self, z: np.ndarray, e: int) -> tuple[np.ndarray, np.ndarray]:
        point = self.at(z, e)
        return self.kernel.simulate(self.records[e], point.q, point.p, point.x0)

    def at(self, z: np.ndarray, e: int, free: np.ndarray | None = None) -> KernelPoint:
        """Where the kernel runs record ``e`` at ``z``, with slopes along `ExperimentView.columns`.

        ``free``: `DecisionVector.constants` there, if known already.
        """
        p, dp, x0, dx0 = self.views[e].at(z, self.variables.constants(z) if free is None else free)
        # Records with the same intervals (the arcs of one record) share one matrix exponential.
        key = p.tobytes(), dp.tobytes(), self.records[e].lengths.tobytes()
        if self._last_coefficients is None or self._last_coefficients[0] != key:
            self._last_coefficients = key, self.kernel.coefficients(self.records[e], p, dp)
        return KernelPoint(*self._last_coefficients[1], p, dp, x0, dx0)

    @cached_property
    def views(self) -> list[ExperimentView]:
        """Which entries of ``z`` concern each record."""
        return [ExperimentView(self.variables, e) for e in range(len(self.records))]


@dataclass(eq=False, repr=False, kw_only=True)
class WhitenedShooting(SingleShooting):
    """Cost of the free-run error in units of its own innovations: minus twice the log-likelihood of autoregressive noise.

    With a robust ``loss`` it is ``sum rho(r)`` of the whitened error ``r``, and the Hessian weighs each residual as the loss does,
    ``2 J' W J`` with ``W = psi(r) / r`` (iteratively reweighted least squares): never indefinite, and never too small where ``rho`` bends
    down. ``colour`` (ny,) holds the autoregression of each output's noise, and each record how large it is row by row. The filter begins
    anew after gaps, with the exact weights of the first samples (`AutoRegression.whiten`). Samples count as evenly spaced. A pass keeps
    the whole Jacobian (N, ny, L) of a record in memory, where white noise needs only sums.
    """

    colour: Sequence[AutoRegression]
    loss: RobustLoss | None = None

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives at ``z``."""
        v, ny = self.variables, len(self.weight)
        gradient, hessian = np.zeros(v.size), np.zeros((v.size, v.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        with np.errstate(all="ignore"):  # what is not finite is found and reported
            for e, (r, jacobian) in enumerate(self.whiten(self.compute_weighted_errors(z))):
                every_measured = np.isfinite(self.records[e].samples(self.records[e].y[: self.rows[e]]))
                columns = v.columns(e)
                for first in range(
                    0, len(every_measured), ROWS_AT_A_TIME
                ):  # a long record is in memory a few times only
                    is_measured = every_measured[first : first + ROWS_AT_A_TIME]
                    block = slice(first, first + len(is_measured))
                    is_lost = is_measured & ~(np.isfinite(r[block]) & np.isfinite(jacobian[block]).all(axis=2))
                    if is_lost.any():
                        failed_at = first + int(np.flatnonzero(is_lost.any(axis=1))[0])
                        return Evaluation.failure(v.size, ny, (e, failed_at))
                    residual = np.where(is_measured, r[block], 0.0)
                    # Least squares: rho = r^2, psi = rho' / 2 = r, W = 1.
                    cost, psi, weight = residual**2, residual, np.ones_like(residual)
                    if self.loss is not None:
                        cost, psi, weight, _ = self.loss.terms(residual)
                    rows = jacobian[block][is_measured]
                    # Of sum rho(r): 2 J'psi and 2 J'W J.
                    gradient[columns] += 2 * rows.T @ psi[is_measured]
                    hessian[np.ix_(columns, columns)] += 2 * rows.T @ (weight[is_measured][:, None] * rows)
                    squares += np.where(is_measured, cost, 0.0).sum(axis=0)
                    counts += is_measured.sum(axis=0)
        if not np.isfinite(squares.sum()):
            return Evaluation.failure(v.size, ny, (0, 0))
        return add_prior_penalty(v, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts))

    def reweigh(self, errors: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Whitened residuals (N, ny) and Jacobian (N, ny, L); with a loss, of the least-squares problem that the optimum also solves.

        With ``m`` the mean curvature of the loss for each output they are ``psi(r) / sqrt(m)`` and ``sqrt(m) J``: gradient and
        curvature are those of the robust cost, and the spread of the residual is what outliers leave of it, so that every
        statement about least squares (covariance, bootstrap, tests) holds for the robust fit (Huber 1981, chapter 7).
        """
        raw = self.whiten(errors)
        if self.loss is None:
            return raw
        m = np.sqrt(self.loss.mean_curvature(np.concatenate([r for r, _ in raw])))
        return [(self.loss.terms(r)[1] / m, m[:, None] * jacobian) for r, jacobian in raw]

    def whiten(self, errors: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Errors (N, ny) and their Jacobian (N, ny, L) in units of their innovations; ``errors`` is emptied on the way."""
        for (r, jacobian), record in zip(errors, self.records, strict=True):
            record.scale_errors(r, jacobian, self.weight)
        if not any(colour.order for colour in self.colour):
            return errors
        result = []
        while errors:  # each is gone when the next is whitened: a long record is in memory a few times only
            r, jacobian = errors.pop(0)
            if 2 * len(r) > NUMBERS_AT_A_TIME:  # in their places, for there is no room for both side by side
                for j, colour in enumerate(self.colour):
                    colour.whiten(r[:, j], overwrite_input=True)
                    colour.whiten(jacobian[:, j], overwrite_input=True)
                result.append((r, jacobian))
                del r, jacobian
                continue
            both = np.concatenate([r[:, :, None], jacobian], axis=2)
            del r, jacobian
            for j, colour in enumerate(self.colour):
                colour.whiten(both[:, j], overwrite_input=True)
            result.append((both[:, :, 0], both[:, :, 1:]))
        return result


# Share of the promised decrease that a step must gain for slopes to follow by the secant update (Fletcher's lower ratio).
SECANT_SHARE = 0.25

Errors = list[tuple[np.ndarray, np.ndarray]]
"""For each record weighted errors (N, ny) and their Jacobian (N, ny, L)."""


class PlantShooting(WhitenedShooting):
    """Cost of the runs of a plant that has no equations (`greybox.simulation.plant`): only the part of a record that counts is run.

    A run that fails has an infinite cost. With ``follows_secants`` slopes follow from point to point by Broyden's update (Math. Comp. 19,
    1965), as long as steps gain what they promise: a slope by differences costs a run for each unknown.
    """

    def __post_init__(self) -> None:
        self.records = [r.first(max(2, round(self.share * len(r.u)))) for r in self.records]
        self.share = 1.0
        super().__post_init__()
        self.follows_secants = False
        self._last: tuple[np.ndarray, Errors] | None = None

    def cost(self, z: np.ndarray) -> float:
        """The cost alone, without any slope; infinite where a run fails."""
        errors = self._compute_errors(z)
        if any(np.isnan(r[np.isfinite(k.y)]).any() for r, k in zip(errors, self.records, strict=True)):
            return np.inf
        whitened = [r for r, _ in self.whiten([(r, np.zeros((*r.shape, 0))) for r in errors])]
        costs = [r**2 if self.loss is None else self.loss.terms(r)[0] for r in whitened]
        return float(sum(np.nansum(each) for each in costs)) + self.variables.penalty(z)[0]

    def compute_weighted_errors(self, z: np.ndarray) -> Errors:
        """For each record measured minus run over the noise (N, ny), and its Jacobian (N, ny, L)."""
        if not self.follows_secants:
            return super().compute_weighted_errors(z)
        if self._last is None or not np.array_equal(self._last[0], z):
            self._last = z.copy(), self._follow(z) or super().compute_weighted_errors(z)
        # Copies: whitening takes them as its own.
        return [(r.copy(), slopes.copy()) for r, slopes in self._last[1]]

    def _follow(self, z: np.ndarray) -> Errors | None:
        """The slopes before, changed as little as explains the step; None where there are none, or the step fell short of its promise."""
        if self._last is None:
            return None
        before, errors = self._last
        step, rows = z - before, self._compute_errors(z)
        moves = [step[self.variables.columns(e)] for e in range(len(rows))]
        # r(z0) + J d: what the slopes before promised.
        expected = [r + slopes @ move for (r, slopes), move in zip(errors, moves, strict=True)]
        was, is_now, promised = (
            sum(float(np.nansum(r**2)) for r in group) for group in ([r for r, _ in errors], rows, expected)
        )
        # A step that fell short shows that the slopes are wrong beyond what one secant can mend.
        if was - is_now < SECANT_SHARE * (was - promised):
            return None
        # Broyden: J+ = J + (r - e) d' / d'd, the least change that explains the step.
        return [
            (r, slopes + np.where(np.isfinite(r - e), r - e, 0.0)[:, :, None] * move / (step @ step))
            for r, (_, slopes), e, move in zip(rows, errors, expected, moves, strict=True)
        ]

    def forget_slopes(self) -> None:
        """Take the next slopes by differences."""
        self._last = None

    def _compute_errors(self, z: np.ndarray) -> list[np.ndarray]:
        """Measured minus run over the noise (N, ny) of each record, from runs alone."""
        runs = self.simulate(z)
        return [(record.y - y) * self.weight for record, (y, _) in zip(self.records, runs, strict=True)]


def add_prior_penalty(variables: DecisionVector, z: np.ndarray, evaluation: Evaluation) -> Evaluation:
    """``evaluation``, whose first entries are the constants, with what their priors add (`DecisionVector.penalty`)."""
    if not variables.has_prior.any() or not np.isfinite(evaluation.cost):
        return evaluation
    n = len(variables.which)
    cost, slope, curvature = variables.penalty(z)
    gradient, hessian = evaluation.gradient.copy(), evaluation.hessian.copy()
    gradient[:n] += slope
    hessian[np.arange(n), np.arange(n)] += curvature
    return replace(evaluation, cost=evaluation.cost + cost, gradient=gradient, hessian=hessian)


def compute_gauss_newton_step(variables: DecisionVector, evaluation: Evaluation) -> np.ndarray:
    """The undamped step (size,) in ``z``; undetermined directions and what lies on its bound stay."""
    low, high = variables.bounds()
    # What lies on its bound is held there, on either side of it.
    reach = np.where((np.abs(low) <= AT_BOUND) | (np.abs(high) <= AT_BOUND), 0.0, np.inf)
    return evaluation.bounded_step(-reach, reach)
