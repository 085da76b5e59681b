"""Intervals that do not lean on the curvature at the optimum: profile likelihood and the block bootstrap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from greybox.base.errors import DataError, FitError, ModelError, nearest
from greybox.base.json_file import StoredResult, read_json
from greybox.base.json_shape import (
    FileKind,
    Finite,
    FiniteArray,
    Interval,
    Matrix,
    UnboundedArray,
    from_json_data,
)
from greybox.base.linear_algebra import pseudo_inverse
from greybox.base.values import Printable
from greybox.estimation.covariance import compute_quantile, estimate_covariance
from greybox.estimation.objective import (
    LIKELIHOOD_TERMINATION,
    Objective,
    SimulationErrorObjective,
    hold_parameters,
    refine_minimum,
    search_minimum,
)
from greybox.estimation.optimum import restore_objective, restore_options, restore_residuals
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.simulation_error import Evaluation

__all__ = ["Bootstrap", "Profile", "bootstrap", "load_bootstrap", "load_profile", "profile"]

# Block bootstrap: what the constants would have been had the residual fallen otherwise.


@dataclass(frozen=True)
class BootstrapPolicy:
    """How long the blocks of a bootstrap are."""

    correlation_times: float = 5.0
    """A block covers so many correlation times of the residual, and at least the cube root of the record (Kunsch 1989)."""

    least_blocks: int = 5
    """Blocks in a record at least: fewer cannot be drawn in enough different orders."""


DEFAULT_BOOTSTRAP_POLICY = BootstrapPolicy()


# Profiles and bootstraps as JSON files that are written and read without loss.


class IntervalFile(StoredResult):
    """A value about intervals that can be saved: its fields are the keys of the file."""

    KEYS: ClassVar[str] = "kind! *"

    @property
    def kind(self) -> str:
        """``profile`` or ``bootstrap``: which of these files it is."""
        return type(self).__name__.lower()


@dataclass(frozen=True, eq=False)
class Bootstrap(IntervalFile):
    """The constants that other draws of the residual would have given.

    Attributes
    ----------
    names
        The constants.
    samples
        For each draw the constants in that order (B, nf).
    std, interval
        Standard deviation and 95 % interval by name.
    block
        Rows of a block.
    policy
        How long blocks are.
    """

    names: tuple[str, ...]
    samples: Matrix
    std: dict[str, float]
    interval: dict[str, Interval]
    block: int
    policy: BootstrapPolicy = DEFAULT_BOOTSTRAP_POLICY

    FILE: ClassVar[FileKind] = FileKind("a bootstrap", "file that a bootstrap was saved to")


def load_bootstrap(path: str | Path) -> Bootstrap:
    """Read a bootstrap that `Bootstrap.save` wrote.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Bootstrap
        The bootstrap as it was saved.

    Raises
    ------
    DataError
        If the file is not a bootstrap.
    """
    data = read_json(path, Bootstrap)
    names = data["names"]
    if any(len(row) != len(names) for row in data["samples"]) or not {*names} == {*data["std"]} == {*data["interval"]}:
        raise DataError(f"{path}: its samples, deviations and intervals are not those of its constants; save it again")
    return from_json_data(Bootstrap, data)


def bootstrap(
    fit: Fit,
    generator: np.random.Generator,
    *,
    replicates: int = 1000,
    block: int | None = None,
    policy: BootstrapPolicy = DEFAULT_BOOTSTRAP_POLICY,
) -> Bootstrap:
    """Moving-block bootstrap of the residual (Kunsch 1989), each replicate refitted by one Gauss-Newton step from the optimum.

    Blocks of the residual, all outputs together, are drawn with replacement from the same record and put in place of the residual;
    ``J+ r*`` moves the parameters and the initial states. One step is the whole refit where the model is nearly linear over the
    interval, which a `profile` can tell. Priors are drawn anew in each replicate. The interval is the basic one (reflected
    percentiles), on the logarithm of positive parameters, within their bounds. As every block bootstrap it falls short by some per
    cent where the record is only tens of blocks long. Of a fit with process noise the innovations are drawn anew (Stoffer and Wall,
    JASA 86, 1991), and one step of scoring moves the parameters.

    Parameters
    ----------
    fit
        A fit that succeeded, with its inputs.
    generator
        Where the draws come from.
    replicates
        How many.
    block
        Rows of a block; five correlation times of the residual where it is left out.
    policy
        How long the blocks are.

    Returns
    -------
    Bootstrap
        Samples (replicates, nf), standard deviations and 95 % intervals. A parameter that each experiment has for itself stands with
        each of its values, as ``B (day 1)``.

    Raises
    ------
    FitError
        For a fit that did not succeed, or a block that leaves fewer than five to a record.

    Examples
    --------
    >>> bootstrap(fit, np.random.default_rng(0)).interval["K"]  # doctest: +SKIP
    (6987.5, 7012.6)
    """
    objective, residuals = restore_residuals(fit)
    v, size = objective.variables, objective.variables.size
    shortest = min(len(r) for r, _ in residuals.rows)
    if block is None:
        estimation = FitOptions.from_data(fit.provenance.options).policy
        colour = estimate_residual_colour(residuals.rows, size, True, noise_policy=estimation.noise)
        time = max((t for t, _ in colour.times), default=1.0)
        block = max(
            1,
            min(
                int(np.ceil(max(policy.correlation_times * time, shortest ** (1 / 3)))), shortest // policy.least_blocks
            ),
        )
    if not 1 <= block <= shortest // policy.least_blocks:
        raise FitError(
            f"bootstrap: blocks of {block} rows from a record of {shortest}; give 1 to {shortest // policy.least_blocks} rows"
        )
    count = sum(int(np.isfinite(r).sum()) for r, _ in residuals.rows)
    gradient = np.zeros((replicates, size))
    prior = np.pad(v.penalty(v.here)[2] / 2, (0, size - len(v.which)))
    for e, (r, slopes) in enumerate(residuals.rows):
        loudness = residuals.log_variance[e] if residuals.log_variance else None
        gradient[:, v.columns(e)] += _draw_scores(r, slopes, loudness, replicates, block, generator)
    # Fitted residuals are too small by the unknowns: N / (N - p) of the variance is given back.
    gradient *= np.sqrt(count / max(count - size, 1))
    # A prior is one more measurement: in each replicate it has an error of its own.
    gradient += np.sqrt(prior) * generator.normal(size=gradient.shape)
    inside = np.ones(size, bool)
    inside[: len(v.which)] = ~v.active
    steps = np.zeros((replicates, size))
    information = residuals.compute_information(v) + np.diag(prior)
    # z* = -(J'J + P)^-1 J'r*
    steps[:, inside] = -gradient[:, inside] @ pseudo_inverse(information[np.ix_(inside, inside)])
    samples, std, interval = np.empty((replicates, len(v.which))), {}, {}
    for k, name in enumerate(v.names):

        def place(step: np.ndarray, k: int = k) -> np.ndarray:
            # value + scale z, or value exp(z), as the decision vector has it
            linear, factor = v.base[k] + v.scale[k] * step, np.exp(np.clip(step, -300, 300))
            return np.clip(v.base[k] * factor if v.logarithmic[k] else linear, v.low[k], v.high[k])

        samples[:, k] = place(steps[:, k])
        std[name] = float(samples[:, k].std(ddof=1))
        upper, lower = np.quantile(steps[:, k], [0.025, 0.975])
        # Basic interval: the error of the estimate is that of the replicates, so that the quantiles change sides.
        ends = place(np.array([-lower, -upper]))
        interval[name] = (float(ends[0]), float(ends[1]))
    return Bootstrap(v.names, samples, std, interval, block, policy)


def _draw_scores(
    r: np.ndarray,
    jacobian: np.ndarray,
    loudness: np.ndarray | None,
    replicates: int,
    block: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """``J' r*`` (B, L) of residuals made of random blocks of ``r`` (N, ny), each output's mean removed; gaps stay gaps.

    Of innovations ``J' r* + L'(s^2 - r*^2) / 2``, ``L`` the slopes of the logarithm of their variance and ``s^2`` their mean square.
    """
    n = len(r)
    measured = np.isfinite(r)
    slopes = np.where(measured[:, :, None], jacobian, 0.0).reshape(-1, jacobian.shape[2])
    with np.errstate(invalid="ignore"):
        centred = r - (np.where(measured, r, 0.0).sum(axis=0) / np.maximum(measured.sum(axis=0), 1))
    # A gap that falls on a measured row is filled by the block's neighbour: no residual must vanish.
    filled = centred.copy()
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        place = np.searchsorted(known, np.arange(n), side="right") - 1
        # The last value before a gap, or the first after; nothing where nothing was measured.
        column[:] = column[known[np.maximum(place, 0)]] if len(known) else 0.0
    squares = 0.5 * ((filled**2).mean(axis=0) - filled**2)
    louder = None if loudness is None else np.where(measured[:, :, None], loudness, 0.0).reshape(-1, jacobian.shape[2])
    places = np.arange(block)
    result = np.empty((replicates, jacobian.shape[2]))
    for b in range(replicates):
        # Blocks may overlap, and begin anywhere (Kunsch 1989).
        starts = generator.integers(0, n - block + 1, size=-(-n // block))
        chosen = (starts[:, None] + places).ravel()[:n]
        result[b] = filled[chosen].ravel() @ slopes
        if louder is not None:
            result[b] += squares[chosen].ravel() @ louder
    return result


# Profile likelihood: how much worse the best fit becomes when one constant is held elsewhere.


@dataclass(frozen=True)
class ProfilePolicy:
    """How a profile is followed to where it crosses its threshold."""

    tolerance: float = 0.01
    """The crossing is found to this share of the threshold, which is half a per cent of the interval's length."""


