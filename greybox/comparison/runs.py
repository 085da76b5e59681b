"""Runs of the compared models over records: physical models, and black boxes on the time grid each was identified at."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.base.errors import DataError
from greybox.base.numerics import INTEGRATING_POLE, SAME_SAMPLING_TIME
from greybox.comparison.blackbox.resample import keep_measured_rows, resample
from greybox.comparison.result import BlackBoxModel, ComparisonRun
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression, fit_autoregression, join_series
from greybox.estimation.optimum import has_free_run
from greybox.estimation.options import FitOptions
from greybox.estimation.predictor import Predictor, predictor
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import Trace
from greybox.estimation.validate import validate
from greybox.model.model import Model
from greybox.simulation.plant import PlantModel
from greybox.simulation.simulate import declared_initial_state

# ---- Black boxes ----


# Rows that determine the initial state of a validation record, where ``skip`` is 0.
COMPARISON_INITIAL_ROWS = 50


def run_black_box(
    model: BlackBoxModel,
    experiments: Sequence[Experiment],
    *,
    training: bool,
    skip: int,
    beginning: int = 0,
    at_rest: bool,
    steps: Sequence[int] = (),
) -> list[ComparisonRun]:
    """Free run and one-step prediction of ``model`` over each record that has its output, and predictions ``steps`` samples ahead.

    The initial state comes from all rows of a ``training`` record, and from the first ``beginning`` (or ``skip``, or
    ``policy.initial_rows``) of another; with ``at_rest`` everything was zero before.
    """
    runs = []
    for experiment in experiments:
        if model.output not in experiment.outputs or not np.isfinite(experiment.outputs[model.output]).any():
            continue
        record = match_sampling_time(experiment, model.output, model.sampling_time, model.label)
        # Rows count in the record as it was given: one resampled has others for the same time.
        ratio = record.rows / experiment.rows
        rows = None if training else max(1, round(ratio * (beginning or skip or COMPARISON_INITIAL_ROWS)))
        initial = "zero" if at_rest else "estimated"
        free_run = model.simulate(record, initial=initial, rows=rows)[model.output]
        one_step, *ahead = (model.predict(record, k, initial=initial, rows=rows)[model.output] for k in (1, *steps))
        first_time = experiment.time[min(skip, experiment.rows - 1)]
        runs.append(
            ComparisonRun(
                experiment.name,
                model.output,
                record.time,
                record.outputs[model.output],
                free_run,
                one_step,
                0 if training else int(np.searchsorted(record.time, first_time)),
                dict(zip(steps, ahead, strict=True)),
            )
        )
    return runs


def match_sampling_time(experiment: Experiment, output: str, sampling_time: float, label: str) -> Experiment:
    """``experiment`` at the ``sampling_time`` of the model ``label`` of ``output``: as it is, at its measured rows alone, or
    resampled where its time is irregular. Raises DataError for another sampling time."""
    step = experiment.sampling_time
    if step is not None and np.isclose(step, sampling_time, rtol=SAME_SAMPLING_TIME):
        return experiment
    sparse = keep_measured_rows(experiment, output)
    slow_step = sparse.sampling_time if sparse is not None else None
    if sparse is not None and slow_step is not None and np.isclose(slow_step, sampling_time, rtol=SAME_SAMPLING_TIME):
        return sparse
    if step is not None:
        raise DataError(
            f"experiment {experiment.name!r} is sampled every {step:.6g} s, but {label} of {output!r} was identified"
            f" at {sampling_time:.6g} s; give greybox.blackbox.resample(experiment, {sampling_time:.6g})"
        )
    return resample(experiment, sampling_time)


# ---- Physical models ----


def run_grey_box(
    model: Model | Fit,
    experiments: Sequence[Experiment],
    *,
    training: bool,
    skip: int,
    beginning: int = 0,
    options: FitOptions,
    filter_predictor: Predictor | None = None,
    steps: Sequence[int] = (),
) -> list[ComparisonRun]:
    """Free run and one-step prediction of a physical model over each record.

    A record that a fit was made of has the initial state of that fit; another one a state estimated from its first ``beginning``
    (or ``skip``, or 50) rows. Predictions, also ``steps`` samples ahead, are those of ``filter_predictor`` (`choose_predictor`);
    without it an autoregression forecasts the free-run error, as the fit's own residual suggests.
    """
    fitted_traces = {t.fingerprint: t for t in model.traces} if isinstance(model, Fit) and has_free_run(model) else {}
    plant = model.model if isinstance(model, Fit) else model
    noise = model.noise.std if isinstance(model, Fit) else None
    # By the content of the record, not its name: a record that the fit knows keeps the initial state of that fit.
    others = [e for e in experiments if not (training and e.fingerprint in fitted_traces)]
    validated: Iterator[Trace] = iter(())
    if others:
        validated = iter(
            validate(plant, others, noise=noise, skip=skip, initial_rows=beginning, options=options).traces
        )
    traces = [
        fitted_traces[e.fingerprint] if training and e.fingerprint in fitted_traces else next(validated)
        for e in experiments
    ]
    colours = estimate_residual_colours(model) if isinstance(model, Fit) else {}
    return [
        run
        for trace, experiment in zip(traces, experiments, strict=True)
        for run in _runs_of_record(trace, experiment, filter_predictor, colours, 0 if training else skip, steps)
    ]


# Rows of all records up to which the best prediction filter is searched for; the search takes longer with more.
FILTERED_ROWS = 50000


def choose_predictor(model: Model | Fit, rows: int) -> Predictor | None:
    """The filter that predicts best from sample to sample with the parameters of a fit, learnt from its own records; None for what
    is no successful fit, has parameters of single records, or where its own and the other ``rows`` are too many."""
    if not (isinstance(model, Fit) and model.success and not model.constraints.per_experiment):
        return None
    if isinstance(model.model, PlantModel):
        return None
    # Corrections are learnt on the estimation records: the one judged has no part in it.
    return predictor(model) if rows + sum(len(t.time) for t in model.traces) <= FILTERED_ROWS else None


def estimate_residual_colours(fit: Fit) -> dict[str, AutoRegression]:
    """The autoregression of each output's residual on the estimation records."""
    names = dict.fromkeys(name for trace in fit.traces for name in trace.measured)
    series = {n: join_series([t.residual(n) for t in fit.traces if n in t.measured]) for n in names}
    policy = FitOptions.from_data(fit.provenance.options).policy.noise
    return {n: fit_autoregression(values, policy=policy) for n, values in series.items()}


