"""What a reader should know before trusting a fit, as findings: failures, bounds, open directions, misfit above the noise, priors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any, Literal

import casadi as ca
import numpy as np

from greybox.base import Finding, Severity, format_unit
from greybox.base.linear_algebra import are_independent
from greybox.base.numerics import INDEPENDENT_FORMULA, RELATION_MET, ROWS_AT_A_TIME, STATE_BOUND_MARGIN, TINY
from greybox.data.closed_loop import answers_same_row
from greybox.data.experiment import Experiment, collect_record_findings
from greybox.data.findings import is_sensor_fault
from greybox.data.noise.noise_model import BoundDirection, NoiseSource
from greybox.estimation.covariance import ParameterCovariance, compute_interval, compute_quantile
from greybox.estimation.errors import compute_weighed_ratio
from greybox.estimation.identifiability.combinations import find_determined_formulas
from greybox.estimation.identifiability.transfer_functions import Polynomial, format_polynomial, logarithmic_gradient
from greybox.estimation.objective import ProcessNoiseTest
from greybox.estimation.optimum import Optimum, PredictionOptimum
from greybox.estimation.parameter_constancy import NOISE_RATIO, find_certain_ratio
from greybox.estimation.record_trends import find_shared_noise, find_trend, shared_conditions, trend_values
from greybox.estimation.result import FOLLOWED_PERCENT, Fit
from greybox.estimation.result_parts import Estimate, IntervalKind, PriorCheck, RobustReport, Trace, Validation
from greybox.estimation.transcription.decision_vector import SHARED, DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model import Model
from greybox.model.expressions.text import expression_text
from greybox.simulation.plant import PlantModel
from greybox.simulation.plant_kernel import PlantKernel


class EstimationCode(StrEnum):
    """Codes of what a fit finds about itself, its records and its options."""

    # What the status says beside its name.
    MISFIT_RATIO = "misfit_ratio"
    PREDICTION_RATIO = "prediction_ratio"
    FILTER_NOT_FINITE = "filter_not_finite"
    TERM_NOT_FINITE = "term_not_finite"
    STATES_DIVERGE = "states_diverge"
    SENSITIVITY_NOT_FINITE = "sensitivity_not_finite"
    PLANT_RUN_FAILED = "plant_run_failed"
    CONSTANT_BY_RECORD = "constant_by_record"
    # How an input moves between rows, by what it does to the constants and to the residual.
    INPUT_COURSE_CONTRADICTED = "input_course_contradicted"
    INPUT_COURSE_OPEN = "input_course_open"
    INPUT_NOISE_COUNTED = "input_noise_counted"
    INPUT_NOISE_BIASES = "input_noise_biases"
    NOISE_SHARED = "noise_shared"
    INPUT_BEFORE_OPEN = "input_before_open"
    # What the constants and the residual say.
    MODEL_DOES_NOT_FOLLOW = "model_does_not_follow"
    NO_FREEDOM = "no_freedom"
    DIRECTION_UNDETERMINED = "direction_undetermined"
    STOPPED_BY_BOUND = "stopped_by_bound"
    LIMITED_FROM_BOUND = "limited_from_bound"
    NARROWED_BY_BOUND = "narrowed_by_bound"
    PARAMETER_UNDETERMINED = "parameter_undetermined"
    NOTHING_TO_EXPLAIN = "nothing_to_explain"
    MISFIT_ABOVE_NOISE = "misfit_above_noise"
    MISFIT_ABOVE_DIFFERENCE_NOISE = "misfit_above_difference_noise"
    PARAMETER_NOT_CONSTANT = "parameter_not_constant"
    GAIN_IS_UNIT_FACTOR = "gain_is_unit_factor"
    RESIDUAL_OF_STEPS = "residual_of_steps"
    RESIDUAL_OF_JITTER = "residual_of_jitter"
    RESIDUAL_CORRELATED = "residual_correlated"
    INNOVATIONS_CORRELATED = "innovations_correlated"
    INTEGRATION_TOO_COARSE = "integration_too_coarse"
    RELATION_NOT_MET = "relation_not_met"
    STEP_MOVES_PARAMETERS = "step_moves_parameters"
    VALIDATION_BEYOND_RANGE = "validation_beyond_range"
    VALIDATION_ERROR_LARGER = "validation_error_larger"
    # What was asked for.
    PRIOR_CONFLICT = "prior_conflict"
    PRIORS_OFF_ALIKE = "priors_off_alike"
    HELD_BY_PRIOR = "held_by_prior"
    TIED_OUTSIDE_BOUNDS = "tied_outside_bounds"
    MEAN_OF_EXPERIMENTS = "mean_of_experiments"
    VALUES_BY_RECORD = "values_by_record"
    CONDITION_OF_RECORDS = "condition_of_records"
    ROBUST_LOSS_OUTLIERS = "robust_loss_outliers"
    TOO_MANY_OUTLIERS = "too_many_outliers"
    CONSTANT_OUTPUT_EXCLUDED = "constant_output_excluded"
    START_IN_FIRST_ROW = "start_in_first_row"
    # Process noise.
    PROCESS_NOISE_ZERO = "process_noise_zero"
    PROCESS_NOISE_NOT_SIGNIFICANT = "process_noise_not_significant"
    PROCESS_NOISE_SIGNIFICANT = "process_noise_significant"
    NOISE_COLOUR_IGNORED = "noise_colour_ignored"
    # Several starts.
    STARTS = "starts"
    STARTS_NOT_BEGUN = "starts_not_begun"
    OTHER_START_TAKEN = "other_start_taken"
    NO_START_HELPS = "no_start_helps"


# Where a simulation broke: which term of which balance, when, and at which states.


# What may fail to be a number in a run.
QuantityKind = Literal["start", "term", "storage", "output"]


def locate_simulation_failure(
    problem: EstimationProblem, variables: DecisionVector, experiment: int, sample: int
) -> Finding:
    """What went wrong where the run of record number ``experiment`` is no longer finite at row ``sample`` (both from 0).

    The terms of every balance are evaluated at the last states that were finite, and then at the points to which a Runge-Kutta
    step goes from there; the first term that is not a number is named, with its formula, the time, the states and the inputs. Where
    all terms are finite the states themselves run away: then the largest of them is named. ``variables``: the point is ``z = 0``.
    """
    model, record = problem.model, problem.records[experiment]
    z = variables.here
    p = variables.parameters(z, experiment)
    if isinstance(problem.kernel, PlantKernel):
        start, _ = variables.compute_initial_state(z, p, experiment)
        values = {"experiment": experiment + 1, "reason": problem.kernel.find_failure(record, p, start)}
        return Finding(EstimationCode.PLANT_RUN_FAILED, Severity.ERROR, model.title, values)
    _, states = problem.shooting(variables).simulate(z)[experiment]
    if sample >= len(states):
        return Finding(EstimationCode.SENSITIVITY_NOT_FINITE, Severity.ERROR, "", {"experiment": experiment + 1})
    finite = np.isfinite(states).all(axis=1)
    last = min(sample, max(int(np.argmin(finite)) - 1, 0)) if not finite.all() else sample
    x, u = states[last], record.u[last, : len(model.inputs)]
    place = {"experiment": experiment + 1, "time": float(problem.experiments[experiment].time[last]), "row": last + 1}
    # The states, and those at which an RK4 step asks for their rates: k2 and k3 half a step on, k4 a whole one.
    h = float(record.h[min(last, len(record.h) - 1)]) if len(record.h) else 0.0
    points = [x]
    for share in (0.5, 0.5, 1.0):
        at = x + share * h * np.asarray(model.system.rhs_function(points[-1], u, p)).ravel()
        if not np.isfinite(at).all():
            break
        points.append(at)
    for at in points:
        quantity = find_first_not_finite(model, at, u, p)
        if quantity:
            values = {**place, **quantity, "point": _name_point(model, at, u)}
            return Finding(EstimationCode.TERM_NOT_FINITE, Severity.ERROR, quantity["name"], values)
    largest = model.system.state_names[int(np.argmax(np.abs(x)))]
    return Finding(EstimationCode.STATES_DIVERGE, Severity.ERROR, largest, {**place, "point": _name_point(model, x, u)})


def find_first_not_finite(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> dict[str, str]:
    """The first quantity of the equations that is not finite: its kind, name, balance, formula, value and unit; empty if none is."""
    system = model.system
    for name, value in zip(system.state_names, x, strict=True):
        if not np.isfinite(value):
            return _describe_quantity("start", name, "", "", float(value), "")
    bounds = np.array([s.bounds for s in model.all_states], float)
    inside = np.clip(x, bounds[:, 0] + STATE_BOUND_MARGIN, bounds[:, 1] - STATE_BOUND_MARGIN)
    quantities: list[tuple[QuantityKind, str, str, ca.SX, str]] = []
    for b in system.balances:
        quantities += [("term", name, b.name, ca.SX(term), b.unit) for name, term in b.terms.items()]
        quantities.append(("storage", b.name, b.name, 1 / ca.SX(b.storage), ""))
    for j, name in enumerate(system.output_names):
        quantities.append(("output", name, "", system.outputs[j], model.outputs[j].unit))
    arguments = [system.x, system.u, system.p]
    formulas = ca.vertcat(*(formula for _, _, _, formula, _ in quantities))
    names = {s.name() for group in arguments for s in ca.symvar(ca.SX(group))}
    # An input of the past is as good as zero here.
    past = [s for s in ca.symvar(formulas) if s.name() not in names]
    if past:
        formulas = ca.substitute(formulas, ca.vertcat(*past), ca.SX.zeros(len(past)))
    values = np.asarray(ca.Function("terms", arguments, [ca.densify(formulas)])(inside, u, p)).ravel()
    for (kind, name, balance, formula, unit), value in zip(quantities, values, strict=True):
        if not np.isfinite(value):
            return _describe_quantity(kind, name, balance, expression_text(formula), float(value), unit)
    return {}


def _describe_quantity(
    kind: QuantityKind, name: str, balance: str, formula: str, value: float, unit: str
) -> dict[str, str]:
    # JSON has no infinities: the value is text.
    value_text = f"{value:g}"
    return {"kind": kind, "name": name, "balance": balance, "formula": formula, "value": value_text, "unit": unit}


def _name_point(model: Model, x: np.ndarray, u: np.ndarray) -> list[dict[str, str]]:
    """States and inputs with their units, values as text."""
    states = zip(model.system.state_names, x, (s.unit for s in model.all_states), strict=True)
    inputs = zip((i.name for i in model.inputs), u, (i.unit for i in model.inputs), strict=True)
    return [{"name": name, "value": f"{value:.4g}", "unit": unit} for name, value, unit in (*states, *inputs)]


def find_status_details(optimum: Optimum) -> tuple[Finding, ...]:
    """Why a run broke off, or the largest misfit over noise, as a wrong model converges too, and what steps that are too long change.

    For a filter it is the largest error one step ahead with that of the free run beside it.
    """
    misfit, failed = optimum.misfit, optimum.evaluation.failed
    if isinstance(optimum, PredictionOptimum):
        if failed:
            return (Finding(EstimationCode.FILTER_NOT_FINITE, Severity.ERROR, "", {"experiment": failed[0] + 1}),)
        ratios = {name: m.noise_ratio for name, m in optimum.one_step.items()}
    else:
        if failed:
            return (locate_simulation_failure(optimum.problem, optimum.variables, *failed),)
        ratios = {name: m.noise_ratio for name, m in misfit.items()}
    # Converged, but with steps that the constants depend on: that stands beside the status.
    steps = find_step_issues(optimum)
    if not ratios:
        return steps
    worst = max(ratios, key=lambda name: ratios[name])
    if isinstance(optimum, PredictionOptimum):
        both = {"one_step": ratios[worst], "free_run": misfit[worst].noise_ratio}
        return (Finding(EstimationCode.PREDICTION_RATIO, Severity.NOTE, worst, both), *steps)
    values: dict[str, Any] = {"ratio": ratios[worst], "without_outliers": misfit[worst].without_outliers}
    if misfit[worst].direction is BoundDirection.AT_MOST:
        values["least_ratio"] = ratios[worst]
    return (Finding(EstimationCode.MISFIT_RATIO, Severity.NOTE, worst, values), *steps)


def is_at_noise(optimum: Optimum) -> bool:
    """Whether nothing but noise is left to explain."""
    return np.isfinite(optimum.evaluation.cost) and all(is_output_at_noise(optimum, name) for name in optimum.misfit)


def is_output_at_noise(optimum: Optimum, name: str) -> bool:
    """Whether nothing but noise is left to explain of an output. A level that is the residual's own says no such thing."""
    is_told = optimum.problem.noise.sources.get(name) is not NoiseSource.RESIDUAL
    return is_told and compute_weighed_ratio(optimum.problem.noise, name, optimum.misfit[name]) <= NOISE_RATIO


