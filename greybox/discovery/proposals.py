"""What to do next: experiments and sensors that would decide, checks of the rig, and what could still be hidden."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from greybox.discovery.certainty import to_features
from greybox.discovery.curve_shape import ShapeKind
from greybox.discovery.discriminating_experiments import rank_discriminating_experiments
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import is_level_measured
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.policy import CertaintyPolicy, DiscoveryPolicy, ProposalPolicy
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.residual_noise import INDEPENDENT_SOURCES
from greybox.discovery.surrogate import Surrogate, SurrogateTone
from greybox.experiment import Experiment
from greybox.findings import Finding, Severity
from greybox.linear_algebra import decompose_symmetric, pseudo_inverse
from greybox.result import Fit


def propose_next_steps(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
    policy: DiscoveryPolicy,
    look_alike: str = "",
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
    """
    first = [Finding(DiscoveryCode.CONTINUE_WITH_LOOK_ALIKE, subject=look_alike)] if look_alike else []
    return (*first, *_propose(base, location, surrogate, validation, policy, bool(look_alike)))


def propose_noise_check(base: Fit) -> tuple[Finding, ...]:
    """What to check if no effect seems to be missing: an overestimated noise hides a missing effect."""
    units = {o.name: o.unit for o in base.model.outputs}
    guessed = _outputs_of_unknown_noise(base)
    if not guessed:
        return ()
    values = {"std": [base.noise.std[n] for n in guessed], "units": [units[n] for n in guessed], "outputs": guessed}
    return (Finding(DiscoveryCode.CHECK_NOISE, Severity.WARNING, ", ".join(guessed), values),)


def propose_experiments(
    problem: DiscoveryProblem, selected: CandidateFit, rivals: Sequence[CandidateFit], policy: DiscoveryPolicy
) -> tuple[Finding, ...]:
    """For each rival the experiment that would tell it from the selected model, or that there is none."""
    findings = []
    for rival in rivals:
        ranked = rank_discriminating_experiments(problem, selected, rival, policy.proposals)
        if not ranked:
            continue
        best = ranked[0]
        decides = not best.cost < policy.selection.tie_cost
        code = DiscoveryCode.DISCRIMINATING_EXPERIMENT if decides else DiscoveryCode.NO_DISCRIMINATING_EXPERIMENT
        values = {"experiment": best.experiment.value, "measured": list(best.measured), "cost": best.cost}
        findings.append(Finding(code, subject=" + ".join(best.rival), values=values))
    return tuple(findings)


def explain_doubt(evidence: EffectEvidence, policy: CertaintyPolicy) -> Finding | None:
    """What would settle an effect that is not established: None where it stands well and only what else is left speaks against it."""
    name, features = evidence.effect, to_features(evidence.measures, policy)
    if evidence.alike:
        return Finding(DiscoveryCode.SEPARATE_FROM_RIVAL, subject=name, values={"rival": evidence.alike[0]})
    if evidence.rival and features["rival_t"] < policy.least_rival:
        return Finding(DiscoveryCode.SEPARATE_FROM_RIVAL, subject=name, values={"rival": evidence.rival})
    if policy.most_change < features["change"] and math.isfinite(evidence.change):
        return Finding(DiscoveryCode.FIT_HALVES_ALONE, subject=name, values={"change": evidence.change})
    return None


def list_detection_limits(candidates: Sequence[CandidateFit], policy: ProposalPolicy) -> tuple[Finding, ...]:
    """For each effect that was tried on a complete model, the smallest amplitude that these records would have shown."""
    limits = (_detection_limit(candidate, policy) for candidate in candidates)
    return tuple(limit for limit in limits if limit is not None)


def _detection_limit(candidate: CandidateFit, policy: ProposalPolicy) -> Finding | None:
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
        "limit": policy.detection_ratio * std,
        "unit": candidate.model.parameter(name).unit,
    }
    return Finding(DiscoveryCode.DETECTION_LIMIT, subject=bound.effect.name, values=values)


def _outputs_of_unknown_noise(base: Fit) -> list[str]:
    """Outputs whose noise was estimated from the records that were fitted."""
    return [name for name in base.misfit if base.noise.sources.get(name) not in INDEPENDENT_SOURCES]


