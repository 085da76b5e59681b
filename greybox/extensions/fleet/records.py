"""Where the records of a fleet lie: files, folders of files, or one Parquet file with a column that names the record of each row.

Only their places are collected; each record is read where it is fitted, so that a fleet need not fit into memory.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, nearest
from greybox.base.texts import to_word
from greybox.data.experiment import Experiment
from greybox.data.file_kinds import list_record_files
from greybox.data.findings import RecordCode
from greybox.data.policy import READING_POLICY
from greybox.data.read import find_shared_courses, read_csv
from greybox.model import Model


@dataclass(frozen=True)
class RecordReference:
    """Where one record lies.

    Parameters
    ----------
    name
        What results call it.
    path
        Its file.
    rows, column
        In a file of several records its first row and the one behind its last, and the column that names the record of each row.
    problem
        Why it cannot be read, where that is known already.
    """

    name: str
    path: Path
    rows: tuple[int, int] | None = None
    column: str = ""
    problem: str = ""

    @property
    def identity(self) -> tuple[Any, ...]:
        """What changes when the record does: its place, size and time of the last change."""
        try:
            stamp = self.path.stat()
        except OSError:
            return str(self.path.resolve()), self.rows
        return str(self.path.resolve()), self.rows, stamp.st_size, stamp.st_mtime_ns


@dataclass(frozen=True)
class RecordCollection:
    """The records of a fleet, and how their files are laid out.

    Parameters
    ----------
    references
        Where each lies.
    layout
        Arguments of `greybox.read_csv` for all of them.
    findings
        What is said of each record.
    """

    references: tuple[RecordReference, ...]
    layout: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.references)

    def with_courses_of(self, records: Sequence[Experiment]) -> RecordCollection:
        """With one course for each input that nobody told, as some ``records`` show it: a signal of a fleet moves in one way."""
        given = self.layout.get("interpolation") or {}
        shared = find_shared_courses(records, self.layout.get("hold", "auto"), given) if records else {}
        moving = {n: r.courses[n] for r in records for n, values in r.inputs.items() if np.ptp(values) > 0}
        straight = {f.subject: f for r in records for f in r.findings if f.code == RecordCode.INPUT_TAKEN_STRAIGHT}
        findings = [f for n, f in straight.items() if n not in shared]
        findings += [
            Finding(RecordCode.INPUT_COURSE_SHARED, subject=n, values={"course": c}) for n, c in shared.items()
        ]
        return replace(
            self, layout={**self.layout, "interpolation": {**moving, **shared, **given}}, findings=tuple(findings)
        )

    def read(self, reference: RecordReference, model: Model) -> Experiment:
        """One record in the model's units. Raises DataError."""
        if reference.problem:
            raise DataError(reference.problem)
        source: Any = reference.path
        if reference.rows is not None:
            from greybox.extensions.formats.parquet_file import open_parquet_part

            policy = self.layout.get("reading", READING_POLICY)
            source = open_parquet_part(reference.path, reference.rows, reference.column, policy)
        record = read_csv(source, model, name=reference.name, **self.layout)
        return replace(record, findings=(*record.findings, *self.findings))


def find_records(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    record: str = "",
    **layout: Any,
) -> RecordCollection:
    """List the records in files and folders; none is read yet.

    Parameters
    ----------
    paths
        Files of any kind that can be read, and folders of such files. Files of the same name get their folder's name in front.
    record
        Column that names the record of each row, for Parquet files that hold many; the rows of a record stand together.
    **layout
        Options of `greybox.read_csv` for all records: ``columns``, ``sampling_time``, ``hold`` ... `fit_each` takes one course for an
        input that nobody tells, as a dozen records show it.

    Returns
    -------
    RecordCollection
        In the order of the names, numbers by their size; records of one Parquet file in the order of the file. A Parquet file that
        cannot be opened counts as a record with its reason.

    Raises
    ------
    DataError
        For no file, a folder without records, or ``record`` beside a file that is no Parquet file.
    TypeError
        For an option that `greybox.read_csv` does not have.

    Examples
    --------
    >>> find_records("bench/2024-06", hold="first")  # doctest: +SKIP
    >>> find_records("bench.parquet", record="serial_number")  # doctest: +SKIP
    """
    known = {*signature(read_csv).parameters}.difference(("path", "model", "name"))
    if unknown := layout.keys() - known:
        raise TypeError(f"find_records has no option {min(unknown)!r}; {nearest(min(unknown), known)}")
    files = list_record_files([paths] if isinstance(paths, str | os.PathLike) else paths)
    if not files:
        raise DataError("no records; give a file or a folder of records")
    references: list[RecordReference] = []
    for file in files:
        if record:
            references += _list_parts(file, record)
        else:
            references.append(RecordReference(file.stem, file.absolute()))
    # Two of one name get their folder's name in front, or that of the file that holds both; two that still share it their whole path.
    counts = Counter(each.name for each in references)
    for k, each in enumerate(references):
        if counts[each.name] > 1:
            place = each.path.parent.name if each.rows is None else each.path.stem
            references[k] = replace(each, name=f"{place}/{each.name}")
    counts = Counter(each.name for each in references)
    for k, each in enumerate(references):
        if counts[each.name] > 1:
            references[k] = replace(each, name=f"{each.path}{'' if each.rows is None else ' ' + each.name}")
    return RecordCollection(tuple(references), layout)


def _list_parts(file: Path, record: str) -> list[RecordReference]:
    """The records of one file by the column ``record``."""
    from greybox.extensions.formats.parquet_file import PARQUET, find_record_rows

    if file.suffix.lower() not in PARQUET.suffixes:
        raise DataError(
            f"{file.name}: a column names the record of each row in Parquet files only; give a Parquet file, or one file for each"
            f" record without record={record!r} (shell: --record {to_word(record)})"
        )
    try:
        rows = find_record_rows(file, record)
    except DataError as error:
        return [RecordReference(file.stem, file.absolute(), problem=str(error))]
    return [RecordReference(name, file.absolute(), part, record) for name, part in rows.items()]
