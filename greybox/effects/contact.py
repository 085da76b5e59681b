"""Contact: forces that begin or repeat at certain positions."""

from __future__ import annotations

import math
from collections.abc import Mapping

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


def _stop_above(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.kc * ca.fmax(x.displacement - p.edge, 0)


def _stop_below(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return p.kc * ca.fmax(p.edge - x.displacement, 0)


def _stop_probe(s: Scales) -> Mapping[str, float]:
    return {"kc": s.visible_force / (START.stop_depth * s.displacement)}


def _stiffest(s: Scales) -> tuple[float, float]:
    """Stiffer than the samples follow, a stop is a wall: no record shows more."""
    return 0.0, s.storage * (math.pi / s.period) ** 2


def _gap_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"gap": [share * s.displacement for share in START.stop_edges]}


def _gap_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    return {"kc": _stiffest(s), "gap": (START.nearest_stop * s.displacement, s.displacement)}


def _travel(s: Scales) -> float:
    return (s.highest - s.lowest) or s.displacement


def _upper_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"edge": [s.highest - (1 - share) * _travel(s) for share in START.stop_edges]}


def _lower_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"edge": [s.lowest + (1 - share) * _travel(s) for share in START.stop_edges]}


def _edge_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    reach = START.nearest_stop * _travel(s)
    return {"kc": _stiffest(s), "edge": (s.lowest - reach, s.highest + reach)}


def _cogging_force(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    turn = 2 * math.pi * x.displacement / p.pitch
    return p.F * ca.sin(turn) + p.Fq * ca.cos(turn)


def _pitch_grid(s: Scales) -> Mapping[str, list[float]]:
    return {"pitch": [_travel(s) / periods for periods in START.cogging_periods]}


def _pitch_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    return {"pitch": (_travel(s) / (2 * START.cogging_periods[-1]), 2 * _travel(s))}


def _stops_from_spring(edges: Mapping[str, list[float]], force: float, s: Scales) -> list[Mapping[str, float]]:
    """Stops that push back as much at the end of the travel as the fitted spring does, from every edge."""
    name, positions = next(iter(edges.items()))
    depth = [(1 - share) * _travel(s) for share in START.stop_edges]
    return [{name: at, "kc": force / into} for at, into in zip(positions, depth, strict=True)]


def _stop_from_cubic(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    return _stops_from_spring(_gap_grid(s), abs(values["K3"]) * s.displacement**3, s)


def _upper_from_quadratic(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    return _stops_from_spring(_upper_grid(s), abs(values["K2"]) * s.displacement**2, s)


def _lower_from_quadratic(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    return _stops_from_spring(_lower_grid(s), abs(values["K2"]) * s.displacement**2, s)


STIFFNESS = amplitude_parameter("kc", "{force}/{displacement}", "stiffness of the stop", low=0.0)

end_stop = Effect(
    "end_stop",
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
    grid=_gap_grid,
    from_parent=_stop_from_cubic,
    limits=_gap_limits,
)

end_stop_above = Effect(
    "end_stop_above",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("edge", "{displacement}", 0.0, (-1e9, 1e9), "position at which the upper stop begins"),
    ],
    terms=_stop_above,
    equation="-kc max(x - edge, 0)",
    parents=("quadratic_stiffness",),
    parity="even",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    amplitudes=("kc",),
    probe=_stop_probe,
    grid=_upper_grid,
    from_parent=_upper_from_quadratic,
    limits=_edge_limits,
)

end_stop_below = Effect(
    "end_stop_below",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("edge", "{displacement}", 0.0, (-1e9, 1e9), "position at which the lower stop begins"),
    ],
    terms=_stop_below,
    equation="kc max(edge - x, 0)",
    parents=("quadratic_stiffness",),
    parity="even",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    amplitudes=("kc",),
    probe=_stop_probe,
    grid=_lower_grid,
    from_parent=_lower_from_quadratic,
    limits=_edge_limits,
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

CONTACT: tuple[Effect, ...] = (end_stop, end_stop_above, end_stop_below, cogging)
