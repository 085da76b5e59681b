"""Refining a model on measured records: further effects, small beside the first, where the residual never reaches the noise.

A discovery on simulated rigs ends at the noise. Measured records hardly do: what an electronic circuit or a tank does beyond its
first two effects lies a hundred times below the first misfit and still above the noise. Here an effect is demanded if it removes a
share of what is *left* on the estimation records, and on validation records, which none of its parameters has seen. Where
several do, the validation records decide. They are thereby used for the choice: the figure to quote comes from a third record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from greybox.base import TINY, Check, Finding
from greybox.base.values import Printable, ReadOnly
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import AutoRegression
from greybox.discovery.candidates import estimate_scales, list_candidates
from greybox.discovery.decision import make_check
from greybox.discovery.effect_signal import EVIDENCE_BLOCKS
from greybox.discovery.execution import RefitExecutor, RefitJournal
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import HoldoutScores, ValidationSet, compare_errors, validate_candidate
from greybox.discovery.localisation import normalised_residuals
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import SEARCH_REFIT_ITERATIONS, DiscoveryProblem, FittedCandidate, share_values
from greybox.discovery.residual_noise import is_shape_correction
from greybox.discovery.selection import SCREENING_ITERATIONS, MessageCallback, list_extension_starts, rank_extensions
from greybox.estimation.result import Fit
from greybox.model import Effect, Model
from greybox.model.effects.scales import Scales


@dataclass(frozen=True)
class RefinementStep(Printable, ReadOnly):
    """One further effect, or one that is out again.

    Parameters
    ----------
    name
        The effect.
    estimation_share, validation_share
        Share of the rms misfit that it removes on the estimation and on the validation records.
    alike
        What does nearly as well in its place, with the share that it removes on the validation records.
    replaced
        The effect whose place it takes; empty for one that is added.
    dropped
        Whether it was taken out, because beside the effects that came after it it removes too little.
    """

    name: str
    estimation_share: float
    validation_share: float
    alike: Mapping[str, float]
    replaced: str = ""
    dropped: bool = False

    KEYS: ClassVar[str] = "name fitted=estimation_share held_out=validation_share alike replaced dropped"


@dataclass(frozen=True, eq=False)
class Refinement(Printable, ReadOnly):
    """What `refine` found.

    Parameters
    ----------
    fit
        The fit with all effects.
    steps
        Further effects in the order in which they came.
    checks
        Those of every candidate that was refitted.
    """

    fit: Fit
    steps: tuple[RefinementStep, ...]
    checks: tuple[Check, ...] = ()

    KEYS: ClassVar[str] = (
        "steps checks effects parameters=fit.parameters misfit=fit.misfit validation=fit.validation.misfit"
    )

    @property
    def effects(self) -> tuple[str, ...]:
        """All effects of its model."""
        return self.fit.model.effect_names


@dataclass(frozen=True)
class _Extension:
    """A model with one effect more, its misfit on the validation records, and the share of the estimation misfit that it removes."""

    candidate: FittedCandidate
    name: str
    validation_misfit: float
    estimation_share: float


def refine(
    fit: Fit,
    validation: Experiment | Sequence[Experiment],
    *,
    plain: Model | None = None,
    effects: Sequence[Effect] | None = None,
    policy: DiscoveryPolicy | None = None,
    on_message: MessageCallback | None = None,
    journal: str | Path | None = None,
    on_refit: Callable[[int], None] | None = None,
) -> Refinement:
    """Small effects that the model of ``fit`` still lacks, one at a time.

    The model is refitted to the same records with white noise of the level of its own residual: what is left is structure, and the
    free run is to follow it. Curves and second branches that correct the shape of an effect are removed first: here they would stand in
    the way of a name.

    Parameters
    ----------
    fit
        Of a model that has its large effects already, as `discover` gives it (``discovery.best``).
    validation
        Records that no parameter has seen. They choose the effects: quote the misfit on another record.
    plain
        A model whose candidates of the catalogue count; by default that of ``fit``.
    effects
        The only candidates, instead of the catalogue.
    policy
        The decision numbers, above all ``policy.refinement``.
    on_message, journal, on_refit
        As in `discover`.

    Returns
    -------
    Refinement
        The fit with all effects, and each step.

    Raises
    ------
    ModelError, DataError
        As `greybox.fit`; DataError for a file that is no journal.
    """
    policy = policy or DiscoveryPolicy()
    executor = RefitExecutor(journal=RefitJournal(Path(journal)) if journal else None, report=on_refit)
    plain_problem = replace(DiscoveryProblem.from_fit(fit, policy.budget), executor=executor)
    problem = with_residual_noise(plain_problem, plain_problem.to_candidate(fit))
    start = problem.to_candidate(fit)
    listed = list_candidates(plain or fit.model, estimate_scales(start), problem.failures, effects)
    scores = HoldoutScores(problem, ValidationSet.of(validation))
    refined = refine_candidate(scores, start, listed.effects, policy, on_message)
    validated = validate_candidate(problem, refined.candidate, scores.validation)
    return Refinement(validated, refined.steps, refined.checks)


@dataclass(frozen=True)
class RefinedCandidate:
    """A candidate with further effects, the steps that led there, and the checks of every candidate that was refitted."""

    candidate: FittedCandidate
    steps: tuple[RefinementStep, ...]
    checks: tuple[Check, ...]


# Models whose misfits differ by less than this share explain a measured record equally well: an effect that takes the place of another
# must remove more than that.
ALIKE_SHARE = 0.1
# Effects added or replaced at most.
MOST_STEPS = 5
# Effects in a model from which none is added: a fifth shares its error among four others, and no resample tells which.
MOST_EFFECTS = 4


def refine_candidate(
    scores: HoldoutScores,
    start: FittedCandidate,
    candidates: Sequence[Effect],
    policy: DiscoveryPolicy,
    on_message: MessageCallback | None = None,
) -> RefinedCandidate:
    """Further effects for ``start``, one at a time, as long as they remove a share of what is left on the validation records.

    After each, an effect that no longer passes the test by which it would come in is out. Where none is to be added, an effect may still
    be replaced by a better one: what was chosen first was chosen beside a larger misfit.

    Parameters
    ----------
    scores
        The problem, whose noise is the residual of ``start``, and the validation records.
    start
        The model to begin with. Curves and second branches that correct the shape of its effects are removed first.
    candidates
        Effects that are tried.
    policy, on_message
        As in `refine`.
    """
    problem = scores.problem
    model = start.model
    for name in filter(is_shape_correction, [e.name for e in model.effects]):
        model = model.without(name)
    selected = problem.refit_best(model, [share_values(start.model, model)], keep=1, like=start) or start
    scales = estimate_scales(selected)
    misfit = scores.score(selected)
    if on_message:
        on_message(
            str(Finding(DiscoveryCode.REFINEMENT_STARTED, subject=selected.model.title, values={"misfit": misfit}))
        )
    steps: list[RefinementStep] = []
    checks: list[Check] = []
    while sum(not s.dropped for s in steps) < MOST_STEPS and len(selected.effects) < MOST_EFFECTS:
        replaced = ""
        extensions = [
            extension
            for candidate in _extend_each(problem, selected, candidates, scales, policy)
            if (extension := _judge_extension(scores, selected, candidate, misfit, policy, checks))
        ]
        for name in selected.effects if not extensions else ():
            replaced, extensions = (
                name,
                [
                    extension
                    for candidate in _replace_each(problem, selected, name, candidates, scales, policy)
                    if (extension := _judge_extension(scores, selected, candidate, misfit, policy, checks))
                ],
            )
            if extensions:
                break
        if not extensions:
            break
        alike = 1 + ALIKE_SHARE
        least = min(e.candidate.per_sample for e in extensions) ** 0.5
        near = [e for e in extensions if e.candidate.per_sample**0.5 <= alike * least]
        near = sorted(near, key=lambda e: e.validation_misfit)
        best = _prefer_simpler(near[0], near, candidates, alike * near[0].validation_misfit)
        also = {
            e.name: 1 - e.validation_misfit / misfit
            for e in near
            if e is not best and e.validation_misfit <= alike * best.validation_misfit
        }
        share = 1 - best.validation_misfit / misfit
        steps.append(RefinementStep(best.name, best.estimation_share, share, also, replaced))
        if on_message:
            on_message(str(steps[-1]))
        selected, misfit = best.candidate, best.validation_misfit
        for name in [n for n in selected.effects if n != best.name]:
            rest = problem.refit_without(selected, name, 1)
            if rest is None:
                continue
            without = scores.score(rest)
            if _judge_extension(scores, rest, selected, without, policy, checks) is None:
                removed = 1 - (selected.cost / rest.cost) ** 0.5
                steps.append(RefinementStep(name, removed, 1 - misfit / without, {}, dropped=True))
                if on_message:
                    on_message(str(steps[-1]))
                selected, misfit = rest, without
    return RefinedCandidate(selected, tuple(steps), tuple(checks))


def _prefer_simpler(
    best: _Extension, near: Sequence[_Extension], candidates: Sequence[Effect], limit: float
) -> _Extension:
    """The simplest member of the family of ``best`` whose misfit on the validation records is within ``limit``."""
    parents = next((e.parents for e in candidates if e.name == best.name), ())
    simpler = next((e for e in near if e.name in parents and e.validation_misfit <= limit), None)
    return best if simpler is None else _prefer_simpler(simpler, near, candidates, limit)


# Share of the remaining rms misfit that the effect must remove on the estimation records.
ESTIMATION_SHARE = 0.02
# Share of the remaining rms misfit that it must remove on the validation records.
VALIDATION_SHARE = 0.05
# Standard errors, over blocks of the validation records, of what an added effect removes there at least: what helps in a few blocks and
# harms in others is chance, and makes the other effects less certain for nothing.
REFINEMENT_LEAST_DEVIATIONS = 2.0


def _judge_extension(
    scores: HoldoutScores,
    smaller: FittedCandidate,
    larger: FittedCandidate,
    misfit: float,
    policy: DiscoveryPolicy,
    checks: list[Check],
) -> _Extension | None:
    """The larger model with its errors; None where the records do not demand it. Every check is added to ``checks``."""
    name = next(n for n in larger.effects if n not in smaller.effects)
    gain, least_gain = _criterion_gain(smaller, larger), policy.selection.criterion_gain
    share = 1 - (larger.cost / smaller.cost) ** 0.5
    gains = make_check(DiscoveryRule.CRITERION_GAIN, gain, least_gain, gain > least_gain, name)
    fits = Check.at_least(DiscoveryRule.ESTIMATION_DECREASE, share, ESTIMATION_SHARE, name)
    checks += [gains, fits]
    if not (gains and fits):
        return None
    after = scores.score(larger)
    is_exchange = len(larger.effects) == len(smaller.effects)
    least = ALIKE_SHARE if is_exchange else VALIDATION_SHARE
    predicts = Check.at_most(DiscoveryRule.VALIDATION_DECREASE, after, (1 - least) * misfit, name)
    checks.append(predicts)
    if not predicts:
        return None
    errors, before = (scores.square_errors(c, EVIDENCE_BLOCKS, adapted=True) for c in (larger, smaller))
    deviations = compare_errors(errors, before)[1]
    lasts = Check.at_least(DiscoveryRule.CONSISTENT_DECREASE, deviations, REFINEMENT_LEAST_DEVIATIONS, name)
    checks.append(lasts)
    return _Extension(larger, name, after, share) if lasts else None


def _criterion_gain(smaller: FittedCandidate, larger: FittedCandidate) -> float:
    """Decrease of Schwarz's criterion with a noise level that is not known, and falls with each effect: ``N ln(cost)``."""
    paid = (larger.free - smaller.free) * float(np.log(larger.count))
    return larger.count * float(np.log(max(smaller.cost, TINY) / max(larger.cost, TINY))) - paid


