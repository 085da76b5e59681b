"""`fit`: a model and records in, parameters with intervals out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base import TINY, Finding, FitError, ModelError, nearest, read_versions
from greybox.base.interrupts import hold_interrupts
from greybox.data.experiment import Experiment, collect_record_findings, find_usual_interval, refuse_long_time_gaps
from greybox.data.findings import RecordCode
from greybox.data.identity import mark_fitted, refuse_repeated
from greybox.data.noise import GrowingNoise, NoiseModel, NoiseSource
from greybox.data.read import as_experiments
from greybox.estimation import result_parts
from greybox.estimation.covariance import (
    check_priors,
    compute_quantile,
    locate_fitted,
    to_estimates,
    to_experiment_estimates,
    to_model_covariance,
    to_tied_estimates,
)
from greybox.estimation.exchange import find_exchange
from greybox.estimation.findings import (
    PAIRED_RECORDS,
    EstimationCode,
    add_record_findings,
    find_fit_issues,
    find_foreign_conditions,
    find_option_issues,
    find_prior_conflicts,
    find_record_trends,
    find_status_details,
    find_step_issues,
    find_validation_issues,
    list_shared_noise,
)
from greybox.estimation.noise_loop import (
    StartCost,
    keep_best,
    summarise_outliers,
)
from greybox.estimation.optimum import Optimum, PredictionOptimum, SimulationOptimum
from greybox.estimation.options import ColourTreatment, FitOptions, explain_unknown, resolve_options
from greybox.estimation.prediction_error import (
    estimate_by_prediction_error,
    likelihood_ratio_tests,
    set_intensity_limits,
)
from greybox.estimation.reading_errors import find_mistaken_units, find_reading_errors
from greybox.estimation.result import Fit
from greybox.estimation.starts import StartSearch, search_from_starts
from greybox.estimation.transcription.preparation import begin_with_known_past, prepare_problem
from greybox.estimation.transcription.problem import Completion, EstimationProblem, FitProgressCallback, make_strategy
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.estimation.transcription.single_shooting import solve_single_shooting
from greybox.estimation.validate import validate
from greybox.model import Model, equations_text
from greybox.model.effects.scales import (
    bound_delays,
    list_delays_at_limit,
)
from greybox.model.equations import declare
from greybox.simulation.plant import Plant, PlantModel, as_model
from greybox.simulation.plant_kernel import PlantKernel
from greybox.simulation.records import to_experiments


@explain_unknown
def fit(
    model: Model | Plant,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float | str | GrowingNoise] | NoiseModel | None = None,
    quiet: Experiment | Sequence[Experiment] = (),
    colour: ColourTreatment | str = ColourTreatment.KNOWN,
    validation: Experiment | Sequence[Experiment] = (),
    skip: int = 0,
    beginning: int = 0,
    per_experiment: Sequence[str] = (),
    initial: Sequence[Mapping[str, float]] = (),
    options: FitOptions | None = None,
    report: FitProgressCallback | None = None,
    raise_on_failure: bool = False,
) -> Fit:
    """Fit the free parameters of a model, or of a plant that is run from outside, to one or more experiments.

    Minimises the sum of squared free-run errors, each over its noise standard deviation (that of the output, or of the row where
    `Experiment.noise` tells it), ``sum ((y - yhat) / noise)^2``, over
    the free parameters and each experiment's initial state, with IPOPT and a Gauss-Newton Hessian. A model with process noise
    (`State`) is fitted by its likelihood through a Kalman filter instead. Priors of parameters (`Model.prior`) are weighed as
    measurements. The parameters start at the values of ``model`` (`Model.start`); where the search from there explains nothing of an
    output, others are tried by themselves (`FitOptions.other_starts`), and the result says so. A model with effects never ends worse than
    without them: its optimum without is a start as well. Each record's estimated initial state starts at the declared values, or at the
    first readings of an output that is a state; a velocity with dry friction that is not measured, where its first rows fit best.

    Parameters
    ----------
    model
        The model; it is not changed. Or a plant without equations, such as an FMU (`greybox.simulation.plant.Plant`): then no more is run
        than is needed, and the result says how much that was (`SolverReport.statistics`).
    experiments
        Estimation records: experiments, or data frames and mappings from name to column with headers as a file has them.
    noise
        Standard deviation by output in the model's units, a `GrowingNoise` where it grows with the signal (each row is then weighed by the
        noise at the run there), or a `NoiseModel` that is known already. A text names a level that is estimated together with the
        constants, by maximum likelihood, from the residual of all outputs with that name: ``{"x1": "a", "x2": "a"}`` for two sensors
        of one kind. Of outputs left out it is what the
        experiments tell row by row, or it is estimated, in this order of trust: from ``quiet`` records, from repetition in the records (a
        periodic input, several experiments with the same input), from high-order differences. Quiet records and repetition show the noise's
        colour as well: then residual and sensitivities are whitened by its autoregression, which is maximum likelihood for such noise.
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
    beginning
        Rows from which the initial state of each validation record is estimated, not counted either; 0 for as many as `validate` takes.
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
        Called with a `FitProgress` as the fit goes on; where it returns True the fit ends, as one that was interrupted.
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
    model = as_model(model)
    options = resolve_options(options)
    names = (per_experiment,) if isinstance(per_experiment, str) else per_experiment
    options = replace(options, per_experiment=(*options.per_experiment, *names))
    if colour not in list(ColourTreatment):
        raise ModelError(f"unknown colour {colour!r}; {nearest(colour, list(map(str, ColourTreatment)))}")
    held = [q.name for q in model.parameters if q.fixed and q.prior is not None]
    model.require_unchanged()
    experiments, validation, quiet = (as_experiments(records, model) for records in (experiments, validation, quiet))
    refuse_repeated(experiments)
    # A delay may be as long as the records show it, where nobody has bounded it.
    period = find_usual_interval(to_experiments(experiments))
    model = bound_delays(model, period)
    # Refused before the work is done, and not after it.
    judges = mark_fitted(to_experiments(validation), experiments) if validation else ()
    experiments = begin_with_known_past(model, to_experiments(experiments), options)
    optimum: Optimum
    starts: tuple[result_parts.StartResult, ...] = ()
    notices: tuple[Finding, ...] = ()
    if model.noisy_states:
        if colour == ColourTreatment.RESIDUAL:
            raise ModelError(
                "colour 'residual': process noise makes the innovations white; leave out the colour, or the process noise"
            )
        given = {} if isinstance(noise, NoiseModel) or noise is None else dict(noise)
        if named := [n for n, v in given.items() if isinstance(v, str)]:
            raise ModelError(
                f"noise of {', '.join(named)}: a fit with process noise estimates the level of each output that is not given; leave the"
                " names of levels out"
            )
        known = {n: v for n, v in given.items() if isinstance(v, (int, float))}
        levels: Mapping[str, float] | NoiseModel = noise if isinstance(noise, NoiseModel) else known
        grows = bool(noise.growth) if isinstance(noise, NoiseModel) else known != given
        if grows or any(e.noise for e in to_experiments(experiments)):
            which = "that grows with the signal" if grows else "told row by row"
            raise ModelError(
                f"noise {which}: a fit with process noise takes one standard deviation for each output; leave out one of the two"
            )
        estimate = estimate_by_prediction_error(
            model, experiments, levels, options, report, quiet=quiet, initial=initial
        )
        tests = likelihood_ratio_tests(estimate, options)
        optimum = PredictionOptimum(model, estimate.solution, tests, maximum=estimate.optimum)
    else:
        problem = prepare_problem(model, experiments, noise, options, quiet=quiet, initial=initial)
        if not problem.step.per_interval:
            refuse_long_time_gaps(judges)
        with hold_interrupts() as interrupt:
            search = StartSearch(problem, experiments, options, colour, report)
            begun, optimum, starts, notices = search_from_starts(search, interrupt, goes_on=bool(initial))
            optimum = _refine_for_constants(optimum, options, report)
            # With the steps it ends with, or from where another start led, the model's own may be better again.
            if optimum is not begun and not optimum.solution.joined:
                kept = keep_best(optimum.solution, problem.variables, options, report)
                optimum = optimum if kept is optimum.solution else SimulationOptimum(model, kept)
    model.require_unchanged()
    exchange = None
    if isinstance(optimum, SimulationOptimum) and options.exchange:
        exchange = find_exchange(optimum, options)
    result = exchange.complete(assemble_fit(exchange.optimum, options)) if exchange else assemble_fit(optimum, options)
    notices = (*_list_constants_by_record(model, result.model), *notices)
    if starts or notices:
        result = replace(result, starts=starts, findings=(*notices, *result.findings))
    if longer := _lengthen_delays(model, result, period, experiments, options):
        again = fit(
            longer,
            experiments,
            noise=noise,
            quiet=quiet,
            colour=colour,
            validation=validation,
            skip=skip,
            beginning=beginning,
            options=options,
            report=report,
        )
        if again.success and sum_errors(again, result) < len(result.misfit):
            return again
    if held and result.success:
        freed = fit(result.model.free(*held), experiments, noise=noise, quiet=quiet, colour=colour, options=options)
        if freed.success:
            result = _say_what_held_would_be(result, freed, held)
    if judges and result.success:
        judged = validate(
            result.model,
            judges,
            noise=result.noise.given,
            skip=max(skip, beginning),
            initial_rows=beginning,
            options=options,
        ).over(result.noise)
        issues = (
            *(
                f
                for f in collect_record_findings(e for e in judges if e not in validation)
                if f.code == RecordCode.ALSO_FITTED
            ),
            *find_validation_issues(result, judged),
            *list_shared_noise(result.traces[:PAIRED_RECORDS], judged.traces[:PAIRED_RECORDS]),
        )
        result = replace(result, validation=judged, findings=(*result.findings, *issues))
    if raise_on_failure and not result.success:
        raise FitError(f"fit of {model.title}: {result.solver.status_message}")
    return result


