"""From a file to an `Experiment` in the model's units. Nothing is repaired: a bad file is refused with every reason."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from greybox.errors import DataError
from greybox.experiment.array_table import read_mat, read_npz, read_parquet
from greybox.experiment.columns import TIME, ColumnMatch, SignalKind, convert_column, match_columns
from greybox.experiment.conditions import read_conditions, request_conditions
from greybox.experiment.experiment import Experiment, Hold
from greybox.experiment.findings import RecordCode
from greybox.experiment.policy import RECORD_POLICY, RecordPolicy
from greybox.experiment.problems import (
    enumerate_first,
    find_array_problems,
    find_measurement_problems,
    raise_problems,
)
from greybox.experiment.table import DataTable
from greybox.experiment.text_table import read_text
from greybox.findings import Finding
from greybox.model import Model

READERS: Mapping[str, Callable[[Path], DataTable]] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), read_text),
    ".mat": read_mat,
    ".npz": read_npz,
    ".parquet": read_parquet,
}
Arrays = dict[str, np.ndarray]


def read_csv(
    path: str | os.PathLike[str],
    model: Model,
    *,
    columns: Mapping[str, str] | None = None,
    hold: Hold = "zero",
    name: str | None = None,
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
    policy: RecordPolicy = RECORD_POLICY,
) -> Experiment:
    """Read a record for ``model`` from a CSV, TSV, TXT, MAT (up to version 7), NPZ or Parquet file.

    Headers are ``name [unit]``, ``name (unit)`` or ``name`` (then in the model's unit, which ``findings`` say); names are those of
    the model's inputs and outputs, exactly, and ``time`` or ``t`` (seconds unless a unit is given). Values are converted to the
    model's units. Other columns are ignored, which ``findings`` say. Every input needs its column; of the outputs at least
    one. Empty fields and NaN are gaps, allowed in outputs only. Text files: columns separated by ``,``, ``;``, tab or
    blanks, decimal comma except between commas, lines that begin with ``#`` are comments.

    Parameters
    ----------
    path
        The file.
    model
        Its inputs and outputs are looked for, and their units are those of the record.
    columns
        Signal -> header, where the file's headers are others: ``{"x": "Laser ch1 [um]", "time": "Zeit [ms]"}``.
    hold
        How the input moves between samples, see `Experiment`.
    name
        What results call the record; None takes the file's name without suffix.
    conditions
        Constants of this experiment, name -> value; None as the value takes it from the file, which has a column of that name
        (its mean is taken) or a comment line such as ``# P_S = 801 kPa``.
    allow_constant_input
        Accept inputs that are zero throughout (free decay).
    policy
        When a record is long enough, and when a sensor is in doubt.

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
    (experiment,) = _read_runs(path, model, columns, hold, name, conditions, allow_constant_input, policy, split=False)
    return experiment


def read_experiments(
    paths: Sequence[str | os.PathLike[str]],
    model: Model,
    *,
    columns: Mapping[str, str] | None = None,
    hold: Hold = "zero",
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
    split: bool = False,
    policy: RecordPolicy = RECORD_POLICY,
) -> tuple[Experiment, ...]:
    """Read several records for one model, each as `read_csv` does.

    Parameters
    ----------
    paths
        The files. Files of the same name get their folder's name in front.
    model, columns, hold, conditions, allow_constant_input, policy
        As of `read_csv`.
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
    stems = [f.stem for f in files]
    experiments: list[Experiment] = []
    problems: list[str] = []
    for file in files:
        name = file.stem if stems.count(file.stem) == 1 else f"{file.parent.name}/{file.stem}"
        try:
            experiments += _read_runs(
                file, model, columns, hold, name, conditions, allow_constant_input, policy, split=split
            )
        except DataError as error:
            problems.append(str(error))
    if problems:
        raise DataError("\n".join(problems))
    return tuple(experiments)


def open_table(path: str | os.PathLike[str]) -> tuple[Path, DataTable]:
    """A file that is there and can be read, and its table. Raises DataError otherwise, with the nearest file names."""
    file = _find_file(path)
    if not file.stat().st_size:
        raise DataError(f"{file.name}: the file is empty; it needs a header line and rows of numbers")
    try:
        return file, READERS[file.suffix.lower()](file)
    except OSError as error:
        raise DataError(f"{file}: cannot be read ({error})") from error


def _read_runs(
    path: str | os.PathLike[str],
    model: Model,
    columns: Mapping[str, str] | None,
    hold: Hold,
    name: str | None,
    conditions: Mapping[str, float | None] | None,
    allow_constant_input: bool,
    policy: RecordPolicy,
    *,
    split: bool,
) -> list[Experiment]:
    """The record in a file as `read_csv` gives it; with ``split`` each run of a file in which time starts anew."""
    file, table = open_table(path)
    given = {name: value for name, value in (conditions or {}).items() if value is not None}
    requested = request_conditions(model, [name for name in conditions or {} if name not in given])
    match = match_columns(table.headers, model, columns, requested)
    raise_problems(file.name, match.problems)
    (time, inputs, outputs, condition_columns), problems = _convert_arrays(table, match)
    raise_problems(file.name, problems)
    from_file, findings = read_conditions(requested, condition_columns, table.comments, problems, policy)
    runs = _cut_runs(time, inputs, outputs, split)
    for rows, t, u, y in runs:
        # A file of too few rows is called so, and not by what else follows from it.
        if len(t) > 1:
            problems += find_array_problems(t, u, y, table.row_labels.select(rows))
        problems += find_measurement_problems(u, y, len(t), allow_constant_input, policy)
    raise_problems(file.name, problems)
    title, findings = name or file.stem, [*_inspect_columns(match), *findings]
    if len(runs) > 1:
        findings.append(Finding(RecordCode.ONE_OF_RUNS, values={"runs": len(runs)}))
    return [
        Experiment.from_arrays(
            t,
            u,
            y,
            name=title if len(runs) == 1 else f"{title}[{rows.start}:{rows.stop}]",
            hold=hold,
            source=file.name,
            conditions=given | from_file,
            findings=tuple(findings),
            allow_constant_input=allow_constant_input,
            policy=policy,
        )
        for rows, t, u, y in runs
    ]


def _cut_runs(
    time: np.ndarray, inputs: Arrays, outputs: Arrays, split: bool
) -> list[tuple[slice, np.ndarray, Arrays, Arrays]]:
    """The rows of each run with its arrays: with ``split`` a run ends where time goes back, else the whole is one."""
    starts = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist()] if split else [0]
    parts = [slice(a, b) for a, b in pairwise([*starts, len(time)])]
    return [
        (rows, time[rows], {n: v[rows] for n, v in inputs.items()}, {n: v[rows] for n, v in outputs.items()})
        for rows in parts
    ]


def _find_file(path: str | os.PathLike[str]) -> Path:
    file = Path(path)
    if file.is_dir():
        raise DataError(f"{file} is a folder; give a file in it ({', '.join(READERS)})")
    if file.suffix.lower() not in READERS and file.is_file():
        raise DataError(
            f"{file.name}: files of type {file.suffix or '(no suffix)'!r} cannot be read;"
            f" export it as one of {', '.join(READERS)}"
        )
    if file.is_file():
        return file
    if not file.parent.is_dir():
        raise DataError(f"{file}: file not found, there is no folder {str(file.parent)!r}")
    beside = sorted(f.name for f in file.parent.iterdir() if f.suffix.lower() in READERS)
    close = difflib.get_close_matches(file.name, beside, n=3, cutoff=0.5)
    remedy = (
        f"did you mean {' or '.join(map(repr, close))}?"
        if close
        else f"records there: {enumerate_first(beside[:8], len(beside)) or 'none'}"
    )
    raise DataError(f"{file}: file not found; {remedy}")


def _convert_arrays(
    table: DataTable, match: ColumnMatch
) -> tuple[tuple[np.ndarray, Arrays, Arrays, Arrays], list[str]]:
    """Time, inputs, outputs and conditions in the model's units, and the problems met on the way."""
    raw, problems = table.values([c.position for c in match.columns.values()])
    groups: dict[SignalKind, Arrays] = {kind: {} for kind in SignalKind}
    for signal, column in match.columns.items():
        groups[signal.kind][signal.name] = convert_column(raw[column.position], signal, column, problems)
    time = groups[SignalKind.TIME][TIME]
    return (time, groups[SignalKind.INPUT], groups[SignalKind.OUTPUT], groups[SignalKind.CONDITION]), problems


def _inspect_columns(match: ColumnMatch) -> list[Finding]:
    findings = []
    if match.unmeasured:
        findings.append(Finding(RecordCode.OUTPUT_NOT_MEASURED, values={"outputs": list(match.unmeasured)}))
    if match.unitless:
        units = {signal.name: signal.unit for signal in match.unitless}
        findings.append(Finding(RecordCode.UNITS_ASSUMED, values={"units": units}))
    if match.ignored:
        findings.append(Finding(RecordCode.COLUMNS_IGNORED, values={"columns": list(match.ignored)}))
    return findings
