"""Variable projection: many initial states, eliminated record by record, so that the optimiser sees the constants alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.transcription.arcs import find_measured_states
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.single_shooting import Evaluation, SingleShooting, add_prior_penalty

# The initial state of a record is found when a further step would lower chi-square by less than this, in units of the residual
# variance; or the misfit over noise by less than this (data without noise end at rounding errors).
NEGLIGIBLE, PERFECT = 1e-8, 1e-8
PASSES = 12
# Directions of an initial state with less than this share of the largest (scaled) curvature are not shown by the record.
UNSEEN = 1e-10


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
        low, high = v.bounds()
        self._low, self._high = (
            low[self.size :].reshape(v.experiments, -1),
            high[self.size :].reshape(v.experiments, -1),
        )
        self._own = np.clip(np.zeros_like(self._low), self._low, self._high)
        self._slope = np.zeros((*self._own.shape, self.size))
        self._at = np.zeros(self.size)

    @property
    def variables(self) -> DecisionVector:
        """The variables with the initial states still in them; see `full`."""
        return self.shooting.variables

    @property
    def own(self) -> np.ndarray:
        """The estimated initial states (experiments, states each) in units of their scale, relative to the guess."""
        return self._own

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on the constants (n,)."""
        low, high = self.variables.bounds()
        return low[: self.size], high[: self.size]

    def full(self, z: np.ndarray) -> np.ndarray:
        """The constants ``z`` (n,) followed by the initial states that belong to them: a point of `variables`."""
        self.evaluate(z)
        return np.concatenate([z, self._own.ravel()])

    def carry(self, starts_record: Sequence[bool] = ()) -> None:
        """Begin each arc where the one before it ended: a first guess for arcs that follow each other.

        States that an output shows keep the guess they have. The search for each initial state starts there, in order of time.
        ``begins`` says which arcs begin a record; there nothing is carried over.
        """
        v, shooting = self.variables, self.shooting
        scale, z = v.initial.scale[v.free_states], np.zeros(self.size)
        shown = find_measured_states(v)
        hidden = np.array([j not in shown for j in v.free_states])
        for e in range(v.experiments):
            self._settle(z, e, self._own[e])
            if e + 1 == v.experiments:
                return
            if starts_record and starts_record[e + 1]:
                continue
            whole = np.concatenate([z, self._own.ravel()])
            p = v.parameters(whole, e)
            q, _, _, x0, _ = shooting.at(whole, p, e)
            _, x = shooting.kernel.simulate(shooting.records[e], q, p, x0)
            if np.isfinite(x[-1]).all():
                carried = (x[-1] - v.initial.guess[e + 1])[v.free_states] / scale
                own = np.where(hidden, carried, self._own[e + 1])
                self._own[e + 1] = np.clip(own, self._low[e + 1], self._high[e + 1])

    def evaluate(self, z: np.ndarray) -> Evaluation:
        """Cost and derivatives along the constants at ``z`` (n,)."""
        ny = len(self.shooting.weight)
        gradient, hessian = np.zeros(self.size), np.zeros((self.size, self.size))
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        ahead = self._own + self._slope @ (z - self._at)
        ahead = np.clip(np.where(np.isfinite(ahead), ahead, self._own), self._low, self._high)
        found, slopes = self._own.copy(), self._slope.copy()
        for e in range(self.variables.experiments):
            part = self._settle(z, e, ahead[e])
            if part is None:
                self._own = found  # a trial step too far: keep what belongs to the last good point
                return Evaluation(np.inf, 0 * gradient, 0 * hessian, 0 * squares, 0 * counts, (e, 0))
            gradient += 2 * part.gradient
            hessian += 2 * part.hessian
            squares += part.squares
            counts += part.counts
            slopes[e] = part.slope
        self._at, self._slope = z.copy(), slopes
        return add_prior_penalty(
            self.variables, z, Evaluation(float(squares.sum()), gradient, hessian, squares, counts)
        )

    def _settle(self, z: np.ndarray, e: int, own: np.ndarray) -> _Part | None:
        """The best initial state of one record at ``z``, by damped Gauss-Newton steps; None where nothing can be simulated."""
        best = self._part(z, e, own)
        if best is None:
            own = self._own[e]
            best = self._part(z, e, own)
        if best is None:
            return None
        for _ in range(PASSES):
            count = max(int(best.counts.sum()), 1)
            if best.decrease <= NEGLIGIBLE * best.cost / count + PERFECT**2 * count:
                break
            better = self._shorter(z, e, own, best)
            if better is None:
                break
            own, best = better
        self._own[e] = own
        return best

    def _shorter(self, z: np.ndarray, e: int, own: np.ndarray, part: _Part) -> tuple[np.ndarray, _Part] | None:
        """The first of ever shorter steps that lowers the cost."""
        for share in (1.0, 0.5, 0.2, 0.05, 0.01):
            there = np.clip(own + share * part.step, self._low[e], self._high[e])
            trial = self._part(z, e, there)
            if trial is not None and trial.cost < part.cost:
                return there, trial
        return None

    def _part(self, z: np.ndarray, e: int, own: np.ndarray) -> _Part | None:
        v, shooting, n = self.variables, self.shooting, self.size
        whole = np.concatenate([z, np.zeros(v.size - n)])
        whole[v.columns(e)[n:]] = own
        p = v.parameters(whole, e)
        q, dq, dp, x0, dx0 = shooting.at(whole, p, e)
        sums = shooting.kernel.sums(shooting.records[e], q, dq, p, dp, x0, dx0, shooting.weight, shooting.rows[e])
        if not np.isfinite(sums.cost):
            return None
        return _Part(
            sums.squares, sums.counts.astype(int), sums.gradient, sums.gauss_newton, n, own, self._low[e], self._high[e]
        )


class _Part:
    """One record at one point, its initial state eliminated to first order; a state pushed against its bound stays there."""

    def __init__(
        self, squares: np.ndarray, counts: np.ndarray, gradient: np.ndarray, matrix: np.ndarray, n: int,
        own: np.ndarray, low: np.ndarray, high: np.ndarray,
    ) -> None:  # fmt: skip
        self.squares, self.counts, self.cost = squares, counts, float(squares.sum())
        g, b, c = gradient[n:], matrix[:n, n:], matrix[n:, n:]
        held = (own <= low) & (g > 0) | (own >= high) & (g < 0)
        inverse = invert_semidefinite(np.where(held[:, None] | held, 0.0, c))
        self.step = -inverse @ g
        self.decrease = float(g @ inverse @ g)
        self.slope = -inverse @ b.T
        self.gradient = gradient[:n] - b @ inverse @ g
        self.hessian = matrix[:n, :n] - b @ inverse @ b.T


def invert_semidefinite(matrix: np.ndarray, unseen: float = UNSEEN) -> np.ndarray:
    """Inverse of a positive semidefinite matrix, zero along directions that carry no information (after scaling)."""
    scale = np.sqrt(np.diag(matrix))
    usable = scale > 0
    inverse = np.zeros_like(matrix)
    if usable.any():
        outer = np.outer(scale[usable], scale[usable])
        values, vectors = np.linalg.eigh(matrix[np.ix_(usable, usable)] / outer)
        seen = values > unseen * values.max()
        inverse[np.ix_(usable, usable)] = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T / outer
    return inverse
