"""`fit`: a model and records in, parameters with intervals out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.errors import FitError, ModelError, nearest
from greybox.estimation.covariance import estimate_covariance
from greybox.estimation.estimates import (
    check_priors,
    locate_fitted,
    to_estimates,
    to_experiment_estimates,
    to_model_covariance,
    to_tied_estimates,
)
from greybox.estimation.fit_issues import (
    add_record_findings,
    find_fit_issues,
    find_option_issues,
    find_status_details,
    find_validation_issues,
)
from greybox.estimation.options import ColourTreatment, FitOptions, resolve_options
from greybox.estimation.parameter_constancy import find_solution_shifts
from greybox.estimation.prediction_error_fit import fit_by_prediction
from greybox.estimation.robust_estimation import refit_robustly, summarise_outliers
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.estimation.step_size_sensitivity import measure_discretisation_shift, polish_by_gauss_newton
from greybox.estimation.traces import compute_misfits, make_traces, to_noise_by_output
from greybox.estimation.validate import validate
from greybox.estimation.versions import read_versions
from greybox.experiment import Experiment
from greybox.experiment.time_gaps import refuse_long_time_gaps
from greybox.model import Model
from greybox.model.equations import equations_text
from greybox.noise import AutoRegression, NoiseModel, NoiseSource
from greybox.result import (
    Fit,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    Provenance,
    SolverReport,
)
from greybox.transcription.policy import JoiningPolicy
from greybox.transcription.problem import prepare_problem
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.records import to_experiments
from greybox.transcription.solve import Solution, solve


def fit(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | NoiseModel | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: ColourTreatment | str = ColourTreatment.KNOWN,
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    per_experiment: Sequence[str] = (),
    initial: Sequence[Mapping[str, float]] = (),
    options: FitOptions | None = None,
    report: FitProgressCallback | None = None,
    raise_on_failure: bool = False,
) -> Fit:
    """Fit the free parameters of a model to one or more experiments.

    Minimises the sum of squared free-run errors, each output over its noise standard deviation, ``sum ((y - yhat) / noise)^2``, over
    the free parameters and each experiment's initial state, with IPOPT and a Gauss-Newton Hessian. A model with process noise
    (`State`) is fitted by its likelihood through a Kalman filter instead. Priors of parameters (`Model.prior`) are weighed as
    measurements. The parameters start at the values of ``model`` (`Model.start`), each record's estimated initial state at the declared
    values, or at the first readings of an output that is a state.

    Parameters
    ----------
    model
        The model; it is not changed.
    experiments
        Estimation records.
    noise
        Standard deviation by output in the model's units, or a `NoiseModel` that is known already. Outputs left out are estimated, in
        this order of trust: from ``quiet`` records, from repetition in the records (a periodic input, several experiments with the same
        input), from high-order differences. Quiet records and repetition show the noise's colour as well: then residual and
        sensitivities are whitened by its autoregression, which is maximum likelihood for such noise.
    quiet
        Records with the input at rest and the same columns: they show the noise alone.
    colour
        ``known`` whitens where the colour of the noise is known; ``residual`` takes it from the residual of a first fit where it is not
        (right only if the model lacks nothing); ``white`` never whitens. Where the residual stays coloured the intervals allow for it
        (`FitUncertainty.kind`).
    validation
        Records that are only judged, see `validate`.
    skip
        Rows at the beginning of each validation record that the errors leave out.
    per_experiment
        Parameters of which each experiment has a value of its own, ``per_experiment=["B"]``. `FitConstraints.per_experiment` has them
        all, `Fit.parameters` and the fitted model their mean, which a validation uses.
    initial
        Initial states to start from: one mapping from state to value for each experiment, in their order; states left out start as
        without it. To start where a former fit ended, ``[t.initial_state for t in former.traces]`` together with
        ``FitOptions(progressive=False)``.
    options
        Discretisation, transcription, robust loss and more.
    report
        Called with a `FitProgress` as the fit goes on.
    raise_on_failure
        Raise FitError if the fit does not succeed, instead of returning a fit whose ``success`` is False.

    Returns
    -------
    Fit
        The fitted model, parameters with 95 % intervals, misfit, runs, and what to know before trusting them.

    Raises
    ------
    DataError, ModelError
        For records, or initial states, that do not go with the model.
    FitError
        With ``raise_on_failure``.

    Examples
    --------
    >>> result = fit(micro_actuator.fix("M", "Ra"), record)  # doctest: +SKIP
    >>> result.parameters["K"].interval  # doctest: +SKIP
    (5895.26, 5895.67)
    """
    options = resolve_options(options)
    names = (per_experiment,) if isinstance(per_experiment, str) else per_experiment
    options = replace(options, per_experiment=(*options.per_experiment, *names))
    if colour not in list(ColourTreatment):
        raise ModelError(f"unknown colour {colour!r}; {nearest(colour, list(map(str, ColourTreatment)))}")
    judges = to_experiments(validation) if validation else ()  # refused before the work is done, and not after it
    if model.noisy_states:
        if colour == ColourTreatment.RESIDUAL:
            raise ModelError(
                "colour 'residual': process noise makes the innovations white; leave out the colour, or the process noise"
            )
        result = fit_by_prediction(model, experiments, noise, quiet, options, report, initial)
        return _add_validation(result, judges, skip, options, raise_on_failure)
    problem = prepare_problem(
        model,
        experiments,
        noise,
        at_rest=options.at_rest,
        method=options.method,
        substeps=options.substeps,
        quiet=quiet,
        per_experiment=options.per_experiment,
        robust=options.robust,
        initial=initial,
        policy=options.policy,
    )
    if not problem.step.per_interval:
        refuse_long_time_gaps(judges)
    if colour == ColourTreatment.WHITE:
        problem = problem.with_noise(replace(problem.noise, colour=tuple(AutoRegression() for _ in model.outputs)))
    solution = solve(problem, options, report)
    if NoiseSource.RESIDUAL in problem.noise.sources.values() and solution.status.success:
        solution = _weigh_by_residual(solution, options, report)
    solution = refit_robustly(solution, options, report)
    if colour == ColourTreatment.RESIDUAL and solution.status.success:
        solution = refit_robustly(_whiten_by_residual(solution, options, report), options, report)
    solution = polish_by_gauss_newton(solution, options.policy.convergence)
    return _add_validation(_to_fit(model, solution, options), judges, skip, options, raise_on_failure)


def _add_validation(
    result: Fit, validation: Experiment | Sequence[Experiment], skip: int, options: FitOptions, raise_on_failure: bool
) -> Fit:
    """``result`` with its misfit on validation records; FitError for a failure that is to be raised."""
    if validation and result.success:
        judged = validate(result.model, validation, noise=result.noise.std, skip=skip, options=options)
        issues = find_validation_issues(result.misfit, judged.misfit, options.policy)
        result = replace(result, validation=judged, findings=(*result.findings, *issues))
    if raise_on_failure and not result.success:
        raise FitError(f"fit of {result.model.title}: {result.solver.status_message}")
    return result


def _weigh_by_residual(solution: Solution, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """The fit repeated with the residual's own size as the noise of the outputs whose noise nothing else tells."""
    problem, evaluation = solution.problem, solution.evaluation
    counts = np.maximum(evaluation.counts, 1)
    size = np.sqrt(evaluation.squares / counts * evaluation.count / max(evaluation.count - solution.unknowns, 1))
    by_residual = np.array([problem.noise.sources.get(o.name) is NoiseSource.RESIDUAL for o in problem.model.outputs])
    least = options.policy.noise.min_relative_level
    std = problem.noise.std * np.where(by_residual & (size > 0), np.maximum(size, least), 1.0)
    weighted = replace(problem.with_noise(replace(problem.noise, std=std)), variables=solution.variables)
    return solve(weighted, replace(options, progressive=False), report)


