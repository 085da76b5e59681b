"""From a search to the answer: claims, laws, the finished models, what is left and what to do next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from greybox.base import TINY, Check, Finding, Severity
from greybox.base.values import with_code
from greybox.discovery.answer import SearchAnswer, make_answer
from greybox.discovery.claims import (
    LEAST_SHARE,
    SOME_LEFT,
    Depth,
    Grounds,
    Weights,
    list_tied_sets,
    measure_share,
    name_claim,
    reweigh_claims,
    weigh_claims,
)
from greybox.discovery.decision import Decision, Grade, Verdict, judge_test, make_check
from greybox.discovery.effect_signal import (
    EVIDENCE_BLOCKS,
    EffectSignal,
    estimate_effect_signals,
    measure_remaining_error,
)
from greybox.discovery.execution import SearchStage
from greybox.discovery.false_names import MOST_SIGNALS, ContestTable, list_nonsense_sites, measure_false_names
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import (
    PARTIAL_SHARE,
    VALIDATION_SHARE,
    VISIBLE_RMS,
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
from greybox.discovery.laws.search import LawProposer
from greybox.discovery.laws.terms import Law, claimed_name, describe_laws, is_law, write_effect
from greybox.discovery.localisation import ResidualLocalisation, localise_residual
from greybox.discovery.plausibility import prefer_usual
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.proposals import explain_doubt, list_detection_limits, propose_next_steps, propose_noise_check
from greybox.discovery.proposers import add_curves_in_place, add_objections
from greybox.discovery.residual_noise import has_memory, is_level_known, is_shape_correction
from greybox.discovery.result import Discovery, RankedCandidate, quote_test_error
from greybox.discovery.search import LEAST_PROMISE, EffectSearch, find_named_winner
from greybox.discovery.summary import list_law_ranges, summarise, summarise_laws
from greybox.discovery.surrogate import Surrogate, fit_stand_in
from greybox.discovery.table import RESAMPLES, Draws, FitTable, SetKey, key_of
from greybox.estimation import Fit
from greybox.model.parts import read_parts

# Standard errors over blocks of records that were not fitted which are more than chance.
LEAST_DEVIATIONS = 2.0


def conclude(
    answer: SearchAnswer,
    test: ValidationSet,
    findings: tuple[Finding, ...],
    of_laws: DiscoveryProblem | None = None,
) -> Discovery:
    """What a search comes to: claims, laws, the finished models, what is left, and what to do next.

    Parameters
    ----------
    answer
        The set that won.
    test
        Records that took no part.
    findings
        What a user should know already.
    of_laws
        The problem for which an equation is looked for; None for none.
    """
    answer = _weigh_answer(answer)
    if of_laws is not None and (answer.is_open or not is_level_known(of_laws.noise_model)):
        answer = _add_law(answer, of_laws)
    answer = replace(answer, findings=findings)
    answer = _hold_against_test(_settle(answer, test), test)
    surrogate = _fit_stand_in(answer, test)
    return _describe(answer, surrogate)


def _weigh_answer(answer: SearchAnswer, is_last: bool = False) -> SearchAnswer:
    """The answer with its claims, beside all its rivals; the usual one first among those that do equally well.

    ``is_last``: what objects to the usual one is looked for no further.
    """
    answer = replace(answer, location=_locate(answer, answer.plain), signals=_estimate_signals(answer))
    has_law = any(is_law(e.name) for e in answer.added)
    if not (answer.search.candidates or has_law) or answer.verdict is Verdict.COMPLETE:
        return answer
    answer.problem.executor.release_reserve()
    weigh = partial(_weigh, answer)
    weighed: SearchAnswer = answer.problem.failures.attempt(
        SearchStage.WEIGHING, answer.candidate.effects, weigh, answer
    )
    is_cut = bool(answer.problem.executor.skipped)  # not all rivals were tried
    weighed = replace(weighed, grounds=replace(weighed.grounds, is_cut=is_cut))
    # The records have decided: for names, or that no set of effects does better than the plain model.
    if has_law or weighed.verdict is Verdict.NAMED or not weighed.candidate.effects:
        return weighed
    search, prefer = answer.search, partial(_put_usual_first, weighed)
    known = set(map(key_of, search.table.candidates))
    usual: SearchAnswer = answer.problem.failures.attempt(
        SearchStage.EVIDENCE, weighed.candidate.effects, prefer, weighed
    )
    # What objects to the usual set is on the table now: where one of these wins, it is the answer, and is weighed as any other.
    if is_last or len(search.table.candidates) == len(known):
        return usual
    draws = search.draw(RESAMPLES, (weighed.candidate, usual.candidate))
    winner = leave_out_small(search.table, find_named_winner(draws, search.baseline))
    if key_of(winner) in known:
        return usual
    return _weigh_answer(_hand_over(weighed, winner), is_last=True)


def _put_usual_first(answer: SearchAnswer) -> SearchAnswer:
    """The answer with the usual one of the sets that do equally well in its place; its names are no more certain for that."""
    search, chosen = answer.search, answer.candidate
    search.add_usual()
    usual = [fit for fit in search.table.candidates if fit.effects and set(fit.effects) <= set(search.expected)]
    draws = search.draw(RESAMPLES, (chosen, *usual))
    grades = {c.name: c.grade for c in answer.claims if c.name}
    left = max((c.left for c in answer.weighed), default=1.0)
    is_open = may_leave_more(chosen, left, is_level_known(answer.problem.noise_model))
    refused: set[tuple[str, ...]] = set()
    judged = _JudgedSets(answer)
    while True:
        preference = prefer_usual(draws, chosen, search.problem.model, grades, is_open, refused)
        if preference is None:
            return answer
        if preference.finding is None:
            return replace(answer, question=preference.question)
        # On the table its constants follow the records that judge: what does no better there with its own gives way to the next.
        if judged.holds(preference.candidate):
            break
        refused.add(preference.candidate.names)
    preferred = _hand_over(answer, preference.candidate)
    if key_of(preferred.candidate) != key_of(preference.candidate):
        return answer
    names = set(answer.grounds.names or ()) & set(preferred.candidate.names)
    # Each name that is said is weighed, however seldom it wins.
    sites = answer.location.sets if answer.location else ()
    made = weigh_claims(draws, sites, chosen.given, left, preferred.candidate.names, is_open)
    new = set(preferred.candidate.names) - {c.name for c in answer.weighed}
    weighed = (*answer.weighed, *(c for c in made if c.name in new))
    preferred = replace(preferred, weighed=weighed, grounds=replace(answer.grounds, names=names))
    # Among ties that the records have made the weights may choose; they make none of their own.
    if answer.verdict is Verdict.AMBIGUOUS and preferred.verdict is not Verdict.AMBIGUOUS:
        return replace(answer, question=preference.question)
    return replace(preferred, usual=preference.finding, question=preference.question)


@dataclass(frozen=True)
class _JudgedSets:
    """Whether sets of the table do better than the plain model on the records that judge an answer."""

    answer: SearchAnswer

    def holds(self, candidate: FittedCandidate) -> bool:
        """Whether a set does so with the constants of the fitted records, or with those of the first halves of the judging ones too."""
        search = self.answer.search
        if self._is_better(search.table.scores, search.baseline, candidate):
            return True
        learnt = None if self._plain is None else _refit_as_it_stands(self._wider.problem, candidate)
        return self._plain is not None and learnt is not None and self._is_better(self._wider, self._plain, learnt)

    def _is_better(self, scores: HoldoutScores, plain: FittedCandidate, candidate: FittedCandidate) -> bool:
        of_plain, run = scores.run(plain), scores.run(candidate)
        if of_plain is None or run is None:
            return False
        # Of a fit its runs and the level of its noise are read, and that level is one for all.
        before, after = (replace(self.answer.base, validation=each) for each in (of_plain, run))
        return bool(judge_against_plain(before, after, scores.validation.uncounted))

    @cached_property
    def _wider(self) -> HoldoutScores:
        return _learn_from_first_halves(self.answer.search.problem, self.answer.validation)

    @cached_property
    def _plain(self) -> FittedCandidate | None:
        """The plain model with constants of the first halves too: one for all sets."""
        return _refit_as_it_stands(self._wider.problem, self.answer.search.baseline)


def _learn_from_first_halves(problem: DiscoveryProblem, validation: ValidationSet) -> HoldoutScores:
    """The same problem on the first halves of the validation records too, under its noise; the second halves judge."""
    first_halves, second_halves = validation.halve()
    experiments = (*problem.experiments, *first_halves)
    return HoldoutScores(replace(problem, noise=problem.noise_model, experiments=experiments), second_halves)


def _refit_as_it_stands(problem: DiscoveryProblem, candidate: FittedCandidate) -> FittedCandidate | None:
    """A set refitted to the records of ``problem``, from where it stands and from what its user gave."""
    return problem.refit_best(candidate.model, [candidate.model.values, problem.model.values])


def may_leave_more(chosen: FittedCandidate, left: float, is_noise_known: bool) -> bool:
    """Whether a set that won may leave more than noise: it does (``left``, a share), or it follows whatever is left.

    An effect with memory does that: where nobody told the noise, no record says that only noise is left. One without memory cannot, and
    shows by more than the noise that the record is known to have at most.
    """
    follows = any(has_memory(e) for e in chosen.model.effects if e.name in chosen.effects)
    return left >= SOME_LEFT or chosen.noise_ratio > VISIBLE_RMS or (follows and not is_noise_known)


def _add_law(answer: SearchAnswer, of_laws: DiscoveryProblem) -> SearchAnswer:
    """The answer with the equation that is missing, weighed as any other; as it was where that says no more."""
    look = partial(_look_for_laws, answer, of_laws)
    looked: tuple[SearchAnswer, int] | None = answer.problem.failures.attempt(
        SearchStage.LAWS, answer.candidate.effects, look, None
    )
    if looked is None:
        return answer
    proposed, terms = looked
    with_law = replace(_weigh_answer(proposed), terms=terms)
    made = [name_claim(with_law.claims, claimed_name(e)) for e in with_law.added if is_law(e.name)]
    is_probable = any(claim is not None and claim.grade is not Grade.STAND_IN for claim in made)
    # One of several that do the same may be said too, or no more than where it acts and of what; and a plain model that only was stuck
    # lacks nothing.
    is_deeper = with_law.verdict is Verdict.PARTLY and answer.verdict is not Verdict.PARTLY
    says_more = is_probable or with_law.has_certain_name or is_deeper
    return with_law if says_more else replace(answer, terms=terms)


def _look_for_laws(answer: SearchAnswer, problem: DiscoveryProblem) -> tuple[SearchAnswer, int]:
    """The law that wins most often on the table of those that were proposed; and how many terms were tried."""
    table, beside = FitTable(HoldoutScores(problem, answer.validation)), problem.baseline
    search = replace(answer.search, problem=problem, table=table)
    # What is established stays in the model, and the law is looked for beside it.
    if answer.is_open and answer.has_certain_name:
        known = answer.candidate
        beside = problem.refit_best(known.model, [known.model.values], 1, like=known) or beside
    laws = LawProposer(problem, table.scores, search.on_message)
    looking = replace(search, candidates=(), laws=laws)
    looking.run(beside)
    selected = looking.find_winner(looking.draw(RESAMPLES))
    search.baseline = looking.baseline
    search.table.add(selected)
    search.drop_parts(selected)
    return make_answer(search, selected), laws.tried


def _settle(answer: SearchAnswer, test: ValidationSet) -> SearchAnswer:
    """The answer with its constants: those of the estimation records; where these do not hold, of half the validation records as well.

    They do not hold where they do no better than the plain model on the records that judge, or where with the others as much as half of the
    error goes. The plain model is the answer where neither does better than it.
    """
    # A model that follows the records no better than the plain one is not handed over: to finish it may cost as much as the search.
    brief = _keep_if_better(answer, test)
    settled = _keep_if_better(_finish_answer(answer if brief.added else brief), test)
    # Where the whole search learnt from the first halves already there is no more to learn.
    has_learnt = with_code(answer.findings, DiscoveryCode.LEARNT_FROM_VALIDATION)
    if not answer.added or (settled.added and settled.rest) or has_learnt or answer.problem.executor.is_late:
        return settled
    answer.search.on_message(str(Finding(DiscoveryCode.LEARNING_FROM_VALIDATION)))
    learn = partial(_learn_from_validation, answer)
    wider = answer.problem.failures.attempt(SearchStage.HOLDOUT, answer.candidate.effects, learn, None)
    learnt = settled if wider is None else _keep_if_better(_finish_answer(wider), test)
    if not (settled.added and learnt.added):
        return learnt if learnt.added else settled
    again = replace(
        settled.best,
        validation=learnt.validation.run(settled.best.model, settled.best.noise.std, learnt.problem.options),
    )
    before, after = _sum_up(compare_holdout_errors(again, learnt.best))
    return learnt if after < (1 - PARTIAL_SHARE) * before else settled


def _learn_from_validation(answer: SearchAnswer) -> SearchAnswer | None:
    """The answer with constants of the first halves of the validation records too, the second halves judge; None where it fails there."""
    scores = _learn_from_first_halves(answer.scores.problem, answer.validation)
    wider = scores.problem
    fits = [_refit_as_it_stands(wider, each) for each in (answer.plain, answer.candidate)]
    if fits[0] is None or fits[1] is None:
        return None
    plain, candidate = fits[0], fits[1]
    base, best = (validate_candidate(wider, each, scores.validation) for each in (plain, candidate))
    return replace(
        answer,
        scores=scores,
        weighed=reweigh_claims(answer.weighed, measure_structure(scores, candidate, only_visible=True)),
        plain=plain,
        candidate=candidate,
        base=base,
        best=best,
        findings=(Finding(DiscoveryCode.LEARNT_FROM_VALIDATION, Severity.WARNING), *answer.findings),
    )


def _finish_answer(answer: SearchAnswer) -> SearchAnswer:
    """With both models as a fit of one's own gives them: the plain one, and the one that is handed over."""
    base, doubts = _finish(answer, answer.base)
    best, more = (base, ()) if answer.best is answer.base else _finish(answer, answer.best)
    words = (*doubts, *more)
    # A constant that wanders where it changes no error shakes nothing.
    is_settled = not any(word.values["errors"] for word in words)
    return replace(
        answer,
        grounds=replace(answer.grounds, is_settled=is_settled),
        base=base,
        best=best,
        # What the time limit left open is told once, of the model that is handed over.
        findings=(*answer.findings, *(word for word in words if word is words[-1] or not word.values["is_late"])),
    )


