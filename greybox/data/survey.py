"""What a file holds, looked at without a model: signals, units, rates, holes, doubtful sensors, and the columns to name."""

from __future__ import annotations

import math
import os
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from greybox.base import (
    DataError,
    Finding,
    ModelError,
    Printable,
    Severity,
    StoredResult,
    format_unit,
    nearest,
    parse_unit,
)
from greybox.data import array_table, channels, file_kinds, policy, sampling, sensor_faults
from greybox.data.columns import (
    WITHOUT_MARKS,
    RequestedSignal,
    SignalKind,
    counts_up,
    describe_second_time,
    find_conversion,
    find_likely_times,
    find_likely_unit,
    find_stamp_unit,
    find_times,
    measure_step,
)
from greybox.data.findings import RecordCode
from greybox.data.headers import TIME, Column, UnitSource, parse_header, read_endings, read_time
from greybox.data.notation import COUNT, converts, read_conversion, read_notation
from greybox.data.problems import find_repeats, find_time_problems, is_constant
from greybox.data.stamps import Stamps, from_digits, from_epoch
from greybox.data.time_base import Samples, estimate_clock_offset, find_stamp_problems, is_held

# Words of a name that speak for an input.
INPUT_WORDS = frozenset(
    re.split(
        " ", "u cmd command set setpoint ref reference drive control ctrl input valve duty pwm demand target actuator"
    )
)


@dataclass(frozen=True)
class SignalSurvey:
    """One signal of a file.

    Attributes
    ----------
    header, unit, clock
        As the file has them; the clock is "" where the file has one.
    rows, missing
        Samples, and those of them that are empty.
    step
        Usual seconds between samples; None where nobody knows.
    regular
        Whether all steps are alike.
    start, stop
        Time of the first and last sample (s).
    lowest, highest
        Range; None without a value.
    gaps
        Holes in time.
    held
        Whether it stays at its values and jumps between them.
    use
        ``input``, ``output``, ``constant``, ``time`` or ``text``: what it may be for.
    name
        A name that a model can give it.
    model_unit
        The unit that a model can give it: 1 where the file states none that is one.
    stated_unit
        The unit that a person has to state for it (``--column 'time [ms]=millis'``); "" where the file does.
    """

    header: str
    unit: str
    clock: str
    rows: int
    missing: int
    step: float | None
    regular: bool
    start: float | None
    stop: float | None
    lowest: float | None
    highest: float | None
    gaps: int
    held: bool
    use: str
    name: str
    model_unit: str = "1"
    stated_unit: str = ""


@dataclass(frozen=True)
class FileSurvey(Printable, StoredResult):
    """What a file holds.

    Attributes
    ----------
    file
        Its name.
    kind
        Its format.
    signals
        The signals in the order of the file.
    findings
        Doubtful sensors, holes, clocks.
    """

    file: str
    kind: str
    signals: tuple[SignalSurvey, ...]
    findings: tuple[Finding, ...]

    KEYS: ClassVar[str] = "file kind signals columns! findings notes=str(findings)"

    @property
    def columns(self) -> Mapping[str, str]:
        """Proposed columns, name -> header: time, and every input and output. Names are those of the file, as a model can write them.

        A name carries the unit of its column where the file does not state it, as ``time [ms]``.
        """
        chosen = [s for s in self.signals if s.use in ("time", "input", "output")]
        return {f"{s.name} [{s.stated_unit}]" if s.stated_unit else s.name: s.header for s in chosen}


FileSurveys = list[FileSurvey]
"""What several files hold."""


def survey_file(
    path: str | os.PathLike[str],
    *,
    names: Sequence[str] | None = None,
    columns: Mapping[str, str | int] = MappingProxyType({}),
    sampling_time: float | None = None,
    reading: policy.ReadingPolicy = policy.READING_POLICY,
) -> FileSurvey:
    """Look at a file of any kind that is read, without a model.

    Parameters
    ----------
    path
        The file.
    names
        Names of its columns in their order, for a file without a header.
    columns
        Signal -> header of its column, or its number counted from 1, where its name or unit is another one.
    sampling_time
        Seconds between rows, for a file without a time column; one that is there is refused.
    reading
        How large it may be.

    Returns
    -------
    FileSurvey
        Its signals, what is doubtful, and the columns to name.

    Raises
    ------
    DataError
        For a file that cannot be read, a column that it does not have, and a time column beside a sampling time.
    """
    file = file_kinds.open_record_file(path, policy=reading)
    if names is not None:
        file = file.rename(names)
    headers, renamed = file.table.headers, dict[str, str]()
    for name, wanted in columns.items():
        is_number = str(wanted) not in headers and str(wanted).isdecimal() and 0 < int(wanted) <= len(headers)
        header = headers[int(wanted) - 1] if is_number else str(wanted)
        if header not in headers:
            raise DataError(f"{file.path.name}: no column {header!r} for {name}; {nearest(header, headers)}")
        renamed[header] = name
    if isinstance(file.table, channels.ChannelTable):
        return _survey_channels(file, file.table, renamed)
    return _survey_table(file, sampling_time, renamed)


