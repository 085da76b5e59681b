"""`fit_each`: one model fitted to each of many records, in processes of this machine or on a cluster, kept in a journal.

Each record is fitted by `greybox.fit`, so a row of the result is what that function gives for the record alone. Machines of a kind are
alike: the first few records are fitted from the model's own start, and the others begin where these ended, which saves most of the
search. What does not depend on the record is done once in each process: the equations, their derivatives, the compiled step.
"""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import from_json_data, read_versions, to_json_data
from greybox.base.errors import DataError, GreyboxError, ModelError, WorkersLostError
from greybox.base.files import add_entry, read_journal
from greybox.base.parallel.jobs import JobProgressCallback, JobResult, run_jobs
from greybox.base.parallel.local_pool import count_cores, open_local_pool
from greybox.data.experiment import Experiment, as_records
from greybox.data.noise.noise_model import NoiseModel
from greybox.data.read import as_experiments
from greybox.estimation.fit import fit
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import ColourTreatment, FitOptions, explain_unknown, resolve_options
from greybox.extensions.fleet.records import RecordCollection, RecordReference, find_records
from greybox.extensions.fleet.result import FleetResult, RecordEstimate, RecordStatus
from greybox.model import Model
from greybox.model.equations import identify
from greybox.simulation.plant import Plant, as_model

Item = Experiment | RecordReference
"""A record, or where it lies."""


@dataclass(frozen=True)
class _Work:
    """What the fits of all records share: ``begun`` is the model at the constants of the records that were fitted first."""

    model: Model
    begun: Model
    collection: RecordCollection
    noise: Mapping[str, float] | NoiseModel | None
    colour: ColourTreatment | str
    options: FitOptions

    def fit(self, item: Item) -> RecordEstimate:
        """One record; what is wrong with it is its result. Raises KeyboardInterrupt where Ctrl-C ended its search."""
        began = time.perf_counter()
        try:
            record = item if isinstance(item, Experiment) else self.collection.read(item, self.model)
        except DataError as error:
            return _refused(item.name, RecordStatus.NOT_READ, str(error), time.perf_counter() - began)
        estimate = self._fit_from(self.begun, record, began)
        # A record unlike the others may need the model's own start.
        if not estimate.is_usable and self.begun is not self.model:
            other = self._fit_from(self.model, record, began)
            estimate = other if other.is_usable or not estimate.success else estimate
        return estimate

    def _fit_from(self, model: Model, record: Experiment, began: float) -> RecordEstimate:
        try:
            result = fit(model, record, noise=self.noise, colour=self.colour, options=self.options)
        except GreyboxError as error:
            return _refused(record.name, RecordStatus.NOT_FITTED, str(error), time.perf_counter() - began)
        if result.status == TerminationStatus.INTERRUPTED:  # the search hears Ctrl-C itself
            raise KeyboardInterrupt
        return RecordEstimate.of(record.name, result, record.rows, time.perf_counter() - began)


def _refused(name: str, status: RecordStatus, reason: str, seconds: float = 0.0) -> RecordEstimate:
    return RecordEstimate(name, str(status), reason=reason, seconds=seconds)


def _fit_items(work: _Work, items: Sequence[Item]) -> list[RecordEstimate]:
    """Some records one after the other, where the job runs; fewer than there are ``items`` where Ctrl-C came."""
    done: list[RecordEstimate] = []
    try:
        for item in items:
            done.append(work.fit(item))
    except KeyboardInterrupt:
        pass  # whoever receives fewer than it asked for ends the run
    return done