def _keep_if_better(answer: SearchAnswer, test: ValidationSet) -> SearchAnswer:
    """The answer where it does better than the plain model on the records that judge it; else the plain model is the answer."""
    if not answer.added:
        return replace(answer, rejected=answer.rejected or _name_best_fitted(answer))
    names = " + ".join(write_effect(answer.best.model, e) for e in answer.added)
    better = judge_against_plain(answer.base, answer.best, answer.validation.uncounted, names)
    kept = judge_on_test(answer.problem, answer.base, answer.best, test, names)
    checks = (*better.checks, *kept.checks)
    if better and kept:
        return replace(answer, checks=checks)
    # Records that took no part speak against the model, and so against its names; where something acts, and of what, is probable at most.
    is_worse = better.passed
    claims = [c for c in answer.weighed if c.depth <= Depth.VARIABLES] if is_worse else []
    return replace(
        answer,
        candidate=answer.plain,
        best=answer.base,
        weighed=tuple(claims),
        grounds=replace(answer.grounds, is_contradicted=is_worse),
        rates=(),
        signals=(),
        checks=(*answer.decided.checks, *checks),
        rejected=names,
        usual=None,
        question=None,
    )


def _name_best_fitted(answer: SearchAnswer) -> str:
    """The set that follows the fitted records best by its criterion, where it does no better than the plain model on those that judge."""
    table, plain = answer.search.table, answer.search.baseline
    named = [fit for fit in table.candidates if not any(map(is_shape_correction, fit.effects))]
    best = min(named, key=lambda fit: fit.criterion, default=plain)
    before, after = table.sums(plain), table.sums(best)
    if not best.effects or before is None or after is None or measure_share(before, after) >= LEAST_SHARE:
        return ""
    return " + ".join(best.names)