def _list_parameters(code: str, names: Sequence[str], severity: Severity = Severity.WARNING) -> list[Finding]:
    return [Finding(code, severity, "", {"parameters": list(names)})] if names else []


# A model that follows little of an output (`FOLLOWED_PERCENT`) with a misfit so many times the noise describes another plant.
FAR_NOISE_RATIO = 3.0
# Parameters that are not constant are listed up to this number.
LISTED_SHIFTS = 3
# Integration error over the noise ...
INTEGRATION_ERROR = 0.1
# ... and over the misfit.
INTEGRATION_SHARE = 0.01
# Share of a standard deviation that half the integration step may shift a parameter.
STEP_SHIFT = 0.1
# Nobody asks for more digits of a parameter than this share of its value.
LAST_DIGIT = 1e-06


def find_fit_issues(optimum: Optimum, estimates: Mapping[str, Estimate]) -> tuple[Finding, ...]:
    """Findings about the end of an estimation, the most important first.

    A free run is held against the noise; a prediction corrects what it lacks, so its process noise is judged instead.
    """
    predicts = isinstance(optimum, PredictionOptimum)
    covariance, problem, variables = optimum.covariance, optimum.problem, optimum.variables
    free_run = {} if predicts else optimum.misfit
    result: list[Finding] = []

    def warn(code: EstimationCode, severity: Severity = Severity.WARNING, **values: Any) -> None:
        result.append(Finding(code, severity, "", values))

    # A model that follows little of an output describes another plant: then its constants mean nothing.
    best_fit = {n: m.best_fit_percent for n, m in free_run.items()}
    # A noise that is the residual's own never stands against it: a short table is judged by what the model follows alone.
    sources = problem.noise.sources
    lost = {n: best_fit[n] for n in free_run if best_fit[n] < FOLLOWED_PERCENT}
    weighed = {n: compute_weighed_ratio(problem.noise, n, m) for n, m in free_run.items()}
    far = {n: followed for n, followed in lost.items() if weighed[n] > FAR_NOISE_RATIO}
    short = {n: followed for n, followed in lost.items() if sources.get(n) is NoiseSource.RESIDUAL}
    if far or short:
        severity = Severity.ERROR if far else Severity.WARNING
        warn(EstimationCode.MODEL_DOES_NOT_FOLLOW, severity, best_fit=far | short)
    result += _find_other_courses(optimum)
    result += _find_inputs_before(optimum, estimates)
    result += _find_input_noise(optimum)
    result += list_shared_noise(optimum.traces[:PAIRED_RECORDS])
    # What the data leave open, and what only looks determined.
    if covariance.degrees == 0:
        count = sum(int(np.isfinite(r.y).sum()) for r in problem.records)
        warn(EstimationCode.NO_FREEDOM, readings=count, unknowns=variables.size)
    result += _find_open_directions(optimum)
    tested = [test.name for test in optimum.tests]
    zero = [test.name for test in optimum.tests if test.value == 0]
    at_bound = [n for n, e in estimates.items() if e.at_bound and n not in zero]
    wide = [n for n, e in estimates.items() if e.std is not None and not (e.at_bound or e.determined or n in tested)]
    result += _find_bounds(variables, covariance, at_bound)
    result += _find_narrowed(covariance, at_bound)
    result += _list_parameters(EstimationCode.PARAMETER_UNDETERMINED, wide)
    # Nothing to explain: every output is at its noise already with a constant in the place of the model.
    if free_run and is_at_noise(optimum) and not any(percent > 0 for percent in best_fit.values()):
        warn(EstimationCode.NOTHING_TO_EXPLAIN, best_fit=best_fit)
    # Misfit above the noise; what it means depends on how the noise is known.
    # Beyond the level that is weighed with it may be noise up to the ceiling.
    louder = {n: weighed[n] for n, m in free_run.items() if m.noise_ratio > NOISE_RATIO}
    certain = any(ratio > find_certain_ratio(problem.noise, n) for n, ratio in louder.items())
    if louder:
        code = EstimationCode.MISFIT_ABOVE_NOISE if certain else EstimationCode.MISFIT_ABOVE_DIFFERENCE_NOISE
        warn(code, ratios=louder)
    if optimum.parameter_shifts:
        shifts = [{**vars(s), "parts": list(s.parts)} for s in optimum.parameter_shifts[:LISTED_SHIFTS]]
        warn(EstimationCode.PARAMETER_NOT_CONSTANT, shifts=shifts)
    result += [_judge_process_noise(optimum, test, estimates[test.name]) for test in optimum.tests]
    result += _find_correlation(optimum)
    if predicts and optimum.solution.problem.noise.coloured:
        warn(EstimationCode.NOISE_COLOUR_IGNORED, Severity.NOTE)
    result += _find_unmet_relations(optimum)
    result += find_step_issues(optimum)
    return tuple(result)


