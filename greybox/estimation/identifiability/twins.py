"""Twins: other values of the constants with which a model answers every input as before, such as two lags in a row that change places.

A twin is no open direction. Each constant is determined, up to a finite choice that no record of these outputs makes.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from greybox.base import Finding, Severity, parse_unit
from greybox.base.linear_algebra import COLUMN_RANK, decompose_columns
from greybox.base.values import ReadOnly
from greybox.estimation.covariance import decompose_information
from greybox.estimation.identifiability.combinations import find_closing_sets
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from greybox.estimation.identifiability.structural import find_unmeasured_states
from greybox.estimation.identifiability.transfer_functions import PolynomialValues, transfer_function_coefficients
from greybox.estimation.objective import (
    LIKELIHOOD_LAST_DIGITS,
    SimulationErrorObjective,
    hold_parameters,
    refine_minimum,
)
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem, Runs
from greybox.model import System


@dataclass(frozen=True)
class Twin(ReadOnly):
    """Other values of the constants that make the same run.

    Attributes
    ----------
    values
        The constants whose values differ, with those they have there.
    pairs
        Which of them change places.
    units
        Their units.
    told_by
        States without an output that run otherwise there: a sensor for one of them decides.
    """

    values: Mapping[str, float]
    pairs: tuple[tuple[str, str], ...]
    units: Mapping[str, str]
    told_by: tuple[str, ...] = ()

    @property
    def others(self) -> tuple[str, ...]:
        """The constants that move along with those that change places."""
        return tuple(name for name in self.values if not any(name in pair for pair in self.pairs))


# Least factor between two constants where it is asked whether they may change places: any model allows it to two that are equal.
TWIN_SPREAD = 1.4
# Share of what half an exchange does to a run (squared) that a whole one may leave of it: rounding, and the integration step.
TWIN_RUN = 1e-6


def find_twins(problem: EstimationProblem, runs: Runs | None = None) -> tuple[Twin, ...]:
    """The twins of the present values, within the bounds, of a model whose runs are free ones over the records of ``problem``: those of
    the present values are ``runs``, where they are known.

    Of a linear model they are the other roots of the coefficients of its transfer functions. Of any other one constants of one unit are
    tried in each other's place, and negative values in the place of positive ones; a run over the records says whether they are twins. Of
    two constants that are nearly equal this is asked where they are not.
    """
    v = problem.variables
    if not len(v.which) or (v.owner != SHARED).any() or not problem.model.has_equations or problem.model.noisy_states:
        return ()
    alike, system, records = list_alike(v), problem.model.system, problem.records
    measured = np.any([np.isfinite(r.y).any(axis=0) for r in records], axis=0)
    coefficients = _polynomials(system, tuple(np.flatnonzero(measured).tolist()), not v.initial.free.any())
    if not coefficients and not list_changes(v, alike):
        return ()
    base = spread_alike(v.base, alike)
    spread = v.with_values(dict(zip(v.names, base.tolist(), strict=True)))
    apart = _own_run(problem, spread, runs if base is v.base else None)
    if not all(np.isfinite(y).any() for y in (r.y for r in apart.records)):
        return ()
    roots = find_roots(coefficients, apart.variables, alike) if coefficients else _try_exchanges(apart, alike)
    everything, twins, is_open = list(range(len(base))), list[Twin](), None
    for root in roots:
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(base == 0, 1.0, root / base)
        moved = [k for k in everything if abs(factors[k] - 1) > SAME_ROOT]
        # Where the others brought the run back to these values, or had none that are finite, there is no other answer.
        if not (moved and np.isfinite(root).all()):
            continue
        pairs = [(i, j) for i, j in alike if np.allclose(root[[i, j]], base[[j, i]], rtol=SAME_ROOT, atol=0.0)]
        # Where a direction is open the twin is one of many answers: nothing is a choice but what it does not touch.
        if (is_open := _find_open(apart) if is_open is None else is_open)[moved].any():
            continue
        half = base.copy()
        # A constant that moves alone is there already: half way it is not.
        half[moved[:1]] = root[moved[:1]] if len(moved) > 1 else (base[moved] + root[moved]) / 2
        settled = settle(apart, root, everything)
        # What is left of the difference, over what one of the constants alone makes of it.
        if not settled.cost <= TWIN_RUN * settle(apart, half, everything).cost:
            continue
        values = v.base * factors
        for i, j in pairs:
            values[[i, j]] = v.base[[j, i]]
        if base is not v.base:
            values = settle(_own_run(problem, v), values, [k for pair in pairs for k in pair]).values
        if (values >= v.low).all() and (values <= v.high).all():
            twins.append(
                Twin(
                    {v.names[k]: float(values[k]) for k in moved},
                    tuple((v.names[i], v.names[j]) for i, j in pairs),
                    {v.names[k]: v.quantities[k].unit for k in moved},
                    tuple(_list_other_states(apart, settled.variables)),
                )
            )
    return tuple(twins)


def _find_open(problem: EstimationProblem) -> np.ndarray:
    """Which constants (nf,) an open direction touches."""
    v = problem.variables
    return decompose_information(v, problem.shooting(v).evaluate(v.here).hessian / 2).is_open


# Share of its movement by which a state must run otherwise for a sensor to show it.
OTHER_RUN = 1e-3


def _list_other_states(problem: EstimationProblem, twin: DecisionVector) -> list[str]:
    """States without an output that run otherwise at a twin."""
    runs, twin_runs = (problem.shooting(v).simulate(v.here) for v in (problem.variables, twin))
    names, different = problem.model.system.state_names, set[str]()
    for (_, x), (_, other) in zip(runs, twin_runs, strict=True):
        moved = np.abs(x - other).max(axis=0) > OTHER_RUN * np.abs(x).max(axis=0)
        different |= {names[k] for k in np.flatnonzero(moved)}
    return [name for name in find_unmeasured_states(problem.model) if name in different]


def move_apart(problem: EstimationProblem, twins: Sequence[Twin]) -> EstimationProblem:
    """``problem`` itself, or begun where constants that change places in ``twins`` and are nearly equal differ."""
    v = problem.variables
    alike = [(v.names.index(a), v.names.index(b)) for twin in twins for a, b in twin.pairs]
    base = np.clip(spread_alike(v.base, alike), v.low, v.high)
    if np.array_equal(base, v.base):
        return problem
    return replace(problem, variables=v.with_values(dict(zip(v.names, base.tolist(), strict=True))))


def find_other_answers(twins: Sequence[Twin]) -> list[Finding]:
    """What is to be said of twins: one finding for those that touch the same constants."""
    return [
        Finding(IdentifiabilityCode.OTHER_ANSWER, Severity.WARNING, "", describe_twins(group))
        for group in group_twins(twins)
    ]


def group_twins(twins: Sequence[Twin]) -> Iterator[list[Twin]]:
    """Twins that touch the same constants together."""
    left = list(twins)
    while left:
        group = [left.pop(0)]
        names = {*group[0].values}
        while more := [twin for twin in left if names & {*twin.values}]:
            group += more
            names |= {name for twin in more for name in twin.values}
            left = [twin for twin in left if twin not in more]
        yield group


def describe_twins(group: Sequence[Twin]) -> dict[str, Any]:
    """The twins of a group as values of a finding: the one that moves the fewest constants stands for all."""
    simplest = min(group, key=lambda twin: len(twin.values))
    exchanged = list(dict.fromkeys(name for twin in group for pair in twin.pairs for name in pair))
    moved = list(dict.fromkeys(name for twin in group for name in twin.values))
    return {
        "exchanged": exchanged,
        "others": [name for name in moved if name not in exchanged],
        "values": dict(simplest.values),
        "units": dict(simplest.units),
        "count": len(group),
        "told_by": list(simplest.told_by),
        "equal": all(np.isclose(twin.values[a], twin.values[b]) for twin in group for a, b in twin.pairs),
    }


def list_alike(variables: DecisionVector) -> list[tuple[int, int]]:
    """Pairs of free constants of one dimension, neither of them zero: what may change places."""
    units = [parse_unit(q.unit) for q in variables.quantities]
    known = np.flatnonzero(variables.base)
    return [(int(i), int(j)) for i, j in itertools.combinations(known, 2) if units[i] == units[j]]


def spread_alike(base: np.ndarray, alike: list[tuple[int, int]]) -> np.ndarray:
    """``base`` (nf,) itself, or with constants of one dimension that nearly agree moved apart."""
    result = base
    for _ in range(len(base)):
        near = [(i, j) for i, j in alike if 1 / TWIN_SPREAD < abs(result[i] / result[j]) < TWIN_SPREAD]
        if not near:
            break
        i, j = near[0]
        low, high = (i, j) if abs(result[i]) < abs(result[j]) else (j, i)
        result = result.copy()
        # The larger one goes up by more than the limit, so that it passes what lies beside it.
        result[high] *= TWIN_SPREAD**1.1 * abs(result[low] / result[high])
    return result


# Linear models: the other roots of the coefficients of the transfer functions.


@lru_cache(maxsize=32)
def _polynomials(system: System, outputs: tuple[int, ...], at_rest: bool) -> PolynomialValues | None:
    """What the ``outputs`` of a linear system show of its constants, as polynomials; None where there are no such formulas."""
    polynomials = transfer_function_coefficients(system, outputs, at_rest=at_rest) if system.linear else []
    return PolynomialValues.of(polynomials) if polynomials else None


# Roots are searched for from so many random points, within this factor about the present values: a twin farther off lies where no record
# of these constants would have been taken.
RANDOM_STARTS = 24
START_FACTOR = 100.0
# Damped steps from each at most, and the factor that the damping falls and rises by.
ROOT_STEPS = 40
DAMPING_FACTOR = 4.0
# Longest step of the logarithm of a constant.
LONGEST_STEP = 1.5
# Root mean square of the logarithms of the coefficients, over those at the present values, below which it is a root.
ROOT_SIZE = 1e-7
# Share by which two roots differ at most that are one.
SAME_ROOT = 1e-4


def find_roots(
    coefficients: PolynomialValues, variables: DecisionVector, alike: list[tuple[int, int]]
) -> Iterator[np.ndarray]:
    """Other values (nf,) of the free constants with the same coefficients.

    Newton's method with damping (Levenberg and Marquardt) on the logarithms, from all starts at once: constants in each other's place, and
    random ones. Where a direction is open as many constants are held as close it.
    """
    base, which = variables.base, variables.which
    fixed = variables.fixed.copy()
    fixed[which] = base
    target, slope = (part[0] for part in coefficients.at(fixed[None], which))
    moving = np.flatnonzero((np.abs(slope) > 0).any(axis=1) & np.isfinite(slope).all(axis=1) & (target != 0))
    free = np.flatnonzero(base)
    null = decompose_columns(slope[moving][:, free] / target[moving, None], COLUMN_RANK).null_basis
    if null.shape[1]:
        sets = find_closing_sets(null)
        if not sets:
            return
        # Held are those that nothing could change places with.
        paired = {k for pair in alike for k in pair}
        closing = min(sets, key=lambda s: len({int(free[k]) for k in s} & paired))
        free = np.delete(free, closing)
    if not len(free):
        return
    generator = np.random.default_rng(0)
    random = np.tile(base, (RANDOM_STARTS, 1))
    random[:, free] *= np.exp(generator.uniform(-1, 1, (RANDOM_STARTS, len(free))) * np.log(START_FACTOR))
    # Either sign where the bounds hold zero inside.
    signed = free[(variables.low[free] < 0) & (variables.high[free] > 0)]
    random[:, signed] *= generator.choice((-1.0, 1.0), (RANDOM_STARTS, len(signed)))
    starts = [random]
    for i, j in alike:
        swapped = base.copy()
        swapped[[i, j]] = base[[j, i]]
        starts.append(swapped[None])
    for number in signed.tolist():
        flipped = base.copy()
        flipped[number] *= -1
        starts.append(flipped[None])
    points = np.concatenate(starts)

    def residuals(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        whole = np.tile(fixed, (len(at), 1))
        whole[:, which] = at
        values, slopes = (part[:, moving] for part in coefficients.at(whole, which[free]))
        with np.errstate(all="ignore"):
            ratio = values / target[moving]
            # log c / c0, in which products are straight; where the sign differs c / c0 - 1.
            logs = np.where(ratio > 0, np.log(np.abs(ratio)), ratio - 1)
            along = slopes / np.where(ratio > 0, values, target[moving])[:, :, None]
        return logs, along

    def measure(errors: np.ndarray) -> np.ndarray:
        return np.where(np.isfinite(errors).all(axis=1), np.nansum(errors**2, axis=1), np.inf)

    damping = np.ones(len(points))
    errors, slopes = residuals(points)
    cost = measure(errors)
    for _ in range(ROOT_STEPS):
        finite = np.nan_to_num(slopes)
        normal = np.einsum("smi,smj->sij", finite, finite)
        # (J'J + l diag J'J) d = - J'r
        damped = normal + (damping[:, None] * np.einsum("sii->si", normal) + ROOT_SIZE**2)[:, :, None] * np.eye(
            len(free)
        )
        score = np.einsum("smi,sm->si", finite, np.nan_to_num(errors))
        tried = points.copy()
        tried[:, free] *= np.exp(
            np.clip(-np.linalg.solve(damped, score[:, :, None])[:, :, 0], -LONGEST_STEP, LONGEST_STEP)
        )
        at_tried = residuals(tried)
        better = measure(at_tried[0]) < cost
        points[better], errors[better], slopes[better] = tried[better], at_tried[0][better], at_tried[1][better]
        cost = measure(errors)
        damping = np.where(better, damping / DAMPING_FACTOR, damping * DAMPING_FACTOR)
        if not (cost[np.isfinite(cost)] > (0.01 * ROOT_SIZE) ** 2).any():
            break
    roots = [base]
    for point in points[cost < ROOT_SIZE**2 * len(moving)]:
        with np.errstate(all="ignore"):
            apart = [np.nanmax(np.abs(point / other - 1)) > SAME_ROOT for other in roots]
        if all(apart):
            roots.append(point)
            yield point


# Any model: constants in each other's place, or of the other sign.


# Exchanges that are tried at most: each takes a run with its slopes.
MAX_EXCHANGES = 15
# Samples of each record that they are looked at over; what promises to be a twin there is run over the whole.
EXCHANGE_SAMPLES = 2000
# Share of the difference (squared) that the other constants must promise to take away for an exchange to be followed.
PROMISING = 0.05


def list_changes(variables: DecisionVector, alike: Sequence[tuple[int, int]]) -> list[tuple[list[int], np.ndarray]]:
    """Numbers of constants and the values that they may take instead: those ``alike`` in each other's place, or one of the other sign."""
    base, low, high = variables.base, variables.low, variables.high
    flips = [k for k in range(len(base)) if base[k] and low[k] <= -base[k] <= high[k]]
    return [*(([i, j], base[[j, i]]) for i, j in alike), *(([k], -base[[k]]) for k in flips)]


