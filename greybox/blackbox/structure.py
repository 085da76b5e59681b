"""Which coefficients a difference equation has, and their positions in one vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.blackbox.linear_regression import Orders
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.sampled_data import SampledData
from greybox.errors import DataError


@dataclass(frozen=True)
class PolynomialStructure:
    """Orders of ``A y = sum B / F u + constant + C / D e``: those of ``A`` and ``B``, ``nf`` of each input, ``nc``, ``nd``."""

    kind: str
    orders: Orders
    nf: tuple[int, ...]
    nc: int = 0
    nd: int = 0
    offset: bool = False

    @property
    def sizes(self) -> tuple[int, ...]:
        """Lengths of the parts of the vector: a, each b, each f, c, d, constant."""
        return (self.orders.na, *self.orders.nb, *self.nf, self.nc, self.nd, int(self.offset))

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(self.sizes)

    def parts(self, theta: np.ndarray) -> list[np.ndarray]:
        """``theta`` (p,) cut into a, each b, each f, c, d, constant."""
        return np.split(theta, np.cumsum(self.sizes)[:-1])

    def model(self, theta: np.ndarray, data: SampledData) -> PolynomialModel:
        """The coefficients (p,) as a model of the output of ``data``."""
        n = len(self.nf)
        a, *rest = self.parts(theta)
        b, f, (c, d, constant) = rest[:n], rest[n : 2 * n], rest[2 * n :]
        return PolynomialModel(
            kind=self.kind,
            output=data.output,
            inputs=data.inputs,
            sampling_time=data.sampling_time,
            nk=self.orders.nk,
            a=to_monic(a),
            b=tuple(np.append(np.zeros(k), part) for k, part in zip(self.orders.nk, b, strict=True)),
            f=tuple(map(to_monic, f)),
            c=to_monic(c),
            d=to_monic(d),
            constant=float(constant[0]) if self.offset else None,
        )

    def vector(self, model: PolynomialModel) -> np.ndarray:
        """The coefficients (p,) of ``model``; polynomials that are shorter there are filled up with zeros."""
        padded = [_padded(model.a[1:], self.orders.na)]
        padded += [_padded(b[k:], n) for b, k, n in zip(model.b, self.orders.nk, self.orders.nb, strict=True)]
        padded += [_padded(f[1:], n) for f, n in zip(model.f, self.nf, strict=True)]
        padded += [_padded(model.c[1:], self.nc), _padded(model.d[1:], self.nd)]
        return np.concatenate([*padded, [model.constant or 0.0] if self.offset else []])


def to_monic(rest: Sequence[float] | np.ndarray) -> np.ndarray:
    """``1 + p1 q^-1 + ...`` from ``p1 ...``."""
    return np.append(1.0, rest)


def to_order(letter: str, value: int, kind: str) -> int:
    """``value`` as an order; DataError where it is not a whole number from 0."""
    if int(value) != value or value < 0:
        raise DataError(f"{kind}: {letter} = {value}; give a whole number from 0")
    return int(value)


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.append(values[:size], np.zeros(max(size - len(values), 0)))
