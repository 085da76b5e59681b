"""Many refits: in this process, in others or on a cluster, each kept in a journal so that an interrupted run resumes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from greybox.base.errors import FitError, GreyboxError, is_numerical, is_raised_here
from greybox.base.files import add_entry, read_journal
from greybox.base.interrupts import hold_interrupts
from greybox.base.json_file import find_offence
from greybox.base.json_shape import FileKind, Finite, from_json_data, to_json_data
from greybox.base.parallel.jobs import JobResult, run_jobs
from greybox.base.parallel.local_pool import count_cores, open_local_pool
from greybox.base.values import Finding
from greybox.model.model import Model

# What failed during a search, and why. A candidate or a stage that fails is out; the search goes on and the reason is kept.

Result = TypeVar("Result")
Fallback = TypeVar("Fallback")

# The reason of a model that runs to infinity from every starting point: no error states it.
NOT_SIMULATED = ""


class SearchStage(StrEnum):
    """Where something failed."""

    PREPARATION = "preparation"
    """An effect has no place in the model, or its starting points cannot be computed."""
    SCREENING = "screening"
    """The cost of a model cannot be predicted."""
    REFIT = "refit"
    """A model cannot be fitted."""
    SHAPE_CORRECTION = "shape_correction"
    """The shape of an effect cannot be corrected."""
    HOLDOUT = "holdout"
    """A model cannot be simulated on the validation records."""
    LOCALISATION = "localisation"
    """Where and when a model falls short cannot be estimated."""
    SURROGATE = "surrogate"
    """No curve or tone can be fitted."""
    EVIDENCE = "evidence"
    """A rival of an answer cannot be fitted, or what one rests on cannot be estimated."""
    WEIGHING = "weighing"
    """An answer cannot be weighed against its rivals."""
    FALSE_NAMES = "false_names"
    """How often signals without meaning are established cannot be measured."""
    LAWS = "laws"
    """No equation can be looked for."""


@dataclass(frozen=True)
class SearchFailure:
    """One failure.

    Parameters
    ----------
    stage
        Of the search.
    effects
        Those of the model that failed.
    reason
        As the error states it.
    """

    stage: SearchStage
    effects: tuple[str, ...]
    reason: str


@dataclass
class FailureLog:
    """Failures of a search in the order in which they happened, each model once a stage."""

    entries: dict[tuple[SearchStage, frozenset[str]], SearchFailure] = field(default_factory=dict)

    def add(self, stage: SearchStage, effects: tuple[str, ...], reason: str) -> None:
        """Keep one, unless the same model failed in the same stage before."""
        self.entries.setdefault((stage, frozenset(effects)), SearchFailure(stage, effects, reason))

    def find(self, stage: SearchStage, effects: tuple[str, ...]) -> SearchFailure | None:
        """The failure of a model in a stage; None where it has not failed."""
        return self.entries.get((stage, frozenset(effects)))

    def replace(self, failure: SearchFailure) -> None:
        """Keep a failure with more to say of it."""
        self.entries[failure.stage, frozenset(failure.effects)] = failure

    def attempt(
        self, stage: SearchStage, effects: tuple[str, ...], run: Callable[[], Result], fallback: Fallback
    ) -> Result | Fallback:
        """``run()``, or ``fallback`` where a model, a solver or a compiler fails: one candidate must not end the search.

        An error of any other kind is a bug of this library, which ends the run: it must not turn a name into *unknown*.
        """
        try:
            return run()
        except Exception as error:
            # While a candidate is prepared, functions of an effect that a user wrote run: they may raise anything.
            is_of_user = stage is SearchStage.PREPARATION and not is_raised_here(error)
            if not (is_of_user or is_numerical(error)):
                raise
            self.add(stage, effects, reason_of(error))
            return fallback

    def of_single_effects(self) -> Mapping[str, str]:
        """The reason by effect for every effect that could not be prepared or fitted alone."""
        return {
            failure.effects[0]: failure.reason
            for failure in self.entries.values()
            if len(failure.effects) == 1 and failure.stage in (SearchStage.PREPARATION, SearchStage.REFIT)
        }


def reason_of(error: Exception) -> str:
    """What an error states in one line; with its kind where the library did not raise it on purpose."""
    text = " ".join(str(error).split())
    return text if isinstance(error, GreyboxError) else f"{type(error).__name__}: {text}"


@dataclass(frozen=True)
class RefitJob:
    """One refit: ``model`` from the ``keep`` most promising of ``starts``, ``iterations`` at most.

    ``beginning`` holds the first guess of initial states by name, one value a record; the others start as model and record say. Whether
    ``refines`` says that the integration step may become finer on the way: a look at a model that may be hopeless need not.
    """

    model: Model
    starts: tuple[Mapping[str, float], ...]
    keep: int
    iterations: int
    beginning: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    refines: bool = True


@dataclass(frozen=True)
class RefitOutcome:
    """Where a refit ended.

    Parameters
    ----------
    values
        Parameter -> value.
    initial
        The initial state of each record (records, nx).
    substeps
        Those it was integrated with; 0 for those that the model starts with.
    """

    values: Mapping[str, Finite]
    initial: tuple[tuple[Finite, ...], ...]
    substeps: int = 0


@dataclass(frozen=True)
class RefitEntry:
    """One line of ``journal.jsonl``: a finished refit.

    Parameters
    ----------
    key
        Hash of model, start, records, noise, options and versions.
    outcome
        Where it ended; None where the model cannot be simulated.
    """

    key: str
    outcome: RefitOutcome | None

    FILE: ClassVar[FileKind] = FileKind("a journal entry", "journal.jsonl that greybox discover has written", None)


@dataclass
class RefitJournal:
    """Finished refits in a file, one JSON object a line, by a hash of model, starts, records, noise, options and versions.

    ``reused`` counts the refits that were taken from it; ``findings`` say which lines were lost.

    Raises
    ------
    DataError
        If the file is no journal.
    """

    path: Path
    known: dict[str, RefitOutcome | None] = field(init=False, default_factory=dict)
    reused: int = field(init=False, default=0)
    findings: tuple[Finding, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        content = read_journal(self.path, _parse_entry)
        self.known, self.findings = dict(content.entries), content.findings

    def add(self, key: str, outcome: RefitOutcome | None) -> None:
        """Keep one more, on disk at once."""
        self.known[key] = outcome
        add_entry(self.path, to_json_data(RefitEntry(key, outcome)))


class RefitProblem(Protocol):
    """What an executor needs of the problem that it refits for."""

    @property
    def failures(self) -> FailureLog:
        """Where jobs that fail are kept."""

    def refit(self, job: RefitJob, /) -> Any:
        """The fitted candidate of one job; None if it cannot be simulated from any start."""

    def to_outcome(self, candidate: Any, /) -> RefitOutcome:
        """What must be kept of a candidate to restore it."""

    def restore(self, model: Model, outcome: RefitOutcome, /) -> Any:
        """The candidate of an earlier refit."""

    def to_portable(self) -> RefitProblem:
        """The same problem for another process."""

    def job_key(self, job: RefitJob, /) -> str:
        """The hash by which a refit is known."""


# Expected seconds of refits from which starting processes pays.
PARALLEL_SECONDS = 20.0
# Seconds that the answer may be fitted on for where the search took less: a model of many heights that follows nothing, with steps that
# become ever smaller, would go on for a thousand times as long.
FINISHING_SECONDS = 60.0


@dataclass
class RefitExecutor:
    """Where refits run, and where they are kept.

    Parameters
    ----------
    executor
        Any `concurrent.futures.Executor`; None for this machine.
    workers
        Processes on this machine; 0 for one a core.
    journal
        Keeps every finished refit; None for none.
    report
        Called after each refit with the number of finished ones.
    parallel_seconds
        Expected seconds of refits from which starting processes pays.
    deadline, last_deadline
        Values of ``time.perf_counter()`` after which no refit begins: while effects are looked for, and in all. ``skipped`` counts
        those that did not.
    """

    executor: Executor | None = None
    workers: int = 0
    journal: RefitJournal | None = None
    report: Callable[[int], None] | None = None
    parallel_seconds: float = PARALLEL_SECONDS
    deadline: float = math.inf
    last_deadline: float = math.inf
    finished: int = field(init=False, default=0)
    skipped: int = field(init=False, default=0)
    seconds: list[float] = field(init=False, default_factory=list)
    began: float = field(init=False, default_factory=time.perf_counter)
    _pools: ExitStack = field(init=False, default_factory=ExitStack)

    def run(self, problem: RefitProblem, jobs: Sequence[RefitJob]) -> list[Any]:
        """Each job as a fitted candidate of ``problem``; None for one that cannot be fitted, with the reason in ``problem.failures``.

        Raises
        ------
        FitError
            If every job failed in other processes.
        KeyboardInterrupt
            If the user interrupted a refit.
        """
        keys = [self._key(problem, job) for job in jobs]
        results: list[Any] = [None] * len(jobs)
        remaining = []
        for k, (key, job) in enumerate(zip(keys, jobs, strict=True)):
            if self.journal and key in self.journal.known:
                self.journal.reused += 1
                results[k] = self._restore(problem, job, self.journal.known[key])
            else:
                remaining.append(k)
        if len(remaining) > 1 and self._parallel_pays(len(remaining)):
            self._run_in_parallel(problem, jobs, keys, remaining, results)
            return results
        with hold_interrupts() as interrupt:
            for k in remaining:
                if self.is_late:
                    self.skipped += 1
                    continue
                began = time.perf_counter()
                results[k] = _attempt(problem, jobs[k], partial(problem.refit, jobs[k]))
                self.seconds.append(time.perf_counter() - began)
                self._keep(keys[k], results[k] and problem.to_outcome(results[k]))
                if interrupt.requested:
                    raise KeyboardInterrupt
        return results

    @property
    def is_late(self) -> bool:
        """Whether no refit may begin any more."""
        return time.perf_counter() >= self.deadline

    def limit_finishing(self) -> float:
        """When a fit of the answer that begins now has to be done: it may take as long as the search took, and no time limit passes."""
        now = time.perf_counter()
        return min(self.last_deadline, now + max(FINISHING_SECONDS, now - self.began))

    def release_reserve(self) -> None:
        """From now on refits may begin until the last deadline."""
        self.deadline = self.last_deadline

    def _key(self, problem: RefitProblem, job: RefitJob) -> str:
        """The key of a job in the journal; empty where there is none, or the job fails already here."""
        return (self.journal and _attempt(problem, job, partial(problem.job_key, job))) or ""

    def _restore(self, problem: RefitProblem, job: RefitJob, outcome: RefitOutcome | None) -> Any:
        if outcome is None:
            problem.failures.add(SearchStage.REFIT, _effects(job), NOT_SIMULATED)
            return None
        return _attempt(problem, job, partial(problem.restore, job.model, outcome))

    @contextmanager
    def open(self) -> Iterator[RefitExecutor]:
        """Ends processes that were started meanwhile; until then BLAS has one thread, as in every process for refits.

        The matrices are small: a pool of threads costs more than it does, and takes the cores from the processes.
        """
        with self._pools, threadpool_limits(1, "blas"):
            yield self

    def _parallel_pays(self, jobs: int) -> bool:
        if self.executor is not None:
            return True
        processes = self.workers or count_cores()
        usual = float(np.median(self.seconds)) if self.seconds else 0.0
        if processes < 2 or jobs * usual < self.parallel_seconds:
            return False
        self.executor = self._pools.enter_context(open_local_pool(processes))
        return True

    def _run_in_parallel(
        self,
        problem: RefitProblem,
        jobs: Sequence[RefitJob],
        keys: Sequence[str],
        remaining: Sequence[int],
        results: list[Any],
    ) -> None:
        def keep(number: int, result: JobResult) -> None:
            if not result.error:
                self._keep(keys[remaining[number]], result.value)

        done, interrupted = run_jobs(
            _refit_elsewhere,
            problem.to_portable(),
            [jobs[k] for k in remaining],
            executor=self.executor,
            workers=self.workers,
            receive=keep,
            deadline=self.deadline,
        )
        errors = []
        for k, result in zip(remaining, done, strict=True):
            if result is None:
                self.skipped += 1
                continue
            if result.error:
                errors.append(f"{jobs[k].model.title}: {result.error}")
                problem.failures.add(SearchStage.REFIT, _effects(jobs[k]), result.error)
                continue
            results[k] = self._restore(problem, jobs[k], result.value)
        if interrupted:
            raise KeyboardInterrupt
        if errors and len(errors) == len(remaining):  # no candidate's fault: the processes
            raise FitError(f"refits failed: {'; '.join(errors)}")

    def _keep(self, key: str, outcome: RefitOutcome | None) -> None:
        self.finished += 1
        if self.report:
            self.report(self.finished)
        if self.journal and key:
            self.journal.add(key, outcome)


def _attempt(problem: RefitProblem, job: RefitJob, run: Callable[[], Any]) -> Any:
    """``run()``; None where it fails, with the reason in the problem's log."""
    return problem.failures.attempt(SearchStage.REFIT, _effects(job), run, None)


def _effects(job: RefitJob) -> tuple[str, ...]:
    return tuple(e.name for e in job.model.effects)


def _refit_elsewhere(problem: RefitProblem, job: RefitJob) -> RefitOutcome | None:
    """One job, in another process."""
    candidate = problem.refit(job)
    return None if candidate is None else problem.to_outcome(candidate)


def _parse_entry(entry: Mapping[str, Any]) -> tuple[str, RefitOutcome | None]:
    """Key and outcome of a line of the journal. Raises ValueError."""
    offence = find_offence(entry, RefitEntry)
    if offence:
        raise ValueError(offence)
    read = from_json_data(RefitEntry, entry)
    return read.key, read.outcome
