"""Many initial states, eliminated, so that the optimiser works on the parameters alone.

Variable projection does it record by record, where they need not meet; condensing all at once, where each ends as the next begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bmat, coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from greybox.base import decompose_symmetric
from greybox.base.numerics import FREE_STATE_CURVATURE, TINY
from greybox.estimation.optim.gauss_newton import run_gauss_newton
from greybox.estimation.optim.minimisation import DEFAULT_POLICY as MINIMISATION
from greybox.estimation.optim.minimisation import Minimisation, Termination, TerminationPolicy
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.transcription.decision_vector import DecisionVector, find_measured_states
from greybox.estimation.transcription.shooting_cost import Evaluation, SingleShooting, add_prior_penalty
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
                # The end of this segment as the start of the next, in its scaled unknowns.
                carried = (x[-1] - v.initial.guess[e + 1])[v.free_states] / scale
                first_states = np.where(hidden, carried, self.states[e + 1])
                self.states[e + 1] = np.clip(first_states, self._low[e + 1], self._high[e + 1])

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives along the constants at ``z`` (n,)."""
        ny = len(self.shooting.weight)
        gradient, hessian = np.zeros(self.size), np.zeros((self.size, self.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        # x0(z + dz) = x0(z) + dx0/dz dz: one or two steps from there are enough.
        predicted = self.states + self._state_slopes @ (z - self._constants)
        predicted = np.clip(np.where(np.isfinite(predicted), predicted, self.states), self._low, self._high)
        last_states, slopes = self.states.copy(), self._state_slopes.copy()
        for e in range(self.variables.experiments):
            model = self._find_initial_state(z, e, predicted[e])
            if model is None:
                self.states = last_states  # a trial step too far: keep what belongs to the last good point
                return Evaluation.failure(self.size, ny, (e, 0))
            constants, sums = self.shooting.views[e].constants, model.sums
            # How the initial state follows the constants; one pushed against its bound stays there.
            n, states, g = len(constants), self.states[e], model.gradient
            is_held = (states <= self._low[e]) & (g > 0) | (states >= self._high[e]) & (g < 0)
            slope = project_states(sums.gauss_newton, n, is_held)
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
        sums = shooting.kernel.sums(shooting.records[e], shooting.at(point, e), shooting.weight, shooting.rows[e])
        cost = float(sums.squares.sum()) if np.isfinite(sums.cost) else np.inf
        return _StateModel(cost, 2 * sums.gradient[n:], 2 * sums.gauss_newton[n:, n:], sums)


@dataclass(frozen=True)
class _StateModel(QuadraticModel):
    """One record along its initial state, with the sums along constants and initial state."""

    sums: GaussNewtonSums


def project_states(matrix: np.ndarray, n: int, is_held: np.ndarray | bool = False) -> np.ndarray:
    """``-C^-1 B'`` (states, n) of a Gauss-Newton matrix ``[[A, B], [B', C]]`` of ``n`` constants and some states.

    Zero for states that are held, and along directions that the residuals do not show.
    """
    # Directions that the residuals do not show, and states that are held, stay: the inverse is zero there.
    b, c = matrix[:n, n:], matrix[n:, n:]
    held = np.broadcast_to(is_held, len(c))
    inverse = decompose_symmetric(np.where(held[:, None] | held, 0.0, c)).without_doubtful().pseudo_inverse
    return -inverse @ b.T


# Condensing: segments that must meet are eliminated from a least-squares problem; the one that is left has the parameters alone.


@dataclass(frozen=True)
class LinearisedSegment:
    """One linearised segment, in scaled states.

    ``residual`` (m,) with ``jacobian`` (m, n + nx) along the constants and its first state; ``ends`` (nx, n + nx) slopes of its last
    state; ``defect`` (nx,) that state minus the first of the next segment (zero after the last one). ``tie``, for states that begin
    as declared: their numbers, how far they are from that, and its slope along the constants (k, n).
    """

    residual: np.ndarray
    jacobian: np.ndarray
    ends: np.ndarray
    defect: np.ndarray
    tie: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class CondensedProblem(QuadraticModel):
    """The model of the cost along the constants, with every segment's first state at its best for them."""

    offset: np.ndarray
    """Step of the first states (segments, nx) where the constants stay."""

    slope: np.ndarray
    """How they follow the constants (segments, nx, n)."""

    segments: Sequence[LinearisedSegment]
    """What was condensed."""

    def step(self, dz: np.ndarray) -> np.ndarray:
        """``dz`` and the step of the first states that belongs to it."""
        return np.concatenate([dz, (self.offset + self.slope @ dz).ravel()])

    def cost_after(self, step: np.ndarray) -> float:
        """Cost of the linearised residuals after a step."""
        dz, states = np.split(step, [self.slope.shape[2]])
        pairs = zip(self.segments, states.reshape(self.offset.shape), strict=True)
        residuals = (s.residual + s.jacobian @ np.concatenate([dz, ds]) for s, ds in pairs)
        return float(sum(r @ r for r in residuals))


def condense(records: Sequence[Sequence[LinearisedSegment]], n: int) -> CondensedProblem | None:
    """Eliminate the first states of the segments from a constrained least-squares problem in the constants (n,) and all of them.

    With ``K = [[H, C'], [C, 0]]`` over the first states and their constraints, ``H = R'R`` block diagonal and the constants on the right:
    a sparse factorisation with pivoting, which is stable whether errors grow or decay along the record. None where there is no step,
    as with slopes of a segment so near to overflow that their squares are beyond it.
    """
    solutions = []
    for segments in records:
        nx = len(segments[0].defect)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix, right = _build_system(segments, n, nx)
        try:
            factors = splu(matrix)
        except RuntimeError:  # SuperLU: "Factor is exactly singular"
            return None
        solution = factors.solve(right)
        if not np.isfinite(solution).all():
            return None
        solutions.append(solution[: len(segments) * nx].reshape(len(segments), nx, n + 1))
    states, flat = np.concatenate(solutions), [s for segments in records for s in segments]
    offset, slope = states[:, :, 0], states[:, :, 1:]
    cost, gradient, hessian = 0.0, np.zeros(n), np.zeros((n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, s in enumerate(flat):
            jz, js = s.jacobian[:, :n], s.jacobian[:, n:]
            # r + R (o + S dz) + P dz, a least-squares problem in dz alone.
            residual, jacobian = s.residual + js @ offset[k], jz + js @ slope[k]
            cost += float(residual @ residual)
            gradient += 2 * jacobian.T @ residual
            hessian += 2 * jacobian.T @ jacobian
    if not (np.isfinite(cost) and np.isfinite(hessian).all()):
        return None
    return CondensedProblem(cost, gradient, hessian, offset, slope, flat)


def _build_system(segments: Sequence[LinearisedSegment], n: int, nx: int) -> tuple[csc_matrix, np.ndarray]:
    """The matrix ``K`` and its right-hand sides (., 1 + n): for the step as it is, and for each constant."""
    count = len(segments)
    states, joints = count * nx, (count - 1) * nx
    size = states + joints + sum(len(s.tie[0]) for s in segments if s.tie)
    right = np.zeros((size, n + 1))
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    entries: list[np.ndarray] = []

    def put(block: np.ndarray, row: int, column: int, mirrored: bool = False) -> None:
        i, j = np.indices(block.shape)
        for a, b, values in ((i + row, j + column, block), *(((j + column, i + row, block),) if mirrored else ())):
            rows.append(a.ravel())
            columns.append(b.ravel())
            entries.append(values.ravel())

    # H = R'R, held back a little along directions that no sample shows: K would be singular there.
    curvatures = [s.jacobian[:, n:].T @ s.jacobian[:, n:] for s in segments]
    regularisation = FREE_STATE_CURVATURE * np.mean([np.diag(c) for c in curvatures], axis=0)
    regularisation = np.diag(
        np.where(
            regularisation > 0, regularisation, FREE_STATE_CURVATURE * max(float(regularisation.max(initial=0.0)), 1.0)
        )
    )
    for k, s in enumerate(segments):
        node, next_node, joint = k * nx, (k + 1) * nx, states + k * nx
        put(curvatures[k] + regularisation, node, node)
        # R'R ds = -R'r - R'P dz: one right-hand side for the step as it is, and one for each constant.
        right[node:next_node, 0] = -s.jacobian[:, n:].T @ s.residual
        right[node:next_node, 1:] = -s.jacobian[:, n:].T @ s.jacobian[:, :n]
        if k + 1 < count:  # it ends where the next one begins
            put(s.ends[:, n:], joint, node, mirrored=True)
            put(-np.eye(nx), joint, next_node, mirrored=True)
            # A_k ds_k - ds_{k+1} = -d_k - B_k dz.
            right[joint : joint + nx, 0] = -s.defect
            right[joint : joint + nx, 1:] = -s.ends[:, :n]
    row = states + joints
    for k, s in enumerate(segments):
        if s.tie:
            which, distance, slope = s.tie
            put(np.eye(nx)[which], row, k * nx, mirrored=True)
            # ds = distance + slope dz: it begins as declared.
            right[row : row + len(which), 0] = distance
            right[row : row + len(which), 1:] = slope
            row += len(which)
    places = np.concatenate(rows), np.concatenate(columns)
    return coo_matrix((np.concatenate(entries), places), (size, size)).tocsc(), right


def compute_state_slopes(
    along: csc_matrix, states: csc_matrix, equations: csc_matrix, constraints: csc_matrix
) -> np.ndarray:
    """How states (ns, n) that satisfy linearised equations follow the constants, at their best for the residuals.

    The least ``|along dz + states dx|^2`` with ``equations dz + constraints dx = 0``: residuals (m, n) and (m, ns), equations (k, n) and
    (k, ns). Directions that no residual shows are held back a little, as in `condense`.
    """
    curvature = (states.T @ states).tocsc()
    diagonal = curvature.diagonal()
    regularisation = FREE_STATE_CURVATURE * max(float(diagonal.mean()) if diagonal.any() else 1.0, TINY)
    matrix = bmat(
        [[curvature + regularisation * diags(np.ones(len(diagonal))), constraints.T], [constraints, None]], format="csc"
    )
    # Stationarity of the Lagrange function, and the equations, along each constant.
    right = -np.vstack([(states.T @ along).toarray(), equations.toarray()])
    return splu(matrix).solve(right)[: len(diagonal)]