@dataclass
class FleetJournal:
    """Records that are done, in a file, one JSON object a line with those of one job, by a hash of all that decides the result.

    What begins in this process is there before: a record that ends the process is known to the next run.

    Raises
    ------
    DataError
        If the file is no journal.
    """

    path: Path
    known: dict[str, RecordEstimate] = field(init=False)
    begun: frozenset[str] = field(init=False)
    """Begun in the process of an earlier run, and not done."""

    def __post_init__(self) -> None:
        entries = read_journal(self.path, _parse_entry).entries
        self.known = {key: estimate for _, entry in entries for key, estimate in entry.items()}
        # One job at a time runs in a process: what the last line says.
        begun = next((keys for keys, _ in reversed(entries) if keys is not None), frozenset())
        self.begun = begun - frozenset(self.known)

    def begin(self, keys: Sequence[str]) -> None:
        """Say what begins, on the disk when this returns; nothing where what had begun has been ended. Raises OutputError."""
        add_entry(self.path, {"begun": list(keys)})

    def add(self, keys: Sequence[str], estimates: Sequence[RecordEstimate]) -> None:
        """Keep some more, on the disk when this returns. Raises OutputError."""
        self.known |= dict(zip(keys, estimates, strict=True))
        add_entry(self.path, {"estimates": to_json_data(dict(zip(keys, estimates, strict=True)))})


def _parse_entry(data: Mapping[str, Any]) -> tuple[frozenset[str] | None, dict[str, RecordEstimate]]:
    """What begins, or what is done."""
    if "begun" in data:
        return frozenset(map(str, data["begun"])), {}
    return None, {str(key): from_json_data(RecordEstimate, each) for key, each in data["estimates"].items()}


# Records that are fitted here before the others are shared out: they tell where the others begin and how long one takes, and compile what
# all need. Their median is that of machines as they usually are even if two of them are not.
PILOTS = 5
# Records, from all over a fleet, that tell how its inputs move between rows.
COURSE_RECORDS = 12
# Seconds that one job should take: long against handing it out, short against what an interruption may lose.
JOB_SECONDS = 1.0
# Most records of one job: each is read and sent with it.
MOST_IN_JOB = 100
# Jobs for each worker at least, so that all end at about the same time.
JOBS_PER_WORKER = 8
# Expected seconds of fits from which starting processes pays: a process takes two seconds to begin.
PARALLEL_SECONDS = 8.0