# Delays, in rows, from which a longer one than at first is searched for: no two are farther apart than a factor of 1.3.
LONGER_DELAYS = (16, 20, 26, 34, 44, 57, 74, 96, 125, 150)


def _lengthen_delays(
    model: Model, result: Fit, period: float, experiments: Experiment | Sequence[Experiment], options: FitOptions
) -> Model | None:
    """The model with its delays begun where the run fits best of longer ones; None where none has ended at the first limit.

    The limit is ours and not the user's: an end there says nothing of the plant.
    """
    fitted = {q.name: result.model.values[q.name] for q in model.free_parameters}
    names = list_delays_at_limit(model, fitted, period)
    if not names or not result.success or model.noisy_states or isinstance(model, PlantModel):
        return None
    longest = LONGER_DELAYS[-1] * period
    longer = model.bound(**dict.fromkeys(names, (0.0, longest))).start(**fitted)
    # Noise that is known already: runs are compared, and nothing is fitted.
    problem = prepare_problem(longer, experiments, result.noise.std, replace(options, loss="squares"))
    begins = [fitted | dict.fromkeys(names, rows * period) for rows in LONGER_DELAYS]
    variables = [problem.variables.with_values(begin) for begin in begins]
    start_cost = StartCost(problem, options)
    costs = [start_cost.evaluate(v)[0].cost for v in variables]
    return longer.start(**begins[int(np.nanargmin(costs))])


