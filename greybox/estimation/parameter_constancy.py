"""Constants that move between experiments, halves of a record or amplitudes: they imitate something the model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from greybox.estimation.sandwich import ResidualColour, estimate_residual_colour, estimate_score_covariance
from greybox.estimation.solve import Solution
from greybox.noise import AutoRegression
from greybox.noise.noise_sources import NoiseSource
from greybox.transcription import DecisionVector
from greybox.transcription.decision_vector import SHARED

DataPart = tuple[str, Mapping[int, np.ndarray]]  # what it is called, and which rows (N,) of each record it has

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
# Slopes (in units of the noise) below which a constant does not act in a part.
FAINT = 1e-100


# Small and large motion are told apart in so many windows of a record, over so many correlation times of the residual at least, if
# the upper quarter of the motion is so many times as large as the lower.
WINDOWS, CORRELATION_TIMES, DIFFERENT = 50, 5.0, 1.5


@dataclass(frozen=True)
class ParameterShift:
    """``name`` would be ``before`` in one part of the data and ``after`` in another; ``deviations`` standard deviations apart."""

    name: str
    unit: str
    before: float
    after: float
    deviations: float
    between: str


Rows = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ConstancyInput:
    """What is looked at: the constants, the ``names`` of their experiments, the model's outputs (N, ny) in each of them, and ``colour``
    and variance of what noise alone leaves in the weighted residual. ``aside``: constants that are not looked at.
    """

    variables: DecisionVector
    names: Sequence[str]
    outputs: Sequence[np.ndarray]
    colour: ResidualColour
    aside: Sequence[str] = ()


def find_solution_shifts(solution: Solution, rows: Rows) -> list[ParameterShift]:
    """`find_parameter_shifts` a fit by free runs, from the weighted residual (N, ny) of each record and its slopes (N, ny, L)."""
    if not np.isfinite(solution.evaluation.cost):
        return []
    problem = solution.problem
    runs = zip(problem.records, solution.simulate(), strict=True)
    names = [e.name for e in problem.experiments]
    outputs = [record.samples(y) for record, (y, _) in runs]
    return find_parameter_shifts(ConstancyInput(solution.variables, names, outputs, _noise(solution, rows)), rows)


def find_parameter_shifts(judged: ConstancyInput, rows: Rows) -> list[ParameterShift]:
    """Constants that move too far between experiments, halves of the records, or small and large motion; the farthest first.

    Each part has its own constants and initial states, one Gauss-Newton step from the common optimum (a score test of constancy). The
    standard deviation of a move is the one that noise leaves: where the residual clearly exceeds the noise, of the noise alone;
    else of the residual with its colour. A constant that each experiment has for itself may move, and is not looked at.
    """
    variables, colour = judged.variables, judged.colour
    inside = np.flatnonzero(~variables.active & (variables.owner == SHARED) & ~np.isin(variables.names, judged.aside))
    if not len(inside):
        return []
    groups = [
        [(name, *found) for name, rows_in in parts if (found := _part(variables, rows, rows_in, colour, inside))]
        for parts in (_experiments(judged, rows), _halves(rows), _amplitudes(judged))
    ]
    comparisons = max(sum(len(inside) * len(g) * (len(g) - 1) // 2 for g in groups), 1)
    threshold = max(LEAST, float(-ndtri(ALARMS / comparisons / 2)))
    farthest: dict[int, ParameterShift] = {}
    for (one, step_a, variance_a), (other, step_b, variance_b) in (pair for g in groups for pair in combinations(g, 2)):
        with np.errstate(divide="ignore", invalid="ignore"):
            deviations = np.abs(step_b - step_a) / np.sqrt(variance_a + variance_b)
        for k in map(int, np.flatnonzero(deviations > threshold)):
            if k not in farthest or deviations[k] > farthest[k].deviations:
                between = f"{one} and {other}"
                farthest[k] = _move(variables, inside[k], step_a[k], step_b[k], float(deviations[k]), between)
    seen = [m for m in farthest.values() if m.before != m.after]  # both beyond the same bound: nowhere to move
    return sorted(seen, key=lambda m: -m.deviations)


def _experiments(judged: ConstancyInput, rows: Rows) -> list[DataPart]:
    """Each experiment by itself, if there are several."""
    if len(rows) < 2:
        return []
    known = judged.names
    names = [f"experiment {known[e]!r}" if known else f"experiment {e + 1}" for e in range(len(rows))]
    return [(name, {e: np.ones(len(rows[e][0]), bool)}) for e, name in enumerate(names)]


def _halves(rows: Rows) -> list[DataPart]:
    """The first and the second half of every record."""
    first = {e: np.arange(len(r)) < len(r) // 2 for e, (r, _) in enumerate(rows)}
    of = "half of the record" if len(rows) == 1 else "halves of the records"
    return [(f"the first {of}", first), (f"the second {of}", {e: ~mask for e, mask in first.items()})]


def compute_running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean (N,) of ``width`` samples around each of ``values`` (N,), which go on beyond their ends as they end."""
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray((sums[width:] - sums[:-width]) / width)


