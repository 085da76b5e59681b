"""Contact: forces that begin or repeat at certain positions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from greybox.effects.parameters import amplitude_parameter, shape_parameter
from greybox.effects.policy import START
from greybox.effects.scales import Scales
from greybox.model import Effect
from greybox.model.signals import Expression, NamedValues

STOP_SOURCE = "R. Isermann, Mechatronic Systems, Springer 2005: stop of finite stiffness"
STOP_TEXT = (
    "Drive slowly into the suspected position from both sides: a stop is not felt before it, a hardening spring bends everywhere;"
    " a clipped input and choked flow limit the speed wherever the body is."
)


def _stop_on_both_sides(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.kc * (x.displacement - ca.fmin(ca.fmax(x.displacement, -p.gap), p.gap))


def _stop_on_one_side(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.kc * p.side * ca.fmax(p.side * (x.displacement - p.gap), 0)


def _stop_probe(s: Scales) -> Mapping[str, float]:
    return {"kc": s.visible_force / (START.stop_depth * s.displacement)}


def _stiffest(s: Scales) -> tuple[float, float]:
    """Stiffer than the samples follow, a stop is a wall: no record shows more."""
    return 0.0, s.storage * (math.pi / s.period) ** 2


def _travel(s: Scales) -> float:
    return (s.highest - s.lowest) or s.displacement


def _both_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"gap": [share * s.displacement for share in START.stop_edges]}


def _both_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    return {"kc": _stiffest(s), "gap": (START.nearest_stop * s.displacement, s.displacement)}


def _one_grid(s: Scales) -> Mapping[str, list[float]]:
    into = [(1 - share) * _travel(s) / 2 for share in START.stop_edges]
    return {"gap": [*(s.highest - depth for depth in into), *(s.lowest + depth for depth in into)], "side": [1.0, -1.0]}


def _one_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    reach = START.nearest_stop * _travel(s)
    return {"kc": _stiffest(s), "gap": (s.lowest - reach, s.highest + reach)}


def _one_from_spring(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    """Stops that push back as much at the end of the travel as the fitted spring does, on either side."""
    force = abs(values["K2"]) * s.displacement**2 if "K2" in values else abs(values["K3"]) * s.displacement**3
    into = [(1 - share) * _travel(s) / 2 for share in START.stop_edges]
    above = [{"gap": s.highest - depth, "kc": force / depth, "side": 1.0} for depth in into]
    below = [{"gap": s.lowest + depth, "kc": force / depth, "side": -1.0} for depth in into]
    return [*above, *below]


def _both_from_cubic(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    force = abs(values["K3"]) * s.displacement**3
    return [{"gap": share * s.displacement, "kc": force / ((1 - share) * s.displacement)} for share in START.stop_edges]


def _cogging_force(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    turn = 2 * math.pi * x.displacement / p.pitch
    return p.F * ca.sin(turn) + p.Fq * ca.cos(turn)


def _pitch_grid(s: Scales) -> Mapping[str, list[float]]:
    longest, shortest = _pitch_limits(s)["pitch"][::-1]
    seen = [share * s.pitch for share in START.seen_pitches if shortest <= share * s.pitch <= longest]
    return {"pitch": [*seen, *(_travel(s) / periods for periods in START.cogging_periods)]}


def _pitch_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    # With fewer periods over the travel it is any curve.
    return {"pitch": (_travel(s) / (2 * START.cogging_periods[-1]), _travel(s) / START.fewest_cogging_periods)}


STIFFNESS = amplitude_parameter("kc", "{force}/{displacement}", "stiffness of the stop", low=0.0)

end_stop = Effect(
    "end_stop",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("gap", "{displacement}", 0.0, (-1e9, 1e9), "position at which the stop begins"),
        # Which end it is at: no constant to be found, both are tried.
        replace(shape_parameter("side", "1", 1.0, (-1.0, 1.0), "1 for a stop above, -1 for one below"), fixed=True),
    ],
    terms=_stop_on_one_side,
    equation="-kc max(x - gap, 0), or kc max(gap - x, 0) for a stop below",
    parents=("quadratic_stiffness", "cubic_stiffness"),
    parity="even",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    amplitudes=("kc",),
    probe=_stop_probe,
    grid=_one_grid,
    limits=_one_limits,
    from_parent=_one_from_spring,
)

end_stops = Effect(
    "end_stops",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("gap", "{displacement}", 1.0, (1e-12, 1e9), "distance of both stops from zero"),
    ],
    terms=_stop_on_both_sides,
    equation="-kc (x - min(max(x, -gap), gap))",
    parents=("cubic_stiffness",),
    parity="odd",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    amplitudes=("kc",),
    probe=_stop_probe,
    grid=_both_grid,
    limits=_both_limits,
    from_parent=_both_from_cubic,
)

cogging = Effect(
    "cogging",
    site="force",
    parameters=[
        amplitude_parameter("F", "{force}", "sine part of the periodic force, either sign"),
        amplitude_parameter("Fq", "{force}", "cosine part, either sign"),
        shape_parameter("pitch", "{displacement}", 1.0, (1e-12, 1e9), "distance after which it repeats"),
    ],
    terms=_cogging_force,
    equation="F sin(2 pi x/pitch) + Fq cos(2 pi x/pitch)",
    parity="odd",
    tells_apart=(
        "Move slowly over many pitches with the drive off: the body is drawn to positions a pitch apart, whatever the direction;"
        " friction has no such positions, and a hum from outside keeps its frequency at every speed."
    ),
    source="slot harmonics of motors with permanent magnets: D. Hanselman, Brushless Permanent Magnet Motor Design, 2003",
    amplitudes=("F", "Fq"),
    probe=lambda s: {"F": s.visible_force, "Fq": s.visible_force},
    grid=_pitch_grid,
    limits=_pitch_limits,
)

CONTACT: tuple[Effect, ...] = (end_stop, end_stops, cogging)
