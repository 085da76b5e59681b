"""A fit before it starts: records, weights, unknowns and one discrete step; how it is solved, and what a search ends with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from greybox.base import Finding, Severity
from greybox.data.experiment import Experiment
from greybox.data.noise import AutoRegression, GrowingNoise, NoiseModel
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import DEFAULT_POLICY, EstimationPolicy, RobustLoss
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.shooting_cost import Evaluation, PlantShooting, SingleShooting, WhitenedShooting
from greybox.model import Model
from greybox.simulation.integrators.discretisation import ADAPTIVE, choose_implicit_method, discretise
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import Kernel
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant_kernel import PlantKernel

# Rows of a record that a part of it has at least.
LEAST_PART_ROWS = 50


@dataclass(frozen=True)
class EstimationProblem:
    """Everything a fit needs, in plain arrays.

    ``loss``: None for least squares. ``constant_outputs``: outputs that were left out because they read the same in every row.
    ``policy``: the numbers it was laid out by, and that what is made of it goes by. ``written_out``: its step is one that a filter takes.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    records: tuple[Record, ...]
    noise: NoiseModel
    variables: DecisionVector
    step: Step
    kernel: Kernel
    method: str
    loss: RobustLoss | None = None
    constant_outputs: tuple[str, ...] = ()
    policy: EstimationPolicy = DEFAULT_POLICY
    written_out: bool = False

    def shooting(self, variables: DecisionVector | None = None, share: float = 1.0) -> SingleShooting:
        """The cost of free runs over the first ``share`` of every record, for its own variables or others.

        Whitened where the noise is known to be coloured, with the ``loss``.
        """
        base = variables or self.variables, self.step, self.kernel, self.records, 1 / self.noise.std, share
        if isinstance(self.kernel, PlantKernel):
            return PlantShooting(*base, colour=self.noise.colour, loss=self.loss)
        if self.loss is None and not self.is_whitened:
            return SingleShooting(*base)
        return WhitenedShooting(*base, colour=self.noise.colour, loss=self.loss)

    def over_part(self, share: float) -> EstimationProblem:
        """The same over the first ``share`` of every record, and some rows of it at least."""
        records = []
        for record in self.records:
            samples = max(round(share * len(record.u)), LEAST_PART_ROWS) // record.rows_per_sample
            records.append(record.first(min(samples * record.rows_per_sample, len(record.u))))
        return replace(self, records=tuple(records))

    @property
    def is_whitened(self) -> bool:
        """Whether errors are more than divided by the noise of their output: of noise with a colour, or of another size in each row."""
        return self.noise.coloured or any(r.spread is not None or r.log_std is not None for r in self.records)

    @property
    def is_plain_squares(self) -> bool:
        """Whether the cost is the sum of squared errors over white noise of one size, and of nothing else."""
        return self.loss is None and not self.is_whitened and not self.variables.has_prior.any()

    def with_white_noise(self) -> EstimationProblem:
        """The same with the noise taken to be white."""
        return replace(self, noise=replace(self.noise, colour=tuple(AutoRegression() for _ in self.noise.colour)))

    def with_plain_squares(self) -> EstimationProblem:
        """The same with the noise taken to be white and of one size for each output, and no other loss than squares."""
        records = tuple(replace(record, spread=None, log_std=None) for record in self.records)
        return replace(self.with_white_noise(), records=records, loss=None)

    @property
    def left_out(self) -> dict[str, int]:
        """How many readings that the experiments have the search does not see, by output."""
        left_out = {
            o.name: sum(
                int(np.isfinite(e.outputs[o.name]).sum() - np.isfinite(r.samples(r.y)[:, j]).sum())
                for e, r in zip(self.experiments, self.records, strict=True)
                if o.name in e.outputs
            )
            for j, o in enumerate(self.model.outputs)
            if o.name not in self.constant_outputs
        }
        return {name: count for name, count in left_out.items() if count}

    def with_growing_noise(self, growth: Mapping[str, GrowingNoise], runs: Sequence[np.ndarray]) -> EstimationProblem:
        """The same with noise that grows with the signal as ``growth`` says, of the runs (N, ny) of its records; all of it has values."""
        names, std = self.noise.outputs, self.noise.std.copy()
        spreads = [
            np.ones((len(r.samples(r.y)), len(names))) if r.spread is None else r.spread.copy() for r in self.records
        ]
        log_std = np.full(len(names), np.nan)
        for j, name in enumerate(names):
            if name not in growth:
                continue
            sizes = [growth[name].std(run[:, j]) for run in runs]
            measured = [np.isfinite(r.samples(r.y)[:, j]) for r in self.records]
            together = np.concatenate([s[m] for s, m in zip(sizes, measured, strict=True)])
            std[j] = np.sqrt(np.mean(together**2)) if len(together) else 1.0
            if growth[name].logarithmic:
                log_std[j] = growth[name].share
                continue
            for spread, size in zip(spreads, sizes, strict=True):
                spread[:, j] = size / std[j]
        has_logarithms = bool(np.isfinite(log_std).any())
        records = tuple(
            replace(r, spread=spread, log_std=log_std if has_logarithms else None)
            for r, spread in zip(self.records, spreads, strict=True)
        )
        return replace(self, records=records, noise=replace(self.noise, std=std, growth=dict(growth)))

    @property
    def variance_floor(self) -> np.ndarray | None:
        """What the loss leaves of the variance of known noise, by output (ny,); None for least squares."""
        return None if self.loss is None else self.loss.least()

    @property
    def start_parameters(self) -> np.ndarray:
        """The parameters (np,) at the present point, without any experiment's own."""
        return self.variables.parameters(self.variables.here)

    def with_step(self, substeps: int, p: np.ndarray) -> EstimationProblem:
        """The same with a step made anew: another method, or another number of substeps (0 to choose)."""
        lengths, no_states = (
            np.unique(np.concatenate([r.lengths for r in self.records])),
            np.zeros((0, self.model.system.x.numel())),
        )
        policy = self.policy.discretisation
        step = discretise(
            self.model.system,
            p,
            no_states,
            lengths,
            method=self.method,
            substeps=substeps,
            rows=0 if self.model.noisy_states else sum(len(r.u) for r in self.records),
            directions=self.variables.size,
            written_out=self.written_out,
            policy=policy,
        )
        return replace(self, step=step, kernel=make_kernel(step, self.variables.which))

    def with_substeps(self, substeps: int) -> EstimationProblem:
        """The same step, repeated more often: nothing is compiled. A delayed input is cut differently, so its step is made anew."""
        if self.step.past is not None:
            return self.with_step(substeps, self.variables.fixed)
        step = replace(self.step, substeps=substeps)
        return replace(self, step=step, kernel=self.kernel.with_substeps(substeps))

    def with_steps_of(self, other: EstimationProblem) -> EstimationProblem:
        """The same with the steps of another problem of its model."""
        return replace(self, method=other.method, step=other.step, kernel=other.kernel)

    def with_stable_steps(self) -> EstimationProblem:
        """The same with steps that follow the error in place of implicit ones of one length, where the model is smooth."""
        method = choose_implicit_method(self.model.system, written_out=self.written_out)
        if method != ADAPTIVE or self.step.adaptive:
            return self
        return replace(self, method=method).with_step(0, self.start_parameters)

    def halve_step(self) -> EstimationProblem:
        """The same with half the step."""
        return self.with_substeps(2 * self.step.substeps)


