"""Every set of effects that was fitted, on one table, and how each would do if the records were drawn again.

A set keeps its residual and Jacobian block by block, on the records that it was fitted to and on those that judge it. A resample draws
blocks of all of them with replacement: one small solve refits every set to what was drawn, and the blocks that were not drawn score it
(the out-of-bag error of the bootstrap: L. Breiman 1996, Out-of-bag estimation). No run is simulated for that. What wins how often is
the raw weight of a claim (stability selection: N. Meinshausen, P. Buehlmann 2010, J. R. Stat. Soc. B 72).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from greybox.base.numerics import SAME_ERROR, TINY
from greybox.data.noise.noise_model import fit_autoregression, join_series
from greybox.discovery.execution import SearchStage
from greybox.discovery.holdout import VISIBLE_RMS, HoldoutScores
from greybox.discovery.laws.terms import claimed_name
from greybox.discovery.localisation import normalised_residuals
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.residual_noise import is_shape_correction
from greybox.estimation.transcription.problem import EstimationProblem

# Blocks into which the records that were fitted, and those that judge, are divided: so many at least, so that there is something to
# draw from...
LEAST_BLOCKS = 24
# ...and at most: an effect that acts in a tenth of them is then seen in three resamples of four, and more say no more.
MOST_BLOCKS = 96
# Length of a block over the memory of what the best set leaves: blocks are drawn as if they were independent (H. R. Kuensch 1989, The
# jackknife and the bootstrap for general stationary observations, Ann. Statist. 17).
BLOCK_MEMORIES = 10.0
# Fewest rows of a block.
LEAST_BLOCK_ROWS = 2
# Draws: a frequency is known to 3 %.
RESAMPLES = 200
# Standard errors, over the blocks that were not drawn, within which a set does as well as the best of a resample: of many sets the best
# is partly lucky.
GOOD_DEVIATIONS = 2.0
# What a set may leave more than the best one, over what the effects of the best take, in rms: no real effect is as exact as its name. A
# richer form that does better by less is no doubt about the simple one; of a further effect, which has a name, the same would be unheard.
SAME_FORM = 0.04
# Mean square error over the noise, and difference relative to what the best leaves, beyond which more of it says nothing more.
ASTRAY, FAR_BEHIND = 1e100, 1e6
# Seed of the draws: the same records give the same answer.
SEED = 1
# Size of the step of a constant that costs as much as one sample at the level of the noise: beyond its own size a linear step is not to be
# trusted, and a constant that the drawn blocks leave open would go to its bound.
RIDGE = 1.0


@dataclass(frozen=True, eq=False)
class BlockSums:
    """The sums of squares of one set of effects as a quadratic of its unknowns, by block and output.

    Parameters
    ----------
    square, count
        Sum of the squared residuals over the noise, and how many (B, ny).
    gradient, curvature
        ``J'r`` (B, ny, n) and ``J'J`` (B, ny, n, n) along the n unknowns: constants, then the first states of every record.
    low, high
        How far the unknowns may move (n,).
    constants
        How many of the unknowns are constants.
    is_judging
        Which blocks are of the records that judge (B,).
    reach
        Range of the readings of each output over the noise (ny,).
    """

    square: np.ndarray
    count: np.ndarray
    gradient: np.ndarray
    curvature: np.ndarray
    low: np.ndarray
    high: np.ndarray
    constants: int
    is_judging: np.ndarray
    reach: np.ndarray

    @property
    def judged_rms(self) -> np.ndarray:
        """Rms error over the noise on the records that judge, with the constants of the fitted ones (ny,); nan where nothing was read."""
        squares, counts = (each[self.is_judging].sum(axis=0) for each in (self.square, self.count))
        return np.sqrt(np.divide(squares, counts, out=np.full(squares.shape, np.nan), where=counts > 0))

    def refit(self, drawn: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """The steps (R, n) to the optimum of each resample: ``drawn`` (R, B) counts its blocks, ``weight`` (ny,) its outputs."""
        n = len(self.low)
        if not n:
            return np.zeros((len(drawn), 0))
        # sum_b w_b (J'J, J'r), outputs in units of what is left in them.
        curvature = (drawn @ np.einsum("boij,o->bij", self.curvature, weight).reshape(-1, n * n)).reshape(-1, n, n)
        gradient = drawn @ np.einsum("boi,o->bi", self.gradient, weight)
        # In units in which each unknown alone has a curvature of one: beside the curvatures of a run that nearly goes astray the ridge is
        # lost in rounding.
        unit = 1 / np.sqrt(np.einsum("rii->ri", curvature) + RIDGE)
        ridge = RIDGE * unit**2 + n * np.finfo(float).eps
        scaled = curvature * unit[:, :, None] * unit[:, None, :] + ridge[:, :, None] * np.eye(n)
        target = (gradient * unit)[:, :, None]
        try:
            moves = np.linalg.solve(scaled, target)
        except (
            np.linalg.LinAlgError
        ):  # a run that nearly goes astray: only rounding stands beside its steepest direction
            moves = np.linalg.pinv(scaled, hermitian=True) @ target
        steps = -unit * moves[:, :, 0]
        return np.clip(steps, self.low, self.high)

    def mean_squares(self, steps: np.ndarray) -> np.ndarray:
        """Mean square errors (R, B, ny) over the noise after ``steps`` (R, n): |r + J s|^2 = r'r + 2 s'J'r + s'J'J s."""
        i, j = np.triu_indices(steps.shape[1])
        # s'J'J s as one product of matrices: each pair of unknowns once, those off the diagonal twice.
        pairs = steps[:, i] * steps[:, j] * np.where(i == j, 1.0, 2.0)
        change = 2 * np.tensordot(steps, self.gradient, (1, 2)) + np.tensordot(pairs, self.curvature[..., i, j], (1, 2))
        return np.maximum(self.square + change, 0.0) / np.maximum(self.count, 1)


