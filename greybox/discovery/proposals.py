"""What to do next: experiments and sensors that would decide, checks of the rig, and what could still be hidden."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base import TINY, Finding, Severity, decompose_symmetric, pseudo_inverse
from greybox.data.experiment import Experiment
from greybox.data.noise.noise_model import DETECTION_RATIO, NEW_SENSOR_NOISE
from greybox.data.signals import InputKind, chirp, multisine
from greybox.discovery.claims import PLAIN, Claim, split_names
from greybox.discovery.curve_shape import CurveShape, Dependence, ShapeKind
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import is_level_measured
from greybox.discovery.localisation import MisfitTiming, ResidualLocalisation
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem, FittedCandidate
from greybox.discovery.residual_noise import INDEPENDENT_SOURCES
from greybox.discovery.selection import TIE_COST
from greybox.discovery.surrogate import Surrogate
from greybox.estimation.findings import FAR_NOISE_RATIO
from greybox.estimation.result import Fit
from greybox.model.signals import Input
from greybox.model.sites import DRIVE, VALVE
from greybox.simulation.simulate import simulate

# Which experiment would tell rivals apart: the one where the refitted rival stays farthest behind (T-optimality).
#
# For a chosen model A and a rival B, ``T = min over B's parameters of sum ((y_A - y_B) / noise)^2`` on a simulated experiment
# (Atkinson, Fedorov 1975): the cost by which B would lose. The minimum is taken by one Gauss-Newton step from B's fitted
# parameters. Below about ten the experiment shows nothing.
#
# `greybox.experiment_design` measures by T as well, but stands above this package: it begins with a discovery, adds the information
# of earlier records and needs its gradient along the input. Here the inputs are few, the rival keeps its bounds, and a proposal costs a
# few runs.


NEW_COURSES = (
    InputKind.FULL_SWEEP,
    InputKind.SMALL_SWEEP,
    InputKind.MULTISINE,
    InputKind.STEPS,
    InputKind.SLOW_TRIANGLE,
)


@dataclass(frozen=True)
class DiscriminatingExperiment:
    """An experiment, which outputs it needs, and the cost by which the rival would lose there."""

    experiment: InputKind
    measured: tuple[str, ...]
    rival: tuple[str, ...]
    cost: float


def rank_discriminating_experiments(
    problem: DiscoveryProblem, selected: FittedCandidate, rival: FittedCandidate
) -> list[DiscriminatingExperiment]:
    """Every candidate input with the present sensors, and with one more, best first."""
    installed = tuple(problem.noise_std)
    outputs = tuple(o.name for o in problem.model.outputs)
    sensors = [installed] + [(*installed, name) for name in outputs if name not in installed]
    experiments = []
    for kind, inputs in candidate_inputs(problem.experiments[0], problem.model.inputs).items():
        run = simulate(selected.model, inputs)
        if run.overflow is not None:
            continue
        for measured in sensors:
            cost = _cost_of_rival(problem, rival, run.record(), measured)
            if np.isfinite(cost):
                experiments.append(DiscriminatingExperiment(kind, measured, rival.effects, cost))
    return sorted(experiments, key=lambda e: -e.cost)


# Samples on which experiments are compared: enough to rank them.
MOST_SAMPLES = 4000


def candidate_inputs(record: Experiment, inputs: Sequence[Input]) -> dict[InputKind, Experiment]:
    """Inputs that could be applied instead: a sweep, a multisine, steps, a slow ramp, the record's own at other amplitudes.

    Each input moves within the range that it has in the record, and each in a course of its own. What nobody sets (an input with a
    role other than that of a drive or valve, such as an ambient temperature) stays as it was, and so does a constant input.
    """
    rows = min(record.rows, MOST_SAMPLES)
    same = record.window(0, rows)
    period = float(np.median(record.intervals))
    time = np.arange(rows) * period
    set_by_user = {i.name for i in inputs if i.role in ("", DRIVE, VALVE)}
    ranges = {name: _InputRange.of(values) for name, values in record.inputs.items()}
    driven = [name for name in record.inputs if name in set_by_user and ranges[name].peak > 0]
    courses = {name: _courses(time, period, number) for number, name in enumerate(driven)}
    shares = {InputKind.SMALL_SWEEP: 1 / 5, InputKind.MULTISINE: 1 / 3}
    experiments = {}
    for kind in NEW_COURSES:
        share = shares.get(kind, 1.0)
        moved = {name: ranges[name].middle + share * ranges[name].peak * courses[name][kind] for name in driven}
        experiments[kind] = Experiment(kind, time, {**same.inputs, **moved}, {})
    for kind, factor in {
        InputKind.SAME_INPUT: 1.0,
        InputKind.SAME_INPUT_SMALL: 1 / 3,
        InputKind.SAME_INPUT_DOUBLED: 2.0,
    }.items():
        rest = {name: ranges[name].rest for name in driven}
        scaled = {name: rest[name] + factor * (same.inputs[name] - rest[name]) for name in driven}
        experiments[kind] = Experiment(kind, same.time, {**same.inputs, **scaled}, {}, same.hold)
    return experiments


@dataclass(frozen=True)
class _InputRange:
    """Where an input moves in a record: about zero if it takes both signs, else about the middle of its range.

    ``rest`` is zero, or the end of the range that is nearest to it.
    """

    middle: float
    peak: float
    rest: float

    @classmethod
    def of(cls, values: np.ndarray) -> _InputRange:
        low, high = float(values.min()), float(values.max())
        if low < 0 < high:
            return cls(0.0, max(-low, high), 0.0)
        return cls((low + high) / 2, (high - low) / 2, low if low >= 0 else high)


# Seed of the multisine's phases.
PROPOSAL_SEED = 1


def _courses(time: np.ndarray, period: float, number: int) -> dict[InputKind, np.ndarray]:
    """Courses between -1 and 1 for input ``number`` of those that are driven."""
    low, high = 2 / time[-1], 0.1 / period
    generator = np.random.default_rng(PROPOSAL_SEED + number)
    sweep = chirp(time, low, high, 1.0)
    steps, ramps = 5 + 2 * number, 2 + number
    return {
        InputKind.FULL_SWEEP: sweep if number % 2 == 0 else sweep[::-1],
        InputKind.SMALL_SWEEP: sweep if number % 2 == 0 else sweep[::-1],
        InputKind.MULTISINE: multisine(time, low, high, 1.0, generator),
        InputKind.STEPS: np.sign(np.sin(2 * np.pi * steps / time[-1] * time)),
        InputKind.SLOW_TRIANGLE: (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * ramps / time[-1] * time)),
    }


def _cost_of_rival(
    problem: DiscoveryProblem,
    rival: FittedCandidate,
    record: Experiment,
    measured: tuple[str, ...],
) -> float:
    """Cost of the rival on a record of the selected model, after its parameters have adapted."""
    outputs = {n: record.outputs[n] for n in measured}
    estimation = problem.prepare(
        rival.model, (Experiment(record.name, record.time, record.inputs, outputs, record.hold),)
    )
    std = estimation.noise.std.copy()
    for j, output in enumerate(rival.model.outputs):
        is_new = output.name in measured and output.name not in problem.noise_std
        if is_new:  # how good that sensor would be is not known
            std[j] = NEW_SENSOR_NOISE * max(float(np.abs(record.outputs[output.name]).max()), TINY)
    estimation = replace(estimation, noise=replace(estimation.noise, std=std))
    e = estimation.shooting(estimation.variables).evaluate(estimation.variables.here)
    if not (np.isfinite(e.cost) and e.is_finite):
        return np.inf
    return e.cost - e.predicted_decrease(*estimation.variables.bounds())


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


def propose_experiments(
    problem: DiscoveryProblem, selected: FittedCandidate, rivals: Sequence[FittedCandidate]
) -> tuple[Finding, ...]:
    """For each rival the experiment that would tell it from the selected model, or that there is none."""
    findings = []
    for rival in rivals:
        ranked = rank_discriminating_experiments(problem, selected, rival)
        if not ranked:
            continue
        best = ranked[0]
        decides = not best.cost < TIE_COST
        code = DiscoveryCode.DISCRIMINATING_EXPERIMENT if decides else DiscoveryCode.NO_DISCRIMINATING_EXPERIMENT
        values = {"experiment": best.experiment.value, "measured": list(best.measured), "cost": best.cost}
        findings.append(Finding(code, subject=" + ".join(best.rival), values=values))
    return tuple(findings)


def explain_doubt(claim: Claim) -> Finding | None:
    """What would settle a name that is not established: None where only what else is left speaks against it."""
    rival = claim.equals[0] if claim.equals else _other_effect(claim)
    if not rival:
        return None
    return Finding(DiscoveryCode.SEPARATE_FROM_RIVAL, subject=claim.name, values={"rival": rival})


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
    beyond = None if suffices else _range_beyond_estimation(base, location, surrogate, validation)
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


# Share of the range of a variable by which validation records must extend beyond the estimation records to be reported.
RANGE_MARGIN = 0.1


def _range_beyond_estimation(
    base: Fit,
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    validation: Sequence[Experiment],
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
    if min(least - low, high - most) >= -RANGE_MARGIN * (high - low):
        return None
    values = {"low": low, "high": high, "least": least, "most": most, "unit": dependence.unit}
    return Finding(DiscoveryCode.COVER_VALIDATION_RANGE, Severity.WARNING, variable, values)


def _values(outputs: Mapping[str, np.ndarray], inputs: Mapping[str, np.ndarray], name: str) -> list[np.ndarray]:
    return [signals[name] for signals in (outputs, inputs) if name in signals]
