"""Elasticity: springs that are not proportional, that remember, or that carry a mass of their own."""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import Effect, amplitude_parameter, fixed_parameter, geometric_grid, shape_parameter
from greybox.model.effects.scales import Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State


def _hysteresis_balance(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
    v = x.velocity
    # Bouc-Wen with exponent 1: z' = v - beta |v| z - gamma v |z|.
    closing = {"beta": -p.beta * ca.fabs(v) * x.z, "gamma": -p.gamma * v * ca.fabs(x.z)}
    return [Balance("loop", "{velocity}", 1, "z", motion=v, **closing)]


def _hysteresis_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    """Constants that bend the branch visibly over the stroke, and no further than explicit steps follow."""
    least, most = 1e-3 / s.displacement, 1e3 / s.displacement
    return {"beta": (least, most), "gamma": (-most, most)}


def _coupling_force(x: NamedValues, p: NamedValues) -> Expression:
    """Force of the second mass on the body."""
    # F = k2 (z1 - x) + c2 (z2 - v), with z1 the position and z2 the velocity of the second mass.
    return p.k2 * (x.z1 - x.displacement) + p.c2 * (x.z2 - x.velocity)


def _second_mass_balances(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
    # Where positions are measured from a base that moves, its acceleration acts on this mass as on the body.
    carried = {"base": -p.m2 * u.base_acceleration} if "base_acceleration" in u else {}
    return [
        Balance("second_position", "{velocity}", 1, "z1", velocity=x.z2),
        Balance("second_force", "{force}", p.m2, "z2", reaction=-_coupling_force(x, p), **carried),
    ]


# Of the moving mass: a second mass of this size is visible but small.
SECOND_MASS = 0.04
# Damping of a second mode as a ratio of critical damping: metal structures have 0.002 to 0.03.
SECOND_DAMPING = 0.02


def _second_grid(s: Scales) -> Mapping[str, list[float]]:
    """Resonances from below the fastest mode of the plant up to a quarter of the sampling rate."""
    m2 = SECOND_MASS * s.storage
    low, high = 0.3 / s.slowest, 1.5 / s.period
    middle = (low * high) ** 0.5
    return {
        "m2": [m2],
        # Neighbours a quarter apart: a refit finds a sharp resonance only from nearby.
        "k2": [m2 * w**2 for w in geometric_grid(low, high, 16)],
        # c = 2 zeta m w, at the middle of the frequencies tried.
        "c2": [2 * SECOND_DAMPING * m2 * middle],
    }


# Lower bound of that stiffness and damping.
LEAST_COUPLING = 1e-12


def _second_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    """A body between three thousandths of the moving mass and all of it, on a spring that rings below half the sampling rate.

    What is faster shows as nothing but a stiffer or a delayed plant, at the price of a thousand substeps.
    """
    # Half the sampling rate in rad/s; a spring k rings with the mass m at w = sqrt(k / m).
    fastest = math.pi / s.period
    return {
        "m2": (0.003 * s.storage, s.storage),
        "k2": (LEAST_COUPLING, s.storage * fastest**2),
        "c2": (LEAST_COUPLING, s.storage * fastest),
    }


cubic_stiffness = Effect(
    "cubic_stiffness",
    site="force",
    parameters=[
        amplitude_parameter("K3", "{force}/{displacement}**3", "cubic stiffness, positive for a spring that hardens")
    ],
    terms=lambda x, u, p: -p.K3 * x.displacement**3,
    equation="-K3 x^3",
    parity="odd",
    tells_apart=(
        "Measure the current: a force constant that falls with displacement changes the force per ampere and the back"
        " EMF, a cubic spring changes neither."
    ),
    source="Duffing oscillator: first odd term of the series of a symmetric spring",
    probe=lambda s: {"K3": s.visible_force / s.displacement**3},
    needs=("spring", "rubber"),
    occurs=Occurrence.EXOTIC,
    occurs_with={"voice_coil": Occurrence.USUAL, "spring": Occurrence.COMMON},
)

quadratic_stiffness = Effect(
    "quadratic_stiffness",
    site="force",
    parameters=[
        amplitude_parameter(
            "K2", "{force}/{displacement}**2", "quadratic stiffness of a spring that differs by side, either sign"
        )
    ],
    terms=lambda x, u, p: -p.K2 * x.displacement**2,
    equation="-K2 x^2",
    parity="even",
    tells_apart=(
        "Reach the same displacement slowly and at resonance: a curved sensor bends both readings alike, a spring makes"
        " a mean shift and harmonics that the dynamics filter."
    ),
    source="first even term of the series of an asymmetric spring",
    probe=lambda s: {"K2": s.visible_force / s.displacement**2},
    needs=("spring", "rubber"),
    occurs=Occurrence.EXOTIC,
    occurs_with={"voice_coil": Occurrence.COMMON, "spring": Occurrence.OCCASIONAL},
)

viscoelastic_creep = Effect(
    "viscoelastic_creep",
    site="force",
    parameters=[
        amplitude_parameter("K1", "{force}/{displacement}", "stiffness of the branch that relaxes", low=0.0),
        shape_parameter("tau1", "s", 0.1, (1e-7, 1e6), "time in which it relaxes"),
    ],
    states=[State("z", "{displacement}", lambda p: p.displacement, relaxing=True, description="crept position")],
    terms=lambda x, u, p: -p.K1 * (x.displacement - x.z),
    balances=lambda x, u, p: [Balance("creep", "{displacement}", p.tau1, "z", stretch=x.displacement - x.z)],
    equation="-K1 (x - z), tau1 z' = x - z",
    parity="linear",
    tells_apart=(
        "Vary the frequency over two decades: the loop of creep shrinks away from 1/tau1, that of Bouc-Wen hysteresis"
        " stays; and measure the current, which a warming winding lowers and creep does not."
    ),
    source="standard linear solid (Zener): one Maxwell branch beside the spring",
    probe=lambda s: {"K1": s.visible_force / s.displacement},
    # Faster than the body itself it is damping, slower than the record a stiffness.
    grid=lambda s: {"tau1": geometric_grid(max(s.fastest, 4 * s.period), 0.5 * s.duration, 5)},
    needs=("rubber",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"rubber": Occurrence.COMMON},
)

bouc_wen_hysteresis = Effect(
    "bouc_wen_hysteresis",
    site="force",
    parameters=[
        amplitude_parameter("alpha", "{force}/{displacement}", "stiffness of the hysteretic branch", low=0.0),
        shape_parameter("beta", "1/{displacement}", 1e4, (1e-9, 1e12), "how soon the branch yields"),
        shape_parameter(
            "gamma",
            "1/{displacement}",
            0.0,
            (-1e12, 1e12),
            "how much sooner it yields on its way out than on its way back; below -beta it hardens",
        ),
    ],
    states=[State("z", "{displacement}", relaxing=True, description="stretch of the hysteretic branch")],
    terms=lambda x, u, p: -p.alpha * x.z,
    balances=_hysteresis_balance,
    equation="-alpha z, z' = v - beta abs(v) z - gamma v abs(z)",
    parity="odd",
    tells_apart=(
        "Vary the frequency over two decades: the loop of Bouc-Wen hysteresis stays, that of creep shrinks; vary the"
        " amplitude: it is a spring at small ones, where a cubic spring and Coulomb friction are not."
    ),
    approaches=("coulomb_friction",),
    source="R. Bouc 1967; Y. K. Wen 1976, Method for random vibration of hysteretic systems (exponent 1)",
    probe=lambda s: {"alpha": s.visible_force / s.displacement},
    grid=lambda s: {"beta": geometric_grid(0.3 / s.displacement, 30 / s.displacement, 5), "gamma": [0.0]},
    limits=_hysteresis_limits,
    needs=("hysteretic",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"hysteretic": Occurrence.USUAL},
)

# Stiffness (N/m) and damping (N s/m) between two bodies that do not feel each other. Positive, so that a refit sees a change of mass,
# stiffness and damping by the same factor as a straight line.
NEUTRAL_COUPLING = 1e-09


second_mode = Effect(
    "second_mode",
    site="force",
    parameters=[
        shape_parameter(
            "m2", "{force}*s/{velocity}", 1e-9, (1e-15, 1e9), "mass that swings on the body", "small, until fitted"
        ),
        shape_parameter(
            "k2",
            "{force}/{displacement}",
            NEUTRAL_COUPLING,
            (1e-12, 1e15),
            "stiffness between the two",
            "small, until fitted",
        ),
        shape_parameter(
            "c2",
            "{force}/{velocity}",
            NEUTRAL_COUPLING,
            (LEAST_COUPLING, 1e12),
            "damping between the two",
            "small, until fitted",
        ),
    ],
    states=[
        State("z1", "{displacement}", lambda p: p.displacement, description="position of the second mass"),
        State("z2", "{velocity}", description="its velocity"),
    ],
    terms=lambda x, u, p: _coupling_force(x, p),
    balances=_second_mass_balances,
    equation="k2 (z1 - x) + c2 (z2 - v), z1' = z2, m2 z2' = -(that) - m2 base acceleration",
    parity="linear",
    tells_apart=(
        "Excite up to the resonance of the second mass: it shows a dip and a peak; far below it cannot be told from a"
        " short delay of the input."
    ),
    source="two masses and a spring (Rayleigh, The Theory of Sound)",
    neutral={"k2": NEUTRAL_COUPLING, "c2": NEUTRAL_COUPLING},
    grid=_second_grid,
    limits=_second_limits,
    needs=("elastic",),
    occurs=Occurrence.RARE,
    occurs_with={"elastic": Occurrence.COMMON},
)

return_spring = Effect(
    "return_spring",
    site="force",
    parameters=[
        amplitude_parameter("Ks", "{force}/{displacement}", "stiffness of a spring towards zero displacement", low=0.0)
    ],
    terms=lambda x, u, p: -p.Ks * x.displacement,
    equation="-Ks s",
    parity="linear",
    tells_apart=(
        "Measure the pressures: a spring holds a steady difference between them away from the middle, leakage makes it"
        " decay; without them both draw the piston back."
    ),
    source="Hooke's law, for a cylinder that is pushed back by a spring",
    probe=lambda s: {"Ks": s.visible_force / s.displacement},
    needs=("spring",),
    occurs=Occurrence.RARE,
)

ELASTICITY: tuple[Effect, ...] = (
    cubic_stiffness,
    quadratic_stiffness,
    viscoelastic_creep,
    bouc_wen_hysteresis,
    second_mode,
    return_spring,
)


# Contact: forces that begin or repeat at certain positions.

STOP_SOURCE = "R. Isermann, Mechatronic Systems, Springer 2005: stop of finite stiffness"
STOP_TEXT = (
    "Drive slowly into the suspected position from both sides: a stop is not felt before it, a hardening spring bends everywhere;"
    " a clipped input and choked flow limit the speed wherever the body is."
)


# Share of the travel that a body goes into a stop of visible size.
STOP_DEPTH = 0.3


def _stop_probe(s: Scales) -> Mapping[str, float]:
    # The visible force at a usual depth: F = kc depth.
    return {"kc": s.visible_force / (STOP_DEPTH * s.displacement)}


def _stiffest(s: Scales) -> tuple[float, float]:
    """Stiffer than the samples follow, a stop is a wall: no record shows more."""
    # k = m w^2 at half the sampling rate.
    return 0.0, s.storage * (math.pi / s.period) ** 2


def _travel(s: Scales) -> float:
    return (s.highest - s.lowest) or s.displacement


# Where an end stop may begin, as shares of the way from the middle of the travel to its end, the faintest first.
STOP_EDGES: tuple[float, ...] = (0.85, 0.6, 0.3)


# Share of the travel within which no stop is looked for about zero, and beyond its ends.
NEAREST_STOP = 0.05


def _one_grid(s: Scales) -> Mapping[str, list[float]]:
    into = [(1 - share) * _travel(s) / 2 for share in STOP_EDGES]
    return {"gap": [*(s.highest - depth for depth in into), *(s.lowest + depth for depth in into)], "side": [1.0, -1.0]}


def _one_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    reach = NEAREST_STOP * _travel(s)
    return {"kc": _stiffest(s), "gap": (s.lowest - reach, s.highest + reach)}


def _one_from_spring(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    """Stops that push back as much at the end of the travel as the fitted spring does, on either side."""
    force = abs(values["K2"]) * s.displacement**2 if "K2" in values else abs(values["K3"]) * s.displacement**3
    into = [(1 - share) * _travel(s) / 2 for share in STOP_EDGES]
    above = [{"gap": s.highest - depth, "kc": force / depth, "side": 1.0} for depth in into]
    below = [{"gap": s.lowest + depth, "kc": force / depth, "side": -1.0} for depth in into]
    return [*above, *below]


def _both_from_cubic(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    # The cubic spring at the end of the travel, K3 x^3; a stop that begins at a gap takes the same force over the rest of the way.
    force = abs(values["K3"]) * s.displacement**3
    return [{"gap": share * s.displacement, "kc": force / ((1 - share) * s.displacement)} for share in STOP_EDGES]


def _cogging_force(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    # Sine and cosine instead of amplitude and phase: both constants enter linearly.
    turn = 2 * math.pi * x.displacement / p.pitch
    return p.F * ca.sin(turn) + p.Fq * ca.cos(turn)


# Periods of a periodic force over the travel of the record that a search starts from. A refit finds the pitch only next to its start, so
# they are close.
COGGING_PERIODS: tuple[float, ...] = (2, 2.33, 2.67, 3, 3.5, 4, 4.5, 5, 6, 7, 8, 9, 10, 12, 14, 16)
# Pitches that it starts from where the residual repeats over the position, over the period seen: each refit stays at the minimum next to
# its start.
SEEN_PITCHES: tuple[float, ...] = (1.0, 0.99, 1.01, 0.98, 1.02)


def _pitch_grid(s: Scales) -> Mapping[str, list[float]]:
    longest, shortest = _pitch_limits(s)["pitch"][::-1]
    seen = [share * s.pitch for share in SEEN_PITCHES if shortest <= share * s.pitch <= longest]
    return {"pitch": [*seen, *(_travel(s) / periods for periods in COGGING_PERIODS)]}


# Fewest periods over the travel: with fewer a sinusoid imitates any curve of the position.
FEWEST_COGGING_PERIODS = 1.5


def _pitch_limits(s: Scales) -> Mapping[str, tuple[float, float]]:
    # With fewer periods over the travel it is any curve.
    return {"pitch": (_travel(s) / (2 * COGGING_PERIODS[-1]), _travel(s) / FEWEST_COGGING_PERIODS)}


STIFFNESS = amplitude_parameter("kc", "{force}/{displacement}", "stiffness of the stop", low=0.0)

end_stop = Effect(
    "end_stop",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("gap", "{displacement}", 0.0, (-1e9, 1e9), "position at which the stop begins"),
        # Which end it is at: no constant to be found, both are tried.
        fixed_parameter("side", "1", 1.0, (-1.0, 1.0), "1 for a stop above, -1 for one below"),
    ],
    terms=lambda x, u, p: -p.kc * p.side * ca.fmax(p.side * (x.displacement - p.gap), 0),
    equation="-kc max(x - gap, 0), or kc max(gap - x, 0) for a stop below",
    parents=("quadratic_stiffness", "cubic_stiffness"),
    parity="even",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    probe=_stop_probe,
    grid=_one_grid,
    limits=_one_limits,
    from_parent=_one_from_spring,
    needs=("stop",),
    occurs=Occurrence.RARE,
)

end_stops = Effect(
    "end_stops",
    site="force",
    parameters=[
        STIFFNESS,
        shape_parameter("gap", "{displacement}", 1.0, (1e-12, 1e9), "distance of both stops from zero"),
    ],
    # How far beyond the nearer stop: x less its nearest point of [-gap, gap].
    terms=lambda x, u, p: -p.kc * (x.displacement - ca.fmin(ca.fmax(x.displacement, -p.gap), p.gap)),
    equation="-kc (x - min(max(x, -gap), gap))",
    parents=("cubic_stiffness",),
    parity="odd",
    tells_apart=STOP_TEXT,
    source=STOP_SOURCE,
    probe=_stop_probe,
    grid=lambda s: {"gap": [share * s.displacement for share in STOP_EDGES]},
    limits=lambda s: {"kc": _stiffest(s), "gap": (NEAREST_STOP * s.displacement, s.displacement)},
    from_parent=_both_from_cubic,
    needs=("stop",),
    occurs=Occurrence.RARE,
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
    probe=lambda s: {"F": s.visible_force, "Fq": s.visible_force},
    grid=_pitch_grid,
    limits=_pitch_limits,
    needs=("magnets",),
    occurs=Occurrence.EXOTIC,
    occurs_with={"magnets": Occurrence.COMMON},
)

CONTACT: tuple[Effect, ...] = (end_stop, end_stops, cogging)
