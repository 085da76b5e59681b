"""Variable projection: many initial states, eliminated record by record, so that the optimiser works on the parameters alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base.linear_algebra import decompose_symmetric
from greybox.estimation.optim.gauss_newton import run_gauss_newton
from greybox.estimation.optim.minimisation import DEFAULT_POLICY as MINIMISATION
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, Minimisation, Termination, TerminationPolicy
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.segments import Cuts, SegmentedProblem, find_measured_states
from greybox.estimation.transcription.simulation_error import Evaluation, SingleShooting, add_prior_penalty
from greybox.simulation.kernel.interface import GaussNewtonSums

# Gauss-Newton steps at most; from the state of the last point one or two are enough.
PROJECTION_MAX_STEPS = 12
# Found when a further step would lower chi-square by less than this many residual variances, or the misfit over noise by less than that:
# data without noise end at rounding errors.
PROJECTION_TERMINATION = TerminationPolicy(negligible_decrease=1e-8, perfect_noise_ratio=1e-8)


class ProjectedShooting:
    """`SingleShooting` with each record's initial state at its best for the constants of the moment.

    ``evaluate`` takes and returns the constants alone: the cost ``min over x0 of sum r^2``, its gradient (the initial states do not
    contribute to it: their own gradient vanishes) and the Schur complement ``A - B C^-1 B'`` of the Gauss-Newton matrix (Golub and
    Pereyra 1973; Kaufman 1975). Work and memory grow with the number of records, not with its square. The search for the initial
    states of one point begins where the last one ended, moved along the slope ``dx0/dz = -C^-1 B'``.
    """

    def __init__(self, shooting: SingleShooting) -> None:
        self.shooting = shooting
        v = shooting.variables
        self.size = len(v.which)
        self._low, self._high = (v.split(edge).initial_states for edge in v.bounds())
        self.states = np.clip(np.zeros_like(self._low), self._low, self._high)
        """The estimated initial states (experiments, states) in units of their scale, relative to the guess."""
        self._state_slopes = np.zeros((*self.states.shape, self.size))
        self._constants = np.zeros(self.size)

    @property
    def variables(self) -> DecisionVector:
        """The variables with the initial states still in them; see `full`."""
        return self.shooting.variables

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on the constants (n,)."""
        low, high = self.variables.bounds()
        return low[: self.size], high[: self.size]

    def full(self, z: np.ndarray) -> np.ndarray:
        """The constants ``z`` followed by the initial states that belong to them: a point of `variables`."""
        self.evaluate(z)
        return np.concatenate([z, self.states.ravel()])

    def carry_states(self, starts_record: Sequence[bool] = ()) -> None:
        """Begin each segment where the one before it ended: a first guess for segments that follow each other.

        States that an output shows keep the guess they have. The search for each initial state starts there, in order of time.
        ``starts_record`` says which segments begin a record; there nothing is carried over.
        """
        v, shooting = self.variables, self.shooting
        scale, z = v.initial.scale[v.free_states], np.zeros(self.size)
        measured = find_measured_states(v)
        hidden = np.array([j not in measured for j in v.free_states])
        for e in range(v.experiments):
            self._find_initial_state(z, e, self.states[e])
            if e + 1 == v.experiments:
                return
            if starts_record and starts_record[e + 1]:
                continue
            point = shooting.at(np.concatenate([z, self.states.ravel()]), e)
            _, x = shooting.kernel.simulate(shooting.records[e], point.q, point.p, point.x0)
            if np.isfinite(x[-1]).all():
                carried = (x[-1] - v.initial.guess[e + 1])[v.free_states] / scale
                first_states = np.where(hidden, carried, self.states[e + 1])
                self.states[e + 1] = np.clip(first_states, self._low[e + 1], self._high[e + 1])

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives along the constants at ``z`` (n,)."""
        ny = len(self.shooting.weight)
        gradient, hessian = np.zeros(self.size), np.zeros((self.size, self.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        predicted = self.states + self._state_slopes @ (z - self._constants)
        predicted = np.clip(np.where(np.isfinite(predicted), predicted, self.states), self._low, self._high)
        last_states, slopes = self.states.copy(), self._state_slopes.copy()
        for e in range(self.variables.experiments):
            model = self._find_initial_state(z, e, predicted[e])
            if model is None:
                self.states = last_states  # a trial step too far: keep what belongs to the last good point
                return Evaluation(np.inf, 0 * gradient, 0 * hessian, 0 * squares, 0 * counts, (e, 0))
            constants, sums = self.shooting.views[e].constants, model.sums
            n, slope = len(constants), self._eliminate(model, e)
            # Along the constants the states follow; at their best they have no slope of their own.
            gradient[constants] += 2 * (sums.gradient[:n] + slope.T @ sums.gradient[n:])
            hessian[np.ix_(constants, constants)] += 2 * (sums.gauss_newton[:n, :n] + sums.gauss_newton[:n, n:] @ slope)
            slopes[e][:, constants] = slope
            squares += sums.squares
            counts += sums.counts.astype(int)
        self._constants, self._state_slopes = z.copy(), slopes
        return add_prior_penalty(
            self.variables, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts)
        )

    def _find_initial_state(self, z: np.ndarray, e: int, states: np.ndarray) -> _StateModel | None:
        """The best initial state of one record at ``z``, from ``states`` on; None where nothing can be simulated."""
        measured = int(np.isfinite(self.shooting.records[e].y).sum())
        test = Termination(PROJECTION_TERMINATION, self._low[e], self._high[e], measured).test
        search = Minimisation(lambda s: self._model_states(z, e, s), 1.0, test, None, MINIMISATION)
        if not np.isfinite(search(states).cost):
            search.best_value = None
            if not np.isfinite(search(self.states[e]).cost):
                return None
        if not search.test_termination():
            run_gauss_newton(search, self._low[e], self._high[e], MINIMISATION.damped, steps=PROJECTION_MAX_STEPS)
        self.states[e] = search.best
        assert isinstance(search.best_value, _StateModel)  # what `_model_states` returned
        return search.best_value

    def _model_states(self, z: np.ndarray, e: int, states: np.ndarray) -> _StateModel:
        """The cost of one record along its initial state."""
        v, shooting, n = self.variables, self.shooting, len(self.shooting.views[e].constants)
        point = np.concatenate([z, np.zeros(v.size - self.size)])
        v.split(point).initial_states[e] = states
        sums = shooting.kernel.sums(shooting.records[e], *shooting.at(point, e), shooting.weight, shooting.rows[e])
        cost = float(sums.squares.sum()) if np.isfinite(sums.cost) else np.inf
        return _StateModel(cost, 2 * sums.gradient[n:], 2 * sums.gauss_newton[n:, n:], sums)

    def _eliminate(self, model: _StateModel, e: int) -> np.ndarray:
        """How the initial state follows the constants (states, n); one pushed against its bound stays there."""
        g, states = model.gradient, self.states[e]
        is_held = (states <= self._low[e]) & (g > 0) | (states >= self._high[e]) & (g < 0)
        return project_states(model.sums.gauss_newton, len(self.shooting.views[e].constants), is_held)


@dataclass(frozen=True)
class _StateModel(QuadraticModel):
    """One record along its initial state, with the sums along constants and initial state."""

    sums: GaussNewtonSums


def project_states(matrix: np.ndarray, n: int, is_held: np.ndarray | bool = False) -> np.ndarray:
    """``-C^-1 B'`` (states, n) of a Gauss-Newton matrix ``[[A, B], [B', C]]`` of ``n`` constants and some states.

    Zero for states that are held, and along directions that the residuals do not show.
    """
    b, c = matrix[:n, n:], matrix[n:, n:]
    held = np.broadcast_to(is_held, len(c))
    inverse = decompose_symmetric(np.where(held[:, None] | held, 0.0, c)).without_doubtful().pseudo_inverse
    return -inverse @ b.T


# Where a search over segments or by collocation begins: states along the record, and constants without continuity.


def estimate_segment_states(segmented: SegmentedProblem) -> ProjectedShooting:
    """The cost of the segments with the initial state of each estimated in turn, the constants at their start values.

    A state that is an output is taken as measured to begin with, a hidden one from the end of the segment before; then both are
    estimated from the samples of the segment. A short segment, which a wrong constant cannot spoil much, acts as an observer.
    """
    pieces = segmented.pieces.with_plain_squares()
    projected = ProjectedShooting(pieces.shooting())
    projected.carry_states(segmented.starts_record)
    return projected


# A positive constant stays within a factor ``e^4.6``, a hundred, of its start; no step of a joined search is longer.
MAX_LOG_CHANGE = 4.6
# Steps at most.
RELAXATION_MAX_STEPS = 15
# A step is the last one when it gained less than a hundredth of the cost, or hardly anything is left.
RELAXATION_TERMINATION = TerminationPolicy(negligible_decrease=1e-6, patience=1, little_gain=1e-2)
# Damped quickly, as the start need not be good.
RELAXATION_DAMPED = GaussNewtonPolicy(damping_growth=100.0, max_rejections=5)
# Short segments may leave a constant open, so positive ones are held weakly: a factor ``e^2`` is one standard deviation.
PRIOR_WEIGHT = 0.25


def fit_without_continuity(projected: ProjectedShooting) -> np.ndarray:
    """A point of the variables near the best for segments that need not meet, by damped Gauss-Newton steps from the start.

    A segment cannot lose its place in an oscillation, so this search is spared the wrong optima of a long run; its result is good to
    the noise over one segment.
    """
    v, start = projected.variables, np.zeros(projected.size)
    precision = np.where(v.logarithmic, PRIOR_WEIGHT, 0.0)
    reach = np.where(v.logarithmic, MAX_LOG_CHANGE, np.inf)
    low, high = projected.bounds()

    def evaluate(z: np.ndarray) -> Evaluation:
        e = projected.evaluate(z)
        cost, hessian = e.cost + precision @ z**2, e.hessian + np.diag(2 * precision)
        return replace(e, cost=cost, gradient=e.gradient + 2 * precision * z, hessian=hessian)

    low, high = np.minimum(np.maximum(low, -reach), 0.0), np.maximum(np.minimum(high, reach), 0.0)
    search = Minimisation(evaluate, 1.0, Termination(RELAXATION_TERMINATION, low, high, 1).test, None, MINIMISATION)
    if np.isfinite(search(start).cost) and not search.test_termination():
        run_gauss_newton(search, low, high, RELAXATION_DAMPED, steps=RELAXATION_MAX_STEPS)
    return projected.full(search.best)


def initialise_without_continuity(problem: EstimationProblem, cuts: Cuts) -> tuple[EstimationProblem, list[np.ndarray]]:
    """``problem`` at constants fitted without continuity, and states (N, nx) along each record: a start for `Collocation`."""
    segmented = SegmentedProblem.of(problem, cuts)
    arcs = estimate_segment_states(segmented)
    z = fit_without_continuity(arcs)
    segmented = segmented.at(segmented.pieces.variables.recentre(z))
    return segmented.whole, [x for _, x in segmented.simulate()]
