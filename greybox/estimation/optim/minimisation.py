"""The function being minimised, its best point so far, and when to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from greybox.base.numerics import AT_BOUND, PUSH_OFF_BOUNDS
from greybox.estimation.optim.quadratic_model import QuadraticModel


@dataclass(frozen=True)
class TerminationPolicy:
    """When a minimisation has nothing left to gain that matters.

    The unit of a sum of ``count`` squares is the residual's variance, ``cost / count``; that of minus twice a log-likelihood is one. A
    predicted decrease of ``k^2`` units is a step of ``k`` standard deviations of the unknowns.

    Parameters
    ----------
    negligible_decrease
        Predicted decrease, in that unit, below which a search has converged: the unknowns are within 1 % of their standard
        deviations.
    perfect_noise_ratio
        A predicted decrease of the misfit over noise below this is negligible too: data without noise end at rounding errors.
    patience
        Iterations over which the gain is looked at. A cost with kinks (dry friction) never meets the rules above.
    little_gain
        A search ends as acceptable when it gained less than this within its patience: a share of the cost, or of one for a
        likelihood.
    """

    negligible_decrease: float = 1e-4
    perfect_noise_ratio: float = 1e-7
    patience: int = 12
    little_gain: float = 1e-5

    def negligible(self, cost: float, count: int | None) -> float:
        """Largest decrease of ``cost`` that changes nothing that matters; ``count``: number of squares, None for a likelihood."""
        if count is None:
            return self.negligible_decrease
        # A share of the mean square, and what every square may be off in a record without noise.
        return self.negligible_decrease * cost / max(count, 1) + self.perfect_noise_ratio**2 * count


@dataclass(frozen=True)
class GaussNewtonPolicy:
    """How damped Gauss-Newton steps adapt and when they give up.

    Parameters
    ----------
    initial_damping
        Damping of the first step, as a share of the curvature: nearly a full Gauss-Newton step, which is right near a smooth optimum.
    damping_growth
        Factor on the damping after a step that gained nothing; it doubles with each further one in a row (Nielsen 1999).
    max_steps
        Steps in all; a smooth cost needs ten to twenty from a lost start.
    max_rejections
        Steps in a row that gain nothing: by then the damping has grown by ten decades, and no direction is left to try.
    max_kink_steps
        Steps in a row below ``kink_share`` after which the cost counts as kinked.
    """

    initial_damping: float = 1e-6
    damping_growth: float = 2.0
    max_steps: int = 50
    max_rejections: int = 8
    max_kink_steps: int = 6


@dataclass(frozen=True)
class GradientSamplingPolicy:
    """How gradients are sampled around a point where the cost has a kink.

    Parameters
    ----------
    radii
        Distances of the sampled points, in turn: where a smooth cost would rise by these shares of itself.
    """

    radii: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


@dataclass(frozen=True)
class MinimisationPolicy:
    """When a search by IPOPT counts as stalled, and how it goes on from there.

    Parameters
    ----------
    max_shortenings
        Times that a step is shortened without any gain before the search counts as stalled: IPOPT halves it each time, so a direction
        that gains nothing at a thousandth of its length points the wrong way, or the gradient is that of one side of a kink.
    hand_overs
        Times that IPOPT hands over to damped Gauss-Newton steps because the quadratic model predicted its last iteration well; each
        time it goes on where a step gains little of what was predicted. 0: IPOPT goes on to the end.
    damped
        The damped Gauss-Newton steps that follow IPOPT once it has come close, or has stalled.
    sampling
        The search around a kink, where damped steps gain nothing either.
    """

    max_shortenings: int = 10
    hand_overs: int = 3
    damped: GaussNewtonPolicy = field(default_factory=GaussNewtonPolicy)
    sampling: GradientSamplingPolicy = field(default_factory=GradientSamplingPolicy)


DEFAULT_POLICY = MinimisationPolicy()

DEFAULT_TERMINATION = TerminationPolicy()


# How a minimisation ended, and what is minimised.


class TerminationStatus(StrEnum):
    """How a minimisation ended. Result files contain the values."""

    CONVERGED = "converged"
    """The termination test is met."""

    KINK = "kink"
    """At a kink of the cost, as dry friction has them: no small step in any direction lowers it."""

    ACCEPTABLE = "acceptable"
    """Converged to a looser tolerance: the last digits may move."""

    ITERATION_LIMIT = "iteration_limit"
    """Stopped at the iteration limit."""

    INTERRUPTED = "interrupted"
    """Stopped by the user; the best point so far is kept."""

    STUCK = "stuck"
    """No further progress, and the termination test is not met."""

    NO_START = "no_start"
    """The cost cannot be computed at the start."""

    FAILED = "failed"
    """The solver failed."""

    @property
    def success(self) -> bool:
        """Whether the point can be used as an optimum."""
        return self in (TerminationStatus.CONVERGED, TerminationStatus.KINK, TerminationStatus.ACCEPTABLE)


class SolverName(StrEnum):
    """The solvers that a minimisation may go through, as results name them."""

    IPOPT = "IPOPT"
    GAUSS_NEWTON = "Gauss-Newton"
    GRADIENT_SAMPLING = "gradient sampling"


@dataclass(frozen=True)
class MinimisationResult:
    """The best point of a minimisation, how it ended, and what it took."""

    z: np.ndarray
    """The best point (n,)."""

    cost: float
    """The cost there."""

    status: TerminationStatus
    """How the minimisation ended."""

    iterations: int
    evaluations: int
    seconds: float

    solver_status: str = ""
    """IPOPT's return status in its own words."""

    value: Any = None
    """What the minimised function returned at ``z``; None where it never returned anything finite."""

    solver: str = ""
    """Which solvers ran, in their order: "IPOPT, then Gauss-Newton"; empty where the start was the end."""