def _hold_against_test(answer: SearchAnswer, test: ValidationSet) -> SearchAnswer:
    """The answer whose model leaves only noise, unless it leaves more on the records that took no part: these contradict it."""
    problem = answer.problem
    plain, best = (_run_on_test(problem, fit, test) for fit in (answer.base, answer.best))
    if plain is None or best is None or not answer.rest:
        return answer
    errors = answer.compare(plain, best)
    limits = answer.limit_noise(HoldoutScores(answer.scores.problem, test))
    on_test = judge_test(errors, limits, answer.search.policy.selection)
    if on_test:
        return replace(answer, on_test=on_test)
    values = {"ratio": max(e.after / e.floor for e in errors.values())}
    output = max(errors, key=lambda name: errors[name].after / errors[name].floor)
    warning = Finding(DiscoveryCode.MISSING_ON_TEST, Severity.WARNING, output, values)
    return replace(answer, on_test=on_test, findings=(warning, *answer.findings))


def _fit_stand_in(answer: SearchAnswer, test: ValidationSet) -> Surrogate | None:
    """A curve in the place of what has no name: not where a probable effect is said, nor where the plain model does as well."""
    # The sets of the table are fitted to fewer records than an answer that learnt from those that judge: none of them stands beside it.
    has_learnt = len(answer.scores.problem.experiments) > len(answer.problem.experiments)
    if not answer.is_nameless or has_learnt:
        return None
    problem, represent = answer.problem, partial(fit_stand_in, answer)
    surrogate: Surrogate | None = problem.failures.attempt(
        SearchStage.SURROGATE, answer.candidate.effects, represent, None
    )
    if surrogate is None:
        return None
    follows = judge_against_plain(answer.base, surrogate.fit, answer.validation.uncounted)
    return surrogate if follows and judge_on_test(problem, answer.base, surrogate.fit, test) else None


