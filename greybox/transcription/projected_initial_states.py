"""Variable projection: many initial states, eliminated record by record, so that the optimiser works on the parameters alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.linear_algebra import decompose_symmetric
from greybox.transcription.arcs import find_measured_states
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.policy import DEFAULT_POLICY, ProjectionPolicy
from greybox.transcription.simulation_error import Evaluation, SingleShooting, add_prior_penalty


class ProjectedShooting:
    """`SingleShooting` with each record's initial state at its best for the constants of the moment.

    ``evaluate`` takes and returns the constants alone: the cost ``min over x0 of sum r^2``, its gradient (the initial states do not
    contribute to it: their own gradient vanishes) and the Schur complement ``A - B C^-1 B'`` of the Gauss-Newton matrix (Golub and
    Pereyra 1973; Kaufman 1975). Work and memory grow with the number of records, not with its square. The search for the initial
    states of one point begins where the last one ended, moved along the slope ``dx0/dz = -C^-1 B'``.
    """

    def __init__(self, shooting: SingleShooting, policy: ProjectionPolicy = DEFAULT_POLICY.projection) -> None:
        self.shooting, self.policy = shooting, policy
        v = shooting.variables
        self.size = len(v.which)
        low, high = v.bounds()
        self._low = low[self.size :].reshape(v.experiments, -1)
        self._high = high[self.size :].reshape(v.experiments, -1)
        self._states = np.clip(np.zeros_like(self._low), self._low, self._high)
        self._state_slopes = np.zeros((*self._states.shape, self.size))
        self._constants = np.zeros(self.size)

    @property
    def variables(self) -> DecisionVector:
        """The variables with the initial states still in them; see `full`."""
        return self.shooting.variables

    @property
    def own(self) -> np.ndarray:
        """The estimated initial states (experiments, states each) in units of their scale, relative to the guess."""
        return self._states

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on the constants (n,)."""
        low, high = self.variables.bounds()
        return low[: self.size], high[: self.size]

    def full(self, z: np.ndarray) -> np.ndarray:
        """The constants ``z`` (n,) followed by the initial states that belong to them: a point of `variables`."""
        self.evaluate(z)
        return np.concatenate([z, self._states.ravel()])

    def carry_states(self, starts_record: Sequence[bool] = ()) -> None:
        """Begin each arc where the one before it ended: a first guess for arcs that follow each other.

        States that an output shows keep the guess they have. The search for each initial state starts there, in order of time.
        ``starts_record`` says which arcs begin a record; there nothing is carried over.
        """
        v, shooting = self.variables, self.shooting
        scale, z = v.initial.scale[v.free_states], np.zeros(self.size)
        measured = find_measured_states(v)
        hidden = np.array([j not in measured for j in v.free_states])
        for e in range(v.experiments):
            self._find_initial_state(z, e, self._states[e])
            if e + 1 == v.experiments:
                return
            if starts_record and starts_record[e + 1]:
                continue
            point = np.concatenate([z, self._states.ravel()])
            p = v.parameters(point, e)
            q, _, _, x0, _ = shooting.at(point, p, e)
            _, x = shooting.kernel.simulate(shooting.records[e], q, p, x0)
            if np.isfinite(x[-1]).all():
                carried = (x[-1] - v.initial.guess[e + 1])[v.free_states] / scale
                first_states = np.where(hidden, carried, self._states[e + 1])
                self._states[e + 1] = np.clip(first_states, self._low[e + 1], self._high[e + 1])

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives along the constants at ``z`` (n,)."""
        ny = len(self.shooting.weight)
        gradient, hessian = np.zeros(self.size), np.zeros((self.size, self.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        predicted = self._states + self._state_slopes @ (z - self._constants)
        predicted = np.clip(np.where(np.isfinite(predicted), predicted, self._states), self._low, self._high)
        last_states, slopes = self._states.copy(), self._state_slopes.copy()
        for e in range(self.variables.experiments):
            record = self._find_initial_state(z, e, predicted[e])
            if record is None:
                self._states = last_states  # a trial step too far: keep what belongs to the last good point
                return Evaluation(np.inf, 0 * gradient, 0 * hessian, 0 * squares, 0 * counts, (e, 0))
            gradient += 2 * record.gradient
            hessian += 2 * record.hessian
            squares += record.squares
            counts += record.counts
            slopes[e] = record.slope
        self._constants, self._state_slopes = z.copy(), slopes
        return add_prior_penalty(
            self.variables, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts)
        )

    def _find_initial_state(self, z: np.ndarray, e: int, states: np.ndarray) -> _ProjectedRecord | None:
        """The best initial state of one record at ``z``, by damped Gauss-Newton steps; None where nothing can be simulated."""
        best = self._project_record(z, e, states)
        if best is None:
            states = self._states[e]
            best = self._project_record(z, e, states)
        if best is None:
            return None
        for _ in range(self.policy.max_steps):
            count = max(int(best.counts.sum()), 1)
            negligible = self.policy.negligible_decrease * best.cost / count + self.policy.negligible_ratio**2 * count
            if best.decrease <= negligible:
                break
            step = self._search_line(z, e, states, best)
            if step is None:
                break
            states, best = step
        self._states[e] = states
        return best

    def _search_line(
        self, z: np.ndarray, e: int, states: np.ndarray, record: _ProjectedRecord
    ) -> tuple[np.ndarray, _ProjectedRecord] | None:
        """The first of ever shorter steps that lowers the cost."""
        for length in self.policy.step_lengths:
            trial_states = np.clip(states + length * record.step, self._low[e], self._high[e])
            trial = self._project_record(z, e, trial_states)
            if trial is not None and trial.cost < record.cost:
                return trial_states, trial
        return None

    def _project_record(self, z: np.ndarray, e: int, states: np.ndarray) -> _ProjectedRecord | None:
        v, shooting, n = self.variables, self.shooting, self.size
        z_with_states = np.concatenate([z, np.zeros(v.size - n)])
        z_with_states[v.columns(e)[n:]] = states
        p = v.parameters(z_with_states, e)
        q, dq, dp, x0, dx0 = shooting.at(z_with_states, p, e)
        sums = shooting.kernel.sums(shooting.records[e], q, dq, p, dp, x0, dx0, shooting.weight, shooting.rows[e])
        if not np.isfinite(sums.cost):
            return None
        return _ProjectedRecord(
            sums.squares,
            sums.counts.astype(int),
            sums.gradient,
            sums.gauss_newton,
            n,
            states,
            self._low[e],
            self._high[e],
        )


class _ProjectedRecord:
    """One record at one point, its initial state eliminated to first order; a state pushed against its bound stays there."""

    def __init__(
        self,
        squares: np.ndarray,
        counts: np.ndarray,
        gradient: np.ndarray,
        matrix: np.ndarray,
        n: int,
        states: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
    ) -> None:
        self.squares, self.counts, self.cost = squares, counts, float(squares.sum())
        g, b, c = gradient[n:], matrix[:n, n:], matrix[n:, n:]
        is_held = (states <= low) & (g > 0) | (states >= high) & (g < 0)
        inverse = decompose_symmetric(np.where(is_held[:, None] | is_held, 0.0, c)).without_doubtful().pseudo_inverse
        self.step = -inverse @ g
        self.decrease = float(g @ inverse @ g)
        self.slope = -inverse @ b.T
        self.gradient = gradient[:n] - b @ inverse @ g
        self.hessian = matrix[:n, :n] - b @ inverse @ b.T
