"""The bench: one set of records on which many models are tried, each from several starts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from greybox.discovery.execution import RefitExecutor, RefitJob, RefitOutcome
from greybox.estimation import FitOptions
from greybox.estimation.problem import EstimationProblem, prepare_problem
from greybox.estimation.solve import Solution, solve
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.noise import AutoRegression, NoiseModel
from greybox.optim import TerminationStatus
from greybox.result import Fit
from greybox.transcription import DecisionVector, Evaluation

StartValues = Mapping[str, float]

# Iterations of one refit: what has not converged by then is not the answer, or is finished in the last fit.
ITERATIONS = 60
# A start whose curvature is beyond this is next to an overflow.
HUGE = 1e100


@dataclass(frozen=True)
class CandidateFit:
    """A model refitted: ``cost`` is the sum of squared whitened residuals over ``count`` samples, ``free`` the number of constants."""

    model: Model
    cost: float
    count: int
    free: int
    problem: EstimationProblem
    variables: DecisionVector
    evaluation: Evaluation

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the model."""
        return tuple(e.name for e in self.model.effects)

    @property
    def per_sample(self) -> float:
        """Cost over the number of samples: 1 where only noise is left."""
        return self.cost / self.count

    @property
    def criterion(self) -> float:
        """Schwarz's criterion: cost plus ``ln(samples)`` for each free constant."""
        return self.cost + self.free * float(np.log(self.count))


@dataclass(frozen=True)
class DiscoveryProblem:
    """Records, noise and the plain model, with the start values it came with."""

    plain: Model
    experiments: tuple[Experiment, ...]
    noise: Mapping[str, float] | NoiseModel
    quiet: tuple[Experiment, ...]
    options: FitOptions
    refits: RefitExecutor = field(default_factory=RefitExecutor)

    @classmethod
    def of(cls, fit: Fit) -> DiscoveryProblem:
        """The records, noise and options of a finished fit; its constants are what the plain model comes with."""
        outputs = [o.name for o in fit.model.outputs]
        std = np.array([fit.noise.std.get(name, np.nan) for name in outputs])
        colour = tuple(AutoRegression(fit.noise.colour.get(name, ())) for name in outputs)
        noise = NoiseModel(tuple(outputs), std, fit.noise.sources, colour, False)
        options = FitOptions.from_data(fit.provenance.options)
        return cls(fit.model, tuple(t.experiment for t in fit.traces), noise, (), options)

    def at(self, fit: Fit) -> CandidateFit:
        """A finished fit as it stands, without another search."""
        problem = self.problem(fit.model)
        names = problem.model.system.state_names
        guess = np.array([[t.initial_state[name] for name in names] for t in fit.traces])
        variables = replace(problem.variables, initial=replace(problem.variables.initial, guess=guess))
        evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
        return CandidateFit(
            fit.model, evaluation.cost, evaluation.count, variables.size, problem, variables, evaluation
        )

    @cached_property
    def base(self) -> CandidateFit:
        """The plain model, fitted to a growing part of the record from its start values."""
        solution = solve(self.problem(self.plain), self.options)
        if solution.status is TerminationStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return _trial(self.plain, solution)

    def problem(self, model: Model, experiments: tuple[Experiment, ...] | None = None) -> EstimationProblem:
        """The records (or others) as a fit of ``model`` sees them; the noise is looked at once."""
        known = self.noise if model is self.plain or isinstance(self.noise, NoiseModel) else self._noise
        return prepare_problem(
            model, experiments or self.experiments, known, at_rest=self.options.at_rest, method=self.options.method,
            substeps=self.options.substeps, quiet=self.quiet,
        )  # fmt: skip

    @property
    def known_noise(self) -> NoiseModel:
        """The noise as it was given, or as the base fit looked at it."""
        return self.noise if isinstance(self.noise, NoiseModel) else self._noise

    @cached_property
    def _noise(self) -> NoiseModel:
        return self.base.problem.noise

    @property
    def noise_std(self) -> dict[str, float]:
        """Noise standard deviation of each measured output."""
        measured = {name for e in self.experiments for name in e.outputs}
        pairs = zip(self.plain.outputs, self._noise.std, strict=True)
        return {o.name: float(std) for o, std in pairs if o.name in measured}

    def best(
        self,
        model: Model,
        starts: Iterable[StartValues],
        keep: int = 2,
        iterations: int = ITERATIONS,
        like: CandidateFit | None = None,
    ) -> CandidateFit | None:
        """``model`` refitted from the most promising ``keep`` of ``starts``; None where none of them can be simulated.

        The records begin as in the trial ``like``, where that has the state.
        """
        return self.every([RefitJob(model, tuple(starts), keep, iterations, _beginning(like))])[0]

    def every(self, jobs: Sequence[RefitJob]) -> list[CandidateFit | None]:
        """Independent refits, wherever they are done."""
        return self.refits.run(self, jobs)

    def refitted(self, job: RefitJob) -> CandidateFit | None:
        """One refit, here and now. Raises KeyboardInterrupt where the user ended it."""
        problem = _beginning_as(self.problem(job.model), job.beginning)
        ranked = sorted(
            (point for s in job.starts if (point := _promise(problem, s)) is not None), key=lambda point: point[0]
        )
        options = replace(self.options, progressive=False, thorough=False, iterations=job.iterations)
        solutions = [solve(replace(problem, variables=v), options) for _, v in ranked[: job.keep]]
        if any(s.status is TerminationStatus.INTERRUPTED for s in solutions):
            raise KeyboardInterrupt
        finite = [t for t in (_trial(job.model, s) for s in solutions) if np.isfinite(t.cost)]
        return min(finite, key=lambda t: t.cost, default=None)

    def outcome(self, trial: CandidateFit) -> RefitOutcome:
        """What has to be known of a trial to have it again."""
        return RefitOutcome(trial.model.values, tuple(map(tuple, trial.variables.initial.guess.tolist())))

    def placed(self, model: Model, outcome: RefitOutcome) -> CandidateFit:
        """``model`` where a refit ended."""
        problem = self.problem(model.start(**outcome.values))
        variables = with_start_values(problem.variables, outcome.values)
        variables = replace(variables, initial=replace(variables.initial, guess=np.array(outcome.initial)))
        e = problem.shooting(variables).evaluate(np.zeros(variables.size))
        return CandidateFit(problem.model, e.cost, e.count, variables.size, problem, variables, e)

    def portable(self) -> DiscoveryProblem:
        """The same for another process: with the noise as it is known here, and without a journal or an executor."""
        return DiscoveryProblem(self.plain, self.experiments, self.known_noise, (), self.options)

    def promise(self, model: Model, starts: Iterable[StartValues], like: CandidateFit | None = None) -> float:
        """The lowest cost that a Gauss-Newton step from any of ``starts`` foresees; ``like`` as in `highest_ranks`."""
        problem = _beginning_as(self.problem(model), _beginning(like))
        return min((point[0] for s in starts if (point := _promise(problem, s)) is not None), default=np.inf)


