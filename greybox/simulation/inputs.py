"""The inputs of a file alone, for simulating where nothing was measured."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from greybox.experiment import Experiment
from greybox.experiment.columns import ColumnMapping
from greybox.experiment.experiment import Hold
from greybox.experiment.policy import READING_POLICY, ReadingPolicy
from greybox.experiment.problems import find_array_problems, raise_problems
from greybox.experiment.read import read_arrays
from greybox.model import Model


def read_inputs(
    path: str | os.PathLike[str],
    model: Model,
    *,
    columns: ColumnMapping | Sequence[str] | None = None,
    sampling_time: float | None = None,
    hold: Hold = "zero",
    interpolation: Mapping[str, Hold] | None = None,
    reading: ReadingPolicy = READING_POLICY,
) -> Experiment:
    """Read time and the inputs of a model from a file, to simulate where nothing was measured. Other columns are not read.

    Parameters
    ----------
    path
        The file, of a kind that `greybox.read_csv` reads.
    model
        Its inputs are looked for, and their units are those of the record.
    columns, sampling_time, interpolation, reading
        As of `greybox.read_csv`.
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
    record = read_arrays(
        path,
        model,
        columns=columns,
        sampling_time=sampling_time,
        inputs_only=True,
        hold=hold,
        interpolation=interpolation,
        reading=reading,
    )
    file, labels = record.file.path, record.file.table.row_labels
    if len(record.time) > 1:
        raise_problems(file.name, find_array_problems(record.time, record.inputs, {}, labels))
    else:
        raise_problems(file.name, [f"{len(record.time)} rows; a record needs at least 2"])
    return Experiment(file.stem, record.time, record.inputs, {}, hold, source=file.name)
