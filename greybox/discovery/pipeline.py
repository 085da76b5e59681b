"""`discover`: a model, estimation and validation records in; a verdict with its claims out.

Baseline, noise, screening and selection are here, and the run over the validation records; what that comes to is in
`greybox.discovery.conclusion`. Several records are witnesses as well: which constants of the answer follow which of their conditions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import DataError, Finding, ModelError, Severity
from greybox.base.values import with_code
from greybox.data.data_frame import Frame
from greybox.data.experiment import Experiment, collect_record_findings, find_usual_interval, name_records
from greybox.data.findings import RecordCode
from greybox.data.identity import find_shared_readings, refuse_repeated
from greybox.data.noise.growing import GrowingNoise
from greybox.data.read import as_experiments
from greybox.discovery.answer import SearchAnswer, make_answer
from greybox.discovery.candidates import CandidateList, estimate_scales, failed_candidates, list_candidates
from greybox.discovery.conclusion import add_test_error, conclude, leave_out_small
from greybox.discovery.decision import judge_effect, judge_validation_only
from greybox.discovery.execution import PARALLEL_SECONDS, FailureLog, RefitExecutor, RefitJournal, SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.localisation import localise_residual
from greybox.discovery.plant_search import search_plant
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FitSettings, FittedCandidate, clean_cost_limit
from greybox.discovery.result import Discovery
from greybox.discovery.search import EffectSearch, MessageCallback
from greybox.discovery.table import FitTable
from greybox.estimation import Fit, FitOptions
from greybox.estimation.findings import EstimationCode
from greybox.estimation.fit import fit as estimate
from greybox.estimation.options import explain_unknown
from greybox.estimation.record_trends import shared_conditions
from greybox.estimation.transcription.preparation import begin_with_known_past
from greybox.estimation.transcription.problem import TranscriptionReason
from greybox.model import Effect, Model
from greybox.model.effects import Scales, all_effects, effect
from greybox.model.effects.scales import LONGEST_DELAY
from greybox.simulation.plant import Plant, PlantModel, as_model

Records = Experiment | Frame | Sequence[Any]
"""A record or several; a data frame is read for the model."""


# Share of a limited time that the search for effects may take; the rest is for the rivals of what it finds.
SEARCH_SHARE = 0.6


# A plain model, or a candidate, whose run goes astray has errors beyond all numbers: whoever weighs them looks whether they are finite.
@explain_unknown
@np.errstate(over="ignore")
def discover(
    model: Model | Plant,
    estimation: Records,
    *,
    validation: Records,
    test: Records = (),
    skip: int = 0,
    beginning: int = 0,
    noise: Mapping[str, float] | None = None,
    quiet: Records = (),
    effects: Sequence[Effect | str] | None = None,
    without: Collection[str] = (),
    options: FitOptions | None = None,
    policy: DiscoveryPolicy | None = None,
    on_message: MessageCallback | None = None,
    executor: Executor | None = None,
    workers: int = 0,
    journal: str | Path | None = None,
    on_refit: Callable[[int], None] | None = None,
    further: bool = False,
    time_limit: float = math.inf,
    beside: Sequence[Effect] = (),
    laws: bool = False,
) -> Discovery:
    """Find which effect, if any, ``model`` lacks.

    Refits the model with each effect of the catalogue that it has a site for to the estimation records, keeps what the data demand, and
    judges it on the validation records, which no parameter has seen. An effect that shows in the validation records only (a
    saturation that the estimation input never reaches) is learnt from their first half and judged on the second.

    Parameters
    ----------
    model
        The plain model; or a plant that is run from outside, of which effects at its inputs and outputs are looked for.
    estimation
        Records to fit to.
    validation
        Records to judge by.
    test
        Records that take no part in the search: what is found is held against the plain model there at the end, and its error told.
    skip
        Rows at the start of each validation and test record that the errors leave out.
    beginning
        Rows from which the initial state of each of them is estimated, not counted either; 0 for as many as `validate` takes.
    noise
        Standard deviation of outputs whose noise is known, in their units. Others are estimated.
    quiet
        Records with the input at rest, which show level and colour of the noise.
    effects
        The only candidates, instead of the catalogue; names are those of the catalogue.
    without
        Names of effects that are not tried. `greybox.discovery.family_of` lists an effect with its relatives.
    options
        Options of every fit. With a robust loss the search takes squares, without the readings that jump away and back within one row.
    policy
        The decision numbers.
    on_message
        Called with a line about each step.
    executor
        Where refits run, for example ``Client.get_executor()`` of Dask; None for this machine.
    workers
        Processes of this machine that a long search uses; 0 for one a core.
    journal
        A file in which every finished refit is kept, so that the same call resumes after an interruption.
    on_refit
        Called after each refit with the number of finished ones.
    further
        Whether smaller effects are looked for even where the residual is noise already.
    time_limit
        Seconds after which no refit begins and the best answer so far is given as such: no effect in it counts as established. The
        first fit and the runs over the validation records are always made.
    beside
        Effects of one's own that are candidates beside those of the catalogue.
    laws
        Whether an equation is looked for where no effect is established or more than noise is left. With ``effects=()`` nothing of the
        catalogue is tried, and the answer is an equation or none.

    Returns
    -------
    Discovery
        The verdict, both fits, the checks and the path that led there.

    Raises
    ------
    ModelError
        For an unknown name in ``without``, and where none of ``effects`` has a place in the model.
    DataError
        Without a validation record, for records that do not go with the model, and for a file that is no journal.

    Examples
    --------
    >>> found = gb.discover(model, train, validation=test, noise={"x": 2e-7})  # doctest: +SKIP
    >>> found.verdict, [e["name"] for e in found.effects]  # doctest: +SKIP
    ('named', ['coulomb_friction'])
    """
    began = time.perf_counter()
    learnt, judges, tests, rests = (
        name_records(as_experiments(records, as_model(model))) for records in (estimation, validation, test, quiet)
    )
    options, policy, on_message = options or FitOptions(), policy or DiscoveryPolicy(), on_message or (lambda _: None)
    if options.to_loss() is not None:  # sets of effects are compared by squares: what the loss would limit is left out
        learnt, judges, tests = (tuple(r.without_spikes() for r in records) for records in (learnt, judges, tests))
        options = replace(options, loss="squares")
    model = as_model(model)
    tried = None if effects is None else [effect(e) if isinstance(e, str) else e for e in effects]
    candidates = (*(all_effects() if tried is None else tried), *beside)
    if any(isinstance(e, Effect) and e.delay and e.name not in without for e in candidates):
        # Every candidate sees the same rows: a delay must not be held against those of which nobody knows the input.
        delay = LONGEST_DELAY * find_usual_interval(learnt)
        learnt, judges, tests = (begin_with_known_past(model, rs, options, delay) for rs in (learnt, judges, tests))
    validation_set = ValidationSet(judges, skip, beginning)
    growing = [name for name, given in (noise or {}).items() if isinstance(given, GrowingNoise)]
    if growing:
        raise ModelError(
            f"noise of {', '.join(growing)} grows with the signal; a search takes a standard deviation for each row: fit the plain model,"
            " and give the records the noise of its run (Experiment.noise)"
        )
    refuse_repeated(learnt)
    if used := [shared.second.name for shared in find_shared_readings(validation_set.records, learnt)]:
        raise DataError(
            f"validation record {', '.join(used)}: it is fitted too, and what was fitted cannot judge; give another one"
        )
    test_set = ValidationSet(tests, skip, beginning)
    known = (*learnt, *validation_set.records)
    if used := [shared.second.name for shared in find_shared_readings(test_set.records, known)]:
        raise DataError(f"test record {', '.join(used)}: it takes part in the search already; give another one")
    if not validation_set:
        raise DataError(
            "no validation record: a discovery needs a record that was not fitted; give at least one, another run or the"
            " end of this one (shell: --validate FILE)"
        )
    if isinstance(model, PlantModel):
        if laws:
            raise ModelError(
                f"{model.title} is run from outside: the equation that a balance lacks needs equations; leave out laws"
            )
        return search_plant(
            model,
            learnt,
            partial(
                discover,
                skip=skip,
                beginning=beginning,
                noise=noise,
                without=without,
                policy=policy,
                on_message=on_message,
                executor=executor,
                workers=workers,
                journal=journal,
                on_refit=on_refit,
                further=further,
                time_limit=time_limit,
                beside=beside,
            ),
            effects=tried,
            options=options,
            test=test_set,
            fitting={
                "validation": validation_set.records,
                "noise": noise,
                "quiet": rests,
                "skip": skip,
                "beginning": beginning,
            },
        )
    refit_journal = RefitJournal(Path(journal)) if journal else None
    for finding in refit_journal.findings if refit_journal else ():
        on_message(str(finding))
    if not time_limit > 0:
        raise DataError(f"a time limit of {time_limit:g} s: give a number of seconds above 0")
    refits = RefitExecutor(
        executor,
        workers,
        refit_journal,
        on_refit,
        PARALLEL_SECONDS,
        began + SEARCH_SHARE * time_limit,
        began + time_limit,
    )
    with refits.open():
        problem = DiscoveryProblem(
            model,
            learnt,
            dict(noise or {}),
            rests,
            options,
            refits,
            given=tuple(effect.name for effect in model.effects),
            user_settings=FitSettings(dict(noise or {}), rests, options),
        )
        # Where a record has to begin as it is told there are no stretches with first states of their own.
        unstable = _tell_if_errors_grow(problem.baseline, options, not (options.at_rest or skip or beginning))
        if unstable and (stretch := unstable[0].values["stretch"]):
            problem = replace(problem, experiments=_cut(problem.experiments, stretch))
            validation_set, test_set = (
                replace(s, records=_cut(s.records, stretch)) for s in (validation_set, test_set)
            )
        scales = _estimate_scales(problem)
        is_uniform = all(r.sampling_time is not None for r in (*problem.experiments, *validation_set.records))
        list_all = partial(list_candidates, model, scales, problem.failures, is_uniform=is_uniform)
        if laws and tried is not None and not tried:  # nothing of the catalogue
            listed = list_all(beside) if beside else CandidateList(())
        else:
            listed = list_all(tried, without, beside)
        findings = with_code(collect_record_findings(learnt), RecordCode.ROWS_OF_PAST)
        answer = _search(problem, listed.effects, scales, validation_set, policy, on_message, further)
        if not refits.is_late and _is_to_learn(answer):
            on_message(str(Finding(DiscoveryCode.LEARNING_FROM_VALIDATION)))
            first_halves, second_halves = validation_set.halve()
            wider = replace(problem, experiments=(*problem.experiments, *first_halves))
            answer = _search(wider, listed.effects, scales, second_halves, policy, on_message, further)
            findings = (Finding(DiscoveryCode.LEARNT_FROM_VALIDATION, Severity.WARNING), *findings)
        findings = (*findings, *unstable)
        result = conclude(answer, test_set, findings, problem if laws else None)
        if stuck := find_stuck_start(problem.baseline, result.base):
            result = replace(result, findings=(stuck, *result.findings))
        result = add_test_error(result, problem, test_set)
        witnesses = (*answer.problem.experiments, *answer.validation.records)
        compare = partial(follow_conditions, result.extended, witnesses, problem.options)
        trends = problem.failures.attempt(SearchStage.EVIDENCE, tuple(e["name"] for e in result.effects), compare, ())
        result = replace(result, findings=(*tell_failed_stages(problem.failures), *result.findings, *trends))
        fitted = {fit.effects[0] for fit in problem.fitted if len(fit.effects) == 1}
        failed = failed_candidates(listed.effects, problem.failures, fitted)
        not_reached: dict[str, Finding] = {}
        if refits.skipped:
            values = {"seconds": time_limit, "skipped": refits.skipped}
            result = replace(
                result, findings=(Finding(DiscoveryCode.TIME_OVER, Severity.WARNING, "", values), *result.findings)
            )
            seen = fitted | answer.search.screened | failed.keys()
            missed = [e.name for e in listed.effects if e.name not in seen]
            not_reached = {name: Finding(DiscoveryCode.NOT_REACHED, subject=name) for name in missed}
        return replace(
            result,
            not_tried=listed.not_tried | failed | not_reached,
            failures=tuple(problem.failures.entries.values()),
            seconds=time.perf_counter() - began,
        )


# Stages that fail as a whole: without one, what is said is less than the records carry.
WHOLE_STAGES = (SearchStage.WEIGHING, SearchStage.LAWS)


def tell_failed_stages(failures: FailureLog) -> tuple[Finding, ...]:
    """That a whole stage of a search failed, and why: its answer is what there was without it."""
    return tuple(
        Finding(DiscoveryCode.STAGE_FAILED, Severity.WARNING, str(f.stage), {"reason": f.reason})
        for f in failures.entries.values()
        if f.stage in WHOLE_STAGES
    )


# Misfit of the plain model from its start values over that of the one in the answer, from which the first was in another optimum.
WORSE_OPTIMUM = 1.1


def find_stuck_start(begun: FittedCandidate, plain: Fit) -> Finding | None:
    """That the plain model, fitted from its start values as anybody would, had ended in a worse optimum than that of the answer."""
    before, after = begun.noise_ratio, max((m.noise_ratio for m in plain.misfit.values()), default=math.inf)
    if not math.isfinite(before) or before <= WORSE_OPTIMUM * after:
        return None
    values = {"before": before, "after": after, "bounded": begun.is_noise_bounded}
    return Finding(DiscoveryCode.PLAIN_WAS_STUCK, Severity.WARNING, plain.model.title, values)


def _estimate_scales(problem: DiscoveryProblem) -> Scales:
    """Peaks and times of the plain model, and the distances after which what it leaves repeats."""
    plain = problem.baseline
    located = problem.failures.attempt(SearchStage.LOCALISATION, (), partial(localise_residual, plain), None)
    dependences = located.dependences if located else ()
    periods = {d.variable: d.period for d in dependences if d.period and d.is_relevant}
    return estimate_scales(plain).with_periods(plain.model, periods)


def _search(
    problem: DiscoveryProblem,
    candidates: Sequence[Effect],
    scales: Scales,
    validation: ValidationSet,
    policy: DiscoveryPolicy,
    on_message: MessageCallback,
    further: bool,
) -> SearchAnswer:
    """The set that wins on the table of all that was tried."""
    values = {"misfit": problem.baseline.noise_ratio, "bounded": problem.baseline.is_noise_bounded}
    on_message(str(Finding(DiscoveryCode.BASELINE_FITTED, values=values)))
    table = FitTable(HoldoutScores(problem, validation))
    search = EffectSearch(problem, table, candidates, scales, policy, on_message, further)
    if not candidates:
        return make_answer(search, search.baseline)
    return make_answer(search, leave_out_small(table, search.run()))


def _shows_on_validation_only(answer: SearchAnswer) -> bool:
    """Whether the plain model explains the estimation records and fails on the validation records."""
    if answer.candidate.effects:
        return False
    return judge_validation_only(answer.plain, answer.holdout, answer.noise_limits).passed


def _is_to_learn(answer: SearchAnswer) -> bool:
    """Whether the search is to learn from the validation records as well: the fitted ones ask for no effect, the others show one."""
    search = answer.search
    if answer.candidate.effects:
        if judge_effect(answer.plain, answer.plain, answer.candidate, search.policy.selection):
            return False
        # What the fitted records do not ask for explains the others by what these cannot tell from the truth.
        answer = make_answer(search, search.baseline)
    return _shows_on_validation_only(answer) and (answer.problem.options.at_rest or _explains_all(answer))


def _explains_all(answer: SearchAnswer) -> bool:
    """Whether one set of constants of the plain model explains the records that were fitted and those that judge."""
    problem = answer.scores.problem
    everywhere = replace(problem, experiments=(*problem.experiments, *answer.validation.records))
    fitted = problem.failures.attempt(SearchStage.HOLDOUT, (), lambda: everywhere.baseline, None)
    return fitted is not None and fitted.per_sample <= clean_cost_limit(fitted.count)


# Factor by which an error may grow over a stretch: the records of an unstable plant are searched in such ones.
STRETCH_GROWTH = math.e
# Fewest rows of a stretch: its first states are estimated from it as well.
LEAST_STRETCH_ROWS = 10


def _tell_if_errors_grow(plain: FittedCandidate, options: FitOptions, is_cut: bool) -> tuple[Finding, ...]:
    """That the records are too long for free runs of the plain model, which is unstable, and the ``stretch`` (s) over which they are run.

    0 s where they are run as they are, whether that can be helped or not (``is_cut``): claims rest on such runs.
    """
    choice = plain.choose_transcription(options)
    if choice.reason is None or choice.reason.code != TranscriptionReason.UNSTABLE:
        return ()
    # exp(rate duration) is the factor by which an error grows.
    rate = choice.reason.values["rate"]
    longest, stretch = (math.log(g) / rate for g in (options.policy.transcription.max_error_growth, STRETCH_GROWTH))
    periods = [np.median(np.diff(e.time)) for e in plain.problem.experiments]
    if not is_cut or stretch < LEAST_STRETCH_ROWS * max(periods):
        stretch = 0.0
    values = {**choice.reason.values, "longest": longest, "stretch": stretch}
    return (Finding(DiscoveryCode.ERRORS_GROW, Severity.WARNING, values=values),)


def _cut(records: Sequence[Experiment], stretch: float) -> tuple[Experiment, ...]:
    """The records in parts of as many seconds at most, all of a record alike."""
    parts: list[Experiment] = []
    for record in records:
        count = math.ceil(record.duration / stretch) if stretch else 1
        ends = np.linspace(0, record.rows, count + 1).astype(int)
        parts += [record.window(*pair) for pair in pairwise(ends.tolist())] if count > 1 else [record]
    return tuple(parts)


# Several records as witnesses: a load, a temperature, a voltage that constants follow.


def follow_conditions(fit: Fit, records: Sequence[Experiment], options: FitOptions) -> tuple[Finding, ...]:
    """What the constants of a model have in common over records that differ in a condition, one finding each.

    Parameters
    ----------
    fit
        The answer of a search.
    records
        Those that were fitted, and those that judged: for this question each is a witness.
    options
        How a fit is made.

    Returns
    -------
    tuple of Finding
        `EstimationCode.VALUES_BY_RECORD` for each constant; empty where the records have no condition in common that differs.
    """
    if len(records) < 2 or not shared_conditions(records):
        return ()
    # Shapes (a velocity, a time constant) stay common to all: one record alone seldom tells them, and the amplitude would take their place.
    shapes = {
        bound.model_names[q.name]
        for bound in fit.model.bound_effects
        for q in bound.effect.parameters
        if q.name not in bound.effect.amplitudes
    }
    given = {name for record in records for name in record.conditions}
    amplitudes = [q.name for q in fit.model.free_parameters if q.name not in shapes | given]
    if not amplitudes:
        return ()
    near = replace(options, progressive=False, other_starts=0, exchange=False, per_experiment=())
    each = estimate(fit.model, records, noise=fit.noise.given, per_experiment=amplitudes, options=near)
    return tuple(f for f in each.findings if f.code == EstimationCode.VALUES_BY_RECORD) if each.success else ()
