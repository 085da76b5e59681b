"""Estimation by the error of predictions: maximum likelihood of a model with process noise, through a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import ModelError
from greybox.estimation.objective import PredictionErrorObjective, add_noise_levels
from greybox.estimation.objective_search import LikelihoodMaximum, search_minimum, select_best_start
from greybox.estimation.options import FitOptions, prepare_estimation
from greybox.estimation.process_noise_tests import compute_largest_intensities, drop_insignificant, guess_intensities
from greybox.experiment import Experiment
from greybox.filtering import KalmanFilter
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.transcription import DecisionVector
from greybox.transcription.options import Transcription
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.solution import Solution
from greybox.transcription.solve import solve


@dataclass(frozen=True)
class MaximumLikelihoodEstimate:
    """The ``optimum`` of the likelihood, from the fit by simulation error ``solution``; ``names`` of the intensities that were
    estimated, those of them that are ``zero``, and for each the size that would explain all movement by chance.
    """

    solution: Solution
    optimum: LikelihoodMaximum
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

    Raises ModelError for a robust loss or a transcription, which have no meaning here.
    """
    _check_options(options)
    names = tuple(q.name for q in model.free_parameters if q.name in model.noise_parameters)
    undriven = model.fix(*names)  # a free run knows nothing of the intensities
    solution = solve(
        prepare_estimation(undriven, experiments, noise, options, quiet=quiet, initial=initial), options, report
    )
    sizes = compute_largest_intensities(model, _compute_state_changes(solution))
    starts = [
        guess_intensities(start, names, sizes, options.policy.process_noise)
        for start in _make_starts(model, names, sizes, solution, options)
    ]
    optimum = search_minimum(select_best_start(starts), options, report)
    if not optimum.status.success:
        return MaximumLikelihoodEstimate(solution, optimum, names, (), sizes)
    may_be_zero = [n for n in names if model.parameter(n).bounds[0] == 0]
    optimum, zero = drop_insignificant(optimum, may_be_zero, options)
    return MaximumLikelihoodEstimate(solution, optimum, names, zero, sizes)


def _check_options(options: FitOptions) -> None:
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


def _compute_state_changes(solution: Solution) -> np.ndarray:
    """Change of each state (nx,) from row to row over the root of the interval, root mean square over the free runs."""
    changes = [
        np.diff(x, axis=0) / np.sqrt(r.h)[:, None]
        for (_, x), r in zip(solution.simulate(), solution.problem.records, strict=True)
    ]
    whole = np.concatenate(changes)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.sqrt(np.nanmean(np.where(np.isfinite(whole), whole, np.nan) ** 2, axis=0))


def _make_starts(
    model: Model, names: Sequence[str], sizes: Mapping[str, float], solution: Solution, options: FitOptions
) -> list[PredictionErrorObjective]:
    """The likelihood at the fit by simulation error, where there is one, and at the start values."""
    problem, policy = solution.problem, options.policy
    working = model
    for name in names:
        low, high = model.parameter(name).bounds
        floor = max(low, policy.process_noise.floor * sizes[name])
        value = model.values[name] or 1e-3 * sizes[name]
        working = working.start(**{name: float(np.clip(value, min(floor, high / 2), high))})
        working = working.bound(**{name: (min(floor, high / 2), high)})
    known_start = not problem.variables.initial.free.any()
    kalman = KalmanFilter.of(working.system, problem.step, known_start=known_start)
    given = [e.conditions for e in problem.experiments]
    conditions, titles = given if any(given) else (), [e.name for e in problem.experiments]
    objectives = []
    for start in (solution.variables, problem.variables) if solution.status.success else (problem.variables,):
        variables = DecisionVector.of(working, start.initial, conditions, options.per_experiment, titles)
        variables = variables.with_values(dict(zip(start.names, start.base, strict=True)))
        variables = add_noise_levels(variables, problem, policy.likelihood_search)
        objectives.append(PredictionErrorObjective(variables, kalman, problem.records))
    return objectives