def sum_errors(one: Fit, other: Fit) -> float:
    """The errors of one fit over those of another, summed over the outputs."""
    return sum(m.rmse / max(other.misfit[name].rmse, TINY) for name, m in one.misfit.items())


def _say_what_held_would_be(result: Fit, freed: Fit, held: Sequence[str]) -> Fit:
    """The fit, with what its records say of the constants that it holds at values known beforehand; ``freed`` is that without holding."""
    # A held constant does not move, and learns nothing.
    checks = {
        name: replace(check, shift=0.0, variance_reduction=0.0)
        for name, check in freed.constraints.priors.items()
        if name in held
    }
    constraints = replace(result.constraints, priors={**result.constraints.priors, **checks})
    issues = find_prior_conflicts(result.model, checks)
    return replace(result, constraints=constraints, findings=(*result.findings, *issues))


def _list_constants_by_record(model: Model, fitted: Model) -> Iterator[Finding]:
    """Known constants of effects that have the value which the record shows in the place of the catalogue's."""
    for q in model.all_parameters:
        if q.fixed and (value := fitted.values.get(q.name, q.value)) != q.value:
            values = {"value": value, "stated": q.value, "unit": q.unit}
            yield Finding(EstimationCode.CONSTANT_BY_RECORD, subject=q.name, values=values)


