"""`detect_changes`: a fit and the records of today in; unchanged, changed (what, by how much) or cannot tell out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from greybox.base.errors import DataError
from greybox.base.numerics import TINY
from greybox.base.values import Check, Finding, Severity
from greybox.data.experiment import Experiment, name_records
from greybox.data.identity import find_shared_readings
from greybox.data.noise.noise_model import AutoRegression
from greybox.data.read import as_experiments
from greybox.discovery.pipeline import discover
from greybox.discovery.result import Discovery
from greybox.estimation.fit import fit
from greybox.estimation.optimum import restore_noise
from greybox.estimation.options import FitOptions
from greybox.estimation.result import Fit
from greybox.extensions.changes.constants import (
    DifferenceTest,
    FittedConstants,
    FittedResidual,
    MeasuredScatter,
    compare_constants,
    list_comparable,
    measure_scatter,
    reach_of_missing_part,
    read_constants,
    read_residual,
)
from greybox.extensions.changes.result import (
    ChangeCode,
    ChangeDetection,
    ChangeRule,
    ChangeVerdict,
    ConstantChange,
    list_appeared_effects,
)
from greybox.model.effect import Effect

# Is today's residual like that of the fit: as large, and as white? Where it is not, more than constants have changed.


def check_residual(before: FittedResidual, after: FittedResidual, level: float) -> tuple[Check, ...]:
    """p-values of each output's residual against their limit, which shares ``level`` out; none without a yardstick.

    The size by the ratio of variances, with fewer degrees of freedom where the residual is coloured (Bartlett 1935) or has heavier tails
    than normal noise (Box 1953); the colour by Ljung and Box where it was white before.
    """
    if not before.adequate:
        return ()
    shared = [name for name in before.outputs if name in after.outputs]
    tests: list[tuple[ChangeRule, str, float]] = []
    for name in shared:
        i, j = before.outputs.index(name), after.outputs.index(name)
        one, other = before.colour.variance[i], after.colour.variance[j]
        # A variance of samples with kurtosis k is as uncertain as one of 2 / (k - 1) times as many normal ones (Box 1953). The kurtosis is
        # that of the fit's residual: an effect that has appeared gives today's heavy tails.
        tails = 2 / (max(before.kurtosis[i], 3.0) - 1)
        p = float(fdtrc(after.degrees[j] * tails, before.degrees[i] * tails, other / one)) if one > 0 else 1.0
        tests.append((ChangeRule.RESIDUAL_AS_LARGE, name, p))
        # A residual that was coloured already says nothing by its colour.
        if not before.colour.models[i].order and np.isfinite(after.whiteness[j]):
            tests.append((ChangeRule.RESIDUAL_AS_WHITE, name, float(after.whiteness[j])))
    # Bonferroni: all tests together keep the level.
    limit = level / max(len(tests), 1)
    return tuple(Check.at_least(rule, p, limit, name) for rule, name, p in tests)


Signals = Mapping[str, np.ndarray]

# Two records of the same motion: what the model lacks acts alike in both.


@dataclass(frozen=True)
class Repeats:
    """Records of the same motions before and today, all of one motion over the rows that they have in common.

    ``pairs``: each of today's with the one of before that stands for it. Empty where one of today's repeats none.
    """

    before: tuple[Experiment, ...] = ()
    after: tuple[Experiment, ...] = ()
    pairs: tuple[tuple[Experiment, Experiment], ...] = ()


def match_repeats(reference: Sequence[Experiment], records: Sequence[Experiment]) -> Repeats:
    """The records of each motion that today's repeat; nothing where one of today's repeats none of the fit."""
    everything = (*reference, *records)
    # Alike records show one motion, and so do two that a third links: a record that is left out says nothing of how far constants scatter.
    shown = list(range(len(everything)))
    for k, one in enumerate(everything):
        for j in range(k):
            if shown[j] != shown[k] and is_alike(everything[j], one):
                shown = [shown[j] if m == shown[k] else m for m in shown]
    known, motions = shown[: len(reference)], shown[len(reference) :]
    if not set(motions) <= set(known):
        return Repeats()
    before = {m: [one for one, of in zip(reference, known, strict=True) if of == m] for m in dict.fromkeys(motions)}
    rows = {
        motion: min(r.rows for r in (*ones, *(r for r, m in zip(records, motions, strict=True) if m == motion)))
        for motion, ones in before.items()
    }
    cut = {motion: [one.window(0, rows[motion]) for one in ones] for motion, ones in before.items()}
    after = tuple(record.window(0, rows[motion]) for record, motion in zip(records, motions, strict=True))
    # The second record of a motion stands beside the second one of before, as long as there are any.
    places = [motions[:k].count(motion) for k, motion in enumerate(motions)]
    pairs = tuple(
        (cut[motion][place if place < len(cut[motion]) else 0], record)
        for motion, place, record in zip(motions, places, after, strict=True)
    )
    return Repeats(tuple(one for ones in cut.values() for one in ones), after, pairs)


# Rms difference of two signals over their size up to which one repeats the other: what the model lacks then acts alike in both.
REPEATED_INPUT = 0.1
# Share of the longer record that both must cover: of less, most of what was learnt from it happened elsewhere.
COMMON_SHARE = 0.5


def is_alike(one: Experiment, other: Experiment) -> bool:
    """Whether a record repeats the motion of another one over the time that both cover: under the same input, or with the same outputs.

    A run that ends by itself (a coast-down, a stroke to a stop) may end earlier or later. One without any input repeats another that
    begins alike. In a closed loop a changed machine makes the same motion under another input.
    """
    if min(one.rows, other.rows) < COMMON_SHARE * max(one.rows, other.rows):
        return False
    if not np.allclose(np.median(one.intervals), np.median(other.intervals), rtol=REPEATED_INPUT):
        return False
    if not one.inputs and not other.inputs:
        # Nothing drives them: the same motion is one that begins alike, by the size of the whole of it.
        first, second = ({n: v[:1] for n, v in record.outputs.items()} for record in (one, other))
        return _are_near(first, second, one.outputs)
    rows = min(one.rows, other.rows)
    sides = ((one.inputs, other.inputs), (one.outputs, other.outputs))
    cut = [[{n: v[:rows] for n, v in signals.items()} for signals in pair] for pair in sides]
    return any(_are_near(mine, others, mine) for mine, others in cut)


def _are_near(one: Signals, other: Signals, sizes: Signals) -> bool:
    """Whether every signal differs from that of the other record by a small share of its size (rms)."""
    for name, values in one.items():
        if name not in other:
            return False
        difference, size = (np.sqrt(np.nanmean(v**2)) for v in (values - other[name], sizes[name]))
        if not difference <= REPEATED_INPUT * size:
            return False
    return True


Records = Experiment | Sequence[Experiment]


# Share of healthy comparisons that are called changed, over everything that is looked at.
CHANGE_TEST_FALSE_ALARM_RATE = 0.01
# Share of this rate that goes to the tests of the residual (has it grown, is it no longer white); the rest goes to the constants.
CHANGE_TEST_RESIDUAL_SHARE = 0.2


def detect_changes(
    reference: Fit,
    records: Records,
    *,
    validation: Records = (),
    skip: int = 0,
    search_effects: bool = True,
    effects: Sequence[Effect] | None = None,
    on_message: Callable[[str], None] | None = None,
    on_refit: Callable[[int], None] | None = None,
    executor: Executor | None = None,
    workers: int = 0,
) -> ChangeDetection:
    """Find what has changed in a machine since it was fitted.

    Fits the same model to the new records and compares the constants of both fits, each with its covariance; the rate of false alarms is
    that of the policy over everything that is looked at. Where the new residual is larger or less white than that of the fit, constants
    alone do not explain the records: then `greybox.discover` looks for the effect that has appeared.

    Parameters
    ----------
    reference
        The fit of the machine as it was.
    records
        What it does today.
    validation
        Further records of today that an effect must explain as well. Without them the last of several records is taken, or the second half
        of a single one.
    skip
        Rows at the start of each validation record that the errors leave out.
    search_effects
        Whether to look for an effect where the residual asks for one.
    effects
        The only candidates, instead of the catalogue.
    on_message, on_refit
        Called with a line about each step, and with the number of finished refits of the search.
    executor, workers
        As `greybox.discover` takes them.

    Returns
    -------
    ChangeDetection
        The verdict, the change of each constant, and the effects that have appeared.

    Raises
    ------
    DataError
        Without a record, for records that do not go with the model, and for a fit that did not succeed.

    Examples
    --------
    >>> changes = gb.detect_changes(fit, today)  # doctest: +SKIP
    >>> changes.verdict, changes.moved  # doctest: +SKIP
    ('changed', ('K',))
    """
    began = time.perf_counter()
    listed, judges = (name_records(as_experiments(group, reference.model)) for group in (records, validation))
    check_reference(reference)
    if not listed:
        raise DataError("no record of today: give at least one")
    # Records that the fit was made of cannot have changed.
    findings: tuple[Finding, ...] = tuple(
        Finding(ChangeCode.SAME_RECORD, Severity.WARNING, shared.second.source or shared.second.name)
        for shared in find_shared_readings((*listed, *judges), [trace.experiment for trace in reference.traces])
    )
    today = refit(reference, listed)
    if not today.success:
        values = {"status": today.solver.status_message}
        failed = (Finding(ChangeCode.FIT_FAILED, Severity.WARNING, values=values),)
        seconds = time.perf_counter() - began
        return ChangeDetection(ChangeVerdict.CANNOT_TELL, reference, today, {}, failed, findings, seconds=seconds)
    residuals = read_residual(reference), read_residual(today)
    if not residuals[0].adequate:
        findings = (*findings, Finding(ChangeCode.MODEL_LACKS_SOMETHING, Severity.WARNING))
    level = CHANGE_TEST_FALSE_ALARM_RATE
    # The rate of false alarms is shared between the residual, where it can be tested, and the constants.
    of_residual = check_residual(*residuals, CHANGE_TEST_RESIDUAL_SHARE * level)
    judged = residuals
    if not all(of_residual):
        # A machine that wanders from record to record leaves that in the residual of constants that are common to all: what counts is
        # what each record leaves by itself.
        by_record = _fit_own_constants(reference, today, listed)
        if by_record:
            judged = read_residual(by_record[0]), read_residual(by_record[1])
            of_residual = check_residual(*judged, CHANGE_TEST_RESIDUAL_SHARE * level)
    level_of_constants = (1 - CHANGE_TEST_RESIDUAL_SHARE) * level if of_residual else level
    discovery = None
    if search_effects and not all(of_residual):
        learnt, judged_by = _choose_validation(listed, judges)
        options = FitOptions.from_data(reference.provenance.options)
        if len(listed) == 1 and not judges:
            options = replace(options, at_rest=False)  # the second half begins in motion
            findings = (*findings, Finding(ChangeCode.SPLIT_FOR_VALIDATION, subject=listed[0].name))
        # What the fit left is the noise of today, where that is noise.
        misfit = {name: reference.misfit[name].rmse for name in residuals[0].outputs if residuals[0].adequate}
        discovery = discover(
            reference.model,
            learnt,
            validation=judged_by,
            skip=skip,
            noise={name: rmse for name, rmse in misfit.items() if rmse > 0},
            effects=effects,
            options=options,
            on_message=on_message,
            on_refit=on_refit,
            executor=executor,
            workers=workers,
        )
        # The constants of today are those beside the effect that has appeared.
        if list_appeared_effects(discovery):
            today = discovery.best
            residuals = residuals[0], read_residual(today)
    before, after = read_constants(reference, residuals[0]), read_constants(today, residuals[1])
    scatter: MeasuredScatter | None = None
    shares: dict[str, float] = {}
    if after.names == before.names:
        adequate, compared = residuals[0].adequate, (reference, today)
        repeats = Repeats()
        if not adequate:
            # Of a model that lacks something only records of the same motion say the same of its constants.
            repeats = match_repeats([trace.experiment for trace in reference.traces], listed)
            compared = _fit_repeats(reference, today, repeats)
            before, after = map(read_constants, compared)
        if after.names == before.names:
            shares = _share_beyond_missing_part(compared, before, after)
            scatter = measure_scatter(*compared, before, after, repeats.pairs, adequate=adequate)
        if scatter is not None:
            # From here on the constants are as uncertain as they scatter.
            before, after = scatter.before, scatter.after
            known_ones = before.index(list_comparable(before, after))
            if known_ones:
                largest = max(known_ones, key=lambda k: scatter.factors[k])
                factor = float(scatter.factors[largest])
                allowed = {"factor": factor, "degrees": scatter.degrees, "over": scatter.yardstick}
                note = Finding(ChangeCode.SCATTER_ALLOWED, Severity.NOTE, before.names[largest], allowed)
                findings = (*findings, note)
    comparable = residuals[0].adequate or (scatter is not None and scatter.yardstick.is_trusted)
    constants, test = compare_fits(before, after, level_of_constants, scatter.degrees if scatter else math.inf)
    checks = of_residual
    if test:
        checks = (Check.at_least(ChangeRule.CONSTANTS_AS_BEFORE, test.p_value, level_of_constants), *checks)
    verdict = decide_change(constants, checks)
    conclusion = _conclude(verdict, constants, test, checks, discovery, judged)
    if verdict is ChangeVerdict.CHANGED and not comparable:
        # Pieces of a record say nothing of another motion: a change counts that is more than what the model lacks could ever do.
        wanted = [name for name, c in constants.items() if c.moved]
        moved = [name for name in wanted if shares.get(name, 0.0) > 1]
        constants = {name: replace(c, moved=name in moved) for name, c in constants.items()}
        if moved:
            conclusion = _conclude(verdict, constants, test, checks, discovery, judged)
            least = min(moved, key=lambda name: shares[name])
            reason = Finding(ChangeCode.BEYOND_MISSING_PART, Severity.NOTE, least, {"ratio": shares[least]})
            findings = (*findings, reason)
        else:
            differing = {"constants": wanted, "p": test.p_value if test else None}
            conclusion = (Finding(ChangeCode.DIFFERENT_INPUT, Severity.WARNING, values=differing),)
            verdict = ChangeVerdict.CANNOT_TELL
    return ChangeDetection(
        verdict,
        reference,
        today,
        constants,
        conclusion,
        (*findings, *_find_unseen(constants, after, verdict)),
        checks,
        discovery,
        p_value=test.p_value if test else None,
        seconds=time.perf_counter() - began,
    )


# What a model lacks may hide more of itself in a constant than it leaves: so many times the residual at records of one level, ...
HIDDEN_PART = 1.25


def _share_beyond_missing_part(
    fits: tuple[Fit, Fit], before: FittedConstants, after: FittedConstants
) -> dict[str, float]:
    """The change of each constant over the most that what the model lacks could do to it from the one motion to the other."""
    level = _compare_levels(*([trace.experiment for trace in f.traces] for f in fits))
    # ... and between two levels as a cubic spring under a sine does, whose fundamental 3/4 K A^3 acts as a spring and whose third harmonic
    # 1/4 K A^3 stays: 3 |A^2 - B^2| / (A^2 + B^2) of both residuals together.
    hidden = max(HIDDEN_PART, 3 * (level**2 - 1) / (level**2 + 1))
    reach = hidden * (reach_of_missing_part(fits[0], before) + reach_of_missing_part(fits[1], after))
    change = np.where(before.positive == after.positive, np.abs(after.scaled - before.scaled), 0.0)
    return dict(zip(before.names, (change / np.maximum(reach, TINY)).tolist(), strict=True))


def _compare_levels(before: Sequence[Experiment], after: Sequence[Experiment]) -> float:
    """How many times larger an input (an output, where there is none) is in the records of one side than in those of the other."""

    def measure(records: Sequence[Experiment]) -> dict[str, float]:
        signals = [r.inputs or r.outputs for r in records]
        return {n: float(np.nanstd(np.concatenate([s[n] for s in signals if n in s]))) for n in signals[0]}

    one, other = measure(before), measure(after)
    ratios = [max(one[n], other[n], TINY) / max(min(one[n], other[n]), TINY) for n in one if n in other]
    # An input that is held at one value moves nothing: the offsets of the records are what it has.
    return max((r for r in ratios if r < 1 / TINY), default=1.0)


def _fit_repeats(reference: Fit, today: Fit, repeats: Repeats) -> tuple[Fit, Fit]:
    """Both fits of the rows that the records of a motion have in common: of a model that lacks something the rest tells something else.

    As they are where they are of these rows already, or where today's records repeat none.
    """
    if not repeats.pairs:
        return reference, today
    fits = []
    for whole, side in ((reference, repeats.before), (today, repeats.after)):
        known = [trace.experiment.rows for trace in whole.traces]
        again = refit(whole, side) if [record.rows for record in side] != known else whole
        fits.append(again if again.success else whole)
    return fits[0], fits[1]


def check_reference(reference: Fit) -> None:
    """Refuse a fit that says nothing of its constants. Raises DataError."""
    title = f"the fit of {reference.model.title}"
    if not reference.success:
        raise DataError(f"{title} did not succeed ({reference.solver.status_message}); fit again before comparing")
    if not reference.uncertainty.free:
        raise DataError(f"{title} has no constant that was estimated; there is nothing to compare")


def _fit_own_constants(reference: Fit, today: Fit, records: Sequence[Experiment]) -> tuple[Fit, Fit] | None:
    """Both fits with constants of its own for each record; None of one record each, and where such a fit fails."""
    sides = ([trace.experiment for trace in reference.traces], records)
    if max(map(len, sides)) == 1:
        return None
    names = [name for name in reference.uncertainty.free if name not in reference.model.noise_parameters]
    one, other = (
        refit(reference, of, per_experiment=names) if len(of) > 1 else common
        for of, common in zip(sides, (reference, today), strict=True)
    )
    return (one, other) if one.success and other.success else None


def refit(reference: Fit, records: Sequence[Experiment], per_experiment: Sequence[str] = ()) -> Fit:
    """The model of ``reference`` fitted to other records: same options, priors and noise, begun at its constants.

    ``per_experiment``: constants of which each record has its own.
    """
    noise = restore_noise(reference)
    periods = [float(np.median(np.diff(trace.time))) for trace in reference.traces if len(trace.time) > 1]
    if not all(np.allclose(np.median(record.intervals), period) for record in records for period in periods):
        # The colour of noise is stated sample by sample: at another sampling time it would be another one.
        noise = replace(noise, colour=tuple(AutoRegression() for _ in noise.colour))
    options = FitOptions.from_data(reference.provenance.options)
    return fit(reference.model, records, noise=noise, options=options, per_experiment=per_experiment)


# Probability with which a change of the size that counts as seen is seen.
SENSITIVITY_POWER = 0.95


def compare_fits(
    before: FittedConstants, after: FittedConstants, level: float, scatter_degrees: float = math.inf
) -> tuple[dict[str, ConstantChange], DifferenceTest | None]:
    """The change of every constant of ``before``, and the test behind it; None where no constant can be compared.

    ``scatter_degrees``: as `compare_constants` takes them.
    """
    names = list_comparable(before, after)
    test = compare_constants(before, after, names, level, SENSITIVITY_POWER, scatter_degrees) if names else None
    changes = {}
    for name in before.names:
        i = before.names.index(name)
        value, unit = float(before.values[i]), before.units[i]
        today = float(after.values[after.names.index(name)]) if name in after.names else value
        if test is None or name not in names:
            changes[name] = ConstantChange(value, today, unit, None, None, False, None)
            continue
        k = names.index(name)
        reach, seen, difference = float(test.half_widths[k]), float(test.visible[k]), float(test.difference[k])
        if before.positive[i] and today > 0:
            # p exp(d) - p: back from the logarithm, at most as large as a double holds.
            interval = tuple(value * math.expm1(min(difference + sign * reach, 700.0)) for sign in (-1, 1))
            smallest = value * math.expm1(min(seen, 700.0))
        else:
            interval, smallest = (difference - reach, difference + reach), seen
        p = float(test.p[k])
        moved = p < level
        changes[name] = ConstantChange(value, today, unit, (interval[0], interval[1]), p, moved, smallest)
    return changes, test


def decide_change(constants: Mapping[str, ConstantChange], checks: Sequence[Check]) -> ChangeVerdict:
    """The verdict: changed where a test says so, unchanged where a change of any constant would have been seen."""
    if not all(checks):
        return ChangeVerdict.CHANGED
    hidden = [name for name, change in constants.items() if not is_seen(change)]
    return ChangeVerdict.CANNOT_TELL if hidden or not constants else ChangeVerdict.UNCHANGED


# Share of its value by which a constant may have changed unnoticed; beyond it the records cannot tell, as an interval that wide
# determines nothing.
LARGEST_HIDDEN_CHANGE = 0.5


def is_seen(change: ConstantChange) -> bool:
    """Whether a change of this constant by the share of the policy would have been seen."""
    largest = LARGEST_HIDDEN_CHANGE * abs(change.before)
    return change.smallest is not None and (change.smallest <= largest or change.before == 0)


def _choose_validation(
    records: tuple[Experiment, ...], validation: tuple[Experiment, ...]
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Records to learn an effect from, and records that it must explain as well; those given, the last one, or the second half."""
    if validation:
        return records, validation
    if len(records) > 1:
        return records[:-1], records[-1:]
    (record,) = records
    half = record.rows // 2
    return (record.window(0, half),), (record.window(half, record.rows),)