def _whiten_by_residual(solution: Solution, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """The fit repeated with the noise coloured as the residual is, where its colour is not known already."""
    problem, variables = solution.problem, solution.variables
    residual = estimate_residual_colour(
        solution.residuals(),
        solution.unknowns,
        problem.noise.known,
        policy=options.policy.intervals,
        noise_policy=options.policy.noise,
    )
    models = tuple(
        known if known.order else estimated
        for known, estimated in zip(problem.noise.colour, residual.models, strict=True)
    )
    if all(a is b for a, b in zip(models, problem.noise.colour, strict=True)):
        return solution
    coloured = replace(problem.with_noise(replace(problem.noise, colour=models)), variables=variables)
    return solve(coloured, replace(options, progressive=False), report)


def _to_fit(model: Model, solution: Solution, options: FitOptions) -> Fit:
    problem, variables, policy = solution.problem, solution.variables, options.policy
    traces, rows = make_traces(problem, solution.simulate()), solution.residuals()
    misfit = compute_misfits(problem, traces)
    covariance = estimate_covariance(
        variables,
        solution.evaluation,
        problem.noise.known,
        rows,
        solution.unknowns,
        problem.variance_floor,
        policy.intervals,
        policy.noise,
    )
    parameters, priors = to_estimates(variables, covariance), check_priors(variables, covariance)
    per_experiment, tied = to_experiment_estimates(variables, covariance), to_tied_estimates(variables, covariance)
    robust = summarise_outliers(solution)
    step_shift = measure_discretisation_shift(solution, np.sqrt(np.diag(covariance.covariance)))
    shifts = find_solution_shifts(solution, rows, policy)
    findings = (
        *find_fit_issues(solution, covariance, parameters, misfit, traces, shifts, step_shift, policy),
        *find_option_issues(problem, tied, per_experiment, priors, robust, policy),
    )
    measured = [j for j, o in enumerate(model.outputs) if o.name in misfit]
    inflation = np.ones(len(variables.names)) if covariance.inflation is None else covariance.inflation
    return Fit(
        model=model.start(**{name: float(variables.fixed[k]) for k, name in enumerate(model.values)}),
        parameters=parameters,
        misfit=misfit,
        traces=traces,
        solver=SolverReport(
            str(solution.status),
            solution.status.success,
            float(solution.evaluation.cost),
            _collect_statistics(solution, options.policy.joining),
            solution.strategy,
            find_status_details(solution, misfit),
        ),
        noise=FitNoise(
            to_noise_by_output(problem, misfit),
            dict(problem.noise.sources),
            {
                o.name: a.reflection
                for o, a in zip(model.outputs, problem.noise.colour, strict=True)
                if o.name in misfit
            },
            bounds={
                o.name: replace(bound, level=float(problem.noise.std[j]))
                for j, o in enumerate(model.outputs)
                if o.name in misfit and (bound := problem.noise.bound(o.name)) is not None
            },
        ),
        uncertainty=FitUncertainty(
            tuple(model.all_parameters[k].name for k in locate_fitted(variables)),
            to_model_covariance(variables, covariance.covariance),
            covariance.kind,
            dict(zip(variables.names, inflation.tolist(), strict=True)),
        ),
        discretisation=FitDiscretisation(
            solution.discretisation or problem.step.label,
            {model.outputs[j].name: float(solution.integration_error[j]) for j in measured},
            dict(zip(variables.names, step_shift.tolist(), strict=True)),
        ),
        provenance=Provenance(options.to_data(), equations_text(model), read_versions()),
        constraints=FitConstraints({tie.name: tie.formula for tie in model.ties}, tied, per_experiment, priors),
        robust=robust,
        findings=add_record_findings(findings, problem.experiments),
    )


def _collect_statistics(solution: Solution, policy: JoiningPolicy) -> dict[str, object]:
    return {
        "optimiser": "IPOPT",
        "ipopt_status": solution.solver_status,
        "iterations": solution.iterations,
        "passes": solution.evaluations,
        "seconds": solution.seconds,
        "record_shares": list(solution.shares),
        "transcription": solution.transcription,
        "free_run": solution.is_free_run(policy),
        "method": solution.problem.method,
        "kernel": solution.problem.kernel.name,
        "substeps": solution.problem.step.substeps,
    }
