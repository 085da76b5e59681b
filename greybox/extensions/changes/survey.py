"""Surveys: machines of one kind, and which of them fall out; one machine over many records, and when it has changed.

`survey_population`: each machine's constants are estimated from its own records; the estimates scatter by what the records leave open,
and by what differs from one machine to the next. The spread of the latter is that of a random-effects model (Paule and Mandel, J. Res.
NBS 87, 1982). A machine is judged by its distance from the others, with their mean and spread found without it; several that fall out are
looked for as Rosner's generalised extreme deviate does (Technometrics 25, 1983): removed one by one, the farthest first, and the last
clear step decides, so that two cannot hide each other. `chart_changes` stands below.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtr, stdtr, stdtrit

from greybox.base.errors import DataError
from greybox.base.numerics import BISECTIONS, MEDIAN_OF_RANGE, NEARLY_NORMAL, TINY
from greybox.base.values import Finding, Severity
from greybox.data.experiment import Experiment
from greybox.estimation.result import Fit
from greybox.extensions.changes import detect
from greybox.extensions.changes.constants import FittedConstants, read_constants
from greybox.extensions.changes.result import (
    ChangeCode,
    ChangeDetection,
    ChangePoint,
    ChangeVerdict,
    ChartedRecord,
    MachineConstant,
    MachineReport,
    PopulationConstant,
)


def _is_known(constants: FittedConstants, name: str) -> bool:
    return name in constants.names and math.isfinite(constants.variances[constants.names.index(name)])


def _to_one_scale(known: Sequence[FittedConstants], name: str) -> tuple[np.ndarray, np.ndarray, bool, str]:
    """Estimates and variances (n,) of one constant, of its logarithm where all are positive; whether they are, and the unit."""
    places = [c.names.index(name) for c in known]
    positive = all(c.positive[k] for c, k in zip(known, places, strict=True))
    values = np.array([c.values[k] for c, k in zip(known, places, strict=True)])
    std = np.sqrt([c.variances[k] for c, k in zip(known, places, strict=True)])
    unit = known[0].units[places[0]]
    if positive:
        return np.log(values), std**2, True, unit
    # d value = value d ln(value): those that were compared by their logarithm go back.
    back = np.array([v if c.positive[k] else 1.0 for c, k, v in zip(known, places, values, strict=True)])
    return values, (std * back) ** 2, False, unit


# Fewer say nothing of a spread.
LEAST_MACHINES = 4


def survey_population(reference: Fit, machines: Mapping[str, Sequence[Experiment]]) -> ChangeDetection:
    """Compare machines of one kind with one another.

    Parameters
    ----------
    reference
        A fit of one of them: it says which model, options and noise, and where the search begins. It is not judged itself.
    machines
        Name of each machine -> its records.

    Returns
    -------
    ChangeDetection
        ``changed`` where a machine falls out, with ``population`` and ``machines``.

    Raises
    ------
    DataError
        For fewer machines than a spread needs.

    Examples
    --------
    >>> gb.changes.survey_population(fit, {"A": [a], "B": [b], "C": [c], "D": [d]}).machines  # doctest: +SKIP
    """
    began = time.perf_counter()
    detect.check_reference(reference)
    noun = "machine" if len(machines) == 1 else "machines"
    if len(machines) < LEAST_MACHINES:
        raise DataError(
            f"{len(machines)} {noun}: a population needs {LEAST_MACHINES} at least; give more, or leave out --population"
        )
    fits = {name: detect.refit(reference, records) for name, records in machines.items()}
    estimates = {name: read_constants(fit) for name, fit in fits.items() if fit.success}
    findings = [
        Finding(ChangeCode.MACHINE_NOT_FITTED, Severity.WARNING, name, {"status": fit.solver.status_message})
        for name, fit in fits.items()
        if not fit.success
    ]
    names = read_constants(reference).names
    each = {name: _survey_constant(name, estimates, comparisons=len(names)) for name in names}
    surveys = {name: survey for name, survey in each.items() if survey is not None}
    not_seen = {"share": None, "limit": detect.LARGEST_HIDDEN_CHANGE}
    findings += [Finding(ChangeCode.CONSTANT_NOT_SEEN, Severity.NOTE, n, not_seen) for n in names if n not in surveys]
    reports = [_report(machine, surveys, estimates) for machine in machines]
    outside = [report for report in reports if report.outlying]
    verdict = ChangeVerdict.CHANGED if outside else ChangeVerdict.UNCHANGED if surveys else ChangeVerdict.CANNOT_TELL
    population = {name: survey.common for name, survey in surveys.items()}
    return ChangeDetection(
        verdict,
        reference,
        conclusion=tuple(_conclude(outside, reports, population)),
        findings=tuple(findings),
        machines=reports,
        population=population,
        seconds=time.perf_counter() - began,
    )


@dataclass(frozen=True, eq=False)
class RandomEffects:
    """A mean with its variance, and the variance ``spread`` from one machine to the next, of estimates with known variances."""

    mean: float
    variance: float
    spread: float

    @classmethod
    def of(cls, values: np.ndarray, variances: np.ndarray) -> RandomEffects:
        """By Paule and Mandel: the spread at which the weighted squares about the mean are as many as their degrees of freedom."""

        def weigh(spread: float) -> tuple[float, float, float]:
            # w_i = 1 / (v_i + s^2), mean = sum w x / sum w
            weights = 1 / (variances + spread)
            mean = float(weights @ values / weights.sum())
            return mean, float(weights @ (values - mean) ** 2), float(1 / weights.sum())

        low, high = 0.0, max(float(np.var(values, ddof=1)) * len(values), TINY) if len(values) > 1 else 0.0
        # sum w (x - mean)^2 falls with the spread and is n - 1 at the right one: bisection; no spread where it is less without any.
        if len(values) > 1 and weigh(0.0)[1] > len(values) - 1:
            for _ in range(BISECTIONS):
                middle = (low + high) / 2
                low, high = (middle, high) if weigh(middle)[1] > len(values) - 1 else (low, middle)
        else:
            high = 0.0
        mean, _, variance = weigh(high)
        return cls(mean, variance, high)


@dataclass(frozen=True, eq=False)
class _ConstantSurvey:
    """One constant over the machines: what is common, the p-value of each machine, and which fall out."""

    common: PopulationConstant
    p: Mapping[str, float]
    outlying: tuple[str, ...]


# Share of the machines that may fall out; where more would, there is no kind to fall out of.
LARGEST_OUTLYING_SHARE = 0.34


def _survey_constant(name: str, estimates: Mapping[str, FittedConstants], comparisons: int) -> _ConstantSurvey | None:
    known = {machine: c for machine, c in estimates.items() if _is_known(c, name)}
    if len(known) < LEAST_MACHINES:
        return None
    machines = list(known)
    values, variances, positive, unit = _to_one_scale(list(known.values()), name)
    level = detect.CHANGE_TEST_FALSE_ALARM_RATE / comparisons
    # Those that fall out are no part of what the kind has in common.
    outside = find_outliers(values, variances, level, LARGEST_OUTLYING_SHARE)
    inside = np.setdiff1d(np.arange(len(values)), outside)
    common = RandomEffects.of(values[inside], variances[inside])
    p = {}
    for k, machine in enumerate(machines):
        others = inside[inside != k]
        # Bonferroni: every machine is looked at in every constant.
        looks = len(values) * comparisons
        p[machine] = min(1.0, looks * deleted_p_value(values[k], variances[k], values[others], variances[others]))
    # 95 % of the mean, by as many machines as told it.
    reach = float(stdtrit(max(len(inside) - 1, 1), 0.975)) * math.sqrt(common.variance)
    back = math.exp if positive else float
    interval = (back(common.mean - reach), back(common.mean + reach))
    constant = PopulationConstant(back(common.mean), interval, unit, math.sqrt(common.spread), positive)
    return _ConstantSurvey(constant, p, tuple(machines[k] for k in outside))


def deleted_p_value(value: float, variance: float, others: np.ndarray, of_others: np.ndarray) -> float:
    """How often a machine of the kind of the ``others`` lies as far from their mean as ``value``, which is not among them."""
    common = RandomEffects.of(others, of_others)
    # The machine itself, the spread of its kind, and what is not known of their mean.
    total = variance + common.spread + common.variance
    distance = abs(value - common.mean) / math.sqrt(total)
    # Student's where the spread rules, which so many machines have told; normal where it is the records' own uncertainty.
    share = common.spread / total
    degrees = (len(others) - 1) / share**2 if share > 0 else math.inf
    return 2 * float(stdtr(degrees, -distance) if degrees < NEARLY_NORMAL else ndtr(-distance))


def find_outliers(values: np.ndarray, variances: np.ndarray, level: float, largest_share: float) -> np.ndarray:
    """Places of the machines that fall out, at a rate ``level`` of false alarms over all of them."""
    left, removed, clear = list(range(len(values))), list[int](), 0
    for _ in range(int(largest_share * len(values))):
        p = []
        for k in left:
            others = [i for i in left if i != k]
            p.append(deleted_p_value(values[k], variances[k], values[others], variances[others]))
        farthest = int(np.argmin(p))
        # Of all that are left the farthest was chosen.
        significant = p[farthest] * len(left) < level
        removed.append(left.pop(farthest))
        clear = len(removed) if significant else clear
    return np.array(sorted(removed[:clear]), int)


def _report(
    machine: str, surveys: Mapping[str, _ConstantSurvey], estimates: Mapping[str, FittedConstants]
) -> MachineReport:
    constants: dict[str, MachineConstant] = {}
    fitted = estimates.get(machine)
    for name, survey in surveys.items():
        if fitted is None or machine not in survey.p:
            constants[name] = {"value": None, "std": None, "unit": survey.common.unit, "p": None}
            continue
        k = fitted.names.index(name)
        value = float(fitted.values[k])
        # d p = p d ln p, back into the unit.
        std = math.sqrt(fitted.variances[k]) * (value if fitted.positive[k] else 1.0)
        constants[name] = {"value": value, "std": std, "unit": survey.common.unit, "p": survey.p[machine]}
    return MachineReport(machine, constants, tuple(n for n, s in surveys.items() if machine in s.outlying))


def _conclude(
    outside: Sequence[MachineReport], reports: Sequence[MachineReport], population: Mapping[str, PopulationConstant]
) -> list[Finding]:
    if not population:
        return [Finding(ChangeCode.CANNOT_TELL, Severity.WARNING, values={"constants": []})]
    findings = []
    for report in outside:
        for name in report.outlying:
            common, constant = population[name], report.constants[name]
            of_kind = {"unit": common.unit, "mean": common.mean, "spread": common.spread, "relative": common.relative}
            values = {"constant": name, "value": constant["value"], "p": constant["p"], **of_kind}
            findings.append(Finding(ChangeCode.MACHINE_FALLS_OUT, Severity.WARNING, report.name, values))
    spreads = {name: [c.spread, c.unit, c.relative] for name, c in population.items()}
    values = {"machines": len(reports) - len(outside), "outside": len(outside), "spreads": spreads}
    return [*findings, Finding(ChangeCode.MACHINES_ALIKE, values=values)]


# `chart_changes`: one machine over many records, and between which of them its constants have jumped.
#
# Each record gives an estimate of every constant with its variance. A machine may wander a little from day to day beyond that
# (temperature, mounting): that variance comes from the differences of neighbouring records, which a jump hardly touches (the moving range
# of control charts; Montgomery, Introduction to statistical quality control). A jump is looked for at every place, by the generalised
# likelihood ratio of two means with known variances (Basseville and Nikiforov, Detection of abrupt changes, 1993); the largest ratio is
# held against its distribution over drawn courses without a jump. Each side of a jump is searched again (binary segmentation).

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
    >>> gb.changes.chart_changes(fit, days).change_points[0].record  # doctest: +SKIP
    'day 12'
    """
    began = time.perf_counter()
    detect.check_reference(reference)
    noun = "record" if len(records) == 1 else "records"
    if len(records) < LEAST_RECORDS:
        raise DataError(
            f"{len(records)} {noun}: a chart needs {LEAST_RECORDS} at least; give more, or leave out --chart"
        )
    labels = ["the fit", *(record.name for record in records)]
    fits = [reference, *(detect.refit(reference, [record]) for record in records)]
    points = [read_constants(f) if f.success else None for f in fits]
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
    values = {"share": None, "limit": detect.LARGEST_HIDDEN_CHANGE}
    findings = [Finding(ChangeCode.CONSTANT_NOT_SEEN, Severity.WARNING, name, values) for name in unseen]
    findings += [
        Finding(ChangeCode.RECORD_NOT_FITTED, Severity.WARNING, label, {"status": f.solver.status_message})
        for label, f in zip(labels, fits, strict=True)
        if not f.success
    ]
    charted = [
        ChartedRecord(t, {n: (e.value, e.interval) for n in names if (e := f.parameters.get(n))}, f.status)
        for t, f in zip(labels, fits, strict=True)
    ]
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
    # |x_k - x_(k-1)| over its deviation, of which the median is known: a jump touches one of them.
    ranges = np.median(np.abs(np.diff(values, axis=-1)) / np.sqrt((variances[1:] + variances[:-1]) / 2), axis=-1)
    # What the scatter has beyond the variances of the records, as a variance.
    excess = np.square(ranges / MEDIAN_OF_RANGE) - 1
    return np.maximum(excess, 0.0) * float(np.median(variances))


