"""What a discovery works on: records, noise and a model; and how a candidate model is fitted to them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from greybox.base.extensions import read_versions
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression, NoiseModel
from greybox.discovery.execution import NOT_SIMULATED, FailureLog, RefitExecutor, RefitJob, RefitOutcome, SearchStage
from greybox.discovery.laws.terms import claimed_name, is_law
from greybox.estimation.findings import locate_simulation_failure
from greybox.estimation.noise_loop import StartCost, solve
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.result import Fit
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, Solution
from greybox.estimation.transcription.select import TranscriptionChoice, select_transcription
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.model.equations import identify
from greybox.model.model import Model

StartValues = Mapping[str, float]
# Effects and constants of a candidate, by which it is known again.
CandidateKey = tuple[Any, ...]
# Cost that one step predicts from a starting point, and the variables there.
_Start = tuple[float, DecisionVector]


@dataclass(frozen=True)
class FittedCandidate:
    """A model fitted to the records.

    Parameters
    ----------
    model
        With the fitted values.
    cost
        Sum of squared whitened residuals over ``count`` samples.
    count
        Number of measured samples.
    free
        Number of free parameters and initial states.
    problem, variables, evaluation
        The estimation problem, its variables at the fit, and the residuals there.
    given
        Names of the effects that the model in question holds already: they are its user's, and no search adds, drops or swaps them.
    """

    model: Model
    cost: float
    count: int
    free: int
    problem: EstimationProblem
    variables: DecisionVector
    evaluation: Evaluation
    given: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that were added to the model in question."""
        return tuple(e.name for e in self.model.effects if e.name not in self.given)

    @property
    def key(self) -> CandidateKey:
        """Its effects and constants."""
        return self.effects, *self.model.values.values()

    @property
    def names(self) -> tuple[str, ...]:
        """What these are called where something is claimed of them."""
        return tuple(claimed_name(e) for e in self.model.effects if e.name not in self.given)

    @property
    def laws(self) -> tuple[str, ...]:
        """The formulas of the laws among them, with memory or without."""
        return tuple(sorted(e.equation for e in self.model.effects if e.name not in self.given and is_law(e.name)))

    @property
    def per_sample(self) -> float:
        """Cost over the number of samples: 1 where only noise is left; infinite for a model whose run overflows at once."""
        return self.cost / self.count if self.count else np.inf

    @cached_property
    def noise_ratio(self) -> float:
        """Misfit over noise of the output where that is largest, as a fit has it: the rms error of the run over the level of the noise, or
        over its ceiling where only that is known (`is_noise_bounded`).

        It is the same whatever level and colour a search weighs its residuals with.
        """
        if not np.isfinite(self.cost):
            return np.inf
        noise, evaluation = self.problem.noise, self.evaluation
        if noise.coloured or self.problem.loss is not None:
            evaluation = self.problem.with_plain_squares().shooting(self.variables).evaluate(self.variables.here)
        measured = np.flatnonzero(evaluation.counts)
        errors = noise.std[measured] * np.sqrt(evaluation.squares[measured] / evaluation.counts[measured])
        bounds = [noise.bound(noise.outputs[j]) for j in measured]
        levels = [noise.std[j] if bound is None else bound.level for j, bound in zip(measured, bounds, strict=True)]
        return float(np.max(errors / np.array(levels), initial=0.0))

    def choose_transcription(self, options: FitOptions) -> TranscriptionChoice:
        """The transcription that suits the model where its fit ended, and why."""
        return select_transcription(replace(self.problem, variables=self.variables), options)

    @property
    def is_noise_bounded(self) -> bool:
        """Whether the level of the noise of some output is not known, so that the misfit is at least so many times the noise."""
        return not self.problem.noise.is_level_known

    @property
    def criterion(self) -> float:
        """Schwarz's criterion: cost plus ``ln(samples)`` for each free constant."""
        return self.cost + self.free * float(np.log(max(self.count, 1)))

    @property
    def promised_decrease(self) -> float:
        """By how much a further Gauss-Newton step promises to lower the cost."""
        return self.evaluation.predicted_decrease(*self.variables.bounds())

    @property
    def is_falling(self) -> bool:
        """Whether one step more promises so much of its cost that its refit has not arrived (at a kink a promise is not kept)."""
        return self.promised_decrease > STILL_FALLING * self.cost


