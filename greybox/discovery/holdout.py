"""Models on records that no parameter has seen: each is run there once; the errors, and the rejection of a model that explains nothing."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from greybox.base import Printable
from greybox.base.json_shape import Unbounded
from greybox.base.linear_algebra import eliminate
from greybox.base.numerics import SAME_ERROR, TINY
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.noise_model import AutoRegression, BoundDirection, NoiseModel, fit_autoregression, join_series
from greybox.discovery.execution import SearchStage
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate, with_initial_states
from greybox.estimation.errors import errors_by_block
from greybox.estimation.fit import fit as estimate
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.optim.quadratic_model import QuadraticModel
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import FitNoise, Validation
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import FitProgress
from greybox.estimation.validate import follow_records, validate
from greybox.model.model import Model
from greybox.simulation.plant import PlantModel

# Errors of models in blocks of the validation records: by how much one model does worse than another, and whether that is chance.

BlockErrors = Mapping[str, np.ndarray]
"""Mean square errors (B,) of a model by output, in blocks of the validation records."""


def compare_errors(errors: BlockErrors, others: BlockErrors) -> tuple[float, float]:
    """How much larger the mean square errors of another model are, and how many standard errors of the blocks that is.

    Each output counts relative to the error that the first model leaves in it. The standard errors are those of the logarithm, so that
    blocks of large motion do not hide the others, or those of the errors themselves where these tell more: an effect that acts in a
    few blocks only (a stop, an overflow). Infinitely larger for a model that cannot be run.
    """
    shared = [o for o in errors if o in others and len(others[o]) == len(errors[o])]
    if not shared or not all(np.isfinite(others[o]).all() for o in shared):
        return 1 / TINY, np.inf
    blocks = min(len(errors[o]) for o in shared)
    loss = float(np.mean([mean_error(others[o]) / max(mean_error(errors[o]), TINY) for o in shared])) - 1
    relative = [[each[o][:blocks] / max(mean_error(errors[o]), TINY) for o in shared] for each in (errors, others)]
    first, second = (np.maximum(np.mean(each, axis=0), TINY) for each in relative)
    return loss, max((_count_standard_errors(each) for each in (np.log(second / first), second - first)), key=abs)


def _count_standard_errors(values: np.ndarray) -> float:
    """The mean of ``values`` (B,) in standard errors; two runs of the same model differ by rounding, and not by many of these."""
    spread = float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.inf
    return float(values.mean()) / max(spread, SAME_ERROR)


def mean_error(values: np.ndarray | None) -> float:
    """The mean over the blocks; NaN without any."""
    return np.nan if values is None else float(np.mean(values))


# What a model leaves on records that were not fitted once its constants may move within what the fit left open.
#
# A free run carries the uncertainty of the constants and of the first states along: in a plant that integrates, a constant that is wrong by
# one standard deviation moves the end of a long record by many times the noise. That is no model error. So the run is corrected by one
# Gauss-Newton step of the first states and of the constants, which the estimation records hold as firmly as they determine them.

# Residuals (N,) of each output, one array a record.
Residuals = dict[str, list[np.ndarray]]


@dataclass(frozen=True)
class AdaptedRun:
    """A run over records that were not fitted, corrected within what the fit left open.

    Parameters
    ----------
    residuals
        By measured output the residuals in its unit, one array a record.
    rise
        By how much the step raises the cost of the estimation records: what the correction has to be charged with.
    """

    residuals: Residuals
    rise: float = 0.0


def adapt_to_records(
    problem: DiscoveryProblem, candidate: FittedCandidate, experiments: Sequence[Experiment], run: Validation
) -> AdaptedRun | None:
    """``candidate`` on ``experiments`` after the step.

    Parameters
    ----------
    problem, candidate
        The search's records and noise, and the model as it was fitted.
    experiments, run
        Other records, and its free run over them.

    Returns
    -------
    AdaptedRun or None
        None where the model cannot be run after the step.
    """
    names = candidate.model.system.state_names
    prepared = problem.prepare_fitted(candidate, tuple(experiments), begun=names)
    guess = np.array([[trace.initial_state[name] for name in names] for trace in run.traces])
    variables = replace(prepared.variables, initial=replace(prepared.variables.initial, guess=guess))
    model = prepared.shooting(variables).evaluate(variables.here)
    if not (model.is_finite and len(variables.which) == len(candidate.variables.which)):
        return None
    held = _hold_constants(candidate, variables)
    step = QuadraticModel(model.cost, model.gradient, model.hessian + held).bounded_step(*variables.bounds())
    shooting = prepared.with_plain_squares().shooting(variables)
    errors = [r for r, _ in shooting.residuals(step)]
    # A residual that is no number is one of a sample that nobody measured, or of a model that did not survive the step.
    present = [np.isfinite(record.samples(record.y)) for record in shooting.records]
    if not all(np.isfinite(r[p]).all() for r, p in zip(errors, present, strict=True)):
        return None
    std = prepared.noise.std
    measured = {name for experiment in experiments for name in experiment.outputs}
    residuals = {
        output.name: [r[:, j] * std[j] for r in errors]
        for j, output in enumerate(prepared.model.outputs)
        if output.name in measured
    }
    return AdaptedRun(residuals, float(step @ held @ step) / 2)


def _hold_constants(candidate: FittedCandidate, variables: DecisionVector) -> np.ndarray:
    """Information (n, n) of the estimation records on the constants, as the unknowns ``variables`` count them; none on first states.

    Beside what they tell, the size of a constant is one standard deviation of it: beyond that a linear step is not to be trusted, and one
    that they leave open would go to its bound.
    """
    constants = np.arange(len(candidate.variables.which))
    others = np.arange(len(constants), candidate.variables.size)
    information = candidate.evaluation.hessian
    projection = eliminate(information, constants, others)
    scale = variables.spans / candidate.variables.spans
    held = np.zeros((variables.size, variables.size))
    held[np.ix_(constants, constants)] = (projection @ information @ projection.T) * np.outer(scale, scale)
    held[constants, constants] += 1.0
    return held


@dataclass(frozen=True)
class ValidationSet:
    """The validation records and how they are counted.

    Parameters
    ----------
    records
        The records.
    skip
        Rows at the start of each that the errors leave out.
    beginning
        Rows from which the initial state of each is estimated, not counted either; 0 takes ``skip``, or as many as the library would.
    """

    records: tuple[Experiment, ...]
    skip: int = 0
    beginning: int = 0

    def __bool__(self) -> bool:
        return bool(self.records)

    @classmethod
    def of(cls, records: Experiment | Sequence[Experiment] | ValidationSet) -> ValidationSet:
        """One record, or several, as a set; a set as it is."""
        if isinstance(records, ValidationSet):
            return records
        return cls(as_records(records))

    def halve(self) -> tuple[tuple[Experiment, ...], ValidationSet]:
        """The first halves, to fit to as well, and the records of which the second halves count."""
        half = min(record.rows for record in self.records) // 2
        return tuple(record.window(0, half) for record in self.records), ValidationSet(self.records, half)

    @property
    def uncounted(self) -> int:
        """Rows at the start of each record that do not count."""
        return max(self.skip, self.beginning)

    def run(self, model: Model, noise: Mapping[str, float], options: FitOptions) -> Validation:
        """A free run of ``model`` over the records, its parameters kept."""
        quick = replace(options, progressive=False, thorough=False)
        return validate(
            model, self.records, noise=noise, skip=self.uncounted, initial_rows=self.beginning, options=quick
        )


@dataclass(frozen=True)
class HoldoutError(Printable):
    """Rms simulation error of one output on the validation records.

    Parameters
    ----------
    before, after
        Error of the plain and of the extended model, in ``unit``; infinite where the run goes astray.
    floor
        Standard deviation of the noise: the error of a perfect model.
    unit
        Unit of the output.
    is_floor_known
        Whether the noise is known from elsewhere than from the records that were fitted. If not, ``floor`` is an estimate that only the
        selection uses.
    """

    before: Unbounded
    after: Unbounded
    floor: float
    unit: str
    is_floor_known: bool = True

    KEYS: ClassVar[str] = "before after floor=known_floor unit share"

    @property
    def known_floor(self) -> float | None:
        """Error of the noise alone; None where it is not known."""
        return self.floor if self.is_floor_known else None

    @property
    def share(self) -> float:
        """Share of the error that the extended model takes away, 0 to 1; negative where it is worse."""
        return 1 - self.after / self.before if self.before > 0 else 0.0

    @property
    def visible_share(self) -> float | None:
        """The same; None where the plain model leaves only noise whose level is known."""
        only_noise = self.is_floor_known and not self.before > VISIBLE_RMS * self.floor
        return None if only_noise else self.share

    @property
    def explained_fraction(self) -> float:
        """Share of the gap between ``before`` and ``floor`` that the extended model removes; negative where it is worse."""
        if math.isinf(self.before):
            return float(math.isfinite(self.after))
        return (self.before - self.after) / max(self.before - self.floor, 1e-12 * self.before)


def compare_holdout_errors(base: Fit, best: Fit) -> dict[str, HoldoutError]:
    """By output, from two fits that were validated on the same records."""
    before, after = (
        # A model whose run goes astray is infinitely wrong.
        {name: m.rmse if math.isfinite(m.rmse) else math.inf for name, m in fit.validation.misfit.items()}
        for fit in (base, best)
    )
    return {
        name: HoldoutError(before[name], after[name], base.noise.std[name], m.unit, is_floor_known(base, name))
        for name, m in base.validation.misfit.items()
    }


def is_floor_known(fit: Fit, output: str) -> bool:
    """Whether the level of an output's noise is known, and not bounded only."""
    return is_level_measured(fit.noise, output)