# Starting points of each of these refits, which are short.
REFINEMENT_REFIT_STARTS = 2
# Further effects that are refitted to convergence: the ones that promise the lowest cost.
REFINEMENT_FINISHED_CANDIDATES = 3


def _extend_each(
    problem: DiscoveryProblem,
    selected: FittedCandidate,
    candidates: Sequence[Effect],
    scales: Scales,
    policy: DiscoveryPolicy,
) -> list[FittedCandidate]:
    """``selected`` with each of the further effects whose predicted cost is lowest; those that promise most after a short refit are
    refitted to convergence.
    """
    names = set(selected.effects)
    parents = {parent for b in selected.model.bound_effects for parent in b.effect.parents}
    further = [(selected, e) for e in candidates if e.name not in names | parents and not names & set(e.parents)]
    promising = rank_extensions(problem, further, scales, policy.refinement.promising_candidates)

    looks = [
        problem.plan_refit(
            selected.model + e,
            list_extension_starts(selected, e, scales),
            REFINEMENT_REFIT_STARTS,
            SCREENING_ITERATIONS,
            selected,
            refines=False,
        )
        for _, e in promising
    ]
    short = [fit for fit in problem.refit_all(looks) if fit is not None]
    short.sort(key=lambda candidate: candidate.cost - candidate.promised_decrease)
    leading = short[:REFINEMENT_FINISHED_CANDIDATES]
    jobs = [problem.plan_refit(c.model, [c.model.values], 1, SEARCH_REFIT_ITERATIONS, c) for c in leading]
    finished = [again or c for again, c in zip(problem.refit_all(jobs), leading, strict=True)]
    return [*finished, *short[len(leading) :]]


