"""The inputs of a file alone, for simulating where nothing was measured."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.experiment.columns import TIME, Column, RequestedSignal, convert_column, parse_header
from greybox.experiment.experiment import Hold
from greybox.experiment.read import READERS
from greybox.model import Model

TIME_NAMES = (TIME, "t")


def read_inputs(
    path: str | os.PathLike[str], model: Model, *, columns: Mapping[str, str] | None = None, hold: Hold = "zero"
) -> Experiment:
    """Time and the inputs of ``model`` from a file, as an experiment without outputs; other columns are not looked at.

    Files, headers, ``columns`` and ``hold`` are those of `greybox.read_csv`. Raises DataError for a file that is
    missing, cannot be read, or lacks an input.
    """
    file = Path(path)
    if not file.is_file():
        wanted = ", ".join(["time", *(i.name for i in model.inputs)])
        raise DataError(f"{file}: file not found; give a file with {wanted}")
    if file.suffix.lower() not in READERS:
        raise DataError(
            f"{file.name}: files of type {file.suffix!r} cannot be read; export it as one of {', '.join(READERS)}"
        )
    table = READERS[file.suffix.lower()](file)
    signals = [RequestedSignal(TIME, TIME, "s"), *(RequestedSignal("input", i.name, i.unit) for i in model.inputs)]
    headers = [parse_header(header, k) for k, header in enumerate(table.headers)]
    found = {signal: _column(file.name, signal, headers, columns or {}) for signal in signals}
    raw, problems = table.values([c.position for c in found.values()])
    values = {} if problems else {s.name: convert_column(raw[c.position], s, c, problems) for s, c in found.items()}
    if problems:
        raise DataError(f"{file.name}: {'; '.join(problems)}")
    time = values.pop(TIME)
    return Experiment(file.stem, time, values, {}, hold, source=file.name)


def _column(file: str, signal: RequestedSignal, headers: Sequence[Column], mapping: Mapping[str, str]) -> Column:
    wanted = mapping.get(signal.name)
    if wanted is not None:
        hits = [c for c in headers if wanted.strip() in (c.header, c.name)]
    elif signal.kind == TIME:
        hits = [c for c in headers if c.name.lower() in TIME_NAMES]
    else:
        hits = [c for c in headers if c.name == signal.name]
    if len(hits) == 1:
        return hits[0]
    said = f"{len(hits)} columns for" if hits else "no column for"
    raise DataError(f"{file}: {said} {signal.label}; {nearest(wanted or signal.name, [c.header for c in headers])}")
