"""Records as CSV files that `read_csv` reads back without loss."""

from __future__ import annotations

import csv
import io
import math
import os
from pathlib import Path
from typing import BinaryIO

from greybox.experiment.experiment import Experiment
from greybox.files import write_file
from greybox.model import Model


def write_csv(experiment: Experiment, model: Model, path: str | os.PathLike[str]) -> Path:
    """Write a record as a CSV file that `greybox.read_csv` reads back without loss.

    Parameters
    ----------
    experiment
        The record; gaps become empty fields.
    model
        Its units go into the headers, ``name [unit]``; signals that it does not have are left out.
    path
        The file; folders are made.

    Returns
    -------
    Path
        The file.
    """
    inputs = [(s.name, s.unit, experiment.inputs[s.name]) for s in model.inputs if s.name in experiment.inputs]
    outputs = [(s.name, s.unit, experiment.outputs[s.name]) for s in model.outputs if s.name in experiment.outputs]
    signals = [("time", "s", experiment.time), *inputs, *outputs]
    heads = [f"{name} [{unit}]" if unit else name for name, unit, _ in signals]
    columns = [values.tolist() for _, _, values in signals]

    def write_rows(file: BinaryIO) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(heads)
        writer.writerows(["" if math.isnan(v) else repr(v) for v in row] for row in zip(*columns, strict=True))
        text.flush()
        text.detach()

    return write_file(path, write_rows)
