"""`discover`: a model, estimation and validation records in; a verdict with its claims out.

The stages, each a function of its own: baseline, noise, screening and selection, holdout, decision, localisation, surrogate, proposals.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from greybox.base import Check, DataError, Finding, ModelError, Severity
from greybox.base.json_shape import to_values
from greybox.data.experiment import Experiment, name_records
from greybox.data.noise.growing import GrowingNoise
from greybox.discovery.candidates import CandidateList, estimate_scales, failed_candidates, list_candidates
from greybox.discovery.claims import (
    Claim,
    deepest_established,
    list_tied_sets,
    lower_grade,
    name_claim,
    read_verdict,
    weigh_claims,
)
from greybox.discovery.decision import (
    Conclusion,
    Decision,
    Grade,
    Verdict,
    decide_verdict,
    judge_validation_only,
    make_check,
    visible_rms_limit,
)
from greybox.discovery.effect_signal import (
    EVIDENCE_BLOCKS,
    EffectSignal,
    RemainingError,
    estimate_effect_signals,
    measure_remaining_error,
)
from greybox.discovery.execution import PARALLEL_SECONDS, RefitExecutor, RefitJournal, SearchStage
from greybox.discovery.false_names import ContestTable, FalseNameRate, lower_common, measure_false_names
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import (
    PARTIAL_SHARE,
    HoldoutError,
    HoldoutScores,
    RefitComparison,
    ValidationSet,
    block_errors,
    compare_errors,
    compare_holdout_errors,
    drop_on_validation,
    finish_fit,
    measure_structure,
    reject_on_validation,
    validate_candidate,
    worst_output,
)
from greybox.discovery.laws.search import LawSearch, search_laws
from greybox.discovery.localisation import ResidualLocalisation, localise_residual
from greybox.discovery.plant_search import search_plant
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FitSettings, FittedCandidate
from greybox.discovery.proposals import (
    explain_doubt,
    list_detection_limits,
    propose_experiments,
    propose_next_steps,
    propose_noise_check,
)
from greybox.discovery.record_conditions import follow_conditions
from greybox.discovery.refinement import (
    REFINEMENT_LEAST_DEVIATIONS,
    VALIDATION_SHARE,
    Refinement,
    refine_candidate,
    with_residual_noise,
)
from greybox.discovery.residual_noise import (
    WHITE_CORRELATION,
    estimate_residual_noise,
    excess_autocorrelation,
    is_level_known,
    is_noise_known,
    is_same_noise,
    is_shape_correction,
)
from greybox.discovery.result import Discovery, RankedCandidate, quote_test_error
from greybox.discovery.rivals import RivalSearch, refit_curves_in_place, refit_rivals
from greybox.discovery.selection import AUTOCORRELATION_LAGS, MessageCallback, StepKind, StepwiseSelection, checks_of
from greybox.discovery.surrogate import Surrogate, find_missing_sites, fit_surrogate
from greybox.discovery.table import FitTable
from greybox.estimation import Fit, FitOptions
from greybox.model import Effect, Model
from greybox.model.effects import Scales, applicable_effects
from greybox.simulation.plant import Plant, PlantModel, as_model

Records = Experiment | Sequence[Experiment]


@dataclass(frozen=True)
class JudgedSelection:
    """A finished selection and its error on the validation records.

    Parameters
    ----------
    selection
        The selection with its candidates and its path.
    selected
        The model that it ended with, before its shape was corrected.
    rivals
        Models that explain the records equally well.
    base, best
        The plain and the extended model as fits that were validated.
    holdout
        Error of both on the validation records, by output.
    scores
        These records, with every candidate that was run there.
    plain
        The model as the user gave it.
    checks
        Every check of the selection and of the rejection on the validation records.
    """

    selection: StepwiseSelection
    selected: FittedCandidate
    rivals: Sequence[FittedCandidate]
    base: Fit
    best: Fit
    holdout: Mapping[str, HoldoutError]
    scores: HoldoutScores
    plain: Model
    checks: tuple[Check, ...]

    @property
    def baseline(self) -> FittedCandidate:
        """The fit of the plain model."""
        return self.selection.baseline

    @property
    def corrected(self) -> FittedCandidate:
        """The selected model with the shape of its effects corrected, where the records asked for that."""
        return self.selection.shape_corrections.get(frozenset(self.selected.effects), self.selected)

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that the extended model explains, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].explained_fraction

    @cached_property
    def noise_limits(self) -> dict[str, float]:
        """Rms over noise that noise and the uncertainty of the constants hardly ever exceed on the validation records, by output."""
        colours = dict(zip((o.name for o in self.base.model.outputs), self.baseline.problem.noise.colour, strict=True))
        drift = self.scores.measure_drift(self.corrected if self.selected.effects else self.baseline)
        limits = {}
        for name, error in self.holdout.items():
            of_noise = visible_rms_limit(self.base.validation.misfit[name].samples, colours[name])
            limits[name] = math.hypot(of_noise, math.sqrt(drift.get(name, 0.0)) / error.floor)
        return limits


# Share of a limited time that the search for effects may take; the rest is for the rivals of what it finds.
SEARCH_SHARE = 0.6


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
    effects: Sequence[Effect] | None = None,
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
        The only candidates, instead of the catalogue.
    without
        Names of effects that are not tried. `greybox.discovery.family_of` lists an effect with its relatives.
    options
        Options of every fit.
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
    options, policy, on_message = options or FitOptions(), policy or DiscoveryPolicy(), on_message or _ignore
    validation_set = ValidationSet(_as_tuple(validation), skip, beginning)
    growing = [name for name, given in (noise or {}).items() if isinstance(given, GrowingNoise)]
    if growing:
        raise ModelError(
            f"noise of {', '.join(growing)} grows with the signal; a search takes a standard deviation for each row: fit the plain model,"
            " and give the records the noise of its run (Experiment.noise)"
        )
    test_set = ValidationSet(_as_tuple(test) if test else (), skip, beginning)
    known = {record.fingerprint: record.name for record in (*_as_tuple(estimation), *validation_set.records)}
    if used := [record.name for record in test_set.records if record.fingerprint in known]:
        raise DataError(f"test record {', '.join(used)}: it takes part in the search already; give another one")
    if not validation_set:
        raise DataError(
            "no validation record: a discovery needs a record that was not fitted; give at least one, another run or the"
            " end of this one (shell: --validate FILE)"
        )
    if isinstance(model := as_model(model), PlantModel):
        if laws:
            raise ModelError(
                f"{model.title} is run from outside: the equation that a balance lacks needs equations; leave out laws"
            )
        return search_plant(
            model,
            estimation,
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
            effects=effects,
            options=options,
            test=test_set,
            fitting={
                "validation": validation_set.records,
                "noise": noise,
                "quiet": _as_tuple(quiet),
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
            _as_tuple(estimation),
            dict(noise or {}),
            _as_tuple(quiet),
            options,
            refits,
            policy.budget,
            given=tuple(effect.name for effect in model.effects),
            user_settings=FitSettings(dict(noise or {}), _as_tuple(quiet), options),
        )
        scales = _estimate_scales(problem, policy)
        given = (
            effects
            if not beside or (laws and effects is not None and not effects)
            else _with_own(model, effects, beside)
        )
        if laws and effects is not None and not effects:
            listed = CandidateList(()) if not beside else list_candidates(model, scales, problem.failures, beside, ())
        else:
            listed = list_candidates(problem.model, scales, problem.failures, given, without)
        findings: tuple[Finding, ...] = ()
        judged = _select_and_judge(problem, listed.effects, scales, validation_set, policy, on_message)
        if problem.options.at_rest and not refits.is_late and _shows_on_validation_only(judged):
            on_message(str(Finding(DiscoveryCode.LEARNING_FROM_VALIDATION)))
            half = min(record.rows for record in validation_set.records) // 2
            first_halves = tuple(record.window(0, half) for record in validation_set.records)
            wider = replace(problem, experiments=(*problem.experiments, *first_halves))
            second_halves = ValidationSet(validation_set.records, half)
            judged = _select_and_judge(wider, listed.effects, scales, second_halves, policy, on_message)
            findings = (Finding(DiscoveryCode.LEARNT_FROM_VALIDATION),)
        result = _conclude(judged, listed.effects, test_set, findings, further, problem if laws else None)
        result = _quote_test_error(result, problem, test_set)
        witnesses = (*judged.selection.problem.experiments, *judged.scores.validation.records)
        compare = partial(follow_conditions, result.extended, witnesses, problem.options)
        trends = problem.failures.attempt(SearchStage.EVIDENCE, tuple(e["name"] for e in result.effects), compare, ())
        result = replace(result, findings=(*result.findings, *trends))
        fitted = {name for key in judged.selection.fits if len(key) == 1 for name in key}
        failed = failed_candidates(listed.effects, problem.failures, fitted)
        not_reached: dict[str, Finding] = {}
        if refits.skipped:
            values = {"seconds": time_limit, "skipped": refits.skipped}
            result = replace(
                result, findings=(Finding(DiscoveryCode.TIME_OVER, Severity.WARNING, "", values), *result.findings)
            )
            missed = [e.name for e in listed.effects if e.name not in fitted and e.name not in failed]
            not_reached = {name: Finding(DiscoveryCode.NOT_REACHED, subject=name) for name in missed}
        return replace(
            result,
            not_tried=listed.not_tried | failed | not_reached,
            failures=tuple(problem.failures.entries.values()),
            seconds=time.perf_counter() - began,
        )


def _estimate_scales(problem: DiscoveryProblem, policy: DiscoveryPolicy) -> Scales:
    """Peaks and times of the plain model, and the distances after which what it leaves repeats."""
    plain = problem.baseline
    locate = partial(localise_residual, plain, selection=policy.selection)
    located = problem.failures.attempt(SearchStage.LOCALISATION, (), locate, None)
    dependences = located.dependences if located else ()
    periods = {d.variable: d.period for d in dependences if d.period and d.is_relevant}
    return estimate_scales(plain).with_periods(plain.model, periods)


def _select_and_judge(
    problem: DiscoveryProblem,
    candidates: Sequence[Effect],
    scales: Scales,
    validation: ValidationSet,
    policy: DiscoveryPolicy,
    on_message: MessageCallback,
) -> JudgedSelection:
    """Noise, screening, selection and holdout."""
    values = {"misfit": problem.baseline.noise_ratio, "bounded": problem.baseline.is_noise_bounded}
    on_message(str(Finding(DiscoveryCode.BASELINE_FITTED, values=values)))
    selection = StepwiseSelection(problem, candidates, scales, policy, on_message)
    if is_noise_known(problem.baseline.problem.noise, bool(problem.quiet)):
        selected = selection.select()
    else:
        selection, selected = _select_with_unknown_noise(selection)
    checks = list(checks_of(selection.steps))
    scores = HoldoutScores(selection.problem, validation)
    if selected.effects:
        fits = list(selection.fits.values())
        selected, of_holdout = reject_on_validation(scores, selection.baseline, selected, fits, policy.selection)
        checks += of_holdout
        selected, of_holdout = drop_on_validation(scores, selected, fits, VALIDATION_SHARE)
        checks += of_holdout
    rivals = selection.find_rivals(selected) if selected.effects else []
    base = validate_candidate(selection.problem, selection.baseline, validation)
    final = selection.shape_corrections.get(frozenset(selected.effects), selected)
    attempt = problem.failures.attempt
    finish = partial(validate_candidate, selection.problem, final, validation)
    best = attempt(SearchStage.HOLDOUT, final.effects, finish, None) if selected.effects else base
    if best is None:  # it fails on other records than those that it was fitted to
        selected, rivals, best = selection.baseline, [], base
    holdout = compare_holdout_errors(base, best)
    return JudgedSelection(selection, selected, rivals, base, best, holdout, scores, problem.model, tuple(checks))


# Times that the noise is read off the residual and the selection repeated.
RESIDUAL_NOISE_ROUNDS = 2


def _select_with_unknown_noise(selection: StepwiseSelection) -> tuple[StepwiseSelection, FittedCandidate]:
    """The selection with the noise that the best single effect leaves, and again with the one that the selected model leaves."""
    policy, on_message = selection.policy, selection.on_message
    level_known = is_level_known(selection.baseline.problem.noise)
    selected = selection.select() if level_known else selection.select_first()
    for _ in range(RESIDUAL_NOISE_ROUNDS):
        if selection.problem.executor.is_late:
            break
        noise = estimate_residual_noise(selected)
        if is_same_noise(noise, selected.problem.noise):
            if level_known:
                break
            on_message(str(Finding(DiscoveryCode.NOISE_WHITE)))
        else:
            colours = [list(colour.reflection) for colour in noise.colour]
            values = {"colours": colours, "std": noise.std.tolist()}
            on_message(str(Finding(DiscoveryCode.NOISE_FROM_RESIDUAL, subject=selected.model.title, values=values)))
        plain = selection.problem
        problem = replace(plain, noise=noise, model=selection.baseline.model, options=plain.refit_options)
        previous = selection
        # Beside another effect one that is nothing alone may be much: single effects put none out of the running.
        leading = _leading_candidates(selection)
        is_full = any(step.kind is StepKind.ADD for step in selection.steps)
        selection = StepwiseSelection(
            problem,
            leading if is_full else selection.candidates,
            selection.scales,
            policy,
            on_message,
            selection.fits,
            {e.name for e in leading},
        )
        before, selected = selected, selection.select()
        if problem.executor.is_late:  # cut short: what the round before had found stands
            return previous, before
        if before.effects == selected.effects:
            break
    return selection, selected


# Sets of effects, best first, whose effects remain candidates when the selection is repeated.
CARRIED_SETS = 8


def _leading_candidates(selection: StepwiseSelection) -> list[Effect]:
    """The candidates that did best, in catalogue order, with their parents and children: the others are out of the running."""
    ranked = sorted(selection.fits.values(), key=lambda fit: fit.criterion)
    names = {name for fit in ranked[:CARRIED_SETS] for name in fit.effects}
    family = names | {parent for e in selection.candidates if e.name in names for parent in e.parents}
    return [e for e in selection.candidates if e.name in family]


def _shows_on_validation_only(judged: JudgedSelection) -> bool:
    """Whether the plain model explains the estimation records and fails on the validation records."""
    if judged.selected.effects:
        return False
    return judge_validation_only(judged.baseline, judged.holdout, judged.noise_limits).passed


def _decide(judged: JudgedSelection) -> Conclusion:
    policy, corrected = judged.selection.policy.selection, judged.corrected
    autocorrelation = excess_autocorrelation(corrected, AUTOCORRELATION_LAGS) if corrected.effects else 0.0
    decided = decide_verdict(
        judged.baseline,
        corrected,
        judged.rivals,
        judged.holdout,
        judged.noise_limits,
        autocorrelation,
        policy,
    )
    ties = judged.selection.tie_checks(judged.selected, judged.rivals)
    return replace(decided, checks=(*decided.checks, *ties))


def _with_own(model: Model, effects: Sequence[Effect] | None, beside: Sequence[Effect]) -> Sequence[Effect]:
    """The candidates with those of one's own behind them; one of the same name comes in the place of the catalogue's."""
    names = {e.name for e in beside}
    return (*(e for e in effects or applicable_effects(model) if e.name not in names), *beside)


@dataclass(frozen=True)
class LawAnswer:
    """What a search for laws makes of the answer: the verdict, the plain and the best model, what is left and the rivals."""

    search: LawSearch
    verdict: Verdict
    base: Fit
    best: Fit | None


def _look_for_laws(
    judged: JudgedSelection, problem: DiscoveryProblem, verdict: Verdict, final: FinalModel
) -> LawAnswer:
    """The equation that is missing beside what is established, as an answer."""
    validation, selection = judged.scores.validation, judged.selection
    baseline = problem.baseline
    if verdict is Verdict.PARTLY:
        again = problem.refit_best(final.candidate.model, [final.candidate.model.values], 1, like=final.candidate)
        baseline = again or baseline
    scores = HoldoutScores(problem, validation)
    search = search_laws(problem, scores, baseline, selection.policy, selection.on_message)
    plain = judged.base
    if verdict is not Verdict.PARTLY and search.baseline is not problem.baseline:
        plain = validate_candidate(problem, search.baseline, validation)
    if search.fit is None or search.grade is Grade.STAND_IN:
        # A plain model that only was stuck lacks nothing.
        is_complete = verdict is not Verdict.PARTLY and not search.is_missing
        return LawAnswer(search, Verdict.COMPLETE if is_complete else verdict, plain, None)
    if search.alternatives:
        reached = Verdict.AMBIGUOUS if search.is_clean else Verdict.UNKNOWN
    elif search.grade is Grade.ESTABLISHED:
        reached = Verdict.NAMED if search.is_clean else Verdict.PARTLY
    else:
        reached = Verdict.UNKNOWN
    if verdict is Verdict.PARTLY and reached is Verdict.UNKNOWN:
        reached = Verdict.PARTLY
    return LawAnswer(search, reached, plain, search.fit)


def _conclude(
    judged: JudgedSelection,
    candidates: Sequence[Effect],
    test: ValidationSet,
    findings: tuple[Finding, ...],
    further: bool,
    of_laws: DiscoveryProblem | None = None,
) -> Discovery:
    """Decision, further effects, claims, what is left, localisation, surrogate and proposals."""
    selection, selected = judged.selection, judged.selected
    policy, problem = selection.policy, judged.selection.problem
    attempt = problem.failures.attempt
    decided = _decide(judged)
    final = FinalModel(judged.scores, selected, judged.best)
    refinement: Refinement | None = None
    if further or decided.verdict is Verdict.UNKNOWN or _may_hold_more(judged):
        final, refinement = _refine(judged, candidates)
    signals = _estimate_signals(final)
    location = _locate(judged.baseline, selection)
    claims: tuple[Claim, ...] = ()
    rates: tuple[FalseNameRate, ...] = ()
    if candidates and decided.verdict is not Verdict.COMPLETE:
        problem.executor.release_reserve()
        known = selection.fits if refinement is None or not refinement.steps else {}
        rivals = RivalSearch(
            final.scores.problem,
            selection.scales,
            candidates,
            final.candidate,
            selection.baseline,
            known,
            signals,
            policy,
        )
        weigh = partial(_weigh, judged, rivals, location)
        claims, rates = attempt(SearchStage.EVIDENCE, final.candidate.effects, weigh, ((), ()))
        if problem.executor.skipped:  # not all rivals were tried
            claims = tuple(map(lower_grade, claims))
    tied = [rival.effects for rival in judged.rivals]
    decided = read_verdict(decided, claims, _named_effects(final.candidate), tied)
    verdict = decided.verdict
    judged = replace(judged, best=final.fit, holdout=compare_holdout_errors(judged.base, final.fit))
    answer: LawAnswer | None = None
    is_open = verdict in (Verdict.UNKNOWN, Verdict.PARTLY)
    if of_laws is not None and (is_open or not is_level_known(of_laws.noise_model)):
        look = partial(_look_for_laws, judged, of_laws, verdict, final)
        answer = attempt(SearchStage.LAWS, selected.effects, look, None)
    if answer is not None:
        verdict, decided = answer.verdict, replace(decided, verdict=answer.verdict)
        best = answer.best or (answer.base if verdict is Verdict.COMPLETE else final.fit)
        if answer.best is not None and answer.search.candidate is not None:
            final = FinalModel(
                HoldoutScores(of_laws or problem, judged.scores.validation), answer.search.candidate, best
            )
        judged = replace(judged, base=answer.base, best=best, holdout=compare_holdout_errors(answer.base, best))
        if verdict is Verdict.COMPLETE:
            final, claims, rates = FinalModel(judged.scores, judged.baseline, best), (), ()
    # The answer is what a fit of one's own gives, of the plain model and of the one that is handed over.
    base, doubts = _finish(judged, judged.base)
    best, more = (base, ()) if judged.best is judged.base else _finish(judged, judged.best)
    findings, holdout = (*findings, *doubts, *more), compare_holdout_errors(base, best)
    judged = replace(judged, base=base, best=best, holdout=holdout)
    final = replace(final, fit=best)
    refinement = None if refinement is None else replace(refinement, fit=best)
    uncounted, rejected, is_worse = judged.scores.validation.uncounted, "", False
    if names := " + ".join(_added_effects(judged)):
        better = judge_against_plain(judged.base, judged.best, uncounted, names)
        kept = judge_on_test(problem, judged.base, judged.best, test, names)
        is_worse = better.passed and not kept
        if not (better and kept):
            # What does no better than the plain model on the records that judge it is no answer: the plain model is.
            laws = {} if answer is None else {law.name: law.equation for law in answer.search.laws}
            rejected = " + ".join(laws.get(name, name) for name in _added_effects(judged))
            holdout = compare_holdout_errors(judged.base, judged.base)
            judged = replace(judged, selected=judged.baseline, rivals=(), best=judged.base, holdout=holdout)
            selected, final = judged.baseline, FinalModel(judged.scores, judged.baseline, judged.base)
            claims, signals, rates = (), (), ()
            refinement = None if refinement is None else Refinement(judged.base, (), refinement.checks)
            answer = None if answer is None else replace(answer, best=None, search=replace(answer.search, laws=()))
            decided = replace(_decide(judged), checks=decided.checks)
            verdict = decided.verdict
        decided = replace(decided, checks=(*decided.checks, *better.checks, *kept.checks))
    # Where no name is certain the answer still goes as deep as the records carry.
    is_deeper = verdict is Verdict.UNKNOWN and not problem.executor.skipped and deepest_established(claims) is not None
    of_names = [c for effect in _physical_effects(judged) if (c := name_claim(claims, effect)) is not None]
    is_probable = any(c.grade is Grade.PROBABLE for c in of_names)
    surrogate: Surrogate | None = None
    next_steps: tuple[Finding, ...] = ()
    if verdict in (Verdict.UNKNOWN, Verdict.PARTLY):
        represent = partial(
            fit_surrogate,
            replace(problem, model=judged.plain),
            judged.baseline,
            selected,
            holdout,
            judged.scores.validation,
            judged.base,
            policy,
        )
        # A curve stands in for what has no name: not where a law or a probable effect is said.
        named = (answer is not None and answer.best is not None) or is_probable
        if verdict is Verdict.UNKNOWN and not named:
            surrogate = attempt(SearchStage.SURROGATE, selected.effects, represent, None)
            if surrogate is not None and not (
                judge_against_plain(judged.base, surrogate.fit, uncounted)
                and judge_on_test(problem, judged.base, surrogate.fit, test)
            ):
                surrogate = None
            if surrogate is not None and surrogate.finished is not None:
                findings = (*findings, *_word_on(surrogate.finished))
    left_location = _locate(_under_less_noise(final), selection) if final.candidate.effects else location
    left = measure_remaining_error(final.fit, holdout, left_location, judged.scores.validation.uncounted)
    if verdict is Verdict.UNKNOWN and not is_probable:
        next_steps = _propose_for_unknown(judged, location, surrogate)
    elif verdict in (Verdict.PARTLY, Verdict.UNKNOWN) or (verdict is Verdict.AMBIGUOUS and not judged.rivals):
        next_steps = _propose_for_part(
            judged, left_location, of_names, bool(refinement and refinement.steps) and not test
        )
    elif verdict is Verdict.COMPLETE:
        next_steps = propose_noise_check(judged.base)
    if verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) or not next_steps:
        next_steps = (*next_steps, Finding(DiscoveryCode.CONFIRM_ON_ANOTHER_RECORD))
    propose = partial(propose_experiments, problem, selected, judged.rivals)
    experiments = attempt(SearchStage.PROPOSAL, selected.effects, propose, ())
    limits = list_detection_limits(selection.single_effects) if verdict is Verdict.COMPLETE else ()
    if judged.corrected is not selected and verdict is not Verdict.UNKNOWN and final.candidate is selected:
        added = [name for name in judged.corrected.effects if name not in selected.effects]
        values = {"correction": added}
        findings = (*findings, Finding(DiscoveryCode.SHAPE_CORRECTED, subject=_name(selected), values=values))
    fits = sorted(selection.fits.values(), key=lambda fit: fit.criterion)
    ranking = [RankedCandidate(f.effects, f.noise_ratio, f.criterion - fits[0].criterion) for f in fits]
    search = answer.search if answer is not None else None
    has_law = search is not None and answer is not None and answer.best is not None
    alternatives = [rival.effects for rival in judged.rivals]
    if verdict is Verdict.AMBIGUOUS and not alternatives:
        alternatives = list_tied_sets(claims, _physical_effects(judged))
    if is_deeper:
        verdict, decided = Verdict.PARTLY, replace(decided, verdict=Verdict.PARTLY)
    constants = {e.name: sum(not q.fixed for q in e.parameters) for e in candidates}
    summary = _summarise(
        judged, decided, claims, alternatives, left, location, surrogate, rejected, is_worse, constants
    )
    if search is not None and answer is not None and verdict is not Verdict.COMPLETE:
        summary = _summarise_laws(judged, search, has_law, summary, left)
        findings = (*findings, *_law_ranges(search)) if has_law else findings
    return Discovery(
        verdict,
        judged.base,
        judged.best,
        list(search.alternatives) if search is not None and has_law else alternatives,
        holdout,
        ranking,
        location,
        conclusion=summary,
        checks=(*judged.checks, *decided.checks, *(search.checks if search is not None else ())),
        path=tuple(selection.steps),
        findings=(*findings, *experiments, *limits),
        next_steps=next_steps,
        effect_signals=signals,
        surrogate=surrogate,
        refinement=refinement,
        claims=claims,
        false_names=rates,
        left=left,
        policy=policy,
        options=problem.options,
        laws=search.laws if search is not None and has_law else (),
    )


def _weigh(
    judged: JudgedSelection, rivals: RivalSearch, location: ResidualLocalisation
) -> tuple[tuple[Claim, ...], tuple[FalseNameRate, ...]]:
    """What resampling the records says of all sets of effects that were fitted: the search's own, and every rival of the answer.

    With it, how often signals without meaning would have been established in the place of the answer's effects.
    """
    selection, answer = judged.selection, rivals.selected
    table, attempt = FitTable(judged.scores), selection.problem.failures.attempt

    def weigh() -> tuple[Claim, ...]:
        table.add(selection.baseline, answer, *selection.problem.fitted)
        draws = table.draw(table.leading((selection.baseline, answer)))
        if not draws.sets:
            return ()
        leading = draws.sets[draws.leading].candidate
        left = measure_structure(table.scores, leading, only_visible=True)
        claims = weigh_claims(draws, location.sets, leading.given, left)
        # The certain answer is the model that is handed over: a name that it does not hold is no more than probable.
        return tuple(lower_grade(c) if c.name and c.name not in answer.effects else c for c in claims)

    fit_rivals = partial(refit_rivals, rivals)
    without = attempt(SearchStage.EVIDENCE, answer.effects, fit_rivals, None)
    claims = weigh()
    if without is None:  # a name that was held against no rival is not certain; the place may be
        return tuple(lower_grade(c) if c.name else c for c in claims), ()
    standing = [
        rest for name, rest in without.items() if (c := name_claim(claims, name)) is not None and c.is_established
    ]
    for rest in standing:
        refit_curves_in_place(rivals, rest)
    claims = weigh() if standing else claims
    taking_part = table.leading((selection.baseline, answer))
    contests = ContestTable(table, taking_part, answer, location.sets, len(rivals.candidates))
    rates = measure_false_names(contests, without, rivals.signals, claims)
    return lower_common(claims, rates, answer.model), rates


def _finish(judged: JudgedSelection, fit: Fit) -> tuple[Fit, tuple[Finding, ...]]:
    """A fit of the answer as one's own would end; with a word on it where another that begins there ends elsewhere, or fails."""
    problem, names = judged.selection.problem, tuple(e.name for e in fit.model.effects)
    finish = partial(finish_fit, problem, fit, judged.scores.validation)
    finished = problem.failures.attempt(SearchStage.HOLDOUT, names, finish, None)
    if finished is None:
        finished = RefitComparison(fit, is_settled=False)
    return finished.fit, _word_on(finished)


