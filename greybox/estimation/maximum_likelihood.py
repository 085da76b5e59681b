"""The most likely unknowns of a model with process noise: from the free-run fit on, with intensities that may be zero."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import ModelError
from greybox.estimation.likelihood_search import LikelihoodOptimum, maximise_likelihood, select_best_start
from greybox.estimation.likelihood_unknowns import make_likelihood_unknowns
from greybox.estimation.options import FitOptions, FitProgressCallback
from greybox.estimation.prediction_error import PredictionErrorObjective
from greybox.estimation.problem import prepare_problem
from greybox.estimation.process_noise_tests import (
    FLOOR,
    compute_largest_intensities,
    drop_insignificant,
    guess_intensities,
)
from greybox.estimation.solution import Solution
from greybox.estimation.solve import solve
from greybox.experiment import Experiment
from greybox.filtering import KalmanFilter
from greybox.model import Model
from greybox.noise import NoiseModel
from greybox.transcription import DecisionVector


@dataclass(frozen=True)
class MaximumLikelihoodEstimate:
    """The optimum ``found``, from the free-run fit ``solution``; ``names`` of the intensities that were estimated, those of them that are
    ``zero``, and for each the size that would explain all movement by chance.
    """

    solution: Solution
    found: LikelihoodOptimum
    names: tuple[str, ...]
    zero: tuple[str, ...]
    sizes: Mapping[str, float]


def maximum_likelihood_estimate(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    quiet: Experiment | Sequence[Experiment],
    options: FitOptions,
    report: FitProgressCallback | None = None,
    initial: Sequence[Mapping[str, float]] = (),
) -> MaximumLikelihoodEstimate:
    """Search the unknowns of ``model`` from its free-run fit, or from its start values where those are more likely."""
    _check(options)
    names = tuple(q.name for q in model.free_parameters if q.name in model.noise_parameters)
    still = model.fix(*names)  # a free run knows nothing of them
    problem = prepare_problem(
        still, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, quiet=quiet,
        per_experiment=options.per_experiment, initial=initial,
    )  # fmt: skip
    solution = solve(problem, options, report)
    sizes = compute_largest_intensities(model, _steps(solution))
    found = maximise_likelihood(
        select_best_start([guess_intensities(c, names, sizes) for c in _starts(model, names, sizes, solution)]),
        options,
        report,
    )
    if not found.status.success:
        return MaximumLikelihoodEstimate(solution, found, names, (), sizes)
    found, zero = drop_insignificant(found, [n for n in names if model.parameter(n).bounds[0] == 0], options)
    return MaximumLikelihoodEstimate(solution, found, names, zero, sizes)


def _check(options: FitOptions) -> None:
    if options.loss != "squares":
        raise ModelError(
            f"loss {options.loss!r}: a model with process noise is fitted by its likelihood, which is that of normal noise; leave out"
            " the loss, or the process noise"
        )
    if options.transcription not in ("automatic", "single"):
        raise ModelError(
            f"transcription {options.transcription!r}: a model with process noise is fitted from sample to sample; leave it out, or the"
            " process noise"
        )


def _steps(solution: Solution) -> np.ndarray:
    """Change of each state (nx,) from row to row over the root of the interval, root mean square over the free runs."""
    changes = [
        np.diff(x, axis=0) / np.sqrt(r.h)[:, None]
        for (_, x), r in zip(solution.simulate(), solution.problem.records, strict=True)
    ]
    whole = np.concatenate(changes)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.sqrt(np.nanmean(np.where(np.isfinite(whole), whole, np.nan) ** 2, axis=0))


def _starts(
    model: Model, names: Sequence[str], sizes: Mapping[str, float], solution: Solution
) -> list[PredictionErrorObjective]:
    """The likelihood at the free-run fit, where there is one, and at the start values."""
    problem = solution.problem
    working = model
    for name in names:
        low, high = model.parameter(name).bounds
        floor = max(low, FLOOR * sizes[name])
        value = model.values[name] or 1e-3 * sizes[name]
        working = working.start(**{name: float(np.clip(value, min(floor, high / 2), high))})
        working = working.bound(**{name: (min(floor, high / 2), high)})
    known = not problem.variables.initial.free.any()
    kalman = KalmanFilter.of(working.system, problem.step, known_start=known)
    given = [e.conditions for e in problem.experiments]
    conditions = given if any(given) else ()
    costs = []
    for begin in (solution.variables, problem.variables) if solution.status.success else (problem.variables,):
        labels = dict(zip(begin.names, begin.base, strict=True))
        per_experiment = tuple({q.name for q, owner in zip(begin.quantities, begin.owner, strict=True) if owner >= 0})
        variables = DecisionVector.of(
            working, begin.initial, conditions, per_experiment, [e.name for e in problem.experiments]
        )
        costs.append(
            PredictionErrorObjective(make_likelihood_unknowns(problem, variables.at(labels)), kalman, problem.records)
        )
    return costs