def _amplitudes(judged: ConstancyInput) -> list[DataPart]:
    """The rows with small and with large motion, if the motion changes enough; motion is smoothed over some correlation times."""
    outputs, colour = judged.outputs, judged.colour
    everything = np.concatenate(outputs)
    spread = np.nanstd(everything, axis=0)
    if not np.isfinite(spread).all() or not spread.any():
        return []
    moving = spread > 0
    time = max((t for t, _ in colour.times), default=1.0)
    size = {}
    for e, y in enumerate(outputs):
        away = np.square((y - everything.mean(axis=0))[:, moving] / spread[moving]).mean(axis=1)
        width = int(min(max(len(y) / WINDOWS, CORRELATION_TIMES * time), len(y)))
        size[e] = np.sqrt(compute_running_mean(away, max(width, 1)))
    every = np.concatenate(list(size.values()))
    small, middle, large = np.quantile(every, [0.25, 0.5, 0.75])
    if large < DIFFERENT * small:
        return []
    parts = {e: values <= middle for e, values in size.items()}
    return [("small motion", parts), ("large motion", {e: ~mask for e, mask in parts.items()})]


def _noise(solution: Solution, rows: Rows) -> ResidualColour:
    """Colour and variance of what noise alone leaves in the weighted residual."""
    noise, everything = solution.problem.noise, np.concatenate([r for r, _ in rows])
    found = estimate_residual_colour(rows, solution.unknowns, noise.known, solution.problem.least)
    names = [o.name for o in solution.problem.model.outputs]
    counts = np.isfinite(everything).sum(axis=0)
    ratio = np.sqrt(np.nansum(everything**2, axis=0) / np.maximum(counts, 1))
    found = replace(found, variance=tuple(max(v, LITTLE**2) for v in found.variance))
    for j, name in enumerate(names):
        limit = VISIBLE_BY_DIFFERENCES if noise.sources.get(name) is NoiseSource.DIFFERENCES else VISIBLE
        if ratio[j] > limit:
            models, variance = list(found.models), list(found.variance)
            models[j], variance[j] = AutoRegression(), 1.0
            found = replace(found, models=tuple(models), variance=tuple(variance))
    return found


def _part(
    variables: DecisionVector,
    rows: Rows,
    chosen: Mapping[int, np.ndarray],
    colour: ResidualColour,
    inside: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Step of the constants ``inside`` to the part's own optimum and its variance (k,), both in ``z``; None if too short.

    ``chosen``: which rows (N,) of some records are the part.
    """
    n, shared = len(variables.which), len(inside)
    layout = _Part(shared, {e: np.concatenate([np.flatnonzero(~variables.is_foreign(e) & (variables.owner != SHARED)),
                                               np.arange(n, rows[e][1].shape[2])]) for e in chosen})  # fmt: skip
    here = {
        e: (np.where(mask[:, None], rows[e][0], np.nan), rows[e][1][:, :, layout.lanes(e, inside)])
        for e, mask in chosen.items()
    }
    if sum(int(np.isfinite(r).sum()) for r, _ in here.values()) < RESIDUALS_PER_UNKNOWN * layout.size:
        return None
    information, score = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    for e, (r, jacobian) in here.items():
        there, columns = np.isfinite(r), layout.columns(e)
        slopes = jacobian[there]
        information[np.ix_(columns, columns)] += slopes.T @ slopes
        score[columns] += slopes.T @ r[there]
    scale = np.sqrt(np.diag(information))
    scale[scale < FAINT] = 1.0  # what hardly acts in this part at all: its square is next to underflow
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    weak = values <= UNDETERMINED * values.max(initial=0.0)
    inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T / np.outer(scale, scale)
    meat = estimate_score_covariance(layout, list(here.values()), colour, list(here))
    variance = np.diag(inverse @ meat @ inverse)
    open_ = np.any(np.abs(vectors[:shared, weak]) > 1e-3, axis=1)
    return (-inverse @ score)[:shared], np.where(open_, np.inf, variance[:shared])


@dataclass(frozen=True)
class _Part:
    """The unknowns of one part by itself: ``shared`` constants, then the ``others`` of each of its records (lanes of the Jacobian)."""

    shared: int
    others: Mapping[int, np.ndarray]

    @property
    def size(self) -> int:
        return self.shared + sum(map(len, self.others.values()))

    def columns(self, experiment: int) -> np.ndarray:
        before = sum(len(lanes) for e, lanes in self.others.items() if e < experiment)
        return np.concatenate([np.arange(self.shared), self.shared + before + np.arange(len(self.others[experiment]))])

    def lanes(self, experiment: int, inside: np.ndarray) -> np.ndarray:
        return np.concatenate([inside, self.others[experiment]])


def _move(
    variables: DecisionVector, k: int, before: float, after: float, deviations: float, between: str
) -> ParameterShift:
    quantity, value = variables.quantities[k], float(variables.base[k])
    if variables.logarithmic[k]:
        one, other = (value * float(np.exp(np.clip(step, -50, 50))) for step in (before, after))
    else:
        one, other = (value + float(variables.scale[k]) * step for step in (before, after))
    low, high = quantity.bounds
    one, other = min(max(one, low), high), min(max(other, low), high)
    return ParameterShift(quantity.name, quantity.unit, one, other, deviations, between)
