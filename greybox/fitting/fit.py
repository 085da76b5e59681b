"""`fit`: a model and records in, constants with intervals out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Literal

import numpy as np

from greybox.errors import FitError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.experiment.holes import refuse_long_holes
from greybox.fitting.alias import moves
from greybox.fitting.asked import asked
from greybox.fitting.estimates import (
    estimates,
    fitted,
    model_covariance,
    own_estimates,
    prior_checks,
    tied_estimates,
)
from greybox.fitting.halving import discretisation_shift, polished
from greybox.fitting.notes import elsewhere, meaning, notes, with_records
from greybox.fitting.options import FitOptions, Report, options_given
from greybox.fitting.predictive import fit_by_prediction
from greybox.fitting.problem import prepare
from greybox.fitting.robust import outlying, robustly
from greybox.fitting.sandwich import colour_of
from greybox.fitting.solve import Solution, solve
from greybox.fitting.traces import misfits, named_noise, traces
from greybox.fitting.uncertainty import uncertainty
from greybox.fitting.validate import validate
from greybox.fitting.versions import versions
from greybox.model import Model
from greybox.model.show import equations
from greybox.noise import AutoRegression, Noise
from greybox.noise.hierarchy import LEAST_NOISE, RESIDUAL
from greybox.result import (
    Fit,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    Provenance,
    RobustLoss,
    SolverReport,
)
from greybox.transcription.records import experiments_of

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
    own: Sequence[str] = (),
    initial: Sequence[Mapping[str, float]] = (),
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

    ``own``: constants of which each experiment has a value of its own (``own=["B"]``): `Fit.own` has them all, ``parameters`` and the
    fitted model their mean, which is what a validation uses. Priors of constants (`Model.prior`) are weighed as measurements.
    ``options.loss`` makes the fit robust against outliers; the noise is then estimated so that they do not pass for it.
    The constants begin at the values of ``model`` (`Model.start`), each record's estimated initial state at the declared values, or at
    the first readings of an output that is a state. ``initial`` begins it elsewhere: one mapping from state to value for each
    experiment, in their order; states left out begin as without it. Where a former fit ended: ``fit(former.model, experiments,
    initial=[t.initial_state for t in former.traces])``, with ``FitOptions(progressive=False)`` so that nothing leads away from there.
    A model with process noise (`State`) is fitted by its likelihood through a Kalman filter instead (`Fit.process_noise`).
    ``validation``: records that are only judged (`validate`), without their first ``skip`` rows. ``report`` is called as the
    fit goes on. ``raise_on_failure`` raises FitError where the fit does not succeed.

    Raises DataError and ModelError for records, or initial states, that do not go with the model.
    """
    options = options_given(options)
    options = replace(options, own=(*options.own, *((own,) if isinstance(own, str) else own)))
    if colour not in COLOURINGS:
        raise ModelError(f"unknown colour {colour!r}; {nearest(colour, COLOURINGS)}")
    judges = experiments_of(validation) if validation else ()  # refused before the work is done, and not after it
    if model.noisy_states:
        if colour == "residual":
            raise ModelError(
                "colour 'residual': process noise is what makes the innovations white; leave out the colour, or the process noise"
            )
        if options.transcription not in ("automatic", "single") or options.arc_length:
            raise ModelError(
                f"transcription {options.transcription!r}: a model with process noise is fitted by its one-step predictions, which have"
                " none; leave out transcription and arc_length, or the process noise"
            )
        result = fit_by_prediction(model, experiments, noise, quiet, options, report, initial)
        return _judged(result, judges, skip, options, raise_on_failure)
    problem = prepare(
        model, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, quiet=quiet,
        own=options.own, robust=options.robust, initial=initial,
    )  # fmt: skip
    if not problem.step.per_interval:
        refuse_long_holes(judges)
    if colour == "white":
        problem = problem.with_noise(replace(problem.noise, colour=tuple(AutoRegression() for _ in model.outputs)))
    solution = solve(problem, options, report)
    if RESIDUAL in problem.noise.sources.values() and solution.status.success:
        solution = _weighted_by_residual(solution, options, report)
    solution = robustly(solution, options, report)
    if colour == "residual" and solution.status.success:
        solution = robustly(_coloured_by_residual(solution, options, report), options, report)
    solution = polished(solution)
    return _judged(_result(model, solution, options), judges, skip, options, raise_on_failure)


def _judged(
    result: Fit, validation: Experiment | Sequence[Experiment], skip: int, options: FitOptions, raise_on_failure: bool
) -> Fit:
    """``result`` with its misfit on validation records; FitError for a failure that is to be raised."""
    if validation and result.success:
        judged = validate(result.model, validation, noise=result.noise.std, skip=skip, options=options)
        result = replace(result, validation=judged, notes=(*result.notes, *elsewhere(result.misfit, judged.misfit)))
    if raise_on_failure and not result.success:
        raise FitError(f"fit of {result.model.title}: {result.solver.meaning}")
    return result