def compute_jump_ratios(values: np.ndarray, variances: np.ndarray, least: int) -> np.ndarray:
    """For each place (..., n - 2 least + 1) the squared difference of the means before and after, over its variance.

    ``values`` and ``variances`` are (..., n); the first place lies behind the first ``least`` values.
    """
    # Means of both sides from running sums, at every place at once.
    weights = 1 / variances
    sums, totals = np.cumsum(weights * values, axis=-1), np.cumsum(weights, axis=-1)
    last = values.shape[-1] - least
    before, after = sums[..., least - 1 : last], sums[..., -1:] - sums[..., least - 1 : last]
    weight_before = totals[..., least - 1 : last]
    weight_after = totals[..., -1:] - weight_before
    # (mean_after - mean_before)^2 over the sum of both variances: twice the logarithm of the likelihood ratio.
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
        # Each side of a jump is searched again (binary segmentation).
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
    # Courses with the variances at hand and no jump.
    drawn = generator.standard_normal((CHART_DRAWS, len(variances))) * np.sqrt(variances + wandering)
    # In a part of the course the wandering stays that of the whole, here as there.
    again = estimate_wandering(drawn, variances) if len(variances) == length else np.full(CHART_DRAWS, wandering)
    ratios = compute_jump_ratios(drawn, variances + again[:, None], LEAST_STRETCH).max(axis=-1)
    # The course at hand counts as one of them, so that no p-value is zero.
    return (1 + int((ratios >= largest).sum())) / (1 + CHART_DRAWS)


def _find_jumps(
    name: str, places: Sequence[int], points: Sequence[FittedConstants | None], labels: Sequence[str], comparisons: int
) -> list[ChangePoint]:
    known = [c for t in places if (c := points[t]) is not None]
    values, variances, positive, unit = _to_one_scale(known, name)
    # The rate of false alarms is shared by the constants.
    jumps = find_change_points(values, variances, detect.CHANGE_TEST_FALSE_ALARM_RATE / comparisons)
    edges = [0, *(place for place, _ in jumps), len(values)]
    back = math.exp if positive else float
    # Between two jumps the mean of the records, each weighed by its information.
    means = [back(float(np.average(values[a:b], weights=1 / variances[a:b]))) for a, b in pairwise(edges)]
    return [
        ChangePoint(name, unit, labels[places[at]], places[at], means[k], means[k + 1], min(1.0, p * comparisons))
        for k, (at, p) in enumerate(jumps)
    ]
