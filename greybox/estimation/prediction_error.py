"""Estimation by the error of predictions: maximum likelihood of a model with process noise, through a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.special import chdtrc, chdtri

from greybox.base import ModelError
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import NoiseModel
from greybox.estimation import objective
from greybox.estimation.noise_loop import solve
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.result_parts import Estimate
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import FitProgressCallback, Solution
from greybox.model import Model
from greybox.simulation.filtering.kalman_filter import KalmanFilter

# Intensities of process noise: from which to start, whether zero would do as well, and how large one may be.


def compute_largest_intensities(model: Model, steps: np.ndarray) -> dict[str, float]:
    """For each intensity the one that would explain the movement of its states by chance alone.

    ``steps`` (nx,): root mean square of the states' change from row to row over the root of the interval.
    """
    system = model.system
    p = np.array(list(model.values.values()))
    by_p = ca.Function("noise", [system.p], [ca.jacobian(system.diffusion, system.p)])(p).full()
    largest = {}
    for name in model.noise_parameters:
        slope = np.abs(by_p[:, list(model.values).index(name)])
        with np.errstate(divide="ignore", invalid="ignore"):
            # A random walk of intensity q moves by q sqrt(h) in a row: q |d diffusion / d p| = change / sqrt(h).
            each = steps[slope > 0] / slope[slope > 0]
        each = each[np.isfinite(each) & (each > 0)]
        largest[name] = float(each.min()) if len(each) else 1.0
    return largest


# Start values reach so many decades below the intensity that would explain every movement of a state by chance.
START_DECADES = 6.0
# Decades between two start values.
START_SPACING = 0.5


def guess_intensities(
    cost: objective.PredictionErrorObjective, names: Sequence[str], sizes: Mapping[str, float]
) -> objective.PredictionErrorObjective:
    """``cost`` with ``z = 0`` at the most likely of some start values of the intensities ``names``, the other unknowns as they are.

    All of them together first, then each by itself.
    """
    # Shares of the intensity that would explain every movement of a state by chance.
    shares = 10.0 ** np.arange(0.0, -(START_DECADES + 0.1), -START_SPACING)
    together = [objective.start_at(cost, {n: share * sizes[n] for n in names}) for share in shares]
    cost = objective.select_best_start([cost, *together])
    for name in names if len(names) > 1 else ():
        cost = objective.select_best_start(
            [cost, *(objective.start_at(cost, {name: share * sizes[name]}) for share in shares)]
        )
    return cost


# Zero does as well where it costs less than this in -2 log L.
NEGLIGIBLE_DECREASE = 0.1


def drop_insignificant(
    optimum: objective.LikelihoodMaximum, names: Sequence[str], options: FitOptions
) -> tuple[objective.LikelihoodMaximum, tuple[str, ...]]:
    """The optimum with every intensity at zero for which that is as likely, and their names."""
    zero: list[str] = []
    for name in names:
        near = objective.refine_minimum(objective.hold_parameters(optimum.objective, {name: 0.0}), options)
        if near.evaluation.cost <= optimum.evaluation.cost + NEGLIGIBLE_DECREASE:
            # Each by itself: of two intensities that stand for one another either can be zero, not both.
            zero.append(name)
            optimum = objective.search_minimum(near.objective, options)
    return optimum, tuple(zero)


# An intensity below this share of the one that explains every movement counts as zero.
PROCESS_NOISE_FLOOR = 1e-08
# Level at which an intensity counts as clearly above zero.
PROCESS_NOISE_SIGNIFICANCE = 0.01
# Likelihood ratio at an upper limit: the chi-square point of the two-sided level 0.1, which is one-sided 95 %, as the ratio is zero in
# half of all cases without any process noise.
LIMIT_RATIO = float(chdtri(1, 0.1))


def likelihood_ratio_tests(
    estimate: MaximumLikelihoodEstimate, options: FitOptions
) -> tuple[objective.ProcessNoiseTest, ...]:
    """Each intensity with its likelihood ratio against zero, everything else estimated anew."""
    optimum = estimate.optimum
    if not optimum.status.success:
        return ()
    variables = optimum.objective.variables
    p = variables.parameters(variables.here)
    values = dict(zip((q.name for q in variables.model.all_parameters), p, strict=True))
    tests = []
    for name in estimate.names:
        if name in estimate.zero:
            upper = find_upper_limit(optimum, name, PROCESS_NOISE_FLOOR * estimate.sizes[name], options)
            tests.append(objective.ProcessNoiseTest(name, 0.0, 0.0, 1.0, limits=(0.0, upper)))
            continue
        rest = objective.search_minimum(
            objective.raise_noise_to_innovations(objective.hold_parameters(optimum.objective, {name: 0.0})), options
        )
        # 2 (log L - log L_0), both at their own optimum
        ratio = max(rest.evaluation.cost - optimum.evaluation.cost, 0.0)
        # Zero is on the edge: half the mass at zero, half chi-square of one degree (Self and Liang 1987).
        p_value = 0.5 * float(chdtrc(1, ratio))
        limited = ratio < LIMIT_RATIO
        limits = (0.0, find_upper_limit(optimum, name, values[name], options)) if limited else None
        tests.append(
            objective.ProcessNoiseTest(name, values[name], ratio, p_value, p_value < PROCESS_NOISE_SIGNIFICANCE, limits)
        )
    return tuple(tests)


# Factor between two trials on the way to an upper limit.
LIMIT_GROWTH = 2.0
# Trials at most.
LIMIT_STEPS = 40
# The limit is found to this share of the likelihood ratio.
PROCESS_NOISE_LIMIT_TOLERANCE = 0.02


def find_upper_limit(optimum: objective.LikelihoodMaximum, name: str, begin: float, options: FitOptions) -> float:
    """The intensity from which on ``-2 log L`` exceeds its minimum by the one-sided 95 % point, the other unknowns estimated anew.

    ``begin`` is one that does not.
    """
    limit, tolerance = LIMIT_RATIO, PROCESS_NOISE_LIMIT_TOLERANCE * LIMIT_RATIO
    enough = replace(objective.LIKELIHOOD_TERMINATION, negligible_decrease=tolerance)
    least = optimum.evaluation.cost
    near, low, high = optimum.objective, begin, np.inf
    value = begin
    # With the other unknowns held the cost rises at least as fast: up to there the limit is not reached.
    while value < begin / PROCESS_NOISE_FLOOR and objective.hold_parameters(near, {name: value}).cost() - least < limit:
        low, value = value, LIMIT_GROWTH * value
    for _ in range(LIMIT_STEPS):
        trial = objective.refine_minimum(objective.hold_parameters(near, {name: value}), options, enough)
        rise = trial.evaluation.cost - least
        if abs(rise - limit) <= tolerance:
            break
        if trial.status.success:
            near = trial.objective
        low, high = (value, high) if rise < limit else (low, value)
        # Doubled until it is enclosed, then halved in the logarithm: intensities span decades.
        value = LIMIT_GROWTH * value if np.isinf(high) else float(np.sqrt(low * high))
    return value


def set_intensity_limits(
    parameters: Mapping[str, Estimate], tests: Sequence[objective.ProcessNoiseTest]
) -> dict[str, Estimate]:
    """Intensities that are zero, or not certainly more, with their limit in place of an interval that cannot reach zero."""
    limited = dict(parameters)
    for test in tests:
        if test.value == 0:
            limited[test.name] = Estimate(0.0, parameters[test.name].unit, None, test.limits, False, True)
        elif test.limits is not None:
            limited[test.name] = replace(parameters[test.name], interval=test.limits)
    return limited


@dataclass(frozen=True)
class MaximumLikelihoodEstimate:
    """The ``optimum`` of the likelihood, from the fit by simulation error ``solution``; ``names`` of the intensities that were
    estimated, those of them that are ``zero``, and for each the size that would explain all movement by chance.
    """

    solution: Solution
    optimum: objective.LikelihoodMaximum
    names: tuple[str, ...]
    zero: tuple[str, ...]
    sizes: Mapping[str, float]


def estimate_by_prediction_error(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    options: FitOptions,
    report: FitProgressCallback | None = None,
    *,
    quiet: Experiment | Sequence[Experiment] = (),
    initial: Sequence[Mapping[str, float]] = (),
) -> MaximumLikelihoodEstimate:
    """The most likely parameters, intensities of process noise, measurement noise and first states of ``model``.

    The likelihood is that of the innovations of a Kalman filter, exact for a linear model, extended otherwise (Astrom 1970; Kristensen,
    Madsen, Jorgensen, Automatica 40, 2004). Noise of the outputs that is given, or known from a quiet record, is taken as it is,
    other noise is estimated with the rest. The search starts from the fit by simulation error, or from the start values where those
    are more likely; ``initial`` as in `greybox.fit`. An intensity for which zero is as likely becomes zero; with all at zero the fit is
    the one by simulation error.

    Raises ModelError for a robust loss, a transcription or common noise, which have no meaning here.
    """
    if options.loss != "squares":
        raise ModelError(
            f"loss {options.loss!r}: a model with process noise is fitted by its likelihood, which is that of normal noise; leave out"
            " the loss, or the process noise"
        )
    if options.transcription not in (Transcription.AUTOMATIC, Transcription.SINGLE) or options.arc_length:
        raise ModelError(
            f"transcription {options.transcription!r}: a model with process noise is fitted by its one-step predictions, which have"
            " none; leave out transcription and arc_length, or the process noise"
        )
    if options.common_noise:
        raise ModelError(
            "common_noise: a model with process noise estimates the noise of each output by itself; give the noise of the outputs, or leave"
            " out common_noise or the process noise"
        )
    names = tuple(q.name for q in model.free_parameters if q.name in model.noise_parameters)
    undriven = model.fix(*names)  # a free run knows nothing of the intensities
    begun = prepare_problem(undriven, experiments, noise, options, quiet=quiet, initial=initial, written_out=True)
    solution = solve(begun, options, report)
    # Change of each state from row to row over the root of the interval: what a random walk of unit intensity makes one.
    changes = [
        np.diff(x, axis=0) / np.sqrt(r.h)[:, None]
        for (_, x), r in zip(solution.simulate(), solution.problem.records, strict=True)
    ]
    whole = np.concatenate(changes)
    with np.errstate(invalid="ignore", over="ignore"):
        # Root mean square of dx / sqrt(h).
        moved = np.sqrt(np.nanmean(np.where(np.isfinite(whole), whole, np.nan) ** 2, axis=0))
    sizes = compute_largest_intensities(model, moved)
    objectives = _make_starts(model, names, sizes, begun.variables, solution, options)
    starts = [guess_intensities(start, names, sizes) for start in objectives]
    optimum = objective.search_minimum(objective.select_best_start(starts), options, report)
    if not optimum.status.success:
        return MaximumLikelihoodEstimate(solution, optimum, names, (), sizes)
    may_be_zero = [n for n in names if model.parameter(n).bounds[0] == 0]
    optimum, zero = drop_insignificant(optimum, may_be_zero, options)
    return MaximumLikelihoodEstimate(solution, optimum, names, zero, sizes)


def _make_starts(
    model: Model,
    names: Sequence[str],
    sizes: Mapping[str, float],
    begun: DecisionVector,
    solution: Solution,
    options: FitOptions,
) -> list[objective.PredictionErrorObjective]:
    """The likelihood at the fit by simulation error, where there is one, and at the start values."""
    problem = solution.problem
    working = model
    for name in names:
        low, high = model.parameter(name).bounds
        floor = max(low, PROCESS_NOISE_FLOOR * sizes[name])
        # A start at zero would stay there: the likelihood is even in the intensity and has no slope.
        value = model.values[name] or 1e-3 * sizes[name]
        working = working.start(**{name: float(np.clip(value, min(floor, high / 2), high))})
        working = working.bound(**{name: (min(floor, high / 2), high)})
    known_start = not problem.variables.initial.free.any()
    kalman = KalmanFilter.of(working.system, problem.step, known_start=known_start)
    given = [e.conditions for e in problem.experiments]
    conditions, titles = given if any(given) else (), [e.name for e in problem.experiments]
    objectives = []
    for start in (solution.variables, begun) if solution.status.success else (begun,):
        variables = DecisionVector.of(working, start.initial, conditions, options.per_experiment, titles)
        variables = variables.with_values(dict(zip(start.names, start.base, strict=True)))
        variables = objective.add_noise_levels(variables, problem)
        objectives.append(objective.PredictionErrorObjective(variables, kalman, problem.records))
    return objectives