@dataclass(frozen=True, eq=False)
class FittedSet:
    """One set of effects on the table: the candidate and its sums by block."""

    candidate: FittedCandidate
    sums: BlockSums

    @property
    def effects(self) -> frozenset[str]:
        """Names of its effects."""
        return frozenset(self.candidate.effects)


@dataclass(frozen=True, eq=False)
class Draws:
    """What resampling says of a table.

    Parameters
    ----------
    sets
        The sets that took part.
    errors
        Out-of-bag error of each set in each resample, all outputs together (R, S): the logarithm of the rms over what the best leaves.
    good
        Which sets are within `GOOD_DEVIATIONS` of the best of the resample, or of its form (R, S).
    winner
        The simplest good one (R,).
    """

    sets: tuple[FittedSet, ...]
    errors: np.ndarray
    good: np.ndarray
    winner: np.ndarray


SetKey = frozenset[tuple[str, str, str]]


def key_of(candidate: FittedCandidate, without: str = "") -> SetKey:
    """What makes a set: names, places and equations of its effects, but for one; two curves, and two laws, have the same name."""
    added = [b for b in candidate.model.bound_effects if b.effect.name not in (*candidate.given, without)]
    return frozenset((claimed_name(b.effect), b.site, b.effect.equation) for b in added)


# Sets that take part in the draws at most: those that leave least on the records that were fitted...
MOST_SETS = 60
# ...and at most so many times the rms error of the best of them: no resample makes up for more.
NEAR_RATIO = 2.0


