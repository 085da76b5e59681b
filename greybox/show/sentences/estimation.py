"""Sentences about fits: how a search ended, what the parameters and the residual say, what was asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from greybox.base import Finding, format_unit
from greybox.base.document import REMARK, Block, Facts, Paragraphs, TableBlock
from greybox.data.noise.noise_model import AutoRegression
from greybox.estimation.findings import EstimationCode
from greybox.estimation.profiles import NEARLY_COLLINEAR
from greybox.estimation.record_trends import TrendKind
from greybox.estimation.residuals import ResidualTestKind
from greybox.estimation.result import ResultCode
from greybox.estimation.transcription.problem import SolutionCode, TranscriptionReason
from greybox.show.sentences import register, renders, sentence, sentences, wording, writes
from greybox.show.sentences.data import describe_source, join_alike

if TYPE_CHECKING:
    from greybox.estimation import FitNoise, MultiStartResult, SolverReport
    from greybox.estimation.predictor import PredictionCorrection, SmoothedStates
    from greybox.estimation.residuals import ResidualTest, ResidualTests
    from greybox.estimation.score import Scores
    from greybox.estimation.uncertainty import Profile, ProfilePair

STATUS = {
    "converged": "converged",
    "kink": "converged at a kink of the cost, as dry friction causes: no small step lowers the cost",
    "acceptable": "converged to a looser tolerance: the last digits may change",
    "iteration_limit": "stopped at the iteration limit before convergence",
    "interrupted": "interrupted: the result is the best point so far",
    "stuck": "no further progress: the search stopped before it met the convergence test",
    "no_start": "the model cannot be simulated from the start values",
    "failed": "the solver failed",
}
CAUSES = {
    "no_start": (
        "start values far from physical ones",
        "an unstable model over a long record",
        "a missing bound (for example on a level, which cannot be negative)",
    ),
    "iteration_limit": (
        "parameters that the data do not determine: fix one",
        "start values far from the solution: set others with start",
        "too few iterations",
    ),
    "stuck": (
        "parameters that the data do not determine: fix one",
        "an effect that is not smooth in its parameters",
        "bounds that exclude the optimum",
    ),
    "failed": (
        "start values far from physical ones",
        "an unstable model over a long record",
        "bounds that exclude the optimum",
    ),
}
PARTS = {
    "first_half": "the first half of the record",
    "second_half": "the second half of the record",
    "small_motion": "small motion",
    "large_motion": "large motion",
}


def status_text(status: str) -> str:
    """How a search ended, without causes and details."""
    return STATUS.get(status, status)


@renders("SolverReport")
def write_status(report: SolverReport) -> str:
    """How a search ended, with its likely causes if it failed, and what its residual says."""
    text = status_text(report.status)
    if report.status in CAUSES:
        causes = "; ".join(f"({k + 1}) {cause}" for k, cause in enumerate(CAUSES[report.status]))
        text += f". Likely causes, most likely first: {causes}"
    for finding, words in zip(report.details, sentences(report.details), strict=True):
        ratio = finding.code in (EstimationCode.MISFIT_RATIO, EstimationCode.PREDICTION_RATIO)
        text += f"; {words}" if ratio else f". {wording.capitalise(words)}"
    return text


# Intervals that are wider by less than this factor are as wide: a reader would see no difference.
WIDER = 1.05


def _write_width(finding: Finding, white: str) -> str:
    """`` and are up to 3 times as wide as for white noise``; nothing where they are as wide."""
    inflation = finding.values["inflation"]
    return f" and are up to {inflation:.2g} times as wide as for white {white}" if inflation >= WIDER else ""


# Constants of open directions that a sentence lists; of more it says how many.
LISTED_CONSTANTS = 6


def _write_open(finding: Finding) -> str:
    """``Kf, La, Ra can change together ...: fix one of them``, and the formulas of theirs that are determined."""
    v = finding.values
    names, count = list(v["direction"]), len(v.get("directions", ())) or 1
    if len(names) == 1:
        return f"{names[0]} has no influence on the measured outputs, or none that free initial states could not have"
    listed = ", ".join(names) if len(names) <= LISTED_CONSTANTS else f"{len(names)} of {v['free']} constants"
    if count == 1:
        text = f"{listed} can change together without changing the outputs: fix one of them, or measure another output"
    else:
        text = f"{listed} share {count} free directions: fix {count} of them, or measure other outputs"
    determined = []
    for f in v.get("determined", ()):
        low, high = map(wording.make_formatter(f["value"], f["std"]), f["interval"])
        value = wording.with_unit(wording.format_with_std(f["value"], f["std"]), f["unit"])
        determined.append(f"{f['text']} = {value}, 95 % interval [{low}, {high}]")
    return text + (f"; determined: {', '.join(determined)}" if determined else "")


@writes(EstimationCode.MISFIT_RATIO)
def _write_misfit_ratio(finding: Finding) -> str:
    outliers = ", outliers excluded" if finding.values["without_outliers"] else ""
    ratio, least = finding.values["ratio"], finding.values.get("least_ratio")
    size = f"{ratio:#.3g}".rstrip(".") if least is None else f"at least {least:.3g}"
    return f"misfit {size} times the noise in {finding.subject}{outliers}"


@writes(EstimationCode.TERM_NOT_FINITE)
def _write_term_not_finite(finding: Finding) -> str:
    v = finding.values
    if v["kind"] == "start":
        what = f"the initial value of state {v['name']!r} is {v['value']}"
    else:
        named = {
            "term": f"the term {v['name']!r} of balance {v['balance']!r}",
            "storage": f"the inverse storage of balance {v['balance']!r}",
            "output": f"the output {v['name']!r}",
        }[v["kind"]]
        formula = f" ({v['formula']})" if len(v["formula"]) <= wording.LONGEST_FORMULA else ""
        what = f"{named}{formula} is {v['value']} {v['unit']}".rstrip()
    return f"{_write_place(finding)}: {what} at {_write_point(finding)}"


def _write_place(finding: Finding) -> str:
    v = finding.values
    return f"the simulation of experiment {v['experiment']} fails at t = {v['time']:.6g} s (row {v['row']})"


def _write_point(finding: Finding) -> str:
    return ", ".join(f"{q['name']} = {q['value']} {q['unit']}".rstrip() for q in finding.values["point"])


@writes(EstimationCode.MODEL_DOES_NOT_FOLLOW)
def _write_other_plant(finding: Finding) -> str:
    listed = ", ".join(
        f"{wording.percent_text(percent / 100, 2)} of {name}" for name, percent in finding.values["best_fit"].items()
    )
    return (
        f"the model follows only {listed} (best fit; 100 % is a perfect fit, 0 % a constant): do not use these parameters; check the"
        " units and signs of the columns, the fixed parameters, and whether this is the right model"
    )


def _write_part(label: str) -> str:
    kind, _, subject = label.partition(":")
    if kind == "experiment":
        return f"experiment {subject}"
    return PARTS[kind].replace("half of the record", "half of the record" if subject == "1" else "half of each record")


@writes(EstimationCode.PARAMETER_NOT_CONSTANT)
def _write_shifts(finding: Finding) -> str:
    by_parts: dict[tuple[str, ...], list[str]] = {}
    for s in finding.values["shifts"]:
        known = s["before"] is not None
        change = f"changes from {s['before']:.4g} to {s['after']:.4g} {s['unit']}" if known else "differs"
        deviations = float(f"{s['deviations']:.2g}")
        by_parts.setdefault(tuple(s["parts"]), []).append(
            f"{s['name']} {change} ({deviations:g} standard deviations by the noise alone)"
        )
    shifts = "; ".join(
        f"between {_write_part(first)} and {_write_part(second)}, {', '.join(changes)}"
        for (first, second), changes in by_parts.items()
    )
    several = len(finding.values["shifts"]) > 1
    words = "they compensate" if several else "it compensates"
    return f"not constant: {shifts}; {words} for an effect that the model lacks, or the plant changes"


@writes(EstimationCode.LIMITED_FROM_BOUND)
def _write_limit(finding: Finding) -> str:
    v, name = finding.values, finding.subject
    side, limit = ("lower", "an upper limit") if v["is_upper"] else ("upper", "a lower limit")
    if v["limit"] is None:
        return f"{name} is at its {side} bound, and the records set no {limit.partition(' ')[2]} to it"
    value = wording.value_with_unit(v["limit"], v["unit"], 3)
    return f"{name} is at its {side} bound; the records set {limit} of {value} (95 %)"


@writes(EstimationCode.NARROWED_BY_BOUND)
def _write_narrowed(finding: Finding) -> str:
    finite = {name: growth for name, growth in finding.values["growth"].items() if growth is not None}
    widened = ", ".join(f"{name} {growth:.2g} times" for name, growth in finite.items())
    open_names = [name for name in finding.values["growth"] if name not in finite]
    parts = [f"the intervals would be wider: {widened}"] if finite else []
    if open_names:
        parts.append(f"{', '.join(open_names)} would not be determined")
    several = "," in finding.subject
    where = "are at their bounds and count" if several else "is at its bound and counts"
    return f"{finding.subject} {where} as exactly known there; with {'them' if several else 'it'} free, {' and '.join(parts)}"


@writes(EstimationCode.INPUT_COURSE_CONTRADICTED)
def _write_course_contradicted(finding: Finding) -> str:
    changes = f", with {_list_changes(finding)}" if finding.values["changes"] else ""
    which = f"input {_list_courses(finding)}" if _courses(finding) else f"every value {wording.COURSES['mean']}"
    return f"the records fit better with {which}{changes}: {_course_remedy(finding)}"


@writes(EstimationCode.INPUT_COURSE_OPEN)
def _write_course_open(finding: Finding) -> str:
    courses, remedy = _list_courses(finding), f"if it moves so, {_course_remedy(finding)}"
    if not finding.values["changes"]:
        return f"how input {finding.subject} moves between its rows may matter, and could not be compared with {courses}; {remedy}"
    return (
        f"the records do not tell how input {finding.subject} moves between its rows, and it matters: with {courses} they would give"
        f" {_list_changes(finding)}; {remedy}"
    )


def _list_courses(finding: Finding) -> str:
    """``u straight between its rows, and d held between its rows``."""
    by_course: dict[str, list[str]] = {}
    for name, course in _courses(finding).items():
        by_course.setdefault(course, []).append(name)
    return ", and ".join(f"{' and '.join(names)} {wording.COURSES[course]}" for course, names in by_course.items())


def _courses(finding: Finding) -> dict[str, str]:
    # Files of earlier versions have one.
    return dict(
        finding.values["courses"] if "courses" in finding.values else {finding.subject: finding.values["course"]}
    )


def _course_remedy(finding: Finding) -> str:
    courses = _courses(finding) or "mean"
    if isinstance(courses, str):
        return f"read the records with hold={courses!r} (shell: --hold {courses}) and fit anew"
    options = " ".join(f"--interpolate {name}={course}" for name, course in courses.items())
    return f"read the records with hold={courses!r} (shell: {options}) and fit anew"


def _write_input_noise(finding: Finding) -> str:
    levels = finding.values["levels"].items()
    inputs = " and ".join(f"{name} (about {wording.with_unit(f'{level:.2g}', unit)})" for name, (level, unit) in levels)
    return f"input{'s' * (len(levels) > 1)} {inputs} {'were' if len(levels) > 1 else 'was'} measured with noise"


@writes(EstimationCode.INPUT_NOISE_COUNTED)
def _write_noise_counted(finding: Finding) -> str:
    return f"{_write_input_noise(finding)}: the intervals of {', '.join(finding.values['counted'])} count it"


@writes(EstimationCode.INPUT_NOISE_BIASES)
def _write_noise_biases(finding: Finding) -> str:
    return (
        f"{_write_input_noise(finding)}, which the fit takes for movement: without it, about {_list_changes(finding)}; smooth the input"
        " over a few rows, or take what drives it"
    )


def _list_changes(finding: Finding) -> str:
    changes = finding.values["changes"].items()
    return ", ".join(
        f"{n} = {new:.5g} for {old:.5g} ({size:.2g} standard deviations)" for n, (old, new, size) in changes
    )


@writes(EstimationCode.STEP_MOVES_PARAMETERS)
def _write_step_shifts(finding: Finding) -> str:
    shifts = ", ".join(f"{name} by {shift:.2g}" for name, shift in finding.values["shifts"].items())
    return (
        "with half the integration step the parameters change by more than a tenth of their standard deviation"
        f" ({shifts} standard deviations): increase the number of substeps"
    )


@writes(EstimationCode.PRIOR_CONFLICT)
def _write_prior_conflict(finding: Finding) -> str:
    v = finding.values
    # Files of earlier versions have no factor.
    factor = v.get("factor")
    units = f": {v['units']} mistaken?" if "units" in v else ""
    measured = (
        ""
        if factor is None
        else f" (the data say {wording.format_with_std(factor, v['factor_std'])} times its value{units})"
    )
    return (
        f"the prior of {finding.subject} and the data disagree by {v['deviations']:.2g} standard deviations{measured}: one of them, or"
        " the model, is wrong"
    )


@writes(EstimationCode.PRIORS_OFF_ALIKE)
def _write_priors_off_alike(finding: Finding) -> str:
    v = finding.values
    where = f"of the input {' or '.join(v['inputs'])}, or " if v["inputs"] else ""
    return (
        f"the data say {v['factor']:.3g} times the prior values of {wording.join_names(v['parameters'])} alike, as a gain {where}of a"
        " sensor does that is off by this factor: add the effect input_gain or sensor_gain and fit again"
    )


@writes(EstimationCode.GAIN_IS_UNIT_FACTOR)
def _write_gain_of_unit(finding: Finding) -> str:
    v = finding.values
    factor = f"{wording.format_with_std(v['factor'], v['factor_std'])} times"
    what = (
        f"the output {v['signal']} reads {factor} the value of the model"
        if v["kind"] == "output"
        else f"{factor} the input {v['signal']} of the record acts"
    )
    return f"{what}: {v['units']} mistaken?"


@writes(EstimationCode.VALUES_BY_RECORD)
def write_record_trend(finding: Finding) -> str:
    """What the values of a constant by record have in common."""
    v, name = finding.values, finding.subject
    unit = format_unit(v["unit"])
    low, high = (wording.format_number(each, 3) for each in v["at"])
    if v["kind"] == TrendKind.ALIKE:
        return f"one value of {name} does for all {v['records']} records: {wording.with_unit(str(low), unit)}"
    if v["kind"] == TrendKind.DIFFERENT:
        return f"{name} differs between the records ({low} to {high} {unit}) and follows no condition that is given"
    condition, (least, most) = v["condition"], v["levels"]
    ends = f"{low} to {high} {unit} at {least:g} to {most:g}"
    ratio = v["ratio"]
    rises = v["at"][1] > v["at"][0]
    way = "grows" if rises else "falls"
    if ratio is None:
        text = f"{name} {'rises' if rises else 'falls'} with {condition}: {ends}"
    elif least > 0:
        proportion = " in proportion to" if v["kind"] == TrendKind.PROPORTIONAL else " with"
        text = f"{name} {way}{proportion} {condition}: {ratio:.3g} times at {most / least:.3g} times the {condition} ({ends})"
    else:
        text = f"{name} {way} with {condition}: {ratio:.3g} times from {least:g} to {most:g} ({low} to {high} {unit})"
    if v["kind"] == TrendKind.PAIR:
        text += "; two records show no more than that they differ"
    if v["also"]:
        text += f"; in these records {wording.join_names(v['also'])} tells as much"
    return text


@writes(EstimationCode.ROBUST_LOSS_OUTLIERS)
def _write_outliers(finding: Finding) -> str:
    shares = finding.values["shares"]
    counted = f"{wording.format_shares(shares)} count as outliers" if shares else "no sample counts as an outlier"
    left_out = wording.join_names([f"{count} of {name}" for name, count in finding.values.get("left_out", {}).items()])
    bursts = f"; readings in bursts, {left_out}, are left out" if left_out else ""
    return f"robust loss ({finding.values['loss']}): {counted}{bursts}"


@writes(
    EstimationCode.PROCESS_NOISE_ZERO,
    EstimationCode.PROCESS_NOISE_NOT_SIGNIFICANT,
    EstimationCode.PROCESS_NOISE_SIGNIFICANT,
)
def _write_process_noise(finding: Finding) -> str:
    v = finding.values
    unit = format_unit(v["unit"])
    balances = " and ".join(f"the balance {b!r}" for b in v["balances"])
    where = f"process noise on {', '.join(v['states'])}"
    upper = "" if v["upper_limit"] is None else f", below {v['upper_limit']:.3g} {unit} at 95 %"
    if finding.code == EstimationCode.PROCESS_NOISE_ZERO:
        return f"{where} ({finding.subject}): zero{upper}; these records show no deviation from {balances}"
    if finding.code == EstimationCode.PROCESS_NOISE_NOT_SIGNIFICANT:
        return (
            f"{where} ({finding.subject}): not significant (p = {v['p_value']:.2g}){upper}; these records show no certain deviation"
            f" from {balances}"
        )
    sizes = " and ".join(
        f"{s['size']:.3g} {format_unit(s['unit'])} averaged over one sample of {v['period']:.3g} s" for s in v["sizes"]
    )
    return (
        f"{where} ({finding.subject} = {v['intensity']:.3g} {unit}): significant (likelihood ratio {v['ratio']:.3g}); {balances}"
        f" {'lacks' if len(v['balances']) == 1 else 'lack'} an effect, or a random disturbance acts there, of {sizes}"
    )


@writes(EstimationCode.STARTS)
def _write_starts(finding: Finding) -> str:
    """``18 of 20 starts ended at the best optimum, 2 at a worse one (misfit 3.4 times as large)``.

    How large the misfit is at the best one stands beside the status.
    """
    counts, ratios, nowhere = finding.values["counts"], finding.values["ratios"], finding.values["without_result"]
    total = sum(counts) + nowhere
    # over the best one, whose misfit may be as good as none
    larger = [wording.times_text(ratio / ratios[0], "as large") if ratios[0] > 0 else "larger" for ratio in ratios]
    parts = [f"{counts[0]} of {total} starts ended at the best optimum"]
    parts += [f"{n} at a worse one (misfit {size})" for n, size in zip(counts[1:4], larger[1:4], strict=True)]
    if len(counts) > 4:
        parts.append(f"{sum(counts[4:])} at still worse ones (from {larger[4]})")
    parts += [f"{nowhere} without a result"] * bool(nowhere)
    unmoved = finding.values.get("unmoved", {}).items()
    parts += [f"{n} of the first did not move {name} and say nothing of it" for name, n in unmoved]
    return ", ".join(parts)


def _write_best_fits(best_fit: Mapping[str, float]) -> str:
    return ", ".join(f"{percent:.2f} % of {name}" for name, percent in best_fit.items())


_TROUBLES = {
    "explains_nothing": "explains nothing",
    "stands": "stands where it began",
    "gave_up": "did not end within its iterations",
    "lost_constants": "ended where some of its constants change nothing",
    "another_course": "ended above the noise, of a model in which errors grow",
}


@writes(EstimationCode.OTHER_START_TAKEN)
def _write_other_start(finding: Finding) -> str:
    v = finding.values
    before = f" (best fit {_write_best_fits(v['before'])})" if v["before"] else ""
    # Files of earlier versions say only whether it stands where it began.
    trouble = v.get("trouble", "stands" if v.get("stands") else "explains_nothing")
    of_what = f" of {wording.join_names(list(v['before']))}" if trouble == "explains_nothing" and v["before"] else ""
    return (
        f"the search from the model's own start values {_TROUBLES[trouble]}{of_what}{before}; of {v['drawn']} other starts the"
        f" {v['searched']} most promising were searched, and the best follows {_write_best_fits(v['after'])}"
    )


@writes(EstimationCode.NO_START_HELPS)
def _write_no_start_helps(finding: Finding) -> str:
    v = finding.values
    remedy = "give start values nearer to physical ones, and check units, signs and bounds"
    if not v["best_fit"]:
        return f"no start helps: the model cannot be simulated from any of {v['drawn']} other starts either; {remedy}"
    others = f" from the model's own start values and from {v['searched']} others" if v["searched"] else ""
    return (
        f"the fit explains nothing of {wording.join_names(list(v['best_fit']))}{others}: its free run is hardly better than a constant"
        f" output (best fit {_write_best_fits(v['best_fit'])}); {remedy}"
    )


register(
    {
        EstimationCode.PREDICTION_RATIO: "prediction error {one_step:.3g} times the noise in {subject} one step ahead, simulation error"
        " {free_run:.3g} times",
        EstimationCode.FILTER_NOT_FINITE: "the Kalman filter diverges in experiment {experiment}: its values are not finite",
        EstimationCode.STATES_DIVERGE: lambda f: (
            f"{_write_place(f)}: the states diverge, although every term is finite; the largest is {f.subject!r}, at {_write_point(f)}"
        ),
        EstimationCode.SENSITIVITY_NOT_FINITE: "the simulation of experiment {experiment} succeeds, but its sensitivity to the parameters"
        " is not finite: a term has an infinite slope, as sqrt has at 0; set a bound on the state in this term, or rewrite the term with a"
        " finite slope",
        EstimationCode.PLANT_RUN_FAILED: "{subject} does not run over experiment {experiment} from its start values ({reason}): give"
        " others (model.start(...), shell: --start)",
        EstimationCode.DIRECTION_UNDETERMINED: lambda f: f"not determined by these data: {_write_open(f)}",
        EstimationCode.NO_FREEDOM: "{readings} readings for {unknowns} constants and first states: nothing is left that would tell the"
        " noise, so no interval can be given; tell the noise (--noise), or record more rows",
        EstimationCode.STOPPED_BY_BOUND: "stopped by a bound: {parameters:list}; widen the bound, or add the effect that the model lacks",
        EstimationCode.PARAMETER_UNDETERMINED: "not determined (the 95 % interval exceeds half the value): {parameters:list}",
        EstimationCode.HELD_BY_PRIOR: "determined by {parameters:its prior|their priors}: {parameters:list}; the data add little or"
        " nothing",
        EstimationCode.TIED_OUTSIDE_BOUNDS: lambda f: (
            "the tied parameter {subject} is outside its bounds: {value:.5g} {unit}, bounds [{low}, {high}] {unit}".format_map(
                {"subject": f.subject, **f.values, "unit": format_unit(f.values["unit"])}
            )
        ),
        EstimationCode.CONSTANT_OUTPUT_EXCLUDED: "excluded: {outputs:list} {outputs:is|are} constant, so {outputs:its|their} noise cannot"
        " be estimated (the {outputs:sensor|sensors} may be dead); give {outputs:its|their} noise to include {outputs:it|them}",
        EstimationCode.INPUT_BEFORE_OPEN: "record {subject} begins in motion, and for {seconds:.4g} s it shows what {input} was before:"
        " taken is its first value, {first@unit:6}; state another with --before {input}=VALUE (before=), or begin at --from {until:.4g},"
        " from where the record knows it",
        EstimationCode.NOTHING_TO_EXPLAIN: lambda f: (
            f"the records move no more than their noise (best fit {_write_best_fits(f.values['best_fit'])}): a constant output does as"
            " well, and the parameters mean nothing; use an input that moves the plant"
        ),
        EstimationCode.MISFIT_ABOVE_NOISE: "the misfit exceeds the noise: the model is incomplete, and its parameters may be biased",
        EstimationCode.MISFIT_ABOVE_DIFFERENCE_NOISE: "the misfit exceeds the noise estimated from differences of the records: the model"
        " is incomplete, or the noise is coloured (a quiet record shows which)",
        EstimationCode.RESIDUAL_CORRELATED: lambda f: (
            f"the residual of {wording.join_names(f.values['outputs'])} is correlated from sample to sample: the intervals allow for it"
            f"{_write_width(f, 'noise')}"
        ),
        EstimationCode.INNOVATIONS_CORRELATED: lambda f: (
            "the innovations are correlated from sample to sample: the model or its noise model is incomplete; the intervals allow for it"
            f"{_write_width(f, 'innovations')}"
        ),
        EstimationCode.INTEGRATION_TOO_COARSE: "the integration error exceeds a tenth of the noise in {outputs:list}: increase the number"
        " of substeps",
        EstimationCode.RELATION_NOT_MET: "the balance {subject} stores nothing, and its terms miss zero by {share:.2g} of the largest:"
        " give {state} a start value of the right size, and bounds",
        EstimationCode.NOISE_SHARED: lambda f: (
            f"{f.subject} and {f.values['other']} seem to be one measurement: what the model leaves of them agrees like one noise"
            f" (correlation {f.values['shared']:.2f}); "
            + (
                "then it cannot validate the model; use another record"
                if f.values["judges"]
                else "then its data count twice, and intervals are too narrow; leave one out"
            )
        ),
        EstimationCode.START_IN_FIRST_ROW: "record {subject} begins at {time:g} s, and the start of {states:list} is taken to hold there;"
        " where it holds at 0 s, begin the record with a row at 0 s without a reading",
        EstimationCode.VALIDATION_BEYOND_RANGE: "use estimation records that cover the whole range: the validation records reach from"
        " {least:.3g} to {most@unit:3} in {subject}, the estimation records only from {low:.3g} to {high@unit:3} ({share:percent 2} of the"
        " validation rows lie beyond)",
        EstimationCode.VALIDATION_ERROR_LARGER: "the simulation error in {subject} is {ratio:.1f} times that on the estimation records: a"
        " free run accumulates small errors of force and offset, above all if the plant integrates, and parameters change from day to day;"
        " validate on shorter records as well",
        EstimationCode.RESIDUAL_OF_STEPS: "the reading {subject} has steps of {step:.3g}, which by themselves make {share:percent 2} of"
        " the mean square of its residual: no model does much better",
        EstimationCode.RESIDUAL_OF_JITTER: lambda f: (
            f"the residual of {f.subject} grows with the rate at which it moves, as with time stamps that are off by"
            f" {f.values['jitter']:.2g} s (standard deviation,"
            f" {wording.percent_text(f.values['jitter'] / f.values['usual_step'], 2)} of the step): that makes"
            f" {wording.percent_text(f.values['share'], 2)} of its mean square"
        ),
        EstimationCode.MEAN_OF_EXPERIMENTS: "each experiment has its own value of {parameters:list}: the fitted model has the mean, and a"
        " validation uses the mean",
        EstimationCode.CONDITION_OF_RECORDS: "{subject} is no constant of the model: constants that each record has for itself are held"
        " against it",
        EstimationCode.TOO_MANY_OUTLIERS: "too many samples of {outputs:list} count as outliers: the model is incomplete, or the noise is"
        " larger than assumed",
        EstimationCode.NOISE_COLOUR_IGNORED: "the noise is coloured, but a fit with process noise assumes white noise",
        EstimationCode.CONSTANT_BY_RECORD: lambda f: (
            f"{f.subject} is taken as {wording.value_with_unit(f.values['value'], f.values['unit'], 6)} by what the record shows; fix it"
            f" (--fix {f.subject}=VALUE) where you know it"
        ),
        EstimationCode.STARTS_NOT_BEGUN: "{left:d} of {starts:d} starts were not finished within {seconds:.3g} s; repeat the command to"
        " continue with them",
    }
)


@renders("MultiStartResult")
def write_multistart(result: MultiStartResult) -> str:
    """Where the starts ended, then the best fit."""
    return f"{result.summary}\n{result.best}"


@renders("SmoothedStates")
def write_smoothed_states(states: SmoothedStates) -> str:
    """Range and standard deviation of each state, mean and standard deviation of each innovation."""
    lines = [f"{states.experiment}: {len(states.time)} rows smoothed, {states.discretisation}"]
    for name, mean in states.mean.items():
        size = np.sqrt(np.mean(states.std[name] ** 2))
        unit = format_unit(states.units[name])
        seen, spread = wording.range_with_unit(mean.min(), mean.max(), unit), wording.value_with_unit(size, unit, 2)
        lines.append(f"  {name}: {seen}, standard deviation {spread}")
    for name, e in states.innovations.items():
        lines.append(
            f"  innovation of {name}: mean {np.nanmean(e):.2g}, standard deviation {np.nanstd(e):.3g} (1 is correct)"
        )
    return "\n".join(lines)


@renders("PredictionCorrection")
def write_correction(correction: PredictionCorrection) -> str:
    """How measurements correct a prediction."""
    if correction.kind == "none_white":
        return "none: the simulation error is white"
    if correction.kind == "none_zero":
        return "none: the process noise is zero"
    if correction.kind == "autoregression":
        orders = ", ".join(f"{name} AR({c.order})" for name, c in correction.colours.items() if c.order)
        return f"autoregression of the simulation error ({orders})" if orders else "none: the simulation error is white"
    estimated = " estimated" if correction.kind == "estimated_kalman_filter" else ""
    return f"Kalman filter, process noise{estimated} on {', '.join(correction.model.noisy_states)}"


@writes(ResultCode.OTHER_CONSTANT)
def _write_other_constant(finding: Finding) -> str:
    fitted, now = (f"{finding.values[when]:.6g}" for when in ("fitted", "now"))
    unit = f" {format_unit(finding.values['unit'])}".rstrip()
    return (
        f"{finding.subject} was {fitted}{unit} in the fit and is {now}{unit} in the model now: the result keeps {fitted}{unit};"
        " repeat the fit with the new value"
    )


register(
    {
        ResultCode.FOREIGN_FINDING: lambda f: (
            f"{f.subject + ': ' if f.subject else ''}the file holds a finding that this version has no sentence for"
            f" ({f.values['code']})"
        ),
        ResultCode.OTHER_MODEL: lambda f: (
            f"the model {f.subject} is not the one that was fitted: {f.values['fitted'] or 'nothing'} (fitted),"
            f" {f.values['now'] or 'nothing'} (now); its intervals and errors are those of the fitted one"
        ),
    }
)


@renders("FitNoise")
def write_noise(noise: FitNoise) -> str:
    """Where the noise of each output is known from; levels that a likelihood estimated with their 95 % interval."""
    texts = {}
    for name, source in noise.sources.items():
        if name in noise.log_std:
            texts[name] = _write_estimated_level(noise, name)
        elif name in noise.growth:
            texts[name] = _write_growth(noise, name)
        else:
            bound = noise.bound(name)
            direction = source.direction if bound is None else bound.direction
            texts[name] = describe_source(source, AutoRegression(tuple(noise.colour.get(name, ()))), direction)
    return join_alike(texts, always_named=bool(noise.log_std))


def _write_growth(noise: FitNoise, output: str) -> str:
    """``0.02 g + 9.8 % of the reading (floor and share estimated from the residual)``."""
    growth = noise.growth[output]
    origin = f"{' and '.join(growth.estimated)} estimated from the residual" if growth.estimated else "given"
    if growth.unknown:
        return "grows with the signal, not known"
    if growth.logarithmic:
        return f"{growth.share:.3g} in log({output}) ({origin.replace('share ', '')})"
    parts = [f"{growth.floor:.3g} {noise.units.get(output, '')}".rstrip()] if growth.floor else []
    parts += [f"{wording.percent_text((growth.share or 0.0), 3)} of the reading"] if growth.share else []
    return f"{' + '.join(parts)} ({origin})"


def _write_estimated_level(noise: FitNoise, output: str) -> str:
    low, high = noise.interval(output)
    known = math.log(high / noise.std[output]) < wording.NOISE_REACH
    ends = f" [{low:.3g}, {high:.3g}]" if known else " (poorly determined)"
    source = "estimated with the parameters" if output in noise.named else "from the innovations"
    return f"{noise.std[output]:.3g}{ends} {noise.units[output]} {source}"


# Sentences of the transcriptions: how a solution was searched for, and why so (goes on after "chosen because").

_STIFF = "the model is stiff: its fastest mode has a time constant of {fastest:.2g} s and needs {substeps:.0f} explicit steps a sample"


def _write_integrating(ending: str) -> Callable[[Finding], str]:
    def write(finding: Finding) -> str:
        duration, number = finding.values["duration"], finding.values["time_constants"]
        length = f"{duration:.4g} s"
        if number is not None:
            length = f"{length} are {number:.2g} time constants of its slowest other mode"
        return f"the model integrates ({length}); {ending}"

    return write


@writes(SolutionCode.SEARCH_STRATEGY)
def _write_strategy(finding: Finding) -> str:
    """What was searched, how it was completed, and why it was chosen."""
    v = finding.values
    text = _write_transcription(finding.subject, v) + (", as requested" if v.get("reason") == "" else "")
    if v.get("held_samples"):
        text += f"; {v['held_samples']} samples lie at a bound of a state"
    text += {
        "free_run": "; then a free run from that result, as the noise model, the cost or the steps require",
        "white_noise": "; the noise is assumed to be white, because a free run does not follow this plant; the intervals allow for its"
        " colour",
        "went_on": "; that led no farther, and the search went on by free runs from the best point",
    }.get(v.get("completion", ""), "")
    if not v.get("reason"):
        return text
    return f"{text}; chosen because {sentence(Finding(v['reason'], values=v.get('reason_values', {})))}"


def _write_transcription(name: str, v: Mapping[str, Any]) -> str:
    if name == "single":
        parts = ", ".join(wording.percent_text(share, 3) for share in (*(s for s in v["shares"] if s < 1), 1.0))
        growing = any(share < 1 for share in v["shares"])
        return f"single shooting on a growing record ({parts})" if growing else "single shooting on the whole record"
    if name == "multiple":
        segments = "one segment" if v["segments"] == 1 else f"{v['segments']} segments"
        return f"multiple shooting over {segments}"
    if name == "arcs":
        if v["whole"]:
            return (
                f"arcs of {v['arc_length']:g} s; no record is divided (a second arc would be shorter than half an arc)"
            )
        return f"{v['arcs']} arcs of {v['arc_length']:g} s, each with its own initial state"
    if name == "prediction":
        kind = "exact" if v["exact"] else "extended"
        return f"prediction error with the {kind} Kalman filter, started from the free-run fit or the start values"
    return "direct collocation"


register(
    {
        TranscriptionReason.STABLE: "the model is stable and not stiff",
        TranscriptionReason.UNSTABLE: "the model is unstable: errors grow at {rate:.3g} 1/s, by e^{exponent:.3g} over the record of"
        " {duration:.4g} s, too far for a free run",
        TranscriptionReason.FREE_RUN_FOLLOWS: "the model is stiff, and a free run follows the records although errors may grow at"
        " {rate:.3g} 1/s",
        TranscriptionReason.STIFF_IMPLICIT: f"{_STIFF}; a few implicit steps suffice",
        TranscriptionReason.STIFF_NOT_SMOOTH: f"{_STIFF}; collocation does not handle sticking, switching or delays, so the fit takes these"
        " steps",
        TranscriptionReason.STIFF_LONG: f"{_STIFF}; {{samples}} samples are too many for collocation, so the fit takes these steps",
        TranscriptionReason.STIFF_COLLOCATION: f"{_STIFF}; collocation at Radau points needs one",
        TranscriptionReason.INTEGRATING_SHORT: _write_integrating(
            "a free run stays near the data over this short time"
        ),
        TranscriptionReason.INTEGRATING_GROWING: _write_integrating(
            "a growing part of the record keeps the free run near the data"
        ),
    }
)


# Profiles in plain text.


# Times as closely as alone that a constant is known beside another, from which a region is called thin.
LEAST_NARROWING = 3.0


@renders("Profile")
def write_profile(profile: Profile) -> str:
    """``K: 7000 N/m, 95 % by profile likelihood [6988, 7012]; bounded``, and below it what is to be known of the shape."""
    sides = [
        f"{v:.5g}{(' (its bound)' if v == profile.best else ' (open)') if is_open else ''}"
        for v, is_open in zip(profile.interval, profile.open_sides, strict=True)
    ]
    value = f"{profile.name}: {wording.value_with_unit(profile.best, profile.unit, 5)}"
    return "\n  ".join([f"{value}, 95 % by profile likelihood [{sides[0]}, {sides[1]}]", *explain_profile(profile)])


def explain_profile(profile: Profile) -> list[str]:
    """The shape of a profile in words, whether it is to be taken in place of the covariance, and which constant makes it so."""
    (low, high), open_sides = profile.interval, profile.open_sides
    shape = {
        "bounded": "bounded on both sides",
        "one_sided": f"one-sided: the records set no {'lower' if open_sides[0] else 'upper'} limit",
        "flat": "flat: the records set no limit on either side",
        "two_valleys": "two valleys",
    }[profile.shape]
    # At its bound there is one side to be followed.
    if profile.shape == "one_sided" and profile.best in (low, high):
        side, other = ("lower", "an upper") if profile.best == low else ("upper", "a lower")
        limit = wording.value_with_unit(high if profile.best == low else low, profile.unit, 5)
        shape = f"at its {side} bound: the records set {other} limit of {limit}"
    if profile.valley is not None:
        value, rise = profile.valley
        place = wording.value_with_unit(value, profile.unit, 5)
        shape += (
            f": at {place} the cost is less than at the optimum; fit again from there"
            if rise < 0
            else f": at {place} the cost has fallen again, to {rise:.3g} above its least (95 % at {profile.threshold:.3g})"
        )
    lines = [shape]
    if profile.is_better and profile.by_covariance is not None:
        low, high = profile.by_covariance
        lines.append(
            f"the covariance says [{low:.5g}, {high:.5g}], for a cost that it takes for a parabola: use the profile"
        )
    if abs(profile.correlation) > NEARLY_COLLINEAR:
        pair = f"{profile.name} and {profile.partner} are nearly collinear (correlation {profile.correlation:.5g})"
        known = f"the covariance takes {profile.partner} for known, as it is at its bound; the profile does not"
        combined = "the records determine a combination of them better than either"
        lines.append(f"{pair}: {known if profile.partner_at_bound else combined}")
    return lines


@renders("ProfilePair")
def write_profile_pair(pair: ProfilePair) -> str:
    """The region of two constants: from where to where, how thin it is, and where the records leave it open."""
    first, second = pair.first, pair.second
    shape = {
        "bounded": "bounded on all sides",
        "one_sided": "open towards some side",
        "flat": "flat: the records set no limit to either",
    }[pair.shape]
    ends = f"[{pair.values[0]:.5g}, {pair.values[-1]:.5g}] {pair.units[0]}"
    lines = [f"{first} and {second} together, 95 % by profile likelihood: {first} in {ends}; {shape}"]
    if math.isfinite(pair.narrowing) and pair.narrowing > LEAST_NARROWING:
        lines.append(
            f"beside a known {first}, {second} is known {pair.narrowing:.3g} times as closely: the region is thin, and the records"
            f" determine a combination of both (correlation {pair.correlation:.5g})"
        )
    return "\n  ".join(lines)


# What a residual test says, and the tables of tests and scores.

# Kind of test -> the sentence without and with an alarm.
_SENTENCES: dict[ResidualTestKind, tuple[Callable[[ResidualTest], str], Callable[[ResidualTest], str]]] = {
    ResidualTestKind.WHITENESS: (
        lambda t: f"no correlation over {t.lags} samples",
        lambda t: f"correlated over {t.lags} samples ({t.colour})",
    ),
    ResidualTestKind.INPUT_INDEPENDENCE: (
        lambda t: f"independent of the input {t.input}",
        lambda t: f"correlated with the input {t.input}: the model lacks part of its effect",
    ),
    ResidualTestKind.SAME_ROW: (
        lambda t: f"the input {t.input} does not answer the reading of its own row",
        lambda t: (
            f"correlated with the input {t.input} in the same row, which the model gives no path: a controller answers the reading (the"
            " loop is closed), or a direct path is missing"
        ),
    ),
    ResidualTestKind.NORMALITY: (
        lambda t: "normally distributed",
        lambda t: "not normal: look for outliers, quantisation or two regimes",
    ),
    ResidualTestKind.EQUAL_VARIANCE: (
        lambda t: "equally large throughout",
        lambda t: "larger in some parts of the record than in others",
    ),
    ResidualTestKind.EQUAL_MEAN: (lambda t: "no drift", lambda t: "its mean drifts, or an offset changes"),
}


def name_test(test: ResidualTest) -> str:
    """``whiteness, 5 lags`` or ``independence of u``: what tables and figures call a test."""
    if test.kind is ResidualTestKind.WHITENESS:
        return f"whiteness, {test.lags} lags"
    if test.kind is ResidualTestKind.INPUT_INDEPENDENCE:
        return f"independence of {test.input}"
    if test.kind is ResidualTestKind.SAME_ROW:
        return f"{test.input} in the same row"
    return test.kind.value.replace("_", " ")


@renders("ResidualTest")
def write_residual_test(test: ResidualTest) -> str:
    """What the test says."""
    return _SENTENCES[test.kind][test.alarm](test)


def residual_tests_tables(tests: ResidualTests, note: str = "") -> list[TableBlock]:
    """A row for each test; no table where none was made."""
    rows = [[t.output, name_test(t), f"{t.statistic:.4g}", f"{t.p_value:.2g}", str(t)] for t in tests.tests]
    table = TableBlock("Tests of the residual", ["output", "test", "statistic", "p", REMARK], rows, note)
    return [table] if rows else []


@renders("ResidualTests")
def write_residual_tests(tests: ResidualTests) -> list[Block]:
    """The tests, which residuals were whitened before, and what could not be tested."""
    whitened = f"the residual of {', '.join(tests.whitened)} was whitened with the noise model before the tests"
    lines = [*([whitened] if tests.whitened else []), *(f"not tested: {line}" for line in list_tests_not_made(tests))]
    return [*residual_tests_tables(tests), Paragraphs(lines)]


def list_tests_not_made(tests: ResidualTests) -> list[str]:
    """``y has too few values for normality, equal variance``: one for each output that could not be tested for everything."""
    return [
        f"{output} has too few values for {', '.join(kind.value.replace('_', ' ') for kind in kinds)}"
        for output, kinds in tests.not_made.items()
    ]


@renders("Scores")
def write_scores(scores: Scores) -> list[Block]:
    """A row for each output: errors of the free run and of predictions; infinite where a run overflows."""
    ahead = sorted({k for s in scores.outputs.values() for k in s.ahead})
    head = ["rmse", "free run", *(f"{k} step{'s' if k > 1 else ''} ahead" for k in ahead), "movement", "unit"]
    rows = [
        [name, *(f"{v:.4g}" for v in (s.rmse, *(s.ahead[k] for k in ahead), s.movement)), s.unit]
        for name, s in scores.outputs.items()
    ]
    corrections = dict.fromkeys(str(s.predictor) for s in scores.outputs.values())
    return [TableBlock("Free run and prediction", head, rows), Facts([("corrected by", text) for text in corrections])]