def _runs_of_record(
    trace: Trace,
    experiment: Experiment,
    filter_predictor: Predictor | None,
    colours: Mapping[str, AutoRegression],
    skip: int,
    steps: Sequence[int],
) -> Iterator[ComparisonRun]:
    """The runs of one record, output by output."""
    predictions = {}
    if filter_predictor:
        predictions = {k: filter_predictor.predict(experiment, k, initial=trace.initial_state) for k in (1, *steps)}
    for output in trace.measured:
        simulated = trace.simulated[output]
        if filter_predictor is None:
            residual = trace.residual(output)
            one_step, *ahead = (
                simulated + (colours[output].predict(residual, k) if output in colours else 0.0) for k in (1, *steps)
            )
        else:
            one_step, *ahead = (predictions[k][output] for k in (1, *steps))
        by_steps = dict(zip(steps, ahead, strict=True))
        measured = trace.measured[output]
        yield ComparisonRun(experiment.name, output, trace.time, measured, simulated, one_step, skip, by_steps)


def compute_feedthrough(model: Model) -> dict[str, float]:
    """``output/input`` -> ``dy/du`` at the declared initial state and input zero, where it is not zero."""
    system = model.system
    direct = ca.Function("direct", [system.x, system.u, system.p], [ca.jacobian(system.outputs, system.u)])
    p = np.array(list(model.values.values()))
    matrix = direct(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    return {
        f"{output.name}/{input_.name}": float(matrix[j, i])
        for j, output in enumerate(model.outputs)
        for i, input_ in enumerate(model.inputs)
        if matrix[j, i] != 0
    }


def is_stable(model: Model, runs: Sequence[ComparisonRun]) -> bool:
    """Whether a linear model has no eigenvalue in the right half plane; of any other plant, whether all its runs stay finite."""
    if isinstance(model, PlantModel) or not model.system.linear:
        return all(np.isfinite(run.simulated).all() for run in runs)
    p = np.array(list(model.values.values()))
    a = model.system.jacobian(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    eigenvalues = np.linalg.eigvals(a)
    # An integrator's eigenvalue is zero but for rounding: it counts as stable.
    return bool(np.all(eigenvalues.real <= INTEGRATING_POLE * np.abs(eigenvalues).max(initial=0.0)))


def resolve_options(model: Model | Fit, options: FitOptions | None) -> FitOptions:
    """The options to simulate with: the given ones, else those of the fit."""
    if options is not None:
        return options
    if not isinstance(model, Fit):
        return FitOptions()
    return replace(FitOptions.from_data(model.provenance.options), per_experiment=())