def noise_cost_limit(count: int) -> float:
    """Cost per sample that ``count`` samples of noise of exactly known level hardly ever exceed: four standard deviations."""
    return 1 + 4 * math.sqrt(2 / max(count, 1))


# Cost per sample beyond chance that is still clean: for a noise level that is not exact, and for the integrator's error.
FLOOR_MARGIN = 0.05


def clean_cost_limit(count: int) -> float:
    """Cost per sample above which something other than noise is left."""
    return noise_cost_limit(count) + FLOOR_MARGIN


# Iterations of a refit: what has not converged by then is not the answer, or is finished in the last fit.
SEARCH_REFIT_ITERATIONS = 60
# Share of its cost that one step more promises from which a refit that ended at that limit has not arrived.
STILL_FALLING = 0.1
# How often a refit that still falls goes on, each time by more than this share of its cost.
MOST_CONTINUED = 5
# Substeps of a sample that a refit of the search takes at most, unless the plain model needs more: a candidate that does is stiff by its
# constants alone, and minutes would not make it the answer. The last fit knows no such limit.
MAX_SUBSTEPS = 16
# How many times as many it takes if it is unstable with so few. One that is so still is out.
UNSTABLE_FACTOR = 2
# Most promising starting points from which a model is refitted.
SEARCH_REFIT_STARTS = 2
# Of more than so many the search goes on from those that promise most after a few iterations: a sharp resonance shows from afar at none.
MOST_SEARCHED = 3
# Iterations of such a look.
LOOK_ITERATIONS = 3


@dataclass(frozen=True)
class FitSettings:
    """How a fit of one's own to the same records goes: with the noise and the options as they were given.

    A search estimates the noise once and fits briefly. Its answer is fitted like this in the end, so that whoever fits the model that is
    handed over gets what the search reported.

    Parameters
    ----------
    noise, quiet, options
        What was given to the search.
    """

    noise: Mapping[str, float]
    quiet: tuple[Experiment, ...]
    options: FitOptions