def is_level_measured(noise: FitNoise | NoiseModel, output: str) -> bool:
    """Whether the level of an output's noise is known, and not bounded only."""
    bound = noise.bound(output)
    return bound is not None and bound.direction is BoundDirection.ABOUT


def worst_output(holdout: Mapping[str, HoldoutError]) -> str:
    """The output that the plain model misses most, in units of its noise."""
    return max(holdout, key=lambda name: holdout[name].before / holdout[name].floor)


def validate_candidate(
    problem: DiscoveryProblem, candidate: FittedCandidate, validation: ValidationSet | Sequence[Experiment]
) -> Fit:
    """The candidate as a fit with intervals, from its own parameters and initial states, validated on other records."""
    # It ends where it begins: what other starts or exchanged constants would do is no question here.
    quick = replace(problem.options, progressive=False, thorough=False, other_starts=0, exchange=False)
    initial = estimated_initial_states(candidate)
    fit = estimate(candidate.model, problem.experiments, noise=candidate.problem.noise, initial=initial, options=quick)
    validation = ValidationSet.of(validation)
    if not validation:
        return fit
    return replace(fit, validation=validation.run(fit.model, fit.noise.std, problem.options).over(fit.noise))


# How often a fit is begun again where the last one ended, until that leaves it where it is.
MOST_FINISHES = 4
# Simulations with slopes from which on no further one is begun: a fit that has taken so many will not come to rest in the next.
MOST_FINISHING_RUNS = 1000
# Share of an error by which a fit has moved: a third of a digit that a reader would see.
MOVED_SHARE = 0.003
# Standard deviations by which a constant has moved: less is no other answer.
MOVED_DEVIATIONS = 0.1