# A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration.


@dataclass(frozen=True)
class FitProgress:
    """Where a running fit is: stage ``stage`` of ``stages`` (a growing part of the record), iteration, misfit over noise."""

    stage: int
    stages: int
    iteration: int
    noise_ratio: float


FitProgressCallback = Callable[[FitProgress], bool | None]
"""Called after each iteration of a fit; one that returns True ends the fit there, as one that was interrupted."""


class ProgressMonitor:
    """Called with the number of each iteration and its cost, over the first ``share`` of the records; whether to ``stop``."""

    def __init__(
        self,
        problem: EstimationProblem,
        report: FitProgressCallback | None,
        share: float = 1.0,
        stage: int = 1,
        stages: int = 1,
    ) -> None:
        self.report, self.stop, self.stage, self.stages = report, False, stage, stages
        parts = (r.y[: round(share * len(r.u))] for r in problem.records)
        self.count = max(sum(int(np.isfinite(y).sum()) for y in parts), 1) if report else 1

    def __call__(self, iteration: int, cost: float) -> bool:
        """Report where the search is; whether to end it."""
        if self.report and self.report(
            FitProgress(self.stage, self.stages, iteration, float(np.sqrt(cost / self.count)))
        ):
            self.stop = True
        return self.stop


# Codes of what a transcription and a solution say about themselves.