def _propose(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
    policy: DiscoveryPolicy,
    has_look_alike: bool,
) -> Iterator[Finding]:
    suffices = surrogate is not None and surrogate.explained_fraction >= policy.selection.holdout_share
    guessed = [name for name in base.misfit if not is_level_measured(base.noise, name)]
    if guessed and not suffices:
        yield Finding(DiscoveryCode.STATE_NOISE, Severity.WARNING, ", ".join(guessed), {"outputs": guessed})
    if not location.is_missing:
        yield Finding(DiscoveryCode.EXTEND_ESTIMATION_RECORDS)
    beyond = None if suffices else _range_beyond_estimation(base, location, surrogate, validation, policy.proposals)
    if beyond is not None:
        yield beyond
    if surrogate is not None and surrogate.tone is not None:
        yield from _about_tone(surrogate.tone, policy.proposals)
    elif surrogate is not None:
        yield from _about_curve(surrogate, suffices)
    elif location.is_missing and not (beyond or has_look_alike):
        yield Finding(DiscoveryCode.SUSPECT_MEMORY)
    unmeasured = [o.name for o in base.model.outputs if o.name not in base.misfit]
    if unmeasured and (len(location.likeliest) > 1 or not suffices):
        yield Finding(DiscoveryCode.MEASURE_MORE, subject=", ".join(unmeasured), values={"outputs": unmeasured})


def _about_tone(tone: SurrogateTone, policy: ProposalPolicy) -> Iterator[Finding]:
    mains = [
        mains
        for mains in policy.mains_frequencies
        for k in range(1, policy.mains_multiples + 1)
        if abs(tone.frequency - k * mains) < policy.mains_tolerance * mains
    ]
    values = {"frequency": tone.frequency}
    if mains:
        yield Finding(DiscoveryCode.SUSPECT_MAINS, values={**values, "mains": mains[0]})
    else:
        yield Finding(DiscoveryCode.SUSPECT_MACHINE, values=values)
    yield Finding(DiscoveryCode.USE_TONE_MODEL, values=values)


def _about_curve(surrogate: Surrogate, suffices: bool) -> Iterator[Finding]:
    variable = surrogate.variable
    if surrogate.dependence.period is not None:
        values = {"period": surrogate.dependence.period, "unit": surrogate.variable_unit}
        yield Finding(DiscoveryCode.SUSPECT_PERIODIC_PART, subject=variable, values=values)
    elif surrogate.shape.kind in (ShapeKind.FLAT_MIDDLE, ShapeKind.BEND):
        values = {"position": surrogate.shape.position, "unit": surrogate.variable_unit}
        yield Finding(DiscoveryCode.SUSPECT_CONTACT, subject=variable, values=values)
    if suffices:
        yield Finding(DiscoveryCode.USE_CURVE_MODEL, subject=variable)
    else:
        yield Finding(DiscoveryCode.VARY_SPEED_AND_AMPLITUDE, subject=variable)


def _range_beyond_estimation(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
    policy: ProposalPolicy,
) -> Finding | None:
    """Where the validation records extend beyond the range in which the signal, or the curve, is known."""
    if surrogate is not None:
        dependence, signal = surrogate.dependence, surrogate.signal
    elif location.dependences and location.signal is not None:
        dependence, signal = location.dependences[0], location.signal
    else:
        return None
    variable = dependence.variable
    if variable not in signal.variables:
        return None
    estimated = [v for t in base.traces for v in _values(t.measured, t.inputs, variable)]
    validated = [v for e in validation for v in _values(e.outputs, e.inputs, variable)]
    if not estimated or not validated:
        return None
    low, high = float(np.nanmin(np.concatenate(estimated))), float(np.nanmax(np.concatenate(estimated)))
    least, most = float(np.nanmin(np.concatenate(validated))), float(np.nanmax(np.concatenate(validated)))
    if min(least - low, high - most) >= -policy.range_margin * (high - low):
        return None
    values = {"low": low, "high": high, "least": least, "most": most, "unit": dependence.unit}
    return Finding(DiscoveryCode.COVER_VALIDATION_RANGE, Severity.WARNING, variable, values)


def _values(outputs: Mapping[str, np.ndarray], inputs: Mapping[str, np.ndarray], name: str) -> list[np.ndarray]:
    return [signals[name] for signals in (outputs, inputs) if name in signals]
