"""What an exchange of constants does to a fit: the intervals of constants that may change places, and what is said of it.

Where two constants that may change places are nearly equal the slope along their difference vanishes, and the second order determines it:
neither the curvature at the optimum nor "not determined" is right. There the intervals are those of the profile likelihood, and the
covariance of everything else is taken beside the optimum, where the slope has come back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base import Finding, Severity
from greybox.estimation.covariance import ParameterCovariance, compute_interval, compute_quantile
from greybox.estimation.findings import EstimationCode
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from greybox.estimation.identifiability.twins import (
    Twin,
    describe_twins,
    find_other_answers,
    find_twins,
    group_twins,
    settle,
)
from greybox.estimation.objective import SimulationErrorObjective
from greybox.estimation.optimum import SimulationOptimum
from greybox.estimation.options import FitOptions
from greybox.estimation.profiles import ProfileSearch, RiseScale, estimate_covariance_at, scale_simulation_error
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimates
from greybox.estimation.transcription.decision_vector import DecisionVector


@dataclass(frozen=True, eq=False)
class Exchange:
    """The ``optimum`` with the covariance beside it where constants that change places are near one another, the ``intervals`` of these,
    and what is to be said.
    """

    optimum: SimulationOptimum
    intervals: Mapping[str, tuple[float, float]]
    findings: tuple[Finding, ...]

    def complete(self, fit: Fit) -> Fit:
        """``fit`` of the optimum with these intervals and findings."""
        half = 2 * compute_quantile(self.optimum.covariance.degrees)
        estimates = {
            # A deviation that stands for the interval: the likelihood is no parabola here.
            name: replace(fit.parameters[name], interval=(low, high), std=(high - low) / half)
            for name, (low, high) in self.intervals.items()
        }
        parameters = Estimates({**fit.parameters, **estimates})
        # Beside the optimum of one of three that are equal the other two still are: open by their slopes alone, as all were.
        rest = [f for f in fit.findings if not self._is_of_equals(f)]
        return replace(fit, parameters=parameters, findings=(*self.findings, *rest))

    def _is_of_equals(self, finding: Finding) -> bool:
        is_direction = finding.code is EstimationCode.DIRECTION_UNDETERMINED
        return is_direction and set(finding.values["direction"]) <= set(self.intervals)


# Half the distance to a twin in standard deviations up to which the cost is no parabola: below four the interval holds the twin, and at
# eight that by the curvature ends a sixth of its half too near.
TWIN_REACH = 8.0
# What the cost at a twin may exceed that of the optimum by, over the variance of the residual: what the search has left over.
AS_GOOD = 0.01
# Change of the unit in which the cost rises, beside the optimum, from which the profile is followed anew: colour shows there alone.
UNIT_CHANGE = 0.1


def find_exchange(optimum: SimulationOptimum, options: FitOptions) -> Exchange | None:
    """What constants of ``optimum`` that may change places mean for it; None where none may."""
    solution = optimum.solution
    if (
        not (optimum.status.success and np.isfinite(optimum.evaluation.cost) and solution.is_free_run())
        or solution.joined
    ):
        return None
    objective = optimum.objective
    v, everything = objective.variables, range(len(objective.variables.which))
    unit = max(
        optimum.evaluation.cost / max(optimum.evaluation.count - v.size, 1), float(objective.problem.noise.known)
    )
    twins = []
    for twin in find_twins(objective.problem, optimum.runs):
        twin_variables = v.with_values(twin.values)
        # Constants that are held have lost their priors, which may have decided.
        cost = settle(objective.problem, twin_variables.base, everything).cost + twin_variables.penalty(v.here)[0]
        if cost <= optimum.evaluation.cost + AS_GOOD * unit:
            twins.append(twin)
    near = [twin for twin in twins if _measure_distance(optimum.covariance, v, twin) < TWIN_REACH]
    far = [twin for twin in twins if twin not in near]
    intervals, beside = _follow_profiles(objective, near, options) if near else ({}, None)
    # Of constants that are told to be near one another it is said there.
    findings = find_other_answers([twin for twin in far if not {*twin.values} & {*intervals}])
    if beside is not None:
        optimum = replace(optimum, beside=beside)
        findings += [_find_sums(optimum, group, intervals) for group in group_twins(near)]
    return Exchange(optimum, intervals, tuple(findings)) if findings else None


def _measure_distance(covariance: ParameterCovariance, v: DecisionVector, twin: Twin) -> float:
    """Half the way to a twin in the standard deviations that the curvature tells, of the constant that goes farthest."""
    places = [v.names.index(name) for name in twin.values]
    way = np.array(list(twin.values.values())) - v.base[places]
    # Where the curvature tells none the twin is here.
    deviations = np.sqrt(np.diag(covariance.covariance)[places])
    return float(np.max(np.abs(way) / np.where(deviations > 0, deviations, np.inf))) / 2


def _follow_profiles(
    objective: SimulationErrorObjective, twins: Sequence[Twin], options: FitOptions
) -> tuple[dict[str, tuple[float, float]], ParameterCovariance | None]:
    """The profile intervals of the constants of ``twins``, and the covariance where the first of them ends; none where it never does."""
    v = objective.variables
    near = replace(options, progressive=False)
    intervals: dict[str, tuple[float, float]] = {}
    beside = None
    for name in dict.fromkeys(name for twin in twins for name in twin.values):
        k = v.names.index(name)
        # Two that change places share their values, where these are not told apart.
        partners = [a if b == name else b for twin in twins for a, b in twin.pairs if name in (a, b)]
        shared = [n for n in partners if n in intervals and intervals[n][0] <= v.base[k] <= intervals[n][1]]
        if shared:
            intervals[name] = intervals[shared[0]]
            continue
        scale = scale_simulation_error(objective, k)
        interval, ends = _follow(objective, k, scale, near)
        if not ends:
            continue
        other = _stand_at(objective, k, ends[-1], scale, near)
        changed = replace(scale, unit=scale_simulation_error(other, k).unit)
        if abs(changed.unit / scale.unit - 1) > UNIT_CHANGE:
            interval, ends = _follow(objective, k, changed, near)
        if ends:
            beside = beside or estimate_covariance_at(_stand_at(objective, k, ends[-1], changed, near))
            intervals[name] = interval
    return intervals, beside


def _follow(
    objective: SimulationErrorObjective, k: int, scale: RiseScale, options: FitOptions
) -> tuple[tuple[float, float], list[float]]:
    """The interval of one constant, and those of its ends where the cost has risen to the threshold."""
    search, v = ProfileSearch.of(objective, k, scale, options), objective.variables
    sides = [search.follow(bound, sign, farther=False) for bound, sign in ((v.low[k], -1), (v.high[k], 1))]
    ends = [end for end, points in sides if any(rise > scale.threshold for _, rise in points)]
    return (sides[0][0], sides[1][0]), ends


def _stand_at(
    objective: SimulationErrorObjective, k: int, value: float, scale: RiseScale, options: FitOptions
) -> SimulationErrorObjective:
    """The cost with one constant at ``value`` and the others where they are then."""
    v = objective.variables
    _, others = ProfileSearch.of(objective, k, scale, options).rise(value, None)
    values = {**dict(zip(others.names, others.base.tolist(), strict=True)), v.names[k]: value}
    return objective.at(replace(v.with_values(values), initial=others.initial))


def _find_sums(
    optimum: SimulationOptimum, group: Sequence[Twin], intervals: Mapping[str, tuple[float, float]]
) -> Finding:
    """Constants that change places within their intervals, and the sums of them, which the records tell better."""
    v, covariance = optimum.variables, optimum.covariance
    described = describe_twins(group)
    exchanged = described["exchanged"] or list(described["values"])
    sums = []
    for unit in dict.fromkeys(v.quantities[v.names.index(name)].unit for name in exchanged):
        places = [v.names.index(name) for name in exchanged if v.quantities[v.names.index(name)].unit == unit]
        if len(places) > 1:
            value = float(v.base[places].sum())
            # var(a + b) = sum of all their covariances
            variance = float(covariance.covariance[np.ix_(places, places)].sum())
            if np.isfinite(variance) and variance > 0:
                std = float(np.sqrt(variance))
                reach, bounds = compute_quantile(covariance.degrees) * std, (-np.inf, np.inf)
                ends = compute_interval(value, reach, bool(v.logarithmic[places].all()), bounds)
                names = [v.names[k] for k in places]
                sums.append({"constants": names, "value": value, "std": std, "interval": list(ends), "unit": unit})
    pairs = [pair for twin in group for pair in twin.pairs if {*pair} <= {*intervals}]
    equal = bool(pairs) and all(
        intervals[a][0] <= v.base[v.names.index(b)] <= intervals[a][1]
        for one, two in pairs
        for a, b in ((one, two), (two, one))
    )
    values = {
        **described,
        "equal": equal,
        "intervals": {n: list(i) for n, i in intervals.items() if n in described["units"]},
        "sums": sums,
    }
    return Finding(IdentifiabilityCode.EXCHANGEABLE, Severity.NOTE, "", values)