def _word_on(finished: RefitComparison) -> tuple[Finding, ...]:
    """That another fit which begins at this one ends elsewhere, or fails; nothing where it ends there too."""
    if finished.is_settled:
        return ()
    values = {"status": finished.status, "errors": list(finished.errors), "constants": dict(finished.constants)}
    return (Finding(DiscoveryCode.REFIT_ELSEWHERE, Severity.WARNING, finished.fit.model.title, values),)


def _summarise_laws(
    judged: JudgedSelection,
    search: LawSearch,
    has_law: bool,
    without: tuple[Finding, ...],
    left: Mapping[str, RemainingError],
) -> tuple[Finding, ...]:
    """The conclusion with the law: what it is, how certain, what it takes of the error; without one, that there is none."""
    if not has_law:
        values = {"terms": search.tried, "equations": [law.equation for law in search.laws]}
        code = DiscoveryCode.LAW_STAND_IN if search.laws else DiscoveryCode.NO_LAW
        return (*without, Finding(code, values=values))
    terms = [{"equation": law.equation, "site": law.site, "unit": law.unit} for law in search.laws]
    values = {"laws": terms, "rivals": [" + ".join(texts) for texts in search.alternatives]}
    established = search.grade is Grade.ESTABLISHED
    code = (
        DiscoveryCode.LAWS_TIED
        if search.alternatives
        else DiscoveryCode.LAW_ESTABLISHED
        if established
        else DiscoveryCode.LAW_PROBABLE
    )
    output = worst_output(judged.holdout)
    names = [law.name for law in search.laws]
    reduced = _error_reduced(names, judged.holdout, VALIDATION_SHARE)
    likeness = [
        Finding(
            DiscoveryCode.LAW_LIKENESS, subject=law.equation, values={"several": len(terms) > 1, **asdict(law.likeness)}
        )
        for law in search.laws
        if law.likeness is not None
    ]
    remaining = [
        Finding(DiscoveryCode.ERROR_LEFT, subject=o, values={**each.to_values(), "before": judged.holdout[o].before})
        for o, each in left.items()
        if not search.is_clean and o == output
    ]
    return (Finding(code, values=values), *likeness, *reduced, *remaining)


