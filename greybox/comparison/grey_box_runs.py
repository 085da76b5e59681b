"""Physical models as contestants: their runs over records, stability and feed-through."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.comparison.result import ComparisonRun
from greybox.estimation import FitOptions, Predictor, predictor, validate
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.noise import AutoRegression, fit_autoregression, join_series
from greybox.result import Fit, Trace
from greybox.simulation import declared_initial_state

# Of the fastest eigenvalue, by which a real part may seem to lie above zero.
ROUNDING = 1e-9
# Rows of all records up to which the filter that predicts best is searched for, which takes longer with more.
MOST_FILTERED = 50_000


def run_grey_box(
    model: Model | Fit,
    experiments: Sequence[Experiment],
    *,
    training: bool,
    skip: int,
    options: FitOptions,
    ahead: Predictor | None = None,
    steps: Sequence[int] = (),
) -> list[ComparisonRun]:
    """Free run and one-step prediction of a physical model over each record.

    A record that a fit was made of has the initial state of that fit; another one a state estimated from its first ``skip`` (or 50)
    rows. Predictions, also ``steps`` samples ahead, are those of ``ahead`` (`choose_predictor`); without it an autoregression forecasts the
    free-run error, as the fit's own residual tells.
    """
    own = {t.fingerprint: t for t in model.traces} if isinstance(model, Fit) and has_free_runs(model) else {}
    plant = model.model if isinstance(model, Fit) else model
    noise = model.noise.std if isinstance(model, Fit) else None
    unknown = [e for e in experiments if not (training and e.fingerprint in own)]
    judged = iter(validate(plant, unknown, noise=noise, skip=skip, options=options).traces if unknown else ())
    traces = [own[e.fingerprint] if training and e.fingerprint in own else next(judged) for e in experiments]
    colour = estimate_residual_colours(model) if isinstance(model, Fit) else {}
    return [
        run
        for trace, experiment in zip(traces, experiments, strict=True)
        for run in _runs(trace, experiment, ahead, colour, 0 if training else skip, steps)
    ]


def choose_predictor(model: Model | Fit, rows: int) -> Predictor | None:
    """What predicts best from sample to sample with the constants of a fit, learnt from its own records; None for what is no
    successful fit, has constants of single records, or where all its and the other ``rows`` are too many."""
    if not (isinstance(model, Fit) and model.success and not model.constraints.per_experiment):
        return None
    return predictor(model) if rows + sum(len(t.time) for t in model.traces) <= MOST_FILTERED else None


def has_free_runs(fit: Fit) -> bool:
    """Whether the traces of ``fit`` are free runs over whole records: not those of arcs or segments."""
    return bool(fit.solver.statistics.get("free_run", True)) and fit.solver.statistics.get("transcription") != "arcs"


def estimate_residual_colours(fit: Fit) -> dict[str, AutoRegression]:
    """The autoregression of each output's residual on the fitted records."""
    names = dict.fromkeys(name for trace in fit.traces for name in trace.measured)
    return {n: fit_autoregression(join_series([t.residual(n) for t in fit.traces if n in t.measured])) for n in names}


def _runs(
    trace: Trace, experiment: Experiment, ahead: Predictor | None, colour: Mapping[str, AutoRegression], skip: int,
    steps: Sequence[int],
) -> Iterator[ComparisonRun]:  # fmt: skip
    """The runs of one record, output by output."""
    foreseen = {k: ahead.predict(experiment, k, initial=trace.initial_state) for k in (1, *steps)} if ahead else {}
    for output in trace.measured:
        simulated = trace.simulated[output]
        if ahead is None:
            residual = trace.residual(output)
            one, *more = (
                simulated + (colour[output].predict(residual, k) if output in colour else 0.0) for k in (1, *steps)
            )
        else:
            one, *more = (foreseen[k][output] for k in (1, *steps))
        further = dict(zip(steps, more, strict=True))
        yield ComparisonRun(experiment.name, output, trace.time, trace.measured[output], simulated, one, skip, further)


def compute_feedthrough(model: Model) -> dict[str, float]:
    """``output/input`` -> ``dy/du`` at the declared initial state and input zero, where it is not zero."""
    system = model.system
    slopes = ca.Function("direct", [system.x, system.u, system.p], [ca.jacobian(system.outputs, system.u)])
    p = np.array(list(model.values.values()))
    found = slopes(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    return {
        f"{output.name}/{given.name}": float(found[j, i])
        for j, output in enumerate(model.outputs)
        for i, given in enumerate(model.inputs)
        if found[j, i] != 0
    }


def is_stable(model: Model, runs: Sequence[ComparisonRun]) -> bool:
    """Whether a linear model has no eigenvalue in the right half plane; of a nonlinear one, whether all its runs stay finite."""
    if not model.system.linear:
        return all(np.isfinite(run.simulated).all() for run in runs)
    p = np.array(list(model.values.values()))
    a = model.system.jacobian(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    eigenvalues = np.linalg.eigvals(a)
    return bool(np.all(eigenvalues.real <= ROUNDING * np.abs(eigenvalues).max(initial=0.0)))


def resolve_options(model: Model | Fit, options: FitOptions | None) -> FitOptions:
    """The options to judge by: the given ones, else those of the fit."""
    if options is not None:
        return options
    if not isinstance(model, Fit):
        return FitOptions()
    known = {name: value for name, value in model.provenance.options.items() if name in FitOptions.__dataclass_fields__}
    return replace(FitOptions(**known), per_experiment=())
