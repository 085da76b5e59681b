"""What a search ends with: the constants, how it ended, how it was searched, and the model's run as the transcription has it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from greybox.base.findings import Finding, Severity
from greybox.estimation.optim.minimisation import TerminationStatus, stop_on_interrupt
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.estimation.transcription.simulation_error import Evaluation
from greybox.simulation.kernel.record import Record

# A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration.


@dataclass(frozen=True)
class FitProgress:
    """Where a running fit is: stage ``stage`` of ``stages`` (a growing part of the record), iteration, misfit over noise."""

    stage: int
    stages: int
    iteration: int
    noise_ratio: float


FitProgressCallback = Callable[[FitProgress], None]


class ProgressMonitor:
    """Called with the number of each iteration and its cost; whether to ``stop``."""

    def __init__(self, problem: EstimationProblem, report: FitProgressCallback | None) -> None:
        self.report, self.stop = report, False
        self.count = max(sum(int(np.isfinite(r.y).sum()) for r in problem.records), 1)

    def __call__(self, iteration: int, cost: float) -> bool:
        """Report where the search is; whether to end it."""
        if self.report:
            self.report(FitProgress(1, 1, iteration, float(np.sqrt(cost / self.count))))
        return self.stop


@contextmanager
def monitor_progress(problem: EstimationProblem, report: FitProgressCallback | None) -> Iterator[ProgressMonitor]:
    """A `ProgressMonitor` that hears Ctrl-C."""
    watch = ProgressMonitor(problem, report)
    with stop_on_interrupt(watch):
        yield watch


# Codes of what a transcription and a solution say about themselves.


class TranscriptionReason(StrEnum):
    """Why a transcription suits a model and its record."""

    STABLE = "transcription_stable"
    """Neither unstable, nor stiff, nor integrating."""

    UNSTABLE = "transcription_unstable"
    """Errors grow along the record. Values: ``rate`` (1/s), ``exponent`` (over the record), ``duration`` (s)."""

    STIFF_IMPLICIT = "transcription_stiff_implicit"
    """A fast mode, which implicit steps follow. Values: ``fastest`` (s), ``substeps`` (explicit ones in a sample)."""

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
    """How a fit by segments or collocation points was completed where the cost is more than plain squares."""

    NONE = ""
    FREE_RUN = "free_run"
    """By a free run from the optimum of the segments."""

    WHITE_NOISE = "white_noise"
    """With the noise taken as white, as a free run does not follow this plant."""


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
