"""Sentences about records, and a record in plain text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from greybox.base import Finding
from greybox.base.document import Block, Details, Facts, Paragraphs, TableBlock
from greybox.base.texts import to_word
from greybox.data.experiment import LONG_GAP_ROWS
from greybox.data.findings import RecordCode
from greybox.data.noise.noise_model import BoundDirection, NoiseSource
from greybox.data.problems import enumerate_first
from greybox.show.sentences import register, renders, sentences
from greybox.show.sentences.wording import COURSES, count_noun, fill_in, join_names

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.data.noise.noise_model import AutoRegression, NoiseModel
    from greybox.data.survey import FileSurvey, SignalSurvey

HOLDS = {
    "zero": "input held between samples",
    "first": "input linear between samples",
    "band-limited": "band-limited input between samples",
    "mean": "input as means over the interval before each row",
}
# What to do about readings that are none: an input needs a value in every row.
_REMEDIES = {
    "output": "leave these fields empty",
    "signal": "leave these fields empty (where it is an input, write what acted: it needs a value in every row)",
    "input": "write what acted there: an input needs a value in every row",
}


def _about_records(template: str | Callable[[Finding], str]) -> Callable[[Finding], str]:
    """The sentence of a finding, after the names of the records that it holds for (`collect_record_findings`)."""

    def write(finding: Finding) -> str:
        values = {"subject": finding.subject, "kind": "output", **finding.values}
        values["remedy"] = _REMEDIES.get(values["kind"], _REMEDIES["output"])
        text = fill_in(template, (), values) if isinstance(template, str) else template(finding)
        records = finding.values.get("records", ())
        return f"{', '.join(records)}: {text}" if records else text

    return write


def _spikes(finding: Finding) -> str:
    count, times, kind = finding.values["count"], finding.values["times"], finding.values.get("kind", "output")
    places = enumerate_first([f"{t:.6g} s" for t in times], count)
    return (
        f"{kind} {finding.subject!r} jumps away and back within one row, {count} time{'s' * (count != 1)} (at {places}): if this is"
        f" a fault of the sensor and not the motion of the plant, {_REMEDIES[kind]}, or fit with a robust loss,"
        " FitOptions(loss='huber') (shell: --loss huber)"
    )


def _time_gap(finding: Finding) -> str:
    v = finding.values
    what = f"{v['gaps']} gaps, the longest" if v["gaps"] > 1 else "a gap"
    return (
        f"time has {what} from {v['start']:.6g} to {v['stop']:.6g} s (usual step {v['usual_step']:.6g} s): the input is assumed to"
        " continue through it"
    )


def _what_is_refused(finding: Finding) -> str:
    """What a simulation says of a long gap, as `refuse_unknown_input` and `refuse_long_time_gaps` do."""
    v = finding.values
    rows = round((v["stop"] - v["start"]) / v["usual_step"]) - 1
    if rows < LONG_GAP_ROWS:
        return ""
    return (
        f"; with its {rows} missing rows it is refused where the input moves by much in such a time, and by a nonlinear model, which is"
        " integrated in steps"
    )


def _pieces_left_out(finding: Finding) -> str:
    pieces = finding.values["pieces"]
    named = [f"{start:.6g} to {stop:.6g} s ({rows} rows)" for start, stop, rows in pieces[:5]]
    return f"excluded, too few rows between two gaps in time: {enumerate_first(named, len(pieces))}"


def _write_rate(step: float) -> str:
    """``1000 Hz``, or ``every 20 s``."""
    return f"{1 / step:.4g} Hz" if 0 < step <= 1 else f"every {step:.4g} s"


_COURSES = {"zero": "held", "first": "straight", "band-limited": "band-limited", "measured": "at the nearest rows"}


def _brought_to_one_time(finding: Finding) -> str:
    v = finding.values
    base = f"the stamps of {v['base']!r}" if v["base"] else "a uniform grid"
    signals = ", ".join(
        f"{name!r} ({_write_rate(step)}) {_COURSES[course]}"
        for name, _, step, course in v["signals"]
        if name != v["base"]
    )
    return (
        f"signals have stamps of their own; brought to {base} ({_write_rate(v['step'])}, {v['rows']} rows from {v['start']:.6g} to"
        f" {v['stop']:.6g} s): {signals}"
    )


def _clock_offset(finding: Finding) -> str:
    v = finding.values
    # A drift above zero is added to its stamps: they fall behind.
    course = "loses" if v["drift"] > 0 else "gains"
    drift = f", and {course} {1e6 * abs(v['drift']):.3g} us every second" if v["drift"] else ", both taken to run alike"
    return (
        f"clock {finding.subject!r} is {abs(v['offset']):.6g} s {'behind' if v['offset'] > 0 else 'ahead of'} clock"
        f" {v['reference']!r} (standard deviation {v['std']:.2g} s{drift}), as {v['signal']!r} on both shows; its stamps are corrected"
    )


_STAMPS = {"date": "dates", "clock": "times of day"}
_SOURCES = {"column": "mean of its column", "comment": "from a comment of the file"}

# How the unit of a column is known where its header does not state it as this library writes it.
_UNITS_READ = {
    "turns": "counts turns ({unit}; a turn is 2 pi rad)",
    "counts": "is taken as a plain number",
    "told": "is read in {unit}, as told",
    "name": "is in {unit}, as its name says",
    "size": "is in {unit} since 1970, by the size of its numbers",
    "notation": "is in {unit}",
}

_TEMPLATES: dict[RecordCode, str | Callable[[Finding], str]] = {
    RecordCode.INPUT_CONSTANT: "input '{subject}' is constant at {value:g}",
    RecordCode.INPUT_FOLLOWS_OUTPUT: "input {subject!r} follows output {output!r}: past readings tell {share:percent 2} of what its own"
    " past leaves open, as in a closed loop; a disturbance that nobody measured then acts on the input too, and what is said of the input"
    " may be the disturbance's",
    RecordCode.OUTPUT_CONSTANT: "{kind} '{subject}' is constant at {value:g}: a constant signal carries no information; leave it out",
    RecordCode.OUTPUT_GAPS: "output {subject!r} has {gaps:noun gap} in {rows} rows",
    RecordCode.OUTPUT_UNWRAPPED: "{kind} '{subject}' starts anew every {period:.6g} {unit}: {jumps} jumps taken out",
    RecordCode.TURNS_UNCERTAIN: "{kind} '{subject}' starts anew every {period:.6g} {unit} and may have gone on by more than half of that"
    " unseen, {times} times, first between {start:.6g} and {stop:.6g} s: the number of turns is a guess there; sample it faster, or split"
    " the record there (--split-holes)",
    RecordCode.SENSOR_FROZEN: "{kind} '{subject}' stays at exactly {value:g} for {rows} rows, from {start:.6g} to {stop:.6g} s,"
    " while the input moves, with a jump before or after: if the sensor or the logger failed, {remedy}",
    RecordCode.SENSOR_DEAD: "{kind} '{subject}' stays at exactly {value:g} from {start:.6g} s to the end ({rows} rows) while the"
    " input keeps moving: if the sensor or the logger failed, {remedy}",
    RecordCode.SENSOR_SPIKES: _spikes,
    RecordCode.SPIKES_LEFT_OUT: "{count:noun reading} of output {subject!r} that {count:jumps|jump} away and back within one row left out,"
    " as a robust loss was asked for",
    RecordCode.CODE_FOR_MISSING: "{kind} '{subject}' is exactly {value:.6g} in {rows} rows (first at {start:.6g} s), far from all its other"
    " values: if this stands for a missing reading, {remedy}",
    RecordCode.SENSOR_SATURATED: "{kind} '{subject}' reads exactly its {end} value, {value:g}, in {rows} rows and stays there"
    " {stays} times: if the sensor or the converter saturates, {remedy} (an end stop of the plant looks the same)",
    RecordCode.READING_COARSE: "{kind} '{subject}' reads in steps of {step:.4g}, which alone make an error of 0.29 steps (rms)",
    RecordCode.SENT_ON_CHANGE: lambda f: (
        f"{f.values.get('kind', 'output')} {f.subject!r} is sent when it has changed by {f.values['band']:.4g}: "
        + (
            "between two changes its last reading is repeated and off by up to so much (0.58 of it rms), always late: constants take"
            " this up, beyond their intervals"
            if f.values["held"]
            else "then a reading lies half a step from what the sensor feels"
        )
    ),
    RecordCode.ROWS_ON_CHANGE: "there is a row only when {kind} '{subject}' has changed by {band:.4g}: when an input changed between two"
    " rows is not recorded, and constants of fast motions take this up; log every change of the inputs too, or at a fixed rate",
    RecordCode.ROWS_OF_PAST: "the record begins in motion, and what its inputs were before is not told: its first {rows} rows"
    " ({seconds:.4g} s) only tell what reaches the rest late; with --before INPUT=VALUE (before=) they count",
    RecordCode.INPUT_TAKEN_STRAIGHT: "input {subject} is smooth and carries the noise of a sensor, as what is measured does and a"
    " computer's output does not: it is taken as straight between its rows; if it is held read the record with hold='zero' (shell:"
    " --interpolate {subject}=zero)",
    RecordCode.INPUT_COURSE_SHARED: lambda f: (
        f"input {f.subject} is taken as {COURSES[f.values['course']]}, in all of these records alike, as most of their rows show; if it is"
        f" not so tell it (shell: --interpolate {f.subject}=zero or =first)"
    ),
    RecordCode.INPUT_COURSES_DIFFER: lambda f: (
        f"input {f.subject} is {join_names([COURSES[c] for c in f.values['courses']])} from record to record; one signal moves in one way:"
        " tell it where they are read (hold=...)"
    ),
    RecordCode.TIME_ROUNDED: "time is rounded: steps from {shortest:.6g} to {longest:.6g} s differ by at most one unit of the last digit;"
    " a uniform step of {sampling_time:.6g} s is assumed",
    RecordCode.TIME_GAP: lambda f: (
        f"{_time_gap(f)}{_what_is_refused(f)}; split the record there with split_at_time_gaps() (shell: --split-holes)"
    ),
    RecordCode.INPUT_HELD_THROUGH_GAP: _time_gap,
    RecordCode.TIME_ROWS_MISSING: "{rows} rows are missing in {places} places (usual step {usual_step:.6g} s): the input is assumed to"
    " continue through each, which is wrong if it moved there",
    RecordCode.TIME_IRREGULAR: "time is irregular: steps from {shortest:.6g} to {longest:.6g} s; each interval is used as it is",
    RecordCode.TIME_JITTER: "time stamps jitter by {jitter:.2g} s (standard deviation; usual step {usual_step:.4g} s), and the readings do"
    " not: they were taken regularly and stamped late or early. Leave the time out and give the step (shell: '-' in its place in"
    " --columns, and --sampling-time SECONDS), or each error of a stamp counts as motion",
    RecordCode.PIECES_LEFT_OUT: _pieces_left_out,
    RecordCode.OUTPUT_NOT_MEASURED: lambda f: (
        f"not measured: output {' and '.join(map(repr, f.values['outputs']))}"
        + "".join(
            f"; is {header!r} {name}, whose unit it has? (shell: --column {to_word(f'{name}={header}')})"
            for name, header in f.values.get("columns", {}).items()
        )
    ),
    RecordCode.UNITS_ASSUMED: lambda f: (
        f"the header gives no unit for {', '.join(f.values['units'])}: {', '.join(f.values['units'].values())} assumed"
    ),
    RecordCode.MAY_BE_PER_CENT: lambda f: (
        f"{f.subject} is a plain number in the model, its header states no unit, and it reaches {f.values['largest']:.4g}: taken as it"
        f" stands; if it is per cent, say so (shell: --column {to_word(f.subject + ' [%]=' + f.values['header'])})"
    ),
    RecordCode.UNITS_READ: lambda f: (
        "units: "
        + "; ".join(
            f"{header!r} {_UNITS_READ[reason].format(unit=unit)}" for header, unit, reason in f.values["columns"]
        )
    ),
    RecordCode.COLUMNS_IGNORED: lambda f: (
        f"columns ignored: {enumerate_first([repr(c) for c in f.values['columns'][:8]], len(f.values['columns']))}"
    ),
    RecordCode.CONDITION_READ: lambda f: (
        f"condition {f.subject}: {f.values['value']:.6g} {f.values['unit']}, {_SOURCES[f.values['source']]}"
    ),
    RecordCode.FEW_ROWS: "only {rows} rows: the intervals hold if the model is right, and so few values hardly show whether it is",
    RecordCode.ONE_OF_RUNS: "one of {runs} runs in its file: time restarts with each run",
    RecordCode.ROWS_TWICE: lambda f: (
        f"{f.subject + ': ' if f.subject else ''}{count_noun(f.values['rows'], 'row')} written twice, time and values alike, counted once"
        + (f" (first {f.values['first']})" if "first" in f.values else "")
    ),
    RecordCode.RESAMPLED: "resampled to every {sampling_time:.6g} s from {rows} rows",
    RecordCode.NO_TIME: "no column is called time or t: name it (--column time=HEADER), or give the step (--sampling-time SECONDS)",
    RecordCode.COLUMN_WITH_TEXT: "{subject}: {count} of {rows} fields are numbers and the others are refused: {reason}",
    RecordCode.POINTS_OPEN: "{subject}: the points of {text} may stand between thousands, which a fit asks",
    RecordCode.TIME_UNUSABLE: lambda f: f"{f.subject + ': ' if f.subject else ''}{f.values['reason']}",
    RecordCode.BROUGHT_TO_ONE_TIME: _brought_to_one_time,
    RecordCode.CLOCK_OFFSET: _clock_offset,
    RecordCode.CLOCK_OFFSET_BY_RECORDER: "clocks '{reference}' and '{subject}' differ by {offset:.3g} s, by when their messages reached"
    " the recorder; the stamps of the second are corrected, to a few milliseconds",
    RecordCode.CLOCK_START: "clock '{subject}' was started {start:.6g} s after the first, as the file says; its stamps are shifted by that",
    RecordCode.DATES_READ: lambda f: (
        f"{f.subject}: {_STAMPS[f.values['kind']]}, counted in seconds from {f.values['start']}"
    ),
    RecordCode.MIDNIGHT_PASSED: "{subject}: the time of day starts anew {nights} times, each of which is read as midnight; write the date"
    " too where days are left out",
    RecordCode.SUMMER_TIME: lambda f: (
        f"{f.subject}: the clock was put {'back' if f.values['hours'] > 0 else 'forward'} by an hour before {f.values['at']}, as at a"
        " change of summer time; the hour is taken out (a time zone in the stamps would leave no doubt)"
    ),
    RecordCode.ORIGINS_APART: lambda f: (
        "its time counts from "
        + (f.values["own"] or "its own zero")
        + f", other records of this call from {f.values['start']}, with which it"
        " cannot be compared: how they lie to each other in time is not known"
    ),
    RecordCode.ROWS_BELOW_TABLE: "sheet '{subject}': the table ends at the empty row {row}, and {rows} rows below it are not read; remove"
    " the empty rows, or move what is below to a sheet of its own",
    RecordCode.SHEET_NOT_READ: "sheet '{subject}' is not read, as sheet '{read}' is: which column is its time cannot be told; call it"
    " time [s], or keep one column of dates or times of day",
    RecordCode.CLOCKS_NOT_COMPARED: "clocks '{reference}' and '{subject}' have no signal in common: an offset between them cannot be told"
    " from a delay of the plant; record one signal on both, or fit a delay (shell: --effect transport_delay)",
    RecordCode.ALSO_FITTED: "{place}, which is fitted: it cannot validate the model; use a record that is not",
}
register({code: _about_records(template) for code, template in _TEMPLATES.items()})


def describe_range(values: np.ndarray) -> str:
    """Smallest and largest value, and how many are missing."""
    known = values[~np.isnan(values)]
    if not len(known):
        return "no value"
    return f"{known.min():.6g} to {known.max():.6g}, {count_noun(len(values) - len(known), 'gap')}"


def _describe_courses(experiment: Experiment) -> str:
    if not isinstance(experiment.hold, Mapping):
        return (
            "every value a mean over the interval before its row"
            if experiment.hold == "mean"
            else HOLDS[experiment.hold]
        )
    return ", ".join(
        f"{n} {HOLDS[course].replace('input ', '').replace(' input', '')}" for n, course in experiment.hold.items()
    )


@renders("Experiment")
def write_experiment(experiment: Experiment) -> str:
    """Rows, sampling, signals with their ranges, conditions and findings."""
    pace = f"every {experiment.sampling_time:.6g} s" if experiment.regular else "at irregular times"
    lines = [
        f"{experiment.name}: {experiment.rows} rows {pace}, {experiment.duration:.6g} s, {_describe_courses(experiment)},"
        f" data {experiment.fingerprint}"
    ]
    for kind, signals in (("input", experiment.inputs), ("output", experiment.outputs)):
        lines += [f"  {kind:<9} {name}: {describe_range(values)}" for name, values in signals.items()]
    lines += [f"  condition {name}: {value:g}" for name, value in experiment.conditions.items()]
    return "\n".join([*lines, *(f"  note      {text}" for text in sentences(experiment.findings))])


@renders("FileSurvey")
def write_survey(survey: FileSurvey) -> list[Block]:
    """The signals as a table, what is doubtful, and the columns to name."""
    clocks = any(s.clock for s in survey.signals)
    head = [
        "signal",
        "unit",
        *(["clock"] if clocks else []),
        "samples",
        "rate",
        "from - to",
        "range",
        "holes",
        "may be",
    ]
    rows = [_write_signal(signal, clocks) for signal in survey.signals]
    inputs, outputs = ([s for s in survey.signals if s.use == use] for use in ("input", "output"))
    lines = [f'gb.Input("{s.name}", "{s.model_unit}")' for s in inputs]
    lines += [f'gb.Output("{s.name}", "{s.model_unit}")' for s in outputs]
    guess = "for a model (which signal is an input is a guess from names and from how they move):"
    renamed = {name: header for name, header in survey.columns.items() if name not in (header, _bare(header))}
    columns = " ".join(f"--column {to_word(name)}={to_word(header)}" for name, header in renamed.items())
    return [
        Paragraphs([_survey_answer(survey)]),
        TableBlock("Signals", head, rows),
        Facts([(str(f.severity), f) for f in survey.findings]),
        *([Details(guess, [Paragraphs(lines)])] if lines else []),
        Facts([("columns for it", columns)] if columns else []),
    ]


def _survey_answer(survey: FileSurvey) -> str:
    """What the file holds, which signals may be inputs and outputs, and how much of it is doubtful."""
    longest = max(survey.signals, key=lambda s: s.rows, default=None)
    rows = "" if longest is None else f", {count_noun(longest.rows, 'row')}"
    uses = []
    for use in ("input", "output"):
        if names := [s.name for s in survey.signals if s.use == use]:
            uses.append(
                f"{join_names(names[:5])} may be {use if len(names) > 1 else f'an {use}'}{'s' * (len(names) > 1)}"
            )
    doubts = count_noun(len(survey.findings), "thing") + " to know" if survey.findings else "nothing is doubtful"
    return f"{survey.file}: {survey.kind}, {count_noun(len(survey.signals), 'signal')}{rows}; {'; '.join([*uses, doubts])}."


def _bare(header: str) -> str:
    return header.partition(" [")[0]


def _write_signal(signal: SignalSurvey, clocks: bool) -> list[str]:
    holes = [count_noun(signal.gaps, "gap")] if signal.gaps else []
    holes += [f"{signal.missing} empty"] if signal.missing else []
    rate = "" if signal.step is None else _write_rate(signal.step) + ("" if signal.regular else ", irregular")
    span = "" if signal.start is None else f"{signal.start:.6g} - {signal.stop:.6g} s"
    values = "" if signal.lowest is None else f"{signal.lowest:.4g} to {signal.highest:.4g}"
    use = f"{signal.use}, held" if signal.held and signal.use == "input" else signal.use
    clock = [signal.clock] if clocks else []
    return [
        _bare(signal.header),
        signal.unit,
        *clock,
        str(signal.rows),
        rate,
        span,
        values,
        ", ".join(holes) or "-",
        use,
    ]


# Where the noise is known from, and its colour, in a few words.

SOURCES: Mapping[NoiseSource, str] = {
    NoiseSource.GIVEN: "given",
    NoiseSource.QUIET_RECORD: "a quiet record",
    NoiseSource.REPEATED_PERIODS: "repeated periods",
    NoiseSource.REPEATED_EXPERIMENTS: "repeated experiments",
    NoiseSource.FLAT_PIECES: "flat pieces of the records",
    NoiseSource.SPECTRUM: "the frequencies without signal",
    NoiseSource.DIFFERENCES: "differences of the records",
    NoiseSource.RESIDUAL: "the residual of the fit",
    NoiseSource.INNOVATIONS: "the innovations",
}
# What a level bounds, and why it may be larger than the noise.
_AT_MOST = {
    NoiseSource.FLAT_PIECES: "the loudest flat pieces of the records",
    NoiseSource.SPECTRUM: "what no linear response explains of the records, nonlinear motion included",
    NoiseSource.DIFFERENCES: "differences of the records, if the noise is white",
    NoiseSource.RESIDUAL: "the residual of the fit, which holds what the model lacks (too few samples for another source)",
}


@renders("AutoRegression")
def write_autoregression(process: AutoRegression) -> str:
    """``white``, or order and correlation."""
    if not process.order:
        return "white"
    return f"AR({process.order}), correlation {process.autocorrelation(2)[1]:.2g} from sample to sample"


@renders("NoiseModel")
def write_noise_model(noise: NoiseModel) -> str:
    """``given``, or ``x: estimated from a quiet record (AR(2), ...); i: ...``."""
    colours = dict(zip(noise.outputs, noise.colour, strict=True))
    texts = {}
    for name, source in noise.sources.items():
        bound = noise.bound(name)
        texts[name] = describe_source(source, colours[name], source.direction if bound is None else bound.direction)
    return join_alike(texts)


def join_alike(texts: Mapping[str, str], *, always_named: bool = False) -> str:
    """``x, v: given; i: ...``: what is said of each output, those together of which the same is said; only that where it is of all."""
    groups: dict[str, list[str]] = {}
    for name, text in texts.items():
        groups.setdefault(text, []).append(name)
    if len(groups) == 1 and not always_named:
        return next(iter(groups))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in groups.items())


def describe_source(source: NoiseSource, colour: AutoRegression, direction: BoundDirection | None = None) -> str:
    """Where the noise of one output is known from, with its colour, or what it is at most."""
    direction = direction or source.direction
    if direction is BoundDirection.AT_MOST:
        return f"at most {_AT_MOST.get(source, SOURCES[source])}"
    says_colour = source not in (NoiseSource.GIVEN, NoiseSource.DIFFERENCES, NoiseSource.RESIDUAL)
    with_colour = f" ({colour})" if says_colour or colour.order else ""
    if source is NoiseSource.GIVEN:
        return f"given{with_colour}"
    kind = "at least that of" if direction is BoundDirection.AT_LEAST else "estimated from"
    return f"{kind} {SOURCES[source]}{with_colour}"
