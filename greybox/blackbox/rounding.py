"""How many digits of the coefficients a model needs, and polynomials made stable."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from greybox.errors import DataError

if TYPE_CHECKING:
    from greybox.blackbox.polynomial import PolynomialModel

FEWEST_DIGITS, MOST_DIGITS = 2, 15
BEHAVES = 0.01  # relative change of the frequency response that rounding may make
LINES = 200  # frequencies at which that is looked at
# A mirrored root is kept this far inside the unit circle, so that its filter forgets.
MARGIN = 1e-6
# An integrator's pole, held inside the circle, must not leak over a long record.
LEAK = 1e-9


def reflect_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots outside the unit circle mirrored into it.

    The magnitude of its frequency response keeps its shape; a root on the circle goes just inside.
    """
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size < 1 - MARGIN):
        return polynomial
    size = np.where(size > 1, 1 / np.maximum(size, 1), size)
    inside = np.minimum(size, 1 - MARGIN) * np.exp(1j * np.angle(roots))
    mirrored = np.real(np.poly(inside))
    return np.append(mirrored, np.zeros(len(polynomial) - len(mirrored)))


def confine_roots(polynomial: np.ndarray) -> np.ndarray:
    """A polynomial in ``q^-1`` that begins with 1, its roots on or outside the unit circle drawn straight to just inside it."""
    roots = np.roots(polynomial)
    size = np.abs(roots)
    if np.all(size <= 1 - LEAK):
        return polynomial
    drawn = np.real(np.poly(roots * np.minimum(1.0, (1 - LEAK) / np.maximum(size, 1e-300))))
    return np.append(drawn, np.zeros(len(polynomial) - len(drawn)))


def round_coefficients(model: PolynomialModel, digits: int) -> PolynomialModel:
    """``model`` with every coefficient rounded to ``digits`` significant digits. Raises DataError below one digit."""
    if digits < 1:
        raise DataError(f"{model.label}: {digits} digits; give a whole number from 1")

    def cut(values: np.ndarray) -> np.ndarray:
        return np.array([float(f"{v:.{digits - 1}e}") for v in values])

    return replace(
        model, a=cut(model.a), c=cut(model.c), d=cut(model.d), b=tuple(map(cut, model.b)), f=tuple(map(cut, model.f)),
        constant=None if model.constant is None else float(f"{model.constant:.{digits - 1}e}"),
    )  # fmt: skip


def count_digits_needed(model: PolynomialModel) -> int:
    """Smallest number of significant digits that keeps the model's behaviour, from there up to `MOST_DIGITS`.

    Rounding may make no stable model unstable, and change the frequency response from one line of the record it was fitted to
    up to half the sampling rate by no more than 1 %.
    """
    lowest = 1 / max(model.samples, 1000)
    frequency = np.geomspace(lowest, 0.5, LINES) / model.sampling_time
    before = [model.response(frequency, name) for name in model.inputs]
    needed = FEWEST_DIGITS
    for digits in range(MOST_DIGITS, FEWEST_DIGITS - 1, -1):
        short = round_coefficients(model, digits)
        if model.stable and not short.stable:
            return digits + 1
        after = [short.response(frequency, name) for name in model.inputs]
        if any(np.any(np.abs(y - x) > BEHAVES * np.abs(x)) for x, y in zip(before, after, strict=True)):
            return digits + 1
        needed = digits
    return needed


def find_instability(model: PolynomialModel) -> tuple[str, ...]:
    """What one must know of an unstable model before running it freely."""
    if model.stable:
        return ()
    outermost = float(np.abs(model.poles[0]))
    growth = np.inf if outermost == 1 else 1 / np.log(outermost)
    noisy = len(model.a) > 1
    remedy = "more noise on the output than the structure allows for: take an output-error or armax model, or focus='simulation'"
    other = "a pole that belongs on the unit circle, or a structure that is too large: take a smaller one"
    return (
        f"unstable: outermost pole at |z| = {outermost:.6g}, a free run grows by e every {growth:.3g} samples; likely causes:"
        f" {remedy if noisy else other}; an integrating plant has its pole at 1 and may fall on either side",
    )
