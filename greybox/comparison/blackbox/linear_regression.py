"""Linear least squares for difference equations: rows, named columns, and the dependent ones among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from greybox.base.errors import DataError, nearest
from greybox.base.linear_algebra import RowTriangle
from greybox.base.numerics import COLLINEAR_COLUMNS, DEPENDENT_COLUMN_SHARE, SAME_SAMPLING_TIME
from greybox.data.experiment import Experiment, as_records

# Records for a difference equation: one output and the inputs at equal steps.


@dataclass(frozen=True, eq=False)
class FunctionSignal:
    """A ``function`` of a signal ``values`` (N,), one value or several (N, m) for each row, computed of the rows that are asked for."""

    values: np.ndarray
    function: Callable[[np.ndarray], np.ndarray]

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.function(self.values[rows])

    def __len__(self) -> int:
        return len(self.values)


RowSignal = np.ndarray | FunctionSignal
"""An input row by row: as it was recorded, or as a function of that."""


def cut_signal(signal: RowSignal, rows: slice) -> RowSignal:
    """These ``rows`` as a signal of its own."""
    if isinstance(signal, FunctionSignal):
        return FunctionSignal(signal.values[rows], signal.function)
    return signal[rows]


@dataclass(frozen=True, eq=False)
class SampledRecord:
    """One record: ``y`` (N,), NaN where nothing was measured, and its ``signals``, one an input (N,), every ``sampling_time`` seconds.

    ``basis``: for each input the functions (N, m) that it is a sum of, where that is so.
    """

    name: str
    y: np.ndarray
    signals: tuple[RowSignal, ...]
    sampling_time: float
    basis: tuple[FunctionSignal, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows N."""
        return len(self.y)

    @property
    def u(self) -> np.ndarray:
        """The inputs side by side (N, nu)."""
        return np.column_stack([np.empty((self.rows, 0)), *(signal[:] for signal in self.signals)])

    def segments(self, least: int) -> list[SampledRecord]:
        """Parts without gaps in ``y`` of at least ``least`` rows."""
        return [
            replace(
                self,
                y=self.y[rows],
                signals=tuple(cut_signal(signal, rows) for signal in self.signals),
                basis=tuple(FunctionSignal(each.values[rows], each.function) for each in self.basis),
            )
            for rows in find_runs(np.isfinite(self.y))
            if rows.stop - rows.start >= least
        ]


def find_runs(wanted: np.ndarray) -> list[slice]:
    """The stretches of rows over which ``wanted`` (N,) holds."""
    # Where it begins and ends to hold: a list of row numbers would be as large as a signal.
    edges = np.flatnonzero(np.diff(wanted, prepend=False, append=False))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


# Rows that are worked on at once: what is computed of them (a column for each coefficient) stays small beside a long record, and what
# is done for each block by itself does not count.
BLOCK_ROWS = 1 << 14


def each_block(rows: int, first: int = 0) -> Iterator[slice]:
    """All ``rows`` in blocks; the first one holds at least as many as ``first``."""
    end = 0
    while end < rows:
        begin, end = end, min(rows, end + max(BLOCK_ROWS, 0 if end else first))
        yield slice(begin, end)