@explain_unknown
def fit_each(
    model: Model | Plant,
    records: RecordCollection | Experiment | Sequence[Experiment] | str | os.PathLike[str],
    *,
    noise: Mapping[str, float] | NoiseModel | None = None,
    colour: ColourTreatment | str = ColourTreatment.KNOWN,
    options: FitOptions | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    report: JobProgressCallback | None = None,
    journal: str | Path | None = None,
) -> FleetResult:
    """Fit ``model`` to each record by itself: a line's test bench, a fleet of machines, a machine over years.

    Parameters
    ----------
    model
        The model, or a plant. The first records are fitted from its values; the others from the median of what these gave, and again
        from the model's values where that leads nowhere.
    records
        What `greybox.fleet.find_records` lists; a file or folder, for which it is called; or experiments in memory.
    noise, colour, options
        As in `greybox.fit`, for each record. Given noise saves estimating it from each record.
    executor
        Where the fits run, for example ``Client.get_executor()`` of Dask; None for processes of this machine. Its machines read the
        files of ``records`` by the same paths.
    workers
        How many local processes, 0 for one on each core where there is enough to do.
    report
        Called as ``report(done, records)`` from time to time.
    journal
        File that keeps what is done; the same call continues from it. A record that has changed is fitted anew.

    Returns
    -------
    FleetResult
        An estimate for each record and the population of the constants. A record that cannot be read or fitted has its reason in
        place of constants. Ctrl-C keeps what is done.

    Raises
    ------
    DataError
        If there are no records, or the journal is none.
    ModelError
        For options that do not go with the model.
    WorkersLostError
        If a cluster is lost. What is done is in the journal.

    Examples
    --------
    >>> fleet = gb.fit_each(rig, "bench/2024-06", noise={"x": 2e-7})  # doctest: +SKIP
    >>> fleet.save_table("constants.parquet")  # doctest: +SKIP
    """
    began, options, model = time.perf_counter(), resolve_options(options), as_model(model)
    if isinstance(records, str | os.PathLike):
        records = find_records(records)
    collection = records if isinstance(records, RecordCollection) else RecordCollection(())
    items: Sequence[Item] = (
        records.references if isinstance(records, RecordCollection) else as_records(as_experiments(records, model))
    )
    if not items:
        raise DataError("no records to fit; give a folder with records, or at least one experiment")
    run = _FleetRun(_Work(model, model, collection, noise, colour, options), items, journal, report)
    # What an earlier run was at when its process ended may have ended it: never in this process again.
    is_interrupted = run.do_apart(run.suspects, executor, 1)
    pilots = range(min(PILOTS, len(items)))
    is_interrupted = is_interrupted or run.do([k for k in pilots if run.results[k] is None], None, 1, 1)
    if not is_interrupted and run.open:
        known = [r for k in pilots if (r := run.results[k]) is not None and r.is_usable]
        run.begin_at(known)
        # The shortest of them: the first compiles.
        usual = min((r.seconds for r in known), default=JOB_SECONDS)
        if executor is None and not workers and usual * len(run.open) < PARALLEL_SECONDS:
            workers = 1
        shares = JOBS_PER_WORKER * (workers or count_cores())
        size = max(1, math.ceil(min(JOB_SECONDS / max(usual, TINY_SECONDS), MOST_IN_JOB, len(run.open) / shares)))
        is_interrupted = run.do(run.open, executor, workers, size)
        if not is_interrupted and run.open and size > 1:
            # Jobs that failed as a whole: their records one by one, so that one of them does not take the others along.
            is_interrupted = run.do_apart(run.open, executor, workers or count_cores())
    if not is_interrupted:
        run.give_up(run.open)
    done = tuple(r for r in run.results if r is not None)
    given = dict(noise) if isinstance(noise, Mapping) else {}
    left = len(items) - len(done)
    return FleetResult(model, done, run.start, options.to_data(), given, left, time.perf_counter() - began)


# A fit takes longer.
TINY_SECONDS = 1e-4