def _law_ranges(search: LawSearch) -> tuple[Finding, ...]:
    """Within what each law was seen."""
    return tuple(
        Finding(
            DiscoveryCode.LAW_RANGE,
            subject=law.equation,
            values={"range": {v: list(ends) for v, ends in law.seen.items()}, "units": dict(law.units)},
        )
        for law in search.laws
        if law.seen
    )


def judge_against_plain(base: Fit, fit: Fit, uncounted: int, subject: str = "") -> Decision:
    """Whether a model follows the records that judge it better than the plain one, beyond chance.

    Its error there, all outputs together, is smaller by a share that counts, or smaller in most parts of the records.

    Parameters
    ----------
    base, fit
        The plain model and the other one, validated on the same records.
    uncounted
        Rows at the start of each record that do not count.
    subject
        What the checks are about.
    """
    before, after = _sum_up(compare_holdout_errors(base, fit))
    errors, plain = (block_errors(each.validation, uncounted, EVIDENCE_BLOCKS) for each in (fit, base))
    deviations = compare_errors(errors, plain)[1] if errors else 0.0
    least = REFINEMENT_LEAST_DEVIATIONS
    lasts = after < before and deviations >= least
    checks = (
        Check.at_most(DiscoveryRule.VALIDATION_DECREASE, after, (1 - VALIDATION_SHARE) * before, subject),
        make_check(DiscoveryRule.CONSISTENT_DECREASE, deviations, least, lasts, subject),
    )
    return Decision(any(check.passed for check in checks), checks)


