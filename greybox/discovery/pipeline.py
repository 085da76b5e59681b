"""`discover`: a model, estimation and validation records in; a verdict with its evidence out.

The stages, each a function of its own: baseline, noise, screening and selection, holdout, decision, localisation, surrogate, proposals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from greybox.discovery.candidates import failed_candidates, list_candidates
from greybox.discovery.decision import (
    Conclusion,
    Verdict,
    decide_verdict,
    judge_validation_only,
    visible_rms_limit,
)
from greybox.discovery.effect_signal import estimate_effect_signals
from greybox.discovery.execution import RefitExecutor, RefitJournal
from greybox.discovery.failures import SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import (
    HoldoutError,
    compare_holdout_errors,
    reject_on_validation,
    validate_candidate,
    worst_output,
)
from greybox.discovery.localisation import ResidualLocalisation, localise_residual
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.proposals import (
    list_detection_limits,
    propose_experiments,
    propose_next_steps,
    propose_noise_check,
)
from greybox.discovery.residual_noise import (
    estimate_residual_noise,
    excess_autocorrelation,
    is_level_known,
    is_noise_known,
    is_same_noise,
)
from greybox.discovery.result import Discovery, RankedCandidate
from greybox.discovery.selection import MessageCallback, StepwiseSelection, checks_of
from greybox.discovery.starting_points import estimate_scales
from greybox.discovery.surrogate import Surrogate, fit_surrogate
from greybox.effects import Scales
from greybox.errors import DataError
from greybox.estimation import FitOptions
from greybox.experiment import Experiment
from greybox.findings import Check, Finding
from greybox.model import Effect, Model
from greybox.result import Fit

Records = Experiment | Sequence[Experiment]


@dataclass(frozen=True)
class SelectionEvidence:
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
    validation, skip
        These records, and the rows at their start that do not count.
    plain
        The model as the user gave it.
    checks
        Every check of the selection and of the rejection on the validation records.
    """

    selection: StepwiseSelection
    selected: CandidateFit
    rivals: Sequence[CandidateFit]
    base: Fit
    best: Fit
    holdout: Mapping[str, HoldoutError]
    validation: tuple[Experiment, ...]
    skip: int
    plain: Model
    checks: tuple[Check, ...]

    @property
    def baseline(self) -> CandidateFit:
        """The fit of the plain model."""
        return self.selection.baseline

    @property
    def corrected(self) -> CandidateFit:
        """The selected model with the shape of its effects corrected, where the records asked for that."""
        return self.selection.shape_corrections.get(frozenset(self.selected.effects), self.selected)

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that the extended model explains, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].explained_fraction

    @property
    def noise_limits(self) -> dict[str, float]:
        """Rms over noise that the noise of each output hardly ever exceeds on the validation records."""
        colours = dict(zip((o.name for o in self.base.model.outputs), self.baseline.problem.noise.colour, strict=True))
        policy = self.selection.policy.selection
        return {
            name: visible_rms_limit(self.base.validation.misfit[name].samples, colours[name], policy)
            for name in self.holdout
        }