def find_step_issues(optimum: Optimum) -> tuple[Finding, ...]:
    """What the integration step leaves in the outputs of a free run, and by how much half of it moves parameters, where that matters."""
    problem, variables, covariance = optimum.problem, optimum.variables, optimum.covariance
    free_run = {} if isinstance(optimum, PredictionOptimum) else optimum.misfit
    outputs = [o.name for o in problem.model.outputs]
    error = dict(zip(outputs, optimum.solution.integration_error, strict=True))
    # Beside a misfit far above the noise less than a hundredth of it matters.
    least = {n: INTEGRATION_SHARE * compute_weighed_ratio(problem.noise, n, m) for n, m in free_run.items()}
    coarse = [n for n in free_run if error[n] > max(INTEGRATION_ERROR, least[n])]
    result = []
    if coarse:
        result.append(Finding(EstimationCode.INTEGRATION_TOO_COARSE, Severity.WARNING, "", {"outputs": coarse}))
    deviations, shift = np.sqrt(np.diag(covariance.covariance)), optimum.step_shift
    known = np.isfinite(deviations) & np.isfinite(shift)
    change = np.where(known, shift, 0.0) * np.where(known, deviations, 0.0)
    moved = known & (shift > STEP_SHIFT) & (change > LAST_DIGIT * np.abs(variables.base))
    if moved.any():
        shifts = {variables.names[k]: float(shift[k]) for k in np.flatnonzero(moved)}
        result.append(Finding(EstimationCode.STEP_MOVES_PARAMETERS, Severity.WARNING, "", {"shifts": shifts}))
    return tuple(result)


