"""What fitting a fleet gives back: an estimate for each record, what the constants have in common, and their files."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from greybox.base import FileKind, Finding, GreyboxError, Printable, Severity, read_json, write_file
from greybox.base.json_file import StoredResult
from greybox.base.texts import to_cell
from greybox.estimation import Estimate, Fit, Misfit
from greybox.model import Model


class FleetCode(StrEnum):
    """Codes of the findings about a whole fleet."""

    RECORDS_FITTED = "fleet_records_fitted"
    """Values: ``fitted``, ``records``."""
    RECORD_WITHOUT_RESULT = "fleet_record_without_result"
    """Subject: the record. Values: ``reason``."""
    RECORDS_LEFT = "fleet_records_left"
    """Values: ``left``, ``records``."""
    RECORDS_ALIKE = "fleet_records_alike"
    """One measurement that is there twice. Subject: the second record. Values: ``first``, ``pairs``."""
    FINDING_COUNT = "fleet_finding_count"
    """How many records one finding is about. Subject: the first of them. Values: ``code``, ``records``, ``of``, ``sentence``."""


# Share of an error, and of a constant's standard deviation, by which two fits of one measurement may differ: where their searches ended. Of
# two measurements both agree so well, by chance, once in ten million pairs.
ALIKE_ERROR, ALIKE_VALUE = 1e-5, 1e-2


class RecordStatus(StrEnum):
    """What stands for the status of a search where there was none."""

    NOT_READ = "not_read"
    NOT_FITTED = "not_fitted"


@dataclass(frozen=True, eq=False)
class RecordEstimate:
    """One record of a fleet.

    Parameters
    ----------
    name
        The record.
    status, success
        How the search ended, as `greybox.Fit.status` says it, or `RecordStatus`.
    reason
        Why there is no result; empty where there is one.
    rows
        Rows of the record.
    parameters
        Name -> `Estimate`, as of `greybox.Fit`.
    misfit
        Output -> `Misfit` of the free run.
    findings
        What a reader should know before trusting a number, as of `greybox.Fit`.
    seconds
        Time that it took, reading included.
    """

    name: str
    status: str
    success: bool = False
    reason: str = ""
    rows: int = 0
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    misfit: Mapping[str, Misfit] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    seconds: float = 0.0

    @classmethod
    def of(cls, name: str, fit: Fit, rows: int, seconds: float) -> RecordEstimate:
        """What is kept of the fit of one record."""
        reason = "" if fit.success else fit.solver.status_message
        return cls(
            name,
            str(fit.status),
            fit.success,
            reason,
            rows,
            dict(fit.parameters),
            dict(fit.misfit),
            fit.findings,
            seconds,
        )

    @property
    def is_usable(self) -> bool:
        """Whether the constants mean something: the search succeeded, and the model follows the record."""
        return self.success and not any(f.severity is Severity.ERROR for f in self.findings)


@dataclass(frozen=True)
class ConstantDistribution:
    """One constant over the records of a fleet whose fit is usable and that determine it.

    Parameters
    ----------
    unit
        Of all values.
    count
        Records that determine it.
    median, low, high
        Median, and the range that holds 90 % of these records (their 5th and 95th percentile).
    std
        Standard deviation that a record leaves, the median over the records.
    spread
        Standard deviation from record to record beyond what the records leave open (a random-effects model, Paule and Mandel 1982);
        a share of the value where ``relative``.
    relative
        Whether the spread is one of the logarithm: all values are positive.
    undetermined
        Usable fits whose record leaves the constant open.
    at_bound
        Usable fits in which it was stopped by its bounds.
    """

    unit: str
    count: int
    median: float
    low: float
    high: float
    std: float
    spread: float
    relative: bool
    undetermined: int = 0
    at_bound: int = 0

    @classmethod
    def of(cls, estimates: Sequence[Estimate]) -> ConstantDistribution:
        """That of one constant's estimates in usable fits."""
        from greybox.extensions.changes.survey import RandomEffects

        known = [e for e in estimates if e.std is not None and e.determined and not e.at_bound]
        at_bound = sum(e.at_bound for e in estimates)
        counts = {"undetermined": len(estimates) - len(known) - at_bound, "at_bound": at_bound}
        if not known:
            nothing = math.nan
            return cls(estimates[0].unit, 0, nothing, nothing, nothing, nothing, nothing, False, **counts)
        values, std = np.array([e.value for e in known]), np.array([e.std for e in known], float)
        positive = bool((values > 0).all())
        # d ln(p) = dp / p
        effects = (
            RandomEffects.of(np.log(values), (std / values) ** 2) if positive else RandomEffects.of(values, std**2)
        )
        low, median, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
        return cls(
            known[0].unit,
            len(known),
            median,
            low,
            high,
            float(np.median(std)),
            math.sqrt(effects.spread),
            positive,
            **counts,
        )


