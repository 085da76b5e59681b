"""The inputs of a file alone, for simulating where nothing was measured."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from greybox.errors import DataError, nearest
from greybox.experiment import Experiment
from greybox.experiment.columns import TIME, Column, RequestedSignal, SignalKind, convert_column, parse_header
from greybox.experiment.experiment import Hold
from greybox.experiment.problems import raise_problems
from greybox.experiment.read import open_table
from greybox.model import Model


def read_inputs(
    path: str | os.PathLike[str], model: Model, *, columns: Mapping[str, str] | None = None, hold: Hold = "zero"
) -> Experiment:
    """Read time and the inputs of a model from a file, to simulate where nothing was measured. Other columns are not read.

    Parameters
    ----------
    path
        The file, of a kind that `greybox.read_csv` reads.
    model
        Its inputs are looked for, and their units are those of the record.
    columns
        Signal -> header, where the file's headers are others.
    hold
        How the inputs move between samples, see `greybox.Experiment`.

    Returns
    -------
    Experiment
        A record without outputs.

    Raises
    ------
    DataError
        For a file that is missing, cannot be read, or lacks an input.
    """
    file, table = open_table(path)
    signals = [RequestedSignal(SignalKind.TIME, TIME, "s")]
    signals += [RequestedSignal(SignalKind.INPUT, i.name, i.unit) for i in model.inputs]
    headers = [parse_header(header, k) for k, header in enumerate(table.headers)]
    matched = {signal: _find_column(file.name, signal, headers, columns or {}) for signal in signals}
    raw, problems = table.values([c.position for c in matched.values()])
    values = {} if problems else {s.name: convert_column(raw[c.position], s, c, problems) for s, c in matched.items()}
    raise_problems(file.name, problems)
    time = values.pop(TIME)
    return Experiment(file.stem, time, values, {}, hold, source=file.name)


def _find_column(file: str, signal: RequestedSignal, headers: Sequence[Column], mapping: Mapping[str, str]) -> Column:
    wanted = mapping.get(signal.name)
    if wanted is not None:
        hits = [c for c in headers if wanted.strip() in (c.header, c.name)]
    elif signal.kind is SignalKind.TIME:
        hits = [c for c in headers if c.name.lower() in (TIME, "t")]
    else:
        hits = [c for c in headers if c.name == signal.name]
    if len(hits) == 1:
        return hits[0]
    problem = f"{len(hits)} columns for" if hits else "no column for"
    raise DataError(f"{file}: {problem} {signal.label}; {nearest(wanted or signal.name, [c.header for c in headers])}")
