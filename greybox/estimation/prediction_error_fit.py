"""Fitting a model with process noise by the error of its predictions: maximum likelihood through a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.errors import ModelError
from greybox.estimation.covariance import LikelihoodCovariance, estimate_likelihood_covariance
from greybox.estimation.estimates import (
    check_priors,
    to_estimates,
    to_experiment_estimates,
    to_model_covariance,
    to_tied_estimates,
)
from greybox.estimation.fit_issues import (
    add_record_findings,
    find_likelihood_issues,
    find_likelihood_status_details,
    find_option_issues,
)
from greybox.estimation.likelihood_search import (
    LikelihoodOptimum,
    compute_scoring_step,
    maximise_likelihood,
    select_best_start,
)
from greybox.estimation.options import FitOptions
from greybox.estimation.parameter_constancy import ConstancyInput, ParameterShift, find_parameter_shifts
from greybox.estimation.policy import EstimationPolicy
from greybox.estimation.prediction_error import (
    PredictionErrorObjective,
    Runs,
    compute_free_runs,
    compute_innovations,
    compute_one_step_runs,
    make_likelihood_unknowns,
)
from greybox.estimation.process_noise_tests import (
    ProcessNoiseTest,
    compute_largest_intensities,
    drop_insignificant,
    guess_intensities,
    likelihood_ratio_tests,
)
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.estimation.traces import compute_misfits, make_traces
from greybox.estimation.versions import read_versions
from greybox.experiment import Experiment
from greybox.filtering import KalmanFilter
from greybox.model import Model
from greybox.model.equations import equations_text
from greybox.noise import NoiseModel, NoiseSource
from greybox.result import (
    Estimate,
    Fit,
    FitConstraints,
    FitDiscretisation,
    FitNoise,
    FitUncertainty,
    PredictionReport,
    Provenance,
    RobustReport,
    SolverReport,
)
from greybox.transcription import DecisionVector
from greybox.transcription.options import Transcription
from greybox.transcription.problem import EstimationProblem, prepare_problem
from greybox.transcription.progress import FitProgressCallback
from greybox.transcription.solution import Solution
from greybox.transcription.solve import solve
from greybox.transcription.strategy import make_strategy


@dataclass(frozen=True)
class MaximumLikelihoodEstimate:
    """The ``optimum`` of the likelihood, from the fit by simulation error ``solution``; ``names`` of the intensities that were
    estimated, those of them that are ``zero``, and for each the size that would explain all movement by chance.
    """

    solution: Solution
    optimum: LikelihoodOptimum
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
    """Search the unknowns of ``model`` from its fit by simulation error, or from its start values where those are more likely."""
    _check_options(options)
    names = tuple(q.name for q in model.free_parameters if q.name in model.noise_parameters)
    undriven = model.fix(*names)  # a free run knows nothing of the intensities
    problem = prepare_problem(
        undriven,
        experiments,
        noise,
        at_rest=options.at_rest,
        method=options.method,
        substeps=options.substeps,
        quiet=quiet,
        per_experiment=options.per_experiment,
        initial=initial,
        policy=options.policy,
    )
    solution = solve(problem, options, report)
    sizes = compute_largest_intensities(model, _compute_state_changes(solution))
    starts = [
        guess_intensities(start, names, sizes, options.policy.process_noise)
        for start in _make_starts(model, names, sizes, solution, options.policy)
    ]
    optimum = maximise_likelihood(select_best_start(starts), options, report)
    if not optimum.status.success:
        return MaximumLikelihoodEstimate(solution, optimum, names, (), sizes)
    may_be_zero = [n for n in names if model.parameter(n).bounds[0] == 0]
    optimum, zero = drop_insignificant(optimum, may_be_zero, options)
    return MaximumLikelihoodEstimate(solution, optimum, names, zero, sizes)


def _check_options(options: FitOptions) -> None:
    if options.loss != "squares":
        raise ModelError(
            f"loss {options.loss!r}: a model with process noise is fitted by its likelihood, which is that of normal noise; leave out"
            " the loss, or the process noise"
        )
    if options.transcription not in (Transcription.AUTOMATIC, Transcription.SINGLE) or options.arc_length:
        raise ModelError(
            f"transcription {options.transcription!r}: a model with process noise is fitted by its one-step predictions, which have"
            " none; leave out transcription and arc_length, or the process noise"
        )


def _compute_state_changes(solution: Solution) -> np.ndarray:
    """Change of each state (nx,) from row to row over the root of the interval, root mean square over the free runs."""
    changes = [
        np.diff(x, axis=0) / np.sqrt(r.h)[:, None]
        for (_, x), r in zip(solution.simulate(), solution.problem.records, strict=True)
    ]
    whole = np.concatenate(changes)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.sqrt(np.nanmean(np.where(np.isfinite(whole), whole, np.nan) ** 2, axis=0))


def _make_starts(
    model: Model, names: Sequence[str], sizes: Mapping[str, float], solution: Solution, policy: EstimationPolicy
) -> list[PredictionErrorObjective]:
    """The likelihood at the fit by simulation error, where there is one, and at the start values."""
    problem = solution.problem
    working = model
    for name in names:
        low, high = model.parameter(name).bounds
        floor = max(low, policy.process_noise.floor * sizes[name])
        value = model.values[name] or 1e-3 * sizes[name]
        working = working.start(**{name: float(np.clip(value, min(floor, high / 2), high))})
        working = working.bound(**{name: (min(floor, high / 2), high)})
    known_start = not problem.variables.initial.free.any()
    kalman = KalmanFilter.of(working.system, problem.step, known_start=known_start)
    given = [e.conditions for e in problem.experiments]
    conditions = given if any(given) else ()
    costs = []
    for start in (solution.variables, problem.variables) if solution.status.success else (problem.variables,):
        values = dict(zip(start.names, start.base, strict=True))
        per_experiment = tuple({q.name for q, owner in zip(start.quantities, start.owner, strict=True) if owner >= 0})
        variables = DecisionVector.of(
            working, start.initial, conditions, per_experiment, [e.name for e in problem.experiments]
        )
        unknowns = make_likelihood_unknowns(problem, variables.with_values(values), policy.likelihood_search)
        costs.append(PredictionErrorObjective(unknowns, kalman, problem.records))
    return costs


def fit_by_prediction(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    quiet: Experiment | Sequence[Experiment],
    options: FitOptions,
    report: FitProgressCallback | None = None,
    initial: Sequence[Mapping[str, float]] = (),
) -> Fit:
    """The most likely parameters, intensities of process noise, measurement noise and first states of ``model``.

    The likelihood is that of the innovations of a Kalman filter, exact for a linear model, extended otherwise (Astrom 1970; Kristensen,
    Madsen, Jorgensen, Automatica 40, 2004). Noise of the outputs that is given, or known from a quiet record, is taken as it is,
    other noise is estimated with the rest. The search starts from the fit by simulation error, or from the start values where those
    are more likely; ``initial`` as in `greybox.fit`. An intensity for which zero is as likely becomes zero; with all at zero the fit is
    the one by simulation error.

    Raises ModelError for a robust loss or a transcription, which have no meaning here.
    """
    estimate = maximum_likelihood_estimate(model, experiments, noise, quiet, options, report, initial)
    optimum = estimate.optimum
    tests: tuple[ProcessNoiseTest, ...] = ()
    if optimum.status.success:
        tests = likelihood_ratio_tests(optimum, estimate.names, estimate.zero, estimate.sizes, options)
    return _to_fit(model, estimate.solution, optimum, tests, options)


def _to_fit(
    model: Model,
    solution: Solution,
    optimum: LikelihoodOptimum,
    tests: Sequence[ProcessNoiseTest],
    options: FitOptions,
) -> Fit:
    objective, policy = optimum.cost, options.policy
    unknowns, variables = objective.unknowns, objective.unknowns.variables
    problem = solution.problem.with_noise(replace(solution.problem.noise, std=unknowns.level))
    free_runs = compute_free_runs(objective)
    traces = make_traces(problem, free_runs)
    misfit = compute_misfits(problem, traces)
    one_step = compute_misfits(problem, make_traces(problem, compute_one_step_runs(objective)))
    covariance = estimate_likelihood_covariance(optimum, policy.intervals, policy.noise)
    constants = covariance.constants
    fitted = model.start(**{name: float(v) for name, v in zip(model.values, variables.fixed, strict=True)})
    parameters = _set_limits(to_estimates(variables, constants), tests)
    inflation = np.ones(len(variables.names)) if constants.inflation is None else constants.inflation
    step_shift = _compute_step_shift(optimum, covariance)
    free, matrix = _order_covariance(model, variables, covariance)
    per_experiment, tied = to_experiment_estimates(variables, constants), to_tied_estimates(variables, constants)
    priors = check_priors(variables, constants)
    shifts = _find_shifts(problem, optimum, free_runs, policy)
    findings = (
        *find_likelihood_issues(fitted, problem, covariance, parameters, tests, step_shift, shifts, policy),
        *find_option_issues(problem, tied, per_experiment, priors, RobustReport(), policy),
    )
    sources = {
        output: NoiseSource.INNOVATIONS if unknowns.estimated[j] else problem.noise.sources[output]
        for j, output in enumerate(model.system.output_names)
        if unknowns.estimated[j] or output in problem.noise.sources
    }
    estimated = [(j, o) for j, o in enumerate(model.outputs) if unknowns.estimated[j]]
    measured = [(j, output) for j, output in enumerate(model.system.output_names) if output in misfit]
    return Fit(
        model=fitted,
        parameters=parameters,
        misfit=misfit,
        traces=traces,
        solver=SolverReport(
            str(optimum.status),
            optimum.status.success,
            float(optimum.evaluation.cost),
            _collect_statistics(solution, optimum),
            make_strategy("prediction", exact=_is_exact(solution)),
            find_likelihood_status_details(optimum, one_step, misfit),
        ),
        noise=FitNoise(
            {output: float(unknowns.level[j]) for j, output in measured},
            sources,
            dict.fromkeys(misfit, ()),
            {o.name: float(covariance.noise[j]) for j, o in estimated},
            {o.name: o.unit for _, o in estimated},
        ),
        uncertainty=FitUncertainty(
            free, matrix, constants.kind, dict(zip(variables.names, inflation.tolist(), strict=True))
        ),
        discretisation=FitDiscretisation(
            objective.kalman.filter_step.label,
            {output: float(solution.integration_error[j]) for j, output in measured},
            step_shift,
        ),
        provenance=Provenance(options.to_data(), equations_text(model), read_versions()),
        constraints=FitConstraints({tie.name: tie.formula for tie in model.ties}, tied, per_experiment, priors),
        prediction=PredictionReport(
            {state: value for state, value in fitted.noise_intensities.items() if state in model.noisy_states},
            one_step,
            optimum.likelihood if np.isfinite(optimum.likelihood) else None,
        ),
        findings=add_record_findings(findings, problem.experiments),
    )


def _set_limits(parameters: dict[str, Estimate], tests: Sequence[ProcessNoiseTest]) -> dict[str, Estimate]:
    """Intensities that are zero, or not certainly more, with their limit in place of an interval that cannot reach zero."""
    limited = dict(parameters)
    for test in tests:
        if test.value == 0:
            limited[test.name] = Estimate(0.0, parameters[test.name].unit, None, test.limits, False, True)
        elif test.limits is not None:
            limited[test.name] = replace(parameters[test.name], interval=test.limits)
    return limited


def _order_covariance(
    model: Model, variables: DecisionVector, covariance: LikelihoodCovariance
) -> tuple[tuple[str, ...], np.ndarray]:
    """The parameters that were free in the order of the model, and their covariance; NaN for an intensity that became zero."""
    estimated = [model.all_parameters[k].name for k in dict.fromkeys(variables.which.tolist())]
    zero = [q.name for q in model.free_parameters if q.name in model.noise_parameters and q.name not in estimated]
    free = tuple(q.name for q in model.all_parameters if q.name in (*estimated, *zero))
    matrix = np.full((len(free), len(free)), np.nan)
    places = [free.index(name) for name in estimated]
    matrix[np.ix_(places, places)] = to_model_covariance(variables, covariance.constants.covariance)
    return free, matrix


def _compute_step_shift(optimum: LikelihoodOptimum, covariance: LikelihoodCovariance) -> dict[str, float]:
    """Change of each parameter when the step is halved, in its standard deviations; 0 for an exact discretisation."""
    objective = optimum.cost
    variables = objective.unknowns.variables
    n = len(variables.which)
    if objective.kalman.step.per_interval or not n or not optimum.status.success:
        return dict.fromkeys(variables.names, 0.0)
    finer = replace(objective, kalman=objective.kalman.with_substeps(2 * objective.kalman.step.substeps))
    after = finer.evaluate(np.zeros(objective.unknowns.size))
    if not np.isfinite(after.cost):
        return dict.fromkeys(variables.names, float("nan"))
    bounds = objective.unknowns.bounds()
    change = np.subtract(*(compute_scoring_step(e, *bounds) for e in (after, optimum.evaluation)))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.abs(change[:n] * variables.spans) / np.sqrt(np.diag(covariance.constants.covariance))
    return dict(zip(variables.names, share.tolist(), strict=True))


def _find_shifts(
    problem: EstimationProblem, optimum: LikelihoodOptimum, runs: Runs, policy: EstimationPolicy
) -> list[ParameterShift]:
    """Parameters that are not constant, by the innovations; not the intensities, which these tell by their size alone."""
    if not optimum.status.success:
        return []
    rows = tuple((e, mean) for e, mean, _ in compute_innovations(optimum.cost).rows)
    outputs = [record.samples(y) for record, (y, _) in zip(problem.records, runs, strict=True)]
    tested = ConstancyInput(
        optimum.cost.unknowns.variables,
        [e.name for e in problem.experiments],
        outputs,
        estimate_residual_colour(rows, 0, True, policy=policy.intervals, noise_policy=policy.noise),
        problem.model.noise_parameters,
    )
    return find_parameter_shifts(tested, rows, policy.constancy)


def _is_exact(solution: Solution) -> bool:
    """Whether the Kalman filter is exact: for a linear model and an exact discretisation."""
    return bool(solution.problem.model.system.linear and solution.problem.step.per_interval)


def _collect_statistics(solution: Solution, optimum: LikelihoodOptimum) -> dict[str, object]:
    return {
        "optimiser": "IPOPT",
        "ipopt_status": optimum.word,
        "iterations": optimum.iterations,
        "passes": optimum.evaluations,
        "seconds": optimum.seconds,
        "record_shares": [1.0],
        "transcription": "prediction",
        "free_run": False,
        "method": solution.problem.method,
        "kernel": optimum.cost.kalman.kernel.name,
        "substeps": solution.problem.step.substeps,
    }