@dataclass(frozen=True)
class RefitComparison:
    """A fit as one's own of the same model ends, and what another that begins there would change.

    Parameters
    ----------
    fit
        The fit, validated; where it is not settled, the last one but one, of which the other is known.
    status
        How the other one ended; empty where there is none.
    errors
        Errors that it changes, each with its ``records``, the ``output``, the error ``before`` and ``after``, and the ``unit``.
    constants
        Free constants that it moves, in their standard deviations.
    is_settled
        Whether another fit ends there too.
    is_late
        Whether there was no time for another one.
    """

    fit: Fit
    status: str = ""
    errors: tuple[Mapping[str, Any], ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    is_settled: bool = True
    is_late: bool = False

    @property
    def is_worse(self) -> bool:
        """Whether the other one ends with a larger error on the records that were fitted, all outputs together."""
        fitted = [e for e in self.errors if e["records"] == "estimation"]
        return sum(math.log(max(e["after"], TINY) / max(e["before"], TINY)) for e in fitted) > 0


def compare_with_refit(fit: Fit, again: Fit) -> RefitComparison:
    """``fit`` beside the fit ``again`` that began where it ended."""
    pairs = (("estimation", fit.misfit, again.misfit), ("validation", fit.validation.misfit, again.validation.misfit))
    errors = tuple(
        {"records": records, "output": name, "before": before[name].rmse, "after": m.rmse, "unit": m.unit}
        for records, before, after in pairs
        for name, m in after.items()
        if name in before and math.isfinite(m.rmse) and not abs(m.rmse - before[name].rmse) <= MOVED_SHARE * m.rmse
    )
    moves = {
        name: abs(each.value - fit.model.values[name]) / each.std for name, each in again.parameters.items() if each.std
    }
    constants = {name: float(move) for name, move in moves.items() if move > MOVED_DEVIATIONS}
    return RefitComparison(fit, again.solver.status, errors, constants, again.success and not (errors or constants))


def finish_fit(
    problem: DiscoveryProblem, fit: Fit, validation: ValidationSet, most: int = MOST_FINISHES
) -> RefitComparison:
    """``fit`` as a fit of one's own of the same model ends, validated; as it is where nobody asks for it.

    The model that a search writes holds these constants. Whoever fits it gets what the search reports, because the search has done just
    that, until another fit changed nothing; where none of them stands still, what the last one changed is told, and where there is no
    time for one, that is.
    """
    user = problem.user_settings
    if user is None:
        return RefitComparison(fit)
    best = RefitComparison(fit, is_settled=False, is_late=True)
    # It begins at the answer: that it stands there is no trouble for which other starts would have to be searched from.
    options = replace(user.options, other_starts=0, exchange=False)
    runs, end = 0, problem.executor.limit_finishing()

    def is_over(_: FitProgress) -> bool:
        return time.perf_counter() >= end

    for made in range(most):
        if problem.executor.is_late:
            break
        again = estimate(
            fit.model, problem.experiments, noise=user.noise, quiet=user.quiet, options=options, report=is_over
        )
        if again.solver.status is TerminationStatus.INTERRUPTED and time.perf_counter() >= end:
            break
        # The constants of a fit that did not end are no better than those where it began.
        if fit.success and not again.success:
            return compare_with_refit(fit, again)
        judged = validation.run(again.model, again.noise.std, user.options).over(again.noise)
        again = replace(again, validation=judged)
        best = compare_with_refit(fit, again)
        if best.is_settled:
            return RefitComparison(again)
        # Constants do not carry all of an end along: where a fit of one's own was better than the one that begins there, it stands.
        runs += again.solver.statistics["passes"]
        if (made and best.is_worse) or runs >= MOST_FINISHING_RUNS:
            break
        fit = again
    return best


def estimated_initial_states(candidate: FittedCandidate) -> list[dict[str, float]]:
    """The estimated initial states of each record where a refit ended."""
    initial, names = candidate.variables.initial, np.array(candidate.model.system.state_names)
    return [dict(zip(names[initial.free].tolist(), row[initial.free].tolist(), strict=True)) for row in initial.guess]


@dataclass
class HoldoutScores:
    """Candidates on the validation records; each is run there once, all but the first from where that begins."""

    problem: DiscoveryProblem
    validation: ValidationSet
    _runs: dict[tuple[Any, ...], Validation | None] = field(init=False, default_factory=dict)
    # The first states of the first that was run there, one value a record, and from how many rows of each they were estimated.
    _begun: tuple[Mapping[str, Sequence[float]], list[int]] | None = field(init=False, default=None)
    _adapted: dict[tuple[Any, ...], AdaptedRun | None] = field(init=False, default_factory=dict)

    def run(self, candidate: FittedCandidate) -> Validation | None:
        """The candidate's free run over the records; None where it fails there."""
        key = candidate.key
        if key not in self._runs:
            run = partial(self._run, candidate)
            self._runs[key] = self.problem.failures.attempt(SearchStage.HOLDOUT, candidate.effects, run, None)
        return self._runs[key]

    def _run(self, candidate: FittedCandidate) -> Validation:
        problem, records, options = self.problem, self.validation.records, self.problem.run_options
        is_free = options.transcription == Transcription.SINGLE and not isinstance(candidate.model, PlantModel)
        # Of a plant that no free run follows, and of one from outside, a run is more than its initial states.
        if not is_free or self.validation.beginning:
            return self.validation.run(candidate.model, problem.noise_std, options)
        guess, least = self._begun or ({}, [self.validation.skip] * len(records))
        prepared = with_initial_states(problem.prepare_fitted(candidate, records, begun=guess), guess)
        run, rows = follow_records(prepared, options, self.validation.skip, least)
        if self._begun is None:
            names = candidate.model.system.state_names
            self._begun = {name: [t.initial_state[name] for t in run.traces] for name in names}, rows
        return run

    def adapt(self, candidate: FittedCandidate) -> AdaptedRun | None:
        """Its run on the counted rows once constants and first states moved within their uncertainty; None where it fails.

        See `adapt_to_records`. Where the step lowers the error by less than it costs, this is the free run.
        """
        key = candidate.key
        if key not in self._adapted:
            self._adapted[key] = self._adapt(candidate)
        return self._adapted[key]

    def _adapt(self, candidate: FittedCandidate) -> AdaptedRun | None:
        run, first, records = self.run(candidate), self.validation.uncounted, self.validation.records
        if run is None:
            return None
        free_run = AdaptedRun(self._free_residuals(candidate))
        # A run that is lost before the first row that counts leaves nothing to correct.
        if not any(np.isfinite(np.concatenate(r)).any() for r in free_run.residuals.values()):
            return None
        step = partial(adapt_to_records, self.problem, candidate, records, run)
        adapted = self.problem.failures.attempt(SearchStage.HOLDOUT, candidate.effects, step, None)
        if adapted is None:
            return free_run
        residuals: Residuals = {
            name: [r[first:] for r, t in zip(adapted.residuals[name], run.traces, strict=True) if name in t.measured]
            for name in run.misfit
        }
        return min((AdaptedRun(residuals, adapted.rise), free_run), key=self._total_cost)

    def _total_cost(self, run: AdaptedRun) -> float:
        noise = self.problem.noise_std
        with np.errstate(over="ignore"):  # a curve may leave its records altogether: an infinite cost is the right one
            squares = (np.nansum(np.concatenate(r) ** 2) / noise[name] ** 2 for name, r in run.residuals.items())
            return float(run.rise + sum(squares))

    def charge(self, run: AdaptedRun) -> dict[str, float]:
        """By output, the mean square error that stands for the rise of an adapted run: it is spread evenly over the samples."""
        noise = self.problem.noise_std
        samples = sum(int(np.isfinite(r).sum()) for each in run.residuals.values() for r in each)
        return {name: noise[name] ** 2 * run.rise / max(samples, 1) for name in run.residuals}

    def _free_residuals(self, candidate: FittedCandidate) -> Residuals:
        run = self.run(candidate)
        return {} if run is None else _counted_residuals(run, self.validation.uncounted)

    def measure_drift(self, candidate: FittedCandidate) -> dict[str, float]:
        """By output the mean square error that goes when constants and first states move within their uncertainty."""
        run, adapted = self.run(candidate), self.adapt(candidate)
        if run is None or adapted is None:
            return {}
        charge = self.charge(adapted)
        left = {name: charge[name] + _mean_square(r) for name, r in adapted.residuals.items()}
        return {name: max(m.rmse**2 - left[name], 0.0) for name, m in run.misfit.items()}


def block_errors(validation: Validation, uncounted: int, blocks: int) -> dict[str, np.ndarray]:
    """By output the mean square error (B,) of a free run in about ``blocks`` equal blocks, without the ``uncounted`` first rows."""
    return errors_by_block(_counted_residuals(validation, uncounted), blocks)


def _counted_residuals(validation: Validation, uncounted: int) -> Residuals:
    return {
        name: [trace.residual(name)[uncounted:] for trace in validation.traces if name in trace.measured]
        for name in validation.misfit
    }


def _mean_square(residuals: Sequence[np.ndarray]) -> float:
    return float(np.nanmean(np.concatenate(residuals) ** 2))


# Rms over noise on validation records below which there is no gap to explain.
VISIBLE_RMS = 1.05
# Share by which the rms error there must fall to count.
VALIDATION_SHARE = 0.05
# Share of that gap below which a model explains nothing there; above it, reaching the noise is enough.
PARTIAL_SHARE = 0.5


# Correlation from sample to sample up to which a residual may be the noise of a sensor, where nobody knows the noise.
MOST_CORRELATION = 0.95
# Standard errors by which the rms of noise may exceed its level by chance.
CHANCE_DEVIATIONS = 3.0


# Samples over which the correlation of coloured noise is summed for the number of independent samples in a record.
NOISE_MEMORY = 500


def count_independent(samples: int, colour: AutoRegression) -> float:
    """Samples of white noise whose rms is as certain as that of so many ``samples`` of a colour: N / (1 + 2 sum rho_k^2)."""
    correlations = colour.autocorrelation(min(samples, NOISE_MEMORY))
    return samples / (1 + 2 * float(correlations[1:] @ correlations[1:]))


def measure_structure(scores: HoldoutScores, candidate: FittedCandidate, only_visible: bool) -> float:
    """Share of the rms error on the validation records that is no noise, 0 to 1, all outputs together.

    What the uncertainty of constants and first states explains does not count (`HoldoutScores.adapt`). Where the noise is known, what
    exceeds it; else what the samples before tell of each sample. With ``only_visible`` what noise may look like is noise: a level up
    to `VISIBLE_RMS` or within chance, and the correlation of first order that a sensor may have.
    """
    run, adapted = scores.run(candidate), scores.adapt(candidate)
    if run is None or adapted is None:
        return 1.0
    noise, charge, shares = candidate.problem.noise, scores.charge(adapted), []
    for name, misfit in run.misfit.items():
        series = join_series(adapted.residuals[name])
        rms = max(float(np.sqrt(np.nanmean(series**2) + charge[name])), TINY)
        deviation = series / rms
        colour, first = fit_autoregression(deviation), fit_autoregression(deviation, max_order=1)
        # A sensor, or the filter behind it, has one time constant; a correlation that lasts longer is none of theirs.
        is_sensor = only_visible and abs(first.autocorrelation(2)[1]) < MOST_CORRELATION
        if is_level_measured(noise, name):
            bound = noise.bound(name)  # the problem may weigh with another level, the residual's
            level = misfit.rmse / misfit.noise_ratio if bound is None else bound.level
            if only_visible:
                # The rms of N independent samples of noise has a standard error of 1 / sqrt(2 N) of itself.
                alike = first if is_sensor and colour.order <= 1 else AutoRegression()
                error = 1 / math.sqrt(2 * count_independent(misfit.samples, alike))
                level *= max(VISIBLE_RMS, 1 + CHANCE_DEVIATIONS * error)
            shares.append(max(1 - (level / rms) ** 2, 0.0))
            continue
        shares.append(1 - colour.innovation_variance / (first.innovation_variance if is_sensor else 1.0))
    return float(np.sqrt(np.mean(shares))) if shares else 1.0
