"""Fitting a model with process noise by the error of its predictions: maximum likelihood through a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from greybox.estimation.covariance import compute_quantile
from greybox.estimation.estimates import (
    check_priors,
    to_estimates,
    to_experiment_estimates,
    to_model_covariance,
    to_tied_estimates,
)
from greybox.estimation.findings import add_record_notes
from greybox.estimation.likelihood_covariance import LikelihoodCovariance, estimate_likelihood_covariance
from greybox.estimation.likelihood_search import LikelihoodOptimum, compute_scoring_step
from greybox.estimation.likelihood_unknowns import LikelihoodUnknowns
from greybox.estimation.maximum_likelihood import maximum_likelihood_estimate
from greybox.estimation.option_findings import find_option_issues
from greybox.estimation.options import FitOptions, FitProgressCallback
from greybox.estimation.parameter_constancy import ConstancyInput, ParameterShift, find_parameter_shifts
from greybox.estimation.prediction_error_findings import describe_likelihood_status, find_likelihood_issues
from greybox.estimation.prediction_error_runs import Runs, compute_free_runs, compute_one_step_runs
from greybox.estimation.problem import EstimationProblem
from greybox.estimation.process_noise_tests import ProcessNoiseTest, likelihood_ratio_tests
from greybox.estimation.restore_likelihood import compute_innovations
from greybox.estimation.robust_estimation import OutlierSummary
from greybox.estimation.sandwich import estimate_residual_colour
from greybox.estimation.solution import Solution
from greybox.estimation.traces import compute_misfits, make_traces
from greybox.estimation.versions import read_versions
from greybox.experiment import Experiment
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
    SolverReport,
)
from greybox.transcription import DecisionVector

# Ends of an interval that are further from the value than by a factor of e to this say nothing.
HARDLY = 5.0


def fit_by_prediction(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    quiet: Experiment | Sequence[Experiment],
    options: FitOptions,
    report: FitProgressCallback | None = None,
    initial: Sequence[Mapping[str, float]] = (),
) -> Fit:
    """The most likely constants, intensities of process noise, measurement noise and first states of ``model``.

    The likelihood is that of the innovations of a Kalman filter, exact for a linear model, extended otherwise (Astrom 1970; Kristensen,
    Madsen, Jorgensen, Automatica 40, 2004). Noise of the outputs that is given, or known from a quiet record, is taken as it is,
    other noise is estimated with the rest. The search starts from the free-run fit, or from the start values where those are more
    likely; ``initial`` as in `greybox.fit`. An intensity for which zero is as likely becomes zero; with all at zero the fit is the
    free-run one.

    Raises ModelError for a robust loss or a transcription, which have no meaning here.
    """
    likely = maximum_likelihood_estimate(model, experiments, noise, quiet, options, report, initial)
    judged = (
        likelihood_ratio_tests(likely.found, likely.names, likely.zero, likely.sizes, options)
        if likely.found.status.success
        else ()
    )
    return _result(model, likely.solution, likely.found, judged, options)


def _result(
    model: Model, solution: Solution, found: LikelihoodOptimum, judged: Sequence[ProcessNoiseTest], options: FitOptions
) -> Fit:
    cost, variables = found.cost, found.cost.unknowns.variables
    level = cost.unknowns.level
    problem = solution.problem.with_noise(replace(solution.problem.noise, std=level))
    free = compute_free_runs(cost)
    runs = make_traces(problem, free)
    free_run, one_step = (
        compute_misfits(problem, runs),
        compute_misfits(problem, make_traces(problem, compute_one_step_runs(cost))),
    )
    around = estimate_likelihood_covariance(found)
    fitted = model.start(**{name: float(v) for name, v in zip(model.values, variables.fixed, strict=True)})
    constants = _with_limits(to_estimates(variables, around.constants), judged)
    inflation = np.ones(len(variables.names)) if around.constants.inflation is None else around.constants.inflation
    shift = _shift(found, around)
    names, covariance = _laid_out(model, variables, around)
    sources = _sources(problem, cost.unknowns, around)
    per_experiment, tied = (
        to_experiment_estimates(variables, around.constants),
        to_tied_estimates(variables, around.constants),
    )
    priors = check_priors(variables, around.constants)
    remarks = find_likelihood_issues(
        fitted, problem, found, around, constants, judged, shift, _moves(problem, found, free)
    )
    remarks = (
        *remarks,
        *find_option_issues(problem, constants, tied, per_experiment, priors, OutlierSummary("", {}, {})),
    )
    return Fit(
        model=fitted,
        parameters=constants,
        misfit=free_run,
        traces=runs,
        solver=SolverReport(
            found.status.name.lower(),
            found.status.success,
            describe_likelihood_status(found, one_step, free_run),
            float(found.evaluation.cost),
            _statistics(solution, found),
        ),
        noise=FitNoise(
            {name: float(level[j]) for j, name in enumerate(problem.model.system.output_names) if name in free_run},
            "; ".join(f"{name}: {text}" for name, text in sources.items()),
            {name: _source(problem, cost.unknowns, name) for name in sources},
            dict.fromkeys(free_run, ()),
        ),
        uncertainty=FitUncertainty(
            names, covariance, around.constants.kind, dict(zip(variables.names, inflation.tolist(), strict=True))
        ),
        discretisation=FitDiscretisation(
            cost.kalman.whole.label,
            {n: float(solution.integration_error[j]) for j, n in enumerate(model.system.output_names) if n in free_run},
            shift,
        ),
        provenance=Provenance(
            {**asdict(options), "per_experiment": list(options.per_experiment)}, equations_text(model), read_versions()
        ),
        constraints=FitConstraints({tie.name: tie.formula for tie in model.ties}, tied, per_experiment, priors),
        prediction=PredictionReport(
            {state: value for state, value in fitted.noise_intensities.items() if state in model.noisy_states},
            one_step,
            found.likelihood if np.isfinite(found.likelihood) else None,
        ),
        notes=add_record_notes(remarks, problem.experiments),
    )


def _with_limits(constants: dict[str, Estimate], judged: Sequence[ProcessNoiseTest]) -> dict[str, Estimate]:
    """Intensities that are zero, or not certainly more, with their limit in place of an interval that cannot reach zero."""
    found = dict(constants)
    for i in judged:
        if i.value == 0:
            found[i.name] = Estimate(0.0, constants[i.name].unit, None, i.limits, False, True)
        elif i.limits is not None:
            found[i.name] = replace(constants[i.name], interval=i.limits)
    return found


def _laid_out(
    model: Model, variables: DecisionVector, around: LikelihoodCovariance
) -> tuple[tuple[str, ...], np.ndarray]:
    """The constants that were free in the order of the model, and their covariance; NaN for an intensity that became zero."""
    known = [model.all_parameters[k].name for k in dict.fromkeys(variables.which.tolist())]
    zero = [q.name for q in model.free_parameters if q.name in model.noise_parameters and q.name not in known]
    free = tuple(q.name for q in model.all_parameters if q.name in (*known, *zero))
    covariance = np.full((len(free), len(free)), np.nan)
    places = [free.index(name) for name in known]
    covariance[np.ix_(places, places)] = to_model_covariance(variables, around.constants.covariance)
    return free, covariance


def _shift(found: LikelihoodOptimum, around: LikelihoodCovariance) -> dict[str, float]:
    """Change of each constant when the step is halved, in its standard deviations; 0 for an exact discretisation."""
    cost = found.cost
    variables = cost.unknowns.variables
    n = len(variables.which)
    if cost.kalman.step.per_interval or not n or not found.status.success:
        return dict.fromkeys(variables.names, 0.0)
    finer = replace(cost, kalman=cost.kalman.with_substeps(2 * cost.kalman.step.substeps))
    after = finer.evaluate(np.zeros(cost.unknowns.size))
    if not np.isfinite(after.cost):
        return dict.fromkeys(variables.names, float("nan"))
    change = np.subtract(*(compute_scoring_step(e, *cost.unknowns.bounds()) for e in (after, found.evaluation)))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.abs(change[:n] * variables.spans) / np.sqrt(np.diag(around.constants.covariance))
    return dict(zip(variables.names, share.tolist(), strict=True))


def _moves(problem: EstimationProblem, found: LikelihoodOptimum, runs: Runs) -> list[ParameterShift]:
    """Constants that move, by the innovations; not the intensities, which these tell by their size alone."""
    if not found.status.success:
        return []
    rows = [(e, mean) for e, mean, _ in compute_innovations(found.cost).rows]
    outputs = [record.samples(y) for record, (y, _) in zip(problem.records, runs, strict=True)]
    names, aside = [e.name for e in problem.experiments], problem.model.noise_parameters
    judged = ConstancyInput(
        found.cost.unknowns.variables, names, outputs, estimate_residual_colour(rows, 0, True), aside
    )
    return find_parameter_shifts(judged, rows)


def _source(problem: EstimationProblem, unknowns: LikelihoodUnknowns, output: str) -> NoiseSource:
    place = problem.model.system.output_names.index(output)
    return NoiseSource.INNOVATIONS if unknowns.estimated[place] else problem.noise.sources[output]


def _sources(problem: EstimationProblem, unknowns: LikelihoodUnknowns, around: LikelihoodCovariance) -> dict[str, str]:
    """Where the noise of each measured output comes from, in words."""
    texts = {}
    for j, output in enumerate(problem.model.outputs):
        if unknowns.estimated[j]:
            value, reach = unknowns.level[j], compute_quantile(np.inf) * around.noise[j]
            unit = problem.model.outputs[j].unit
            told = reach < HARDLY
            ends = f" [{value * np.exp(-reach):.3g}, {value * np.exp(reach):.3g}]" if told else " (hardly told)"
            texts[output.name] = f"{value:.3g}{ends} {unit} from the innovations"
        elif output.name in problem.noise.sources:
            texts[output.name] = problem.noise.sources[output.name].replace("_", " ")
    return texts


def _statistics(solution: Solution, found: LikelihoodOptimum) -> dict[str, object]:
    kind = "exact" if solution.problem.model.system.linear and solution.problem.step.per_interval else "extended"
    return {
        "optimiser": "IPOPT", "ipopt_status": found.word, "iterations": found.iterations, "passes": found.evaluations,
        "seconds": found.seconds, "record_shares": [1.0],
        "strategy": f"prediction error through the {kind} Kalman filter, begun at the free-run fit or the start values",
        "transcription": "prediction", "free_run": False, "method": solution.problem.method, "kernel": found.cost.kalman.kernel.name,
        "substeps": solution.problem.step.substeps,
    }  # fmt: skip
