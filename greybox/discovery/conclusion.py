"""From a judged selection to the answer: smaller effects, claims, laws, the finished models, what is left and what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from greybox.base import Check, Finding, Severity
from greybox.discovery.claims import (
    NO_GROUNDS,
    SOME_LEFT,
    Claim,
    Depth,
    Grounds,
    Weights,
    find_winner,
    grade_claims,
    list_tied_sets,
    name_claim,
    read_verdict,
    weigh_claims,
)
from greybox.discovery.decision import (
    Conclusion,
    Decision,
    Grade,
    Verdict,
    judge_rest,
    judge_test,
    make_check,
)
from greybox.discovery.effect_signal import (
    EVIDENCE_BLOCKS,
    EffectSignal,
    estimate_effect_signals,
    measure_remaining_error,
)
from greybox.discovery.execution import SearchStage
from greybox.discovery.false_names import (
    MOST_SIGNALS,
    ContestTable,
    FalseNameRate,
    list_nonsense_sites,
    measure_false_names,
)
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
    finish_fit,
    measure_structure,
    validate_candidate,
    worst_output,
)
from greybox.discovery.judged_selection import JudgedSelection, list_added_effects, list_named_effects
from greybox.discovery.laws.search import propose_laws
from greybox.discovery.laws.terms import Law, claimed_name, describe_laws, is_law, write_effect
from greybox.discovery.localisation import ResidualLocalisation, localise_residual
from greybox.discovery.plausibility import prefer_usual, refit_usual
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.proposals import (
    explain_doubt,
    list_detection_limits,
    propose_next_steps,
    propose_noise_check,
    separate_ties,
)
from greybox.discovery.refinement import (
    REFINEMENT_LEAST_DEVIATIONS,
    VALIDATION_SHARE,
    Refinement,
    refine_candidate,
    with_residual_noise,
)
from greybox.discovery.residual_noise import (
    WHITE_CORRELATION,
    excess_autocorrelation,
    is_level_known,
)
from greybox.discovery.result import Discovery, RankedCandidate, quote_test_error
from greybox.discovery.rivals import RivalSearch, refit_curves_in_place, refit_rivals
from greybox.discovery.selection import AUTOCORRELATION_LAGS, StepwiseSelection
from greybox.discovery.summary import list_law_ranges, summarise, summarise_laws
from greybox.discovery.surrogate import Surrogate, fit_surrogate
from greybox.discovery.table import Draws, FitTable
from greybox.estimation import Fit
from greybox.model import Effect
from greybox.model.parts import read_parts


@dataclass(frozen=True)
class FinalModel:
    """The model of the answer: as a candidate, as a validated fit, and the validation records under the noise it was fitted with."""

    scores: HoldoutScores
    candidate: FittedCandidate
    fit: Fit


@dataclass(frozen=True)
class SearchAnswer:
    """An answer in the making, as each step of the conclusion leaves it.

    Parameters
    ----------
    judged
        The selection, with the plain model and that of the answer as validated fits.
    final
        The model of the answer.
    rest
        Whether that leaves only noise.
    location
        What the plain model leaves unexplained, and where.
    weighed
        What resampling the records says, with its probabilities.
    grounds
        What the grades of these rest on beside.
    rates
        How often signals without meaning would have been established in the place of its effects.
    signals
        The signal of each effect of the answer.
    refinement
        Further effects, where some were looked for.
    terms
        How many terms of equations were tried; 0 where none were looked for.
    findings
        What a user should know beside the verdict.
    checks
        Those against the plain model, on the records that judge and on those that took no part.
    rejected
        Names of its effects where the plain model is the answer in their place; "" for an answer that stands.
    usual
        What the records alone say, where what such rigs usually have comes first.
    question
        The part of the rig that nobody has spoken of, and on which the name hangs.
    """

    judged: JudgedSelection
    final: FinalModel
    rest: Decision
    location: ResidualLocalisation
    weighed: tuple[Claim, ...] = ()
    grounds: Grounds = NO_GROUNDS
    rates: tuple[FalseNameRate, ...] = ()
    signals: tuple[EffectSignal, ...] = ()
    refinement: Refinement | None = None
    terms: int = 0
    findings: tuple[Finding, ...] = ()
    checks: tuple[Check, ...] = ()
    rejected: str = ""
    usual: Finding | None = None
    question: Finding | None = None

    @property
    def problem(self) -> DiscoveryProblem:
        """The records and the noise of its search."""
        return self.judged.selection.problem

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """What is said, with its grades."""
        return grade_claims(self.weighed, self.grounds)

    @cached_property
    def decided(self) -> Conclusion:
        """The verdict, with the checks that it rests on."""
        tied = [rival.effects for rival in self.judged.rivals]
        return read_verdict(self.rest, self.claims, list_named_effects(self.judged), tied)

    @property
    def verdict(self) -> Verdict:
        """What may be said so far."""
        return self.decided.verdict

    @property
    def names(self) -> list[Claim]:
        """The claims of its effects by name."""
        return [c for e in list_named_effects(self.judged) if (c := name_claim(self.claims, e)) is not None]

    @property
    def is_open(self) -> bool:
        """Whether something is missing that no effect is certain to be."""
        return self.verdict in (Verdict.UNKNOWN, Verdict.PARTLY)

    @property
    def is_nameless(self) -> bool:
        """Whether something is missing, and no name of an effect is even probable."""
        return self.is_open and all(claim.grade is Grade.STAND_IN for claim in self.names)

    @property
    def has_certain_name(self) -> bool:
        """Whether an effect is established, or one of a few that the records cannot tell apart."""
        return not self.is_open or any(claim.is_established for claim in self.names)


def conclude(
    judged: JudgedSelection,
    candidates: Sequence[Effect],
    test: ValidationSet,
    findings: tuple[Finding, ...],
    further: bool,
    of_laws: DiscoveryProblem | None = None,
) -> Discovery:
    """What a judged selection comes to: further effects, claims, laws, the finished models, what is left, and what to do next.

    Parameters
    ----------
    judged
        The selection.
    candidates
        Every effect that was tried.
    test
        Records that took no part.
    findings
        What a user should know already.
    further
        Whether smaller effects are looked for even where the residual is noise.
    of_laws
        The problem for which an equation is looked for; None for none.
    """
    answer = _weigh_answer(judged, candidates, further)
    if of_laws is not None and (answer.is_open or not is_level_known(of_laws.noise_model)):
        answer = _add_law(answer, of_laws, candidates)
    answer = replace(answer, findings=findings)
    # A model that follows the records no better than the plain one is not handed over: to finish it may cost as much as the search.
    brief = _keep_if_better(answer, test)
    answer = _keep_if_better(_finish_answer(brief if brief.rejected else answer), test)
    answer = _hold_against_test(answer, test)
    surrogate = _fit_stand_in(answer, test)
    return _describe(answer, candidates, surrogate, test)


def _weigh_answer(judged: JudgedSelection, candidates: Sequence[Effect], further: bool) -> SearchAnswer:
    """The selected model, with smaller effects where more than noise is left, beside all its rivals."""
    rest = _judge_rest(judged)
    final = FinalModel(judged.scores, judged.selected, judged.best)
    refinement: Refinement | None = None
    has_law = any(is_law(e.name) for e in list_added_effects(judged))
    may_add = bool(candidates) and not has_law  # beside a law the terms were the candidates
    if may_add and (further or not rest or _may_hold_more(judged)):
        final, refinement = _refine(judged, candidates)
    judged = replace(judged, best=final.fit, holdout=compare_holdout_errors(judged.base, final.fit))
    location = _locate(judged.baseline, judged.selection)
    answer = SearchAnswer(judged, final, rest, location, signals=_estimate_signals(final), refinement=refinement)
    if not (candidates or has_law) or answer.verdict is Verdict.COMPLETE:
        return answer
    answer.problem.executor.release_reserve()
    weigh = partial(_weigh, answer, candidates)
    weighed: SearchAnswer = answer.problem.failures.attempt(
        SearchStage.EVIDENCE, final.candidate.effects, weigh, answer
    )
    is_cut = bool(answer.problem.executor.skipped)  # not all rivals were tried
    weighed = replace(weighed, grounds=replace(weighed.grounds, is_cut=is_cut))
    if has_law or weighed.verdict is Verdict.NAMED:  # the records have decided
        return weighed
    prefer = partial(_put_usual_first, weighed, candidates)
    return answer.problem.failures.attempt(SearchStage.EVIDENCE, weighed.final.candidate.effects, prefer, weighed)


def _put_usual_first(answer: SearchAnswer, candidates: Sequence[Effect]) -> SearchAnswer:
    """The answer with the usual one of the sets that do equally well in its place; its names are no more certain for that."""
    judged, chosen, table = answer.judged, answer.final.candidate, answer.judged.table
    usual = refit_usual(_make_rivals(answer, candidates), table, read_parts(judged.plain))
    draws = table.draw(table.leading((judged.baseline, chosen, *usual)))
    grades = {c.name: c.grade for c in answer.claims if c.name}
    # A set with memory follows whatever is left: where nobody told the noise, no record says that only noise is.
    left = max((c.left for c in answer.weighed), default=1.0)
    is_open = left >= SOME_LEFT or not is_level_known(answer.problem.noise_model)
    preference = prefer_usual(draws, chosen, judged.plain, grades, is_open)
    if preference is None:
        return answer
    preferred = answer
    if preference.finding is not None:
        preferred = _hand_over(answer, preference.candidate)
        names = set(answer.grounds.names or ()) & set(preferred.final.candidate.names)
        preferred = replace(preferred, grounds=replace(answer.grounds, names=names))
        # Among ties that the records have made the weights may choose; they make none of their own.
        if answer.verdict is Verdict.AMBIGUOUS and preferred.verdict is not Verdict.AMBIGUOUS:
            return replace(answer, question=preference.question)
    return replace(preferred, usual=preference.finding, question=preference.question)


def _add_law(answer: SearchAnswer, of_laws: DiscoveryProblem, candidates: Sequence[Effect]) -> SearchAnswer:
    """The answer with the equation that is missing, weighed as any other; as it was where that says no more."""
    look = partial(_look_for_laws, answer, of_laws)
    looked: tuple[JudgedSelection, int] | None = answer.problem.failures.attempt(
        SearchStage.LAWS, answer.judged.selected.effects, look, None
    )
    if looked is None:
        return answer
    judged, terms = looked
    with_law = replace(_weigh_answer(judged, candidates, further=False), terms=terms)
    added = list_added_effects(with_law.judged)
    made = [name_claim(with_law.claims, claimed_name(e)) for e in added if is_law(e.name)]
    is_probable = any(claim is not None and claim.grade is not Grade.STAND_IN for claim in made)
    # One of several that do the same may be said too, or no more than where it acts and of what; and a plain model that only was stuck
    # lacks nothing.
    is_deeper = with_law.verdict is Verdict.PARTLY and answer.verdict is not Verdict.PARTLY
    says_more = is_probable or with_law.has_certain_name or is_deeper
    return with_law if says_more else replace(answer, terms=terms)


def _look_for_laws(answer: SearchAnswer, problem: DiscoveryProblem) -> tuple[JudgedSelection, int]:
    """The law that wins most often on the table of those that were proposed, as a selection; and how many terms were tried."""
    judged, validation = answer.judged, answer.judged.scores.validation
    selection, table = copy(judged.selection), FitTable(HoldoutScores(problem, validation))
    selection.problem, selection.baseline, beside = problem, problem.baseline, problem.baseline
    # What is established stays in the model, and the law is looked for beside it.
    if answer.is_open and answer.has_certain_name:
        known = answer.final.candidate
        beside = problem.refit_best(known.model, [known.model.values], 1, like=known) or beside
    proposal = propose_laws(problem, table.scores, beside, selection.on_message)
    if not beside.effects:
        selection.baseline = proposal.beside
    table.add(selection.baseline, proposal.beside, *proposal.laws)
    draws = table.draw(table.candidates)
    selected = draws.sets[int(Weights.of(draws).totals.argmax())].candidate if draws.sets else proposal.beside
    is_better = selection.baseline is not problem.baseline
    base = validate_candidate(problem, selection.baseline, validation) if is_better else judged.base
    best = validate_candidate(problem, selected, validation) if selected.effects else base
    judged = replace(
        judged,
        selection=selection,
        selected=selected,
        rivals=(),
        base=base,
        best=best,
        holdout=compare_holdout_errors(base, best),
        table=table,
    )
    return judged, proposal.tried


def _finish_answer(answer: SearchAnswer) -> SearchAnswer:
    """With both models as a fit of one's own gives them: the plain one, and the one that is handed over."""
    judged = answer.judged
    base, doubts = _finish(judged, judged.base)
    best, more = (base, ()) if judged.best is judged.base else _finish(judged, judged.best)
    judged = replace(judged, base=base, best=best, holdout=compare_holdout_errors(base, best))
    words = (*doubts, *more)
    # A constant that wanders where it changes no error shakes nothing.
    is_settled = not any(word.values["errors"] for word in words)
    return replace(
        answer,
        grounds=replace(answer.grounds, is_settled=is_settled),
        judged=judged,
        final=replace(answer.final, fit=best),
        refinement=None if answer.refinement is None else replace(answer.refinement, fit=best),
        # What the time limit left open is told once, of the model that is handed over.
        findings=(*answer.findings, *(word for word in words if word is words[-1] or not word.values["is_late"])),
    )