def _describe(answer: SearchAnswer, surrogate: Surrogate | None) -> Discovery:
    """The answer with what is left and where, what to do next, and its conclusion."""
    search, verdict, problem = answer.search, answer.verdict, answer.problem
    of_plain = answer.location or ResidualLocalisation.without_sites(answer.plain)
    location = _locate(answer, _under_less_noise(answer)) if answer.candidate.effects else of_plain
    left = measure_remaining_error(answer.best, answer.holdout, location, answer.validation.uncounted)
    next_steps = _list_next_steps(answer, of_plain, surrogate, location)
    named = [c for c in search.table.candidates if not any(map(is_shape_correction, c.effects))]
    singles = [c for c in named if len(c.effects) == 1]
    limits = list_detection_limits(singles) if verdict is Verdict.COMPLETE else ()
    findings = answer.findings
    if surrogate is not None and surrogate.finished is not None:
        findings = (*findings, *_word_on(surrogate.finished))
    ranking = _rank(answer, [c for c in named if c.effects])
    laws = _describe_laws(answer)
    alternatives: list[tuple[str, ...]] = []
    if verdict is Verdict.AMBIGUOUS or (laws and not all(claim.is_established for claim in answer.names)):
        alternatives = list_tied_sets(answer.claims, answer.named)
    decided = answer.decided
    constants = {e.name: sum(not q.fixed for q in e.parameters) for e in search.candidates}
    summary = summarise(answer, alternatives, left, of_plain, surrogate, constants)
    if answer.terms and not laws and verdict is not Verdict.COMPLETE:
        summary = (*summary, Finding(DiscoveryCode.NO_LAW, values={"terms": answer.terms}))
    if answer.usual is not None:
        summary = (*summary[:1], answer.usual, *summary[1:])
    if laws:
        alternatives = _write_sets(problem.fitted, alternatives)
        summary = summarise_laws(answer, laws, alternatives, left)
        findings = (*findings, *list_law_ranges(laws))
    of_search = [check for step in search.steps for check in step.checks]
    return Discovery(
        verdict,
        answer.base,
        answer.best,
        alternatives,
        answer.holdout,
        ranking,
        of_plain,
        conclusion=summary,
        checks=(*of_search, *decided.checks, *answer.checks),
        path=tuple(search.steps),
        findings=(*findings, *limits),
        next_steps=next_steps,
        effect_signals=answer.signals,
        surrogate=surrogate,
        claims=answer.claims,
        false_names=answer.rates,
        left=left,
        policy=search.policy,
        options=problem.options,
        laws=laws,
    )


