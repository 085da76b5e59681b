"""Constants that move between experiments, or between the halves of a record: they imitate something the model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from greybox.fitting.sandwich import Colour, colour_of, score_covariance
from greybox.fitting.solve import Solution
from greybox.noise import AutoRegression
from greybox.noise.hierarchy import DIFFERENCES
from greybox.transcription import Variables

# A move counts from this many standard deviations, and from a false alarm rate of this over all comparisons of a fit.
LEAST, ALARMS = 3.0, 0.01
# Misfit over noise from which a residual is not noise; noise told by differences alone may be coloured and that much too small.
VISIBLE, VISIBLE_BY_DIFFERENCES = 1.3, 10.0
# A residual below this share of the noise is rounding or integration error, which is not random.
LITTLE = 0.1
# Parts with fewer residuals than this for each unknown say nothing.
RESIDUALS_PER_UNKNOWN = 10
# Directions of a part with less than this share of its largest curvature are left alone.
UNDETERMINED = 1e-10


@dataclass(frozen=True)
class Move:
    """``name`` would be ``before`` in one part of the data and ``after`` in another; ``deviations`` standard deviations apart."""

    name: str
    unit: str
    before: float
    after: float
    deviations: float
    between: str


def moves(solution: Solution, rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[Move]:
    """Constants that move too far between experiments (if several), else between the halves of the record; the farthest first.

    Each part has its own constants and initial state, one Gauss-Newton step from the common optimum (a score test of constancy). The
    standard deviation of a move is the one that noise leaves: where the residual clearly exceeds the noise, of the noise alone;
    else of the residual with its colour.
    """
    problem, variables = solution.problem, solution.variables
    if not len(variables.which) or not np.isfinite(solution.evaluation.cost):
        return []
    colour = _noise(solution, rows)
    if len(rows) > 1:
        pieces = [(e, 0, len(r)) for e, (r, _) in enumerate(rows)]
        names = [
            f"experiment {problem.experiments[e].name!r}" if problem.experiments else f"experiment {e + 1}"
            for e, *_ in pieces
        ]
    else:
        half = len(rows[0][0]) // 2
        pieces, names = [(0, 0, half), (0, half, len(rows[0][0]))], ["the first half of the record", "the second"]
    inside = np.flatnonzero(~variables.active(variables.fixed))
    parts = [
        (name, *part)
        for name, piece in zip(names, pieces, strict=True)
        if (part := _part(solution, rows, piece, colour, inside))
    ]
    comparisons = max(len(inside) * len(parts) * (len(parts) - 1) // 2, 1)
    threshold = max(LEAST, float(-ndtri(ALARMS / comparisons / 2)))
    farthest: dict[int, Move] = {}
    for a, (one, step_a, variance_a) in enumerate(parts):
        for other, step_b, variance_b in parts[a + 1 :]:
            with np.errstate(divide="ignore", invalid="ignore"):
                deviations = np.abs(step_b - step_a) / np.sqrt(variance_a + variance_b)
            for k in map(int, np.flatnonzero(deviations > threshold)):
                if k not in farthest or deviations[k] > farthest[k].deviations:
                    farthest[k] = _move(
                        variables, inside[k], step_a[k], step_b[k], float(deviations[k]), f"{one} and {other}"
                    )
    return sorted(farthest.values(), key=lambda m: -m.deviations)


def _noise(solution: Solution, rows: Sequence[tuple[np.ndarray, np.ndarray]]) -> Colour:
    """Colour and variance of what noise alone leaves in the weighted residual."""
    noise, evaluation = solution.problem.noise, solution.evaluation
    found = colour_of(rows, solution.variables.size, noise.given)
    names = [o.name for o in solution.problem.model.outputs]
    ratio = np.sqrt(evaluation.squares / np.maximum(evaluation.counts, 1))
    found = replace(found, variance=tuple(max(v, LITTLE**2) for v in found.variance))
    for j, name in enumerate(names):
        limit = VISIBLE_BY_DIFFERENCES if noise.sources.get(name) == DIFFERENCES else VISIBLE
        if ratio[j] > limit:
            models, variance = list(found.models), list(found.variance)
            models[j], variance[j] = AutoRegression(), 1.0
            found = replace(found, models=tuple(models), variance=tuple(variance))
    return found


def _part(
    solution: Solution,
    rows: Sequence[tuple[np.ndarray, np.ndarray]],
    piece: tuple[int, int, int],
    colour: Colour,
    inside: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Step of the constants ``inside`` to the part's own optimum and its variance (k,), both in ``z``; None if too short."""
    e, start, stop = piece
    variables = solution.variables
    n = len(variables.which)
    r, jacobian = rows[e][0][start:stop], rows[e][1][start:stop]
    lanes = np.concatenate([inside, np.arange(n, jacobian.shape[2])])
    there = np.isfinite(r)
    if there.sum() < RESIDUALS_PER_UNKNOWN * len(lanes):
        return None
    x, y = jacobian[there][:, lanes], r[there]
    scale = np.linalg.norm(x, axis=0)
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh((x / scale).T @ (x / scale))
    weak = values <= UNDETERMINED * values.max(initial=0.0)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    step = -inverse @ (x.T @ y)
    meat = score_covariance(_Part(len(lanes)), [(r, jacobian[:, :, lanes])], colour)
    variance = np.diag(inverse @ meat @ inverse)
    open_ = np.any(np.abs(vectors[: len(inside), weak]) > 1e-3, axis=1)
    return step[: len(inside)], np.where(open_, np.inf, variance[: len(inside)])


@dataclass(frozen=True)
class _Part:
    """The unknowns of one part by itself."""

    size: int

    def columns(self, experiment: int) -> np.ndarray:
        return np.arange(self.size)


def _move(variables: Variables, k: int, before: float, after: float, deviations: float, between: str) -> Move:
    quantity = variables.model.parameter(variables.names[k])
    value = float(variables.fixed[variables.which[k]])
    if variables.logarithmic[k]:
        one, other = (value * float(np.exp(np.clip(step, -50, 50))) for step in (before, after))
    else:
        one, other = (value + float(variables.scale[k]) * step for step in (before, after))
    low, high = quantity.bounds
    one, other = min(max(one, low), high), min(max(other, low), high)
    return Move(quantity.name, quantity.unit, one, other, deviations, between)
