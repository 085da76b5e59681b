"""Profile likelihood: how much worse the best fit becomes when one constant is held elsewhere, and what shape that has."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.special import chdtri, fdtri

from greybox.base import DataError, ModelError, Printable, StoredResult, nearest, pseudo_inverse, read_json
from greybox.base.json_shape import FileKind, Finite, FiniteArray, Interval, UnboundedArray, from_json_data
from greybox.estimation.covariance import ParameterCovariance, compute_quantile, estimate_covariance
from greybox.estimation.findings import EstimationCode
from greybox.estimation.objective import (
    LIKELIHOOD_TERMINATION,
    Objective,
    SimulationErrorObjective,
    hold_parameters,
    refine_minimum,
    search_minimum,
)
from greybox.estimation.optim.minimisation import TerminationPolicy
from greybox.estimation.optimum import restore_objective, restore_options
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Estimate
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.shooting_cost import Evaluation

# Profiles, of one constant or two, and bootstraps as JSON files that are written and read without loss.


class IntervalFile(StoredResult):
    """A value about intervals that can be saved: its fields are the keys of the file."""

    KEYS: ClassVar[str] = "kind! *"

    @property
    def kind(self) -> str:
        """``profile``, ``profile_pair`` or ``bootstrap``: which of these files it is."""
        return re.sub("(?<!^)([A-Z])", r"_\1", type(self).__name__).lower()


# What a profile is.


@dataclass(frozen=True)
class ProfilePolicy:
    """How a profile is followed to where it crosses its threshold.

    Parameters
    ----------
    tolerance
        The crossing is found to this share of the threshold, which is half a per cent of the interval's length.
    """

    tolerance: float = 0.01


DEFAULT_PROFILE_POLICY = ProfilePolicy()


class ProfileShape(StrEnum):
    """What a profile looks like, and with it what the records say of a constant."""

    BOUNDED = "bounded"
    """The cost rises beyond the threshold on both sides."""

    ONE_SIDED = "one_sided"
    """It rises on one side only: the records set one limit."""

    FLAT = "flat"
    """It rises on no side: the records set no limit."""

    TWO_VALLEYS = "two_valleys"
    """It rises and falls again: there are values further away that do nearly as well, or better."""


# A profile falls again where it loses so much of the threshold after a rise: less is what refits leave over.
VALLEY_DEPTH = 0.25
# Share of half an interval by which the ends of profile and covariance may differ.
LARGEST_DISAGREEMENT = 0.1
# Correlation beyond which two constants are told to be nearly collinear: one alone is then known three times worse than beside the other.
NEARLY_COLLINEAR = 0.95


@dataclass(frozen=True, eq=False)
class Profile(Printable, IntervalFile):
    """The profile of one constant: how the cost rises when it is held elsewhere.

    Attributes
    ----------
    name, unit
        The constant and its unit.
    best
        Where the cost is least.
    values
        Where the constant was held (k,), increasing.
    increase
        Rise of the minimal cost there over its scale (k,), which for a well-determined constant is ``((value - best) / std)^2``;
        infinite where it could not be found.
    threshold
        Rise at the ends of the interval: the squared 95 % point.
    interval
        Where the rise stays below it; an end is the constant's bound, or infinite, where the rise never reaches it: the data leave
        that side open.
    policy
        How it was followed.
    by_covariance
        The 95 % interval of the fit itself, from the curvature at the optimum; None where it has none.
    partner, correlation
        The other constant that the records tell apart from it least, and their correlation; none where there is no other. Of a
        constant at its bound only the size of the correlation is known.
    partner_at_bound
        Whether that one lies at its bound, where the covariance takes it for known.
    """

    name: str
    unit: str
    best: Finite
    values: FiniteArray
    increase: UnboundedArray
    threshold: Finite
    interval: Interval
    policy: ProfilePolicy = DEFAULT_PROFILE_POLICY
    by_covariance: Interval | None = None
    partner: str = ""
    correlation: Finite = 0.0
    partner_at_bound: bool = False

    FILE: ClassVar[FileKind] = FileKind("a profile", "file that a profile was saved to")
    KEYS: ClassVar[str] = "kind! * shape valley disagreement is_better"

    @property
    def open_sides(self) -> tuple[bool, bool]:
        """Whether the rise stays below the threshold downwards and upwards as far as it was followed."""
        above = self.increase > self.threshold
        return not (above & (self.values < self.best)).any(), not (above & (self.values > self.best)).any()

    @property
    def valley(self) -> tuple[float, float] | None:
        """Where the cost falls again beyond a rise, and its rise there: below zero where it is less than at the optimum."""
        valleys: list[tuple[float, float]] = []
        for side in (np.flatnonzero(self.values < self.best)[::-1], np.flatnonzero(self.values > self.best)):
            highest = np.maximum.accumulate(np.append(0.0, self.increase[side]))[:-1]
            rises = self.increase[side]
            again = (rises < self.threshold) & (rises < highest - VALLEY_DEPTH * self.threshold)
            again |= rises < -VALLEY_DEPTH * self.threshold
            valleys += [(float(rises[k]), float(self.values[side[k]])) for k in np.flatnonzero(again)]
        return min(valleys)[::-1] if valleys else None

    @property
    def shape(self) -> ProfileShape:
        """Bounded, one-sided, flat, or with two valleys."""
        if self.valley is not None:
            return ProfileShape.TWO_VALLEYS
        return (ProfileShape.BOUNDED, ProfileShape.ONE_SIDED, ProfileShape.FLAT)[sum(self.open_sides)]

    @property
    def disagreement(self) -> float | None:
        """By how much the ends of this interval and of that by the covariance differ at most, over half the latter; None without it.

        Infinite where this one is open.
        """
        if self.by_covariance is None or not np.isfinite(self.by_covariance).all():
            return None
        low, high = self.by_covariance
        if not high > low:
            return None
        # A side that begins at its bound is neither open nor closed.
        if any(is_open and end != self.best for is_open, end in zip(self.open_sides, self.interval, strict=True)):
            return np.inf
        return float(np.abs(np.subtract(self.interval, self.by_covariance)).max() / ((high - low) / 2))

    @property
    def is_better(self) -> bool:
        """Whether this interval is to be taken in place of that by the covariance, from which it differs by more than a tenth."""
        return self.disagreement is not None and self.disagreement > LARGEST_DISAGREEMENT


def load_profile(path: str | Path) -> Profile:
    """Read a profile that `Profile.save` wrote.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Profile
        The profile as it was saved.

    Raises
    ------
    DataError
        If the file is not a profile.
    """
    data = read_json(path, Profile)
    if not 0 < len(data["values"]) == len(data["increase"]):
        raise DataError(f"{path}: it has {len(data['values'])} values and {len(data['increase'])} rises; save it again")
    return from_json_data(Profile, data)


def profile(fit: Fit, name: str, *, policy: ProfilePolicy = DEFAULT_PROFILE_POLICY) -> Profile:
    """Profile likelihood interval of a free parameter, by refits of everything else from the neighbouring point.

    ``2 log(L max / L(value)) = (cost(value) - cost min) / s^2`` stays below the 95 % point of chi-square with one degree of freedom
    (of F, where ``s^2`` was estimated). ``s^2`` is the one with which curvature and variance agree at the optimum: the variance of the
    residual where that is white, and as much more as the stated variance is larger where it is coloured, the loss is robust, or
    the parameter has a prior (Chandler and Bate, Biometrika 94, 2007). Of a fit with process noise it is the likelihood of its
    predictions. From beyond the threshold some searches with nothing held look for other minima. Takes some 15 to 25 refits.

    Parameters
    ----------
    fit
        A fit that succeeded, with its inputs.
    name
        The parameter. One that each experiment has for itself is named with its experiment: ``"B (day 1)"``.
    policy
        How the profile is followed.

    Returns
    -------
    Profile
        Values, rise of the cost, the 95 % interval beside that by the covariance, and the shape.

    Raises
    ------
    ModelError
        For a parameter that was not fitted.
    FitError
        For a fit that did not succeed.

    Examples
    --------
    >>> profile(fit, "K").interval  # doctest: +SKIP
    (6988.2, 7011.9)
    """
    if fit.prediction.process_noise and name in fit.model.noise_parameters and fit.model.values[name] == 0:
        raise ModelError(
            f"profile of {name!r}: its estimate is zero, and its interval in the fit is already the limit of the profile likelihood"
        )
    objective = restore_objective(fit)
    v = objective.variables
    if name not in v.names:
        raise ModelError(f"profile of {name!r}: not a fitted parameter; {nearest(name, v.names)}")
    k = v.names.index(name)
    scale = find_scale(fit, objective, k)
    search = ProfileSearch.of(objective, k, scale, restore_options(fit), policy)
    quantity, best = v.quantities[k], float(v.base[k])
    low, points_low = search.follow(quantity.bounds[0], -1)
    high, points_high = search.follow(quantity.bounds[1], +1)
    values, increase = np.array(sorted({(best, 0.0), *points_low, *points_high})).T
    return Profile(
        name,
        quantity.unit,
        best,
        values,
        increase,
        scale.threshold,
        (low, high),
        policy,
        _find_stated(fit, objective, k).interval,
        *_find_partner(fit, quantity.name),
    )


def _find_stated(fit: Fit, objective: Objective, k: int) -> Estimate:
    """What ``fit`` states of its unknown constant number ``k``."""
    v = objective.variables
    constant = v.quantities[k].name
    owner = v.names[k][len(constant) + 2 : -1]
    return fit.constraints.per_experiment[constant][owner] if owner else fit.parameters[constant]


def _find_partner(fit: Fit, name: str) -> tuple[str, float, bool]:
    """The constant whose correlation with ``name`` is largest, that, and whether it is at its bound; nothing where there is none."""
    partners: list[tuple[str, float, bool]] = [("", 0.0, False)]
    free, covariance = fit.uncertainty.free, np.asarray(fit.uncertainty.covariance)
    if name in free:
        with np.errstate(invalid="ignore", divide="ignore"):
            std = np.sqrt(np.diag(covariance))
            row = covariance[free.index(name)] / (std[free.index(name)] * std)
        others = zip(free, row.tolist(), strict=True)
        partners += [(other, value, False) for other, value in others if other != name and np.isfinite(value)]
    # A constant at its bound has no row there: what its freedom would do to the other's interval tells the correlation.
    for finding in fit.findings:
        if finding.code != EstimationCode.NARROWED_BY_BOUND:
            continue
        for other, growth in finding.values["growth"].items():
            # std with the other free, over std with it held = 1 / sqrt(1 - correlation^2)
            size = 1.0 if growth is None else float(np.sqrt(1 - 1 / growth**2))
            if other == name and "," not in finding.subject:
                partners.append((finding.subject, size, True))
            elif finding.subject == name:
                partners.append((other, size, False))
    return max(partners, key=lambda partner: abs(partner[1]))


@dataclass(frozen=True)
class RiseScale:
    """The ``least`` cost, the ``unit`` of its rise, the ``std`` of the constant (None: open), ``degrees`` of freedom of the unit."""

    least: float
    unit: float
    std: float | None
    degrees: float

    @property
    def threshold(self) -> float:
        """The 95 % point of chi-square with one degree of freedom, or of F."""
        # The square of Student's t with n degrees is F(1, n), that of a normal value chi-square(1).
        return compute_quantile(self.degrees) ** 2

    @property
    def threshold_of_two(self) -> float:
        """The same of two constants together."""
        # 2 F(2, n), which becomes chi-square(2) where the noise is known.
        return float(2 * fdtri(2, self.degrees, 0.95) if np.isfinite(self.degrees) else chdtri(2, 0.05))


def find_scale(fit: Fit, objective: Objective, k: int) -> RiseScale:
    """In what unit the cost of the free constant number ``k`` rises."""
    v = objective.variables
    if isinstance(objective, SimulationErrorObjective):
        return scale_simulation_error(objective, k)
    # The standard deviation of a fit with process noise is widened by coloured innovations alone.
    widened = fit.uncertainty.inflation.get(v.names[k], 1.0)
    unit = widened**2 if np.isfinite(widened) else 1.0
    return RiseScale(objective.evaluate(v.here).cost, unit, _find_stated(fit, objective, k).std, np.inf)


def scale_simulation_error(objective: SimulationErrorObjective, k: int) -> RiseScale:
    """The same of a simulation error, at its present point."""
    problem, v = objective.problem, objective.variables
    evaluation = objective.evaluate(v.here)
    covariance = estimate_covariance_at(objective, evaluation)
    degrees, variance = covariance.degrees, covariance.covariance[k, k]
    if not np.isfinite(variance) or covariance.information is None:
        scale, limit, value = evaluation.cost / max(evaluation.count - v.size, 1), covariance.limits.get(k), v.base[k]
        std = None
        if limit is not None and limit.limit is not None:  # of a constant on its bound half the way to its limit
            way = value * np.log(limit.limit / value) if v.logarithmic[k] else limit.limit - value
            std = abs(float(way)) / 2
        return RiseScale(evaluation.cost, max(scale, 1.0) if problem.noise.known else scale, std, degrees)
    inside = np.flatnonzero(~v.active)
    whole = covariance.information[np.ix_(inside, inside)] + np.diag(v.penalty(v.here)[2][inside] / 2)
    place = int(np.searchsorted(inside, k))
    # The unit of the cost in which curvature and stated variance agree: s^2 = var / (A^-1)_kk.
    scale = float(variance / v.spans[k] ** 2 / pseudo_inverse(whole)[place, place])
    return RiseScale(evaluation.cost, scale, float(np.sqrt(variance)), degrees)


def estimate_covariance_at(
    objective: SimulationErrorObjective, evaluation: Evaluation | None = None
) -> ParameterCovariance:
    """The covariance that the residual at the present point tells; ``evaluation`` is that there, where it is at hand."""
    problem, v, residuals = objective.problem, objective.variables, objective.linearise()
    colour = estimate_residual_colour(residuals.rows, v.size, problem.noise.known, problem.variance_floor)
    return estimate_covariance(v, evaluation or objective.evaluate(v.here), residuals, colour, problem)


# The cost of each point is minimised to this share of the residual's variance (of one, for a likelihood); the threshold is near 4.
COST_DECREASE = 0.0001


# First step, in standard deviations: well inside the 95 % point, so that two points bracket it.
FIRST_STEP = 1.0
# Growth of the steps after it.
PROFILE_GROWTH = 1.6
# Steps to a side: 1.6^8 is 43 standard deviations. What is not reached by then is looked for at the bound itself.
PROFILE_STEPS = 9
# Without a bound so many times the last step: a side counts as open where the rise stays below the threshold even there.
FARTHEST_STEP = 1000.0
# Refits for the crossing at most.
PROFILE_REFITS = 8
# First step over the value of a parameter without a standard deviation: a factor of e^0.1.
BLIND_STEP = 0.1
# How far out, over the distance of the threshold, searches begin that look whether the cost falls again.
FARTHER_LOOKS = (3.0, 12.0)


@dataclass(frozen=True)
class ProfileSearch:
    """What was minimised with the free parameter number ``k`` of ``objective`` held elsewhere, everything else estimated anew.

    ``least`` is the cost at the optimum, ``scale`` the unit of its rise, whose ``threshold`` is looked for; ``std``: the standard
    deviation of the parameter, where it has one. ``ground``: rise at the present point, where another constant is held elsewhere already,
    and ``lost_prior`` what the prior of that adds to the cost.
    """

    objective: Objective
    k: int
    least: float
    std: float | None
    scale: float
    threshold: float
    options: FitOptions
    policy: ProfilePolicy
    ground: float = 0.0
    lost_prior: float = 0.0

    @classmethod
    def of(
        cls,
        objective: Objective,
        k: int,
        scale: RiseScale,
        options: FitOptions,
        policy: ProfilePolicy = DEFAULT_PROFILE_POLICY,
    ) -> ProfileSearch:
        """The search along the constant number ``k`` whose rise has this ``scale``."""
        return cls(objective, k, scale.least, scale.std, scale.unit, scale.threshold, options, policy)

    def rise(self, value: float, near: DecisionVector | None) -> tuple[float, DecisionVector]:
        """Rise of the least cost over ``scale`` with the parameter at ``value``, from ``near`` on; infinite without a fit."""
        v = self.objective.variables
        name, owner, which = v.quantities[self.k].name, int(v.owner[self.k]), int(v.which[self.k])
        mean, std = v.prior[self.k]
        if owner == SHARED:
            held = hold_parameters(self.objective if near is None else self.objective.at(near), {name: value})
        else:  # of the other experiments it stays a parameter of their own
            given = [dict(c) for c in v.conditions or [{}] * v.experiments]
            given[owner][which] = value
            others = v.hold(np.arange(len(v.which)) == self.k) if near is None else near
            held = self.objective.at(replace(others, conditions=tuple(given)))
        optimum = refine_minimum(held, self.options, self._enough)
        if not optimum.status.success:
            optimum = search_minimum(optimum.objective, self.options)
        # A held constant has lost its prior, which the cost at the optimum has.
        cost = optimum.evaluation.cost + ((value - mean) / std) ** 2 + self.lost_prior
        return self._measure(cost), optimum.objective.variables

    @property
    def _enough(self) -> TerminationPolicy:
        return replace(LIKELIHOOD_TERMINATION, negligible_decrease=COST_DECREASE)

    def _measure(self, cost: float) -> float:
        """The rise of a cost over ``scale``."""
        rise = (cost - self.least) / self.scale if np.isfinite(cost) else np.inf
        # What the optimum itself has left over is no better value.
        return rise if rise < -VALLEY_DEPTH * self.threshold else max(rise, 0.0)

    def follow(self, bound: float, sign: int, *, farther: bool = True) -> tuple[float, list[tuple[float, float]]]:
        """Where the rise crosses the threshold on one side, and the points visited, with ``farther`` some beyond."""
        v, best = self.objective.variables, float(self.objective.variables.base[self.k])

        def place(step: float) -> float:
            value = best + sign * step
            if v.quantities[self.k].positive:
                value = best * float(np.exp(np.clip(sign * step / abs(best), -300, 300)))
            return max(value, bound) if sign < 0 else min(value, bound)

        points: list[tuple[float, float]] = []
        if best == bound:
            return bound, points
        std = self.std if self.std is not None and self.std > 0 else BLIND_STEP * (abs(best) or 1.0)
        step = FIRST_STEP * std
        inner, near = (0.0, self.ground), None
        for number in range(PROFILE_STEPS + 1):
            value = place(step)
            if number == PROFILE_STEPS:
                # The last one goes to the bound itself, or as far as there is any use in going.
                if not (farther or np.isfinite(bound)):
                    break
                value = bound if np.isfinite(bound) else place(FARTHEST_STEP * step)
                step = abs(best * float(np.log(value / best)) if v.quantities[self.k].positive else value - best)
            rise, near = self.rise(value, near)
            # Where there is no run there is no rise to be told.
            if number == PROFILE_STEPS and not np.isfinite(rise):
                break
            points.append((value, rise))
            if rise > self.threshold:
                end = self._cross(place, inner, (step, rise), near, points)
                if farther:
                    self._look_farther(place, step, bound, near, points)
                return end, points
            if value == bound:
                return bound, points
            inner, step = (step, rise), PROFILE_GROWTH * step
        return (bound if np.isfinite(bound) else sign * np.inf), points

    def _look_farther(
        self,
        place: Callable[[float], float],
        step: float,
        bound: float,
        near: DecisionVector,
        points: list[tuple[float, float]],
    ) -> None:
        """Add the minima that are reached from beyond the threshold with nothing held: a profile may fall again there."""
        v = self.objective.variables
        beside = {
            name: float(value) for name, value in zip(near.names, near.base, strict=True) if name != v.names[self.k]
        }
        for factor in FARTHER_LOOKS:
            value = place(factor * step)
            begin = self.objective.at(v.with_values({**beside, v.names[self.k]: value}))
            end = refine_minimum(begin, self.options, self._enough)
            if end.status.success and np.isfinite(end.evaluation.cost):
                reached = float(end.objective.variables.base[self.k])
                # A run that comes back has found nothing new.
                known = [float(v.base[self.k]), *(visited for visited, _ in points)]
                if not min(known) <= reached <= max(known):
                    points.append((reached, self._measure(end.evaluation.cost + self.lost_prior)))
            if value == bound:
                return

    def _cross(
        self,
        place: Callable[[float], float],
        inner: tuple[float, float],
        outer: tuple[float, float],
        near: DecisionVector,
        points: list[tuple[float, float]],
    ) -> float:
        """The value between two steps where the rise meets the threshold: regula falsi on its square root, which is nearly straight."""
        threshold, refits, kept = self.threshold, PROFILE_REFITS, 0
        for k in range(refits):
            (a, fa), (b, fb) = inner, outer
            ra, rb = np.sqrt(max(fa, 0.0)), np.sqrt(fb) if np.isfinite(fb) else np.inf
            # At a kink (another constant comes to its bound) the same side would be cut over and over: then the middle.
            straight = np.isfinite(rb) and k < refits - 2 and abs(kept) < 2
            # sqrt(rise) is |value - best| / std near the best value: a straight line.
            middle = np.sqrt(a * b) if a > 0 else (a + b) / 2  # decades may lie between the last step and the bound
            step = a + (b - a) * (np.sqrt(threshold) - ra) / (rb - ra) if straight else middle
            rise, near = self.rise(place(step), near)
            points.append((place(step), rise))
            if abs(rise - threshold) <= self.policy.tolerance * threshold:
                return place(step)
            if rise < threshold:
                inner, kept = (step, rise), max(kept, 0) + 1
            else:
                outer, kept = (step, rise), min(kept, 0) - 1
        # Between the last two, as near as that tells.
        (a, fa), (b, fb) = inner, outer
        if np.isfinite(fb):
            a += (b - a) * (np.sqrt(threshold) - np.sqrt(max(fa, 0.0))) / (np.sqrt(fb) - np.sqrt(max(fa, 0.0)))
        return place(a if np.isfinite(fb) else b)
