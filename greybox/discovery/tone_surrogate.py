"""A disturbance that is a tone in time, whatever the motion (the mains, a fan, a neighbour's pump): a generator at its place.

``z1' = 2 pi f z2``, ``z2' = -2 pi f z1``: a sinusoid whose amplitude and phase are the initial state, which every record has for
itself. The frequency is one constant of all. (B. A. Francis, W. M. Wonham 1976, The internal model principle of control theory.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.discovery import decision
from greybox.discovery.dependence import Dependence
from greybox.discovery.disturbance_sites import INPUT, SENSOR, DisturbanceSite, list_disturbance_sites
from greybox.discovery.effect_test import estimated_initial_states
from greybox.discovery.holdout_error import HoldoutError, compare_holdout_errors
from greybox.discovery.localisation import ResidualLocalisation, ResidualSignal, estimate_site_signals
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.discovery.surrogate import TONE, Surrogate, SurrogateTone
from greybox.estimation import fit as fitted
from greybox.estimation import validate
from greybox.estimation.policy import DEFAULT_POLICY
from greybox.experiment import Experiment
from greybox.model import Balance, Effect
from greybox.model.signals import Expression, NamedValues, Parameter, State
from greybox.result import Fit

# Periods of the beginning of a validation record from which amplitude and phase are read there; points of a period that is drawn.
PERIODS, POINTS = 5, 24


def fit_tone_surrogate(
    bench: DiscoveryProblem,
    trial: CandidateFit,
    found: ResidualLocalisation,
    judges: Sequence[Experiment],
    base: Fit,
    skip: int = 0,
) -> Surrogate | None:
    """The tone for what ``trial`` leaves over; None where that is no tone, or the model with it does no better.

    ``base``: the plain model judged on the same records, which the gap is counted from. One frequency looks alike at every place once
    it is steady, so the model is fitted with the tone at each; where several explain the records, balances come before sensors. On the
    judging records amplitude and phase are estimated from the first few periods, since no two records begin at the same phase.
    """
    if not found.dependences or found.dependences[0].tone is None:
        return None
    there = estimate_site_signals(trial)
    measured = {name for e in trial.problem.experiments for name in e.outputs}
    ways = [p for p in list_disturbance_sites(trial.model, sorted(measured)) if str(p) in there]
    fits = [_fitted(bench, trial, p, there[str(p)], found.dependences[0].tone) for p in ways]
    least = min((f.solver.cost for f in fits), default=np.inf)
    if not least < trial.cost:  # nor where it is not a number
        return None
    alike = [(p, f) for p, f in zip(ways, fits, strict=True) if f.solver.cost - least < decision.TIE]
    place, result = alike[0]
    rows, seconds = _beginning(judges, result.parameters[_own(result)[0]].value, skip)
    seen = validate(result.model, judges, noise=result.noise.std, skip=skip, initial_rows=rows, options=bench.options)
    result = replace(result, validation=seen)
    others = tuple(str(p) for p, _ in alike[1:])
    return _drawn(
        place, there[str(place)], found.dependences[0], result, compare_holdout_errors(base, result), seconds, others
    )


def _fitted(
    bench: DiscoveryProblem, trial: CandidateFit, place: DisturbanceSite, signal: ResidualSignal, frequency: float
) -> Fit:
    """The model of ``trial`` with a tone at ``place``, fitted to the records."""
    record = next(e for e in trial.problem.experiments if e.name == signal.record)
    model = trial.model + make_tone_effect(place, signal, float(record.time[0]), frequency)
    # The fitted constants have bent themselves to the tone, so the ones that the user came with are a start as well.
    origins: tuple[dict[str, float], ...] = ({}, {q.name: q.value for q in bench.plain.free_parameters})
    tried = [
        fitted(
            model.start(**values), bench.experiments, noise=trial.problem.noise, initial=estimated_initial_states(trial),
            options=replace(bench.options, progressive=False),
        )
        for values in origins
    ]  # fmt: skip
    return min((f for f in tried if np.isfinite(f.solver.cost)), key=lambda f: f.solver.cost, default=tried[0])


def _own(fit: Fit) -> tuple[str, str, str]:
    """How the frequency and the two states of the tone are called in the model."""
    bound = next(b for b in fit.model.bound_effects if b.effect.name == TONE)
    first, second = (s.name for s in bound.states)
    return bound.model_names["frequency"], first, second


def _drawn(
    place: DisturbanceSite,
    signal: ResidualSignal,
    region: Dependence,
    fit: Fit,
    gap: Mapping[str, HoldoutError],
    seconds: float,
    others: tuple[str, ...],
) -> Surrogate:
    """The stand-in with the tone along the stretch of ``signal``."""
    frequency, *states = _own(fit)
    estimate = fit.parameters[frequency]
    trace = next(t for t in fit.traces if t.name == signal.record)
    points = max(int(POINTS * np.ptp(signal.time) * estimate.value), POINTS)
    time = np.linspace(signal.time[0], signal.time[-1], points)
    turned = 2 * np.pi * estimate.value * (time - trace.time[0])
    cosine, sine = (trace.initial_state[n] for n in states)
    amplitude = {t.name: math.hypot(*(t.initial_state[n] for n in states)) for t in fit.traces}
    return Surrogate(
        str(place), place.unit, fit, gap, time, cosine * np.cos(turned) + sine * np.sin(turned), signal, region, "a tone",
        SurrogateTone(estimate.value, estimate.std, amplitude, seconds, others),
    )  # fmt: skip


def make_tone_effect(place: DisturbanceSite, signal: ResidualSignal, begins: float, frequency: float) -> Effect:
    """The generator of a tone of about ``frequency`` Hz as an effect at ``place``; at rest it begins as the ``signal`` shows it.

    ``begins``: time of the first row of the signal's record.
    """
    frequency, (cosine, sine) = _closest(signal.time - begins, signal.value, frequency)
    unit = place.unit.strip() if place.unit.strip() not in ("", "-") else "1"
    rate_unit = f"{unit}/s" if unit.isalnum() else f"({unit})/s"
    states = [
        State("z1", place.unit, cosine, free_start=True, description="the tone"),
        State("z2", place.unit, sine, free_start=True, description="the tone a quarter of a period later"),
    ]

    def turning(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        rate = 2 * ca.pi * p.frequency
        return [
            Balance("tone", rate_unit, 1, "z1", turning=rate * x.z2),
            Balance("quarter", rate_unit, 1, "z2", turning=-rate * x.z1),
        ]

    def heard(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return x.z1

    def changed(value: Expression, x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return value + x.z1

    return Effect(
        TONE, place.name,
        [
            Parameter(
                "frequency", "Hz", frequency, (0.5 * frequency, 2 * frequency), source="spectral line of what the model leaves over",
                description="frequency of the tone",
            )
        ],
        states=states, balances=turning,
        terms=None if place.kind in (INPUT, SENSOR) else heard,
        on_input=changed if place.kind == INPUT else None, on_output=changed if place.kind == SENSOR else None,
        equation="z1, z1' = 2 pi f z2, z2' = -2 pi f z1", parity="slow", source="fitted to what the model leaves over; no law of its own",
    )  # fmt: skip


def _closest(time: np.ndarray, w: np.ndarray, about: float) -> tuple[float, tuple[float, float]]:
    """Frequency near ``about`` of the sinusoid closest to ``w`` (K,), and its cosine and sine parts at time zero."""
    from scipy.optimize import minimize_scalar

    def parts(frequency: float) -> tuple[np.ndarray, float]:
        turned = 2 * np.pi * frequency * time
        basis = np.stack([np.cos(turned), np.sin(turned), np.ones_like(time)], axis=1)
        found = np.linalg.lstsq(basis, w, rcond=None)[0]
        return found, float(np.sum((w - basis @ found) ** 2))

    reach = 1 / np.ptp(time)
    best = minimize_scalar(
        lambda f: parts(f)[1],
        bounds=(max(about - reach, 0.5 * about), about + reach),
        method="bounded",
        options={"xatol": 1e-4 * reach},
    )
    cosine, sine, _ = parts(float(best.x))[0]
    return float(best.x), (float(cosine), float(sine))


def _beginning(judges: Sequence[Experiment], frequency: float, skip: int) -> tuple[int, float]:
    """Rows of a judging record from which the tone's amplitude and phase are estimated, and their seconds."""
    period = max(float(np.median(np.diff(e.time))) for e in judges)
    half = min(e.rows for e in judges) // 2
    rows = skip or min(max(math.ceil(PERIODS / (frequency * period)), DEFAULT_POLICY.initial_state.first_rows), half)
    return rows, rows * period
