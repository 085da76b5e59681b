"""Two records under the same input: what the model lacks acts alike in both, and leaves their difference.

The residuals of both fits then have a part in common. The difference of the constants rests on the difference of the residuals alone: its
covariance is the sandwich with that in the middle, far narrower than the sum of two covariances that each take the common part for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.change_detection.fitted_constants import FittedConstants
from greybox.change_detection.policy import ScatterPolicy
from greybox.errors import FitError
from greybox.estimation import FitOptions
from greybox.estimation.covariance import estimate_covariance
from greybox.estimation.objective import ResidualRows, SimulationErrorObjective
from greybox.estimation.restore import restore_noise, restore_residuals
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.experiment import Experiment
from greybox.result import Fit, Trace


def match_repeats(reference: Fit, records: Sequence[Experiment], policy: ScatterPolicy) -> tuple[int, ...]:
    """For each record the record of the fit whose input it repeats, each once; none where one repeats none."""
    places: list[int] = []
    for record in records:
        alike = (
            k
            for k, trace in enumerate(reference.traces)
            if k not in places and _is_alike(trace.experiment, record, policy)
        )
        place = next(alike, None)
        if place is None:
            return ()
        places.append(place)
    return tuple(places) if len(places) == len(reference.traces) else ()


def _is_alike(one: Experiment, other: Experiment, policy: ScatterPolicy) -> bool:
    """Whether an input repeats another one row by row."""
    if one.rows != other.rows or not np.allclose(np.median(one.intervals), np.median(other.intervals)):
        return False
    for name, values in one.inputs.items():
        difference = np.sqrt(np.nanmean((values - other.inputs[name]) ** 2)) if name in other.inputs else np.inf
        if not difference <= policy.repeated_input * np.sqrt(np.nanmean(values**2)):
            return False
    return True


def rest_on_difference(
    reference: Fit, today: Fit, places: Sequence[int], before: FittedConstants, after: FittedConstants
) -> tuple[FittedConstants, FittedConstants]:
    """Both estimates with the covariance of their difference on the second, and none on the first.

    As they were where today's run is no free one, or where a record lacks rows of the other.
    """
    try:
        objective, residuals = restore_residuals(today)
    except FitError:
        return before, after
    if not isinstance(objective, SimulationErrorObjective):
        return before, after
    rows = []
    for (r, jacobian), trace, place in zip(residuals.rows, today.traces, places, strict=True):
        difference = _weigh(trace, today) - _weigh(reference.traces[place], today)
        if difference.shape != r.shape:
            return before, after
        rows.append((difference, jacobian))
    policy, variables = FitOptions.from_data(today.provenance.options).policy, objective.variables
    colour = estimate_residual_colour(rows, variables.size, False, None, policy.intervals, policy.noise)
    evaluation, problem = objective.evaluate(variables.here), objective.problem
    whole = estimate_covariance(variables, evaluation, ResidualRows(tuple(rows)), colour, problem, policy.intervals)
    names = list(variables.names)
    if not set(after.names) <= set(names):
        return before, after
    order = [names.index(name) for name in after.names]
    slopes = np.where(after.positive, 1 / np.where(after.positive, after.values, 1.0), 1.0)
    covariance = whole.covariance[np.ix_(order, order)] * np.outer(slopes, slopes)
    nothing = np.where(np.isfinite(before.covariance), 0.0, before.covariance)
    return (
        replace(before, covariance=nothing, degrees=float(np.inf)),
        replace(after, covariance=covariance, degrees=colour.degrees),
    )


def _weigh(trace: Trace, fit: Fit) -> np.ndarray:
    """The residual (N, ny) of a run over the noise of ``fit``, whitened as it weighs; NaN where an output is not measured."""
    noise = restore_noise(fit)
    columns = []
    for output, std, colour in zip(noise.outputs, noise.std, noise.colour, strict=True):
        known = output in trace.measured and output in trace.simulated
        residual = trace.residual(output) if known else np.full(len(trace.time), np.nan)
        columns.append(colour.whiten(residual / std))
    return np.column_stack(columns)
