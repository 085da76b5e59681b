"""What to do next: experiments and sensors that would decide, checks of the rig, and what could still be hidden."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from greybox.base import Finding, Severity, decompose_symmetric, pseudo_inverse
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import DETECTION_RATIO
from greybox.discovery.claims import PLAIN, Claim, split_names
from greybox.discovery.curve_shape import CurveShape, Dependence, ShapeKind
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import is_level_measured
from greybox.discovery.localisation import MisfitTiming, ResidualLocalisation
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.residual_noise import INDEPENDENT_SOURCES
from greybox.discovery.surrogate import Surrogate
from greybox.estimation.findings import FAR_NOISE_RATIO, find_range_beyond
from greybox.estimation.result import Fit
from greybox.model.effects.catalogue import AT, all_effects


def propose_next_steps(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
    policy: DiscoveryPolicy,
    look_alike: str = "",
    left: Fit | None = None,
) -> tuple[Finding, ...]:
    """What to do about something unknown, the most promising first.

    Parameters
    ----------
    base, location
        The plain model and what it leaves unexplained.
    surrogate
        What stands in for that, if anything does.
    validation
        The validation records.
    policy
        The decision numbers.
    look_alike
        The nearest effects, where they explain the larger part of the gap on the validation records.
    left
        The model that leaves what ``location`` says, where that is not the plain one.

    Returns
    -------
    tuple of Finding
        Each follows from what was seen: a noise that may hide something, a shape, a loop, a tone, a stretch of time, a missing sensor.
    """
    first = [Finding(DiscoveryCode.CONTINUE_WITH_LOOK_ALIKE, subject=look_alike)] if look_alike else []
    return (*first, *_propose(base, location, surrogate, validation, policy, bool(look_alike), left or base))


def propose_noise_check(base: Fit) -> tuple[Finding, ...]:
    """What to check if no effect seems to be missing: an overestimated noise hides a missing effect."""
    units = {o.name: o.unit for o in base.model.outputs}
    # Outputs whose noise was estimated from the records that were fitted.
    guessed = [name for name in base.misfit if base.noise.sources.get(name) not in INDEPENDENT_SOURCES]
    if not guessed:
        return ()
    values = {"std": [base.noise.std[n] for n in guessed], "units": [units[n] for n in guessed], "outputs": guessed}
    return (Finding(DiscoveryCode.CHECK_NOISE, Severity.WARNING, ", ".join(guessed), values),)


def explain_doubt(claim: Claim) -> Finding | None:
    """What would settle a name that is not established: None where only what else is left speaks against it."""
    rival = claim.equals[0] if claim.equals else _other_effect(claim)
    if not rival:
        return None
    # Of what is one equation no record shows more: only a change of the rig does.
    twin = next((e for e in all_effects() if e.name == rival.partition(AT)[0]), None)
    is_same = twin is not None and claim.name.partition(AT)[0] in twin.stands_for
    values = {"rival": rival, "advice": twin.tells_apart if twin is not None and is_same else ""}
    return Finding(DiscoveryCode.SEPARATE_FROM_RIVAL, subject=claim.name, values=values)


def _other_effect(claim: Claim) -> str:
    """The effect that the best rival of a name has and that is not this one; "" where the rival has no other."""
    return next((name for name in split_names(claim.rival) if name not in ("", PLAIN, claim.name)), "")


def list_detection_limits(candidates: Sequence[FittedCandidate]) -> tuple[Finding, ...]:
    """For each effect that was tried on a complete model, the smallest amplitude that these records would have shown."""
    limits = (_detection_limit(candidate) for candidate in candidates)
    return tuple(limit for limit in limits if limit is not None)


def _detection_limit(candidate: FittedCandidate) -> Finding | None:
    bound, variables = candidate.model.bound_effects[-1], candidate.variables
    amplitudes = [
        bound.model_names[name] for name in bound.effect.amplitudes if bound.model_names[name] in variables.names
    ]
    if not amplitudes:
        return None
    name = amplitudes[0]
    information = candidate.evaluation.hessian / 2
    covariance = pseudo_inverse(information)
    k = variables.names.index(name)
    if decompose_symmetric(information).is_open[k]:  # at zero these records show nothing of it, whatever its amplitude
        return None
    std = float(np.sqrt(covariance[k, k]) * variables.spans[k])
    values = {
        "parameter": name,
        "limit": DETECTION_RATIO * std,
        "unit": candidate.model.parameter(name).unit,
    }
    return Finding(DiscoveryCode.DETECTION_LIMIT, subject=bound.effect.name, values=values)


def _propose(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
    policy: DiscoveryPolicy,
    has_look_alike: bool,
    left: Fit,
) -> Iterator[Finding]:
    suffices = surrogate is not None and surrogate.explained_fraction >= policy.selection.holdout_share
    # Far above the ceiling something is missing whatever the noise is: then to know it better would decide nothing.
    guessed = [
        name
        for name in base.misfit
        if not is_level_measured(base.noise, name) and _over_ceiling(base, left, name) < FAR_NOISE_RATIO
    ]
    if guessed and not suffices:
        yield Finding(DiscoveryCode.STATE_NOISE, Severity.WARNING, ", ".join(guessed), {"outputs": guessed})
    if not location.is_missing:
        yield Finding(DiscoveryCode.EXTEND_ESTIMATION_RECORDS)
    beyond = (
        None if suffices else find_range_beyond([trace.experiment for trace in base.traces], validation, base.model)
    )
    if beyond is not None:
        yield beyond
    # A stand-in that explains nothing says nothing of the cause; what the localisation saw does.
    helps = surrogate is not None and surrogate.explained_fraction > 0
    if surrogate is not None and helps and surrogate.tone is not None:
        yield _about_tone(surrogate.tone.frequency)
        yield Finding(DiscoveryCode.USE_TONE_MODEL, values={"frequency": surrogate.tone.frequency})
    elif surrogate is not None and helps:
        yield from _about_curve(surrogate, location, suffices)
    elif location.is_missing and not (beyond or has_look_alike):
        yield _about_signal(location)
    unmeasured = [o.name for o in base.model.outputs if o.name not in base.misfit]
    if unmeasured and (len(location.likeliest) > 1 or not suffices):
        yield Finding(DiscoveryCode.MEASURE_MORE, subject=", ".join(unmeasured), values={"outputs": unmeasured})


def _over_ceiling(base: Fit, left: Fit, output: str) -> float:
    """Misfit that a model leaves in ``output`` over the most that its noise can have."""
    bound = base.noise.bound(output)
    ceiling = base.noise.std[output] if bound is None else bound.level
    return left.misfit[output].rmse / ceiling if ceiling > 0 else math.inf


def _about_signal(location: ResidualLocalisation) -> Finding:
    """What the missing signal looks like, and the record or the check that shows its cause."""
    dependence = next((d for d in location.dependences if d.is_relevant), None)
    if dependence is not None and dependence.tone is not None:
        return _about_tone(dependence.tone)
    if dependence is not None:
        return _about_dependence(dependence)
    timing = location.timing
    if timing is not None and timing.stretches:
        # Neither a variable nor a frequency, but a time: something happened then.
        return _look_at(timing)
    return Finding(DiscoveryCode.SUSPECT_MEMORY)


def _about_dependence(dependence: Dependence) -> Finding:
    """A part of the rig where the shape names one; else the record that shows the loop, or the curve, by itself."""
    if dependence.has_loop:
        return Finding(DiscoveryCode.TRACE_LOOP, subject=dependence.variable, values={"loop": dependence.loop})
    part = _suspect_part(dependence.variable, dependence.unit, dependence.period, dependence.shape)
    return part or Finding(DiscoveryCode.TRACE_CURVE, subject=dependence.variable, values={"share": dependence.share})


# Frequencies of the mains in Hz.
MAINS_FREQUENCIES: tuple[float, ...] = (50.0, 60.0)
# Share of the mains frequency within which a tone may be the mains or a multiple.
MAINS_TOLERANCE = 0.01
# Highest multiple that is considered.
MAINS_MULTIPLES = 5


def _about_tone(frequency: float) -> Finding:
    mains = [
        mains
        for mains in MAINS_FREQUENCIES
        for k in range(1, MAINS_MULTIPLES + 1)
        if abs(frequency - k * mains) < MAINS_TOLERANCE * mains
    ]
    if mains:
        return Finding(DiscoveryCode.SUSPECT_MAINS, values={"frequency": frequency, "mains": mains[0]})
    return Finding(DiscoveryCode.SUSPECT_MACHINE, values={"frequency": frequency})


def _about_curve(surrogate: Surrogate, location: ResidualLocalisation, suffices: bool) -> Iterator[Finding]:
    variable = surrogate.variable
    part = _suspect_part(variable, surrogate.variable_unit, surrogate.dependence.period, surrogate.shape)
    if part is not None:
        yield part
    if suffices:
        yield Finding(DiscoveryCode.USE_CURVE_MODEL, subject=variable)
    else:
        yield _about_rest(surrogate, location)


def _about_rest(surrogate: Surrogate, location: ResidualLocalisation) -> Finding:
    """What a curve leaves: a loop over its variable, another variable, a stretch of time, or none of these."""
    variable, timing = surrogate.variable, location.timing
    if surrogate.dependence.has_loop:
        return Finding(DiscoveryCode.TRACE_LOOP, subject=variable, values={"loop": surrogate.dependence.loop})
    others = [d for d in location.dependences if d.is_relevant and d.tone is None and d.variable != variable]
    if others:
        values = {"other": others[0].variable, "share": others[0].share + others[0].loop}
        return Finding(DiscoveryCode.VARY_OTHER_VARIABLE, subject=variable, values=values)
    if timing is not None and timing.stretches:
        return _look_at(timing)
    return Finding(DiscoveryCode.VARY_SPEED_AND_AMPLITUDE, subject=variable)


def _look_at(timing: MisfitTiming) -> Finding:
    """The longest of the stretches in which most of the misfit happens."""
    record, start, end = max(timing.stretches, key=lambda stretch: stretch[2] - stretch[1])
    values = {"start": start, "end": end, "share": timing.share, "time_share": timing.time_share}
    return Finding(DiscoveryCode.LOOK_AT_STRETCH, subject=record, values=values)


def _suspect_part(variable: str, unit: str, period: float | None, shape: CurveShape) -> Finding | None:
    """The part of a rig that a curve over ``variable`` points to: what repeats, or what begins somewhere."""
    if period is not None:
        values = {"period": period, "unit": unit}
        return Finding(DiscoveryCode.SUSPECT_PERIODIC_PART, subject=variable, values=values)
    if shape.kind in (ShapeKind.FLAT_MIDDLE, ShapeKind.BEND):
        values = {"position": shape.position, "unit": unit}
        return Finding(DiscoveryCode.SUSPECT_CONTACT, subject=variable, values=values)
    return None
