"""What speaks for each effect of a model, on records that were not fitted, and what speaks against it.

A model that fits better shows that something was missing, not that it has the right name. So each effect is tested by its form: against
the best effect of another family in its place, against itself with a flexible curve (or a second branch) beside it, and by what it
leaves over its own variable. The model is fitted again from other starting points and to each half of the records, to see whether the
constants stay put.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from greybox.base.numerics import TINY
from greybox.base.values import Printable, ReadOnly
from greybox.data.noise.noise_model import fit_autoregression, join_series
from greybox.discovery.candidates import family_of
from greybox.discovery.certainty import (
    LEAST_RIVAL,
    MOST_DEVIATIONS,
    MOST_OWN_FORM,
    Grade,
    grade_effect,
    probability_of,
    to_features,
)
from greybox.discovery.curve_shape import TIME, rank_dependences
from greybox.discovery.disturbance_sites import unwhitened_shooting
from greybox.discovery.effect_signal import (
    EVIDENCE_BLOCKS,
    EVIDENCE_CONSTANT_SPREAD,
    EVIDENCE_SEED,
    EffectSignal,
    acts_as_constant,
    adds_constant,
    is_offset_on_one_side,
)
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.holdout import (
    VISIBLE_RMS,
    BlockErrors,
    HoldoutScores,
    compare_errors,
    is_level_measured,
    mean_error,
)
from greybox.discovery.localisation import localise_residual
from greybox.discovery.policy import CertaintyPolicy, DiscoveryPolicy
from greybox.discovery.problem import SEARCH_REFIT_ITERATIONS, DiscoveryProblem, FittedCandidate
from greybox.discovery.residual_noise import (
    has_memory,
    is_shape_correction,
    list_shape_corrections,
    prepare_curve,
    prepare_power,
)
from greybox.discovery.selection import TIE_COST, list_extension_starts, rank_extensions
from greybox.discovery.surrogate import QUICK_ITERATIONS, FreeCurve, refit_free_curves
from greybox.discovery.surrogate_effects import CURVE
from greybox.estimation.result import Fit
from greybox.model.effect import Effect
from greybox.model.effects.placement import AT
from greybox.model.effects.scales import Scales
from greybox.model.effects.starts import MANY_SHAPES, count_shapes


@dataclass(frozen=True)
class EffectEvidence(Printable, ReadOnly):
    """What speaks for one effect of a model.

    Parameters
    ----------
    effect
        Its name.
    probability, grade
        How probable it is that the effect is there and has the right name, and what may be said because of that.
    output, unit
        The output in which it takes the largest share of the error.
    without, error
        Rms error on the validation records without the effect, everything else refitted, and with it, in ``unit``.
    share, share_interval
        Share of the error that it takes away, 0 to 1, and the 95 % interval over blocks of the records.
    rival, rival_error
        The best effect of another family in its place, and the rms error with that; "" and NaN where none could be fitted.
    alike
        Effects of other families that do the same in its place (those of more constants within chance), and `fitted_curve` where a curve
        does as well: one without memory in the place of an effect with one, a power law in that of one of many constants, or a curve over
        another variable or at another site. No record of this kind separates them. The probability is that of one of these being right.
    change
        Relative change of its constants from one half of the estimation records to the other; NaN where a half could not be fitted.
    survives_start
        Whether a refit from other constants ends in the same place.
    survives_records
        Whether it takes a part of the error of every validation record.
    measures
        What the probability was computed from. Losses are relative differences of mean square errors from that of the model, all outputs
        together, on the validation records and adapted to them (`HoldoutScores.adapt`): without the effect, with its rival, with a
        flexible curve beside it, and with something simpler in its place (``static``: of an effect with memory a curve, of one of many
        constants a power law); ``_t`` are the same in standard errors of the
        blocks, ``rival_parameters`` how many more parameters the rival has, ``curve_gain`` what the curve beside the effect takes of the
        logarithm of the rms error of the records it was fitted to. For what would be established, ``free_loss`` is the relative
        difference of the cost on the estimation records, with a free curve over whatever explains most, wherever it does so.
    """

    effect: str
    probability: float
    grade: Grade
    output: str
    unit: str
    without: float
    error: float
    share: float
    share_interval: tuple[float, float]
    rival: str
    rival_error: float
    alike: tuple[str, ...]
    change: float
    survives_start: bool
    survives_records: bool
    measures: Mapping[str, float]


@dataclass(frozen=True)
class EvidenceInputs:
    """What the evidence is gathered from.

    Parameters
    ----------
    problem, scales, candidates
        The records, their peaks and times, and all effects that are candidates.
    selected, baseline
        The model in question and the plain one.
    fit
        The model in question as a fit with intervals.
    known
        Fits of other sets of effects.
    scores
        The validation records.
    signals
        The signal of each effect, from the data and from the model.
    policy
        The decision numbers.
    """

    problem: DiscoveryProblem
    scales: Scales
    candidates: Sequence[Effect]
    selected: FittedCandidate
    baseline: FittedCandidate
    fit: Fit
    known: Mapping[frozenset[str], FittedCandidate]
    scores: HoldoutScores
    signals: Sequence[EffectSignal]
    policy: DiscoveryPolicy

    def attempt(self, run: partial[FittedCandidate | None]) -> FittedCandidate | None:
        """A refit; None where it fails, with the reason kept."""
        return self.problem.failures.attempt(SearchStage.EVIDENCE, self.selected.effects, run, None)

    def attempt_check(self, check: partial[bool]) -> bool:
        """A check of the selected model; not met where it cannot be made, with the reason kept."""
        return self.problem.failures.attempt(SearchStage.EVIDENCE, self.selected.effects, check, False)


def lower_grade(evidence: EffectEvidence) -> EffectEvidence:
    """The same evidence where the answer as a whole is open: what was established is only probable."""
    return replace(evidence, grade=Grade.PROBABLE) if evidence.grade is Grade.ESTABLISHED else evidence


# Correlation from sample to sample up to which a residual may be the noise of a sensor, where nobody knows the noise.
MOST_CORRELATION = 0.95


def gather_evidence(inputs: EvidenceInputs) -> tuple[EffectEvidence, ...]:
    """The evidence for each effect of the selected model; empty where that cannot be run on the validation records."""
    errors = inputs.scores.square_errors(inputs.selected, EVIDENCE_BLOCKS)
    if not errors:
        return ()
    corrected = _refit_with_corrections(inputs)
    halves = _refit_halves(inputs)
    survives_start = _ends_in_the_same_place(inputs)
    structure = measure_structure(inputs.scores, inputs.selected, only_visible=True)
    weighed = tuple(
        _weigh_effect(inputs, effect, errors, corrected.get(effect.name), halves, survives_start, structure)
        for effect in inputs.selected.model.effects
        if effect.name in inputs.selected.effects and not is_shape_correction(effect.name)
    )
    return _lower_doubtful(weighed, structure, len(inputs.selected.model.outputs))


# Share of the error from which a stand-in without an equal puts the other effects in doubt, where `visible_structure` is left. It always
# puts those in doubt that take less than it.
DISGUISE_SHARE = 0.3
# Share of the rms error that is more than noise from which something unknown still acts.
VISIBLE_STRUCTURE = 0.3


def _lower_doubtful(weighed: tuple[EffectEvidence, ...], structure: float, outputs: int) -> tuple[EffectEvidence, ...]:
    """What one effect says about the others: something unknown may wear several names.

    Where more than noise is left, a stand-in for a large part of the error puts all others in doubt, and always those that take less
    than it: they may be what it does not explain. One that merely has an equal does not. The same effect at each of several outputs is
    as well one of the input or of the plant.
    """
    kinds = [e.effect.partition(AT)[0] for e in weighed]
    repeated = {kind for kind in kinds if outputs > 1 and kinds.count(kind) == outputs}
    largest = max((e.share for e in weighed if e.grade is Grade.STAND_IN and not e.alike), default=0.0)
    is_disguised = structure > VISIBLE_STRUCTURE and largest > DISGUISE_SHARE
    return tuple(
        lower_grade(e) if is_disguised or e.share < largest or kind in repeated else e
        for e, kind in zip(weighed, kinds, strict=True)
    )


# Relative difference of mean square errors, over what the effect takes, below which a rival does the same.
EVIDENCE_SAME_ERROR = 0.01


def _weigh_effect(
    inputs: EvidenceInputs,
    effect: Effect,
    errors: BlockErrors,
    corrected: FittedCandidate | None,
    halves: Sequence[FittedCandidate],
    survives_start: bool,
    structure: float,
) -> EffectEvidence:
    name = effect.name
    rest = _refit_without(inputs, name)
    without = inputs.scores.square_errors(rest, EVIDENCE_BLOCKS) if rest is not None else {}
    rivals = _refit_rivals(inputs, name, rest)
    rival_errors = [inputs.scores.square_errors(rival, EVIDENCE_BLOCKS) for rival in rivals]
    square_errors = partial(inputs.scores.square_errors, blocks=EVIDENCE_BLOCKS, adapted=True)
    form = square_errors(inputs.selected)
    behind = [compare_errors(form, square_errors(rival)) for rival in rivals]
    loss, loss_t = compare_errors(form, square_errors(rest) if rest is not None else {})
    alike = [
        k
        for k, rival in enumerate(rivals)
        if abs(behind[k][0]) < EVIDENCE_SAME_ERROR * min(loss, 1.0) or _is_richer_equal(inputs, rival, behind[k])
    ]
    others = [k for k in range(len(rivals)) if k not in alike]
    nearest = min(others, key=lambda k: behind[k][0], default=None)
    rival_loss, rival_t = (loss, loss_t) if nearest is None else behind[nearest]
    curve_loss, curve_t = (np.nan, np.nan) if corrected is None else compare_errors(form, square_errors(corrected))
    curve_gain = 0.0
    if corrected is not None:
        curve_gain = 0.5 * math.log(max(inputs.selected.cost, TINY) / max(corrected.cost, TINY))
    rival_parameters = 0.0
    if nearest is not None:
        rival_parameters = _count_parameters(rivals[nearest]) - _count_parameters(inputs.selected)
    static = _refit_simpler(inputs, effect, rest)
    static_loss, static_t = (np.nan, np.nan) if static is None else compare_errors(form, square_errors(static))
    is_static = static_loss < EVIDENCE_SAME_ERROR * min(loss, 1.0)
    change = _measure_change(inputs.selected, effect, halves, inputs.fit)
    plain = inputs.scores.square_errors(inputs.baseline, EVIDENCE_BLOCKS)
    output = _choose_output(errors, without, plain)
    share, interval = _share_of_error(errors[output], without.get(output))
    measures = {
        "share": share,
        "loss": loss,
        "loss_t": loss_t,
        "rival_loss": rival_loss,
        "rival_t": rival_t,
        "rival_parameters": rival_parameters,
        "curve_loss": curve_loss,
        "curve_t": curve_t,
        "curve_gain": curve_gain,
        "static_loss": static_loss,
        "static_t": static_t,
        "remainder": _remainder_over_variable(inputs, name),
        "structure": structure,
        "change": change,
        "start": float(survives_start),
        "effects": float(len(inputs.selected.effects)),
        "undetermined": float(_is_undetermined(inputs.fit, name)),
    }
    is_constant = any(
        inputs.attempt_check(partial(check, inputs.selected, name))
        for check in (acts_as_constant, is_offset_on_one_side)
    )
    does_a_curve = is_static or is_constant
    probability, grade = _grade(measures, does_a_curve, inputs.policy.certainty)
    if grade is Grade.ESTABLISHED:  # the dearest test comes last, for what has passed all others
        measures["free_loss"] = _compare_with_free_curves(inputs, name, form, rest)
        probability, grade = _grade(measures, does_a_curve, inputs.policy.certainty)
        does_a_curve = grade is not Grade.ESTABLISHED
    if alike and grade is Grade.ESTABLISHED:
        grade = Grade.PROBABLE
    unit = next(o.unit for o in inputs.selected.model.outputs if o.name == output)
    return EffectEvidence(
        name,
        probability,
        grade,
        output,
        unit,
        float(np.sqrt(mean_error(without.get(output)))),
        float(np.sqrt(mean_error(errors[output]))),
        share,
        interval,
        "" if nearest is None else _other(rivals[nearest], inputs.selected),
        np.nan if nearest is None else float(np.sqrt(mean_error(rival_errors[nearest].get(output)))),
        (*(_other(rivals[k], inputs.selected) for k in alike), *((CURVE,) if does_a_curve else ())),
        change,
        survives_start,
        _helps_on_every_record(inputs, rest, output),
        measures,
    )


def _choose_output(errors: BlockErrors, without: BlockErrors, plain: BlockErrors) -> str:
    """The output of whose error an effect takes the largest share: of those that the model follows better than the plain one does.

    Of an output that the plain model follows better it takes nothing, however much more would be left without it.
    """
    reduced = [o for o in errors if not mean_error(plain.get(o)) <= mean_error(errors[o])]
    return max(reduced or errors, key=lambda o: mean_error(without.get(o)) / max(mean_error(errors[o]), TINY))


def _is_richer_equal(inputs: EvidenceInputs, rival: FittedCandidate, behind: tuple[float, float]) -> bool:
    """Whether a rival does the same with more constants: nothing but chance lies between the two where they are judged, and where they
    were fitted its constants have not paid. It is no objection to the simpler one, which it contains or imitates, but its equal.
    """
    selected = inputs.selected
    is_chance = abs(behind[1]) < LEAST_RIVAL * MOST_DEVIATIONS
    return is_chance and rival.free > selected.free and rival.criterion > selected.criterion - TIE_COST


def _grade(measures: Mapping[str, float], has_equal: bool, policy: CertaintyPolicy) -> tuple[float, Grade]:
    features = to_features(measures)
    probability = probability_of(features, policy)
    return probability, grade_effect(probability, features, has_equal)


def _compare_with_free_curves(
    inputs: EvidenceInputs, name: str, form: BlockErrors, rest: FittedCandidate | None
) -> float:
    """How much larger the cost of the best free curve is that stands in the place of an effect; NaN where none could be fitted.

    The cost is that on the estimation records: on the validation records a curve of so many constants drifts, or is adapted to the
    noise. There it must only not do worse than the selected model, beyond chance; ``form`` holds the errors of that, adapted. A curve
    that represents the effect itself counts where it shows another form (`CertaintyPolicy.most_own_form`) and Schwarz's criterion, which
    charges its heights, is for it.
    """
    signal = next((s for s in inputs.signals if s.effect == name), None)
    chance = LEAST_RIVAL * MOST_DEVIATIONS
    is_constant = inputs.attempt_check(partial(adds_constant, inputs.selected, name))
    taken = 0.0 if rest is None else rest.cost - inputs.selected.cost
    other_form = MOST_OWN_FORM**2 * taken
    losses = [
        curve.candidate.cost / max(inputs.selected.cost, TINY) - 1
        for curve in _refit_free_curves(inputs, rest)
        if not (is_constant or _represents(curve.variable, signal))
        or (
            curve.candidate.criterion < inputs.selected.criterion
            and inputs.selected.cost - curve.candidate.cost > other_form
        )
        if compare_errors(form, inputs.scores.square_errors(curve.candidate, EVIDENCE_BLOCKS, adapted=True))[1] < chance
    ]
    return min(losses, default=np.nan)


# Correlation of an effect's signal with time from which it is a drift.
DRIFT_CORRELATION = 0.95


def _represents(variable: str, signal: EffectSignal | None) -> bool:
    """Whether a curve over ``variable`` can be the effect itself: over its own variable, over time if it drifts, over any if it is
    constant.
    """
    if signal is None:
        return False
    rms, spread = float(np.sqrt(np.mean(signal.modelled**2))), float(np.std(signal.modelled))
    if variable == signal.variable_name or spread <= EVIDENCE_CONSTANT_SPREAD * rms:
        return True
    return variable == TIME and abs(float(np.corrcoef(signal.time, signal.modelled)[0, 1])) > DRIFT_CORRELATION


# Refits


# Iterations of these refits; they start near where they end.
EVIDENCE_ITERATIONS = 30


def _refit_without(inputs: EvidenceInputs, name: str) -> FittedCandidate | None:
    """The selected model without one effect, everything else refitted."""
    selected = inputs.selected
    if len(selected.effects) == 1:
        return inputs.baseline
    known = inputs.known.get(frozenset(selected.effects) - {name})
    model = selected.model.without(name)
    values = {n: value for n, value in selected.model.values.items() if n in model.values}
    iterations = EVIDENCE_ITERATIONS
    again = inputs.attempt(partial(inputs.problem.refit_best, model, [values], 1, iterations, selected, refines=False))
    if again is not None and _is_hopeful(inputs, again):
        again = _converge(inputs, again)
    return min((fit for fit in (known, again) if fit is not None), key=lambda fit: fit.cost, default=None)


# Effects of other families that are fitted in the place of each effect.
EVIDENCE_RIVALS = 4


def _refit_rivals(inputs: EvidenceInputs, name: str, rest: FittedCandidate | None) -> list[FittedCandidate]:
    """The best effects of other families in the place of one; one more where effects that do the same are among them."""
    selected = inputs.selected
    if rest is None:
        return []
    kept, family = frozenset(selected.effects) - {name}, set(family_of(name, inputs.candidates))
    sets = {
        key: fit for key, fit in inputs.known.items() if len(key) == len(kept) + 1 and kept < key and name not in key
    }
    near = sorted((fit for key, fit in sets.items() if not key - kept & family), key=lambda fit: fit.cost)
    if len(near) >= EVIDENCE_RIVALS:
        return _keep_hopeful(inputs, near[:EVIDENCE_RIVALS])
    others = [e for e in inputs.candidates if e.name not in family | set(selected.effects)]
    ranked = rank_extensions(inputs.problem, rest, others, inputs.scales, EVIDENCE_RIVALS)
    quick = [
        partial(
            inputs.problem.refit_best,
            rest.model + e,
            list_extension_starts(rest, e, inputs.scales),
            1,
            QUICK_ITERATIONS,
            rest,
            refines=False,
        )
        for e in ranked
    ]
    fits = [inputs.attempt(job) for job in quick]
    return _keep_hopeful(inputs, [*near, *(fit for fit in fits if fit is not None)])


def _keep_hopeful(inputs: EvidenceInputs, rivals: list[FittedCandidate]) -> list[FittedCandidate]:
    """The rivals that may still come near, refitted to the end, each once; the best where none may: one shows how far behind they are."""
    hopeful = [_converge(inputs, fit) for fit in rivals if _is_hopeful(inputs, fit)]
    # One that was fitted in the search and again here counts as the better of the two.
    once = {frozenset(fit.effects): fit for fit in sorted(hopeful, key=lambda fit: -fit.cost)}
    return list(once.values())[::-1] or sorted(rivals, key=lambda fit: fit.cost)[:1]


# ...if its cost is still so many times that of the model in question: five times the rms error. Where an effect is left out that takes
# almost everything, the others turn stiff in its place, and each refit would take minutes to show that it is no rival.
HOPELESS_COST = 25.0


def _is_hopeful(inputs: EvidenceInputs, fit: FittedCandidate) -> bool:
    """Whether a model that was fitted with the step it started with may still come near the selected one."""
    return fit.cost <= HOPELESS_COST * inputs.selected.cost


# Constants from which an effect without memory is held against a power of its variable: so many imitate other simple laws.
MANY_CONSTANTS = 3


def _refit_simpler(inputs: EvidenceInputs, effect: Effect, rest: FittedCandidate | None) -> FittedCandidate | None:
    """Something simpler in the place of an effect: where that does as well, the records do not show what the effect has beyond it.

    For an effect with memory a smooth curve without one, for one of many constants a power of its variable. None for all others.
    """
    signal = next((s for s in inputs.signals if s.effect == effect.name), None)
    if rest is None or signal is None:
        return None
    if has_memory(effect):
        prepare = partial(prepare_curve, rest, signal)
    elif _count_free(inputs.selected, effect) >= MANY_CONSTANTS:
        prepare = partial(prepare_power, inputs.selected, rest, signal)
    else:
        return None
    job = inputs.problem.failures.attempt(SearchStage.SHAPE_CORRECTION, inputs.selected.effects, prepare, None)
    return None if job is None else inputs.problem.refit_all([job])[0]


def _refit_free_curves(inputs: EvidenceInputs, rest: FittedCandidate | None) -> list[FreeCurve]:
    """In the place of an effect a smooth curve wherever the records would have one: where that does better, the name or the place is
    wrong.
    """
    if rest is None:
        return []

    def refit(rest: FittedCandidate) -> list[FreeCurve]:
        location = localise_residual(rest, selection=inputs.policy.selection)
        return refit_free_curves(inputs.problem, rest, location, inputs.policy, inputs.selected.cost)

    return inputs.problem.failures.attempt(SearchStage.EVIDENCE, rest.effects, partial(refit, rest), [])


def _converge(inputs: EvidenceInputs, fit: FittedCandidate) -> FittedCandidate:
    again = inputs.attempt(
        partial(inputs.problem.refit_best, fit.model, [fit.model.values], 1, EVIDENCE_ITERATIONS, fit)
    )
    return again if again is not None and again.cost < fit.cost else fit


def _refit_with_corrections(inputs: EvidenceInputs) -> dict[str, FittedCandidate]:
    """By effect, the selected model with the best correction of its shape: a curve over its variable, or a second branch."""
    problem, selected = inputs.problem, inputs.selected
    listing = partial(list_shape_corrections, problem, selected, inputs.scales)
    jobs = problem.failures.attempt(SearchStage.SHAPE_CORRECTION, selected.effects, listing, [])
    best: dict[str, FittedCandidate] = {}
    for (name, _), fit in zip(jobs, problem.refit_all([job for _, job in jobs]), strict=True):
        if fit is not None and (name not in best or fit.criterion < best[name].criterion):
            best[name] = fit
    return best


# Rows of a record below which it is not halved.
EVIDENCE_LEAST_ROWS = 100


def _refit_halves(inputs: EvidenceInputs) -> list[FittedCandidate]:
    """The selected model fitted to the first half of each record, and to the second; empty where one cannot be fitted."""
    problem, selected = inputs.problem, inputs.selected
    if min(e.rows for e in problem.experiments) < EVIDENCE_LEAST_ROWS:
        return []

    def refit(second: bool) -> FittedCandidate | None:
        cuts = [e.rows // 2 for e in problem.experiments]
        parts = [
            e.window(cut, e.rows) if second else e.window(0, cut)
            for e, cut in zip(problem.experiments, cuts, strict=True)
        ]
        # A second half does not begin at rest: its first states are estimated, from where the run of the whole record passes.
        options = replace(problem.refit_options, at_rest=False) if second else problem.refit_options
        half = replace(problem, experiments=tuple(parts), noise=problem.noise_model, quiet=(), options=options)
        starts = _states_at(selected, cuts) if second else {}
        job = RefitJob(selected.model, (selected.model.values,), 1, EVIDENCE_ITERATIONS, starts)
        return half.refit_all([job])[0]

    fits = [inputs.attempt(partial(refit, second)) for second in (False, True)]
    return [fit for fit in fits if fit is not None] if None not in fits else []


def _states_at(candidate: FittedCandidate, rows: Sequence[int]) -> dict[str, tuple[float, ...]]:
    """The simulated states at one row of each record, by name."""
    runs = unwhitened_shooting(candidate).simulate(np.zeros(candidate.variables.size))
    states = [record.samples(x)[row] for (_, x), record, row in zip(runs, candidate.problem.records, rows, strict=True)]
    return dict(zip(candidate.model.system.state_names, map(tuple, np.array(states).T.tolist()), strict=True))


# Factor on an effect's amplitudes (and its inverse on its shape) for the refit from another start.
EVIDENCE_DISPLACEMENT = 0.5
# Relative difference in cost below which two refits ended in the same place.
EVIDENCE_SAME_COST = 0.01


def _ends_in_the_same_place(inputs: EvidenceInputs) -> bool:
    """Whether a refit from other constants of the effects finds the same cost, and no lower one.

    An effect of many shapes (a sharp resonance) stays where it is: from another shape no refit comes back, whatever its name.
    """
    selected, factor = inputs.selected, EVIDENCE_DISPLACEMENT
    values = dict(selected.model.values)
    moving = [b for b in selected.model.bound_effects if count_shapes(b.effect, inputs.scales) <= MANY_SHAPES]
    for bound in moving:
        for name in (q.name for q in bound.effect.parameters):
            in_model = bound.model_names[name]
            parameter = selected.model.parameter(in_model)
            if not parameter.fixed:
                low, high = parameter.bounds
                moved = values[in_model] * (factor if name in bound.effect.amplitudes else 1 / factor)
                values[in_model] = float(np.clip(moved, low, high))
    again = inputs.attempt(
        partial(inputs.problem.refit_best, selected.model, [values], 1, SEARCH_REFIT_ITERATIONS, selected)
    )
    if again is None:
        return False
    allowed = max(TIE_COST, EVIDENCE_SAME_COST * selected.cost)
    return bool(abs(again.cost - selected.cost) <= allowed)


# Comparisons


# Resampled sets of blocks behind an interval.
EVIDENCE_RESAMPLES = 400
# Coverage of that interval.
EVIDENCE_CONFIDENCE = 0.95


def _share_of_error(errors: np.ndarray, without: np.ndarray | None) -> tuple[float, tuple[float, float]]:
    """Share of the rms error that an effect takes away, and its interval over resampled blocks."""
    if without is None or len(without) != len(errors) or not np.isfinite(without).all():
        return 1.0, (np.nan, np.nan)
    draws = np.random.default_rng(EVIDENCE_SEED).integers(0, len(errors), (EVIDENCE_RESAMPLES, len(errors)))
    shares = 1 - np.sqrt(errors[draws].mean(axis=1) / np.maximum(without[draws].mean(axis=1), TINY))
    tail = (1 - EVIDENCE_CONFIDENCE) / 2
    low, high = np.quantile(shares, (tail, 1 - tail))
    return 1 - float(np.sqrt(mean_error(errors) / max(mean_error(without), TINY))), (float(low), float(high))


def _helps_on_every_record(inputs: EvidenceInputs, rest: FittedCandidate | None, output: str) -> bool:
    """Whether the effect takes a part of the error of each validation record."""
    runs = [inputs.scores.run(fit) for fit in (inputs.selected, rest) if fit is not None]
    if len(runs) < 2 or runs[0] is None or runs[1] is None:
        return rest is not None
    first = inputs.scores.validation.uncounted
    pairs = [(a, b) for a, b in zip(runs[0].traces, runs[1].traces, strict=True) if output in a.measured]
    return all(
        float(np.nanmean(a.residual(output)[first:] ** 2)) < float(np.nanmean(b.residual(output)[first:] ** 2))
        for a, b in pairs
    )


# Standard errors by which the rms of noise may exceed its level by chance.
CHANCE_DEVIATIONS = 3.0


def measure_structure(scores: HoldoutScores, candidate: FittedCandidate, only_visible: bool) -> float:
    """Share of the rms error on the validation records that is no noise, 0 to 1, all outputs together.

    What the uncertainty of constants and first states explains does not count (`HoldoutScores.adapt`). Where the noise is known, what
    exceeds it; else what the samples before tell of each sample. With ``only_visible`` what noise may look like is noise: a level up
    to `VISIBLE_RMS` or within chance, and the correlation of first order that a sensor may have.
    """
    run, adapted = scores.run(candidate), scores.adapt(candidate)
    if run is None or adapted is None:
        return 1.0
    noise, charge, shares = candidate.problem.noise, scores.charge(adapted), []
    for name, misfit in run.misfit.items():
        series = join_series(adapted.residuals[name])
        rms = max(float(np.sqrt(np.nanmean(series**2) + charge[name])), TINY)
        if is_level_measured(noise, name):
            bound = noise.bound(name)  # the problem may weigh with another level, the residual's
            level = misfit.rmse / misfit.noise_ratio if bound is None else bound.level
            if only_visible:
                # The rms of N samples of noise has a standard error of 1 / sqrt(2 N) of itself.
                level *= max(VISIBLE_RMS, 1 + CHANCE_DEVIATIONS / math.sqrt(2 * misfit.samples))
            shares.append(max(1 - (level / rms) ** 2, 0.0))
            continue
        deviation = series / rms
        colour, first = fit_autoregression(deviation), fit_autoregression(deviation, max_order=1)
        # A sensor, or the filter behind it, has one time constant; a correlation that lasts longer is none of theirs.
        is_sensor = only_visible and abs(first.autocorrelation(2)[1]) < MOST_CORRELATION
        shares.append(1 - colour.innovation_variance / (first.innovation_variance if is_sensor else 1.0))
    return float(np.sqrt(np.mean(shares))) if shares else 1.0


def _remainder_over_variable(inputs: EvidenceInputs, name: str) -> float:
    """Size of what the effect leaves as a function of its own variable, its direction included, over the size of the effect's signal."""
    signal = next((s for s in inputs.signals if s.effect == name), None)
    if signal is None:
        return 0.0
    rest, power = signal.value - signal.modelled, float(np.mean(signal.value**2))
    variables = {signal.variable_name: (signal.variable, signal.variable_unit)}
    ranked = rank_dependences(signal.time, rest, variables)
    share = max((d.share + max(d.loop, 0.0) for d in ranked), default=0.0)
    return float(np.clip(np.sqrt(share * float(np.var(rest)) / max(power, TINY)), 0, 1))