class _FleetRun:
    """Which records are done."""

    def __init__(
        self, work: _Work, items: Sequence[Item], journal: str | Path | None, report: JobProgressCallback | None
    ) -> None:
        self.items, self.report = items, report
        self.journal = None if journal is None else FleetJournal(Path(journal))
        asked = list(_hash_records(work, items)) if self.journal else [""] * len(items)
        self.work = self._share_courses(work, asked)
        self.keys = list(_hash_records(self.work, items)) if self.journal else asked
        begun = self.journal.begun if self.journal else ()
        self.begun = [k for k, keys in enumerate(zip(asked, self.keys, strict=True)) if not {*keys}.isdisjoint(begun)]
        known = self.journal.known if self.journal else {}
        self.results: list[RecordEstimate | None] = [known.get(key) for key in self.keys]
        self.errors: dict[int, str] = {}

    def _share_courses(self, work: _Work, keys: Sequence[str]) -> _Work:
        """One course for each input of the files, as a sample of them shows it."""
        records, step = [], math.ceil(len(self.items) / COURSE_RECORDS)
        for key, reference in zip(keys[::step], work.collection.references[::step], strict=False):
            if self.journal and key in self.journal.begun:
                continue
            if self.journal:
                self.journal.begin([key])
            with suppress(DataError):  # it is told where it is fitted
                records.append(work.collection.read(reference, work.model))
        return replace(work, collection=work.collection.with_courses_of(records)) if records else work

    @property
    def start(self) -> dict[str, float]:
        """Where the searches begin."""
        return {q.name: q.value for q in self.work.begun.free_parameters}

    def begin_at(self, known: Sequence[RecordEstimate]) -> None:
        """Begin the searches that are left at the median of each constant over records that are ``known``."""
        if not known:
            return
        names = [q.name for q in self.work.model.free_parameters]
        values = {name: float(np.median([r.parameters[name].value for r in known])) for name in names}
        try:
            self.work = replace(self.work, begun=self.work.model.start(**values))
        except ModelError:  # the medians of several constants together may break a rule of the model
            return

    @property
    def open(self) -> list[int]:
        """Numbers of the records without a result."""
        return [k for k, result in enumerate(self.results) if result is None]

    @property
    def suspects(self) -> list[int]:
        """Numbers of the open records that an earlier run had begun."""
        return [k for k in self.begun if self.results[k] is None]

    def give_up(self, numbers: Iterable[int]) -> None:
        """The reason in place of constants for those of these records that are open, kept like a result."""
        for k in numbers:
            if self.results[k] is None:
                refused = _refused(self.items[k].name, RecordStatus.NOT_FITTED, self.errors.get(k, ""))
                self.results[k] = refused
                if self.journal:
                    self.journal.add([self.keys[k]], [refused])

    def do_apart(self, numbers: Sequence[int], executor: Executor | None, workers: int) -> bool:
        """Fit these records one by one, never in this process, which one might take along; whether Ctrl-C ended it."""
        if not numbers:
            return False
        with open_local_pool(workers) if executor is None else nullcontext(executor) as pool:
            is_interrupted = self.do(numbers, pool, workers, 1)
        if not is_interrupted:
            self.give_up(numbers)
        return is_interrupted

    def do(self, numbers: Sequence[int], executor: Executor | None, workers: int, size: int) -> bool:
        """Fit these records in jobs of ``size``; whether Ctrl-C ended it."""
        jobs = [numbers[first : first + size] for first in range(0, len(numbers), size)]
        # As `run_jobs` decides it.
        workers = min(workers or count_cores(), max(len(jobs), 1))
        is_cut, is_here = False, executor is None and workers == 1

        def work_on(work: _Work, job: Sequence[int]) -> list[RecordEstimate]:
            if self.journal:
                self.journal.begin([self.keys[k] for k in job])
            done = _fit_items(work, [self.items[k] for k in job])
            if self.journal and len(done) < len(job):  # Ctrl-C, which no record is to blame for
                self.journal.begin([])
            return done

        def receive(number: int, result: JobResult) -> None:
            nonlocal is_cut
            if result.error:
                self.errors |= dict.fromkeys(jobs[number], result.error)
                return
            done = dict(zip(jobs[number], result.value, strict=False))
            if done and self.journal:
                self.journal.add([self.keys[k] for k in done], list(done.values()))
            for k, estimate in done.items():
                self.results[k] = estimate
            if self.report:
                self.report(len(self.items) - len(self.open), len(self.items))
            if len(done) < len(jobs[number]):
                is_cut = True
                raise KeyboardInterrupt

        try:
            _, is_interrupted = run_jobs(
                work_on if is_here else _fit_items,
                self.work,
                jobs if is_here else [[self.items[k] for k in job] for job in jobs],
                executor=executor,
                workers=workers,
                receive=receive,
            )
        except WorkersLostError as error:
            raise WorkersLostError(error.fault, self.results) from error
        return is_interrupted or is_cut


def _hash_records(work: _Work, items: Sequence[Item]) -> Iterable[str]:
    """The hash by which each record is known: equal if everything that decides its result is."""
    noise = work.noise
    given = (noise.std.tolist(), [c.reflection for c in noise.colour]) if isinstance(noise, NoiseModel) else noise
    common = hashlib.sha256(
        repr(
            [
                identify(work.model),
                given and sorted(given.items()) if isinstance(given, Mapping) else given,
                str(work.colour),
                repr(work.options),
                repr(work.collection.layout),
                sorted(read_versions().items()),
            ]
        ).encode(errors="backslashreplace")
    )
    for item in items:
        each = common.copy()
        each.update(repr((item.name, item.identity)).encode(errors="backslashreplace"))
        yield each.hexdigest()[:32]