IterationCallback = Callable[[int, float], bool | None]
"""``(iteration, cost)``, called after every iteration; one that returns True ends the search there, as Ctrl-C does."""

TerminationTest = Callable[[np.ndarray, Any], TerminationStatus | None]
"""``(z, value)`` of the best point so far, ``value`` being what the minimised function returned there; a status ends the search."""

# IPOPT's return status in its own words.
IPOPT_STATUS = {
    "Solve_Succeeded": TerminationStatus.CONVERGED,
    "Solved_To_Acceptable_Level": TerminationStatus.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": TerminationStatus.ITERATION_LIMIT,
    "User_Requested_Stop": TerminationStatus.INTERRUPTED,
    "Search_Direction_Becomes_Too_Small": TerminationStatus.STUCK,
    "Restoration_Failed": TerminationStatus.STUCK,
    "Feasible_Point_Found": TerminationStatus.STUCK,
}


# When a minimisation has nothing left to gain that matters: a rule in units of the residual's variance, not of a gradient norm.


@dataclass(frozen=True)
class Termination:
    """The end of one minimisation within bounds: `test` is asked about the best point so far after every iteration.

    It is converged where the quadratic model predicts a negligible decrease along its step within bounds, and acceptable where the last
    iterations gained next to nothing. It remembers the costs it was asked about, so each minimisation needs one of its own.
    """

    policy: TerminationPolicy = DEFAULT_TERMINATION
    """What is negligible, and how long nothing may be gained."""

    low: np.ndarray | float = -np.inf
    """Lower bounds (n,)."""

    high: np.ndarray | float = np.inf
    """Upper bounds (n,)."""

    count: int | None = None
    """Number of residuals whose squares the cost sums up; None: the cost is minus twice the logarithm of a likelihood."""

    costs: list[float] = field(default_factory=list)
    """The cost after each iteration that did not end the search."""

    def test(self, z: np.ndarray, value: QuadraticModel) -> TerminationStatus | None:
        """How the search ends at ``z`` (n,), where the minimised function is ``value``; None where it goes on."""
        # Within bounds: a constant pressed against its bound has a slope for ever, and gains nothing by it.
        if self.is_negligible(value.predicted_decrease(*measure_room(z, self.low, self.high)), value.cost):
            return TerminationStatus.CONVERGED
        return TerminationStatus.ACCEPTABLE if self.is_flat(value.cost) else None

    def is_negligible(self, decrease: float, cost: float, slack: float = 1.0) -> bool:
        """Whether a predicted ``decrease`` of ``cost`` changes nothing that matters; ``slack`` is a factor on what is allowed."""
        return decrease <= slack * self.policy.negligible(cost, self.count)

    def is_flat(self, cost: float) -> bool:
        """Whether the last iterations gained next to nothing, ``cost`` being that of the newest."""
        self.costs.append(cost)
        # A share of the cost for a sum of squares; a likelihood may be any number, zero included, and counts in
        # units of one.
        patience, whole = self.policy.patience, 1.0 if self.count is None else cost
        return len(self.costs) > patience and self.costs[-1 - patience] - cost <= self.policy.little_gain * whole