def judge_on_test(problem: DiscoveryProblem, base: Fit, fit: Fit, test: ValidationSet, subject: str = "") -> Decision:
    """Whether a model is no worse than the plain one on records that took no part in the search, but for chance.

    Its error there, all outputs together, is larger by less than a share that counts, or larger in some parts of the records only. Without
    such records, or where the plain model cannot be run there, nothing speaks against it.
    """
    plain, other = (_run_on_test(problem, each, test) for each in (base, fit))
    if plain is None:
        return Decision(True, ())
    # A model that cannot be run is infinitely worse.
    before, after, deviations = 1.0, math.inf, math.inf
    if other is not None:
        before, after = _sum_up(compare_holdout_errors(plain, other))
        errors = (block_errors(each.validation, test.uncounted, EVIDENCE_BLOCKS) for each in (plain, other))
        deviations = compare_errors(*errors)[1]
    least = REFINEMENT_LEAST_DEVIATIONS
    is_as_good = after <= before / (1 - VALIDATION_SHARE) or deviations < least
    return Decision(is_as_good, (make_check(DiscoveryRule.TEST_INCREASE, deviations, least, is_as_good, subject),))


def _run_on_test(problem: DiscoveryProblem, fit: Fit, test: ValidationSet) -> Fit | None:
    """A fit with its runs over the test records in the place of those over the validation records; None without such runs."""
    run = partial(test.run, fit.model, fit.noise.std, problem.options)
    names = tuple(e.name for e in fit.model.effects)
    validation = problem.failures.attempt(SearchStage.HOLDOUT, names, run, None) if test else None
    is_run = validation is not None and all(np.isfinite(m.rmse) for m in validation.misfit.values())
    return replace(fit, validation=validation) if is_run and validation is not None else None


