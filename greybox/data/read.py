"""From a file to an `Experiment` in the model's units. Nothing is repaired: a bad file is refused with every reason."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from greybox.base import DataError, Finding, Severity, shorten
from greybox.base.numerics import LARGEST_VALUE
from greybox.data.channels import ChannelTable
from greybox.data.columns import (
    ColumnMapping,
    ColumnMatch,
    RequestedSignal,
    SignalKind,
    counts_up,
    describe_second_time,
    find_stamp_unit,
    match_columns,
    read_before,
    read_conditions,
    request_conditions,
)
from greybox.data.data_frame import Frame, is_frame, open_frame
from greybox.data.experiment import MAX_DELAY_ROWS, UNNAMED, Experiment
from greybox.data.file_kinds import RecordFile, open_record_file
from greybox.data.findings import RecordCode
from greybox.data.headers import TIME, Column
from greybox.data.input_course import (
    CourseEvidence,
    Hold,
    Holds,
    choose_course,
    find_hold_problems,
    inspect_course,
)
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import (
    RowLabels,
    find_array_problems,
    find_measurement_problems,
    find_repeats,
    raise_problems,
)
from greybox.data.stamps import DAY, SECOND, StampKind, StampReader, Stamps, Start, find_origin, from_digits, from_epoch
from greybox.model import Model

Arrays = dict[str, np.ndarray]
Window = tuple[float | str | None, float | str | None]
"""First and last time that is wanted of a record: seconds, or a date or time of day where the file has them; None for all."""
WHOLE: Window = (None, None)


def read_csv(
    path: str | os.PathLike[str] | RecordFile | Frame,
    model: Model,
    *,
    columns: ColumnMapping | Sequence[str] | None = None,
    sampling_time: float | None = None,
    hold: Holds = "auto",
    interpolation: Mapping[str, Hold] | None = None,
    name: str | None = None,
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
    before: Mapping[str, float] | None = None,
    window: Window = WHOLE,
    reading: ReadingPolicy = READING_POLICY,
) -> Experiment:
    """Read a record for ``model`` from a text, MATLAB, NumPy, Parquet, MDF, TDMS, HDF5, ROS, MCAP or Excel file.

    Headers are ``name [unit]``, ``name (unit)`` or ``name`` (then in the model's unit, which ``findings`` say); names are those of
    the model's inputs and outputs, exactly, and ``time`` or ``t`` (seconds unless a unit is given). Values are converted to the
    model's units. Other columns are ignored, which ``findings`` say. Every input needs its column; of the outputs at least
    one. Empty fields and NaN are gaps, allowed in outputs only. Text files: columns separated by ``,``, ``;``, tab or
    blanks, decimal comma except between commas, lines that begin with ``#`` or ``%`` are comments; the last comment before the
    numbers may be the header. The columns of a matrix ``data`` are called ``data(:,1)``, fields of a struct ``log.x``.

    Parameters
    ----------
    path
        The file; or one that is open already, such as a part of a file that holds several records; or a data frame of pandas or polars,
        or a mapping from header to column.
    model
        Its inputs and outputs are looked for, and their units are those of the record.
    columns
        Signal -> header, where the file's headers are others: ``{"x": "Laser ch1 [um]", "time": "Zeit [ms]"}``; a number
        counts columns from 1. A key may state the unit of the column, which goes before that of its header:
        ``{"time [ms]": "millis"}``. Or the names of all columns in their order, for a file without a header or a matrix:
        ``["time [ms]", "u", "-", "x"]``, with ``-`` for a column that is not wanted.
    sampling_time
        Seconds between rows, for a file without a time column (one that is there is refused); for a file whose signals have stamps of
        their own, the step of the time base that they are brought to, in the place of the stamps of the fastest.
    hold
        How the inputs move between samples, all or by name, see `Experiment`.
    interpolation
        Input -> ``"zero"``, ``"first"`` or ``"band-limited"``, where an input does not move between its samples as ``hold`` says.
    name
        What results call the record; None takes the file's name without suffix.
    conditions
        Constants of this experiment, name -> value; None as the value takes it from the file, which has a column of that name
        (its mean is taken) or a comment line such as ``# P_S = 801 kPa``.
    allow_constant_input
        Accept inputs that are zero throughout (free decay).
    before
        Input -> what it was before the first row, for models whose inputs act late; None takes its first value.
    window
        First and last time that is wanted, None for all: seconds of the record's time, or a date or time of day where the file has them
        (``("2024-03-31 08:00", None)``). Times stay those of the whole record.
    reading
        How large a file may be.

    Returns
    -------
    Experiment
        The record in the model's units, with what a reader should know about it in ``findings``.

    Raises
    ------
    DataError
        With every problem of the file in one message, rows called by their line number in the file.

    Examples
    --------
    >>> record = read_csv("run.csv", micro_actuator, columns={"x": "Laser ch1 [um]"})  # doctest: +SKIP
    """
    source = _RecordSource(columns, sampling_time, interpolation, reading, dict(before or {}))
    opened: Any = open_frame(path, reading) if is_frame(path) else path
    (experiment,) = _read_runs(
        [opened], [name], model, source, hold, conditions, allow_constant_input, window, split=False
    )
    return experiment


def as_experiments(records: Experiment | Frame | Iterable[Any], model: Model) -> tuple[Experiment, ...]:
    """One record or several, as a tuple; data frames and arrays by name are read for ``model``. Raises DataError as `read_csv`."""
    if isinstance(records, Experiment | str | os.PathLike):
        return (records,)  # type: ignore[return-value]  # whoever gets a path says how it is read
    group: tuple[Any, ...] = (records,) if is_frame(records) else tuple(records)  # type: ignore[arg-type]
    return tuple(_read_frame(record, model) if is_frame(record) else record for record in group)


def _read_frame(frame: Frame, model: Model) -> Experiment:
    """A frame that was given in the place of a record. Raises DataError that says where its options are given."""
    opened = open_frame(frame)
    try:
        return read_csv(opened, model, name=UNNAMED)
    except DataError as error:
        raise DataError(
            f"{error}\nWhat a frame does not state itself is given where it is read: gb.read_csv(frame, model, columns=..., ...) makes the"
            " record to give in its place"
        ) from None


def read_experiments(
    paths: Sequence[str | os.PathLike[str]],
    model: Model,
    *,
    columns: ColumnMapping | Sequence[str] | None = None,
    sampling_time: float | None = None,
    hold: Holds = "auto",
    interpolation: Mapping[str, Hold] | None = None,
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
    before: Mapping[str, float] | None = None,
    split: bool = False,
    window: Window = WHOLE,
    reading: ReadingPolicy = READING_POLICY,
) -> tuple[Experiment, ...]:
    """Read several records for one model, each as `read_csv` does.

    Parameters
    ----------
    paths
        The files. Files of the same name get their folder's name in front.
    model, columns, sampling_time, hold, interpolation, conditions, allow_constant_input, before, window, reading
        As of `read_csv`. Dated records count from the earliest of them.
    split
        A file in which time starts anew holds several runs; each becomes a record ``name[first:last]``.

    Returns
    -------
    tuple of Experiment
        The records in the order of the files.

    Raises
    ------
    DataError
        One, with the problems of all files.
    """
    files = [Path(p) for p in ([paths] if isinstance(paths, (str, os.PathLike)) else paths)]
    if not files:
        raise DataError("no file to read; give at least one path")
    source = _RecordSource(columns, sampling_time, interpolation, reading, dict(before or {}))
    stems = [f.stem for f in files]
    names = [f.stem if stems.count(f.stem) == 1 else f"{f.parent.name}/{f.stem}" for f in files]
    return tuple(_read_runs(files, names, model, source, hold, conditions, allow_constant_input, window, split=split))


class RecordArrays(NamedTuple):
    """What a file holds of a model's signals, in the model's units: arrays (N,), how the rows are called, and when time is zero."""

    file: RecordFile
    match: ColumnMatch
    time: np.ndarray
    inputs: Arrays
    outputs: Arrays
    conditions: Arrays
    labels: RowLabels
    courses: dict[str, Hold]
    findings: tuple[Finding, ...] = ()
    start: Start | None = None
    before: Mapping[str, ArrayLike] = MappingProxyType({})
    """What the inputs were before these rows, told or in the file, and how long before (as of `Experiment`)."""
    before_ages: np.ndarray = np.zeros(0)

    def cut(self, window: Window) -> RecordArrays:
        """The rows within ``window``, with the times of the whole. Raises DataError for fewer than two, and for a limit that is no time."""
        if window == WHOLE:
            return self
        first, last = (_read_limit(limit, self) for limit in window)
        inside = np.ones(len(self.time), bool)
        if first is not None:
            inside &= self.time >= first - SLACK * np.spacing(abs(first))
        if last is not None:
            inside &= self.time <= last + SLACK * np.spacing(abs(last))
        rows = np.flatnonzero(inside)
        if len(rows) < 2:
            limits = " ".join(
                f"{word} {limit}" for word, limit in zip(("from", "until"), window, strict=True) if limit is not None
            )
            raise DataError(
                f"{self.file.path.name}: {len(rows)} rows {limits}; the record runs from {self.time[0]:.6g} to {self.time[-1]:.6g} s"
                f"{f' (from {self.start})' if self.start else ''}, give a part of that with at least 2 rows"
            )
        part = slice(int(rows[0]), int(rows[-1]) + 1)
        inputs, outputs, conditions = (
            {n: v[part] for n, v in group.items()} for group in (self.inputs, self.outputs, self.conditions)
        )
        earlier = slice(max(0, part.start - MAX_DELAY_ROWS), part.start)
        known = {n: np.append(self.before.get(n, v[0]), v[earlier]) for n, v in self.inputs.items()}
        ages = self.time[part.start] - np.append(2 * self.time[0] - self.time[1], self.time[earlier])
        return self._replace(
            time=self.time[part],
            inputs=inputs,
            outputs=outputs,
            conditions=conditions,
            labels=self.labels.select(part),
            before=known if part.start else self.before,
            before_ages=ages if part.start else self.before_ages,
        )


# Last places by which a time may miss a limit of a window: a unit was converted.
SLACK = 8


def _read_limit(limit: float | str | None, record: RecordArrays) -> float | None:
    """A limit of a window in seconds of the record's time; a date or a time of day where the record has them."""
    if limit is None or not isinstance(limit, str):
        return limit
    start, what = record.start, f"{record.file.path.name}: part {limit!r}"
    try:
        return float(limit)
    except ValueError:
        reader = StampReader()
        if reader.add([limit]) or start is None:
            example = f"or a time such as {start}" if start else "and this record has no dates"
            raise DataError(f"{what}: give seconds of the record's time, {example}") from None
        stamps = reader.finish()
        if stamps.kind is not start.kind:
            raise DataError(f"{what}: the record counts from a {start.kind} ({start}); write one") from None
        if stamps.swapped is not None and stamps.kind is StampKind.CLOCK:
            raise DataError(
                f"{what} can be read as hours:minutes and as minutes:seconds; write all three, as in 00:05:00"
            ) from None
        if stamps.swapped is not None:
            raise DataError(f"{what} can be read as day/month and as month/day; write it as 2024-03-31 13:30") from None
        if stamps.zoned is not start.zoned:
            # Read in another zone it would be hours beside what is meant.
            remedy = (
                "write it with one, as in 2024-03-31 13:30+02:00, or 13:30Z" if start.zoned else "write it without one"
            )
            raise DataError(
                f"{what} has {'no' if start.zoned else 'a'} time zone, and the record counts from {start}, "
                f"which has {'one' if start.zoned else 'none'}; {remedy}"
            ) from None
        moment = int(stamps.nanoseconds[0])
        # Behind midnight a time of day is small again: the first one that the record reaches is meant.
        if moment < start.nanoseconds and any(f.code is RecordCode.MIDNIGHT_PASSED for f in record.findings):
            moment += DAY
        # The rows behind a change of the clock stand at the time that has gone by, which the clock does not show.
        changes = [f.values for f in record.findings if f.code is RecordCode.SUMMER_TIME]
        hours = sum(v["hours"] for v in changes if moment >= np.datetime64(v["at"], "ns").astype(np.int64))
        return (moment - start.nanoseconds) / SECOND + 3600 * hours


class _RecordSource(NamedTuple):
    """How files are laid out, and how large they may be."""

    columns: ColumnMapping | Sequence[str] | None
    sampling_time: float | None
    interpolation: Mapping[str, Hold] | None
    reading: ReadingPolicy
    before: Mapping[str, float]


def read_arrays(
    path: str | os.PathLike[str] | RecordFile,
    model: Model,
    *,
    columns: ColumnMapping | Sequence[str] | None = None,
    sampling_time: float | None = None,
    conditions: Sequence[RequestedSignal] = (),
    inputs_only: bool = False,
    hold: Holds = "auto",
    interpolation: Mapping[str, Hold] | None = None,
    reading: ReadingPolicy = READING_POLICY,
    before: Mapping[str, float] = MappingProxyType({}),
) -> RecordArrays:
    """The arrays of a file, unchecked; with ``inputs_only`` without outputs. Raises DataError.

    Signals with stamps of their own are brought to one time base: ``sampling_time`` is then its step, and inputs move between
    their samples as ``interpolation`` (name -> course) says, else as ``hold``.
    """
    by_name = None if columns is None or isinstance(columns, Mapping) else list(columns)
    if isinstance(columns, str):
        raise DataError(f"columns={columns!r} is one text; give a list of names, or a dictionary signal -> header")
    if sampling_time is not None and not 0 < sampling_time < math.inf:
        raise DataError(
            f"sampling_time {sampling_time}: give the seconds between rows, above 0 (shell: --sampling-time)"
        )
    file = path if isinstance(path, RecordFile) else open_record_file(path, policy=reading)
    if by_name is not None:
        file = file.rename(by_name)
    mapping = columns if isinstance(columns, Mapping) else None
    channels = file.table if isinstance(file.table, ChannelTable) else None
    has_clock = sampling_time is not None and channels is None
    try:
        match = match_columns(
            file.table,
            model,
            mapping,
            conditions,
            has_clock=has_clock,
            inputs_only=inputs_only,
            are_named=by_name is not None,
        )
    except DataError as error:
        raise DataError(f"{file.path.name}: {error}") from None
    raise_problems(file.path.name, match.problems and (*match.problems, *match.unit_problems))
    raise_problems(file.path.name, _find_second_time(file, match.clocks))
    named = {**(hold if isinstance(hold, Mapping) else {}), **(interpolation or {})}
    common: Hold = "auto" if isinstance(hold, Mapping) else hold
    inputs, outputs = [i.name for i in model.inputs], [o.name for o in model.outputs]
    courses = dict.fromkeys(inputs + (outputs if common == "mean" else []), common) | named
    problems = find_hold_problems(courses, inputs, outputs)
    raise_problems(file.path.name, problems)
    if channels is not None:
        channels = file.for_signals(match, common, named, sampling_time)
        courses |= {use.name: use.course for use in channels.uses.values() if use.kind is SignalKind.INPUT}
        file = replace(file, table=channels)
    times = [c.position for s, c in match.columns.items() if s.kind is SignalKind.TIME]
    held = file.values([c.position for c in match.columns.values()], times)
    if held.day is not None:
        day = shorten(file.table.headers[held.day])
        match = replace(match, ignored=tuple(h for h in match.ignored if h != day))
    raw, problems, findings = held.arrays, held.problems, held.findings
    start = channels.start if channels is not None else None
    groups: dict[SignalKind, Arrays] = {kind: {} for kind in SignalKind}
    rows = 0
    problems = [*problems, *match.unit_problems]
    stated, said_before = read_before(model, file.table.comments, problems)
    # What is told goes before what the file says.
    findings = (*findings, *(f for f in said_before if f.subject.removeprefix("before ") not in before))
    before = {**stated, **before}
    match = match.with_stamps(raw, problems)
    problems += match.ask_points(findings)
    findings = tuple(f for f in findings if f.code is not RecordCode.POINTS_OPEN)
    for signal, column in match.columns.items():
        # Each column is let go of as it is converted: a long record is in memory once.
        if column.position in held.stamps:
            stamps: Stamps | None = held.stamps[column.position]
            order = column.unit
        else:
            values, conversion = raw.pop(column.position), match.conversions[signal]
            values = values if conversion.identical else conversion(values)
            stamps, order = None, ""
            if signal.kind is SignalKind.TIME:
                is_epoch = find_stamp_unit(values) == "s"
                stamps = from_epoch(values) if is_epoch else from_digits(values) if column.unit in ("", "s") else None
        if stamps is not None:
            try:
                values, start, seen = stamps.count_seconds(column.header, order)
            except DataError as error:
                problems.append(str(error))
                continue
            findings += seen
        if column.position in held.stamps:
            # A date is in seconds, whatever unit its header states.
            match = replace(match, columns={**match.columns, signal: replace(column, unit=signal.unit)})
        values.setflags(write=False)  # then no record needs a copy of its own
        groups[signal.kind][signal.name] = values
        rows = len(values)
    raise_problems(file.path.name, problems)
    findings += tuple(_find_per_cent(match, groups[SignalKind.INPUT]))
    time = sampling_time * np.arange(rows) if has_clock and sampling_time else groups[SignalKind.TIME][TIME]
    labels, twice = file.table.row_labels, find_repeats(time, chain.from_iterable(g.values() for g in groups.values()))
    if twice.any():
        about = {"rows": int(twice.sum()), "first": labels.describe(np.flatnonzero(twice)[:1])}
        findings += (Finding(RecordCode.ROWS_TWICE, values=about),)
        time, labels = time[~twice], labels.without(twice)
        groups = {kind: {n: v[~twice] for n, v in group.items()} for kind, group in groups.items()}
    return RecordArrays(
        file,
        match,
        time,
        groups[SignalKind.INPUT],
        groups[SignalKind.OUTPUT],
        groups[SignalKind.CONDITION],
        labels,
        courses,
        findings,
        start,
        before,
    )


def _find_second_time(file: RecordFile, clocks: Sequence[Column]) -> list[str]:
    """A problem where one of the columns that may be the time of rows with a sampling time is a clock by its values."""
    for column in clocks:
        position = column.position
        held = file.values([position], [position])
        if not held.problems and counts_up(held.stamps.get(position, held.arrays.get(position, np.zeros(0)))):
            return [describe_second_time(column)]
    return []


def _read_runs(
    paths: Sequence[str | os.PathLike[str] | RecordFile],
    names: Sequence[str | None],
    model: Model,
    source: _RecordSource,
    hold: Holds,
    conditions: Mapping[str, float | None] | None,
    allow_constant_input: bool,
    window: Window,
    *,
    split: bool,
) -> list[Experiment]:
    """The records in files as `read_csv` gives them; with ``split`` each run of a file in which time starts anew."""
    given = {name: value for name, value in (conditions or {}).items() if value is not None}
    requested = request_conditions(model, [name for name in conditions or {} if name not in given])
    read_one = partial(read_arrays, model=model, conditions=requested, hold=hold, **source._asdict())
    records = _collect([partial(read_one, path) for path in paths])
    if len(records) > 1 and (shared := find_shared_courses(records, hold, source.interpolation or {})):
        read_one = partial(read_one, interpolation={**(source.interpolation or {}), **shared})
        records = _collect([partial(read_one, path) for path in paths])
        notes = tuple(
            Finding(RecordCode.INPUT_COURSE_SHARED, subject=n, values={"course": c}) for n, c in shared.items()
        )
        records = [record._replace(findings=(*record.findings, *notes)) for record in records]
    # Dated records count from one origin, the earliest of them, so that they lie to each other as they were taken.
    origin, after = find_origin({str(k): record.start for k, record in enumerate(records)})
    experiments: list[Callable[[], list[Experiment]]] = []
    for record, name, seconds in zip(records, names, after.values(), strict=True):
        if seconds:
            record = record._replace(time=record.time + seconds, start=origin)
        if origin is not None and (record.start is None or record.start[:2] != origin[:2]):
            values = {"start": str(origin), "own": str(record.start or "")}
            record = record._replace(
                findings=(*record.findings, Finding(RecordCode.ORIGINS_APART, Severity.WARNING, values=values))
            )
        experiments.append(
            partial(_to_experiments, record, name, model, requested, given, allow_constant_input, window, split)
        )
    return [experiment for runs in _collect(experiments) for experiment in runs]


def find_shared_courses(
    records: Sequence[RecordArrays | Experiment], hold: Holds, interpolation: Mapping[str, Hold]
) -> dict[str, Hold]:
    """One course for each input that nobody told and that moves differently from record to record by their values: one signal has one."""
    given = {**(hold if isinstance(hold, Mapping) else {}), **interpolation}
    common = "auto" if isinstance(hold, Mapping) else hold
    shared: dict[str, Hold] = {}
    for name in (n for n in records[0].inputs if given.get(n, common) == "auto"):
        columns = [record.inputs[name][np.isfinite(record.inputs[name])] for record in records]
        # A record in which it stands still shows nothing; one with numbers beyond all squares is refused as soon as it is made.
        moving = [c for c in columns if len(c) and 0 < np.abs(c).max() <= LARGEST_VALUE and np.ptp(c) > 0]
        if len({choose_course(column) for column in moving}) < 2:
            continue
        votes = Counter[CourseEvidence]()
        for column in moving:
            votes[inspect_course(column)] += len(column)
        smooth, stepped = votes[CourseEvidence.SMOOTH_AND_NOISY], votes[CourseEvidence.STEPS]
        shared[name] = "first" if smooth > stepped else "zero"
    return shared


Result = TypeVar("Result")


def _collect(jobs: Sequence[Callable[[], Result]]) -> list[Result]:
    """What each of the jobs gives. Raises one DataError with the problems of all."""
    results, problems = [], []
    for job in jobs:
        try:
            results.append(job())
        except DataError as error:
            problems.append(str(error))
    if problems:
        raise DataError("\n".join(problems))
    return results


def _to_experiments(
    record: RecordArrays,
    name: str | None,
    model: Model,
    requested: Sequence[RequestedSignal],
    given: Mapping[str, float],
    allow_constant_input: bool,
    window: Window,
    split: bool,
) -> list[Experiment]:
    file, table, problems = record.file.path, record.file.table, list[str]()
    record = record.cut(window)
    from_file, findings = read_conditions(requested, record.conditions, table.comments, problems)
    runs = _cut_runs(record.time, record.inputs, record.outputs, split)
    for rows, t, u, y in runs:
        # A file of too few rows is called so, and not by what else follows from it.
        if len(t) > 1:
            problems += find_array_problems(t, u, y, record.labels.select(rows))
        problems += find_measurement_problems(u, y, len(t), allow_constant_input)
    raise_problems(file.name, problems)
    title = name or file.stem
    findings = [*_inspect_columns(record.match), *record.findings, *findings]
    if len(runs) > 1:
        findings.append(Finding(RecordCode.ONE_OF_RUNS, values={"runs": len(runs)}))
    unwrapped = [_unwrap_outputs(t, y, model) for _, t, _, y in runs]
    return [
        Experiment.from_arrays(
            t,
            u,
            y,
            name=title if len(runs) == 1 else f"{title}[{rows.start}:{rows.stop}]",
            hold=record.courses,
            source=file.name,
            conditions={**given, **from_file},
            findings=(*findings, *jumps),
            # What the file has before its wanted rows is before the first run of them; what is told is before each.
            before=record.before if rows.start == 0 or not len(record.before_ages) else None,
            before_ages=record.before_ages if rows.start == 0 else (),
            allow_constant_input=allow_constant_input,
        )
        for (rows, t, u, _), (y, jumps) in zip(runs, unwrapped, strict=True)
    ]


# Share of a period that a reading may go on from row to row, as fast as it moves before or after, for its turns to be known: half of it
# less the noise of a reading.
SURE_SHARE = 0.45


def _find_lost_turns(time: np.ndarray, reading: np.ndarray, period: float) -> np.ndarray:
    """The steps, by their number, over which a continuous ``reading`` (N,) may have turned more than half a period unseen."""
    moved, steps = np.abs(np.diff(reading)), np.diff(time)
    speed = moved / steps
    # As fast as in the steps beside it.
    nearby = np.maximum(np.append(0.0, speed[:-1]), np.append(speed[1:], 0.0))
    return np.flatnonzero(np.maximum(nearby * steps, moved) > SURE_SHARE * period)


def _unwrap_outputs(time: np.ndarray, outputs: Arrays, model: Model) -> tuple[dict[str, np.ndarray], list[Finding]]:
    """Readings that start anew after a period, with their jumps taken out."""
    continuous, findings = dict(outputs), []
    for o in model.outputs:
        values = outputs.get(o.name)
        if not o.wraps or values is None:
            continue
        known = np.isfinite(values)
        continuous[o.name] = values.copy()
        continuous[o.name][known] = np.unwrap(values[known], period=o.wraps)
        jumps = int(np.count_nonzero(np.diff(np.round((continuous[o.name] - values)[known] / o.wraps))))
        if jumps:
            figures = {"jumps": jumps, "period": o.wraps, "unit": o.unit}
            findings.append(Finding(RecordCode.OUTPUT_UNWRAPPED, subject=o.name, values=figures))
        lost = _find_lost_turns(time[known], continuous[o.name][known], o.wraps)
        if len(lost):
            start, stop = (float(time[known][lost[0] + k]) for k in (0, 1))
            figures = {"period": o.wraps, "unit": o.unit, "times": len(lost), "start": start, "stop": stop}
            findings.append(Finding(RecordCode.TURNS_UNCERTAIN, Severity.WARNING, o.name, figures))
    return continuous, findings


def _cut_runs(
    time: np.ndarray, inputs: Arrays, outputs: Arrays, split: bool
) -> list[tuple[slice, np.ndarray, Arrays, Arrays]]:
    """The rows of each run with its arrays: with ``split`` a run ends where time goes back, else the whole is one."""
    starts = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist()] if split else [0]
    if len(starts) == 1:
        return [(slice(0, len(time)), time, dict(inputs), dict(outputs))]
    parts = [slice(a, b) for a, b in pairwise([*starts, len(time)])]
    return [
        (rows, time[rows], {n: v[rows] for n, v in inputs.items()}, {n: v[rows] for n, v in outputs.items()})
        for rows in parts
    ]


