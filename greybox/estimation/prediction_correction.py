"""What corrects a model from sample to sample: its own process noise, or what records say would do it, the constants left as they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from greybox.estimation.fixed_parameters import FixedParameterModel, estimate_initial_state, make_likelihood
from greybox.estimation.maximum_likelihood import MaximumLikelihoodEstimate, maximum_likelihood_estimate
from greybox.estimation.problem import prepare_problem
from greybox.estimation.solve import solve
from greybox.experiment import Experiment
from greybox.kernel import Record
from greybox.model import Model
from greybox.noise import AutoRegression, fit_autoregression, join_series

LOG_TWO_PI = float(np.log(2 * np.pi))


@dataclass(frozen=True)
class PredictionCorrection:
    """How measurements correct a run: through the states of ``model``, where that has process noise, or by the autoregression
    ``colours`` of each output's error; by nothing where there is neither. ``noise``: what the sensors are taken to have, by output.
    ``words`` say which it is.
    """

    model: Model
    noise: Mapping[str, float]
    colours: Mapping[str, AutoRegression] = field(default_factory=dict)
    words: str = ""


def identify_correction(given: FixedParameterModel, experiments: Sequence[Experiment]) -> PredictionCorrection:
    """The correction under which ``experiments`` are most likely, the constants being left as they are.

    A model with process noise of its own brings its Kalman filter. Else there are two rivals. Process noise on every balance that may
    lack something, its intensities and the noise of the sensors estimated by maximum likelihood: a filter that moves the states, which
    is right where the plant is pushed, drifts, or began elsewhere. An autoregression of the free run's error, the exact predictor where
    the sensors' noise is coloured: the states stay. The more likely one is taken, less what its numbers cost (BIC), and neither where
    the error of the free run is white: a model that lacks nothing predicts as it runs freely.
    """
    frozen = given.model.fix(*given.model.values)
    if frozen.noisy_states:
        cost = estimate_initial_state(make_likelihood(given, experiments), given.options)
        return PredictionCorrection(
            frozen, _levels(frozen, cost.unknowns.level, cost.records), words=describe_filter(frozen)
        )
    options = given.options
    problem = prepare_problem(
        frozen, experiments, given.noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps
    )
    levels, runs = _levels(frozen, problem.noise.std, problem.records), solve(problem, options).simulate()
    errors = [r.samples(r.y - y) for r, (y, _) in zip(problem.records, runs, strict=True)]
    series = {o.name: join_series([e[:, j] for e in errors]) for j, o in enumerate(frozen.outputs)}
    colours = {name: fit_autoregression(s) for name, s in series.items() if np.isfinite(s).any()}
    if not any(colour.order for colour in colours.values()):
        return PredictionCorrection(frozen, levels, words="none: the error of the free run is white")
    states = find_correctable_states(frozen)
    likely = maximum_likelihood_estimate(frozen.with_process_noise(*states), experiments, given.noise, (), options)
    if likely.found.status.success and _of_states(likely) < sum(_of_colour(series[n], c) for n, c in colours.items()):
        return _by_states(frozen, states, likely)
    orders = ", ".join(f"{name} AR({colour.order})" for name, colour in colours.items() if colour.order)
    words = f"autoregression of the free run's error ({orders})"
    return PredictionCorrection(frozen, levels, colours, words)


def describe_filter(model: Model) -> str:
    """The filter of a model with known process noise, in words; of one whose intensities are all zero there is none."""
    states = model.noisy_states
    return f"Kalman filter, process noise on {', '.join(states)}" if states else "none: the process noise is zero"


def _by_states(frozen: Model, states: Sequence[str], likely: MaximumLikelihoodEstimate) -> PredictionCorrection:
    variables = likely.found.cost.unknowns.variables
    found = dict(zip((q.name for q in variables.model.all_parameters), variables.fixed.tolist(), strict=True))
    model = frozen.with_process_noise(*states)
    model = model.fix(**{name: found[name] for name in likely.names})
    words = f"Kalman filter, process noise estimated on {', '.join(model.noisy_states)}"
    cost = likely.found.cost
    return PredictionCorrection(model, _levels(model, cost.unknowns.level, cost.records), words=words)


def find_correctable_states(model: Model) -> tuple[str, ...]:
    """States whose balance may lack something: not one whose rate is another state by definition, nor one that is set after a step."""
    system = model.system
    moved = [b.state for b in system.balances]
    by_definition = {name for k, name in enumerate(system.state_names) if system.rhs[k].is_symbolic()}
    return tuple(name for name in moved if name not in by_definition) or tuple(moved)


def _levels(model: Model, level: np.ndarray, records: Sequence[Record]) -> dict[str, float]:
    """Noise of the outputs that were measured."""
    seen = [j for j in range(len(level)) if any(np.isfinite(r.y[:, j]).any() for r in records)]
    return {model.outputs[j].name: float(level[j]) for j in seen}


def _of_states(likely: MaximumLikelihoodEstimate) -> float:
    """``-2 log L`` of the filter, and what its intensities and noise levels cost."""
    unknowns, evaluation = likely.found.cost.unknowns, likely.found.evaluation
    numbers = len(unknowns.variables.which) + int(unknowns.estimated.sum())
    return evaluation.cost + numbers * float(np.log(max(evaluation.count, 1)))


def _of_colour(series: np.ndarray, colour: AutoRegression) -> float:
    """``-2 log L`` of an output's errors (N,) as an autoregression, and what its numbers cost."""
    count = int(np.isfinite(series).sum())
    variance = float(np.nanmean(series**2)) * colour.innovation_variance
    return count * (float(np.log(max(variance, 1e-300))) + 1 + LOG_TWO_PI) + (colour.order + 1) * float(np.log(count))
