"""Linear least squares for difference equations: rows, columns with names, and what they cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from greybox.blackbox.sampled_data import SampledData, SampledRecord, delay_rows
from greybox.errors import DataError

RegressionHistory = Literal["measured", "zero"]

# Columns of unit length whose smallest singular value lies below this are one another's combinations, rounding aside.
COLLINEAR = 1e-13
SHARE = 0.05  # of the largest coefficient of a dependence, from which a column belongs to it


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
    channels: SampledData, nb: int | Sequence[int], nk: int | Sequence[int], na: int = 0, kind: str = "arx"
) -> Orders:
    """Orders with ``nb`` and ``nk`` spread over the inputs; raises DataError for what no equation can have."""
    spread = []
    for letter, value in (("nb", nb), ("nk", nk)):
        each = (value,) * len(channels.inputs) if isinstance(value, (int, np.integer)) else tuple(value)
        if len(each) != len(channels.inputs):
            raise DataError(
                f"{kind}: {letter} has {len(each)} numbers for {len(channels.inputs)} inputs"
                f" ({', '.join(channels.inputs)}); give one number, or one for each input"
            )
        least = 1 if letter == "nb" else 0
        if any(int(v) != v or v < least for v in each):
            raise DataError(f"{kind}: {letter} = {value}; give whole numbers from {least}")
        spread.append(tuple(int(v) for v in each))
    if int(na) != na or na < 0:
        raise DataError(f"{kind}: na = {na}; give a whole number from 0")
    found = Orders(int(na), spread[0], spread[1])
    longest = max(channels.series, key=lambda s: s.rows)
    if max(found.nk) >= longest.rows:
        raise DataError(
            f"{kind}: nk = {max(found.nk)} samples of delay, but the longest record ({longest.name!r}) has {longest.rows} rows;"
            f" the input would never arrive, give a delay well below {longest.rows}"
        )
    return found


def build_regressors(series: SampledRecord, o: Orders, offset: bool) -> np.ndarray:
    """Columns ``-y(k-1) ... -y(k-na)``, ``u(k-nk) ...`` of each input and, with ``offset``, ones (N, p); zero before the record."""
    columns = [-delay_rows(series.y, i) for i in range(1, o.na + 1)]
    columns += [
        delay_rows(series.u[:, i], nk + j) for i, (nb, nk) in enumerate(zip(o.nb, o.nk, strict=True)) for j in range(nb)
    ]
    columns += [np.ones(series.rows)] if offset else []
    return np.column_stack(columns)


def name_regressors(channels: SampledData, o: Orders, offset: bool) -> list[str]:
    """What the columns of `build_regressors` are: ``y(k-1)``, ``u(k-2)``, ``1``."""

    def lag(name: str, by: int) -> str:
        return f"{name}(k-{by})" if by else f"{name}(k)"

    names = [lag(channels.output, i) for i in range(1, o.na + 1)]
    names += [lag(name, nk + j) for name, nb, nk in zip(channels.inputs, o.nb, o.nk, strict=True) for j in range(nb)]
    return names + (["1"] if offset else [])


def find_usable_rows(series: SampledRecord, o: Orders, history: RegressionHistory) -> np.ndarray:
    """Rows (m,) whose equation is known: with ``measured`` history those that have one, with ``zero`` also the first ones."""
    gaps = np.isnan(series.y)
    known = ~gaps
    for i in range(1, o.na + 1):
        known &= ~delay_rows(gaps, i)
    if history == "measured":
        known[: o.reach] = False
    return np.flatnonzero(known)


def refuse_few_rows(channels: SampledData, label: str, equations: int, unknowns: int, history: str) -> None:
    """DataError where there are not more equations than unknowns."""
    if equations > unknowns:
        return
    longest = sum(s.rows for s in channels.series)
    gaps = longest - channels.measured
    because = f", of which {gaps} were not measured" if gaps else ""
    more = "" if history == "zero" else "history='zero' (a record that begins at rest), "
    raise DataError(
        f"{label}: {longest} rows{because}, leave {equations} equations for {unknowns} coefficients of {channels.output!r};"
        f" at least {unknowns + 1} are needed: take a smaller structure, {more}or a longer record without gaps"
    )


def solve_least_squares(
    phi: np.ndarray, target: np.ndarray, names: Sequence[str], label: str
) -> tuple[np.ndarray, np.ndarray, float]:
    """``argmin |target - phi theta|``: theta (p,), ``(phi'phi)^-1`` (p, p) and the sum of squares.

    Raises DataError that names the columns where they are combinations of one another.
    """
    scale = np.linalg.norm(phi, axis=0)
    still = [n for n, s in zip(names, scale, strict=True) if s == 0]
    if still:
        raise DataError(
            f"{label}: {', '.join(still)} {'is' if len(still) == 1 else 'are'} zero in every row; the record does not excite"
            " it: leave that input or that lag out"
        )
    left, size, right = np.linalg.svd(phi / scale, full_matrices=False)
    if size[-1] <= COLLINEAR * max(1.0, size[0]) * np.sqrt(len(phi)):
        shares = np.abs(right[-1]) / np.abs(right[-1]).max()
        together = [n for n, s in zip(names, shares, strict=True) if s > SHARE]
        raise DataError(
            f"{label}: the columns {', '.join(together)} are collinear, so the record cannot tell their coefficients apart."
            " A constant input (a step after its edge) carries one coefficient, each sine two, and without noise a structure larger"
            " than the plant is such a combination too: take a smaller nb or na,"
            " history='zero' where the record begins at rest and with the step's edge, or a record with a livelier input"
        )
    theta = right.T @ (left.T @ target / size) / scale
    inverse = right.T / size
    inverse = inverse @ inverse.T / np.outer(scale, scale)
    rest = target - phi @ theta
    return theta, inverse, float(rest @ rest)