@dataclass
class FitTable:
    """All sets that were fitted to the records of one problem.

    Parameters
    ----------
    scores
        The records that judge, with the problem that the sets were fitted for.
    """

    scores: HoldoutScores
    _sets: dict[SetKey, FittedCandidate] = field(init=False, default_factory=dict)
    _sums: dict[int, tuple[FittedCandidate, BlockSums | None]] = field(init=False, default_factory=dict)
    _blocks: int = field(init=False, default=0)

    def add(self, *candidates: FittedCandidate | None) -> None:
        """Put sets on the table; of two fits of the same set the one that leaves less stays, whatever noise they were weighed with."""
        records = [e.fingerprint for e in self.scores.problem.experiments]
        for candidate in candidates:
            if candidate is None or not np.isfinite(candidate.cost):
                continue
            if [e.fingerprint for e in candidate.problem.experiments] != records:
                continue
            known = self._sets.get(key_of(candidate))
            if known is None or candidate.noise_ratio < known.noise_ratio:
                self._sets[key_of(candidate)] = candidate

    def get(self, effects: Iterable[str]) -> FittedCandidate | None:
        """The fit of one set of effects of the catalogue, if it is there."""
        wanted = frozenset(effects)
        return next((fit for fit in self._sets.values() if frozenset(fit.effects) == wanted), None)

    def without(self, candidate: FittedCandidate, name: str) -> FittedCandidate | None:
        """The fit of a set without one of its effects, if it is there."""
        return self._sets.get(key_of(candidate, name))

    @property
    def candidates(self) -> tuple[FittedCandidate, ...]:
        """The fits, those that leave least first."""
        return tuple(sorted(self._sets.values(), key=lambda fit: fit.noise_ratio))

    def leading(
        self, always: Sequence[FittedCandidate], is_meant: Callable[[FittedCandidate], bool] = lambda _: True
    ) -> list[FittedCandidate]:
        """Those that take part in the draws; some ``always`` do, and so does every part of one that takes part.

        What an effect takes of the error is the difference from the set without it. ``is_meant`` says which are considered at all.
        """
        meant = [fit for fit in self.candidates if is_meant(fit)]
        least = min((fit.noise_ratio for fit in meant), default=0.0)
        near = {key_of(fit) for fit in meant if fit.noise_ratio <= NEAR_RATIO * least}
        near |= {key_of(fit) for fit in always}
        taking_part = [fit for fit in self.candidates if any(key_of(fit) <= key for key in near)]
        kept = {key_of(fit) for fit in (*taking_part[:MOST_SETS], *always)}
        return [fit for key, fit in self._sets.items() if key in kept]

    def sums(self, candidate: FittedCandidate) -> BlockSums | None:
        """The sums of a candidate by block; None where it cannot be run."""
        if id(candidate) not in self._sums:
            slopes = self.slopes(candidate)
            self._sums[id(candidate)] = candidate, None if slopes is None else slopes.sum_blocks()
        return self._sums[id(candidate)][1]

    def judged_errors(self, candidate: FittedCandidate) -> dict[str, float]:
        """Rms error of a set on the records that judge, by output; empty for one that has taken part in no draw."""
        _, sums = self._sums.get(id(candidate), (None, None))
        if sums is None:
            return {}
        rms = sums.judged_rms * self.scores.problem.noise_model.std
        return {o.name: float(e) for o, e in zip(candidate.problem.model.outputs, rms, strict=True) if np.isfinite(e)}

    @property
    def blocks(self) -> int:
        """Into how many blocks the records that were fitted, and those that judge, are divided."""
        if not self._blocks:
            self._blocks = _count_blocks(self.candidates[0])
        return self._blocks

    def draw(self, candidates: Sequence[FittedCandidate], resamples: int = RESAMPLES) -> Draws:
        """Resample the records and see which of ``candidates`` wins."""
        return draw_sets([FittedSet(c, sums) for c in candidates if (sums := self.sums(c)) is not None], resamples)

    def slopes(self, candidate: FittedCandidate) -> LinearisedSet | None:
        """A candidate on the table, linearised on all records in as many blocks as the others; None where it cannot be run."""
        compute = partial(linearise_set, self.scores, candidate, self.blocks)
        return self.scores.problem.failures.attempt(SearchStage.EVIDENCE, candidate.effects, compute, None)