@dataclass(frozen=True)
class DiscoveryProblem:
    """Records, noise and the model in question; it fits candidate models to the records.

    Parameters
    ----------
    model
        The plain model with the start values that it came with.
    experiments
        Estimation records.
    noise
        Standard deviation of outputs whose noise is known, or a whole noise model.
    quiet
        Records with the input at rest, which show the noise alone.
    options
        Options of every fit.
    executor
        Where refits run and where they are kept.
    failures
        What failed so far, and why.
    given
        Names of the effects that are the user's own: they count as a part of the plain model.
    user_settings
        How the answer is fitted in the end; None leaves it as the search fitted it.
    fitted
        Every candidate that was fitted so far, whatever came of it.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    noise: Mapping[str, float] | NoiseModel
    quiet: tuple[Experiment, ...]
    options: FitOptions
    executor: RefitExecutor = field(default_factory=RefitExecutor)
    failures: FailureLog = field(default_factory=FailureLog)
    given: tuple[str, ...] = ()
    user_settings: FitSettings | None = None
    fitted: list[FittedCandidate] = field(default_factory=list)
    # Candidates that a refit from where they stand leaves there, under this noise.
    settled: set[CandidateKey] = field(init=False, default_factory=set)

    @classmethod
    def from_fit(cls, fit: Fit) -> DiscoveryProblem:
        """The records, noise and options of a finished fit; its model is the plain one."""
        outputs = [o.name for o in fit.model.outputs]
        std = np.array([fit.noise.std.get(name, np.nan) for name in outputs])
        colour = tuple(AutoRegression(fit.noise.colour.get(name, ())) for name in outputs)
        noise = NoiseModel(tuple(outputs), std, fit.noise.sources, colour, False, fit.noise.bounds)
        options = FitOptions.from_data(fit.provenance.options)
        # A search weighs rows: noise that grows with the signal is that of the fit's run.
        experiments = tuple(
            replace(t.experiment, noise={**t.noise, **{n: g.std(t.simulated[n]) for n, g in fit.noise.growth.items()}})
            for t in fit.traces
        )
        return cls(fit.model, experiments, noise, (), options)

    def to_candidate(self, fit: Fit) -> FittedCandidate:
        """A finished fit as it stands, without another search."""
        names = fit.model.system.state_names
        problem = self.prepare(fit.model, begun=names)
        guess = np.array([[t.initial_state[name] for name in names] for t in fit.traces])
        variables = replace(problem.variables, initial=replace(problem.variables.initial, guess=guess))
        evaluation = problem.shooting(variables).evaluate(variables.here)
        return FittedCandidate(
            fit.model, evaluation.cost, evaluation.count, variables.size, problem, variables, evaluation, self.given
        )

    @cached_property
    def baseline(self) -> FittedCandidate:
        """The plain model, fitted to a growing part of the record from its start values."""
        solution = solve(self.prepare(self.model), self.options)
        if solution.status is TerminationStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return _from_solution(self.model, solution, self.given)

    def prepare(
        self,
        model: Model,
        experiments: tuple[Experiment, ...] | None = None,
        most_substeps: int = 0,
        begun: Collection[str] = (),
        like: EstimationProblem | None = None,
    ) -> EstimationProblem:
        """The estimation problem of ``model`` on the records (or on others); the noise is that of the baseline.

        A sample has ``most_substeps`` at most (0: as many as the options of the fits allow), or the steps of the problem ``like``. Who
        asks sets the first guess of the states in ``begun``.
        """
        known = self.noise if model is self.model or isinstance(self.noise, NoiseModel) else self._baseline_noise
        options = self.options.integration
        if most_substeps:
            coarse = replace(options.policy.discretisation, max_substeps=most_substeps)
            options = replace(options, policy=replace(options.policy, discretisation=coarse))
        if like is not None and not like.step.per_interval:
            options = replace(options, method=like.method, substeps=like.step.substeps)
        return prepare_problem(model, experiments or self.experiments, known, options, quiet=self.quiet, begun=begun)

    def prepare_fitted(
        self, candidate: FittedCandidate, experiments: tuple[Experiment, ...], begun: Collection[str] = ()
    ) -> EstimationProblem:
        """The problem of a candidate on other records, with its constants and its step; ``begun`` as in `prepare`."""
        prepared = self.prepare(candidate.model, experiments, begun=begun, like=candidate.problem)
        return replace(prepared, variables=prepared.variables.start_at(candidate.model.values))

    @cached_property
    def _most_substeps(self) -> int:
        """Substeps of a candidate, unless it is unstable with so few: those of the budget, or twice those of the plain model."""
        return max(MAX_SUBSTEPS, 2 * self.prepare(self.model).step.substeps)

    def _prepare_starts(
        self, model: Model, starts: Sequence[StartValues], beginning: Mapping[str, Sequence[float]]
    ) -> tuple[EstimationProblem, list[_Start]]:
        """The estimation problem of a candidate, and those of its starts from which it can be simulated, most promising first."""
        most = self._most_substeps
        problem = with_initial_states(self.prepare(model, most_substeps=most, begun=beginning), beginning)
        points = _rank_starts(problem, starts, self.refit_options)
        if not points and problem.step.substeps >= most:
            most *= UNSTABLE_FACTOR
            problem = with_initial_states(self.prepare(model, most_substeps=most, begun=beginning), beginning)
            points = _rank_starts(problem, starts, self.refit_options)
        return problem, points

    @cached_property
    def refit_options(self) -> FitOptions:
        """The options of a refit.

        Where free runs follow the plain model they are what a candidate is judged by as well. A candidate that is unstable at its
        start alone would else be searched for segment by segment: minutes for a fit that says nothing of a free run.
        """
        if self.options.transcription != Transcription.AUTOMATIC or self.options.arc_length:
            return self.options
        of_baseline = select_transcription(self.baseline.problem, self.options).transcription
        return replace(self.options, transcription=of_baseline) if of_baseline is Transcription.SINGLE else self.options

    @cached_property
    def run_options(self) -> FitOptions:
        """The options of a free run that compares candidates: its step is no finer than any refit's, and it is as free as these."""
        policy, most = self.options.policy, UNSTABLE_FACTOR * self._most_substeps
        discretisation = replace(policy.discretisation, max_substeps=most)
        refinement = replace(policy.step_refinement, max_substeps=most)
        policy = replace(policy, discretisation=discretisation, step_refinement=refinement)
        return replace(self.refit_options, policy=policy)

    def _job_options(self, job: RefitJob) -> FitOptions:
        """Those of one refit of the search: from its start straight to an optimum, with steps that do not become ever finer."""
        options = replace(self.refit_options, iterations=job.iterations)
        refinement = replace(options.policy.step_refinement, max_substeps=self._most_substeps)
        if not job.refines:
            refinement = replace(refinement, halvings=0)
        policy = replace(options.policy, step_refinement=refinement)
        return replace(options, progressive=False, thorough=False, policy=policy)

    @property
    def noise_model(self) -> NoiseModel:
        """The noise as it was given, or as the baseline identified it."""
        return self.noise if isinstance(self.noise, NoiseModel) else self._baseline_noise

    @cached_property
    def _baseline_noise(self) -> NoiseModel:
        return self.baseline.problem.noise

    @property
    def noise_std(self) -> dict[str, float]:
        """Noise standard deviation of each measured output."""
        measured = {name for e in self.experiments for name in e.outputs}
        pairs = zip(self.model.outputs, self.noise_model.std, strict=True)
        return {o.name: float(std) for o, std in pairs if o.name in measured}

    def plan_refit(
        self,
        model: Model,
        starts: Iterable[StartValues],
        keep: int | None = None,
        iterations: int | None = None,
        like: FittedCandidate | None = None,
        refines: bool = True,
    ) -> RefitJob:
        """The refit of ``model`` from the ``keep`` most promising of ``starts``.

        The records start from the initial states of the fit ``like``, as far as it has the same states. Whether it ``refines`` its
        integration step is as in `RefitJob`.
        """
        keep, iterations = keep or SEARCH_REFIT_STARTS, iterations or SEARCH_REFIT_ITERATIONS
        return RefitJob(model, tuple(starts), keep, iterations, _initial_states(like), refines)

    def refit_best(
        self, model: Model, starts: Iterable[StartValues], *plan: Any, **options: Any
    ) -> FittedCandidate | None:
        """One refit as `plan_refit` has it; None if the model cannot be simulated from any of its starts."""
        return self.refit_all([self.plan_refit(model, starts, *plan, **options)])[0]

    def refit_without(
        self, candidate: FittedCandidate, name: str, *plan: Any, **options: Any
    ) -> FittedCandidate | None:
        """A candidate without one of its effects, all else refitted from where it stands and from what its user gave; None where that
        cannot be simulated. ``plan`` and ``options`` as in `plan_refit`.
        """
        model = candidate.model.without(name)
        kept = share_values(candidate.model, model)
        starts = (kept, kept | share_values(self.model, model))
        return self.refit_best(model, starts, *plan, like=candidate, **options)

    def converge(self, candidate: FittedCandidate, iterations: int = SEARCH_REFIT_ITERATIONS) -> FittedCandidate:
        """A short refit carried on to convergence, with an integration step that is fine enough; itself where nothing is gained.

        One that still falls at its limit comes along a valley from where the constants had gone without its effects: it begins once more
        at those that the user gave.
        """
        if candidate.key in self.settled:
            return candidate
        model, better = candidate.model, candidate
        for start in (model.values, {**model.values, **share_values(self.model, model)}):
            again = self.refit_best(model, [start], 1, iterations, like=candidate)
            better = again if again is not None and again.cost < better.cost else better
            if not better.is_falling:
                break
        # Down a long bent valley each refit comes a part of the way. One that gains little has arrived, whatever a step promises at a kink.
        before = candidate
        for _ in range(MOST_CONTINUED):
            if not better.is_falling or better.cost > (1 - STILL_FALLING) * before.cost:
                break
            before, again = better, self.refit_best(better.model, [better.model.values], 1, iterations, like=better)
            better = again if again is not None and again.cost < better.cost else better
        # A refit that the time limit left out says nothing of where it would have ended: there may be a reserve.
        if not self.executor.is_late:
            self.settled.add(better.key)
        return better

    def refit_all(self, jobs: Sequence[RefitJob]) -> list[FittedCandidate | None]:
        """Independent refits, in order, wherever they run."""
        fits: list[FittedCandidate | None] = self.executor.run(self, jobs)
        self.fitted.extend(fit for fit in fits if fit is not None)
        for job, fit in zip(jobs, fits, strict=True):
            failure = self.failures.find(SearchStage.REFIT, tuple(e.name for e in job.model.effects))
            if fit is None and failure is not None and failure.reason == NOT_SIMULATED:
                self.failures.replace(replace(failure, reason=self._explain_failure(job)))
        return fits

    def _explain_failure(self, job: RefitJob) -> str:
        """Where and why the run of a model breaks off that cannot be simulated from any of its starts: of the first of them."""
        problem = with_initial_states(self.prepare(job.model, most_substeps=self._most_substeps), job.beginning)
        start = next(iter(job.starts), {})
        variables = problem.variables.start_at(start)
        failed = problem.shooting(variables).evaluate(variables.here).failed
        if not failed:
            return NOT_SIMULATED
        constants = {n: v for n, v in {**job.model.values, **start}.items() if n not in self.model.values}
        listed = ", ".join(f"{name} = {value:.4g}" for name, value in constants.items())
        reason = locate_simulation_failure(problem, variables, *failed)
        remedy = "give its constants others, or leave it out with without=... (shell: --without)"
        return f"no run from any starting point; from {listed}: {reason}; {remedy}"

    def refit(self, job: RefitJob) -> FittedCandidate | None:
        """One refit in this process.

        Raises
        ------
        KeyboardInterrupt
            If the user interrupted it.
        """
        problem, points = self._prepare_starts(job.model, job.starts, job.beginning)
        options = self._job_options(job)
        begun = [replace(problem, variables=v) for _, v in points[: job.keep]]
        if len(begun) > MOST_SEARCHED:
            looks = [solve(one, replace(options, iterations=LOOK_ITERATIONS)) for one in begun]
            begun = [look.at_optimum for look in sorted(looks, key=_promised_cost)[:MOST_SEARCHED]]
        solutions = [solve(one, options) for one in begun]
        if any(s.status is TerminationStatus.INTERRUPTED for s in solutions):
            raise KeyboardInterrupt
        finite = [fit for fit in (_from_solution(job.model, s, self.given) for s in solutions) if np.isfinite(fit.cost)]
        if not finite:
            self.failures.add(SearchStage.REFIT, tuple(e.name for e in job.model.effects), NOT_SIMULATED)
        return min(finite, key=lambda fit: fit.cost, default=None)

    def to_outcome(self, candidate: FittedCandidate) -> RefitOutcome:
        """What must be kept of a refit to restore it."""
        initial = tuple(map(tuple, candidate.variables.initial.guess.tolist()))
        return RefitOutcome(candidate.model.values, initial, candidate.problem.step.substeps)

    def restore(self, model: Model, outcome: RefitOutcome) -> FittedCandidate:
        """``model`` where an earlier refit ended."""
        problem = self.prepare(model.start(**outcome.values), begun=model.system.state_names)
        variables = problem.variables.start_at(outcome.values)
        if outcome.substeps not in (0, problem.step.substeps) and not problem.step.per_interval:
            problem = problem.with_substeps(outcome.substeps)
        variables = replace(variables, initial=replace(variables.initial, guess=np.array(outcome.initial)))
        e = problem.shooting(variables).evaluate(variables.here)
        return FittedCandidate(problem.model, e.cost, e.count, variables.size, problem, variables, e, self.given)

    def to_portable(self) -> DiscoveryProblem:
        """The same for another process: the noise is known, and there is no executor or journal."""
        return DiscoveryProblem(
            self.model, self.experiments, self.noise_model, (), self.refit_options, given=self.given
        )

    def job_key(self, job: RefitJob) -> str:
        """The hash by which a refit is known: equal if model, starts, records, noise, options and versions are."""
        noise = self.noise_model
        identity = [
            *identify(job.model),
            [sorted(s.items()) for s in job.starts],
            job.keep,
            job.iterations,
            job.refines,
            sorted(job.beginning.items()),
            [e.identity for e in self.experiments],
            noise.std.tolist(),
            [c.reflection for c in noise.colour],
            sorted(asdict(self.options).items()),
            sorted(read_versions().items()),
        ]
        return hashlib.sha256(repr(identity).encode()).hexdigest()[:32]