def _refine_for_constants(
    optimum: SimulationOptimum, options: FitOptions, report: FitProgressCallback | None
) -> SimulationOptimum:
    """The optimum with ever shorter steps, as long as half of them still moves its constants or leaves an error that matters beside the
    noise; whatever is left is a finding, and stands beside the status.
    """
    policy = options.policy.step_refinement
    for _ in range(policy.halvings):
        solution = optimum.solution
        step = solution.problem.step
        if not optimum.status.success or options.substeps or step.substeps >= policy.max_substeps:
            break
        # Segments whose run one simulation does not give, and arcs, have been refined as far as their search could.
        if not find_step_issues(optimum) or options.arc_length or not solution.is_free_run():
            break
        problem = solution.at_optimum
        finer = problem.with_stable_steps() if options.method == "automatic" else problem
        finer = problem.halve_step() if finer is problem else finer
        again = solve_single_shooting(finer, replace(options, progressive=False), report).with_work_of(solution)
        if not again.status.success:
            break
        again = replace(again, strategy=solution.strategy, shares=solution.shares)
        optimum = SimulationOptimum(
            optimum.model, again.with_strategy(completion=str(Completion.FREE_RUN)) if solution.joined else again
        )
    return optimum


def _count_runs(problem: EstimationProblem) -> dict[str, float]:
    """What a search has cost where a run has a price: runs of one record, those that failed, and all of them in whole records."""
    kernel = problem.kernel
    if not isinstance(kernel, PlantKernel):
        return {}
    rows = sum(len(record.u) for record in problem.records)
    return {"runs": kernel.runs, "failed_runs": kernel.failures, "simulation_equivalents": kernel.rows / rows}


def compute_level_deviations(noise: NoiseModel, evaluation: Evaluation, unknowns: int) -> dict[str, float]:
    """Standard deviation of the logarithm of each level that has a name, by output: ``1 / sqrt(2 n)`` of n independent readings."""
    result: dict[str, float] = {}
    for outputs in map(list, noise.sharing):
        # The unknowns have taken their share of the readings of every output.
        left = evaluation.counts[outputs].sum() * max(1 - unknowns / max(evaluation.count, 1), 0.0)
        result |= dict.fromkeys((noise.outputs[j] for j in outputs), float(1 / np.sqrt(2 * max(left, 1.0))))
    return result