def draw_sets(sets: Sequence[FittedSet], resamples: int = RESAMPLES) -> Draws:
    """Resample the records and see which of ``sets`` wins."""
    sets = _keep_whole(list(sets))
    if not sets:
        return Draws((), np.zeros((0, 0)), np.zeros((0, 0), bool), np.zeros(0, int))
    blocks = len(sets[0].sums.count)
    draws = np.random.default_rng(SEED).integers(0, blocks, (resamples, blocks))
    drawn = np.zeros((resamples, blocks))
    np.add.at(drawn, (np.arange(resamples)[:, None], draws), 1.0)
    left = drawn == 0
    count = sets[0].sums.count
    # Outputs count relative to the least that any set leaves in them: no level of noise is needed.
    level = np.min([s.sums.square.sum(axis=0) / np.maximum(count.sum(axis=0), 1) for s in sets], axis=0)
    measured = count.sum(axis=0) > 0
    weight = np.where(measured, 1 / np.maximum(level, TINY), 0.0)
    squares = np.stack([s.sums.mean_squares(s.sums.refit(drawn, weight)) for s in sets])[..., measured]
    # Each output of the records that were fitted, and of those that judge, counts alike, however long they are.
    judging = sets[0].sums.is_judging[:, None]
    counts = np.concatenate([count[:, measured] * ~judging, count[:, measured] * judging], axis=1)
    return _judge_draws(tuple(sets), np.concatenate([squares, squares], axis=-1), left, counts)


def _keep_whole(sets: list[FittedSet]) -> list[FittedSet]:
    """The sets that run over every sample that any of them runs over: a run that breaks off leaves no error where it is worst."""
    most = np.max([s.sums.count.sum() for s in sets], initial=0)
    return [s for s in sets if s.sums.count.sum() == most]


# Share of the rms error of the best set below which a block counts as one in which nothing is left.
NOTHING_LEFT = 0.01


def _judge_draws(sets: tuple[FittedSet, ...], squares: np.ndarray, left: np.ndarray, count: np.ndarray) -> Draws:
    """The winners, from mean squares (S, R, B, n) of n outputs, the blocks ``left`` out of each resample (R, B), and samples (B, n)."""
    # A set that goes astray is out, however far it goes: nothing may overflow on the way.
    squares = np.minimum(np.nan_to_num(squares, nan=ASTRAY, posinf=ASTRAY), ASTRAY)
    weight = left[:, :, None] * count  # (R, B, n)
    total = weight.sum(axis=1)
    seen = total > 0
    mean = np.einsum("srbo,rbo->sro", squares, weight) / np.maximum(total, 1)
    # Outputs together: the mean of the logarithms of their rms.
    logs = np.where(seen, 0.5 * np.log(np.maximum(mean, TINY)), 0.0)
    errors = (logs.sum(axis=2) / np.maximum(seen.sum(axis=1), 1)).T  # (R, S)
    best = errors.argmin(axis=1)
    rounds = np.arange(len(best))
    # By how much each set is worse than the best, block by block: relative to what the best leaves in that output, and as the logarithm.
    # The one tells an effect that acts in a few blocks (a stop), the other is not deceived by a few blocks in which a set goes astray.
    reference, chosen = np.maximum(mean[best, rounds], TINY), squares[best, rounds]
    share = weight / np.maximum(weight.sum(axis=2, keepdims=True), 1)
    behind = np.minimum((squares - chosen[None]) / reference[None, :, None, :], FAR_BEHIND)
    relative = (behind * share[None]).sum(axis=3)
    # A block in which a set leaves nothing (a reading held at the end of its range) would outweigh all others as a logarithm.
    least = NOTHING_LEFT**2 * reference[:, None, :]
    logarithm = ((np.log(np.maximum(squares, least)) - np.log(np.maximum(chosen, least))) * share[None]).sum(axis=3)
    # The simplest of those within some standard errors (L. Breiman et al. 1984, Classification and regression trees, section 3.4.3).
    good = np.ones(errors.shape, bool)
    for behind in (relative, logarithm):
        good &= (_standard_errors(behind, left) <= GOOD_DEVIATIONS).T
    # ...or of the same form: as many effects with a name, and hardly more error beside what those take in which they differ.
    named = np.array([sum(not is_shape_correction(name) for name in s.candidate.effects) for s in sets])
    average = (relative * left[None]).sum(axis=2) / np.maximum(left.sum(axis=1), 1)  # (S, R)
    shared = {b: _find_shared(sets, b) for b in set(best.tolist())}
    taken = np.where(named[best] > named.min(), np.array([average[shared[b], k] for k, b in enumerate(best)]).T, 0.0)
    # Of formulas there are dozens within that of each other: beside another one a law leaves no more that could be seen.
    laws = [s.candidate.laws for s in sets]
    is_same = np.array([[not law or law == laws[b] for b in best] for law in laws])
    allowed = np.where(is_same, SAME_FORM**2 * taken, np.minimum(SAME_FORM**2 * taken, VISIBLE_RMS**2 - 1))
    good |= ((average <= allowed) & (named[:, None] >= named[best])).T
    good[rounds, best] = True
    free = np.array([s.candidate.free for s in sets], float)
    # Fewest constants; of as many, the one that leaves least.
    ranked = np.where(good, free[None] + errors / (1 + np.abs(errors).max()) / 2, np.inf)
    return Draws(sets, errors, good, ranked.argmin(axis=1))