# Twice the logarithm of the odds by which the records prefer the other course before it is said that they do: where the one that was taken
# is right this happens in one record of 140 at most.
COURSE_CONTRADICTED = 6.0
# ... and by which they prefer the one that was taken before nothing is said: where that one is wrong, in one of 24 at most.
COURSE_CONFIRMED = 3.0
# Change of a constant, in its standard deviations, from which a course that the records do not tell matters.
COURSE_MATTERS = 1.0
# Constants that are listed with it, those first that change most.
LISTED_CHANGES = 3


def _find_other_courses(optimum: Optimum) -> list[Finding]:
    """Inputs for which the other course between rows fits better, or as well with other constants."""
    variables, covariance, result = optimum.variables, optimum.covariance, []
    deviations = np.sqrt(np.diag(covariance.covariance))
    # Correlated rows are worth fewer: the intervals know how many fewer.
    inflation = float(np.nanmax(covariance.inflation, initial=1.0)) ** 2
    judged = []
    for other in optimum.other_courses:
        # An input that answers the reading of its row holds what only the next row could show: straight it would seem to foretell it.
        inputs = [i.name for i in optimum.model.inputs] if other.courses == "mean" else other.courses
        if isinstance(optimum, PredictionOptimum) and any(_answers_same_row(optimum, n) for n in inputs):
            continue
        # What a residual above the noise leaves is noise to a comparison of two courses.
        squares = optimum.objective.squares
        left = 1.0 if squares is None else max(1.0, (optimum.evaluation.cost - max(other.gain, 0.0)) / squares)
        judged.append((other.gain / (left * inflation), other))
    means = [
        (odds, other) for odds, other in judged if isinstance(other.courses, str) or "mean" in other.courses.values()
    ]
    between = [(odds, other) for odds, other in judged if (odds, other) not in means]
    together = [(odds, other) for odds, other in between if len(other.courses) > 1]
    alone = [(odds, other) for odds, other in between if len(other.courses) == 1]
    if together and together[0][0] > max(0.0, *(odds for odds, _ in alone)) + COURSE_CONFIRMED:
        alone = together
    # Of two courses of one input the one that fits better is said.
    alone = [one for one in alone if one[0] >= max(odds for odds, o in alone if set(o.courses) == set(one[1].courses))]
    best = max(means, key=lambda pair: pair[0], default=None)
    # Most records hold no means: that they do is said where neither course between the rows explains them as well.
    if best and best[0] > max(COURSE_CONTRADICTED, *(odds + COURSE_CONFIRMED for odds, _ in alone), 0.0):
        alone = [best]
    for odds, other in alone:
        courses = {} if isinstance(other.courses, str) else dict(other.courses)
        values: dict[str, Any] = {"courses": courses, "odds": odds, "changes": {}}
        subject = " and ".join(courses)
        if other.change is None:
            result.append(Finding(EstimationCode.INPUT_COURSE_OPEN, Severity.WARNING, subject, values))
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes = np.nan_to_num(np.abs(other.change) / deviations, posinf=0.0)
        if odds > COURSE_CONTRADICTED:
            code = EstimationCode.INPUT_COURSE_CONTRADICTED
        elif odds > -COURSE_CONFIRMED and sizes.max() > COURSE_MATTERS:
            code = EstimationCode.INPUT_COURSE_OPEN
        else:
            continue
        values["changes"] = _list_changes(variables, other.change, sizes, COURSE_MATTERS)
        result.append(Finding(code, Severity.WARNING, subject, values))
    return result


# How far an output moves while the delayed input is still that of before the record, in its noise, from which that was no rest.
MOVES_BEFORE = 5.0


def _find_inputs_before(optimum: Optimum, estimates: Mapping[str, Estimate]) -> list[Finding]:
    """A delayed input of which nothing is told before a record that begins in motion: that it was its first value is a guess."""
    model, noise = optimum.model, optimum.problem.noise
    if not model.system.delays:
        return []
    values = {**model.values, **{name: e.value for name, e in estimates.items() if name in model.values}}
    delays = ca.Function("delays", [model.system.p], [d.seconds for d in model.system.delays])
    late = [float(value) for value in delays.call([ca.DM([*values.values()])])]
    for delay, seconds in zip(model.system.delays, late, strict=True):
        for trace in optimum.traces:
            # Until the input of the first row arrives, or another one moves the plant.
            others = [v for name, v in trace.inputs.items() if name != model.inputs[delay.column].name]
            moved = np.any([np.cumsum(v != v[0]) > 1 for v in others] or [np.zeros(len(trace.time), bool)], axis=0)
            waits = (trace.time - trace.time[0] <= seconds) & ~moved
            level = {o.name: std for o, std in zip(model.outputs, noise.std, strict=True)}
            # An output that nothing measures has no noise, and no run that anything is held against.
            moves = [np.ptp(run[waits]) / level[name] for name, run in trace.simulated.items()]
            if not len(trace.before_ages) and np.nanmax(moves, initial=0.0) > MOVES_BEFORE:
                one = model.inputs[delay.column]
                figures = {"seconds": seconds, "first": float(trace.inputs[one.name][0]), "unit": one.unit}
                figures |= {"input": one.name, "until": float(trace.time[0]) + seconds}
                return [Finding(EstimationCode.INPUT_BEFORE_OPEN, Severity.WARNING, trace.name, figures)]
    return []


def _answers_same_row(optimum: Optimum, name: str) -> bool:
    """Whether a controller has written an input in answer to a reading of the same row."""
    return any(
        answers_same_row(e.inputs[name], reading)
        for e in optimum.problem.experiments
        for reading in e.outputs.values()
        if e.courses[name] == "zero"
    )


# Bias of a constant, in its standard deviations, from which the noise of an input is said to cause it: of 95 % intervals half a deviation
# leaves 92.
NOISE_BIASES = 0.5
# Standard deviation over the one without the noise of inputs from which it is said that the interval counts it.
NOISE_COUNTS = 1.2