# Effects that are refitted in the place of each effect of the model, where none is to be added.
REFINEMENT_REPLACEMENTS = 3


def _replace_each(
    problem: DiscoveryProblem,
    selected: FittedCandidate,
    name: str,
    candidates: Sequence[Effect],
    scales: Scales,
    policy: DiscoveryPolicy,
) -> list[FittedCandidate]:
    """``selected`` with one of its effects replaced by each of those whose predicted cost is lowest."""
    rest = problem.refit_without(selected, name, 1)
    if rest is None:
        return []
    others = [e for e in candidates if e.name != name]
    limits = replace(policy.refinement, promising_candidates=REFINEMENT_REPLACEMENTS)
    return [
        fit
        for fit in _extend_each(problem, rest, others, scales, replace(policy, refinement=limits))
        if set(fit.effects) != set(selected.effects)
    ]


def with_residual_noise(problem: DiscoveryProblem, candidate: FittedCandidate) -> DiscoveryProblem:
    """The same problem with white noise of the level of the candidate's residual: what is left is structure, to be followed."""
    noise, ratios = candidate.problem.noise, _residual_over_noise(candidate)
    colour = tuple(AutoRegression() for _ in noise.std)
    return replace(
        problem,
        noise=replace(noise, std=noise.std * ratios, colour=colour),
        model=candidate.model,
        options=problem.refit_options,
    )


def _residual_over_noise(candidate: FittedCandidate) -> np.ndarray:
    """Rms residual over noise of each output (ny,); one for an output that was not measured."""
    residuals = np.concatenate(normalised_residuals(candidate))
    counts = np.isfinite(residuals).sum(axis=0)
    squares = np.nansum(residuals**2, axis=0) / np.maximum(counts, 1)
    return np.where(counts > 0, np.sqrt(np.maximum(squares, TINY)), 1.0)