def measure_room(z: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Distances of ``z`` to its bounds (n,); none to one that it nearly lies on.

    An interior-point search stays a little off a bound that it is pressed against.
    """
    below, above = low - z, high - z
    # Nearly on it counts as on it: otherwise a decrease would be promised that the bound forbids.
    return np.where(below >= -AT_BOUND, 0.0, below), np.where(above <= AT_BOUND, 0.0, above)


# Share of the predicted decrease from which a step counts as well predicted (Fletcher's upper ratio).
GOOD_SHARE = 0.75
# Predicted decrease, as a share of the cost, up to which damped Gauss-Newton steps are tried before IPOPT: the start is near.
NEAR_SHARE = 0.5


class Minimisation:
    """The function being minimised, with its last value kept (IPOPT asks for cost, gradient and Hessian one by one).

    ``best``, ``best_value`` and ``best_cost`` are those of the best point so far; ``status`` is how the search ended, None while it
    runs; ``shortenings`` counts the evaluations since the last gain; ``error`` is what ``evaluate`` raised. ``steps`` and ``solvers``
    are the iterations so far and what made them; ``ipopt_word`` is IPOPT's return status in its own words.
    ``starts_at_best``: a solver that pushes its start a hair off the bounds is told the value of the best point there.
    """

    def __init__(
        self,
        evaluate: Callable[[np.ndarray], QuadraticModel],
        scale: float,
        termination_test: TerminationTest | None,
        progress: IterationCallback | None,
        policy: MinimisationPolicy,
        cost: Callable[[np.ndarray], float] | None = None,
    ) -> None:
        self.cost = cost
        self.evaluate, self.scale, self.progress, self.policy = evaluate, scale, progress, policy
        self.termination_test = termination_test
        self.evaluations = self.iteration = self.shortenings = self.steps = 0
        self.solvers: list[SolverName] = []
        self.ipopt_word = ""
        self.forget_prediction()
        self.stop = self.starts_at_best = False
        self.error: BaseException | None = None
        self.status: TerminationStatus | None = None
        self.best = np.empty(0)
        self.best_value: QuadraticModel | None = None
        self.best_cost = np.inf
        self._last: tuple[bytes, Any] = (b"", None)

    def __call__(self, z: np.ndarray) -> QuadraticModel:
        """The function at ``z``; what it gave last, or at the best point, if that is asked again."""
        if self.best_value is not None and self._is_best(z):
            self._last = z.tobytes(), self.best_value
        if self._last[0] != z.tobytes() or self._last[1] is None:
            if self.stalled:  # IPOPT cannot be told to stop between two iterations
                return QuadraticModel(np.inf, np.zeros_like(z), np.eye(len(z)))
            self.evaluations += 1
            self.remember(z, self.evaluate(z))
        return self._last[1]

    def _is_best(self, z: np.ndarray) -> bool:
        """Whether ``z`` is the best point, or that pushed a hair off its bounds where a solver starts from it."""
        if self.starts_at_best:
            return bool(np.all(np.abs(z - self.best) <= 2 * PUSH_OFF_BOUNDS * np.maximum(np.abs(self.best), 1.0)))
        return np.array_equal(z, self.best)

    def compare(self, z: np.ndarray) -> None:
        """Make ``z`` the best point if its cost is lower; the derivatives of the others are not computed where the cost is cheaper."""
        if self.cost is None or self.cost(z) < self.best_cost:
            self(z)

    @property
    def stalled(self) -> bool:
        """Whether the present step has been shortened again and again without any gain."""
        return self.shortenings > self.policy.max_shortenings

    def remember(self, z: np.ndarray, value: QuadraticModel) -> None:
        """Remember the value at ``z``, which becomes the best point if its cost is lower."""
        self._last = z.tobytes(), value
        # An impossible point says nothing of the direction.
        self.shortenings += np.isfinite(value.cost)
        if self.best_value is None or value.cost < self.best_cost:
            self.best, self.best_value, self.best_cost, self.shortenings = z.copy(), value, value.cost, 0

    def test_termination(self) -> bool:
        """Whether the caller's test says that the best point so far ends the search."""
        if self.termination_test and self.best_value is not None:
            self.status = self.termination_test(self.best, self.best_value)
        return self.status is not None

    def record_solver(self, name: SolverName) -> None:
        """Note that ``name`` goes on with the search."""
        if self.solvers[-1:] != [name]:
            self.solvers.append(name)

    def predict_decrease(self, low: np.ndarray, high: np.ndarray) -> float:
        """By how much the quadratic model at the best point falls within the bounds."""
        assert self.best_value is not None  # a search keeps its start
        return self.best_value.predicted_decrease(*measure_room(self.best, low, high))

    def is_near(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether the quadratic model sees the minimum close by."""
        return self.predict_decrease(low, high) <= NEAR_SHARE * abs(self.best_cost)

    def forget_prediction(self) -> None:
        """Begin to compare anew: a solver starts at the best point."""
        self.predicts_well, self._predicted = False, (-np.inf, np.inf)

    def compare_with_prediction(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether the last iteration gained what the quadratic model predicted before it (``predicts_well`` keeps the answer)."""
        before, predicted = self._predicted
        self._predicted = self.best_cost, self.predict_decrease(low, high)
        # Compared at the best points, not at trials: IPOPT may have shortened its step in between.
        self.predicts_well = before - self.best_cost >= GOOD_SHARE * predicted
        return self.predicts_well

    def report_progress(self) -> None:
        """Tell how far the search is; whoever is told may ask it to stop."""
        if self.progress and self.progress(self.iteration, self.best_cost):
            self.stop = True

    def finish_iteration(self) -> bool:
        """Report the progress after an iteration; whether to stop."""
        self.starts_at_best = False
        self.report_progress()
        self.iteration += 1
        return self.stop or self.stalled or self.error is not None or self.test_termination()
