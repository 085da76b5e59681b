"""Linear least squares for difference equations: rows, named columns, and the dependent ones among them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from greybox.blackbox.sampled_data import SampledData, SampledRecord, delay_rows
from greybox.errors import DataError
from greybox.numerics import COLLINEAR_COLUMNS, DEPENDENT_COLUMN_SHARE

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
    theta = right.T @ (left.T @ target / size) / scale
    inverse = right.T / size
    inverse = inverse @ inverse.T / np.outer(scale, scale)
    rest = target - phi @ theta
    return theta, inverse, float(rest @ rest)
