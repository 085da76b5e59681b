"""Operating conditions that a file states itself: in a comment line, or in a column that does not move."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.errors import ModelError
from greybox.experiment.columns import RequestedSignal, SignalKind, parse_header
from greybox.experiment.findings import RecordCode
from greybox.experiment.policy import RECORD_POLICY, RecordPolicy
from greybox.findings import Finding
from greybox.model import Model
from greybox.units import convert

# ``# P_S = 801.3 kPa`` or ``# P_S [kPa]: 801.3``
_COMMENT = re.compile(r"^[#\s]*(?P<header>[^:=]+?)\s*[:=]\s*(?P<value>[^\s]+)\s*(?P<unit>.*?)\s*$")


def request_conditions(model: Model, names: Sequence[str]) -> list[RequestedSignal]:
    """The conditions ``names`` as signals to look for, in the units of the model's constants. Raises ModelError for other names."""
    return [RequestedSignal(SignalKind.CONDITION, name, model.parameter(name).unit) for name in names]


def read_conditions(
    conditions: Sequence[RequestedSignal],
    columns: Mapping[str, np.ndarray],
    comments: Sequence[str],
    problems: list[str],
    policy: RecordPolicy = RECORD_POLICY,
) -> tuple[dict[str, float], list[Finding]]:
    """The value of each condition, and a finding with its source; missing or invalid values go to ``problems``.

    ``columns``: values (N,) of those that have a column, in the model's units; the mean is taken. Else a line of ``comments``.
    """
    values: dict[str, float] = {}
    findings: list[Finding] = []
    for signal in conditions:
        has_column = signal.name in columns
        if has_column:
            value = _average_column(signal, columns[signal.name], problems, policy)
        else:
            value = _find_in_comments(signal, comments, problems)
        if value is not None:
            values[signal.name] = value
            figures = {"value": value, "unit": signal.unit, "source": "column" if has_column else "comment"}
            findings.append(Finding(RecordCode.CONDITION_READ, subject=signal.name, values=figures))
    return values, findings


def _average_column(
    signal: RequestedSignal, values: np.ndarray, problems: list[str], policy: RecordPolicy
) -> float | None:
    known = values[np.isfinite(values)]
    if not len(known):
        problems.append(f"{signal.label}: its column holds no number; fill it, or give the value")
        return None
    mean = float(known.mean())
    if known.std() > policy.condition_spread * abs(mean):
        problems.append(
            f"{signal.label}: its column runs from {known.min():.6g} to {known.max():.6g} {signal.unit}, so it is no condition of the"
            " whole record; give one value, or declare it as an input that a constant follows (Model.schedule)"
        )
        return None
    return mean


def _find_in_comments(signal: RequestedSignal, comments: Sequence[str], problems: list[str]) -> float | None:
    lines = [
        line for line in map(_COMMENT.match, comments) if line and parse_header(line["header"], 0).name == signal.name
    ]
    if len(lines) != 1:
        what = "has several comment lines" if lines else "has neither a column nor a comment line"
        problems.append(
            f"{signal.label} {what}; write one such as '# {signal.name} = 1.5 {signal.unit}', or give the value"
            f" (shell: --condition {signal.name}=<value>)"
        )
        return None
    (line,) = lines
    unit = line["unit"].strip("[]() ") or parse_header(line["header"], 0).unit or signal.unit
    try:
        return float(np.asarray(convert([float(line["value"])], unit, signal.unit))[0])
    except (ValueError, ModelError) as error:
        problems.append(f"{signal.label}: the comment line {line[0].strip()!r} is not understood ({error})")
        return None