def _read_header(header: str, position: int, renamed: Mapping[str, str]) -> Column:
    """What a header says, or what was said of it in ``renamed``: header -> name with or without a unit."""
    stated, plain = (
        replace(parse_header(text, position), header=header) for text in (renamed.get(header, header), header)
    )
    known = UnitSource.TOLD if header in renamed else stated.known
    return replace(stated, known=known) if stated.unit else replace(stated, unit=plain.unit, known=plain.known)


def _survey_table(file: file_kinds.RecordFile, sampling_time: float | None, renamed: Mapping[str, str]) -> FileSurvey:
    table = file.table
    columns = [_read_header(h, k, renamed) for k, h in enumerate(table.headers)]
    times = find_times(columns, table)
    clock = next(iter(times), None) or next(filter(None, map(read_time, columns)), None)
    arrays: dict[int, np.ndarray] = {}
    stamps: dict[int, Stamps] = {}
    findings: list[Finding] = []
    for k in range(len(columns)):
        if columns[k].header and _is_column(file, k):
            values = file.values([k], [k])
            findings += [f for f in values.findings if f not in findings]
            if k in values.stamps:
                stamps[k] = values.stamps[k]
            elif not values.problems:
                arrays[k] = values.arrays[k]
            else:
                count, rows = int(np.isfinite(values.arrays[k]).sum()), len(values.arrays[k])
                # Numbers with some text or marks among them: shown for what they are, and not passed over as remarks.
                if count > rows / 2:
                    arrays[k] = values.arrays[k]
                elif WITHOUT_MARKS not in values.problems[0]:
                    continue
                about = {"count": count, "rows": rows, "reason": values.problems[0]}
                findings.append(Finding(RecordCode.COLUMN_WITH_TEXT, Severity.WARNING, columns[k].header, about))
    if sampling_time:
        held: dict[int, np.ndarray | Stamps] = {**arrays, **stamps}
        likely_times = [c for c in find_likely_times(columns, table) if c.position in held]
        times = times or [c for c in likely_times if counts_up(held[c.position])]
        if times:
            raise DataError(f"{file.path.name}: {describe_second_time(times[0])}")
        clock = None
    rows = max((len(a) for a in arrays.values()), default=0)
    time: np.ndarray | None = None
    if clock is not None and clock.position in arrays:
        counted = arrays[clock.position]
        unit = clock.unit or find_stamp_unit(counted)
        columns[clock.position] = clock = replace(clock, unit=unit)
        # As a fit reads it, and refused for the same reason.
        refused: list[str] = []
        time = find_conversion(clock, RequestedSignal(SignalKind.TIME, TIME, "s"), False, refused)(counted)
        dates = (
            from_epoch(time)
            if find_stamp_unit(time) == "s"
            else from_digits(counted)
            if clock.unit in ("", "s")
            else None
        )
        if refused:
            findings.append(Finding(RecordCode.TIME_UNUSABLE, Severity.WARNING, values={"reason": refused[0]}))
            time = None
        elif dates is not None:
            stamps[clock.position] = dates
        elif clock.position not in stamps and (likely := find_likely_unit(time, stated=bool(clock.unit))):
            columns[clock.position] = clock = replace(clock, unit=likely)
            reason = (
                f"its rows would be {measure_step(time):.4g} s apart: it is looked at in {likely}, which a fit asks for"
            )
            findings.append(Finding(RecordCode.TIME_UNUSABLE, Severity.WARNING, clock.header, {"reason": reason}))
            time = read_conversion(likely, "s")(counted)
    if clock is not None and clock.position in stamps:
        try:
            time, _, seen = stamps[clock.position].count_seconds(clock.header, clock.unit)
            arrays[clock.position] = time
            findings += seen
            columns[clock.position] = clock = replace(clock, unit="s")
        except DataError as error:
            findings.append(Finding(RecordCode.TIME_UNUSABLE, Severity.WARNING, values={"reason": str(error)}))
    elif sampling_time:
        time = sampling_time * np.arange(rows)
    labels = table.row_labels
    if time is not None and (twice := find_repeats(time, arrays.values())).any():
        counts = {"rows": int(twice.sum()), "first": labels.describe(np.flatnonzero(twice)[:1])}
        findings.append(Finding(RecordCode.ROWS_TWICE, values=counts))
        time, arrays = time[~twice], {k: array[~twice] for k, array in arrays.items()}
        labels = labels.without(twice)
    if time is None and clock is None:
        findings.append(Finding(RecordCode.NO_TIME, Severity.WARNING))
    elif time is not None and (problems := find_time_problems(time, labels)):
        findings.append(Finding(RecordCode.TIME_UNUSABLE, Severity.WARNING, values={"reason": problems[0]}))
        time = None
    elif time is not None and (gap := sampling.find_longest_time_gap(time)) is not None:
        findings.append(gap)
    signals = []
    used = {TIME}
    for k, column in enumerate(columns):
        if not column.header:
            continue
        array = arrays.get(k)
        row_times = time if time is not None and array is not None and len(array) == len(time) else None
        is_clock = clock is not None and k == clock.position
        signals.append(_survey_signal(column, "", array, row_times, used, is_clock=is_clock))
    alike = {
        s.header: arrays[c.position]
        for s, c in zip(signals, (c for c in columns if c.header), strict=True)
        if s.use in ("input", "output")
    }
    guessed = _with_input(signals)
    if time is not None:
        findings += _find_faults(time, {h: v for h, v in alike.items() if len(v) == len(time)}, guessed)
    return FileSurvey(file.path.name, file.kind.name, guessed, tuple(findings))