@dataclass(eq=False)
class BlockFilter:
    """The filter ``b / a`` over signals (n,) or (n, m) that come block by block: what one leaves in it meets the next."""

    b: np.ndarray
    a: np.ndarray
    memory: np.ndarray | None = field(default=None, init=False)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The filtered block."""
        if self.memory is None:
            self.memory = np.zeros((max(len(self.a), len(self.b)) - 1, *values.shape[1:]))
        filtered, self.memory = lfilter(self.b, self.a, values, axis=0, zi=self.memory)
        return filtered


@dataclass(eq=False)
class BlockDelay:
    """A signal (n,) that comes block by block, up to ``longest`` rows later; zero before it begins."""

    longest: int
    held: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.held = np.zeros(self.longest)

    def take(self, values: np.ndarray) -> None:
        """The next block."""
        self.held = np.concatenate([self.held[len(self.held) - self.longest :], values])

    def delayed(self, by: int) -> np.ndarray:
        """That block ``by`` rows later."""
        return self.held[self.longest - by : len(self.held) - by]


Origin = Literal["zero", "mean", "rest"]
"""What signals are measured from: zero; their mean over the records; or, of records that begin at rest, what was before them."""


@dataclass(frozen=True)
class Scaling:
    """Each signal as ``origin + size * number``, the output first: fits see the numbers, and units and operating points do not count."""

    origins: tuple[float, ...]
    sizes: tuple[float, ...]

    @classmethod
    def of(cls, signals: Sequence[Sequence[np.ndarray]], origins: Sequence[float]) -> Scaling:
        """That of ``signals``, each an array (N,) a record, NaN in gaps; the size is the root mean square about the origin."""
        sizes = []
        for records, origin in zip(signals, origins, strict=True):
            deviations = [values[np.isfinite(values)] - origin for values in records]
            count = sum(map(len, deviations))
            # The largest is taken out first: squares of 1e-200 would be zero.
            largest = max((float(np.abs(d).max(initial=0.0)) for d in deviations), default=0.0) or 1.0
            sizes.append(largest * np.sqrt(sum(float(np.sum((d / largest) ** 2)) for d in deviations) / max(count, 1)))
        return cls(tuple(map(float, origins)), tuple(float(size) or 1.0 for size in sizes))

    def apply(self, position: int, values: np.ndarray) -> np.ndarray:
        """The numbers (N, ...) of the signal at this ``position``."""
        return (values - self.origins[position]) / self.sizes[position]


@dataclass(frozen=True, eq=False)
class SampledData:
    """One output and its inputs over several ``experiments`` of the same sampling time, each a `SampledRecord` under a ``scaling``."""

    output: str
    inputs: tuple[str, ...]
    sampling_time: float
    records: tuple[SampledRecord, ...]
    experiments: tuple[Experiment, ...]
    scaling: Scaling

    @property
    def measured(self) -> int:
        """Number of measured values of the output over all records."""
        return int(sum(np.isfinite(s.y).sum() for s in self.records))

    def scaled(self, origin: Origin) -> SampledData:
        """The same data, of signals as they were recorded, measured from an ``origin`` in units of their own movement."""
        signals = [
            [r.y for r in self.records],
            *([r.signals[i][:] for r in self.records] for i in range(len(self.inputs))),
        ]
        if origin == "zero":
            origins = [0.0] * len(signals)
        elif origin == "mean":
            origins = [find_mean(records) for records in signals]
        else:
            # At rest the output stayed at its first reading, and each input at what it was before: zero where the record does not say.
            first = [float(r.y[np.argmax(np.isfinite(r.y))]) for r in self.records]
            before = self.experiments[0].before
            origins = [float(np.mean(first)), *(float(before[n][-1]) if n in before else 0.0 for n in self.inputs)]
        scaling = Scaling.of(signals, origins)
        records = tuple(
            replace(
                r,
                y=scaling.apply(0, r.y),
                signals=tuple(scaling.apply(i, signal[:]) for i, signal in enumerate(r.signals, 1)),
            )
            for r in self.records
        )
        return replace(self, records=records, scaling=scaling)


def find_mean(records: Sequence[np.ndarray]) -> float:
    """Mean of a signal over its records, NaN in gaps; of one that never moves its value to the bit."""
    low, high = min(float(np.nanmin(v)) for v in records), max(float(np.nanmax(v)) for v in records)
    if low == high:
        return low
    return sum(float(np.nansum(v)) for v in records) / sum(int(np.isfinite(v).sum()) for v in records)


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
    signals = tuple(experiment.inputs[n] for n in inputs)
    return SampledRecord(
        experiment.name, np.full(experiment.rows, np.nan) if y is None else y, signals, experiment.sampling_time
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
    as_recorded = Scaling((0.0,) * (1 + len(names)), (1.0,) * (1 + len(names)))
    return SampledData(wanted, names, steps[0], tuple(records), tuple(measured), as_recorded)


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


def build_regressors(record: SampledRecord, orders: Orders, offset: bool, rows: slice) -> np.ndarray:
    """Columns ``-y(k-1) ... -y(k-na)``, ``u(k-nk) ...`` of each input and, with ``offset``, ones, of these ``rows`` (n, p).

    All is zero before the record.
    """
    columns = [-value for value in delayed_columns(record.y, rows, range(1, orders.na + 1))]
    for signal, nb, nk in zip(record.signals, orders.nb, orders.nk, strict=True):
        columns += delayed_columns(signal, rows, range(nk, nk + nb))
    columns += [np.ones(rows.stop - rows.start)] if offset else []
    return np.column_stack(columns)


def delayed_columns(signal: RowSignal, rows: slice, delays: Sequence[int]) -> list[np.ndarray]:
    """These ``rows`` of a signal as it was each of ``delays`` before, zero before it begins."""
    longest = max(delays, default=0)
    before = min(longest, rows.start)
    values = np.concatenate([np.zeros(longest - before), signal[rows.start - before : rows.stop]])
    return [values[longest - by : len(values) - by] for by in delays]


def name_regressors(data: SampledData, orders: Orders, offset: bool) -> list[str]:
    """What the columns of `build_regressors` are: ``y(k-1)``, ``u(k-2)``, ``1``."""

    def lag(name: str, by: int) -> str:
        return f"{name}(k-{by})" if by else f"{name}(k)"

    names = [lag(data.output, i) for i in range(1, orders.na + 1)]
    names += [
        lag(name, nk + j) for name, nb, nk in zip(data.inputs, orders.nb, orders.nk, strict=True) for j in range(nb)
    ]
    return names + (["1"] if offset else [])


def each_equation_block(
    record: SampledRecord, orders: Orders, offset: bool, history: RegressionHistory, prefilter: np.ndarray | None = None
) -> Iterator[np.ndarray]:
    """The equations of a record that are known, block by block: the regressors and, in the last column, the output (n, p + 1).

    With ``measured`` history those that have one, with ``zero`` also the first ones. The filter ``1 / prefilter`` has a memory: it begins
    anew behind each gap.
    """
    smoothing: BlockFilter | None = None
    end = -1
    for rows in each_block(record.rows):
        # A gap of y(k - i) spoils the equation of row k.
        window = slice(max(rows.start - orders.na, 0), rows.stop)
        gaps, before = np.isnan(record.y[window]), rows.start - window.start
        known = ~gaps[before:]
        for i in range(1, orders.na + 1):
            known &= ~delay_rows(gaps, i)[before:]
        if history == "measured":
            known[: max(orders.reach - rows.start, 0)] = False
        runs = find_runs(known)
        if not runs:
            continue
        equations = np.column_stack([build_regressors(record, orders, offset, rows), record.y[rows]])
        if prefilter is None:
            yield equations if known.all() else equations[known]
            continue
        for run in runs:
            if smoothing is None or rows.start + run.start != end:
                smoothing = BlockFilter(np.ones(1), prefilter)
            yield smoothing(equations[run])
            end = rows.start + run.stop


def collect_equations(
    data: SampledData, orders: Orders, offset: bool, history: RegressionHistory, prefilter: np.ndarray | None = None
) -> RowTriangle:
    """All known equations of the records, each record filtered by ``1 / prefilter`` from its first equation or the one behind a gap on."""
    equations = RowTriangle()
    for record in data.records:
        for block in each_equation_block(record, orders, offset, history, prefilter):
            equations.add(block)
    return equations


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
    equations: RowTriangle, names: Sequence[str], label: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """``argmin |y - phi theta|`` of the equations ``phi, y``: theta (p,), ``(phi'phi)^-1`` (p, p) and the sum of squares.

    Raises DataError that names the columns that are linearly dependent.
    """
    assert equations.values is not None
    # Reflections keep lengths and products: |y - phi theta| is |rho - R theta| and what no column reaches.
    phi, target = equations.values[:, :-1], equations.values[:, -1]
    scale = np.linalg.norm(phi, axis=0)
    unexcited = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if unexcited:
        raise DataError(
            f"{label}: {', '.join(unexcited)} {'is' if len(unexcited) == 1 else 'are'} zero in every row; the record does not excite"
            " it: leave that input or that lag out"
        )
    # Columns of length one: whether they are collinear must not hang on the units of the signals.
    left, size, right = np.linalg.svd(phi / scale, full_matrices=False)
    if size[-1] <= COLLINEAR_COLUMNS * max(1.0, size[0]) * np.sqrt(equations.rows):
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