def _quote_test_error(result: Discovery, problem: DiscoveryProblem, test: ValidationSet) -> Discovery:
    """A discovery with its error on the test records, beside that of the plain model; as it is without them."""
    plain = _run_on_test(problem, result.base, test)
    answer = plain if result.extended is result.base else _run_on_test(problem, result.extended, test)
    return result if plain is None or answer is None else quote_test_error(result, plain, answer)


def _sum_up(holdout: Mapping[str, HoldoutError]) -> tuple[float, float]:
    """Rms error over noise of the plain and of the other model, all outputs together."""
    pairs = [(e.before / e.floor, e.after / e.floor) for e in holdout.values()]
    before, after = (float(np.sqrt(np.mean(np.square(each)))) for each in zip(*pairs, strict=True))
    return before, after


@dataclass(frozen=True)
class FinalModel:
    """The model of the answer: as a candidate, as a validated fit, and the validation records under the noise it was fitted with."""

    scores: HoldoutScores
    candidate: FittedCandidate
    fit: Fit


def _may_hold_more(judged: JudgedSelection) -> bool:
    """Whether the noise has no more than a ceiling, and what is left below it remembers: white noise does not."""
    if not judged.selected.effects or is_level_known(judged.selection.problem.noise_model):
        return False
    corrected, attempt = judged.corrected, judged.selection.problem.failures.attempt
    measure = partial(measure_structure, judged.scores, corrected, only_visible=False)
    structure: float = attempt(SearchStage.REFINEMENT, corrected.effects, measure, 0.0)
    return structure > WHITE_CORRELATION