def _find_shared(sets: Sequence[FittedSet], best: int) -> list[int]:
    """For each set the one that holds what it has in common with the best, and no more; the largest part of that which is there.

    Of sets that differ by curves alone, which have no name, it is the smallest: all that they have names for is in question.
    """
    names = [{name for name in s.candidate.effects if not is_shape_correction(name)} for s in sets]
    plainest = min(range(len(sets)), key=lambda k: len(sets[k].candidate.effects))
    whole = [k for k, s in enumerate(sets) if len(s.candidate.effects) == len(names[k]) and k != best]
    parts = sorted(whole, key=lambda k: -len(names[k]))
    return [
        plainest if each == names[best] else next((k for k in parts if names[k] <= each & names[best]), plainest)
        for each in names
    ]


def _standard_errors(behind: np.ndarray, left: np.ndarray) -> np.ndarray:
    """The means (S, R) over the blocks ``left`` (R, B) of ``behind`` (S, R, B), in standard errors."""
    blocks = np.maximum(left.sum(axis=1), 2)
    average = (behind * left[None]).sum(axis=2) / blocks
    spread = np.sqrt((((behind - average[:, :, None]) ** 2) * left[None]).sum(axis=2) / (blocks - 1))
    return np.asarray(average / np.maximum(spread / np.sqrt(blocks), SAME_ERROR))