def _keep_if_better(answer: SearchAnswer, test: ValidationSet) -> SearchAnswer:
    """The answer where it does better than the plain model on the records that judge it; else the plain model is the answer."""
    judged = answer.judged
    added = list_added_effects(judged)
    if not added:
        return answer
    names = " + ".join(write_effect(judged.best.model, e) for e in added)
    better = judge_against_plain(judged.base, judged.best, judged.scores.validation.uncounted, names)
    kept = judge_on_test(answer.problem, judged.base, judged.best, test, names)
    checks = (*better.checks, *kept.checks)
    if better and kept:
        return replace(answer, checks=checks)
    # Records that took no part speak against the model, and so against its names; where something acts, and of what, is probable at most.
    is_worse = better.passed
    refinement = answer.refinement
    holdout = compare_holdout_errors(judged.base, judged.base)
    claims = [c for c in answer.weighed if c.depth <= Depth.VARIABLES] if is_worse else []
    judged = replace(judged, selected=judged.baseline, rivals=(), best=judged.base, holdout=holdout)
    return replace(
        answer,
        judged=judged,
        final=FinalModel(judged.scores, judged.baseline, judged.base),
        rest=_judge_rest(judged),
        weighed=tuple(claims),
        grounds=replace(answer.grounds, is_contradicted=is_worse),
        rates=(),
        signals=(),
        refinement=None if refinement is None else Refinement(judged.base, (), refinement.checks),
        checks=(*answer.decided.checks, *checks),
        rejected=names,
        usual=None,
        question=None,
    )