def _is_column(file: file_kinds.RecordFile, position: int) -> bool:
    table = file.table
    if not isinstance(table, array_table.ArrayTable):
        return True
    info = table.infos[table.columns[position].array]
    return not info.holds and math.prod(info.shape) > 1


def _survey_channels(
    file: file_kinds.RecordFile, table: channels.ChannelTable, renamed: Mapping[str, str]
) -> FileSurvey:
    signals: list[SignalSurvey] = []
    findings: list[Finding] = list(table.findings)
    used = {TIME}
    by_base: dict[bytes, tuple[np.ndarray, dict[str, np.ndarray]]] = {}
    by_name: dict[str, list[tuple[str, Samples]]] = {}
    several = len({c.clock for c in table.channels}) > 1
    for k, channel in enumerate(table.channels):
        header = table.headers[k + 1]
        stated = _read_header(header, k + 1, renamed)
        is_told = stated.known is UnitSource.TOLD
        column = stated if is_told else replace(stated, unit=channel.unit, known=UnitSource.STATED)
        clock = channel.clock if several else ""
        if channel.holds:
            signals.append(_survey_signal(column, clock, None, None, used, rows=channel.rows))
            continue
        samples = file.load_channel(k).without_repeats()
        problems = find_stamp_problems(samples)
        if problems:
            values = {"reason": problems[0]}
            findings.append(Finding(RecordCode.TIME_UNUSABLE, Severity.WARNING, header, values))
        signal = _survey_signal(column, clock, samples.values, None if problems else samples.time, used)
        signals.append(signal)
        if signal.use in ("input", "output") and not problems:
            key = samples.time.tobytes()
            by_base.setdefault(key, (samples.time, {}))[1][header] = samples.values
            by_name.setdefault(channel.name, []).append((channel.clock, samples))
    guessed = _with_input(signals)
    for time, alike in by_base.values():
        findings += _find_faults(time, alike, guessed)
    for name, copies in by_name.items():
        first_clock, first = copies[0]
        for other_clock, other in copies[1:]:
            offset = None if other_clock == first_clock else estimate_clock_offset(first, other)
            if offset is not None:
                figures = {n: float(v) for n, v in offset._asdict().items()}
                about = {"reference": first_clock, "signal": name, **figures}
                findings.append(Finding(RecordCode.CLOCK_OFFSET, Severity.WARNING, other_clock, about))
    return FileSurvey(file.path.name, file.kind.name, guessed, tuple(findings))


# A command stays where it is put and comes back to its ends: of an input that is no fault of a sensor.
AS_COMMANDED = (RecordCode.SENSOR_FROZEN, RecordCode.SENSOR_DEAD, RecordCode.SENSOR_SATURATED)