def discover(
    model: Model,
    estimation: Records,
    *,
    validation: Records,
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
) -> Discovery:
    """Find which effect, if any, ``model`` lacks.

    Refits the model with each effect of the catalogue that it has a site for to the estimation records, keeps what the data demand, and
    judges it on the validation records, which no parameter has seen. An effect that shows in the validation records only (a
    saturation that the estimation input never reaches) is learnt from their first half and judged on the second.

    Parameters
    ----------
    model
        The plain model.
    estimation
        Records to fit to.
    validation
        Records to judge by.
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

    Returns
    -------
    Discovery
        The verdict, both fits, the checks and the path that led there.

    Raises
    ------
    ModelError
        For an unknown name in ``without``.
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
    validation_records = _as_tuple(validation)
    if not validation_records:
        raise DataError(
            "no validation record: a discovery needs a record that was not fitted; give at least one, another run or the"
            " end of this one (shell: --validate FILE)"
        )
    refit_journal = RefitJournal(Path(journal)) if journal else None
    for finding in refit_journal.findings if refit_journal else ():
        on_message(str(finding))
    refits = RefitExecutor(executor, workers, refit_journal, on_refit, policy.budget.parallel_seconds)
    with refits.open():
        problem = DiscoveryProblem(
            model, _as_tuple(estimation), dict(noise or {}), _as_tuple(quiet), options, refits, policy.budget
        )
        scales = estimate_scales(problem.baseline)
        listed = list_candidates(problem.model, scales, problem.failures, effects, without)
        candidates = listed.effects
        findings: tuple[Finding, ...] = ()
        evidence = _gather_evidence(problem, candidates, scales, validation_records, policy, on_message)
        if problem.options.at_rest and _shows_on_validation_only(evidence):
            on_message(str(Finding(DiscoveryCode.LEARNING_FROM_VALIDATION)))
            half = min(record.rows for record in validation_records) // 2
            first_halves = tuple(record.window(0, half) for record in validation_records)
            wider = replace(problem, experiments=(*problem.experiments, *first_halves))
            evidence = _gather_evidence(wider, candidates, scales, validation_records, policy, on_message, half)
            findings = (Finding(DiscoveryCode.LEARNT_FROM_VALIDATION),)
        result = _conclude(evidence, findings)
        not_tried = listed.not_tried | failed_candidates(candidates, problem.failures, result.fitted_alone)
        failures = tuple(problem.failures.entries.values())
        return replace(result, not_tried=not_tried, failures=failures, seconds=time.perf_counter() - began)


def _gather_evidence(
    problem: DiscoveryProblem,
    candidates: Sequence[Effect],
    scales: Scales,
    validation: tuple[Experiment, ...],
    policy: DiscoveryPolicy,
    on_message: MessageCallback,
    skip: int = 0,
) -> SelectionEvidence:
    """Noise, screening, selection and holdout."""
    misfit = problem.baseline.per_sample**0.5
    on_message(str(Finding(DiscoveryCode.BASELINE_FITTED, values={"misfit": misfit})))
    selection = StepwiseSelection(problem, candidates, scales, policy, on_message)
    if is_noise_known(problem.baseline.problem.noise, bool(problem.quiet)):
        selected = selection.select()
    else:
        selection, selected = _select_with_unknown_noise(selection)
    checks = list(checks_of(selection.steps))
    if selected.effects:
        fits = list(selection.fits.values())
        selected, of_holdout = reject_on_validation(
            selection.problem, selection.baseline, selected, fits, validation, policy.selection, skip
        )
        checks += of_holdout
    rivals = selection.find_rivals(selected) if selected.effects else []
    final = selection.shape_corrections.get(frozenset(selected.effects), selected)
    base, best = (validate_candidate(selection.problem, c, validation, skip) for c in (selection.baseline, final))
    holdout = compare_holdout_errors(base, best)
    return SelectionEvidence(
        selection, selected, rivals, base, best, holdout, validation, skip, problem.model, tuple(checks)
    )


def _select_with_unknown_noise(selection: StepwiseSelection) -> tuple[StepwiseSelection, CandidateFit]:
    """The selection with the noise that the best single effect leaves, and again with the one that the selected model leaves."""
    policy, on_message = selection.policy, selection.on_message
    level_known = is_level_known(selection.baseline.problem.noise)
    selected = selection.select() if level_known else selection.select_first()
    for _ in range(policy.noise.rounds):
        noise = estimate_residual_noise(selected, policy.noise)
        if is_same_noise(noise, selected.problem.noise, policy.noise):
            if level_known:
                break
            on_message(str(Finding(DiscoveryCode.NOISE_WHITE)))
        else:
            colours = [list(colour.reflection) for colour in noise.colour]
            values = {"colours": colours, "std": noise.std.tolist()}
            on_message(str(Finding(DiscoveryCode.NOISE_FROM_RESIDUAL, subject=selected.model.title, values=values)))
        problem = replace(selection.problem, noise=noise, model=selection.baseline.model)
        selection = StepwiseSelection(
            problem, _leading_candidates(selection), selection.scales, policy, on_message, selection.fits
        )
        before, selected = selected, selection.select()
        if before.effects == selected.effects:
            break
    return selection, selected


def _leading_candidates(selection: StepwiseSelection) -> list[Effect]:
    """The candidates that did best, in catalogue order, with their parents and children: the others are out of the running."""
    ranked = sorted(selection.fits.values(), key=lambda fit: fit.criterion)
    names = {name for fit in ranked[: selection.policy.noise.carried_sets] for name in fit.effects}
    family = names | {parent for e in selection.candidates if e.name in names for parent in e.parents}
    return [e for e in selection.candidates if e.name in family]


def _shows_on_validation_only(evidence: SelectionEvidence) -> bool:
    """Whether the plain model explains the estimation records and fails on the validation records."""
    if evidence.selected.effects:
        return False
    policy = evidence.selection.policy.selection
    return judge_validation_only(evidence.baseline, evidence.holdout, evidence.noise_limits, policy).passed


def _decide(evidence: SelectionEvidence) -> Conclusion:
    policy, corrected = evidence.selection.policy.selection, evidence.corrected
    autocorrelation = excess_autocorrelation(corrected, policy.autocorrelation_lags) if corrected.effects else 0.0
    decided = decide_verdict(
        evidence.baseline,
        corrected,
        evidence.rivals,
        evidence.holdout,
        evidence.noise_limits,
        autocorrelation,
        policy,
    )
    ties = evidence.selection.tie_checks(evidence.selected, evidence.rivals)
    return replace(decided, checks=(*decided.checks, *ties))


def _conclude(evidence: SelectionEvidence, findings: tuple[Finding, ...]) -> Discovery:
    """Decision, localisation, surrogate and proposals."""
    selection, selected = evidence.selection, evidence.selected
    policy, problem = selection.policy, evidence.selection.problem
    decided = _decide(evidence)
    verdict = decided.verdict
    fits = sorted(selection.fits.values(), key=lambda fit: fit.criterion)
    ranking = [RankedCandidate(f.effects, f.per_sample**0.5, f.criterion - fits[0].criterion) for f in fits]
    attempt, effects = problem.failures.attempt, selected.effects
    locate = partial(localise_residual, evidence.baseline, policy=policy.localisation, selection=policy.selection)
    location = attempt(SearchStage.LOCALISATION, (), locate, None) or ResidualLocalisation.without_sites(
        evidence.baseline, policy.localisation, policy.selection
    )
    propose = partial(propose_experiments, problem, selected, evidence.rivals, policy)
    experiments = attempt(SearchStage.PROPOSAL, effects, propose, ())
    limits = list_detection_limits(selection.single_effects, policy.proposals) if verdict is Verdict.COMPLETE else ()
    surrogate = None
    next_steps: tuple[Finding, ...] = ()
    if verdict is Verdict.UNKNOWN:
        represent = partial(
            fit_surrogate,
            replace(problem, model=evidence.plain),
            evidence.baseline,
            selected,
            evidence.holdout,
            evidence.validation,
            evidence.base,
            policy,
            evidence.skip,
        )
        surrogate = attempt(SearchStage.SURROGATE, effects, represent, None)
        next_steps = _propose_for_unknown(evidence, location, surrogate)
    elif verdict is Verdict.COMPLETE:
        next_steps = propose_noise_check(evidence.base)
    estimate_signals = partial(estimate_effect_signals, problem, selected, policy.localisation)
    signals = attempt(SearchStage.EVIDENCE, effects, estimate_signals, ()) if effects else ()
    if evidence.corrected is not selected and verdict is not Verdict.UNKNOWN:
        added = [name for name in evidence.corrected.effects if name not in selected.effects]
        values = {"correction": added}
        findings = (*findings, Finding(DiscoveryCode.SHAPE_CORRECTED, subject=_name(selected), values=values))
    return Discovery(
        verdict,
        evidence.base,
        evidence.best,
        [rival.effects for rival in evidence.rivals],
        evidence.holdout,
        ranking,
        location,
        conclusion=_summarise(evidence, verdict, location, surrogate),
        checks=(*evidence.checks, *decided.checks),
        path=tuple(selection.steps),
        findings=(*findings, *experiments, *limits),
        next_steps=next_steps,
        effect_signals=signals,
        surrogate=surrogate,
        policy=policy,
        options=problem.options,
        fitted_alone=frozenset(fit.effects[0] for fit in selection.fits.values() if len(fit.effects) == 1),
    )


def _propose_for_unknown(
    evidence: SelectionEvidence, location: ResidualLocalisation, surrogate: Surrogate | None
) -> tuple[Finding, ...]:
    """What to do next about something unknown; continue with a look-alike where no surrogate does better."""
    policy = evidence.selection.policy
    limit = policy.selection.holdout_share
    surrogate_fails = surrogate is None or surrogate.explained_fraction < limit
    is_near = evidence.explained_fraction >= limit and surrogate_fails
    look_alike = _name(evidence.selected) if is_near else ""
    return propose_next_steps(evidence.base, location, surrogate, evidence.validation, policy, look_alike)


def _summarise(
    evidence: SelectionEvidence, verdict: Verdict, location: ResidualLocalisation, surrogate: Surrogate | None
) -> tuple[Finding, ...]:
    """The conclusion as findings: the missing effect, its certainty, and the share of the error that it explains."""
    if verdict is Verdict.COMPLETE:
        return (Finding(DiscoveryCode.NOTHING_MISSING),)
    name, output = _name(evidence.selected), worst_output(evidence.holdout)
    explained = {"share": evidence.explained_fraction, "output": output}
    if verdict is Verdict.NAMED:
        return (Finding(DiscoveryCode.EFFECT_NAMED, subject=name, values=explained),)
    if verdict is Verdict.AMBIGUOUS:
        rivals = [_name(rival) for rival in evidence.rivals]
        return (Finding(DiscoveryCode.EFFECTS_TIED, subject=name, values={**explained, "rivals": rivals}),)
    findings = [Finding(DiscoveryCode.UNKNOWN_EFFECT)]
    if name and evidence.explained_fraction <= 0:
        findings.append(Finding(DiscoveryCode.NO_LOOK_ALIKE, subject=name))
    elif name:
        partly = bool(evidence.explained_fraction < evidence.selection.policy.selection.partial_share)
        values = {**explained, "partly": partly}
        findings.append(Finding(DiscoveryCode.NEAREST_LOOK_ALIKE, subject=name, values=values))
    if not location.is_missing:
        findings.append(Finding(DiscoveryCode.HARDLY_VISIBLE, values={"misfit": location.misfit}))
    elif location.likeliest:
        findings.append(_missing_signal(evidence, location, surrogate))
    if surrogate is not None:
        findings.append(Finding(DiscoveryCode.SURROGATE_FITTED, subject=surrogate.site, values=surrogate.to_values()))
    return tuple(findings)


def _missing_signal(
    evidence: SelectionEvidence, location: ResidualLocalisation, surrogate: Surrogate | None
) -> Finding:
    """How large the missing signal is, where, and of what it is a function; a curve that explains it says more than the localisation."""
    site = location.sites[0]
    values: dict[str, Any] = {
        "size": site.size,
        "unit": site.unit,
        "sites": list(location.likeliest),
        "variable": "",
        "dependence": None,
    }
    limit = evidence.selection.policy.selection.holdout_share
    explains = surrogate is not None and surrogate.tone is None and surrogate.explained_fraction >= limit
    if surrogate is not None and explains and not surrogate.beside:
        values["variable"] = surrogate.variable
    elif location.dependences and location.dependences[0].is_relevant:
        values["variable"] = location.dependences[0].variable
        values["dependence"] = location.dependences[0].to_values()
    return Finding(DiscoveryCode.MISSING_SIGNAL, subject=", ".join(location.likeliest), values=values)


def _name(candidate: CandidateFit) -> str:
    return " + ".join(candidate.effects)


def _as_tuple(records: Records) -> tuple[Experiment, ...]:
    return (records,) if isinstance(records, Experiment) else tuple(records)


def _ignore(_: str) -> None:
    return None
