"""Parameters that differ between experiments, halves of a record or amplitudes: they imitate something that the model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations

import numpy as np
from scipy.special import ndtri

from greybox.base import ROWS_AT_A_TIME, decompose_symmetric
from greybox.data.noise.noise_model import AutoRegression, NoiseModel, NoiseSource
from greybox.estimation.sandwich import ResidualColour, sum_scores
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.problem import Runs


class PartKind(StrEnum):
    """How a part of the data was chosen."""

    EXPERIMENT = "experiment"
    FIRST_HALF = "first_half"
    SECOND_HALF = "second_half"
    SMALL_MOTION = "small_motion"
    LARGE_MOTION = "large_motion"


@dataclass(frozen=True)
class DataPart:
    """A part of the data: of some records (by their number) the rows (N,) that belong to it.

    ``subject`` names the experiment of a part that is one, and the number of records otherwise.
    """

    kind: PartKind
    subject: str
    rows: Mapping[int, np.ndarray]

    @property
    def label(self) -> str:
        """``kind:subject``, which names the part in a finding."""
        return f"{self.kind}:{self.subject}"


@dataclass(frozen=True)
class ParameterShift:
    """A parameter that would be ``before`` in one part of the data and ``after`` in another, ``deviations`` standard deviations apart.

    ``before`` and ``after`` are None where the parts differ but do not tell by how much. ``parts``: `DataPart.label` of the two.
    """

    name: str
    unit: str
    before: float | None
    after: float | None
    deviations: float
    parts: tuple[str, str]


# Standard deviations apart from which a shift counts.
CONSTANCY_LEAST_DEVIATIONS = 3.0
# Rate of false alarms over all comparisons of a fit.
CONSTANCY_FALSE_ALARM_RATE = 0.01


def find_parameter_shifts(
    variables: DecisionVector,
    rows: Runs,
    colour: ResidualColour,
    outputs: Sequence[np.ndarray],
    names: Sequence[str],
    excluded: Sequence[str] = (),
) -> list[ParameterShift]:
    """Parameters that differ too far between experiments, halves of the records, or small and large motion; the farthest first.

    ``rows``: weighted residuals and slopes of each experiment, by their ``names``; ``colour`` and variance are those that noise alone
    leaves in them. ``outputs`` (N, ny): those of the model. ``excluded``: parameters that are not tested.

    Each part has its own parameters and initial states, one Gauss-Newton step from the common optimum (a score test of constancy). The
    standard deviation of a shift is the one that noise leaves: where the residual clearly exceeds the noise, of the noise alone;
    else of the residual with its colour. A parameter that each experiment has for itself may differ, and is not tested.
    """
    inside = np.flatnonzero(~variables.active & (variables.owner == SHARED) & ~np.isin(variables.names, excluded))
    if not len(inside):
        return []
    count = str(len(rows))
    experiments = [
        DataPart(PartKind.EXPERIMENT, repr(name), {e: np.ones(len(rows[e][0]), bool)}) for e, name in enumerate(names)
    ]
    first = {e: np.arange(len(r)) < len(r) // 2 for e, (r, _) in enumerate(rows)}
    halves = [
        DataPart(PartKind.FIRST_HALF, count, first),
        DataPart(PartKind.SECOND_HALF, count, {e: ~mask for e, mask in first.items()}),
    ]
    groups = [
        [(part.label, *step) for part in parts if (step := _step_to_optimum(variables, rows, part, colour, inside))]
        for parts in (experiments if len(rows) > 1 else [], halves, _split_by_motion(outputs, colour))
    ]
    comparisons = max(sum(len(inside) * len(g) * (len(g) - 1) // 2 for g in groups), 1)
    # Bonferroni: the rate of false alarms is shared by all comparisons, on two sides.
    threshold = max(CONSTANCY_LEAST_DEVIATIONS, float(-ndtri(CONSTANCY_FALSE_ALARM_RATE / comparisons / 2)))
    farthest: dict[int, ParameterShift] = {}
    for (one, step_a, variance_a), (other, step_b, variance_b) in (pair for g in groups for pair in combinations(g, 2)):
        with np.errstate(divide="ignore", invalid="ignore"):
            # The parts are independent: their variances add up.
            deviations = np.abs(step_b - step_a) / np.sqrt(variance_a + variance_b)
        beyond = deviations > threshold
        ends = np.array([_find_ends(variables, inside, step) for step in (step_a, step_b)])
        clipped = np.clip(ends, *np.transpose([variables.quantities[k].bounds for k in inside]))
        same = clipped[0] == clipped[1]  # both beyond the same bound: nowhere to go
        # The step moves all constants of a part together: where one would leave its bounds, or its own 95 % interval there is as wide as
        # its value, the others have no value either.
        widths = [
            _find_ends(variables, inside, step, 2 * np.sqrt(v))
            for step, v in ((step_a, variance_a), (step_b, variance_b))
        ]
        vague = (ends != clipped) | ~(np.array(widths) < np.abs(ends))
        has_values = not vague[:, beyond & ~same].any()
        for k in map(int, np.flatnonzero(beyond & ~same)):
            if k not in farthest or deviations[k] > farthest[k].deviations:
                quantity, size = variables.quantities[inside[k]], float(deviations[k])
                before, after = map(float, clipped[:, k]) if has_values else (None, None)
                farthest[k] = ParameterShift(quantity.name, quantity.unit, before, after, size, (one, other))
    return sorted(farthest.values(), key=lambda s: -s.deviations)


def _find_ends(
    variables: DecisionVector, inside: np.ndarray, step: np.ndarray, deviation: np.ndarray | None = None
) -> np.ndarray:
    """Values (k,) of the parameters ``inside`` after a ``step`` in z, or what a ``deviation`` in z is in their units there."""
    base, scale, logarithmic = variables.base[inside], variables.scale[inside], variables.logarithmic[inside]
    ends = np.where(logarithmic, base * np.exp(np.clip(step, -50, 50)), base + scale * step)
    return ends if deviation is None else deviation * np.where(logarithmic, np.abs(ends), scale)


def compute_running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean (N,) of ``width`` samples around each of ``values`` (N,), which go on beyond their ends as they end."""
    before, count = width // 2, len(values)
    sums = np.empty(count + width)
    sums[: before + 1], sums[before + 1 : before + 1 + count], sums[before + 1 + count :] = (
        values[0],
        values,
        values[-1],
    )
    sums[0] = 0.0
    del values  # a long record is in memory a few times only
    np.cumsum(sums[1:], out=sums[1:])
    mean = sums[:count]
    for first in range(0, count, ROWS_AT_A_TIME):  # in its place: what a block needs lies in it or behind it
        last = min(first + ROWS_AT_A_TIME, count)
        mean[first:last] = (sums[first + width : last + width] - mean[first:last]) / width
    return mean