def _find_faults(time: np.ndarray, signals: Mapping[str, np.ndarray], guessed: Sequence[SignalSurvey]) -> list[Finding]:
    """Doubts about each signal, by what it may be; the others of its stamps tell whether the plant moves."""
    findings: list[Finding] = []
    inputs = {s.header for s in guessed if s.use == "input"}
    left_out = (RecordCode.INPUT_CONSTANT, RecordCode.OUTPUT_GAPS)
    for header, values in signals.items():
        others = {h: v for h, v in signals.items() if h != header and np.isfinite(v).all()}
        if is_held(values):
            continue
        for finding in sensor_faults.inspect_signals(time, others, {header: values}):
            if finding.subject != header or finding.code in (*left_out, *(AS_COMMANDED if header in inputs else ())):
                continue
            kind = "input" if header in inputs else "signal"
            findings.append(replace(finding, values={**finding.values, "kind": kind}))
    return findings


def _survey_signal(
    column: Column,
    clock: str,
    values: np.ndarray | None,
    time: np.ndarray | None,
    used: set[str],
    *,
    is_clock: bool = False,
    rows: int = 0,
) -> SignalSurvey:
    if values is None or not len(values):
        return SignalSurvey(
            column.header, column.unit, clock, rows, 0, None, False, None, None, None, None, 0, False, "text", ""
        )
    known = values[np.isfinite(values)]
    regular = time is not None and sampling.find_sampling_time(time) is not None
    held = is_held(values)
    use = _guess_use(column, values, held)
    name = TIME if is_clock else _make_name(column.name, used)
    model_unit, stated_unit = _write_unit(column)
    if column.known is UnitSource.TOLD:
        stated_unit = column.unit
    elif is_clock:
        stated_unit = read_notation(column.unit, "s") if column.known is UnitSource.ENDING else ""
    return SignalSurvey(
        column.header,
        column.unit,
        clock,
        len(values),
        len(values) - len(known),
        float(np.median(np.diff(time))) if time is not None else None,
        regular,
        float(time[0]) if time is not None else None,
        float(time[-1]) if time is not None else None,
        float(known.min()) if len(known) else None,
        float(known.max()) if len(known) else None,
        len(sampling.find_time_gaps(time)) if time is not None else 0,
        held,
        "time" if is_clock else use,
        name,
        model_unit,
        stated_unit,
    )


def _write_unit(column: Column) -> tuple[str, str]:
    """The unit that a model can give to a column, and the one that a person has to state for it: "" where the header does."""
    ending = next((r.unit for r in read_endings(column) if len(r.unit) > 1 or r.unit == "%"), "")
    try:
        unit = read_notation(column.unit or ending)
    except ModelError:
        return "1", "1"
    if unit == COUNT or not unit:
        return "1", ""
    # Data in degrees Celsius are read by a model in kelvin; what is neither a plain number nor an angle (byte, pi) is no unit.
    known = "K" if converts(unit, "K") else unit
    is_number = not parse_unit(known).dimensions and not any(converts(unit, one) for one in ("1", "rad"))
    return ("1", "1") if is_number else (format_unit(known), "" if column.unit else unit)


def _guess_use(column: Column, values: np.ndarray, held: bool) -> str:
    """An input is held, or is called like one; nothing is certain but a constant."""
    if is_constant(values):
        return "constant"
    words = {w.lower() for w in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", column.name)}
    return "input" if held or words & INPUT_WORDS else "output"


def _make_name(text: str, used: set[str]) -> str:
    """The last part of a name as an identifier, with more of it where the last part is taken."""
    # An accent is left out, its letter is not: Füllstand is Fullstand.
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    parts = [p for p in re.split(r"[^0-9A-Za-z_]+", plain) if p] or ["signal"]
    for count in range(1, len(parts) + 1):
        name = "_".join(parts[-count:])
        name = f"s_{name}" if name[0].isdigit() else name
        if name not in used and (count > 1 or not name.isdecimal()):
            used.add(name)
            return name
    number = 2
    while f"{name}_{number}" in used:
        number += 1
    used.add(f"{name}_{number}")
    return f"{name}_{number}"


def _with_input(signals: Sequence[SignalSurvey]) -> tuple[SignalSurvey, ...]:
    """The signals; where none looks like an input, what is electrical beside something that is not: drives are."""
    if any(s.use == "input" for s in signals):
        return tuple(signals)
    driven = {s.header for s in signals if s.use == "output" and any(converts(s.model_unit, u) for u in "VAW")}
    if all(s.header in driven for s in signals if s.use == "output"):
        return tuple(signals)
    return tuple(replace(s, use="input") if s.header in driven else s for s in signals)
