"""Operating conditions that a file states itself: in a comment line, or in a column that stays where it is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.errors import ModelError
from greybox.experiment.columns import RequestedSignal, parse_header
from greybox.model import Model
from greybox.units import convert

CONDITION = "condition"
# A column with more than this standard deviation, relative to its mean, is no condition of the whole record.
STEADY = 0.05
# ``# P_S = 801.3 kPa`` or ``# P_S [kPa]: 801.3``
_STATED = re.compile(r"^[#\s]*(?P<header>[^:=]+?)\s*[:=]\s*(?P<value>[^\s]+)\s*(?P<unit>.*?)\s*$")


def request_conditions(model: Model, names: Sequence[str]) -> list[RequestedSignal]:
    """The conditions ``names`` as signals to look for, in the units of the model's constants. Raises ModelError for other names."""
    return [RequestedSignal(CONDITION, name, model.parameter(name).unit) for name in names]


def read_conditions(
    conditions: Sequence[RequestedSignal],
    columns: Mapping[str, np.ndarray],
    comments: Sequence[str],
    problems: list[str],
) -> tuple[dict[str, float], list[str]]:
    """The value of each condition and where it is from; what is missing or unfit goes to ``problems``.

    ``columns``: values (N,) of those that have a column, in the model's units; the mean is taken. Else a line of ``comments``.
    """
    found: dict[str, float] = {}
    notes: list[str] = []
    for signal in conditions:
        if signal.name in columns:
            value, source = _mean(signal, columns[signal.name], problems), "mean of its column"
        else:
            value, source = _from_comments(signal, comments, problems), "from a comment of the file"
        if value is not None:
            found[signal.name] = value
            notes.append(f"condition {signal.name}: {value:.6g} {signal.unit}, {source}")
    return found, notes


def _mean(signal: RequestedSignal, values: np.ndarray, problems: list[str]) -> float | None:
    known = values[np.isfinite(values)]
    if not len(known):
        problems.append(f"{signal.label}: its column holds no number; fill it, or give the value")
        return None
    mean = float(known.mean())
    if known.std() > STEADY * abs(mean):
        problems.append(
            f"{signal.label}: its column runs from {known.min():.6g} to {known.max():.6g} {signal.unit}, so it is no condition of the"
            " whole record; give one value, or declare it as an input that a constant follows (Model.schedule)"
        )
        return None
    return mean


def _from_comments(signal: RequestedSignal, comments: Sequence[str], problems: list[str]) -> float | None:
    hits = [
        line for line in map(_STATED.match, comments) if line and parse_header(line["header"], 0).name == signal.name
    ]
    if len(hits) != 1:
        what = "has several comment lines" if hits else "has neither a column nor a comment line"
        problems.append(
            f"{signal.label} {what}; write one such as '# {signal.name} = 1.5 {signal.unit}', or give the value"
            f" (shell: --condition {signal.name}=<value>)"
        )
        return None
    unit = hits[0]["unit"].strip("[]() ") or parse_header(hits[0]["header"], 0).unit or signal.unit
    try:
        return float(np.asarray(convert([float(hits[0]["value"])], unit, signal.unit))[0])
    except (ValueError, ModelError) as error:
        problems.append(f"{signal.label}: the comment line {hits[0][0].strip()!r} is not understood ({error})")
        return None