# The largest values of an input without a unit that are likelier per cent than parts of one.
PER_CENT = (20.0, 100.0)


def _find_per_cent(match: ColumnMatch, inputs: Arrays) -> Iterator[Finding]:
    """Inputs that are plain numbers in the model, of which the file states no unit, and whose values are those of per cent."""
    for signal, column in match.columns.items():
        if signal.name in inputs and signal.unit in ("", "-", "1") and not column.unit:
            low, high = np.nanmin(inputs[signal.name]), np.nanmax(inputs[signal.name])
            if low >= 0 and PER_CENT[0] < high <= PER_CENT[1]:
                values = {"header": shorten(column.header), "largest": float(high)}
                yield Finding(RecordCode.MAY_BE_PER_CENT, subject=signal.name, values=values)


def _inspect_columns(match: ColumnMatch) -> list[Finding]:
    findings = []
    if match.unmeasured:
        likely = {name: header for name, header in match.unmeasured.items() if header}
        severity = Severity.WARNING if likely else Severity.NOTE
        values = {"outputs": list(match.unmeasured), **({"columns": likely} if likely else {})}
        findings.append(Finding(RecordCode.OUTPUT_NOT_MEASURED, severity, values=values))
    if units_read := match.describe_units():
        findings.append(Finding(RecordCode.UNITS_READ, values={"columns": units_read}))
    if match.unitless:
        units = {signal.name: signal.unit for signal in match.unitless}
        findings.append(Finding(RecordCode.UNITS_ASSUMED, values={"units": units}))
    if match.ignored:
        findings.append(Finding(RecordCode.COLUMNS_IGNORED, values={"columns": list(match.ignored)}))
    return findings
