"""`chart_changes`: one machine over many records, and between which of them its constants have jumped.

Each record gives an estimate of every constant with its variance. A machine may wander a little from day to day beyond that
(temperature, mounting): that variance comes from the differences of neighbouring records, which a jump hardly touches (the moving range
of control charts; Montgomery, Introduction to statistical quality control). A jump is looked for at every place, by the generalised
likelihood ratio of two means with known variances (Basseville and Nikiforov, Detection of abrupt changes, 1993); the largest ratio is
held against its distribution over drawn courses without a jump. Each side of a jump is searched again (binary segmentation).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from greybox.base.errors import DataError
from greybox.base.findings import Finding, Severity
from greybox.base.numerics import MEDIAN_OF_RANGE
from greybox.data.experiment import Experiment
from greybox.estimation.result import Fit
from greybox.extensions.changes.constants import FittedConstants, read_constants, read_residual
from greybox.extensions.changes.detect import (
    ADEQUATE_RATIO,
    CHANGE_TEST_FALSE_ALARM_RATE,
    LARGEST_HIDDEN_CHANGE,
    check_reference,
    refit,
)
from greybox.extensions.changes.findings import ChangeCode
from greybox.extensions.changes.result import ChangeDetection, ChangePoint, ChangeVerdict, ChartedRecord

# Fewer show no course.
LEAST_RECORDS = 4


def chart_changes(reference: Fit, records: Sequence[Experiment]) -> ChangeDetection:
    """Follow the constants of a machine over records in the order of time, and find where they jump.

    Parameters
    ----------
    reference
        The fit of the machine as it was: the first point of the course.
    records
        One record for each point, in the order of time.

    Returns
    -------
    ChangeDetection
        ``changed`` where a constant jumps, with ``records`` and ``change_points``.

    Raises
    ------
    DataError
        For fewer records than a course needs.

    Examples
    --------
    >>> gb.change_detection.chart_changes(fit, days).change_points[0].record  # doctest: +SKIP
    'day 12'
    """
    began = time.perf_counter()
    check_reference(reference)
    noun = "record" if len(records) == 1 else "records"
    if len(records) < LEAST_RECORDS:
        raise DataError(
            f"{len(records)} {noun}: a chart needs {LEAST_RECORDS} at least; give more, or leave out --chart"
        )
    labels = ["the fit", *(record.name for record in records)]
    fits = [reference, *(refit(reference, [record]) for record in records)]
    points = [read_constants(f, read_residual(f, ADEQUATE_RATIO)) if f.success else None for f in fits]
    assert points[0] is not None
    names = points[0].names
    changes, unseen = [], []
    for name in names:
        places = [t for t, c in enumerate(points) if c is not None and _is_known(c, name)]
        if len(places) < LEAST_RECORDS:
            unseen.append(name)
            continue
        changes += _find_jumps(name, places, points, labels, len(names))
    changes.sort(key=lambda c: (c.number, c.constant))
    verdict = ChangeVerdict.CHANGED if changes else ChangeVerdict.CANNOT_TELL if unseen else ChangeVerdict.UNCHANGED
    conclusion = [
        Finding(
            ChangeCode.CHANGE_POINT,
            Severity.WARNING,
            c.constant,
            {"record": c.record, "number": c.number, "before": c.before, "after": c.after, "unit": c.unit, "p": c.p},
        )
        for c in changes
    ] or [Finding(ChangeCode.NO_CHANGE_POINT, values={"records": len(records)})]
    values = {"share": None, "limit": LARGEST_HIDDEN_CHANGE}
    findings = [Finding(ChangeCode.CONSTANT_NOT_SEEN, Severity.WARNING, name, values) for name in unseen]
    findings += [
        Finding(ChangeCode.RECORD_NOT_FITTED, Severity.WARNING, label, {"status": f.solver.status_message})
        for label, f in zip(labels, fits, strict=True)
        if not f.success
    ]
    charted = [ChartedRecord(label, _estimates(f, names), f.status) for label, f in zip(labels, fits, strict=True)]
    return ChangeDetection(
        verdict,
        reference,
        conclusion=tuple(conclusion),
        findings=tuple(findings),
        records=charted,
        change_points=changes,
        seconds=time.perf_counter() - began,
    )


def estimate_wandering(values: np.ndarray, variances: np.ndarray) -> np.ndarray:
    """Variance (...) from record to record beyond the ``variances`` (n,), of one or several courses (..., n)."""
    ranges = np.median(np.abs(np.diff(values, axis=-1)) / np.sqrt((variances[1:] + variances[:-1]) / 2), axis=-1)
    excess = np.square(ranges / MEDIAN_OF_RANGE) - 1
    return np.maximum(excess, 0.0) * float(np.median(variances))


def compute_jump_ratios(values: np.ndarray, variances: np.ndarray, least: int) -> np.ndarray:
    """For each place (..., n - 2 least + 1) the squared difference of the means before and after, over its variance.

    ``values`` and ``variances`` are (..., n); the first place lies behind the first ``least`` values.
    """
    weights = 1 / variances
    sums, totals = np.cumsum(weights * values, axis=-1), np.cumsum(weights, axis=-1)
    last = values.shape[-1] - least
    before, after = sums[..., least - 1 : last], sums[..., -1:] - sums[..., least - 1 : last]
    weight_before = totals[..., least - 1 : last]
    weight_after = totals[..., -1:] - weight_before
    return np.square(after / weight_after - before / weight_before) / (1 / weight_before + 1 / weight_after)


# Records in a stretch between change points at least: today's record alone may be the first after a change.
LEAST_STRETCH = 1


def find_change_points(values: np.ndarray, variances: np.ndarray, level: float) -> list[tuple[int, float]]:
    """Places at which a course (n,) jumps, each with its p-value: the number of the first value after it."""
    jumps: list[tuple[int, float]] = []
    wandering = float(estimate_wandering(values, variances))
    pending = [(0, len(values))]
    while pending:
        first, end = pending.pop()
        if end - first < 2 * LEAST_STRETCH + 1:
            continue
        part, known = values[first:end], variances[first:end]
        ratios = compute_jump_ratios(part, known + wandering, LEAST_STRETCH)
        place = int(np.argmax(ratios)) + LEAST_STRETCH
        p = _chance_of_jump(float(ratios.max()), known, wandering, len(values))
        if p < level:
            jumps.append((first + place, p))
            pending += [(first, first + place), (first + place, end)]
    return sorted(jumps)


# Courses without a change that are drawn for the distribution of the largest jump.
CHART_DRAWS = 4000
# Of these draws.
CHART_SEED = 0


def _chance_of_jump(largest: float, variances: np.ndarray, wandering: float, length: int) -> float:
    """How often a course without a jump shows a ratio as large somewhere, its wandering estimated as in the course at hand."""
    generator = np.random.default_rng(CHART_SEED)
    drawn = generator.standard_normal((CHART_DRAWS, len(variances))) * np.sqrt(variances + wandering)
    again = estimate_wandering(drawn, variances) if len(variances) == length else np.full(CHART_DRAWS, wandering)
    ratios = compute_jump_ratios(drawn, variances + again[:, None], LEAST_STRETCH).max(axis=-1)
    return (1 + int((ratios >= largest).sum())) / (1 + CHART_DRAWS)


def _find_jumps(
    name: str,
    places: Sequence[int],
    points: Sequence[FittedConstants | None],
    labels: Sequence[str],
    comparisons: int,
) -> list[ChangePoint]:
    known = [c for t in places if (c := points[t]) is not None]
    positions = [c.names.index(name) for c in known]
    positive = all(c.positive[k] for c, k in zip(known, positions, strict=True))
    raw = np.array([c.values[k] for c, k in zip(known, positions, strict=True)])
    std = np.sqrt([c.variances[k] for c, k in zip(known, positions, strict=True)])
    if not positive:
        std = std * np.array([v if c.positive[k] else 1.0 for c, k, v in zip(known, positions, raw, strict=True)])
    values, variances = (np.log(raw) if positive else raw), std**2
    jumps = find_change_points(values, variances, CHANGE_TEST_FALSE_ALARM_RATE / comparisons)
    edges = [0, *(place for place, _ in jumps), len(values)]
    back = math.exp if positive else float
    means = [back(float(np.average(values[a:b], weights=1 / variances[a:b]))) for a, b in pairwise(edges)]
    unit = known[0].units[positions[0]]
    return [
        ChangePoint(name, unit, labels[places[at]], places[at], means[k], means[k + 1], min(1.0, p * comparisons))
        for k, (at, p) in enumerate(jumps)
    ]


def _is_known(constants: FittedConstants, name: str) -> bool:
    return name in constants.names and math.isfinite(constants.variances[constants.names.index(name)])


def _estimates(fit: Fit, names: Sequence[str]) -> dict[str, tuple[float, tuple[float, float] | None]]:
    return {
        name: (fit.parameters[name].value, fit.parameters[name].interval) for name in names if name in fit.parameters
    }