def _weighted_by_residual(solution: Solution, options: FitOptions, report: Report | None) -> Solution:
    """The fit repeated with the residual's own size as the noise of the outputs whose noise nothing else tells."""
    problem, evaluation = solution.problem, solution.evaluation
    counts = np.maximum(evaluation.counts, 1)
    size = np.sqrt(evaluation.squares / counts * evaluation.count / max(evaluation.count - solution.unknowns, 1))
    told = np.array([problem.noise.sources.get(o.name) == RESIDUAL for o in problem.model.outputs])
    std = problem.noise.std * np.where(told & (size > 0), np.maximum(size, LEAST_NOISE), 1.0)
    weighted = replace(problem.with_noise(replace(problem.noise, std=std)), variables=solution.variables)
    return solve(weighted, replace(options, progressive=False), report)


def _coloured_by_residual(solution: Solution, options: FitOptions, report: Report | None) -> Solution:
    """The fit repeated with the noise coloured as the residual is, where its colour is not known already."""
    problem, variables = solution.problem, solution.variables
    residual = colour_of(solution.residuals(), solution.unknowns, problem.noise.given)
    models = tuple(
        known if known.order else found for known, found in zip(problem.noise.colour, residual.models, strict=True)
    )
    if all(a is b for a, b in zip(models, problem.noise.colour, strict=True)):
        return solution
    coloured = replace(problem.with_noise(replace(problem.noise, colour=models)), variables=variables)
    return solve(coloured, replace(options, progressive=False), report)


def _result(model: Model, solution: Solution, options: FitOptions) -> Fit:
    problem, variables = solution.problem, solution.variables
    runs, rows = traces(problem, solution.simulate()), solution.residuals()
    misfit = misfits(problem, runs)
    found = uncertainty(variables, solution.evaluation, problem.noise.given, rows, solution.unknowns, problem.least)
    constants, priors, robust = estimates(variables, found), prior_checks(variables, found), outlying(solution)
    own, tied = own_estimates(variables, found), tied_estimates(variables, found)
    shift = discretisation_shift(solution, np.sqrt(np.diag(found.covariance)))
    remarks = notes(solution, found, constants, misfit, runs, moves(solution, rows), shift)
    remarks = with_records((*remarks, *asked(problem, constants, tied, own, priors, robust)), problem.experiments)
    measured = [j for j, o in enumerate(model.outputs) if o.name in misfit]
    widened = np.ones(len(variables.names)) if found.inflation is None else found.inflation
    return Fit(
        model=model.start(**{name: float(variables.fixed[k]) for k, name in enumerate(model.values)}),
        parameters=constants,
        misfit=misfit,
        traces=runs,
        solver=SolverReport(
            solution.status.name.lower(),
            solution.status.success,
            meaning(solution, misfit),
            float(solution.evaluation.cost),
            _statistics(solution),
        ),
        noise=FitNoise(
            named_noise(problem, misfit),
            problem.noise.source,
            dict(problem.noise.sources),
            {
                o.name: a.reflection
                for o, a in zip(model.outputs, problem.noise.colour, strict=True)
                if o.name in misfit
            },
        ),
        uncertainty=FitUncertainty(
            tuple(model.all_parameters[k].name for k in fitted(variables)),
            model_covariance(variables, found.covariance),
            found.kind,
            dict(zip(variables.names, widened.tolist(), strict=True)),
        ),
        discretisation=FitDiscretisation(
            solution.discretisation or problem.step.label,
            {model.outputs[j].name: float(solution.integration_error[j]) for j in measured},
            dict(zip(variables.names, shift.tolist(), strict=True)),
        ),
        provenance=Provenance({**asdict(options), "own": list(options.own)}, equations(model), versions()),
        constraints=FitConstraints({tie.name: tie.formula for tie in model.ties}, tied, own, priors),
        robust=RobustLoss(robust.loss, robust.scale, robust.outliers),
        notes=remarks,
    )


def _statistics(solution: Solution) -> dict[str, object]:
    return {
        "optimiser": "IPOPT", "ipopt_status": solution.solver_status, "iterations": solution.iterations,
        "passes": solution.evaluations, "seconds": solution.seconds, "record_shares": list(solution.shares),
        "strategy": solution.strategy, "transcription": solution.transcription, "free_run": solution.free_run,
        "method": solution.problem.method,
        "kernel": solution.problem.kernel.name, "substeps": solution.problem.step.substeps,
    }  # fmt: skip
