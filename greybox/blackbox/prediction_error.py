"""Prediction-error minimisation: Levenberg and Marquardt's search with filtered gradients, initial states projected out.

Over ``theta`` the sum of squares of ``e = D / C (A y - sum B / F u - constant)`` is minimised. The unknown past of each record
(of each stretch between gaps, where the predictor uses measured outputs) enters linearly; it is eliminated by projecting
errors and gradients off its responses (variable projection, Golub and Pereyra 1973, with Kaufman's gradient). The gradients are
filtered signals (Ljung, System identification, 2nd ed., section 10.3)::

    de/da_j = D / C q^-j y      de/db_j = -D / (C F) q^-j u      de/df_j = 1 / (C F) q^-j w,   w = D B / F u + its past
    de/dc_j = -1 / C q^-j e     de/dd_j = 1 / C q^-j (A y - sum B / F u - constant)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from greybox.blackbox.linear_regression import delay_rows
from greybox.blackbox.polynomial import PolynomialModel
from greybox.blackbox.responses import NEGLIGIBLE, compute_initial_responses
from greybox.blackbox.rounding import confine_roots, reflect_roots
from greybox.blackbox.sampled_data import SampledData, SampledRecord
from greybox.blackbox.structure import PolynomialStructure, to_monic

ITERATIONS = 100
# The search ends when a step promises, or has brought, less than this share of the sum of squares.
ENOUGH = 1e-12
DAMPING, HARDER, MOST_DAMPING = 1e-4, 2.0, 1e12  # of unit gradients; the factor after a step that failed
FADED = 1e-17  # share of its beginning below which a response is over


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """One-step errors (n,) of all stretches with the past projected out, their slopes (n, p), and the states projected out."""

    e: np.ndarray
    slopes: np.ndarray
    states: int

    @property
    def squares(self) -> float:
        """Sum of squares; infinite where the errors leave all bounds."""
        with np.errstate(over="ignore", invalid="ignore"):
            found = float(self.e @ self.e)
        return found if np.isfinite(found) else np.inf


@dataclass(frozen=True, eq=False)
class PredictionErrorMinimum:
    """Where a search ended: ``theta`` (p,), its errors, iterations, and whether it converged."""

    theta: np.ndarray
    errors: PredictionErrors
    iterations: int
    converged: bool


def split_records(data: SampledData, structure: PolynomialStructure) -> tuple[SampledRecord, ...]:
    """What has one initial state each: whole records for an output error, the parts between gaps where the past outputs count."""
    if not (structure.orders.na or structure.nc or structure.nd):
        return data.series
    least = 2 * max(structure.orders.reach, structure.nc, *structure.nf) + structure.nd + 2
    return tuple(part for series in data.series for part in series.segments(least))


def compute_prediction_errors(
    structure: PolynomialStructure,
    theta: np.ndarray,
    data: SampledData,
    parts: Sequence[SampledRecord],
    *,
    rest: bool,
    slopes: bool,
) -> PredictionErrors:
    """Errors at ``theta``, and their slopes if wanted; ``rest``: everything was zero before each record, nothing is projected out.

    Behind the slopes to ``theta`` stand those to the shares of each input's ``basis``, where the parts have them.
    """
    model = structure.model(theta, data)
    found = [_of_stretch(structure, model, part, rest, slopes) for part in parts]
    e, j, states = zip(*found, strict=True)
    return PredictionErrors(np.concatenate(e), np.concatenate(j), sum(states))


def minimise(
    evaluate: Callable[[np.ndarray, bool], PredictionErrors],
    admissible: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    iterations: int = ITERATIONS,
    enough: float = ENOUGH,
) -> PredictionErrorMinimum:
    """Levenberg and Marquardt's search from ``start`` (p,), damped after Nielsen (1999) by what the last step kept of its promise.

    ``evaluate`` gives the errors, with slopes if its second argument says so; ``admissible`` maps coefficients to allowed ones.
    """
    theta = admissible(start)
    here = evaluate(theta, True)
    damping, harder, taken = DAMPING, HARDER, 0
    while taken < iterations and here.squares > 0:
        step, promised = _step(here, damping)
        if promised <= enough * here.squares or damping > MOST_DAMPING:
            return PredictionErrorMinimum(theta, here, taken, True)
        trial = admissible(theta + step)
        there = evaluate(trial, False)
        kept = (here.squares - there.squares) / promised
        if not kept > 0:
            damping, harder = damping * harder, 2 * harder
            continue
        damping, harder = damping * max(1 / 3, 1 - (2 * min(kept, 1.0) - 1) ** 3), HARDER
        settled = here.squares - there.squares <= enough * here.squares
        theta, taken = trial, taken + 1
        here = evaluate(theta, True)
        if settled:
            return PredictionErrorMinimum(theta, here, taken, True)
    return PredictionErrorMinimum(theta, here, taken, here.squares == 0)


def _step(here: PredictionErrors, damping: float) -> tuple[np.ndarray, float]:
    """The damped Gauss-Newton step (p,) and how much of the sum of squares it should take away."""
    scale = np.linalg.norm(here.slopes, axis=0)
    scale[scale == 0] = 1.0
    triangle = np.asarray(np.linalg.qr(np.column_stack([here.slopes / scale, here.e]), mode="r"))
    left, size, right = np.linalg.svd(triangle[: len(scale), : len(scale)])
    size = np.where(size > NEGLIGIBLE * size[0], size, 0.0)
    pull = left.T @ triangle[: len(scale), -1]
    weight = size / (size**2 + damping)
    return -right.T @ (pull * weight) / scale, float(np.sum(pull**2 * weight * (2 * size - size**2 * weight)))


def stabilise(structure: PolynomialStructure, theta: np.ndarray) -> np.ndarray:
    """``theta`` (p,) with ``C`` and ``D`` reflected into, and the roots of ``F`` held inside the unit circle."""
    parts = structure.parts(theta)
    n = len(structure.nf)
    for k in range(1 + n, 1 + 2 * n):
        parts[k] = confine_roots(to_monic(parts[k]))[1:]
    for k in (1 + 2 * n, 2 + 2 * n):
        parts[k] = reflect_roots(to_monic(parts[k]))[1:]
    return np.concatenate(parts)


def _of_stretch(
    structure: PolynomialStructure, model: PolynomialModel, data: SampledRecord, rest: bool, slopes: bool
) -> tuple[np.ndarray, np.ndarray, int]:
    c, d, there = model.c, model.d, np.isfinite(data.y)
    through = [lfilter(b, f, u) for b, f, u in zip(model.b, model.f, data.u.T, strict=True)]
    # Output error: the zeros in the gaps meet no filter, and their rows are left out below.
    y = data.y if there.all() else np.where(there, data.y, 0.0)
    shortfall = lfilter(model.a, [1.0], y) - sum(through) - (model.constant or 0.0)
    e = lfilter(d, c, shortfall)
    alive = _alive(model, data.rows)
    blocks = [] if rest else compute_initial_responses(model, alive, [len(model.a) + len(d) - 1, len(c)], c)
    free = np.hstack([np.empty((alive, 0)), *blocks])
    past = _past(free[there[:alive]])
    projected = past.without(e[there])
    if not slopes:
        return projected, np.empty((len(projected), 0)), past.states
    share = past.shares(e[there])
    # Each input's drive with what its own past adds to it
    own = (
        np.split(share, np.cumsum([block.shape[1] for block in blocks])[:-1])
        if blocks
        else [np.empty(0)] * len(through)
    )
    driven = [
        lfilter(d, [1.0], w) + lfilter(s, f, np.eye(1, data.rows)[0]) if len(s) else lfilter(d, [1.0], w)
        for w, s, f in zip(through, own, model.f, strict=True)
    ]
    e[:alive] -= free @ share
    columns = _slopes(structure, model, data.u, y, shortfall, driven, e, data.basis)[there]
    return projected, past.without(columns), past.states


@dataclass(frozen=True, eq=False)
class _Past:
    """Orthonormal ``basis`` (k, r) of the free responses, which are over after k rows, and ``back`` (m, r) to their shares."""

    basis: np.ndarray
    back: np.ndarray

    @property
    def states(self) -> int:
        return self.basis.shape[1]

    def without(self, values: np.ndarray) -> np.ndarray:
        """``values`` (n, ...) less their part along the free responses."""
        if not self.states:
            return values
        rest, k = values.copy(), len(self.basis)
        rest[:k] -= self.basis @ (self.basis.T @ values[:k])
        return rest

    def shares(self, e: np.ndarray) -> np.ndarray:
        """Shares (m,) of the free responses that come nearest to ``e`` (n,)."""
        return self.back @ (self.basis.T @ e[: len(self.basis)])


def _past(free: np.ndarray) -> _Past:
    """The span of the columns of ``free`` (n, m)."""
    if not free.size:
        return _Past(np.empty((0, 0)), np.zeros((free.shape[1], 0)))
    q, triangle = np.linalg.qr(free)
    left, size, right = np.linalg.svd(triangle)
    kept = size > NEGLIGIBLE * size[0]
    return _Past(q @ left[:, kept], right[kept].T / size[kept])


def _alive(model: PolynomialModel, rows: int) -> int:
    """Rows after which what was before the record is forgotten, at most ``rows``: by then the slowest root has faded."""
    slowest = max((float(np.abs(np.roots(p)).max(initial=0.0)) for p in (model.c, *model.f)), default=0.0)
    longest = max(len(model.a) + len(model.d), len(model.c), *(len(b) + len(model.d) for b in model.b)) + len(model.d)
    if slowest <= 0:
        return min(rows, longest)
    if slowest >= 1:
        return rows
    # Half as long again, for roots of several filters that meet
    return int(min(rows, longest + 10 + 1.5 * np.log(FADED) / np.log(slowest)))


def _slopes(
    structure: PolynomialStructure, model: PolynomialModel, u: np.ndarray, y: np.ndarray, shortfall: np.ndarray,
    driven: Sequence[np.ndarray], e: np.ndarray, basis: Sequence[np.ndarray],
) -> np.ndarray:  # fmt: skip
    """Gradients (N, p) of the errors ``e`` (N,), in the order of the structure's vector."""
    o, c, d = structure.orders, model.c, model.d
    filtered = lfilter(d, c, y)
    columns = [delay_rows(filtered, j) for j in range(1, o.na + 1)]
    for f, nb, nk, signal in zip(model.f, o.nb, o.nk, u.T, strict=True):
        filtered = -lfilter(d, np.convolve(c, f), signal)
        columns += [delay_rows(filtered, nk + j) for j in range(nb)]
    for f, nf, signal in zip(model.f, structure.nf, driven, strict=True):
        filtered = lfilter([1.0], np.convolve(c, f), signal)
        columns += [delay_rows(filtered, j) for j in range(1, nf + 1)]
    filtered = -lfilter([1.0], c, e)
    columns += [delay_rows(filtered, j) for j in range(1, structure.nc + 1)]
    filtered = lfilter([1.0], c, shortfall)
    columns += [delay_rows(filtered, j) for j in range(1, structure.nd + 1)]
    if structure.offset:
        columns.append(-lfilter(d, c, np.ones(len(y))))
    for b, f, shapes in zip(model.b, model.f, basis, strict=False):
        columns.append(-lfilter(np.convolve(b, d), np.convolve(c, f), shapes, axis=0))
    return np.column_stack(columns)
