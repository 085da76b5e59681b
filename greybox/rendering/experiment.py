"""Sentences about records, and a record in plain text."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from greybox.experiment.findings import RecordCode
from greybox.findings import Finding
from greybox.rendering.english import count_noun
from greybox.rendering.registry import register, renders, sentences

if TYPE_CHECKING:
    from greybox.experiment import Experiment

HOLDS = {
    "zero": "input held between samples",
    "first": "input linear between samples",
    "band-limited": "band-limited input between samples",
}
_LEAVE_EMPTY = "leave these fields empty"


def _enumerate(names: list[str], total: int) -> str:
    """``a, b and 40 more`` of ``total`` things."""
    return ", ".join(names) + (f" and {total - len(names)} more" if total > len(names) else "")


def _about_records(template: str | Callable[[Finding], str]) -> Callable[[Finding], str]:
    """The sentence of a finding, after the names of the records that it holds for (`collect_record_findings`)."""

    def write(finding: Finding) -> str:
        values = {"subject": finding.subject, **finding.values}
        text = template.format_map(values) if isinstance(template, str) else template(finding)
        records = finding.values.get("records", ())
        return f"{', '.join(records)}: {text}" if records else text

    return write


def _gaps(finding: Finding) -> str:
    gaps = finding.values["gaps"]
    return f"output {finding.subject!r} has {gaps} gap{'s' * (gaps != 1)} in {finding.values['rows']} rows"


def _spikes(finding: Finding) -> str:
    count, times = finding.values["count"], finding.values["times"]
    places = _enumerate([f"{t:.6g} s" for t in times], count)
    return (
        f"output {finding.subject!r} jumps away and back within one row, {count} time{'s' * (count != 1)} (at {places}): if"
        f" this is a fault of the sensor and not the motion of the plant, {_LEAVE_EMPTY}, or fit with a robust loss (shell: --loss huber)"
    )


def _time_gap(finding: Finding) -> str:
    v = finding.values
    what = f"{v['gaps']} gaps, the longest" if v["gaps"] > 1 else "a gap"
    return (
        f"time has {what} from {v['start']:.6g} to {v['stop']:.6g} s (usual step {v['usual_step']:.6g} s): the input is assumed to"
        " continue through it"
    )


def _pieces_left_out(finding: Finding) -> str:
    pieces = finding.values["pieces"]
    named = [f"{start:.6g} to {stop:.6g} s ({rows} rows)" for start, stop, rows in pieces[:5]]
    return f"excluded, too few rows between two gaps in time: {_enumerate(named, len(pieces))}"


def _units_assumed(finding: Finding) -> str:
    units = finding.values["units"]
    return f"the header gives no unit for {', '.join(units)}: {', '.join(units.values())} assumed"


def _columns_ignored(finding: Finding) -> str:
    columns = finding.values["columns"]
    return f"columns ignored: {_enumerate([repr(c) for c in columns[:8]], len(columns))}"


_SOURCES = {"column": "mean of its column", "comment": "from a comment of the file"}

_TEMPLATES: dict[RecordCode, str | Callable[[Finding], str]] = {
    RecordCode.INPUT_CONSTANT: "input '{subject}' is constant at {value:g}",
    RecordCode.OUTPUT_CONSTANT: "output '{subject}' is constant at {value:g}: a constant signal carries no information; leave"
    " it out",
    RecordCode.OUTPUT_GAPS: _gaps,
    RecordCode.SENSOR_FROZEN: "output '{subject}' stays at exactly {value:g} for {rows} rows, from {start:.6g} to {stop:.6g} s,"
    " while the input moves, with a jump before or after: if the sensor or the logger failed, " + _LEAVE_EMPTY,
    RecordCode.SENSOR_DEAD: "output '{subject}' stays at exactly {value:g} from {start:.6g} s to the end ({rows} rows) while the"
    " input keeps moving: if the sensor or the logger failed, " + _LEAVE_EMPTY,
    RecordCode.SENSOR_SPIKES: _spikes,
    RecordCode.SENSOR_SATURATED: "output '{subject}' reads exactly its {end} value, {value:g}, in {rows} rows and stays there"
    " {stays} times: if the sensor or the converter saturates, "
    + _LEAVE_EMPTY
    + " (an end stop of the plant looks the same)",
    RecordCode.TIME_ROUNDED: "time is rounded: steps from {shortest:.6g} to {longest:.6g} s differ by at most one unit of the last"
    " digit; a uniform step of {sampling_time:.6g} s is assumed",
    RecordCode.TIME_GAP: lambda f: (
        f"{_time_gap(f)}; split the record there with split_at_time_gaps() (shell: --split-holes)"
    ),
    RecordCode.INPUT_HELD_THROUGH_GAP: _time_gap,
    RecordCode.TIME_ROWS_MISSING: "{rows} rows are missing in {places} places (usual step {usual_step:.6g} s): the input is assumed"
    " to continue through each, which is wrong if it moved there",
    RecordCode.TIME_IRREGULAR: "time is irregular: steps from {shortest:.6g} to {longest:.6g} s; each interval is used as it is",
    RecordCode.PIECES_LEFT_OUT: _pieces_left_out,
    RecordCode.OUTPUT_NOT_MEASURED: lambda f: f"not measured: output {' and '.join(map(repr, f.values['outputs']))}",
    RecordCode.UNITS_ASSUMED: _units_assumed,
    RecordCode.COLUMNS_IGNORED: _columns_ignored,
    RecordCode.CONDITION_READ: lambda f: (
        f"condition {f.subject}: {f.values['value']:.6g} {f.values['unit']}, {_SOURCES[f.values['source']]}"
    ),
    RecordCode.ONE_OF_RUNS: "one of {runs} runs in its file: time restarts with each run",
    RecordCode.RESAMPLED: "resampled to every {sampling_time:.6g} s from {rows} rows",
    RecordCode.ALSO_FITTED: "the same data as the estimation record {record}: it cannot validate the model; use a record that was"
    " not fitted",
}
register({code: _about_records(template) for code, template in _TEMPLATES.items()})


def describe_range(values: np.ndarray) -> str:
    """Smallest and largest value, and how many are missing."""
    known = values[~np.isnan(values)]
    if not len(known):
        return "no value"
    return f"{known.min():.6g} to {known.max():.6g}, {count_noun(len(values) - len(known), 'gap')}"


@renders("Experiment")
def write_experiment(experiment: Experiment) -> str:
    """Rows, sampling, signals with their ranges, conditions and findings."""
    pace = f"every {experiment.sampling_time:.6g} s" if experiment.regular else "at irregular times"
    lines = [
        f"{experiment.name}: {experiment.rows} rows {pace}, {experiment.duration:.6g} s, {HOLDS[experiment.hold]},"
        f" data {experiment.fingerprint}"
    ]
    for kind, signals in (("input", experiment.inputs), ("output", experiment.outputs)):
        lines += [f"  {kind:<9} {name}: {describe_range(values)}" for name, values in signals.items()]
    lines += [f"  condition {name}: {value:g}" for name, value in experiment.conditions.items()]
    return "\n".join([*lines, *(f"  note      {text}" for text in sentences(experiment.findings))])