def _refine(judged: JudgedSelection, candidates: Sequence[Effect]) -> tuple[FinalModel, Refinement | None]:
    """Further effects where more than noise is left; None, and the selected model, where they cannot be looked for."""
    selection, scores = judged.selection, judged.scores
    problem, policy = selection.problem, selection.policy
    unrefined = FinalModel(scores, judged.selected, judged.best)
    start = judged.selected if scores.score(judged.selected) < scores.score(judged.baseline) else judged.baseline

    def search() -> tuple[FinalModel, Refinement | None]:
        of_rest = HoldoutScores(with_residual_noise(problem, start), scores.validation)
        refined = refine_candidate(of_rest, start, candidates, policy, selection.on_message)
        allowed = (1 - VALIDATION_SHARE) * of_rest.score(judged.corrected)
        check = Check.at_most(
            DiscoveryRule.REFINED_ERROR, of_rest.score(refined.candidate), allowed, _name(refined.candidate)
        )
        # A curve or a second branch that corrects the shape of an effect may do better than all further effects.
        if not refined.steps or not check:
            return unrefined, Refinement(judged.best, (), (*refined.checks, check))
        fit = validate_candidate(of_rest.problem, refined.candidate, scores.validation)
        return FinalModel(of_rest, refined.candidate, fit), Refinement(fit, refined.steps, refined.checks)

    return problem.failures.attempt(SearchStage.REFINEMENT, start.effects, search, (unrefined, None))