def _rank(answer: SearchAnswer, fits: Sequence[FittedCandidate]) -> list[RankedCandidate]:
    """The sets that were fitted, those with the best criterion first."""
    parts, table = read_parts(answer.search.problem.model), answer.search.table
    ranking = []
    for fit in sorted(fits, key=lambda fit: fit.criterion):
        added = [b.effect for b in fit.model.bound_effects if b.effect.name not in fit.given]
        rarest = min((parts.occurrence(e) for e in added), key=lambda kind: kind.probability)
        behind = fit.criterion - min(f.criterion for f in fits)
        constants = fit.free - answer.search.baseline.free
        ranking.append(
            RankedCandidate(fit.effects, fit.noise_ratio, behind, constants, rarest, table.judged_errors(fit))
        )
    return ranking


def _describe_laws(answer: SearchAnswer) -> tuple[Law, ...]:
    """The laws of the answer, with the values of its last fit and the ranges of the runs that it was fitted to."""
    problem, model, variables = answer.candidate.problem, answer.best.model, answer.candidate.variables
    if not any(is_law(e.name) for e in model.effects):
        return ()
    runs = problem.shooting(variables).simulate(variables.here)
    states = np.concatenate([record.samples(x) for (_, x), record in zip(runs, problem.records, strict=True)])
    inputs = np.concatenate([record.samples(record.u) for record in problem.records])
    names = [*answer.candidate.model.system.state_names, *(i.name for i in model.inputs)]
    columns = np.column_stack([states, inputs[:, : len(model.inputs)]]).T
    ranges = {n: (float(v.min()), float(v.max())) for n, v in zip(names, columns, strict=True)}
    values = {n: e.value for n, e in answer.best.parameters.items() if n in model.values}
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