def share_values(fitted: Model, model: Model) -> dict[str, float]:
    """The constants of ``fitted`` that ``model`` has too."""
    return {n: value for n, value in fitted.values.items() if n in model.values}


def _initial_states(candidate: FittedCandidate | None) -> dict[str, tuple[float, ...]]:
    """The value of each state at the first row of each record, as a refit ended."""
    if candidate is None:
        return {}
    columns = candidate.variables.initial.guess.T.tolist()
    return dict(zip(candidate.model.system.state_names, map(tuple, columns), strict=True))


def with_initial_states(problem: EstimationProblem, values: Mapping[str, Sequence[float]]) -> EstimationProblem:
    """The same problem with another first guess of some initial states."""
    guess = problem.variables.initial.guess.copy()
    for j, name in enumerate(problem.model.system.state_names):
        if name in values:
            guess[:, j] = values[name]
    initial = replace(problem.variables.initial, guess=guess)
    return replace(problem, variables=replace(problem.variables, initial=initial))


def _from_solution(model: Model, solution: Solution, given: tuple[str, ...]) -> FittedCandidate:
    variables, evaluation = solution.variables, solution.evaluation
    values = dict(zip(model.values, map(float, variables.fixed), strict=True))
    return FittedCandidate(
        model.start(**values),
        evaluation.cost,
        evaluation.count,
        variables.size,
        solution.problem,
        variables,
        evaluation,
        given,
    )


def _promised_cost(solution: Solution) -> float:
    """The cost that a further Gauss-Newton step promises."""
    evaluation = solution.evaluation
    if not np.isfinite(evaluation.cost):
        return np.inf
    return evaluation.cost - evaluation.predicted_decrease(*solution.variables.bounds())


def _rank_starts(problem: EstimationProblem, starts: Sequence[StartValues], options: FitOptions) -> list[_Start]:
    """The starts from which the model can be simulated, most promising first: by the cost that one step promises."""
    start_cost = StartCost(problem, options)
    points = [(start_cost.predict(v), v) for v in map(problem.variables.start_at, starts)]
    return sorted((point for point in points if np.isfinite(point[0])), key=lambda point: point[0])