def _try_exchanges(problem: EstimationProblem, alike: list[tuple[int, int]]) -> Iterator[np.ndarray]:
    """Values (nf,) at which the run may be that of ``problem``: two constants in each other's place, or one of the other sign."""
    v = problem.variables
    beginning = replace(problem, records=tuple(r.first(EXCHANGE_SAMPLES * r.rows_per_sample) for r in problem.records))
    for held, values in list_changes(v, alike)[:MAX_EXCHANGES]:
        begin = v.base.copy()
        begin[held] = values
        objective = _hold(beginning, begin, held)
        evaluation = objective.evaluate(objective.variables.here)
        if np.isfinite(evaluation.cost):
            promised = evaluation.cost - evaluation.predicted_decrease(*objective.variables.bounds())
            if promised <= PROMISING * evaluation.cost or evaluation.cost < TWIN_RUN:
                yield settle(problem, begin, held).values


# A run as its own record.


def _own_run(problem: EstimationProblem, variables: DecisionVector, runs: Runs | None = None) -> EstimationProblem:
    """The problem with the run at ``variables`` in the place of what was measured, and without priors: its cost there is zero."""
    runs = problem.shooting(variables).simulate(variables.here) if runs is None else runs
    records = tuple(
        replace(r, y=np.where(np.isfinite(r.y), y, np.nan)) for r, (y, _) in zip(problem.records, runs, strict=True)
    )
    without = replace(variables, prior=np.tile((0.0, np.inf), (len(variables.which), 1)))
    return replace(problem, records=records, variables=without, loss=None)