def _count_blocks(best: FittedCandidate) -> int:
    """Into how many blocks the records are divided: each long beside the memory of what the best set leaves."""
    residuals = normalised_residuals(best)
    rows = sum(len(r) for r in residuals)
    memory = 1.0
    for j in range(residuals[0].shape[1]):
        # Of a series with correlations rho_k so many samples count as one: 1 + 2 sum_k rho_k.
        series = join_series(r[:, j] for r in residuals)
        correlation = fit_autoregression(series).autocorrelation(rows // LEAST_BLOCKS)
        memory = max(memory, 1 + 2 * float(correlation[1:].sum()))
    return int(np.clip(rows / (BLOCK_MEMORIES * memory), LEAST_BLOCKS, MOST_BLOCKS))


@dataclass(frozen=True, eq=False)
class LinearisedSet:
    """One set of effects on all records, those that were fitted and then those that judge, to first order about its fit.

    Parameters
    ----------
    candidate
        The candidate with all records in its problem.
    residuals
        For each record the residuals over the noise (N, ny), 0 where nothing counts.
    jacobians
        Their slopes (N, ny, n) along the constants and the first states of that record.
    present
        Which of them count (N, ny).
    fitted, uncounted
        How many of the records were fitted, and how many rows at the start of each of the others do not count.
    blocks
        Into how many blocks these, and those that judge, are divided.
    """

    candidate: FittedCandidate
    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    present: tuple[np.ndarray, ...]
    fitted: int
    uncounted: int
    blocks: int

    def columns(self, record: int) -> np.ndarray:
        """Which of all unknowns the slopes of a record are along."""
        return np.asarray(self.candidate.variables.columns(record))

    def sum_blocks(self) -> BlockSums | None:
        """The sums by block; None where they are not finite."""
        variables, experiments = self.candidate.variables, self.candidate.problem.experiments
        rows = [sum(e.rows for e in part) for part in (experiments[: self.fitted], experiments[self.fitted :])]
        size = variables.size
        parts: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]] = []
        for e, (residual, jacobian) in enumerate(zip(self.residuals, self.jacobians, strict=True)):
            is_judging = e >= self.fitted
            first = self.uncounted if is_judging else 0
            length = max(math.ceil(rows[is_judging] / self.blocks), LEAST_BLOCK_ROWS)
            pieces = max(round((len(residual) - first) / length), 1)
            columns = self.columns(e)
            for part in np.array_split(np.arange(first, len(residual)), pieces):
                slopes = np.zeros((residual.shape[1], size))
                curvature = np.zeros((residual.shape[1], size, size))
                slopes[:, columns] = np.einsum("no,noi->oi", residual[part], jacobian[part])
                curvature[np.ix_(np.arange(residual.shape[1]), columns, columns)] = np.einsum(
                    "noi,noj->oij", jacobian[part], jacobian[part], optimize=True
                )
                square = (residual[part] ** 2).sum(axis=0)
                parts.append((square, self.present[e][part].sum(axis=0), slopes, curvature, is_judging))
        square, count, gradient, curvature, judges = (np.array(each) for each in zip(*parts, strict=True))
        low, high = variables.bounds()
        if not all(np.isfinite(sums).all() for sums in (square, gradient, curvature)):
            return None
        reach = measure_reach(self.candidate.problem)
        return BlockSums(square, count, gradient, curvature, low, high, len(variables.which), judges, reach)


def measure_reach(problem: EstimationProblem) -> np.ndarray:
    """Range of the readings of each output over the noise (ny,); infinite for an output that nobody measured."""
    readings = np.concatenate([record.samples(record.y) for record in problem.records])
    seen = np.isfinite(readings)
    low, high = np.where(seen, readings, np.inf).min(axis=0), np.where(seen, readings, -np.inf).max(axis=0)
    return np.where(seen.any(axis=0), (high - low) / problem.noise.std, np.inf)


def linearise_set(scores: HoldoutScores, candidate: FittedCandidate, blocks: int) -> LinearisedSet | None:
    """Residuals and their slopes on all records; None where the set cannot be run over them."""
    run = scores.run(candidate)
    if run is None:
        return None
    judging, problem = scores.validation.records, scores.problem
    fitted = problem.experiments
    names = candidate.model.system.state_names
    prepared = problem.prepare_fitted(candidate, (*fitted, *judging), begun=names).with_plain_squares()
    begun = [[trace.initial_state[name] for name in names] for trace in run.traces]
    guess = np.vstack([candidate.variables.initial.guess, np.array(begun).reshape(len(judging), len(names))])
    variables = replace(prepared.variables, initial=replace(prepared.variables.initial, guess=guess))
    residuals, jacobians, counted, uncounted = [], [], [], scores.validation.uncounted
    for e, (residual, jacobian) in enumerate(prepared.shooting(variables).residuals(variables.here)):
        present = np.isfinite(residual)
        if e >= len(fitted):
            present[:uncounted] = False
        if not np.isfinite(jacobian[present]).all():
            return None
        residuals.append(np.where(present, residual, 0.0))
        jacobians.append(np.where(present[:, :, None], jacobian, 0.0))
        counted.append(present)
    extended = replace(candidate, problem=prepared, variables=variables)
    return LinearisedSet(extended, tuple(residuals), tuple(jacobians), tuple(counted), len(fitted), uncounted, blocks)