def _beginning(trial: CandidateFit | None) -> dict[str, tuple[float, ...]]:
    """The value of each state at the first row of each record, of a finished trial."""
    if trial is None:
        return {}
    columns = trial.variables.initial.guess.T.tolist()
    return dict(zip(trial.model.system.state_names, map(tuple, columns), strict=True))


def _beginning_as(problem: EstimationProblem, beginning: Mapping[str, Sequence[float]]) -> EstimationProblem:
    """The same problem with another first guess of some initial states."""
    guess = problem.variables.initial.guess.copy()
    for j, name in enumerate(problem.model.system.state_names):
        if name in beginning:
            guess[:, j] = beginning[name]
    initial = replace(problem.variables.initial, guess=guess)
    return replace(problem, variables=replace(problem.variables, initial=initial))


def _trial(model: Model, solution: Solution) -> CandidateFit:
    variables, evaluation = solution.variables, solution.evaluation
    values = dict(zip(model.values, map(float, variables.fixed), strict=True))
    return CandidateFit(
        model.start(**values), evaluation.cost, evaluation.count, variables.size, solution.problem, variables, evaluation
    )  # fmt: skip


def _promise(problem: EstimationProblem, start: StartValues) -> tuple[float, DecisionVector] | None:
    """Cost foreseen from one start, and the variables there; None where the model cannot be simulated."""
    variables = with_start_values(problem.variables, start)
    e = problem.shooting(variables).evaluate(np.zeros(variables.size))
    if not (np.isfinite(e.cost) and np.abs(e.hessian).max(initial=0.0) < HUGE):
        return None
    low, high = variables.bounds()
    return e.cost - predict_decrease(e, low, high), variables


def predict_decrease(e: Evaluation, low: np.ndarray, high: np.ndarray) -> float:
    """Decrease of the cost by a Gauss-Newton step that stays within the bounds (variables that would leave are held)."""
    inside = np.ones(len(low), bool)
    for _ in range(3):
        step = np.zeros(len(low))
        gradient, hessian = e.gradient[inside], e.hessian[np.ix_(inside, inside)]
        step[inside] = -np.linalg.lstsq(hessian, gradient, rcond=1e-12)[0]
        leaving = inside & ((step < low) | (step > high))
        if not leaving.any():
            break
        inside &= ~leaving
        step[leaving] = 0.0
    return float(-(e.gradient @ step) - 0.5 * step @ e.hessian @ step)


def with_start_values(variables: DecisionVector, start: StartValues) -> DecisionVector:
    """The same variables with other values at ``z = 0``."""
    fixed = variables.fixed.copy()
    names = variables.model.system.parameter_names
    for name, value in start.items():
        fixed[names.index(name)] = value
    base = fixed[variables.which]
    scale = np.where(base == 0, variables.scale, np.abs(base))
    return replace(variables, fixed=fixed, base=base, scale=scale)
