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
from greybox.experiment.columns import TIME, ColumnMatch, convert_column, match_columns
from greybox.experiment.conditions import CONDITION, read_conditions, request_conditions
from greybox.experiment.experiment import Experiment, Hold
from greybox.experiment.problems import enumerate_first, find_array_problems, find_measurement_problems, raise_problems
from greybox.experiment.table import DataTable
from greybox.experiment.text_table import read_text
from greybox.model import Model

READERS: Mapping[str, Callable[[Path], DataTable]] = {
    ".csv": read_text, ".tsv": read_text, ".txt": read_text, ".dat": read_text,
    ".mat": read_mat, ".npz": read_npz, ".parquet": read_parquet,
}  # fmt: skip
Arrays = dict[str, np.ndarray]
IGNORED_SHOWN = 8  # headers named in the note on columns that nobody asked for


def read_csv(
    path: str | os.PathLike[str],
    model: Model,
    *,
    columns: Mapping[str, str] | None = None,
    hold: Hold = "zero",
    name: str | None = None,
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
) -> Experiment:
    """Read a record for ``model`` from a CSV, TSV, TXT, MAT (up to version 7), NPZ or Parquet file.

    Headers are ``name [unit]``, ``name (unit)`` or ``name`` (then in the model's unit, which ``notes`` say); names are those of the model's
    inputs and outputs, exactly, and ``time`` or ``t`` (seconds unless a unit is given). Values are converted to the
    model's units. Other columns are ignored, which ``notes`` say. Every input needs its column; of the outputs at least
    one. Empty fields and NaN are gaps, allowed in outputs only. Text files: columns separated by ``,``, ``;``, tab or
    blanks, decimal comma except between commas, lines that begin with ``#`` are comments.

    ``columns``: signal -> header, where the file's headers are others: ``{"x": "Laser ch1 [um]", "time": "Zeit
    [ms]"}``. ``hold``: how the input moves between samples, see `Experiment`. ``name``: None takes the file's name
    without suffix. ``conditions``: constants of this experiment; None as the value takes it from the file, which has a column of
    that name (its mean is taken) or a comment line such as ``# P_S = 801 kPa``. ``allow_constant_input``: accept inputs that are
    zero throughout (free decay).

    Raises DataError with every problem of the file in one message, rows called by their line number in the file.
    """
    (experiment,) = _runs(path, model, columns, hold, name, conditions, allow_constant_input, split=False)
    return experiment


def _runs(
    path: str | os.PathLike[str], model: Model, columns: Mapping[str, str] | None, hold: Hold, name: str | None,
    conditions: Mapping[str, float | None] | None, allow_constant_input: bool, *, split: bool,
) -> list[Experiment]:  # fmt: skip
    """The record in a file as `read_csv` gives it; with ``split`` each run of a file in which time starts anew."""
    file = _existing(path)
    table = _opened(file)
    given = {name: value for name, value in (conditions or {}).items() if value is not None}
    sought = request_conditions(model, [name for name in conditions or {} if name not in given])
    found = match_columns(table.headers, model, columns, sought)
    raise_problems(file.name, found.problems)
    arrays, problems = _arrays(table, found)
    raise_problems(file.name, problems)
    time, inputs, outputs, steady = arrays
    read, said = read_conditions(sought, steady, table.comments, problems)
    found_runs = _cut(time, inputs, outputs, split)
    for rows, t, u, y in found_runs:
        # A file of too few rows is called so, and not by what else follows from it.
        if len(t) > 1:
            problems += find_array_problems(t, u, y, table.places.of(rows))
        problems += find_measurement_problems(u, y, len(t), allow_constant_input)
    raise_problems(file.name, problems)
    one, title, notes = len(found_runs) == 1, name or file.stem, (*_notes(found), *said)
    if not one:
        notes = (*notes, f"one of {len(found_runs)} runs in its file, in which time starts anew")
    return [
        Experiment.from_arrays(
            t, u, y, name=title if one else f"{title}[{rows.start}:{rows.stop}]", hold=hold, source=file.name,
            conditions=given | read, notes=notes, allow_constant_input=allow_constant_input,
        )
        for rows, t, u, y in found_runs
    ]  # fmt: skip


def _cut(
    time: np.ndarray, inputs: Arrays, outputs: Arrays, split: bool
) -> list[tuple[slice, np.ndarray, Arrays, Arrays]]:
    """The rows of each run with its arrays: with ``split`` a run ends where time goes back, else the whole is one."""
    starts = [0, *(np.flatnonzero(np.diff(time) < 0) + 1).tolist()] if split else [0]
    parts = [slice(a, b) for a, b in pairwise([*starts, len(time)])]
    return [
        (rows, time[rows], {n: v[rows] for n, v in inputs.items()}, {n: v[rows] for n, v in outputs.items()})
        for rows in parts
    ]


def read_experiments(
    paths: Sequence[str | os.PathLike[str]],
    model: Model,
    *,
    columns: Mapping[str, str] | None = None,
    hold: Hold = "zero",
    conditions: Mapping[str, float | None] | None = None,
    allow_constant_input: bool = False,
    split: bool = False,
) -> tuple[Experiment, ...]:
    """Read several records for one model, as `read_csv` does each; files of the same name get their folder's name in
    front. ``split``: a file in which time starts anew holds several runs, each a record ``name[first:last]``.

    Raises one DataError with the problems of all files.
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
            experiments += _runs(file, model, columns, hold, name, conditions, allow_constant_input, split=split)
        except DataError as error:
            problems.append(str(error))
    if problems:
        raise DataError("\n".join(problems))
    return tuple(experiments)


def _existing(path: str | os.PathLike[str]) -> Path:
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


def _opened(file: Path) -> DataTable:
    if not file.stat().st_size:
        raise DataError(f"{file.name}: the file is empty; it needs a header line and rows of numbers")
    try:
        return READERS[file.suffix.lower()](file)
    except OSError as error:
        raise DataError(f"{file}: cannot be read ({error})") from error


def _arrays(table: DataTable, found: ColumnMatch) -> tuple[tuple[np.ndarray, Arrays, Arrays, Arrays], list[str]]:
    """Time, inputs, outputs and conditions in the model's units, and the problems met on the way."""
    raw, problems = table.values([c.position for c in found.columns.values()])
    groups: dict[str, Arrays] = {TIME: {}, "input": {}, "output": {}, CONDITION: {}}
    for signal, column in found.columns.items():
        groups[signal.kind][signal.name] = convert_column(raw[column.position], signal, column, problems)
    return (groups[TIME][TIME], groups["input"], groups["output"], groups[CONDITION]), problems


def _notes(found: ColumnMatch) -> tuple[str, ...]:
    notes: list[str] = []
    if found.unmeasured:
        notes.append(f"not measured: output {' and '.join(map(repr, found.unmeasured))}")
    if found.unitless:
        names, units = (", ".join(getattr(s, part) for s in found.unitless) for part in ("name", "unit"))
        notes.append(f"no unit in the header of {names}: taken as {units}")
    if found.ignored:
        notes.append(
            f"columns ignored: {enumerate_first([repr(h) for h in found.ignored[:IGNORED_SHOWN]], len(found.ignored))}"
        )
    return tuple(notes)