def _hold(problem: EstimationProblem, values: np.ndarray, held: Sequence[int]) -> SimulationErrorObjective:
    """The cost at these ``values`` (nf,) of the constants, of which those numbered ``held`` are not free."""
    names = problem.variables.names
    given = problem.variables.with_values(dict(zip(names, values.tolist(), strict=True)))
    objective = SimulationErrorObjective(replace(problem, variables=given))
    return hold_parameters(objective, {names[k]: float(values[k]) for k in held}) if held else objective


# Rounds of damped steps (`SCORING_STEPS` each) in which the other constants follow.
SETTLING_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Settled:
    """``values`` (nf,) of the constants, the ``cost`` there, and the ``variables`` that were still free."""

    values: np.ndarray
    cost: float
    variables: DecisionVector


def settle(problem: EstimationProblem, begin: np.ndarray, held: Sequence[int]) -> Settled:
    """Where the cost of ``problem`` is least near ``begin`` (nf,) with the constants numbered ``held`` as they are there."""
    objective, values = _hold(problem, begin, held), begin.copy()
    if not objective.variables.size:
        return Settled(values, objective.evaluate(objective.variables.here).cost, objective.variables)
    for _ in range(SETTLING_ROUNDS):
        end = refine_minimum(objective, FitOptions(), LIKELIHOOD_LAST_DIGITS)
        objective = end.objective
        if end.status.success:
            break
    values[np.setdiff1d(np.arange(len(begin)), held)] = end.objective.variables.base
    return Settled(values, end.evaluation.cost, end.objective.variables)
