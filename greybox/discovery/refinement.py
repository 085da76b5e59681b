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

import numpy as np

from greybox.discovery.decision import criterion_gain, make_check
from greybox.discovery.execution import RefitExecutor, RefitJournal
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import score_holdout, validate_candidate
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem, StartValues
from greybox.discovery.selection import MessageCallback
from greybox.discovery.shape_correction import is_shape_correction
from greybox.discovery.starting_points import estimate_scales, generate_starting_points
from greybox.effects import Scales, applicable_effects, tailor_to_record
from greybox.experiment import Experiment
from greybox.findings import Check, Finding
from greybox.model import Effect, Model
from greybox.noise import AutoRegression
from greybox.result import Fit
from greybox.values import Printable, ReadOnly


@dataclass(frozen=True)
class RefinementStep(Printable, ReadOnly):
    """One further effect.

    Parameters
    ----------
    name
        The effect.
    estimation_share, validation_share
        Share of the rms misfit that it removes on the estimation and on the validation records.
    alike
        What does nearly as well in its place, with the share that it removes on the validation records.
    """

    name: str
    estimation_share: float
    validation_share: float
    alike: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Refinement(Printable, ReadOnly):
    """What `refine` found: the fit with all effects, the steps that led there, and the checks of every candidate that was refitted."""

    fit: Fit
    steps: tuple[RefinementStep, ...]
    checks: tuple[Check, ...] = ()


@dataclass(frozen=True)
class _Extension:
    """A model with one effect more, its misfit on the validation records, and the share of the estimation misfit that it removes."""

    candidate: CandidateFit
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
    records = (validation,) if isinstance(validation, Experiment) else tuple(validation)
    executor = RefitExecutor(journal=RefitJournal(Path(journal)) if journal else None, report=on_refit)
    problem = replace(_with_white_noise(DiscoveryProblem.from_fit(fit, policy.budget), fit), executor=executor)
    start = problem.to_candidate(fit)
    model = _without_shape_corrections(fit.model)
    values = {n: v for n, v in fit.model.values.items() if n in model.values}
    selected = problem.refit_best(model, [values], keep=1, like=start) or start
    scales = estimate_scales(selected)
    candidates = (
        [tailor_to_record(e, scales) for e in effects] if effects else applicable_effects(plain or fit.model, scales)
    )
    misfit = score_holdout(problem, selected, records)
    if on_message:
        on_message(
            str(Finding(DiscoveryCode.REFINEMENT_STARTED, subject=selected.model.title, values={"misfit": misfit}))
        )
    steps: list[RefinementStep] = []
    checks: list[Check] = []
    while len(steps) < policy.refinement.most_effects:
        extensions = [
            extension
            for candidate in _extend_each(problem, selected, candidates, scales, policy)
            if (extension := _judge_extension(problem, selected, candidate, records, misfit, policy, checks))
        ]
        if not extensions:
            break
        alike = 1 + policy.refinement.alike_share
        least = min(e.candidate.per_sample for e in extensions) ** 0.5
        near = [e for e in extensions if e.candidate.per_sample**0.5 <= alike * least]
        best, *others = sorted(near, key=lambda e: e.validation_misfit)
        also = {
            e.name: 1 - e.validation_misfit / misfit
            for e in others
            if e.validation_misfit <= alike * best.validation_misfit
        }
        share = 1 - best.validation_misfit / misfit
        steps.append(RefinementStep(best.name, best.estimation_share, share, also))
        if on_message:
            on_message(str(steps[-1]))
        selected, misfit = best.candidate, best.validation_misfit
    return Refinement(validate_candidate(problem, selected, records), tuple(steps), tuple(checks))


def _judge_extension(
    problem: DiscoveryProblem,
    smaller: CandidateFit,
    larger: CandidateFit,
    validation: Sequence[Experiment],
    misfit: float,
    policy: DiscoveryPolicy,
    checks: list[Check],
) -> _Extension | None:
    """The larger model with its errors; None where the records do not demand it. Every check is added to ``checks``."""
    name = next(n for n in larger.effects if n not in smaller.effects)
    gain, least_gain = criterion_gain(smaller, larger), policy.selection.criterion_gain
    share = 1 - (larger.cost / smaller.cost) ** 0.5
    gains = make_check(DiscoveryRule.CRITERION_GAIN, gain, least_gain, gain > least_gain, name)
    fits = Check.at_least(DiscoveryRule.ESTIMATION_DECREASE, share, policy.refinement.estimation_share, name)
    checks += [gains, fits]
    if not (gains and fits):
        return None
    after = score_holdout(problem, larger, validation)
    predicts = Check.at_most(
        DiscoveryRule.VALIDATION_DECREASE, after, (1 - policy.refinement.validation_share) * misfit, name
    )
    checks.append(predicts)
    return _Extension(larger, name, after, share) if predicts else None


def _extend_each(
    problem: DiscoveryProblem,
    selected: CandidateFit,
    candidates: Sequence[Effect],
    scales: Scales,
    policy: DiscoveryPolicy,
) -> list[CandidateFit]:
    """``selected`` with each of the further effects whose predicted cost is lowest."""
    names = set(selected.effects)
    parents = {parent for b in selected.model.bound_effects for parent in b.effect.parents}
    further = [e for e in candidates if e.name not in names | parents and not names & set(e.parents)]
    starts = {e.name: _starting_points(selected, e, scales, policy) for e in further}
    predicted = {e.name: problem.predict_cost(selected.model + e, starts[e.name], selected) for e in further}
    promising = sorted(further, key=lambda e: predicted[e.name])[: policy.refinement.promising_candidates]
    extended = [
        problem.refit_best(selected.model + e, starts[e.name], policy.refinement.refit_starts, like=selected)
        for e in promising
    ]
    return [candidate for candidate in extended if candidate is not None]


def _without_shape_corrections(model: Model) -> Model:
    for name in [e.name for e in model.effects if is_shape_correction(e.name)]:
        model = model.without(name)
    return model


def _starting_points(
    selected: CandidateFit, effect: Effect, scales: Scales, policy: DiscoveryPolicy
) -> list[StartValues]:
    """Where the refit with a further effect starts: with nothing of it, and at the usual amplitudes and shapes."""
    model = selected.model + effect
    amplitudes = policy.budget.amplitude_grid
    return [model.values, *generate_starting_points(model, effect, selected, selected.model, scales, amplitudes)]


def _with_white_noise(problem: DiscoveryProblem, fit: Fit) -> DiscoveryProblem:
    """The same problem with white noise of the level of the residual."""
    noise = problem.prepare(fit.model).noise
    outputs = [o.name for o in fit.model.outputs]
    std = np.array([fit.misfit[o].rmse if o in fit.misfit else s for o, s in zip(outputs, noise.std, strict=True)])
    return replace(problem, noise=replace(noise, std=std, colour=tuple(AutoRegression() for _ in outputs)))
