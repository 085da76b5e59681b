"""Coefficients with few digits: how many a model needs, and the model with that many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.blackbox.policy import DEFAULT_ROUNDING, RoundingPolicy
from greybox.blackbox.polynomial import PolynomialModel
from greybox.errors import DataError


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


def count_digits_needed(model: PolynomialModel, policy: RoundingPolicy = DEFAULT_ROUNDING) -> int:
    """Count the significant digits that a model's coefficients need.

    Rounding may make no stable model unstable, and change the frequency response, from one line of the record that the model was
    fitted to up to half the sampling rate, by no more than ``policy.response_change``.

    Parameters
    ----------
    model
        A linear black-box model.
    policy
        What counts as the same behaviour.

    Returns
    -------
    int
        Smallest number of digits from which on the behaviour is kept.
    """
    lowest = 1 / max(model.samples, policy.shortest_record)
    frequency = np.geomspace(lowest, 0.5, policy.frequencies) / model.sampling_time
    before = [model.response(frequency, name) for name in model.inputs]
    needed = policy.fewest_digits
    for digits in range(policy.most_digits, policy.fewest_digits - 1, -1):
        short = round_coefficients(model, digits)
        if model.stable and not short.stable:
            return digits + 1
        after = [short.response(frequency, name) for name in model.inputs]
        if any(np.any(np.abs(y - x) > policy.response_change * np.abs(x)) for x, y in zip(before, after, strict=True)):
            return digits + 1
        needed = digits
    return needed