@dataclass(frozen=True, eq=False)
class FleetResult(Printable, StoredResult):
    """One model fitted to each record of a fleet.

    Parameters
    ----------
    model
        The model; the searches of the first records began at its values.
    records
        What each record gave, in the order they were given; of an interrupted run those that are done.
    start
        Free constant -> value that the searches of the other records began at.
    options
        Options of the fits, as JSON data.
    noise
        Standard deviation by output that was given for all records; empty where each told its own.
    left
        Records that were not begun.
    seconds
        Time that it took.
    """

    model: Model
    records: tuple[RecordEstimate, ...]
    start: Mapping[str, float] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    left: int = 0
    seconds: float = 0.0

    FILE: ClassVar[FileKind] = FileKind("a fleet", "fleet.json that greybox fleet has written")
    KEYS: ClassVar[str] = """
        model=model.name records=total fitted left statuses without_result=reasons population misfit_over_noise=noise_ratios start
        noise options notes=str(findings) findings seconds
        """

    @property
    def total(self) -> int:
        """Records of the fleet, those that were not begun included."""
        return len(self.records) + self.left

    @property
    def fitted(self) -> int:
        """Records whose search succeeded."""
        return sum(r.success for r in self.records)

    @property
    def statuses(self) -> dict[str, int]:
        """How a search ended, in a word -> number of records."""
        return dict(Counter(r.status for r in self.records))

    @property
    def reasons(self) -> dict[str, str]:
        """Record that could not be read or fitted -> why."""
        return {r.name: r.reason for r in self.without_result}

    @property
    def usable(self) -> tuple[RecordEstimate, ...]:
        """The records whose constants mean something."""
        return tuple(r for r in self.records if r.is_usable)

    @property
    def without_result(self) -> tuple[RecordEstimate, ...]:
        """The records that could not be read or fitted, each with its ``reason``."""
        return tuple(r for r in self.records if not r.success)

    @property
    def population(self) -> dict[str, ConstantDistribution]:
        """Free constant -> its distribution over the records."""
        usable = self.usable
        free = [q.name for q in self.model.free_parameters]
        return {name: ConstantDistribution.of([r.parameters[name] for r in usable]) for name in free} if usable else {}

    @property
    def noise_ratios(self) -> dict[str, tuple[float, float, float]]:
        """Output -> 5th percentile, median and 95th percentile of misfit over noise of the records that were fitted."""
        names = [o.name for o in self.model.outputs]
        ratios = {n: [r.misfit[n].noise_ratio for r in self.records if r.success and n in r.misfit] for n in names}
        finite = {n: [v for v in values if math.isfinite(v)] for n, values in ratios.items()}
        return {n: tuple(np.quantile(values, (0.05, 0.5, 0.95)).tolist()) for n, values in finite.items() if values}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """How many records have a result, which have none and why, and what is said of how many, the most frequent first."""
        # A search may succeed with a model that follows nothing: the first line says of how many records the constants mean something.
        summary = {"fitted": self.fitted, "records": self.total, "followed": len(self.usable)}
        severity = Severity.NOTE if len(self.usable) == self.total else Severity.WARNING
        result = [Finding(FleetCode.RECORDS_FITTED, severity, "", summary)]
        if self.left:
            values = {"left": self.left, "records": self.total}
            result.append(Finding(FleetCode.RECORDS_LEFT, Severity.WARNING, "", values))
        result += [
            Finding(FleetCode.RECORD_WITHOUT_RESULT, Severity.WARNING, r.name, {"reason": r.reason})
            for r in self.without_result
        ]
        if alike := self._find_alike():
            twins: dict[str, Any] = {"first": alike[0][0], "pairs": len(alike)}
            result.append(Finding(FleetCode.RECORDS_ALIKE, Severity.WARNING, alike[0][1], twins))
        first: dict[str, tuple[str, Finding]] = {}
        counts: Counter[str] = Counter()
        for r in self.records:
            for finding in {str(f.code): f for f in r.findings}.values():
                counts[str(finding.code)] += 1
                first.setdefault(str(finding.code), (r.name, finding))
        for code, count in counts.most_common():
            name, finding = first[code]
            counted = {"code": code, "records": count, "of": len(self.records), "sentence": str(finding)}
            result.append(Finding(FleetCode.FINDING_COUNT, finding.severity, name, counted))
        return tuple(result)

    def _find_alike(self) -> list[tuple[str, str]]:
        """Pairs of records that are one measurement, whatever their files and clocks: noise never gives one fit twice."""

        def differs(a: RecordEstimate, b: RecordEstimate) -> bool:
            errors = any(abs(m.rmse - b.misfit[n].rmse) > ALIKE_ERROR * m.rmse for n, m in a.misfit.items())
            return errors or any(
                abs(e.value - b.parameters[n].value) > ALIKE_VALUE * e.std for n, e in a.parameters.items() if e.std
            )

        # Those of one size of error stand side by side.
        usable = [r for r in self.records if r.is_usable and r.misfit and all(m.rmse > 0 for m in r.misfit.values())]
        ordered = sorted(usable, key=lambda r: (r.rows, sorted(r.misfit), max(m.rmse for m in r.misfit.values())))
        pairs = [(a, b) for a, b in pairwise(ordered) if a.rows == b.rows and a.misfit.keys() == b.misfit.keys()]
        order = [r.name for r in self.records]
        names = [sorted((a.name, b.name), key=order.index) for a, b in pairs if not differs(a, b)]
        return [(a, b) for a, b in names]

    def table(self) -> dict[str, list[Any]]:
        """One row for each record as columns: status, constants with standard deviation and interval, misfit, findings.

        Returns
        -------
        dict
            Header -> values. Headers are ``name [unit]``; what is not known is None.
        """
        columns: dict[str, list[Any]] = {
            "record": [r.name for r in self.records],
            "status": [r.status for r in self.records],
            "success": [r.success for r in self.records],
            "rows": [r.rows for r in self.records],
        }

        for q in self.model.free_parameters:
            estimates = [r.parameters.get(q.name) for r in self.records]
            ends = [(None, None) if e is None else e.interval or (None, None) for e in estimates]
            parts = {
                q.name: [None if e is None else e.value for e in estimates],
                f"{q.name}_std": [None if e is None else e.std for e in estimates],
                f"{q.name}_low": [low for low, _ in ends],
                f"{q.name}_high": [high for _, high in ends],
            }
            columns |= {_label(header, q.unit): _finite(values) for header, values in parts.items()}
        for o in self.model.outputs:
            misfits = [r.misfit.get(o.name) for r in self.records]
            if any(misfits):
                rmse = [None if m is None else m.rmse for m in misfits]
                ratio = [None if m is None else m.noise_ratio for m in misfits]
                percent = [None if m is None else m.best_fit_percent for m in misfits]
                columns[_label(f"{o.name}_rmse", o.unit)] = _finite(rmse)
                columns[f"{o.name}_misfit_over_noise"] = _finite(ratio)
                columns[_label(f"{o.name}_best_fit", "%")] = _finite(percent)
        columns["findings"] = [" ".join(dict.fromkeys(str(f.code) for f in r.findings)) for r in self.records]
        columns["reason"] = [r.reason for r in self.records]
        columns["seconds"] = [r.seconds for r in self.records]
        return columns

    def save_table(self, path: str | Path) -> Path:
        """Write `table` as CSV, or as Parquet where the name ends so.

        Parameters
        ----------
        path
            Where to; folders are made.

        Returns
        -------
        Path
            The file that was written.

        Raises
        ------
        GreyboxError
            For a Parquet file without pyarrow.
        """
        columns = self.table()
        if Path(path).suffix.lower() == ".parquet":
            try:
                import pyarrow as pa
                import pyarrow.parquet as pq
            except ModuleNotFoundError as error:
                raise GreyboxError(
                    f"a Parquet file needs the package {error.name}; install it with: pip install 'greybox-sysid[parquet]', or write CSV"
                ) from error
            return write_file(path, lambda file: pq.write_table(pa.table(dict(columns)), file))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        rows = zip(*columns.values(), strict=True)
        writer.writerows([to_cell(v) if isinstance(v, str) else v for v in row] for row in (columns, *rows))
        return write_file(path, text.getvalue())


def _label(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _finite(values: Sequence[float | None]) -> list[float | None]:
    return [None if v is None or not math.isfinite(v) else float(v) for v in values]


def load_fleet(path: str | Path) -> dict[str, Any]:
    """What ``fleet.json`` holds, checked.

    Parameters
    ----------
    path
        The file that `FleetResult.save` or ``greybox fleet`` has written.

    Returns
    -------
    dict
        ``population``, ``without_result``, ``findings`` and more, as ``docs/result_files.md`` lists them.

    Raises
    ------
    DataError
        If it cannot be read, or is not such a file, with the first offence.

    Examples
    --------
    >>> gb.fleet.load_fleet("results/rig-fleet/fleet.json")["population"]["K"]["median"]  # doctest: +SKIP
    """
    return read_json(path, FleetResult)