def _find_input_noise(optimum: Optimum) -> list[Finding]:
    """What the noise of measured inputs does to the constants, where it matters to one."""
    # A filter takes what the noise of an input adds to the run for process noise, and its intervals count that.
    noise, variables = None if isinstance(optimum, PredictionOptimum) else optimum.input_noise, optimum.variables
    if noise is None:
        return []
    variance = np.diag(optimum.covariance.covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes = np.nan_to_num(np.abs(noise.bias) / np.sqrt(variance), posinf=0.0)
        growth = np.nan_to_num(np.sqrt(variance / (variance - np.diag(noise.spread))), posinf=0.0)
    units = {i.name: i.unit for i in optimum.model.inputs}
    values = {"levels": {name: [level, units[name]] for name, level in noise.levels.items()}}
    if sizes.max() <= NOISE_BIASES:
        counted = [variables.names[int(k)] for k in np.argsort(-growth) if growth[k] > NOISE_COUNTS]
        return [Finding(EstimationCode.INPUT_NOISE_COUNTED, values={**values, "counted": counted})] if counted else []
    changes = _list_changes(variables, -noise.bias, sizes, NOISE_BIASES)
    return [Finding(EstimationCode.INPUT_NOISE_BIASES, Severity.WARNING, "", {**values, "changes": changes})]


def _list_changes(
    variables: DecisionVector, change: np.ndarray, sizes: np.ndarray, least: float
) -> dict[str, list[float]]:
    """Value, other value and size of the constants that a ``change`` (nf,) moves most, by more than ``least`` of their deviations."""
    listed = [int(k) for k in np.argsort(-sizes) if sizes[k] > least][:LISTED_CHANGES]
    return {
        variables.names[k]: [float(variables.base[k]), float(variables.base[k] + change[k]), float(sizes[k])]
        for k in listed
    }


def _find_unmet_relations(optimum: Optimum) -> list[Finding]:
    """Balances that store nothing and were not solved: their Newton steps ended elsewhere."""
    system = optimum.model.system
    if all(a.is_exact for a in system.algebraic):
        return []
    shares = np.zeros(len(system.algebraic))
    for (_, states), record in zip(optimum.runs, optimum.problem.records, strict=True):
        rows = min(len(states), len(record.u))
        inputs = record.u[:rows, : system.u.numel()]
        sums, largest = system.relations(states[:rows].T, inputs.T, np.asarray(optimum.variables.fixed))
        worst = np.abs(np.asarray(sums)) / np.maximum(np.asarray(largest), TINY)
        shares = np.maximum(shares, np.where(np.isfinite(worst), worst, np.inf).max(axis=1))
    pairs = zip(system.algebraic, shares.tolist(), strict=True)
    return [
        Finding(
            EstimationCode.RELATION_NOT_MET, Severity.WARNING, a.balance.name, {"share": share, "state": a.state.name}
        )
        for a, share in pairs
        if share > RELATION_MET
    ]


# Sample-to-sample correlation of the residual.
REPORTING_CORRELATION = 0.3
# Misfit over noise below which there is no residual to speak of.
REPORTING_LEAST_NOISE_RATIO = 0.1


def _find_correlation(optimum: Optimum) -> list[Finding]:
    """Residuals or innovations that are correlated from sample to sample, and what the intervals allow for them."""
    covariance = optimum.covariance
    if covariance.kind != IntervalKind.SANDWICH or not np.isfinite(covariance.inflation).any():
        return []
    inflation = float(np.nanmax(covariance.inflation))
    if isinstance(optimum, PredictionOptimum):
        return [Finding(EstimationCode.INNOVATIONS_CORRELATED, Severity.WARNING, "", {"inflation": inflation})]
    correlated = [
        n
        for n, m in optimum.misfit.items()
        if m.noise_ratio > REPORTING_LEAST_NOISE_RATIO
        and compute_lag_one_correlation(optimum.traces, n) > REPORTING_CORRELATION
    ]
    values = {"outputs": correlated, "inflation": inflation}
    return [Finding(EstimationCode.RESIDUAL_CORRELATED, Severity.NOTE, "", values)] if correlated else []


# Standard deviations by which a prior and the data disagree: one in a hundred where both are right.
PRIOR_CONFLICT = 2.6
# Share of the prior's variance that the data took away; below it the prior holds the parameter.
PRIOR_VARIANCE_REDUCTION = 0.2
# Share of a sensor's samples that may be outliers; more are no outliers.
OUTLIER_SHARE = 0.2


def find_option_issues(
    problem: EstimationProblem,
    tied: Mapping[str, Estimate],
    per_experiment: Mapping[str, Mapping[str, Estimate]],
    priors: Mapping[str, PriorCheck],
    robust: RobustReport,
) -> tuple[Finding, ...]:
    """Findings about what was asked of a fit: priors, parameters of each experiment, ties, a robust loss, excluded outputs."""
    result = find_prior_conflicts(problem.model, priors)
    # Where the data contradict a prior they do say something of its constant, however much the misfit widens the interval.
    contradicted = {finding.subject for finding in result}
    held = [n for n, c in priors.items() if c.variance_reduction < PRIOR_VARIANCE_REDUCTION and n not in contradicted]
    result += _list_parameters(EstimationCode.HELD_BY_PRIOR, held, Severity.NOTE)
    for name, e in tied.items():
        low, high = next(q.bounds for q in problem.model.stated_parameters if q.name == name)
        if not low <= e.value <= high:
            values = {"value": e.value, "unit": e.unit, "low": f"{low:g}", "high": f"{high:g}"}
            result.append(Finding(EstimationCode.TIED_OUTSIDE_BOUNDS, Severity.WARNING, name, values))
    result += _list_parameters(EstimationCode.MEAN_OF_EXPERIMENTS, list(per_experiment), Severity.NOTE)
    if robust.name:
        shares = {name: share for name, share in robust.outliers.items() if share > 0}
        values = {"loss": robust.name, "shares": shares, "left_out": problem.left_out}
        result.append(Finding(EstimationCode.ROBUST_LOSS_OUTLIERS, Severity.NOTE, "", values))
        many = [name for name, share in robust.outliers.items() if share > OUTLIER_SHARE]
        if many:
            result.append(Finding(EstimationCode.TOO_MANY_OUTLIERS, Severity.WARNING, "", {"outputs": many}))
    return (*result, *find_excluded_outputs(problem), *_find_late_first_rows(problem))


# Usual intervals after time zero within which a first row is the first reading of a table that begins at zero; a part of a record, or one
# whose clock ran on, begins later.
LATE_FIRST_ROW = 3.0


def _find_late_first_rows(problem: EstimationProblem) -> list[Finding]:
    """Records that begin shortly after time zero, where the model says how they begin: it is taken to speak of their first row."""
    initial = problem.variables.initial
    stated = [
        s.name
        for s, free, x in zip(problem.model.all_states, initial.free, initial.guess.T, strict=True)
        if not free and x.any()
    ]
    late = [
        e for e in problem.experiments if e.rows > 1 and 0 < e.time[0] <= LATE_FIRST_ROW * float(np.median(e.intervals))
    ]
    if not (stated and late) or initial.settled is not None or isinstance(problem.model, PlantModel):
        return []
    values = {"states": stated, "time": float(late[0].time[0])}
    return [Finding(EstimationCode.START_IN_FIRST_ROW, Severity.WARNING, late[0].name, values)]


# Factors by which a number is off in the wrong unit; those of a hundred and a thousand stand for prefixes.
UNIT_FACTORS: tuple[tuple[float, str], ...] = (
    (10.0, "a power of ten"),
    (100.0, "a power of ten"),
    (1e3, "a power of ten"),
    (1e6, "a power of ten"),
    (math.degrees(1.0), "degrees and radians"),
    (2 * math.pi, "revolutions and radians"),
    (30 / math.pi, "revolutions a minute and radians a second"),
    (60.0, "minutes and seconds"),
    (3600.0, "hours and seconds"),
    (3.6, "kilometres an hour and metres a second"),
    (1 / 0.3048, "feet and metres"),
    (9.80665, "kilogram-force and newton"),
    (4.448222, "pound-force and newton"),
    (25.4, "inches and millimetres"),
    (6.894757, "psi and kilopascal"),
)
# Share within which a factor must be known, and agree, to be that of a unit: the closest two (9.55, 9.81) are 3 % apart.
UNIT_FACTOR_SHARE = 0.01


def find_record_trends(
    variables: DecisionVector, covariance: ParameterCovariance, experiments: Sequence[Experiment]
) -> tuple[Finding, ...]:
    """For each constant of which every record has its own: whether one value does for all, and which condition the values follow."""
    conditions, result = shared_conditions(experiments), []
    for which in dict.fromkeys(variables.which[variables.owner != SHARED].tolist()):
        places = np.flatnonzero((variables.which == which) & (variables.owner != SHARED))
        # A constant at its bound has no interval on both sides.
        places = places[~variables.active[places]]
        owners = variables.owner[places]
        given = {name: values[owners] for name, values in conditions.items()}
        block = covariance.covariance[np.ix_(places, places)]
        trend = find_trend(variables.base[places], block, given)
        if trend is not None:
            q = variables.model.all_parameters[which]
            values = trend_values(trend, q.unit, len(places))
            result.append(Finding(EstimationCode.VALUES_BY_RECORD, Severity.NOTE, q.name, values))
    return tuple(result)


def find_foreign_conditions(model: Model, experiments: Sequence[Experiment]) -> tuple[Finding, ...]:
    """Conditions that are no parameter of the model: the records are compared by them, and that is all."""
    known = {*model.values, *(tie.name for tie in model.ties)}
    foreign = dict.fromkeys(name for e in experiments for name in e.conditions if name not in known)
    return tuple(Finding(EstimationCode.CONDITION_OF_RECORDS, Severity.NOTE, name) for name in foreign)


def find_prior_conflicts(model: Model, priors: Mapping[str, PriorCheck]) -> list[Finding]:
    """Priors that the data contradict, each with the factor between the two; and whether one factor explains them all."""
    conflicts = {n: c for n, c in priors.items() if c.conflict is not None and abs(c.conflict) > PRIOR_CONFLICT}
    result = []
    for name, check in conflicts.items():
        values: dict[str, Any] = {
            "deviations": abs(check.conflict or 0.0),
            "factor": check.factor,
            "factor_std": check.factor_std,
        }
        if units := name_unit_factor(check.factor or 0.0, check.factor_std or 0.0):
            values["units"] = units
        result.append(Finding(EstimationCode.PRIOR_CONFLICT, Severity.WARNING, name, values))
    # Logarithms of the factors and their variances, that of the prior's mean included.
    known = {n: c for n, c in conflicts.items() if c.factor is not None and c.factor > 0}
    if len(known) < max(2, len(conflicts)):
        return result
    logs = np.array([math.log(c.factor) for c in known.values() if c.factor])
    variances = np.array(
        [((c.factor_std or 0.0) / c.factor) ** 2 + (c.std / c.mean) ** 2 for c in known.values() if c.factor]
    )
    # Distance of each two factors, in standard deviations of their difference.
    apart = np.abs(logs[:, None] - logs[None, :]) / np.sqrt(variances[:, None] + variances[None, :])
    if apart.max() < PRIOR_CONFLICT:
        # Weighted by 1 / variance: the most likely common factor.
        common = math.exp(float(np.average(logs, weights=1 / variances)))
        shared = {"parameters": list(known), "factor": common, "inputs": [i.name for i in model.inputs]}
        result.append(Finding(EstimationCode.PRIORS_OFF_ALIKE, Severity.WARNING, "", shared))
    return result


def name_unit_factor(factor: float, std: float) -> str:
    """The units whose mistaking makes this factor; empty where none does, or where it is not known well enough to say."""
    if factor <= 0 or std > UNIT_FACTOR_SHARE * factor:
        return ""
    size = abs(math.log(factor))
    return next((units for known, units in UNIT_FACTORS if abs(size - math.log(known)) < UNIT_FACTOR_SHARE), "")


def find_excluded_outputs(problem: EstimationProblem) -> tuple[Finding, ...]:
    """Outputs that read the same in every row and were left out."""
    if not problem.constant_outputs:
        return ()
    values = {"outputs": list(problem.constant_outputs)}
    return (Finding(EstimationCode.CONSTANT_OUTPUT_EXCLUDED, Severity.WARNING, "", values),)


# Error on validation records over that on the fitted ones from which the difference wants an explanation.
VALIDATION_RATIO = 1.5


# Records of which all pairs are compared.
PAIRED_RECORDS = 20


def list_shared_noise(fitted: Sequence[Trace], judging: Sequence[Trace] = ()) -> list[Finding]:
    """Pairs of records, one of them ``judging`` if there are any, that hold one measurement twice by what the model leaves of them."""
    pairs = [(b, a) for a in fitted for b in judging] or [(b, a) for k, b in enumerate(fitted) for a in fitted[:k]]
    return [
        Finding(
            EstimationCode.NOISE_SHARED,
            Severity.WARNING,
            b.name,
            {"other": a.name, "shared": r, "judges": bool(judging)},
        )
        for b, a in pairs
        if (r := find_shared_noise(a, b))
    ]


def find_validation_issues(fitted: Fit, validation: Validation) -> tuple[Finding, ...]:
    """Outputs whose error is clearly larger on records that were not fitted; before them, that these go where no fitted one has been."""
    misfit = fitted.misfit
    larger = [
        Finding(EstimationCode.VALIDATION_ERROR_LARGER, Severity.WARNING, name, {"ratio": m.rmse / misfit[name].rmse})
        for name, m in validation.misfit.items()
        if name in misfit and m.noise_ratio > NOISE_RATIO and m.rmse > VALIDATION_RATIO * misfit[name].rmse
    ]
    known, judging = ([trace.experiment for trace in traces] for traces in (fitted.traces, validation.traces))
    beyond = find_range_beyond(known, judging, fitted.model) if larger else None
    return (*([beyond] if beyond else []), *larger)


# Share of the fitted range of a signal by which a reading must leave it to be outside: an end that noise has moved is none.
RANGE_MARGIN = 0.1
# Share of rows outside from which records judge what none of the fitted ones has shown.
BEYOND_SHARE = 0.1


def find_range_beyond(fitted: Sequence[Experiment], judging: Sequence[Experiment], model: Model) -> Finding | None:
    """The input or output that most often lies outside its fitted range in the judging records; None where all hardly ever do."""
    units, beyond = {i.name: i.unit for i in model.inputs} | {o.name: o.unit for o in model.outputs}, []
    for name in units:
        known, judged = (
            np.concatenate([s[name] for e in records for s in (e.inputs, e.outputs) if name in s] or [np.empty(0)])
            for records in (fitted, judging)
        )
        known, judged = known[np.isfinite(known)], judged[np.isfinite(judged)]
        if not (len(known) and len(judged)):
            continue
        low, high = float(known.min()), float(known.max())
        margin = RANGE_MARGIN * (high - low)
        share = float(np.mean((judged < low - margin) | (judged > high + margin)))
        reach = {"least": float(judged.min()), "most": float(judged.max())}
        values = {"low": low, "high": high, **reach, "unit": units[name], "share": share}
        beyond.append(Finding(EstimationCode.VALIDATION_BEYOND_RANGE, Severity.WARNING, name, values))
    worst = max(beyond, key=lambda finding: finding.values["share"], default=None)
    return worst if worst is not None and worst.values["share"] >= BEYOND_SHARE else None


def add_record_findings(
    findings: Iterable[Finding], experiments: Sequence[Experiment], is_robust: bool
) -> tuple[Finding, ...]:
    """``findings`` of a fit and those of its records: first those about doubtful measurements, then the others.

    ``is_robust`` as `collect_record_findings` has it.
    """
    records = collect_record_findings(experiments, is_robust=is_robust)
    faults = [finding for finding in records if is_sensor_fault(finding)]
    return (*faults, *findings, *(finding for finding in records if not is_sensor_fault(finding)))


def compute_lag_one_correlation(traces: Sequence[Trace], output: str) -> float:
    """Correlation of one output's residual with the sample before, over all records."""
    products, squares = 0.0, 0.0
    for trace in traces:
        if output in trace.measured:
            residual = trace.residual(output)
            for first in range(0, len(residual), ROWS_AT_A_TIME):  # a long record is in memory a few times only
                r, following = (
                    residual[first : first + ROWS_AT_A_TIME],
                    residual[first + 1 : first + ROWS_AT_A_TIME + 1],
                )
                before, measured = r[: len(following)], np.isfinite(r)
                pair = np.isfinite(following) & measured[: len(following)]
                # r_1 = sum r_t r_{t+1} / sum r_t^2.
                products += float(following[pair] @ before[pair])
                squares += float(r[measured] @ r[measured])
    return products / squares if squares > 0 else 0.0


def find_driven_balances(model: Model, name: str) -> dict[str, tuple[str, str, float]]:
    """States that the intensity ``name`` drives -> their balance, its unit, and storage times intensity, in that unit times sqrt(s)."""
    system = model.system
    p = list(model.values.values())
    at = ca.Function("at", [system.x, system.u, system.p], [system.storages, system.diffusion])
    x0 = system.start_function(p)[0]
    storages, sizes = (np.asarray(v).ravel() for v in at(x0, np.zeros(system.u.numel()), p))
    balances = {b.state: b for b in system.balances}
    driven = {}
    for k, state in enumerate(system.state_names):
        if name in {s.name() for s in ca.symvar(system.diffusion[k])}:
            balance = balances[state]
            driven[state] = balance.name, balance.unit, float(abs(storages[k]) * sizes[k])
    return driven


# Weight of a constant in an open direction, over the largest one, below which it takes no part.
OPEN_WEIGHT = 1e-6
# Change of the first of two constants, in its logarithm, with which a formula for what they determine together is tried in a run.
FORMULA_STEP = 0.3
# What such a run may add to the cost, over the variance of the residual.
FORMULA_RISE = 0.01


def _find_open_directions(optimum: Optimum) -> list[Finding]:
    """The directions that the records leave open, those that share constants together, with the formulas that they determine."""
    covariance, v, result = optimum.covariance, optimum.variables, []
    # In the logarithms of the constants: dp / p.
    with np.errstate(divide="ignore", invalid="ignore"):
        null = covariance.null * (v.spans / np.where(v.base == 0, v.spans, v.base))[:, None]
    touched = np.abs(null) > OPEN_WEIGHT * np.abs(null).max(axis=0, initial=TINY)
    left = list(range(null.shape[1]))
    while left:
        group = [left[0]]
        while more := [k for k in left if k not in group and (touched[:, group].any(axis=1) & touched[:, k]).any()]:
            group += more
        left = [k for k in left if k not in group]
        places = np.flatnonzero(touched[:, group].any(axis=1))
        directions = [
            {
                v.names[i]: float(null[i, k] / null[np.argmax(np.abs(null[:, k])), k])
                for i in np.flatnonzero(touched[:, k])
            }
            for k in group
        ]
        values = {
            "direction": {name: 1.0 for name in v.names if any(name in direction for direction in directions)},
            "directions": directions,
            "free": len(v.which),
            "determined": _value_formulas(optimum, places, null[places][:, group]),
        }
        result.append(Finding(EstimationCode.DIRECTION_UNDETERMINED, Severity.WARNING, "", values))
    return result


def _value_formulas(optimum: Optimum, places: np.ndarray, null: np.ndarray) -> list[dict[str, Any]]:
    """The formulas that the records determine of the constants at ``places``, whose open directions are ``null``, with their values."""
    v, covariance, p = optimum.variables, optimum.covariance, optimum.variables.base[places]
    names, units = [v.names[i] for i in places], [v.quantities[i].unit for i in places]
    spread, quantile = covariance.spread[np.ix_(places, places)], compute_quantile(covariance.degrees)
    chosen: list[np.ndarray] = []
    result = []
    for poly in find_determined_formulas(names, units, p, null):
        # d log f / d log p; of equal constants a product and a sum have the same, and a run tells them apart.
        slope = logarithmic_gradient(poly, p)
        if len(chosen) == len(places) - null.shape[1] or not are_independent([*chosen, slope], INDEPENDENT_FORMULA):
            continue
        if len(places) == 2 and not _keeps_the_run(optimum, places, poly):
            continue
        chosen.append(slope)
        value = sum(float(f) * float(np.prod(p**e)) for e, f in ((np.array(e, float), f) for e, f in poly.items()))
        along = value * slope / p
        std = float(np.sqrt(max(along @ spread @ along, 0.0)))
        is_product = len(poly) == 1
        exponents = next(iter(poly)) if is_product else [1]
        unit = "*".join(f"({unit})**{e}" for unit, e in zip(units, exponents, strict=False) if e)
        interval = compute_interval(value, quantile * std, is_product and value > 0, (-np.inf, np.inf))
        text = format_polynomial(poly, names)
        result.append({"text": text, "value": value, "std": std, "interval": list(interval), "unit": format_unit(unit)})
    return result


def _keeps_the_run(optimum: Optimum, places: np.ndarray, poly: Polynomial) -> bool:
    """Whether two constants that move so that a product of powers, a sum or a difference of theirs stays leave the cost as it is."""
    v, (one, other) = optimum.variables, optimum.variables.base[places].tolist()
    moved = one * math.exp(FORMULA_STEP)
    if len(poly) == 1:
        (first, second) = next(iter(poly))
        # p1^a p2^b stays.
        follows = other * math.exp(-FORMULA_STEP * first / second) if second else other
    else:
        # f1 p1 + f2 p2 stays.
        follows = other - float(poly[1, 0] / poly[0, 1]) * (moved - one)
    if np.sign(follows) != np.sign(other):
        return True
    values = {v.names[places[0]]: moved, v.names[places[1]]: follows}
    cost, count = optimum.evaluation.cost, optimum.evaluation.count
    evaluation = optimum.objective.at(v.with_values(values)).evaluate(v.here)
    return bool(evaluation.cost - cost <= FORMULA_RISE * max(abs(cost) / max(count - v.size, 1), 1.0))


def _find_bounds(variables: DecisionVector, covariance: ParameterCovariance, at_bound: Sequence[str]) -> list[Finding]:
    """Constants at their bounds: those that the records would have beyond, and the limits that they set to the others."""
    places = {k: variables.quantities[k] for k in covariance.limits if variables.quantities[k].name in at_bound}
    pulled = {k for k in places if covariance.limits[k].pull > compute_quantile(covariance.degrees)}
    # Without a covariance it is not known where the records would have it.
    known = {q.name for q in places.values()}
    stopped = [name for name in at_bound if name not in known or any(places[k].name == name for k in pulled)]
    result = _list_parameters(EstimationCode.STOPPED_BY_BOUND, stopped)
    for k, q in places.items():
        if k not in pulled:
            value = float(variables.base[k])
            values = {"limit": covariance.limits[k].limit, "unit": q.unit, "is_upper": value <= q.bounds[0]}
            result.append(Finding(EstimationCode.LIMITED_FROM_BOUND, Severity.NOTE, variables.names[k], values))
    return result


def _find_narrowed(covariance: ParameterCovariance, at_bound: Sequence[str]) -> list[Finding]:
    """Constants whose intervals hold only if others are exactly at their bounds, by these others."""
    groups: dict[tuple[str, ...], dict[str, float | None]] = {}
    for narrowed in covariance.held:
        # An intensity of process noise that is zero is no constant at a bound: there is no such noise.
        if all(name in at_bound for name in narrowed.at_bounds):
            growth = narrowed.growth if np.isfinite(narrowed.growth) else None
            groups.setdefault(narrowed.at_bounds, {})[narrowed.constant] = growth
    return [
        Finding(EstimationCode.NARROWED_BY_BOUND, Severity.WARNING, ", ".join(bounds), {"growth": growth})
        for bounds, growth in groups.items()
    ]


def _judge_process_noise(optimum: Optimum, test: ProcessNoiseTest, estimate: Estimate) -> Finding:
    """One intensity: where it acts, how sure it is, and what it means."""
    driven = find_driven_balances(optimum.fitted_model, test.name)
    values: dict[str, Any] = {
        "states": list(driven),
        "balances": list(dict.fromkeys(balance for balance, _, _ in driven.values())),
        "unit": estimate.unit,
        "upper_limit": None if test.limits is None else test.limits[1],
    }
    if test.value == 0:
        return Finding(EstimationCode.PROCESS_NOISE_ZERO, Severity.NOTE, test.name, values)
    if not test.significant:
        values["p_value"] = test.p_value
        return Finding(EstimationCode.PROCESS_NOISE_NOT_SIGNIFICANT, Severity.NOTE, test.name, values)
    records = optimum.problem.records
    period = float(np.median(np.concatenate([r.h for r in records])) * records[0].rows_per_sample)
    values |= {
        "intensity": estimate.value,
        "ratio": test.ratio,
        "period": period,
        "sizes": [{"size": size / float(np.sqrt(period)), "unit": unit} for _, unit, size in driven.values()],
    }
    return Finding(EstimationCode.PROCESS_NOISE_SIGNIFICANT, Severity.WARNING, test.name, values)