# Small and large motion are told apart in so many windows of a record ...
MOTION_WINDOWS = 50
# ... over so many correlation times of the residual at least ...
CONSTANCY_CORRELATION_TIMES = 5.0
# ... if the upper quarter of the motion is so many times as large as the lower.
MOTION_RATIO = 1.5


def _split_by_motion(outputs: Sequence[np.ndarray], colour: ResidualColour) -> list[DataPart]:
    """The rows with small and with large motion, if the motion changes enough; motion is smoothed over some correlation times."""
    everything = outputs[0] if len(outputs) == 1 else np.concatenate(outputs)
    mean, spread = everything.mean(axis=0), everything.std(axis=0)
    del everything
    if not np.isfinite(spread).all() or not spread.any():
        return []
    moving = spread > 0
    time = max((t for t, _ in colour.times), default=1.0)
    size = {}
    for e, y in enumerate(outputs):
        width = int(min(max(len(y) / MOTION_WINDOWS, CONSTANCY_CORRELATION_TIMES * time), len(y)))
        used = y if moving.all() else y[:, moving]
        # Mean square over the outputs of their distance from the mean, in units of their spread.
        squares = np.empty(len(y))
        for first in range(0, len(y), ROWS_AT_A_TIME):  # a long record is in memory a few times only
            block = slice(first, first + ROWS_AT_A_TIME)
            squares[block] = np.square((used[block] - mean[moving]) / spread[moving]).mean(axis=1)
        squares = compute_running_mean(squares, max(width, 1))
        # Root mean square of the motion around each row.
        size[e] = np.sqrt(squares, out=squares)
    ordered = np.concatenate(list(size.values()))
    ordered.sort()
    small, middle, large = ordered[[int(share * (len(ordered) - 1)) for share in (0.25, 0.5, 0.75)]]
    if large < MOTION_RATIO * small:
        return []
    parts = {e: values <= middle for e, values in size.items()}
    records = str(len(outputs))
    return [
        DataPart(PartKind.SMALL_MOTION, records, parts),
        DataPart(PartKind.LARGE_MOTION, records, {e: ~mask for e, mask in parts.items()}),
    ]