def _estimate_signals(final: FinalModel) -> tuple[EffectSignal, ...]:
    problem, candidate = final.scores.problem, final.candidate
    estimate_signals = partial(estimate_effect_signals, problem, candidate)
    return problem.failures.attempt(SearchStage.EVIDENCE, candidate.effects, estimate_signals, ())


def _locate(candidate: FittedCandidate, selection: StepwiseSelection) -> ResidualLocalisation:
    """What a candidate leaves unexplained; the misfit alone where its site cannot be estimated."""
    policy = selection.policy
    locate = partial(localise_residual, candidate, selection=policy.selection)
    located = selection.problem.failures.attempt(SearchStage.LOCALISATION, candidate.effects, locate, None)
    return located or ResidualLocalisation.without_sites(candidate)


# Share of a residual's variance that counts as noise at least where what is left is localised.
LEAST_NOISE_SHARE = 0.01


def _under_less_noise(final: FinalModel) -> FittedCandidate:
    """The final model with only that part of its residual for noise that nothing before it tells; as it is where the noise is known."""
    candidate = final.candidate
    problem = candidate.problem
    if problem.noise.is_level_known:
        return candidate
    structure = measure_structure(final.scores, candidate, only_visible=False)
    factor = max(1 - structure**2, LEAST_NOISE_SHARE) ** 0.5
    noise = replace(problem.noise, std=factor * problem.noise.std)
    return replace(candidate, problem=replace(problem, noise=noise), cost=candidate.cost / factor**2)


# Effects that are not established for which an experiment is asked, those that take the largest share of the error first.
MOST_SEPARATIONS = 2


def _propose_for_part(
    judged: JudgedSelection, location: ResidualLocalisation, names: Sequence[Claim], refined: bool
) -> tuple[Finding, ...]:
    """What to do about the rest beside established effects."""
    policy = judged.selection.policy
    doubtful = [c for c in names if not c.is_established]
    doubts = [doubt for c in doubtful if (doubt := explain_doubt(c)) is not None]
    shares = {c.name: c.share for c in doubtful}
    steps = sorted(doubts, key=lambda doubt: -shares[doubt.subject])[:MOST_SEPARATIONS]
    if refined:
        steps.append(Finding(DiscoveryCode.QUOTE_THIRD_RECORD))
    if not location.is_missing:
        return tuple(steps)
    records = judged.scores.validation.records
    return (*steps, *propose_next_steps(judged.base, location, None, records, policy, left=judged.best))


def _propose_for_unknown(
    judged: JudgedSelection, location: ResidualLocalisation, surrogate: Surrogate | None
) -> tuple[Finding, ...]:
    """What to do next about something unknown; continue with a look-alike where no surrogate does better."""
    policy = judged.selection.policy
    limit = policy.selection.holdout_share
    surrogate_fails = surrogate is None or surrogate.explained_fraction < limit
    share = judged.holdout[worst_output(judged.holdout)].share
    is_near = share >= PARTIAL_SHARE and surrogate_fails
    look_alike = " + ".join(_physical_effects(judged)) if is_near else ""
    return propose_next_steps(judged.base, location, surrogate, judged.scores.validation.records, policy, look_alike)