def _measure_change(selected: FittedCandidate, effect: Effect, halves: Sequence[FittedCandidate], fit: Fit) -> float:
    """Relative difference of the effect's amplitudes between the halves of the records; the median of several.

    An amplitude that its bounds stopped is only known to be large enough: where all are, the constants of shape count. Each is compared
    with the largest of its unit: the sine and the cosine of one wave are one size.
    """
    if len(halves) < 2:
        return np.nan
    names = selected.model.names_of(effect.name)
    amplitudes = [names[n] for n in effect.amplitudes]
    shapes = [names[q.name] for q in effect.parameters if q.name not in effect.amplitudes]
    free = [n for n in (*amplitudes, *shapes) if not selected.model.parameter(n).fixed]
    inside = [n for n in free if n not in fit.parameters or not fit.parameters[n].at_bound] or free
    counted = [n for n in inside if n in amplitudes] or inside
    units = {n: selected.model.parameter(n).unit for n in counted}
    pairs = {n: tuple(half.model.values[n] for half in halves) for n in counted}
    sizes = {n: (abs(one) + abs(other)) / 2 for n, (one, other) in pairs.items()}
    changes = [
        abs(one - other) / max(*(sizes[m] for m in counted if units[m] == units[n]), TINY)
        for n, (one, other) in pairs.items()
    ]
    return float(np.median(changes)) if changes else 0.0


