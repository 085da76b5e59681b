"""From a difference equation back to the s-domain: the transfer function whose exact hold it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import logm

from greybox.blackbox.polynomial import PolynomialModel
from greybox.errors import DataError, nearest

REAL = 1e-6  # largest imaginary part of a logarithm, relative, that is rounding


@dataclass(frozen=True, eq=False)
class ContinuousTransferFunction:
    """``G(s) = e^(-delay s) numerator / denominator``: coefficients of falling powers of s, the denominator's first is 1."""

    numerator: np.ndarray
    denominator: np.ndarray
    delay: float = 0.0

    @property
    def poles(self) -> np.ndarray:
        """Roots of the denominator in 1/s."""
        return np.roots(self.denominator)

    @property
    def zeros(self) -> np.ndarray:
        """Roots of the numerator in 1/s."""
        return np.roots(self.numerator)

    @property
    def gain(self) -> float:
        """Steady-state gain; infinite for an integrator."""
        return float(self.numerator[-1] / self.denominator[-1]) if self.denominator[-1] else np.inf

    @property
    def feedthrough(self) -> float:
        """Gain at infinite frequency."""
        return float(self.numerator[0]) if len(self.numerator) == len(self.denominator) else 0.0

    def __str__(self) -> str:
        fraction = f"({_written(self.numerator)}) / ({_written(self.denominator)})"
        return f"{fraction} e^(-{self.delay:.4g} s)" if self.delay else fraction


def to_continuous(model: PolynomialModel, input: str | None = None) -> ContinuousTransferFunction:
    """The transfer function from ``input`` (the only one if not named) whose exact zero-order hold ``model`` is.

    The matrix logarithm of the held state space, ``[[A B] [0 1]] = exp([[Ac Bc] [0 0]] Ts)``. Whole samples of delay beyond those
    that a hold brings are kept apart (`ContinuousTransferFunction.delay`). Frequencies up to half the sampling rate are told, no others.

    Raises DataError for a pole at zero or on the negative real axis, which no sampled system without delay has.
    """
    if input not in model.inputs and (input is not None or len(model.inputs) > 1):
        raise DataError(f"{model.label}: no input {input!r}; {nearest(input or '', model.inputs)}")
    i = 0 if input is None else model.inputs.index(input)
    below = np.convolve(model.a, model.f[i])
    order = len(below) - 1
    above = model.b[i]
    late = max(int(np.flatnonzero(above)[0]) - 1, 0)
    late += len(above) - late == order + 2 and above[late] == 0  # a late feed-through
    above = above[late:]
    if order == 0 or len(above) > order + 1:
        raise DataError(
            f"{model.label}: {len(above)} numbers above and {order + 1} below the fraction line, that is a pole at z = 0;"
            " no continuous system has it: take nb + nk at most na + 1, or one sample more of delay in nk"
        )
    above = np.pad(above, (0, order + 1 - len(above)))
    poles = np.roots(below)
    if np.any((np.abs(poles.imag) < 1e-12) & (poles.real <= 0)):
        raise DataError(
            f"{model.label}: a pole at z = {poles.real.min():.4g}; a sampled continuous system has none at or below zero,"
            " take a lower order"
        )
    through = above[0]
    companion = np.zeros((order + 1, order + 1))
    companion[0, :order], companion[0, order] = -below[1:], 1.0
    companion[np.arange(1, order), np.arange(order - 1)] = 1.0
    companion[order, order] = 1.0
    rates = logm(companion) / model.sampling_time
    if np.abs(rates.imag).max() > REAL * np.abs(rates).max():
        raise DataError(f"{model.label}: its poles have no real logarithm; take a lower order")
    a, b = rates.real[:order, :order], rates.real[:order, order]
    c = above[1:] - through * below[1:]
    denominator = np.poly(a)
    # c (s I - a)^-1 b + d = (det(s I - a + b c) - det(s I - a)) / det(s I - a) + d
    numerator = np.poly(a - np.outer(b, c)) - denominator + through * denominator
    return ContinuousTransferFunction(numerator, denominator, late * model.sampling_time)


def _written(polynomial: np.ndarray) -> str:
    powers = range(len(polynomial) - 1, -1, -1)
    terms = [
        f"{value:.8g}{' s' if p else ''}{f'^{p}' if p > 1 else ''}"
        for value, p in zip(polynomial, powers, strict=True)
        if value != 0
    ]
    return " + ".join(terms).replace("+ -", "- ") or "0"
