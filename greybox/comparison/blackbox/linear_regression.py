"""Linear least squares for difference equations: rows, named columns, and the dependent ones among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from greybox.base.errors import DataError, nearest
from greybox.base.numerics import COLLINEAR_COLUMNS, DEPENDENT_COLUMN_SHARE, SAME_SAMPLING_TIME
from greybox.data.experiment import Experiment, as_records

# Records for a difference equation: one output and the inputs at equal steps.


@dataclass(frozen=True, eq=False)
class SampledRecord:
    """One record: ``y`` (N,), NaN where nothing was measured, ``u`` (N, nu), every ``sampling_time`` seconds.

    ``basis``: for each input the functions (N, m) that it is a sum of, where that is so.
    """

    name: str
    y: np.ndarray
    u: np.ndarray
    sampling_time: float
    basis: tuple[np.ndarray, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(self.y)

    def segments(self, least: int) -> list[SampledRecord]:
        """Parts without gaps in ``y`` of at least ``least`` rows."""
        measured = np.flatnonzero(np.isfinite(self.y))
        runs = np.split(measured, np.flatnonzero(np.diff(measured) > 1) + 1) if len(measured) else []
        return [
            replace(self, y=self.y[r], u=self.u[r], basis=tuple(b[r] for b in self.basis))
            for r in runs
            if len(r) >= least
        ]


@dataclass(frozen=True, eq=False)
class SampledData:
    """One output and its inputs over several ``experiments`` of the same sampling time, each a `SampledRecord`."""

    output: str
    inputs: tuple[str, ...]
    sampling_time: float
    records: tuple[SampledRecord, ...]
    experiments: tuple[Experiment, ...]

    @property
    def measured(self) -> int:
        """Number of measured values of the output over all records."""
        return int(sum(np.isfinite(s.y).sum() for s in self.records))


def to_sampled_record(
    experiment: Experiment, output: str, inputs: Sequence[str], *, need_output: bool = True
) -> SampledRecord:
    """``experiment`` as a `SampledRecord`; without measured output all of ``y`` is NaN. Raises DataError."""
    if experiment.sampling_time is None:
        steps = experiment.intervals
        raise DataError(
            f"experiment {experiment.name!r}: time is irregular (steps from {steps.min():.6g} to {steps.max():.6g} s), and a"
            " difference equation needs equal steps; resample it with"
            f" greybox.blackbox.resample(experiment, {float(np.median(steps)):.6g})"
        )
    absent = [name for name in inputs if name not in experiment.inputs]
    if absent:
        raise DataError(
            f"experiment {experiment.name!r}: no input {absent[0]!r}; {nearest(absent[0], experiment.inputs)}"
        )
    y = experiment.outputs.get(output)
    if need_output and (y is None or not np.isfinite(y).any()):
        raise DataError(
            f"experiment {experiment.name!r}: output {output!r} was not measured;"
            f" {nearest(output, experiment.outputs)}, or run it from rest with initial='zero'"
        )
    u = np.column_stack([np.empty((experiment.rows, 0)), *(experiment.inputs[n] for n in inputs)])
    return SampledRecord(
        experiment.name, np.full(experiment.rows, np.nan) if y is None else y, u, experiment.sampling_time
    )


def to_sampled_data(
    experiments: Experiment | Sequence[Experiment], output: str | None = None, inputs: Sequence[str] | str | None = None
) -> SampledData:
    """The ``output`` (None: the only one) and ``inputs`` (None: all) of the records that measured that output.

    Raises DataError for unknown names, irregular time, and records of different sampling times.
    """
    group = as_records(experiments)
    if not group:
        raise DataError("no experiment; give at least one record")
    known = list(dict.fromkeys(name for e in group for name in e.outputs))
    if output is None and len(known) != 1:
        raise DataError(
            f"which output? A black-box model has one: give output=...; known: {', '.join(known) or 'none'}"
        )
    wanted = known[0] if output is None else output
    if wanted not in known:
        raise DataError(f"no experiment has an output {wanted!r}; {nearest(wanted, known)}")
    names = (inputs,) if isinstance(inputs, str) else tuple(group[0].inputs if inputs is None else inputs)
    if not names:
        raise DataError(f"output {wanted!r}: no input; name at least one")
    measured = [e for e in group if wanted in e.outputs and np.isfinite(e.outputs[wanted]).any()]
    if not measured:
        raise DataError(f"output {wanted!r} holds no value in any experiment")
    records = [to_sampled_record(e, wanted, names) for e in measured]
    steps = [record.sampling_time for record in records]
    if not np.allclose(steps, steps[0], rtol=SAME_SAMPLING_TIME, atol=0):
        listing = ", ".join(f"{r.name!r} every {r.sampling_time:.6g} s" for r in records)
        raise DataError(
            f"experiments of different sampling times: {listing}; a difference equation is valid for one sampling time; resample them"
        )
    return SampledData(wanted, names, steps[0], tuple(records), tuple(measured))


def delay_rows(values: np.ndarray, by: int) -> np.ndarray:
    """``values`` (N, ...) ``by`` rows later, zero before they begin."""
    return np.concatenate([np.zeros_like(values[:by]), values[: max(len(values) - by, 0)]]) if by else values


RegressionHistory = Literal["measured", "zero"]


@dataclass(frozen=True)
class Orders:
    """Orders of a difference equation: ``na``, and ``nb``, ``nk`` for each input."""

    na: int
    nb: tuple[int, ...]
    nk: tuple[int, ...]

    @property
    def reach(self) -> int:
        """Rows of history that an equation needs."""
        return max(self.na, *(b + k - 1 for b, k in zip(self.nb, self.nk, strict=True)), 0)


def to_orders(
    data: SampledData, nb: int | Sequence[int], nk: int | Sequence[int], na: int = 0, kind: str = "arx"
) -> Orders:
    """Orders with ``nb`` and ``nk`` spread over the inputs; raises DataError for what no equation can have."""
    spread = []
    for letter, value in (("nb", nb), ("nk", nk)):
        each = (value,) * len(data.inputs) if isinstance(value, (int, np.integer)) else tuple(value)
        if len(each) != len(data.inputs):
            raise DataError(
                f"{kind}: {letter} has {len(each)} numbers for {len(data.inputs)} inputs"
                f" ({', '.join(data.inputs)}); give one number, or one for each input"
            )
        least = 1 if letter == "nb" else 0
        if any(int(v) != v or v < least for v in each):
            raise DataError(f"{kind}: {letter} = {value}; give whole numbers from {least}")
        spread.append(tuple(int(v) for v in each))
    if int(na) != na or na < 0:
        raise DataError(f"{kind}: na = {na}; give a whole number from 0")
    result = Orders(int(na), spread[0], spread[1])
    longest = max(data.records, key=lambda s: s.rows)
    if max(result.nk) >= longest.rows:
        raise DataError(
            f"{kind}: nk = {max(result.nk)} samples of delay, but the longest record ({longest.name!r}) has {longest.rows} rows;"
            f" the input would never arrive, give a delay well below {longest.rows}"
        )
    return result


def build_regressors(record: SampledRecord, orders: Orders, offset: bool) -> np.ndarray:
    """Columns ``-y(k-1) ... -y(k-na)``, ``u(k-nk) ...`` of each input and, with ``offset``, ones (N, p); zero before the record."""
    columns = [-delay_rows(record.y, i) for i in range(1, orders.na + 1)]
    columns += [
        delay_rows(record.u[:, i], nk + j)
        for i, (nb, nk) in enumerate(zip(orders.nb, orders.nk, strict=True))
        for j in range(nb)
    ]
    columns += [np.ones(record.rows)] if offset else []
    return np.column_stack(columns)


def name_regressors(data: SampledData, orders: Orders, offset: bool) -> list[str]:
    """What the columns of `build_regressors` are: ``y(k-1)``, ``u(k-2)``, ``1``."""

    def lag(name: str, by: int) -> str:
        return f"{name}(k-{by})" if by else f"{name}(k)"

    names = [lag(data.output, i) for i in range(1, orders.na + 1)]
    names += [
        lag(name, nk + j) for name, nb, nk in zip(data.inputs, orders.nb, orders.nk, strict=True) for j in range(nb)
    ]
    return names + (["1"] if offset else [])


def find_usable_rows(record: SampledRecord, orders: Orders, history: RegressionHistory) -> np.ndarray:
    """Rows (m,) whose equation is known: with ``measured`` history those that have one, with ``zero`` also the first ones."""
    gaps = np.isnan(record.y)
    known = ~gaps
    for i in range(1, orders.na + 1):
        # A gap of y(k - i) spoils the equation of row k.
        known &= ~delay_rows(gaps, i)
    if history == "measured":
        known[: orders.reach] = False
    return np.flatnonzero(known)


def refuse_few_rows(data: SampledData, label: str, equations: int, unknowns: int, history: str) -> None:
    """DataError where there are not more equations than unknowns."""
    if equations > unknowns:
        return
    longest = sum(s.rows for s in data.records)
    gaps = longest - data.measured
    because = f", of which {gaps} were not measured" if gaps else ""
    more = "" if history == "zero" else "history='zero' (a record that begins at rest), "
    raise DataError(
        f"{label}: {longest} rows{because}, leave {equations} equations for {unknowns} coefficients of {data.output!r};"
        f" at least {unknowns + 1} are needed: take a smaller structure, {more}or a longer record without gaps"
    )


def solve_least_squares(
    phi: np.ndarray, target: np.ndarray, names: Sequence[str], label: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """``argmin |target - phi theta|``: theta (p,), ``(phi'phi)^-1`` (p, p) and the sum of squares.

    Raises DataError that names the columns that are linearly dependent.
    """
    scale = np.linalg.norm(phi, axis=0)
    unexcited = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if unexcited:
        raise DataError(
            f"{label}: {', '.join(unexcited)} {'is' if len(unexcited) == 1 else 'are'} zero in every row; the record does not excite"
            " it: leave that input or that lag out"
        )
    # Columns of length one: whether they are collinear must not hang on the units of the signals.
    left, size, right = np.linalg.svd(phi / scale, full_matrices=False)
    if size[-1] <= COLLINEAR_COLUMNS * max(1.0, size[0]) * np.sqrt(len(phi)):
        participation = np.abs(right[-1]) / np.abs(right[-1]).max()
        dependent = [n for n, s in zip(names, participation, strict=True) if s > DEPENDENT_COLUMN_SHARE]
        raise DataError(
            f"{label}: the columns {', '.join(dependent)} are collinear, so the record does not determine their coefficients."
            " A constant input (a step after its edge) determines one coefficient, each sine two, and without noise a structure larger"
            " than the plant is such a combination too: take a smaller nb or na,"
            " history='zero' where the record begins at rest and with the step's edge, or a record with a richer input"
        )
    # theta = V S^-1 U' y, back in the units of the columns
    theta = right.T @ (left.T @ target / size) / scale
    inverse = right.T / size
    # (Phi'Phi)^-1 = V S^-2 V'
    inverse = inverse @ inverse.T / np.outer(scale, scale)
    rest = target - phi @ theta
    return theta, inverse, float(rest @ rest)