def _estimate_signals(answer: SearchAnswer) -> tuple[EffectSignal, ...]:
    estimate_signals = partial(estimate_effect_signals, answer.scores.problem, answer.candidate)
    return answer.problem.failures.attempt(SearchStage.EVIDENCE, answer.candidate.effects, estimate_signals, ())


def _locate(answer: SearchAnswer, candidate: FittedCandidate) -> ResidualLocalisation:
    """What a candidate leaves unexplained; the misfit alone where its site cannot be estimated."""
    locate = partial(localise_residual, candidate)
    located = answer.problem.failures.attempt(SearchStage.LOCALISATION, candidate.effects, locate, None)
    return located or ResidualLocalisation.without_sites(candidate)


# How often a set that wins takes the place of the answer, and is held against objections of its own.
MOST_HANDOVERS = 2


def _weigh(answer: SearchAnswer) -> SearchAnswer:
    """The answer with what resampling the records says of all sets of effects that were fitted: the search's own, and every objection.

    The set that wins is what is handed over: one that does better takes the place of the answer. With it, how often signals without
    meaning would have been established in the place of its effects.
    """
    search, problem = answer.search, answer.problem
    table, has_rivals = search.table, True
    for handover in range(MOST_HANDOVERS + 1):
        chosen = answer.candidate
        objecting = partial(add_objections, search, chosen, answer.signals)
        has_rivals = problem.failures.attempt(SearchStage.WEIGHING, chosen.effects, objecting, None) is not None
        draws = draw_with_parts(search, (chosen,))
        winner = leave_out_small(table, find_named_winner(draws, search.baseline))
        if key_of(winner) == key_of(chosen) or handover == MOST_HANDOVERS or problem.executor.is_late:
            break
        answer = _hand_over(answer, winner)
    terms = {name for name in chosen.effects if is_law(name)}
    claimed = dict(zip(chosen.effects, chosen.names, strict=True))
    grounds = Grounds(chosen.names, {claimed[name] for name in terms}, has_rivals=has_rivals)

    def weigh(draws: Draws) -> SearchAnswer:
        if not draws.sets:
            return answer
        leading = draws.sets[Weights.of(draws).leading].candidate
        left = measure_structure(table.scores, leading, only_visible=True)
        # Chance leaves a short record a little above its noise: where that is all, the fewest effects are a ground.
        is_open = not answer.rest and may_leave_more(leading, left, is_level_known(problem.noise_model))
        sites = answer.location.sets if answer.location else ()
        weighed = weigh_claims(draws, sites, leading.given, left, chosen.names, is_open)
        return replace(answer, weighed=weighed, grounds=grounds)

    weighed = weigh(draws)
    if not has_rivals:
        return weighed
    standing = [
        name
        for name in chosen.effects
        # Of a law dozens of other formulas were tried: one that is established leaves hardly anything for a curve to add.
        if name not in terms and (c := name_claim(weighed.claims, claimed[name])) is not None and c.is_established
    ]
    for name in standing:
        add_curves_in_place(search, chosen, name)
    weighed = weigh(draw_with_parts(search, (chosen,))) if standing else weighed
    taking_part = table.leading((search.baseline, chosen))
    # Of equations there are more candidates than signals take part.
    tried = len(search.candidates) + MOST_SIGNALS * bool(terms)
    sites = answer.location.sets if answer.location else ()
    contests = ContestTable(table, taking_part, chosen, sites, tried)
    without = {name: rest for name in chosen.effects if (rest := table.without(chosen, name)) is not None}
    rates = measure_false_names(contests, without, answer.signals, weighed.claims)
    nonsense = list_nonsense_sites(rates, chosen.model)
    return replace(weighed, rates=rates, grounds=replace(grounds, nonsense=nonsense))