def assemble_fit(optimum: Optimum, options: FitOptions) -> Fit:
    """The result of an estimation, by simulation error or by prediction error."""
    model, problem, variables, covariance = optimum.model, optimum.problem, optimum.variables, optimum.covariance
    misfit, search, solution = optimum.misfit, optimum.search, optimum.solution
    prediction = optimum if isinstance(optimum, PredictionOptimum) else None
    measured = [(j, o) for j, o in enumerate(model.outputs) if o.name in misfit]
    parameters = set_intensity_limits(to_estimates(variables, covariance), optimum.tests)
    priors = check_priors(variables, covariance)
    per_experiment, tied = to_experiment_estimates(variables, covariance), to_tied_estimates(variables, covariance)
    robust = summarise_outliers(problem, optimum.runs)
    # The parameters that were free in the order of the model, and their covariance; NaN for an intensity that became zero.
    everything = model.all_parameters
    fitted = [everything[k].name for k in locate_fitted(variables)]
    zero = [test.name for test in optimum.tests if test.value == 0]
    free = tuple(q.name for q in everything if q.name in (*fitted, *zero))
    matrix, places = np.full((len(free), len(free)), np.nan), [free.index(name) for name in fitted]
    matrix[np.ix_(places, places)] = to_model_covariance(variables, covariance.covariance)
    findings = (
        *find_fit_issues(optimum, parameters),
        *find_option_issues(problem, tied, per_experiment, priors, robust),
        *find_mistaken_units(model, parameters),
        *(() if prediction else find_reading_errors(optimum.traces)),
        *find_foreign_conditions(model, problem.experiments),
        *find_record_trends(variables, covariance, problem.experiments),
    )
    estimated_noise = [model.outputs[j] for j in variables.estimated_noise]
    return Fit(
        model=optimum.fitted_model,
        parameters=result_parts.Estimates(parameters),
        misfit=misfit,
        traces=optimum.traces,
        solver=result_parts.SolverReport(
            str(optimum.status),
            optimum.status.success,
            float(optimum.evaluation.cost),
            {
                "optimiser": search.solver,
                "ipopt_status": search.solver_status,
                "iterations": search.iterations,
                "passes": search.evaluations,
                "seconds": search.seconds,
                "record_shares": [1.0] if prediction else list(solution.shares),
                "transcription": "prediction" if prediction else solution.transcription,
                "free_run": not prediction and solution.is_free_run(),
                "method": problem.method,
                "kernel": (prediction.maximum.objective.kalman.kernel if prediction else problem.kernel).name,
                "substeps": problem.step.substeps,
                **_count_runs(problem),
            },
            make_strategy("prediction", exact=prediction.is_exact) if prediction else solution.strategy,
            find_status_details(optimum),
        ),
        noise=result_parts.FitNoise(
            {o.name: float(problem.noise.std[j]) for j, o in measured},
            dict(problem.noise.sources),
            {o.name: problem.noise.colour[j].reflection for j, o in measured},
            dict(zip((o.name for o in estimated_noise), covariance.log_noise.tolist(), strict=False))
            or compute_level_deviations(problem.noise, optimum.evaluation, variables.size),
            {
                o.name: o.unit
                for o in model.outputs
                if o in estimated_noise or o.name in {*problem.noise.growth, *problem.noise.named}
            },
            {
                o.name: replace(bound, level=float(problem.noise.std[j]))
                if bound.source is NoiseSource.RESIDUAL
                else bound
                for j, o in measured
                if not prediction and (bound := problem.noise.bound(o.name)) is not None
            },
            {name: noise for name, noise in problem.noise.growth.items() if name in misfit},
            dict(problem.noise.named),
        ),
        uncertainty=result_parts.FitUncertainty(
            free,
            matrix,
            covariance.kind,
            dict(zip(variables.names, covariance.inflation.tolist(), strict=True)),
            compute_quantile(covariance.degrees),
        ),
        discretisation=result_parts.FitDiscretisation(
            optimum.discretisation,
            {o.name: float(solution.integration_error[j]) for j, o in measured},
            dict(zip(variables.names, optimum.step_shift.tolist(), strict=True)),
        ),
        provenance=result_parts.Provenance(
            options.to_data(),
            equations_text(model),
            declare(model),
            read_versions(),
            {q.name: q.value for q in model.free_parameters},
        ),
        constraints=result_parts.FitConstraints(
            {tie.name: tie.formula for tie in model.ties}, tied, per_experiment, priors
        ),
        robust=robust,
        prediction=prediction.report() if prediction else result_parts.PredictionReport(),
        findings=add_record_findings(findings, problem.experiments, is_robust=options.robust),
    )
