"""The model beside the data: traces of each record and misfit of each output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from greybox.result import Fit, Misfit, Trace
from greybox.transcription.problem import EstimationProblem


def make_traces(problem: EstimationProblem, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[Trace, ...]:
    """Each record with the model's run over it: outputs (N, ny) and states (N, nx) for each."""
    states = problem.model.system.state_names
    result = []
    for experiment, record, (y, x) in zip(problem.experiments, problem.records, runs, strict=True):
        y, x, seen, given = (record.samples(rows) for rows in (y, x, record.y, record.u))
        measured = {o.name: seen[:, j] for j, o in enumerate(problem.model.outputs) if np.isfinite(seen[:, j]).any()}
        simulated = {o.name: y[:, j] for j, o in enumerate(problem.model.outputs) if o.name in measured}
        start = dict(zip(states, map(float, x[0]), strict=True))
        inputs = {i.name: given[:, j] for j, i in enumerate(problem.model.inputs)}
        result.append(
            Trace(
                experiment.name,
                experiment.fingerprint,
                experiment.time,
                measured,
                simulated,
                start,
                inputs,
                experiment.hold,
                dict(experiment.conditions),
            )
        )
    return tuple(result)


def compute_misfits(problem: EstimationProblem, traces: Sequence[Trace], skip: int = 0) -> dict[str, Misfit]:
    """Free-run error of each output over all records, their first ``skip`` rows left out."""
    noise = {o.name: problem.noise.std[j] for j, o in enumerate(problem.model.outputs)}
    units = {o.name: o.unit for o in problem.model.outputs}
    return {
        name: compute_misfit(traces, name, units[name], noise[name], skip)
        for name in noise
        if any(name in trace.measured for trace in traces)
    }


def compute_misfit(traces: Sequence[Trace], output: str, unit: str, noise: float, skip: int = 0) -> Misfit:
    """Error of one output over the records that have it."""
    seen = [trace for trace in traces if output in trace.measured]
    error = _join([_select_measured(t.residual(output), t.measured[output], skip) for t in seen])
    samples = len(error)
    if samples == 0:
        return Misfit(np.nan, unit, np.nan, np.nan, 0)
    rmse, size = float(np.sqrt(np.mean(error**2))), float(np.linalg.norm(error))
    del error  # a long record is in memory a few times only
    measured = [_select_measured(t.measured[output], t.measured[output], skip) for t in seen]
    spread = float(np.linalg.norm(_join([values - values.mean() if len(values) else values for values in measured])))
    best_fit = 100 * (1 - size / spread) if spread > 0 else np.nan
    return Misfit(rmse, unit, best_fit, rmse / noise, samples)


def _select_measured(values: np.ndarray, measured: np.ndarray, skip: int) -> np.ndarray:
    """The ``values`` (N,) of the samples that were ``measured`` (N,), from row ``skip`` on."""
    usable = np.isfinite(measured[skip:])
    return values[skip:] if usable.all() else values[skip:][usable]


def _join(parts: Sequence[np.ndarray]) -> np.ndarray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def compute_record_misfits(fit: Fit, trace: Trace, skip: int = 0) -> dict[str, Misfit]:
    """Misfit of one record of a fit by output, without its first ``skip`` rows."""
    units = {o.name: o.unit for o in fit.model.outputs}
    # An output that the fitted records lack has the noise by which the validation judged it.
    judged = {name: m.rmse / m.noise_ratio for name, m in fit.validation.misfit.items() if m.noise_ratio > 0}
    noise = {**judged, **fit.noise.std}
    return {name: compute_misfit([trace], name, units[name], noise.get(name, np.nan), skip) for name in trace.measured}


def to_noise_by_output(problem: EstimationProblem, measured: Mapping[str, Misfit]) -> dict[str, float]:
    """Noise of the outputs that were measured."""
    return {o.name: float(problem.noise.std[j]) for j, o in enumerate(problem.model.outputs) if o.name in measured}