DEFAULT_PROFILE_POLICY = ProfilePolicy()


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
    """

    name: str
    unit: str
    best: Finite
    values: FiniteArray
    increase: UnboundedArray
    threshold: Finite
    interval: Interval
    policy: ProfilePolicy = DEFAULT_PROFILE_POLICY

    FILE: ClassVar[FileKind] = FileKind("a profile", "file that a profile was saved to")

    @property
    def open_sides(self) -> tuple[bool, bool]:
        """Whether the rise stays below the threshold downwards and upwards as far as it was followed."""
        return bool(self.increase[0] < self.threshold), bool(self.increase[-1] < self.threshold)


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
    predictions. Takes some 10 to 20 refits.

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
        Values, rise of the cost, and the 95 % interval.

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
    k, evaluation = v.names.index(name), objective.evaluate(v.here)
    options = restore_options(fit)
    if isinstance(objective, SimulationErrorObjective):
        std, scale, threshold = _scale_simulation_error(objective, evaluation, k)
    else:
        # The standard deviation of a fit with process noise is widened by coloured innovations alone.
        constant = v.quantities[k].name
        owner = v.names[k][len(constant) + 2 : -1]
        stated = fit.constraints.per_experiment[constant][owner] if owner else fit.parameters[constant]
        widened = fit.uncertainty.inflation.get(v.names[k], 1.0)
        std, scale = stated.std, widened**2 if np.isfinite(widened) else 1.0
        threshold = compute_quantile(np.inf) ** 2
    search = _ProfileSearch(objective, k, evaluation.cost, std, scale, threshold, options, policy)
    quantity, best = v.quantities[k], float(v.base[k])
    low, points_low = search.follow(quantity.bounds[0], -1)
    high, points_high = search.follow(quantity.bounds[1], +1)
    values, increase = np.array(sorted([*points_low, (best, 0.0), *points_high])).T
    return Profile(name, quantity.unit, best, values, increase, threshold, (low, high), policy)


def _scale_simulation_error(
    objective: SimulationErrorObjective, evaluation: Evaluation, k: int
) -> tuple[float | None, float, float]:
    """Standard deviation of the free constant number ``k``, the cost that is one of them squared, and the threshold in that unit."""
    problem, v = objective.problem, objective.variables
    residuals = objective.linearise()
    colour = estimate_residual_colour(residuals.rows, v.size, problem.noise.known, problem.variance_floor)
    covariance = estimate_covariance(v, evaluation, residuals, colour, problem)
    threshold, variance = compute_quantile(covariance.degrees) ** 2, covariance.covariance[k, k]
    if not np.isfinite(variance) or covariance.information is None:
        scale = evaluation.cost / max(evaluation.count - v.size, 1)
        return None, max(scale, 1.0) if problem.noise.known else scale, threshold
    inside = np.flatnonzero(~v.active)
    whole = covariance.information[np.ix_(inside, inside)] + np.diag(v.penalty(v.here)[2][inside] / 2)
    place = int(np.searchsorted(inside, k))
    # The unit of the cost in which curvature and stated variance agree: s^2 = var / (A^-1)_kk.
    scale = float(variance / v.spans[k] ** 2 / pseudo_inverse(whole)[place, place])
    return float(np.sqrt(variance)), scale, threshold


# The cost of each point is minimised to this share of the residual's variance (of one, for a likelihood); the threshold is near 4.
COST_DECREASE = 0.0001


# First step, in standard deviations: well inside the 95 % point, so that two points bracket it.
FIRST_STEP = 1.0
# Growth of the steps after it.
PROFILE_GROWTH = 1.6
# Steps to a side at most: 1.6^8 is 43 standard deviations, beyond which the side counts as open.
PROFILE_STEPS = 9
# Refits for the crossing at most.
PROFILE_REFITS = 8
# First step over the value of a parameter without a standard deviation: a factor of e^0.1.
BLIND_STEP = 0.1


@dataclass(frozen=True)
class _ProfileSearch:
    """What was minimised with the free parameter number ``k`` of ``objective`` held elsewhere, everything else estimated anew.

    ``least`` is the cost at the optimum, ``scale`` the unit of its rise, whose ``threshold`` is looked for; ``std``: the standard
    deviation of the parameter, where it has one.
    """

    objective: Objective
    k: int
    least: float
    std: float | None
    scale: float
    threshold: float
    options: FitOptions
    policy: ProfilePolicy

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
        enough = replace(LIKELIHOOD_TERMINATION, negligible_decrease=COST_DECREASE)
        optimum = refine_minimum(held, self.options, enough)
        if not optimum.status.success:
            optimum = search_minimum(optimum.objective, self.options)
        # A held constant has lost its prior, which the cost at the optimum has.
        cost = optimum.evaluation.cost + ((value - mean) / std) ** 2
        rise = max(cost - self.least, 0.0) / self.scale if np.isfinite(cost) else np.inf
        return rise, optimum.objective.variables

    def follow(self, bound: float, sign: int) -> tuple[float, list[tuple[float, float]]]:
        """Where the rise crosses the threshold on one side, and the points visited."""
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
        inner, near = (0.0, 0.0), None
        for _ in range(PROFILE_STEPS):
            value = place(step)
            rise, near = self.rise(value, near)
            points.append((value, rise))
            if rise > self.threshold:
                return self._cross(place, inner, (step, rise), near, points), points
            if value == bound:
                return bound, points
            inner, step = (step, rise), PROFILE_GROWTH * step
        return (bound if np.isfinite(bound) else sign * np.inf), points

    def _cross(
        self,
        place: Callable[[float], float],
        inner: tuple[float, float],
        outer: tuple[float, float],
        near: DecisionVector,
        points: list[tuple[float, float]],
    ) -> float:
        """The value between two steps where the rise meets the threshold: regula falsi on its square root, which is nearly straight."""
        threshold, refits = self.threshold, PROFILE_REFITS
        for k in range(refits):
            (a, fa), (b, fb) = inner, outer
            ra, rb = np.sqrt(fa), np.sqrt(fb) if np.isfinite(fb) else np.inf
            straight = np.isfinite(rb) and k < refits - 2
            # sqrt(rise) is |value - best| / std near the best value: a straight line.
            step = a + (b - a) * (np.sqrt(threshold) - ra) / (rb - ra) if straight else (a + b) / 2
            rise, near = self.rise(place(step), near)
            points.append((place(step), rise))
            if abs(rise - threshold) <= self.policy.tolerance * threshold:
                return place(step)
            inner, outer = ((step, rise), outer) if rise < threshold else (inner, (step, rise))
        return place(outer[0])