def _is_undetermined(fit: Fit, name: str) -> bool:
    """Whether the records do not determine the effect.

    One of its amplitudes ended at zero, or is free and has no interval (of an effect without amplitudes: no parameter has one); of an
    effect that has a simpler relative, also a parameter that its bounds stopped: there the one becomes the other. Bounds elsewhere say
    no such thing (an edge as sharp as the samples can show).
    """
    bound = next((b for b in fit.model.bound_effects if b.effect.name == name), None)
    if bound is None:
        return False
    free = {
        q.name: estimate
        for q in bound.effect.parameters
        if (estimate := fit.parameters.get(bound.model_names[q.name])) is not None and not estimate.fixed
    }
    if bound.effect.parents and any(estimate.at_bound for estimate in free.values()):
        return True
    is_absent = {n: e.value == 0 if e.at_bound else e.std is None for n, e in free.items()}
    if bound.effect.amplitudes:
        return any(is_absent[n] for n in bound.effect.amplitudes if n in is_absent)
    return bool(is_absent) and all(is_absent.values())


def _count_free(candidate: FittedCandidate, effect: Effect) -> int:
    """How many constants of an effect are not fixed."""
    names = candidate.model.names_of(effect.name)
    return sum(not candidate.model.parameter(names[q.name]).fixed for q in effect.parameters)


def _count_parameters(candidate: FittedCandidate) -> float:
    return float(sum(len(effect.parameters) for effect in candidate.model.effects))


def _other(rival: FittedCandidate, selected: FittedCandidate) -> str:
    return next((name for name in rival.effects if name not in selected.effects), "")
