"""Many refits: here, in other processes or on a cluster, each of them kept in a journal so that an interrupted search can go on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from greybox.errors import DataError, FitError
from greybox.estimation.versions import read_versions
from greybox.model import Model
from greybox.parallel import count_cores, open_local_pool, run_jobs

if TYPE_CHECKING:
    from greybox.discovery.problem import DiscoveryProblem

# Seconds of refits from which processes of their own pay for their start.
PAYS = 20.0


@dataclass(frozen=True)
class RefitJob:
    """One refit: ``model`` from the ``keep`` most promising of ``starts``, ``iterations`` at most.

    ``beginning``: first guess of states at the first row of each record, by name; of the others as the model and the record say.
    """

    model: Model
    starts: tuple[Mapping[str, float], ...]
    keep: int
    iterations: int
    beginning: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class RefitOutcome:
    """Where a refit ended: the values of all constants by name, and each record's initial state (experiments, nx)."""

    values: Mapping[str, float]
    initial: tuple[tuple[float, ...], ...]


@dataclass
class RefitJournal:
    """Finished refits in a file, one JSON object a line, by a hash of model, starts, records, noise, options and versions.

    ``reused`` counts those that were found in it. Raises DataError where the file is no journal.
    """

    path: Path
    known: dict[str, RefitOutcome | None] = field(init=False, default_factory=dict)
    reused: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
                self.known[entry["key"]] = _outcome(entry["outcome"])
            except (json.JSONDecodeError, KeyError, TypeError) as error:
                if number < len(lines):  # the last one may have been cut short when the power went
                    raise DataError(
                        f"{self.path}: line {number} is no finished refit ({error}); delete the file to begin anew"
                    ) from None

    def add(self, key: str, outcome: RefitOutcome | None) -> None:
        """Keep one more, on disk at once."""
        self.known[key] = outcome
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, "outcome": None if outcome is None else asdict(outcome)}) + "\n")


@dataclass
class RefitExecutor:
    """How refits are done: on an ``executor`` (None: this machine, on ``workers`` processes where that pays), with a ``journal`` or not.

    ``report`` is told after each how many are ``finished``.
    """

    executor: Executor | None = None
    workers: int = 0
    journal: RefitJournal | None = None
    report: Callable[[int], None] | None = None
    finished: int = field(init=False, default=0)
    seconds: list[float] = field(init=False, default_factory=list)
    _pools: ExitStack = field(init=False, default_factory=ExitStack)

    def run(self, bench: DiscoveryProblem, jobs: Sequence[RefitJob]) -> list[Any]:
        """Each job as a `CandidateFit` on ``bench``; None for one that no start could simulate.

        Raises FitError where another process failed, KeyboardInterrupt where the user ended a refit.
        """
        keys = [job_key(bench, job) if self.journal else "" for job in jobs]
        found: list[Any] = [None] * len(jobs)
        todo = []
        for k, (key, job) in enumerate(zip(keys, jobs, strict=True)):
            if self.journal and key in self.journal.known:
                self.journal.reused += 1
                outcome = self.journal.known[key]
                found[k] = None if outcome is None else bench.placed(job.model, outcome)
            else:
                todo.append(k)
        if len(todo) > 1 and self._pays(len(todo)):
            self._elsewhere(bench, jobs, keys, todo, found)
            return found
        for k in todo:
            began = time.perf_counter()
            found[k] = bench.refitted(jobs[k])
            self.seconds.append(time.perf_counter() - began)
            self._note(keys[k], found[k] and bench.outcome(found[k]))
        return found

    @contextmanager
    def open(self) -> Iterator[RefitExecutor]:
        """Ends processes that were started meanwhile."""
        with self._pools:
            yield self

    def _pays(self, jobs: int) -> bool:
        if self.executor is not None:
            return True
        processes = self.workers or count_cores()
        usual = float(np.median(self.seconds)) if self.seconds else 0.0
        if processes < 2 or jobs * usual < PAYS:
            return False
        self.executor = self._pools.enter_context(open_local_pool(processes))
        return True

    def _elsewhere(
        self,
        bench: DiscoveryProblem,
        jobs: Sequence[RefitJob],
        keys: Sequence[str],
        todo: Sequence[int],
        found: list[Any],
    ) -> None:
        done, interrupted = run_jobs(
            _refit, bench.portable(), [jobs[k] for k in todo], executor=self.executor, workers=self.workers
        )
        errors = []
        for k, result in zip(todo, done, strict=True):
            if result is None:
                continue
            if result.error:
                errors.append(f"{jobs[k].model.title}: {result.error}")
                continue
            self._note(keys[k], result.value)
            found[k] = None if result.value is None else bench.placed(jobs[k].model, result.value)
        if interrupted:
            raise KeyboardInterrupt
        if errors:
            raise FitError(f"refits failed: {'; '.join(errors)}")

    def _note(self, key: str, outcome: RefitOutcome | None) -> None:
        self.finished += 1
        if self.report:
            self.report(self.finished)
        if self.journal:
            self.journal.add(key, outcome)


def job_key(bench: DiscoveryProblem, job: RefitJob) -> str:
    """The hash by which a refit is known: equal where model, starts, records, noise, options and versions are."""
    system, noise = job.model.system, bench.known_noise
    said = [
        str(ca.vertcat(*map(ca.vec, system.free_run_expressions))), str(system.diffusion),
        [(q.name, q.value, q.bounds, q.fixed, q.prior) for q in job.model.all_parameters],
        [(s.name, s.bounds) for s in job.model.all_states],
        [sorted(s.items()) for s in job.starts], job.keep, job.iterations, sorted(job.beginning.items()),
        [e.hold for e in job.model.effects],  # the equations do not show it
        [(e.fingerprint, e.hold, sorted(e.conditions.items())) for e in bench.experiments],
        noise.std.tolist(), [c.reflection for c in noise.colour], sorted(asdict(bench.options).items()), sorted(read_versions().items()),
    ]  # fmt: skip
    return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


def _refit(bench: DiscoveryProblem, job: RefitJob) -> RefitOutcome | None:
    """One job, in another process."""
    trial = bench.refitted(job)
    return None if trial is None else bench.outcome(trial)


def _outcome(data: Mapping[str, Any] | None) -> RefitOutcome | None:
    if data is None:
        return None
    return RefitOutcome(dict(data["values"]), tuple(tuple(map(float, row)) for row in data["initial"]))