def _hold_against_test(answer: SearchAnswer, test: ValidationSet) -> SearchAnswer:
    """The answer whose model leaves only noise, unless it leaves more on the records that took no part: these contradict it."""
    judged, problem = answer.judged, answer.problem
    plain, best = (_run_on_test(problem, fit, test) for fit in (judged.base, judged.best))
    if plain is None or best is None or not answer.rest:
        return answer
    errors = compare_holdout_errors(plain, best)
    limits = judged.limit_noise(HoldoutScores(problem, test))
    on_test = judge_test(errors, limits, judged.selection.policy.selection)
    rest = Decision(on_test.passed, (*answer.rest.checks, *on_test.checks))
    if on_test:
        return replace(answer, rest=rest)
    values = {"ratio": max(e.after / e.floor for e in errors.values())}
    output = max(errors, key=lambda name: errors[name].after / errors[name].floor)
    warning = Finding(DiscoveryCode.MISSING_ON_TEST, Severity.WARNING, output, values)
    return replace(answer, rest=rest, findings=(warning, *answer.findings))


def _fit_stand_in(answer: SearchAnswer, test: ValidationSet) -> Surrogate | None:
    """A curve in the place of what has no name: not where a probable effect is said, nor where the plain model does as well."""
    if not answer.is_nameless:
        return None
    judged, problem = answer.judged, answer.problem
    represent = partial(
        fit_surrogate,
        replace(problem, model=judged.plain),
        judged.baseline,
        judged.selected,
        judged.holdout,
        judged.scores.validation,
        judged.base,
        judged.selection.policy,
    )
    surrogate: Surrogate | None = problem.failures.attempt(
        SearchStage.SURROGATE, judged.selected.effects, represent, None
    )
    if surrogate is None:
        return None
    follows = judge_against_plain(judged.base, surrogate.fit, judged.scores.validation.uncounted)
    return surrogate if follows and judge_on_test(problem, judged.base, surrogate.fit, test) else None