def _summarise(
    judged: JudgedSelection,
    decided: Conclusion,
    claims: Sequence[Claim],
    alternatives: Sequence[Sequence[str]],
    left: Mapping[str, RemainingError],
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    rejected: str = "",
    is_worse: bool = False,
    constants: Mapping[str, int] | None = None,
) -> tuple[Finding, ...]:
    """The conclusion as findings: the effects and how certain they are, the error they take, and what is left.

    ``rejected`` names the effects of the best model on the estimation records where the plain one does as well on the others, or better
    on the test records (``is_worse``), and ``constants`` counts those of each candidate.
    """
    if decided.verdict is Verdict.COMPLETE:
        return (Finding(DiscoveryCode.NOTHING_MISSING),)
    effects = _physical_effects(judged)
    name, output = " + ".join(effects), worst_output(judged.holdout)
    error = judged.holdout[output]
    # With what corrects the shape of an effect: the error is that of the whole model.
    fitted = _added_effects(judged)
    made = {e: c for e in effects if (c := name_claim(claims, e)) is not None}
    grades = {e: made[e].grade if e in made else Grade.STAND_IN for e in effects}
    established = [e for e in effects if grades[e] is Grade.ESTABLISHED]
    reduced = _error_reduced(fitted, judged.holdout, VALIDATION_SHARE)
    explained = {"share": error.share, "output": output}
    remaining = [
        Finding(DiscoveryCode.ERROR_LEFT, subject=o, values={**each.to_values(), "before": judged.holdout[o].before})
        for o, each in left.items()
        if o == output or judged.holdout[o].share < PARTIAL_SHARE
    ]
    if decided.verdict is Verdict.NAMED:
        return (Finding(DiscoveryCode.EFFECT_NAMED, subject=name), *reduced)
    if decided.verdict is Verdict.AMBIGUOUS:
        rivals = [" + ".join(names) for names in alternatives]
        counts = [sum((constants or {}).get(e, 0) for e in names) for names in (effects, *alternatives)]
        values = {**explained, "rivals": rivals, "is_simplest": counts[0] < min(counts[1:], default=0)}
        return (Finding(DiscoveryCode.EFFECTS_TIED, subject=name, values=values), *reduced)
    if decided.verdict is Verdict.PARTLY and established:
        others = {e: grades[e] for e in effects if e not in established}
        values = {"established": established, "others": others}
        return (Finding(DiscoveryCode.EFFECTS_ESTABLISHED, subject=name, values=values), *reduced, *remaining)
    deepest = deepest_established(claims) if decided.verdict is Verdict.PARTLY else None
    headline: list[Finding] = []
    if deepest is not None:
        headline.append(Finding(DiscoveryCode.CLAIM_ESTABLISHED, subject=deepest.output, values=to_values(deepest)))
    probable = {e: c.probability for e, c in made.items() if c.grade is Grade.PROBABLE}
    if probable and error.share > 0:
        values = {"probabilities": probable, "others": [e for e in effects if e not in probable]}
        return (*headline, Finding(DiscoveryCode.EFFECTS_PROBABLE, subject=name, values=values), *reduced, *remaining)
    look_alike: list[Finding] = []
    if rejected:
        code = DiscoveryCode.WORSE_ON_TEST if is_worse else DiscoveryCode.NO_LOOK_ALIKE
        look_alike.append(Finding(code, subject=rejected))
    elif name:
        look_alike += [Finding(DiscoveryCode.NEAREST_LOOK_ALIKE, subject=name), *reduced, *remaining]
    missing: list[Finding] = []
    if not location.is_missing:
        missing.append(
            Finding(
                DiscoveryCode.HARDLY_VISIBLE,
                values={"misfit": location.misfit, "bounded": location.is_noise_bounded},
            )
        )
    elif location.likeliest:
        missing.append(_missing_signal(judged, location, surrogate))
    headline = headline or [Finding(DiscoveryCode.UNKNOWN_EFFECT)]
    if surrogate is None:
        return (*headline, *look_alike, *missing)
    missing.append(Finding(DiscoveryCode.SURROGATE_FITTED, subject=surrogate.site, values=to_values(surrogate)))
    says_more = surrogate.share > error.share  # what explains more comes first
    return (*headline, *(missing + look_alike if says_more else look_alike + missing))


def _error_reduced(effects: Sequence[str], holdout: Mapping[str, HoldoutError], least_share: float) -> list[Finding]:
    """From where to where the error falls: of the output that the plain model misses most, and of others where that is worth a word."""
    first = worst_output(holdout)
    return [
        Finding(
            DiscoveryCode.ERROR_REDUCED,
            subject=output,
            values={"before": e.before, "after": e.after, "unit": e.unit, "share": e.share, "effects": list(effects)},
        )
        for output, e in sorted(holdout.items(), key=lambda item: item[0] != first)
        if output == first or e.share >= least_share
    ]


def _missing_signal(judged: JudgedSelection, location: ResidualLocalisation, surrogate: Surrogate | None) -> Finding:
    """How large the missing signal is, where, and of what it is a function; a curve that explains it says more than the localisation."""
    policy = judged.selection.policy.selection
    site, labels = location.sites[0], find_missing_sites(location, surrogate)
    values: dict[str, Any] = {
        "size": site.size,
        "unit": site.unit,
        "sites": list(labels),
        "variable": "",
        "dependence": None,
    }
    if surrogate is not None and labels != location.likeliest:
        values["size"], values["unit"] = float(np.sqrt(np.mean(surrogate.signal.value**2))), surrogate.unit
        values["variable"] = surrogate.variable
    elif (
        surrogate is not None
        and not (surrogate.tone or surrogate.beside)
        and surrogate.explained_fraction >= policy.holdout_share
    ):
        values["variable"] = surrogate.variable
    elif location.dependences and location.dependences[0].is_relevant:
        values["variable"] = location.dependences[0].variable
        values["dependence"] = to_values(location.dependences[0])
    return Finding(DiscoveryCode.MISSING_SIGNAL, subject=", ".join(labels), values=values)


def _added_effects(judged: JudgedSelection) -> list[str]:
    """The effects of the extended model that the plain one has not."""
    return [
        e.name for e in judged.best.model.effects if e.name not in {given.name for given in judged.base.model.effects}
    ]


def _physical_effects(judged: JudgedSelection) -> list[str]:
    """Those that have a name, without curves that correct them."""
    return [name for name in _added_effects(judged) if not is_shape_correction(name)]


def _named_effects(candidate: FittedCandidate) -> list[str]:
    """The same of a candidate."""
    return [name for name in candidate.effects if not is_shape_correction(name)]


def _name(candidate: FittedCandidate) -> str:
    return " + ".join(candidate.effects)


def _as_tuple(records: Records) -> tuple[Experiment, ...]:
    return name_records(records)


def _ignore(_: str) -> None:
    return None
