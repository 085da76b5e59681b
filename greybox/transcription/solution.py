"""What a search ends with: the constants, how it ended, how it was searched, and the model's run as the transcription has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from greybox.findings import Finding, Severity
from greybox.kernel import Record
from greybox.optim import TerminationStatus
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.findings import SolutionCode
from greybox.transcription.policy import JoiningPolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.simulation_error import Evaluation

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
    """How a fit searched; ``values`` depend on the transcription, see `greybox.rendering.transcription`."""
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

    def is_free_run(self, policy: JoiningPolicy) -> bool:
        """Whether one simulation from each initial state gives the run, to a share of the noise."""
        if not self.joined:
            return True
        free = self.problem.shooting(self.variables).simulate(self.variables.here)
        pairs = zip(free, self.joined.runs, strict=True)
        away = np.concatenate([(a - b) / self.problem.noise.std for (a, _), (b, _) in pairs])
        return bool(np.all(np.abs(away) < policy.free_run_noise_share))

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