def _describe(
    answer: SearchAnswer, candidates: Sequence[Effect], surrogate: Surrogate | None, test: ValidationSet
) -> Discovery:
    """The answer with what is left and where, what to do next, and its conclusion."""
    judged, final, verdict, problem = answer.judged, answer.final, answer.verdict, answer.problem
    selection, selected = judged.selection, judged.selected
    location = _locate(_under_less_noise(final), selection) if final.candidate.effects else answer.location
    left = measure_remaining_error(final.fit, judged.holdout, location, judged.scores.validation.uncounted)
    next_steps = _list_next_steps(answer, surrogate, location, test)
    limits = list_detection_limits(selection.single_effects) if verdict is Verdict.COMPLETE else ()
    findings = answer.findings
    if surrogate is not None and surrogate.finished is not None:
        findings = (*findings, *_word_on(surrogate.finished))
    if judged.corrected is not selected and answer.has_certain_name and final.candidate is selected:
        added = [name for name in judged.corrected.effects if name not in selected.effects]
        values = {"correction": added}
        findings = (*findings, Finding(DiscoveryCode.SHAPE_CORRECTED, subject=_name(selected), values=values))
    fits = sorted(selection.fits.values(), key=lambda fit: fit.criterion)
    ranking = [RankedCandidate(f.effects, f.noise_ratio, f.criterion - fits[0].criterion) for f in fits]
    alternatives = [rival.effects for rival in judged.rivals]
    laws = _describe_laws(final)
    is_tied = verdict is Verdict.AMBIGUOUS or (laws and not all(claim.is_established for claim in answer.names))
    if is_tied and not alternatives:
        alternatives = list_tied_sets(answer.claims, list_named_effects(judged))
    decided = answer.decided
    constants = {e.name: sum(not q.fixed for q in e.parameters) for e in candidates}
    summary = summarise(
        judged,
        decided,
        answer.claims,
        alternatives,
        left,
        answer.location,
        surrogate,
        answer.rejected,
        answer.grounds.is_contradicted,
        constants,
    )
    if answer.terms and not laws and verdict is not Verdict.COMPLETE:
        summary = (*summary, Finding(DiscoveryCode.NO_LAW, values={"terms": answer.terms}))
    if answer.usual is not None:
        summary = (*summary[:1], answer.usual, *summary[1:])
    if laws:
        alternatives = _write_sets(problem.fitted, alternatives)
        summary = summarise_laws(judged, decided, answer.claims, laws, alternatives, left)
        findings = (*findings, *list_law_ranges(laws))
    return Discovery(
        decided.verdict,
        judged.base,
        judged.best,
        alternatives,
        judged.holdout,
        ranking,
        answer.location,
        conclusion=summary,
        checks=(*judged.checks, *decided.checks, *answer.checks),
        path=tuple(selection.steps),
        findings=(*findings, *limits),
        next_steps=next_steps,
        effect_signals=answer.signals,
        surrogate=surrogate,
        refinement=answer.refinement,
        claims=answer.claims,
        false_names=answer.rates,
        left=left,
        policy=selection.policy,
        options=problem.options,
        laws=laws,
    )