# Misfit over a noise that was measured or given from which a residual is more than noise: above the scatter of an estimated level.
NOISE_RATIO = 1.3
# The same over a noise told by differences of the records alone, which may be coloured and that much too small.
DIFFERENCE_NOISE_RATIO = 10.0


def find_certain_ratio(noise: NoiseModel, output: str) -> float:
    """Misfit over the noise that is weighed with from which a residual is certainly more than noise."""
    if noise.sources.get(output) is NoiseSource.DIFFERENCES:
        return DIFFERENCE_NOISE_RATIO
    return NOISE_RATIO * noise.ceiling_ratio(output)


# A residual below this share of the noise is rounding or integration error, which is not random.
CONSTANCY_LEAST_NOISE_RATIO = 0.1


def expect_noise(colour: ResidualColour, rows: Runs, noise: NoiseModel) -> ResidualColour:
    """Colour and variance of what noise alone leaves in the weighted residuals ``rows``, which have the ``colour``.

    Where the residual clearly exceeds the noise it is white noise of the size that is known, unless the residual was taken for the noise.
    """
    squares = np.concatenate([np.square(r) for r, _ in rows])
    counts = np.isfinite(squares).sum(axis=0)
    squares[np.isnan(squares)] = 0.0  # in its place: a long record is in memory a few times only
    # Misfit over the noise that the rows are weighed with.
    ratio = np.sqrt(squares.sum(axis=0) / np.maximum(counts, 1))
    del squares
    models, variance = list(colour.models), [max(v, CONSTANCY_LEAST_NOISE_RATIO**2) for v in colour.variance]
    for j, name in enumerate(noise.outputs):
        if name not in noise.by_residual and ratio[j] > find_certain_ratio(noise, name):
            models[j], variance[j] = AutoRegression(), 1.0
    return replace(colour, models=tuple(models), variance=tuple(variance))


# Parts with fewer residuals for each unknown say nothing.
RESIDUALS_PER_UNKNOWN = 10


def _step_to_optimum(
    variables: DecisionVector, rows: Runs, part: DataPart, colour: ResidualColour, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Step of the parameters ``inside`` to the part's own optimum and its variance (k,), both in ``z``; None if it is too short."""
    n, shared = len(variables.which), len(inside)
    layout = _PartLayout(
        shared,
        {
            e: np.concatenate(
                [
                    np.flatnonzero(~variables.is_foreign(e) & (variables.owner != SHARED)),
                    np.arange(n, rows[e][1].shape[2]),
                ]
            )
            for e in part.rows
        },
    )
    data = {}
    for e, mask in part.rows.items():
        r, jacobian = rows[e]
        # Of a coloured residual the rows keep their places in time.
        r, jacobian = (np.where(mask[:, None], r, np.nan), jacobian) if colour.coloured else (r[mask], jacobian[mask])
        lanes = np.concatenate([inside, layout.others[e]])
        is_all = np.array_equal(lanes, np.arange(jacobian.shape[2]))
        data[e] = r, jacobian if is_all else jacobian[:, :, lanes]
    if sum(int(np.isfinite(r).sum()) for r, _ in data.values()) < RESIDUALS_PER_UNKNOWN * layout.size:
        return None
    sums = sum_scores(layout, list(data.values()), colour, list(data))
    decomposition = decompose_symmetric(sums.information).without_doubtful()
    inverse = decomposition.pseudo_inverse
    # A^-1 B A^-1, B the covariance of the score under the noise.
    variance = np.diag(inverse @ sums.coloured @ inverse)
    return (-inverse @ sums.score)[:shared], np.where(decomposition.is_open[:shared], np.inf, variance[:shared])


@dataclass(frozen=True)
class _PartLayout:
    """The unknowns of one part by itself: ``shared`` parameters, then the ``others`` of each of its records (lanes of the Jacobian)."""

    shared: int
    others: Mapping[int, np.ndarray]

    @property
    def size(self) -> int:
        return self.shared + sum(map(len, self.others.values()))

    def columns(self, experiment: int) -> np.ndarray:
        before = sum(len(lanes) for e, lanes in self.others.items() if e < experiment)
        return np.concatenate([np.arange(self.shared), self.shared + before + np.arange(len(self.others[experiment]))])