class TranscriptionReason(StrEnum):
    """Why a transcription suits a model and its record."""

    STABLE = "transcription_stable"
    """Neither unstable, nor stiff, nor integrating."""

    UNSTABLE = "transcription_unstable"
    """Errors grow along the record. Values: ``rate`` (1/s), ``exponent`` (over the record), ``duration`` (s)."""

    STIFF_IMPLICIT = "transcription_stiff_implicit"
    """A fast mode, which implicit steps follow. Values: ``fastest`` (s), ``substeps`` (explicit ones in a sample)."""

    FREE_RUN_FOLLOWS = "transcription_free_run_follows"
    """A fast mode, and errors that grow; yet a free run gains what its slopes promise. Values: those of both."""

    STIFF_NOT_SMOOTH = "transcription_stiff_not_smooth"
    """A fast mode, too many states for implicit steps, and equations that collocation cannot take. Values as before."""

    STIFF_LONG = "transcription_stiff_long"
    """A fast mode, too many states for implicit steps, and a record too long for collocation. Values as before, and ``samples``."""

    STIFF_COLLOCATION = "transcription_stiff_collocation"
    """A fast mode and too many states for implicit steps: collocation takes it. Values as before."""

    INTEGRATING_SHORT = "transcription_integrating_short"
    """An integrator whose drift stays near the data. Values: ``duration`` (s), ``time_constants`` (of the slowest other mode, or None)."""

    INTEGRATING_GROWING = "transcription_integrating_growing"
    """An integrator; a growing part of the record keeps the run near the data. Values as before."""


class SolutionCode(StrEnum):
    """What a solution says about itself."""

    SEARCH_STRATEGY = "search_strategy"
    """How it was searched for: the transcription, what it was made of, and why it was chosen."""


# Two arrays for each record: outputs and states, or residuals and their Jacobian.
Runs = Sequence[tuple[np.ndarray, np.ndarray]]


class Completion(StrEnum):
    """How a fit went on where its way of solving led to no optimum, or minimises less than was asked for."""

    NONE = ""
    FREE_RUN = "free_run"
    """By a free run from the optimum of the segments."""

    WHITE_NOISE = "white_noise"
    """With the noise taken as white, as a free run does not follow this plant."""

    WENT_ON = "went_on"
    """By single shooting from the best point: the search failed, or its start was better than its end."""


def make_strategy(transcription: str, **values: object) -> Finding:
    """How a fit searched; ``values`` depend on the transcription, see `greybox.show.sentences.estimation`."""
    return Finding(SolutionCode.SEARCH_STRATEGY, Severity.NOTE, transcription, values)


@dataclass(frozen=True)
class SegmentedRun:
    """A run that is more than one simulation from an initial state: segments, joined or not, or collocated points.

    For each record ``runs`` are outputs (N, ny) and states (N, nx); ``rows`` the weighted residuals (N, ny) and their Jacobian
    (N, ny, L) along `DecisionVector.columns`, every state at its best for the constants (the columns of the initial states are zero);
    ``unknowns`` how many numbers were estimated, states included; ``shift`` (nf,) the change of the constants in ``z`` with half
    the step.
    """

    runs: Runs
    rows: Runs
    unknowns: int
    shift: np.ndarray


