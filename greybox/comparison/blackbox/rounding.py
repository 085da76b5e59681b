"""Coefficients with few digits: how many a model needs, and the model with that many."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import logm

from greybox.base.errors import DataError, nearest
from greybox.base.numerics import IMAGINARY_ROUNDING, REAL_POLE
from greybox.base.values import Printable
from greybox.comparison.blackbox.polynomial import PolynomialModel


def round_coefficients(model: PolynomialModel, digits: int) -> PolynomialModel:
    """Round every coefficient of a model.

    Parameters
    ----------
    model
        A linear black-box model.
    digits
        Significant digits that are kept, from 1.

    Returns
    -------
    PolynomialModel
        The same model with rounded coefficients.

    Raises
    ------
    DataError
        If ``digits`` is below one.

    Examples
    --------
    >>> import greybox as gb
    >>> model = gb.blackbox.PolynomialModel("arx", "y", ("u",), 0.1, (1,), ([0, 0.12345],), a=[1, -0.98765])
    >>> gb.blackbox.round_coefficients(model, 2).coefficients
    {'a1': -0.99, 'b1': 0.12}
    """
    if digits < 1:
        raise DataError(f"{model.label}: {digits} digits; give a whole number from 1")

    def cut(values: np.ndarray) -> np.ndarray:
        return np.array([float(f"{v:.{digits - 1}e}") for v in values])

    return replace(
        model,
        a=cut(model.a),
        c=cut(model.c),
        d=cut(model.d),
        b=tuple(map(cut, model.b)),
        f=tuple(map(cut, model.f)),
        constant=None if model.constant is None else float(f"{model.constant:.{digits - 1}e}"),
    )


# Significant digits below which nobody rounds.
FEWEST_DIGITS = 2
# Significant digits of a double.
MOST_DIGITS = 15
# Relative change of the frequency response that rounding may cause.
RESPONSE_CHANGE = 0.01
# Frequencies at which the response is compared.
ROUNDING_FREQUENCIES = 200
# The lowest frequency is one line of a record of at least this many samples.
SHORTEST_RECORD = 1000


def count_digits_needed(model: PolynomialModel) -> int:
    """Count the significant digits that a model's coefficients need.

    Rounding may make no stable model unstable, and change the frequency response, from one line of the record that the model was
    fitted to up to half the sampling rate, by no more than a hundredth.

    Parameters
    ----------
    model
        A linear black-box model.

    Returns
    -------
    int
        Smallest number of digits from which on the behaviour is kept.
    """
    lowest = 1 / max(model.samples, SHORTEST_RECORD)
    frequency = np.geomspace(lowest, 0.5, ROUNDING_FREQUENCIES) / model.sampling_time
    before = [model.response(frequency, name) for name in model.inputs]
    needed = FEWEST_DIGITS
    # From many to few: the first number that fails ends it, so that fewer digits cannot pass by chance.
    for digits in range(MOST_DIGITS, FEWEST_DIGITS - 1, -1):
        short = round_coefficients(model, digits)
        if model.stable and not short.stable:
            return digits + 1
        after = [short.response(frequency, name) for name in model.inputs]
        if any(np.any(np.abs(y - x) > RESPONSE_CHANGE * np.abs(x)) for x, y in zip(before, after, strict=True)):
            return digits + 1
        needed = digits
    return needed


# From a difference equation back to the s-domain: the transfer function whose exact hold it is.


@dataclass(frozen=True, eq=False)
class ContinuousTransferFunction(Printable):
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


def to_continuous(model: PolynomialModel, input: str | None = None) -> ContinuousTransferFunction:
    """Convert a difference equation to the transfer function whose exact zero-order hold it is.

    The matrix logarithm of the held state space, ``[[A B] [0 1]] = exp([[Ac Bc] [0 0]] Ts)``. Whole samples of delay beyond those
    that a hold brings are kept apart (`ContinuousTransferFunction.delay`). Frequencies above half the sampling rate are not seen.

    Parameters
    ----------
    model
        A linear black-box model.
    input
        Which input; None: the only one.

    Returns
    -------
    ContinuousTransferFunction
        Coefficients of falling powers of s, in the model's units.

    Raises
    ------
    DataError
        For a pole at zero or on the negative real axis, which no sampled system without delay has.
    """
    if input not in model.inputs and (input is not None or len(model.inputs) > 1):
        raise DataError(f"{model.label}: no input {input!r}; {nearest(input or '', model.inputs)}")
    i = 0 if input is None else model.inputs.index(input)
    denominator_z = np.convolve(model.a, model.f[i])
    order = len(denominator_z) - 1
    numerator_z = model.b[i]
    extra_delay = max(int(np.flatnonzero(numerator_z)[0]) - 1, 0)
    extra_delay += len(numerator_z) - extra_delay == order + 2 and numerator_z[extra_delay] == 0  # a late feed-through
    numerator_z = numerator_z[extra_delay:]
    if order == 0 or len(numerator_z) > order + 1:
        raise DataError(
            f"{model.label}: {len(numerator_z)} coefficients in the numerator and {order + 1} in the denominator give a pole at z = 0;"
            " a continuous system has none: use nb + nk at most na + 1, or one sample more of delay in nk"
        )
    # As long as the denominator: trailing zeros are delays within the order.
    numerator_z = np.pad(numerator_z, (0, order + 1 - len(numerator_z)))
    poles = np.roots(denominator_z)
    if np.any((np.abs(poles.imag) < REAL_POLE) & (poles.real <= 0)):
        raise DataError(
            f"{model.label}: a pole at z = {poles.real.min():.4g}; a sampled continuous system has none at or below zero,"
            " take a lower order"
        )
    through = numerator_z[0]
    companion = np.zeros((order + 1, order + 1))
    # Controllable form, with the held input as a last state that stays: its logarithm has A and B of the continuous
    # system in it.
    companion[0, :order], companion[0, order] = -denominator_z[1:], 1.0
    companion[np.arange(1, order), np.arange(order - 1)] = 1.0
    companion[order, order] = 1.0
    rates = logm(companion) / model.sampling_time
    if np.abs(rates.imag).max() > IMAGINARY_ROUNDING * np.abs(rates).max():
        raise DataError(f"{model.label}: its poles have no real logarithm; take a lower order")
    a, b = rates.real[:order, :order], rates.real[:order, order]
    # b/a = b0 + (b - b0 a) / a: what is left after the feed-through is strictly proper.
    c = numerator_z[1:] - through * denominator_z[1:]
    denominator = np.poly(a)
    # c (s I - a)^-1 b + d = (det(s I - a + b c) - det(s I - a)) / det(s I - a) + d
    numerator = np.poly(a - np.outer(b, c)) - denominator + through * denominator
    return ContinuousTransferFunction(numerator, denominator, extra_delay * model.sampling_time)
