"""`fit`: a model and records in, constants with intervals out."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

import casadi as ca
import numpy as np

from greybox.errors import FitError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.fitting.alias import moves
from greybox.fitting.halving import discretisation_shift, polished
from greybox.fitting.notes import elsewhere, meaning, notes
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import prepare
from greybox.fitting.sandwich import colour_of
from greybox.fitting.solve import Solution, solve
from greybox.fitting.traces import misfits, named_noise, traces
from greybox.fitting.uncertainty import estimates, uncertainty
from greybox.fitting.validate import validate
from greybox.model import Model
from greybox.model.show import equations
from greybox.noise import AutoRegression, Noise
from greybox.noise.hierarchy import LEAST_NOISE, RESIDUAL
from greybox.result import Fit

Colouring = Literal["known", "residual", "white"]
COLOURINGS = ("known", "residual", "white")


def fit(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | Noise | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: Colouring = "known",
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    options: FitOptions | None = None,
    report: Report | None = None,
    raise_on_failure: bool = False,
) -> Fit:
    """Fit the free constants of ``model`` to one or more experiments.

    Minimises the sum of squared free-run errors, each output over its noise standard deviation,
    ``sum ((y - yhat) / noise)^2``, over the free constants and each experiment's initial state, with IPOPT and a Gauss-Newton
    Hessian. ``model`` is not changed; `Fit.model` carries the fitted values.

    ``noise``: standard deviation by output, in the model's units (or a `Noise` that is known already). Outputs left out are
    estimated, in this order of trust: from ``quiet`` (records with the input at rest and the same columns), from repetition in the
    records (a periodic input, several experiments with the same input), from high-order differences. A quiet record and repetition
    also tell the noise's colour: then residual and sensitivities are whitened by its autoregression, which is maximum likelihood for
    such noise. ``colour``: ``known`` does that where the colour is known; ``residual`` takes it from the residual of a first fit
    where it is not (right only if the model lacks nothing); ``white`` never does. Where the residual stays coloured the
    intervals allow for it (`Fit.interval_kind`).
    ``validation``: records that are only judged (`validate`), without their first ``skip`` rows. ``report`` is called as the
    fit goes on. ``raise_on_failure`` raises FitError where the fit does not succeed.

    Raises DataError and ModelError for records that do not go with the model.
    """
    options = options or FitOptions()
    if colour not in COLOURINGS:
        raise ModelError(f"unknown colour {colour!r}; {nearest(colour, COLOURINGS)}")
    problem = prepare(
        model, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, quiet=quiet
    )  # fmt: skip
    if colour == "white":
        problem = problem.with_noise(replace(problem.noise, colour=tuple(AutoRegression() for _ in model.outputs)))
    solution = solve(problem, options, report)
    if RESIDUAL in problem.noise.sources.values() and solution.status.success:
        solution = _weighted_by_residual(solution, options, report)
    if colour == "residual" and solution.status.success:
        solution = _coloured_by_residual(solution, options, report)
    solution = polished(solution)
    result = _result(model, solution, options)
    if validation and result.success:
        judged = validate(result.model, validation, noise=result.noise, skip=skip, options=options)
        result = replace(
            result, validation=judged.misfit, validation_traces=judged.traces,
            notes=(*result.notes, *elsewhere(result.misfit, judged.misfit)),
        )  # fmt: skip
    if raise_on_failure and not result.success:
        raise FitError(f"fit of {model.title}: {result.meaning}")
    return result


def _weighted_by_residual(solution: Solution, options: FitOptions, report: Report | None) -> Solution:
    """The fit repeated with the residual's own size as the noise of the outputs whose noise nothing else tells."""
    problem, evaluation = solution.problem, solution.evaluation
    counts = np.maximum(evaluation.counts, 1)
    size = np.sqrt(evaluation.squares / counts * evaluation.count / max(evaluation.count - solution.variables.size, 1))
    told = np.array([problem.noise.sources.get(o.name) == RESIDUAL for o in problem.model.outputs])
    std = problem.noise.std * np.where(told & (size > 0), np.maximum(size, LEAST_NOISE), 1.0)
    weighted = replace(problem.with_noise(replace(problem.noise, std=std)), variables=solution.variables)
    return solve(weighted, replace(options, progressive=False), report)


def _coloured_by_residual(solution: Solution, options: FitOptions, report: Report | None) -> Solution:
    """The fit repeated with the noise coloured as the residual is, where its colour is not known already."""
    problem, variables = solution.problem, solution.variables
    rows = problem.shooting(variables).residuals(np.zeros(variables.size))
    residual = colour_of(rows, variables.size, problem.noise.given)
    models = tuple(
        known if known.order else found for known, found in zip(problem.noise.colour, residual.models, strict=True)
    )
    if all(a is b for a, b in zip(models, problem.noise.colour, strict=True)):
        return solution
    coloured = replace(problem.with_noise(replace(problem.noise, colour=models)), variables=variables)
    return solve(coloured, replace(options, progressive=False), report)


def _result(model: Model, solution: Solution, options: FitOptions) -> Fit:
    problem, variables = solution.problem, solution.variables
    runs = traces(problem, variables)
    misfit = misfits(problem, runs)
    rows = problem.shooting(variables).residuals(np.zeros(variables.size))
    found = uncertainty(variables, solution.evaluation, problem.noise.given, rows)
    constants = estimates(variables, found)
    shift = discretisation_shift(solution, np.sqrt(np.diag(found.covariance)))
    remarks = notes(solution, found, constants, misfit, runs, moves(solution, rows), shift)
    measured = [j for j, o in enumerate(model.outputs) if o.name in misfit]
    widened = np.ones(len(variables.names)) if found.inflation is None else found.inflation
    return Fit(
        model=model.start(**{name: float(variables.fixed[k]) for k, name in enumerate(model.values)}),
        status=solution.status.name.lower(), success=solution.status.success, meaning=meaning(solution, misfit),
        parameters=constants, misfit=misfit, traces=runs, free=variables.names, covariance=found.covariance,
        noise=named_noise(problem, misfit), noise_source=problem.noise.source, discretisation=problem.step.label,
        integration_error={model.outputs[j].name: float(solution.integration_error[j]) for j in measured},
        cost=float(solution.evaluation.cost), solver=_statistics(solution), options=asdict(options),
        equations=equations(model), versions=versions(), notes=remarks,
        noise_sources=dict(problem.noise.sources), interval_kind=found.kind,
        noise_colour={o.name: a.reflection for o, a in zip(model.outputs, problem.noise.colour, strict=True) if o.name in misfit},
        inflation=dict(zip(variables.names, widened.tolist(), strict=True)),
        discretisation_shift=dict(zip(variables.names, shift.tolist(), strict=True)),
    )  # fmt: skip


def _statistics(solution: Solution) -> dict[str, object]:
    return {
        "optimiser": "IPOPT", "ipopt_status": solution.solver_status, "iterations": solution.iterations,
        "passes": solution.evaluations, "seconds": solution.seconds, "record_shares": list(solution.shares),
        "strategy": solution.strategy,
        "kernel": solution.problem.kernel.name, "substeps": solution.problem.step.substeps,
    }  # fmt: skip


def versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        own = version("greybox-sysid")
    except PackageNotFoundError:
        own = "not installed"
    return {"greybox": own, "casadi": ca.__version__, "numpy": np.__version__, "python": platform.python_version()}