def draw_with_parts(search: EffectSearch, always: Sequence[FittedCandidate]) -> Draws:
    """Resamples of the table in which a set that wins with a curve has won against each of its parts.

    A curve takes the place of one effect of a set, and may do the work of the others as well: beside a constant, a gain of a sensor that
    had imitated it.
    """
    tried = set[SetKey]()
    while True:
        draws = search.draw(RESAMPLES, always)
        if not draws.sets:
            return draws
        leading = draws.sets[Weights.of(draws).leading].candidate
        parts = [search.table.without(leading, name) for name in leading.effects]
        has_curve = any(map(is_shape_correction, leading.effects))
        if not has_curve or len(parts) < 2 or all(parts) or key_of(leading) in tried:
            return draws
        tried.add(key_of(leading))
        search.drop_parts(leading)


def leave_out_small(table: FitTable, winner: FittedCandidate) -> FittedCandidate:
    """The set that wins without what its records do not ask for.

    An effect is out that takes less of the error than anything claimed must, or no more than chance of what the fitted records leave
    without it; so is what a richer effect has beyond the simpler one that it contains.
    """
    for effect in winner.model.effects:
        others = set(winner.effects) - {effect.name}
        if effect.name not in winner.effects:
            continue
        for simpler in (others, *(others | {parent} for parent in effect.parents)):
            rest = table.without(winner, effect.name) if simpler == others else table.get(simpler)
            sums, before = table.sums(winner), None if rest is None else table.sums(rest)
            if rest is None or sums is None or before is None:
                continue
            gain = winner.count * math.log(max(rest.cost, TINY) / max(winner.cost, TINY))
            if gain < LEAST_PROMISE or (simpler == others and measure_share(before, sums) < LEAST_SHARE):
                return leave_out_small(table, rest)
    return winner


