"""Free runs and predictions of a difference equation, and what its unknown past adds to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from scipy.signal import lfilter

from greybox.base.errors import DataError, nearest
from greybox.base.numerics import FREE_RESPONSE_GROWTH, NEGLIGIBLE_SINGULAR_VALUE
from greybox.comparison.blackbox.linear_regression import SampledRecord, delay_rows

if TYPE_CHECKING:
    from greybox.comparison.blackbox.polynomial import PolynomialModel

InitialChoice = Literal["zero", "measured", "estimated"]


def simulate_free_run(
    model: PolynomialModel, record: SampledRecord, initial: InitialChoice, rows: int | None
) -> np.ndarray:
    """Output (N,) of ``A y = sum B / F u + constant`` from the ``initial`` state."""
    _check_initial(initial)
    constant = np.full(record.rows, model.constant or 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        # A y = sum B / F u + constant, hence y = sum B / (A F) u + constant / A
        y = lfilter([1.0], model.a, constant)
        for b, f, u in zip(model.b, model.f, record.u.T, strict=True):
            y = y + lfilter(b, np.convolve(model.a, f), u)
        if initial == "zero":
            return y
        free = np.hstack(compute_initial_responses(model, record.rows, [len(model.a)], model.a))
        return y + free @ estimate_initial_state(free, record.y - y, initial, rows)


def predict_ahead(
    model: PolynomialModel, record: SampledRecord, steps: int, initial: InitialChoice, rows: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """``yhat(k | k - steps)`` (N,), the measurement less the last ``steps`` innovations' share in it, and the innovations (N,).

    ``e = D / C (A y - sum B / F u - constant)``. Where nothing was measured the innovation is zero and the prediction takes the
    measurement's place. With ``initial="measured"`` the rows without a history are NaN.
    """
    _check_initial(initial)
    alpha = np.convolve(model.a, model.d)
    driven = lfilter(model.d, [1.0], np.full(record.rows, model.constant or 0.0))
    for b, f, u in zip(model.b, model.f, record.u.T, strict=True):
        driven = driven + lfilter(np.convolve(b, model.d), f, u)
    past = np.empty((record.rows, 0))
    if initial != "zero":
        past = np.hstack(compute_initial_responses(model, record.rows, [len(alpha), len(model.c)]))
    with np.errstate(over="ignore", invalid="ignore"):
        e, filled = _innovations(alpha, model.c, record.y, np.column_stack([driven, past]))
        state = estimate_initial_state(-e[:, 1:], e[:, 0], initial, rows)
        innovation, complete = (part[:, 0] + part[:, 1:] @ state for part in (e, filled))
        # y(k) less the part of e(k), ..., e(k - steps + 1): the first ``steps`` coefficients of C / (A D) (Ljung
        # 1999, section 3.2).
        share = lfilter(model.c, alpha, np.eye(1, steps)[0])
        ahead = complete - np.convolve(share, innovation)[: record.rows]
    innovation = np.where(np.isfinite(record.y), innovation, np.nan)
    if initial == "measured":
        without_history = np.flatnonzero(np.isfinite(record.y))[: past.shape[1]]
        innovation[without_history] = np.nan
        ahead[: without_history.max(initial=-1) + 1] = np.nan
    return ahead, innovation


def compute_initial_responses(
    model: PolynomialModel, rows: int, reach: Sequence[int], through: Sequence[float] | np.ndarray = (1.0,)
) -> list[np.ndarray]:
    """What everything before the first row can add to ``A y``: for each input the responses ``q^-j / F`` (N, m).

    ``reach``: lengths of the polynomials through which past outputs and errors act; the responses are those behind the filter
    ``1 / through``. Inputs of one ``F`` share theirs, which stand with the first of them.
    """
    counts: dict[tuple[float, ...], int] = {}
    for b, f in zip(model.b, model.f, strict=True):
        longest = max(len(b) + len(model.d) - 1, *(n + len(f) - 1 for n in reach)) - 1
        counts[tuple(f)] = max(counts.get(tuple(f), 0), min(longest, rows))
    blocks = []
    for f in model.f:
        response = lfilter([1.0], np.convolve(through, f), np.eye(1, rows)[0])
        count = counts.pop(tuple(f), 0)
        blocks.append(np.column_stack([np.empty((rows, 0)), *(delay_rows(response, j) for j in range(count))]))
    return blocks


def estimate_initial_state(
    free: np.ndarray,
    target: np.ndarray,
    initial: InitialChoice,
    rows: int | None,
    largest_amplification: float = 10.0,
) -> np.ndarray:
    """Shares (m,) of the free responses (N, m) that meet ``target`` (N,), NaN in gaps, on the first rows.

    ``"measured"`` meets as many rows as there are responses exactly; ``"estimated"`` the first ``rows`` by least squares. A
    direction that these rows barely determine, and that the rest of the record would show more than ``largest_amplification`` times
    larger, is left at zero.
    """
    if not free.shape[1]:
        return np.zeros(0)
    bounded = np.all(np.abs(free) < FREE_RESPONSE_GROWTH, axis=1)
    usable = np.isfinite(target) & bounded
    if initial == "measured":
        first = usable & (np.cumsum(usable) <= free.shape[1])
        return np.linalg.lstsq(free[first], target[first], rcond=None)[0]
    if rows is not None:
        usable[rows:] = False
    if not usable.any():
        return np.zeros(free.shape[1])
    # Coordinates z = R x of responses that are orthogonal over the whole record and of unit size there
    _, size, right = np.linalg.svd(np.linalg.qr(free[bounded], mode="r") / np.sqrt(bounded.sum()))
    significant = size > NEGLIGIBLE_SINGULAR_VALUE * size[0]
    back = right[significant].T / size[significant]
    u, s, v = np.linalg.svd(free[usable] @ back / np.sqrt(usable.sum()), full_matrices=False)
    # Coordinates of unit size over the whole record: a small singular value on the first rows is what the rest would
    # amplify.
    shown = s * largest_amplification > 1
    z = v[shown].T @ (u[:, shown].T @ target[usable] / s[shown]) / np.sqrt(usable.sum())
    return back @ z


def _innovations(alpha: np.ndarray, c: np.ndarray, y: np.ndarray, driven: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``C e = alpha y - driven`` for every column of ``driven`` (N, m), of which only the first has ``y`` (N,); e and y (N, m).

    In a gap of ``y`` the innovation is zero and ``y`` what follows from that.
    """
    measured = np.zeros_like(driven)
    measured[:, 0] = y
    gaps = np.isnan(y)
    if not gaps.any():
        return lfilter([1.0], c, lfilter(alpha, [1.0], measured, axis=0) - driven, axis=0), measured
    before = max(len(alpha), len(c)) - 1
    e, filled = np.zeros((2, before + len(y), driven.shape[1]))
    for k in range(before, before + len(y)):
        moving_average = sum(c[j] * e[k - j] for j in range(1, len(c)))
        regression = sum(alpha[j] * filled[k - j] for j in range(1, len(alpha)))
        expected = driven[k - before] + moving_average - regression
        if gaps[k - before]:
            filled[k] = expected
        else:
            filled[k] = measured[k - before]
            e[k] = filled[k] - expected
    return e[before:], filled[before:]


def _check_initial(initial: str) -> None:
    if initial not in get_args(InitialChoice):
        raise DataError(f"unknown initial state {initial!r}; {nearest(initial, get_args(InitialChoice))}")
