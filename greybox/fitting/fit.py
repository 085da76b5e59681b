"""`fit`: a model and records in, constants with intervals out."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import PackageNotFoundError, version

import casadi as ca
import numpy as np

from greybox.errors import FitError
from greybox.experiment import Experiment
from greybox.fitting.notes import meaning, notes
from greybox.fitting.options import FitOptions, Report
from greybox.fitting.problem import prepare
from greybox.fitting.solve import Solution, solve
from greybox.fitting.traces import misfits, named_noise, traces
from greybox.fitting.uncertainty import estimates, uncertainty
from greybox.fitting.validate import validate
from greybox.model import Model
from greybox.model.show import equations
from greybox.result import Fit


def fit(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | None = None,
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

    ``noise``: standard deviation by output, in the model's units; outputs left out are estimated from the records.
    ``validation``: records that are only judged (`validate`), without their first ``skip`` rows. ``report`` is called as the
    fit goes on. ``raise_on_failure`` raises FitError where the fit does not succeed.

    Raises DataError and ModelError for records that do not go with the model.
    """
    options = options or FitOptions()
    problem = prepare(model, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps)
    solution = solve(problem, options, report)
    result = _result(model, solution, options)
    if validation and result.success:
        judged = validate(result.model, validation, noise=result.noise, skip=skip, options=options)
        result = replace(result, validation=judged.misfit, validation_traces=judged.traces)
    if raise_on_failure and not result.success:
        raise FitError(f"fit of {model.title}: {result.meaning}")
    return result


def _result(model: Model, solution: Solution, options: FitOptions) -> Fit:
    problem, variables = solution.problem, solution.variables
    runs = traces(problem, variables)
    misfit = misfits(problem, runs)
    found = uncertainty(variables, solution.evaluation, problem.noise.given)
    constants = estimates(variables, found)
    measured = [j for j, o in enumerate(model.outputs) if o.name in misfit]
    return Fit(
        model=model.start(**{name: float(variables.fixed[k]) for k, name in enumerate(model.values)}),
        status=solution.status.name.lower(), success=solution.status.success, meaning=meaning(solution, misfit),
        parameters=constants, misfit=misfit, traces=runs, free=variables.names, covariance=found.covariance,
        noise=named_noise(problem, misfit), noise_source=problem.noise.source, discretisation=problem.step.label,
        integration_error={model.outputs[j].name: float(solution.integration_error[j]) for j in measured},
        cost=float(solution.evaluation.cost), solver=_statistics(solution), options=asdict(options),
        equations=equations(model), versions=versions(), notes=notes(solution, found, constants, misfit, runs),
    )  # fmt: skip


def _statistics(solution: Solution) -> dict[str, object]:
    return {
        "optimiser": "IPOPT", "ipopt_status": solution.solver_status, "iterations": solution.iterations,
        "passes": solution.evaluations, "seconds": solution.seconds, "record_shares": list(solution.shares),
        "kernel": solution.problem.kernel.name,
    }  # fmt: skip


def versions() -> dict[str, str]:
    """Versions of what computed a result."""
    try:
        own = version("greybox-sysid")
    except PackageNotFoundError:
        own = "not installed"
    return {"greybox": own, "casadi": ca.__version__, "numpy": np.__version__, "python": platform.python_version()}