# A free run from the initial states is that of the segments if it differs by at most this share of the noise anywhere.
FREE_RUN_NOISE_SHARE = 0.1


@dataclass(frozen=True)
class Solution:
    """The optimum: ``variables`` with ``z = 0`` there, the evaluation, how it ended, and the work it took.

    ``shares`` of the record that were fitted one after the other; ``integration_error`` of each output over its noise (ny,);
    ``transcription`` what was used, ``strategy`` what was chosen, and why. ``joined`` is None where the model ran freely from each
    initial state. ``discretisation`` is empty where it is the step of the problem. ``solver``: which solvers ran over whole records.
    """

    problem: EstimationProblem
    variables: DecisionVector
    evaluation: Evaluation
    status: TerminationStatus
    solver_status: str
    iterations: int
    evaluations: int
    seconds: float
    shares: tuple[float, ...]
    integration_error: np.ndarray
    strategy: Finding = field(default_factory=lambda: make_strategy("single"))
    transcription: str = "single"
    joined: SegmentedRun | None = None
    discretisation: str = ""
    solver: str = ""

    @property
    def at_optimum(self) -> EstimationProblem:
        """The problem with its present point at the optimum."""
        return replace(self.problem, variables=self.variables)

    @property
    def unknowns(self) -> int:
        """How many numbers were estimated."""
        return self.joined.unknowns if self.joined else self.variables.size

    @property
    def is_single(self) -> bool:
        """Whether each record was run freely from its initial state."""
        return self.transcription == "single"

    @property
    def is_run(self) -> bool:
        """Whether the cost is that of a run: of segments that end where the next one begins, if it is more than one."""
        return True

    def with_work_of(self, earlier: Solution) -> Solution:
        """The same with the work of the search that it began from."""
        return replace(
            self,
            iterations=self.iterations + earlier.iterations,
            evaluations=self.evaluations + earlier.evaluations,
            seconds=self.seconds + earlier.seconds,
            solver=self.solver or earlier.solver,
        )

    def with_strategy(self, **values: object) -> Solution:
        """The same with more to say of how it was searched."""
        return replace(self, strategy=replace(self.strategy, values={**self.strategy.values, **values}))

    def is_free_run(self) -> bool:
        """Whether one simulation from each initial state gives the run, to a share of the noise."""
        if not self.joined:
            return True
        free = self.problem.shooting(self.variables).simulate(self.variables.here)
        pairs = zip(free, self.joined.runs, strict=True)
        # Wherever it differs by more than a share of the noise, a free run would be another statement.
        away = np.concatenate([(a - b) / self.problem.noise.std for (a, _), (b, _) in pairs])
        return bool(np.all(np.abs(away) < FREE_RUN_NOISE_SHARE))

    def simulate(self) -> Runs:
        """For each record outputs (N, ny) and states (N, nx) of the model at the optimum."""
        if self.joined:
            return self.joined.runs
        return tuple(self.problem.shooting(self.variables).simulate(self.variables.here))

    def linearise(self) -> tuple[Runs, Runs]:
        """`simulate`, of the states the first row at least, and `residuals`."""
        if self.joined:
            return self.joined.runs, self.residuals()
        return self.problem.shooting(self.variables).linearise(self.variables.here)

    def residuals(self) -> Runs:
        """For each record the weighted residuals (N, ny) of its samples and their Jacobian (N, ny, L) at the optimum."""
        if self.joined:
            pairs = zip(self.problem.records, self.joined.rows, strict=True)
            return tuple((_samples(record, r), _samples(record, jacobian)) for record, (r, jacobian) in pairs)
        return tuple(self.problem.shooting(self.variables).residuals(self.variables.here))


def _samples(record: Record, values: np.ndarray) -> np.ndarray:
    """The samples among values that are there for every row of ``record``."""
    return record.samples(values) if len(values) == len(record.u) else values