def _hand_over(answer: SearchAnswer, winner: FittedCandidate) -> SearchAnswer:
    """The answer with another set in its place; as it was where that cannot be run over the records that judge."""
    answer.search.table.add(winner)
    answer.search.drop_parts(winner)
    made = make_answer(answer.search, winner)
    if key_of(made.candidate) != key_of(winner):
        return answer
    made = replace(
        answer, candidate=made.candidate, plain=made.plain, scores=made.scores, base=made.base, best=made.best
    )
    return replace(made, signals=_estimate_signals(made))


def _finish(answer: SearchAnswer, fit: Fit) -> tuple[Fit, tuple[Finding, ...]]:
    """A fit of the answer as one's own would end; with a word on it where another that begins there ends elsewhere, or fails."""
    problem, names = answer.problem, tuple(e.name for e in fit.model.effects)
    finish = partial(finish_fit, answer.scores.problem, fit, answer.validation)
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
    least = LEAST_DEVIATIONS
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
    least = LEAST_DEVIATIONS
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
    answer: SearchAnswer,
    of_plain: ResidualLocalisation,
    surrogate: Surrogate | None,
    location: ResidualLocalisation,
) -> tuple[Finding, ...]:
    """What to do next, by what is open; ``location`` is that of what the answer leaves."""
    verdict = answer.verdict
    steps: tuple[Finding, ...] = ()
    if answer.is_nameless:
        steps = _propose_for_unknown(answer, of_plain, surrogate)
    elif verdict in (Verdict.PARTLY, Verdict.UNKNOWN, Verdict.AMBIGUOUS):
        steps = _propose_for_part(answer, location)
    elif verdict is Verdict.COMPLETE:
        steps = propose_noise_check(answer.base)
    if answer.added and (verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) or not steps):
        steps = (*steps, Finding(DiscoveryCode.CONFIRM_ON_ANOTHER_RECORD))
    # The cheapest experiment is a question.
    return steps if answer.question is None else (answer.question, *steps)


# Effects that are not established for which an experiment is asked, those that take the largest share of the error first.
MOST_SEPARATIONS = 2


def _propose_for_part(answer: SearchAnswer, location: ResidualLocalisation) -> tuple[Finding, ...]:
    """What to do about the rest beside established effects."""
    doubtful = [c for c in answer.names if not c.is_established]
    doubts = [doubt for c in doubtful if (doubt := explain_doubt(c)) is not None]
    shares = {c.name: c.share for c in doubtful}
    steps = sorted(doubts, key=lambda doubt: -shares[doubt.subject])[:MOST_SEPARATIONS]
    if not location.is_missing:
        return tuple(steps)
    records, policy = answer.validation.records, answer.search.policy
    return (*steps, *propose_next_steps(answer.base, location, None, records, policy, left=answer.best))


def _propose_for_unknown(
    answer: SearchAnswer, location: ResidualLocalisation, surrogate: Surrogate | None
) -> tuple[Finding, ...]:
    """What to do next about something unknown; continue with a look-alike where no surrogate does better."""
    policy = answer.search.policy
    surrogate_fails = surrogate is None or surrogate.explained_fraction < policy.selection.holdout_share
    is_near = answer.holdout[worst_output(answer.holdout)].share >= PARTIAL_SHARE and surrogate_fails
    look_alike = " + ".join(answer.named) if is_near else ""
    return propose_next_steps(answer.base, location, surrogate, answer.validation.records, policy, look_alike)


# Share of a residual's variance that counts as noise at least where what is left is localised.
LEAST_NOISE_SHARE = 0.01


def _under_less_noise(answer: SearchAnswer) -> FittedCandidate:
    """The final model with only that part of its residual for noise that nothing before it tells; as it is where the noise is known."""
    candidate = answer.candidate
    problem = candidate.problem
    if problem.noise.is_level_known:
        return candidate
    structure = measure_structure(answer.scores, candidate, only_visible=False)
    factor = max(1 - structure**2, LEAST_NOISE_SHARE) ** 0.5
    noise = replace(problem.noise, std=factor * problem.noise.std)
    return replace(candidate, problem=replace(problem, noise=noise), cost=candidate.cost / factor**2)