def _describe_laws(final: FinalModel) -> tuple[Law, ...]:
    """The laws of the final model, with the values of its last fit and the ranges of the runs that it was fitted to."""
    problem, model, variables = final.candidate.problem, final.fit.model, final.candidate.variables
    if not any(is_law(e.name) for e in model.effects):
        return ()
    runs = problem.shooting(variables).simulate(variables.here)
    states = np.concatenate([record.samples(x) for (_, x), record in zip(runs, problem.records, strict=True)])
    inputs = np.concatenate([record.samples(record.u) for record in problem.records])
    names = [*final.candidate.model.system.state_names, *(i.name for i in model.inputs)]
    columns = np.column_stack([states, inputs[:, : len(model.inputs)]]).T
    ranges = {n: (float(v.min()), float(v.max())) for n, v in zip(names, columns, strict=True)}
    values = {n: e.value for n, e in final.fit.parameters.items() if n in model.values}
    return describe_laws(model.start(**values), ranges)


def _write_sets(fitted: Sequence[FittedCandidate], sets: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Those sets of effects that are among the fitted ones, with each law as an equation with numbers."""
    written = []
    for names in sets:
        fits = [fit for fit in fitted if sorted(fit.names) == sorted(names)]
        if fits:
            best = min(fits, key=lambda fit: fit.noise_ratio)
            written.append(tuple(write_effect(best.model, e) for e in best.model.effects if e.name in best.effects))
    return written


def _judge_rest(judged: JudgedSelection) -> Decision:
    """Whether the selected model leaves only noise."""
    policy, corrected = judged.selection.policy.selection, judged.corrected
    autocorrelation = excess_autocorrelation(corrected, AUTOCORRELATION_LAGS) if corrected.effects else 0.0
    rest = judge_rest(
        judged.baseline,
        corrected,
        judged.holdout,
        judged.noise_limits,
        autocorrelation,
        policy,
    )
    ties = judged.selection.tie_checks(judged.selected, judged.rivals)
    return replace(rest, checks=(*rest.checks, *ties))


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
    locate = partial(localise_residual, candidate)
    located = selection.problem.failures.attempt(SearchStage.LOCALISATION, candidate.effects, locate, None)
    return located or ResidualLocalisation.without_sites(candidate)


# How often a rival that wins takes the place of the answer, and is held against rivals of its own.
MOST_HANDOVERS = 2


def _weigh(answer: SearchAnswer, candidates: Sequence[Effect]) -> SearchAnswer:
    """The answer with what resampling the records says of all sets of effects that were fitted: the search's own, and every rival of it.

    The set that wins is what is handed over: a rival that does better takes the place of the answer. With it, how often signals without
    meaning would have been established in the place of its effects.
    """
    table, baseline = answer.judged.table, answer.judged.baseline
    for handover in range(MOST_HANDOVERS + 1):
        rivals, chosen = _make_rivals(answer, candidates), answer.final.candidate
        listing = partial(refit_rivals, rivals)
        without = answer.problem.failures.attempt(SearchStage.EVIDENCE, chosen.effects, listing, None)
        table.add(baseline, chosen, *answer.problem.fitted)
        draws = table.draw(table.leading((baseline, chosen)))
        winner = find_winner(draws, chosen)
        if winner is chosen or handover == MOST_HANDOVERS or answer.problem.executor.is_late:
            break
        answer = _hand_over(answer, winner)
    terms = {name for name in chosen.effects if is_law(name)}
    claimed = dict(zip(chosen.effects, chosen.names, strict=True))
    grounds = Grounds(chosen.names, {claimed[name] for name in terms}, has_rivals=without is not None)

    def weigh(draws: Draws) -> SearchAnswer:
        if not draws.sets:
            return answer
        leading = draws.sets[Weights.of(draws).leading].candidate
        left = measure_structure(table.scores, leading, only_visible=True)
        weighed = weigh_claims(draws, answer.location.sets, leading.given, left)
        return replace(answer, weighed=weighed, grounds=grounds)

    weighed = weigh(draws)
    if without is None:
        return weighed
    standing = [
        rest
        for name, rest in without.items()
        # Of a law dozens of other formulas were tried: one that is established leaves hardly anything for a curve to add.
        if name not in terms and (c := name_claim(weighed.claims, claimed[name])) is not None and c.is_established
    ]
    for rest in standing:
        refit_curves_in_place(rivals, rest)
    table.add(*answer.problem.fitted)
    taking_part = table.leading((baseline, chosen))
    weighed = weigh(table.draw(taking_part)) if standing else weighed
    # Of equations there are more candidates than signals take part.
    tried = len(candidates) + MOST_SIGNALS * bool(terms)
    contests = ContestTable(table, taking_part, chosen, answer.location.sets, tried)
    rates = measure_false_names(contests, without, answer.signals, weighed.claims)
    nonsense = list_nonsense_sites(rates, chosen.model)
    return replace(weighed, rates=rates, grounds=replace(grounds, nonsense=nonsense))


def _make_rivals(answer: SearchAnswer, candidates: Sequence[Effect]) -> RivalSearch:
    """What the rivals of an answer are fitted from."""
    selection, final = answer.judged.selection, answer.final
    known = selection.fits if answer.refinement is None or not answer.refinement.steps else {}
    return RivalSearch(
        final.scores.problem, selection.scales, candidates, final.candidate, selection.baseline, known, answer.signals
    )


def _hand_over(answer: SearchAnswer, winner: FittedCandidate) -> SearchAnswer:
    """The answer with a rival in its place; as it was where that cannot be run over the records that judge."""
    judged, scores, refinement = answer.judged, answer.final.scores, answer.refinement
    problem = judged.selection.problem
    # It may have been fitted under another noise.
    outcome = problem.to_outcome(winner)
    selected, candidate = (each.converge(each.restore(winner.model, outcome)) for each in (problem, scores.problem))
    finish = partial(validate_candidate, scores.problem, candidate, scores.validation)
    fit: Fit | None = problem.failures.attempt(SearchStage.HOLDOUT, winner.effects, finish, None)
    if fit is None:
        return answer
    rivals, holdout = judged.selection.find_rivals(selected), compare_holdout_errors(judged.base, fit)
    judged = replace(judged, selected=selected, rivals=rivals, best=fit, holdout=holdout)
    final = FinalModel(scores, candidate, fit)
    return replace(
        answer,
        judged=judged,
        final=final,
        rest=_judge_rest(judged),
        signals=_estimate_signals(final),
        refinement=None if refinement is None else Refinement(fit, (), refinement.checks),
    )


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
    values = {
        "status": finished.status,
        "errors": list(finished.errors),
        "constants": dict(finished.constants),
        "is_late": finished.is_late,
    }
    return (Finding(DiscoveryCode.REFIT_ELSEWHERE, Severity.WARNING, finished.fit.model.title, values),)


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


def add_test_error(result: Discovery, problem: DiscoveryProblem, test: ValidationSet) -> Discovery:
    """A discovery with its error on the test records, beside that of the plain model; as it is without them."""
    plain = _run_on_test(problem, result.base, test)
    answer = plain if result.extended is result.base else _run_on_test(problem, result.extended, test)
    return result if plain is None or answer is None else quote_test_error(result, plain, answer)


def _sum_up(holdout: Mapping[str, HoldoutError]) -> tuple[float, float]:
    """Rms error over noise of the plain and of the other model, all outputs together."""
    pairs = [(e.before / e.floor, e.after / e.floor) for e in holdout.values()]
    before, after = (float(np.sqrt(np.mean(np.square(each)))) for each in zip(*pairs, strict=True))
    return before, after


def _list_next_steps(
    answer: SearchAnswer, surrogate: Surrogate | None, location: ResidualLocalisation, test: ValidationSet
) -> tuple[Finding, ...]:
    """What to do next, by what is open; ``location`` is that of what the answer leaves."""
    judged, verdict = answer.judged, answer.verdict
    steps: tuple[Finding, ...] = ()
    if answer.is_nameless:
        steps = _propose_for_unknown(judged, answer.location, surrogate)
    elif verdict in (Verdict.PARTLY, Verdict.UNKNOWN) or (verdict is Verdict.AMBIGUOUS and not judged.rivals):
        refined = bool(answer.refinement and answer.refinement.steps) and not test
        steps = _propose_for_part(judged, location, answer.names, refined)
    elif verdict is Verdict.AMBIGUOUS:
        steps = separate_ties(judged.selected.effects, [rival.effects for rival in judged.rivals])
    elif verdict is Verdict.COMPLETE:
        steps = propose_noise_check(judged.base)
    if list_added_effects(judged) and (verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) or not steps):
        steps = (*steps, Finding(DiscoveryCode.CONFIRM_ON_ANOTHER_RECORD))
    # The cheapest experiment is a question.
    return steps if answer.question is None else (answer.question, *steps)


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
    look_alike = " + ".join(list_named_effects(judged)) if is_near else ""
    return propose_next_steps(judged.base, location, surrogate, judged.scores.validation.records, policy, look_alike)


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


def _name(candidate: FittedCandidate) -> str:
    return " + ".join(candidate.effects)