def _find_unseen(
    constants: Mapping[str, ConstantChange], after: FittedConstants, verdict: ChangeVerdict
) -> list[Finding]:
    """Constants of which today's records say too little."""
    findings = []
    severity = Severity.WARNING if verdict is ChangeVerdict.CANNOT_TELL else Severity.NOTE
    for name, change in constants.items():
        if name in after.at_bound:
            findings.append(Finding(ChangeCode.CONSTANT_AT_BOUND, Severity.WARNING, name, {"value": change.after}))
        elif not change.moved and not is_seen(change):
            # The smallest change that would be seen, over the constant: what a reader weighs.
            share = None if change.smallest is None or not change.before else change.smallest / abs(change.before)
            values = {"share": share, "limit": LARGEST_HIDDEN_CHANGE}
            findings.append(Finding(ChangeCode.CONSTANT_NOT_SEEN, severity, name, values))
    return findings


# Share of the largest entry of a combination from which a constant is named in it.
NAMED_WEIGHT = 0.1


def _conclude(
    verdict: ChangeVerdict,
    constants: Mapping[str, ConstantChange],
    test: DifferenceTest | None,
    checks: Sequence[Check],
    discovery: Discovery | None,
    residuals: tuple[FittedResidual, FittedResidual],
) -> tuple[Finding, ...]:
    """The answer in findings, the plain fact first."""
    failed = {check.rule for check in checks if not check}
    conclusion = []
    appeared = list_appeared_effects(discovery)
    for effect in appeared:
        values = {"site": effect["site"], "grade": str(effect["grade"]), "parameters": effect["parameters"]}
        conclusion.append(Finding(ChangeCode.EFFECT_APPEARED, Severity.WARNING, effect["name"], values))
    for name, change in constants.items():
        if change.moved and change.interval:
            values = {"before": change.before, "after": change.after, "unit": change.unit}
            values |= dict(zip(("low", "high"), change.interval, strict=True))
            conclusion.append(Finding(ChangeCode.CONSTANT_MOVED, Severity.WARNING, name, values))
    if ChangeRule.CONSTANTS_AS_BEFORE in failed and test and not any(c.moved for c in constants.values()):
        # No constant by itself stands out: the combination that does is named by its larger entries.
        weights = zip(test.names, test.direction.tolist(), strict=True)
        values = {"combination": {n: w for n, w in weights if abs(w) > NAMED_WEIGHT}, "p": test.p_value}
        conclusion.append(Finding(ChangeCode.COMBINATION_MOVED, Severity.WARNING, values=values))
    # An effect that has appeared explains the residual; without one the residual is described as it is.
    if failed - {ChangeRule.CONSTANTS_AS_BEFORE} and not appeared:
        for name in dict.fromkeys(c.subject for c in checks if not c and c.subject):
            rules = {c.rule for c in checks if not c and c.subject == name}
            before, after = (r.colour.variance[r.outputs.index(name)] for r in residuals)
            # In the unit of the output: of standard deviations, not variances.
            ratio = math.sqrt(after / before) if before > 0 else math.inf
            # As white as before: the sensor's noise has grown.
            code = ChangeCode.UNEXPLAINED if ChangeRule.RESIDUAL_AS_WHITE in rules else ChangeCode.NOISE_GREW
            conclusion.append(Finding(code, Severity.WARNING, name, {"ratio": ratio}))
    if conclusion:
        return tuple(conclusion)
    hidden = [name for name, change in constants.items() if not is_seen(change)]
    if verdict is ChangeVerdict.CANNOT_TELL:
        return (Finding(ChangeCode.CANNOT_TELL, Severity.WARNING, values={"constants": hidden}),)
    # Nothing has changed: what could have, unseen, is said of the constant that is least certain.
    widest = max(constants, key=lambda name: (constants[name].smallest or 0.0) / abs(constants[name].before or 1.0))
    values = {"constants": list(constants), "widest": widest, "rate": CHANGE_TEST_FALSE_ALARM_RATE}
    change = constants[widest]
    values |= {"smallest": change.smallest, "before": change.before, "unit": change.unit}
    return (Finding(ChangeCode.NOTHING_CHANGED, values=values),)
