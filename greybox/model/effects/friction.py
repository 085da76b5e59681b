"""Friction: forces against the motion that viscous damping does not cover."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import casadi as ca

from greybox.model.balance import Balance
from greybox.model.effect import DryFriction, Effect, amplitude_parameter, geometric_grid, shape_parameter
from greybox.model.effects.scales import BOUNDS_REACH, VISIBLE_SHARE, Scales
from greybox.model.parts import Occurrence
from greybox.model.signals import Expression, NamedValues, State

FULL = "Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky 1998, Friction models and compensation"
FRICTION_LEVELS = (
    amplitude_parameter("Fc", "{force}", "friction while sliding fast", low=0.0),
    amplitude_parameter("Fs", "{force}", "friction at standstill", low=0.0),
    shape_parameter("vs", "{velocity}", 0.01, (1e-9, 1e6), "velocity over which the friction falls from Fs to Fc"),
)


def _steady_level(x: NamedValues, p: NamedValues) -> Expression:
    """Friction of steady sliding at the present speed: it falls from Fs to Fc. One that rises with speed is a drag, not this effect."""
    # Stribeck: Fc + (Fs - Fc) exp(-(v / vs)^2).
    return p.Fc + ca.fmax(p.Fs - p.Fc, 0) * ca.exp(-((x.velocity / p.vs) ** 2))


def _speed_grid(s: Scales) -> list[float]:
    return geometric_grid(0.01 * s.velocity, 0.5 * s.velocity, 4)


def _fall_within_record(s: Scales) -> Mapping[str, tuple[float, float]]:
    """A fall of the friction that these speeds show: beyond them it is a constant level and a drag with the square of the speed."""
    return {"vs": (_speed_grid(s)[0] / BOUNDS_REACH, s.velocity)}


# Friction at standstill over friction while sliding: about 1.2 for dry metal, up to 2.5 for seals and grease.
FRICTION_RATIOS: tuple[float, float, float] = (1.2, 1.6, 2.4)


def _stribeck_from_coulomb(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    # Between Fc and Fs is what a fitted Coulomb friction shows: both are lowered a little for the highest ratio.
    low, middle, high = FRICTION_RATIOS
    levels = [(values["Fc"] * share, ratio) for share, ratio in ((1.0, low), (1.0, middle), (0.8, high))]
    return [{"Fc": level, "Fs": level * ratio, "vs": vs} for (level, ratio), vs in product(levels, _speed_grid(s))]


def _bristle_rate(x: NamedValues, p: NamedValues) -> Expression:
    # Without friction (Fc = Fs = 0) the bristles bend freely and carry nothing: keep the quotient finite.
    level = _steady_level(x, p)
    # LuGre: z' = v - s0 |v| z / g(v), with g the level of steady sliding.
    return x.velocity - p.s0 * ca.fabs(x.velocity) * x.z / ca.if_else(level > 0, level, ca.inf)


def _bristle_grid(level: float, s: Scales) -> list[Mapping[str, float]]:
    """Bristles that give way over a share of the stroke, hardly and well damped against the mass on them."""
    # Bristles slide where s0 z reaches the level: s0 = level / stretch. s1 = damping sqrt(s0 m): half the critical one at 1.
    stiff = [level / (share * s.displacement) for share in (0.0005, 0.005, 0.05)]
    return [{"s0": s0, "s1": damping * (s0 * s.storage) ** 0.5} for s0, damping in product(stiff, (0.1, 1.0))]


def _lugre_from_parent(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    """From the fitted Stribeck friction, or from Coulomb friction with a little more at standstill."""
    if "Fs" in values:
        parents: list[Mapping[str, float]] = [{name: values[name] for name in ("Fc", "Fs", "vs")}]
    else:
        slow, fast = 0.03 * s.velocity, 0.2 * s.velocity
        parents = [{"Fc": values["Fc"], "Fs": FRICTION_RATIOS[1] * values["Fc"], "vs": vs} for vs in (slow, fast)]
    return [{**parent, **bristles} for parent in parents for bristles in _bristle_grid(parent["Fc"], s)]


def _lugre_grid(s: Scales) -> Mapping[str, list[float]]:
    bristles = _bristle_grid(s.visible_force, s)
    stiffest, softest = bristles[0], bristles[-1]
    return {
        "vs": geometric_grid(0.03 * s.velocity, 0.3 * s.velocity, 2),
        "s0": geometric_grid(softest["s0"], stiffest["s0"], 3),
        "s1": [(stiffest["s1"] * softest["s1"]) ** 0.5],
    }


def _friction_under_load(x: NamedValues, u: NamedValues, p: NamedValues) -> DryFriction:
    # Amontons beside a constant level: Fc + mu N, where N is the size of what is transmitted.
    level = p.Fc + p.mu * x.transmitted
    return DryFriction(sliding=level, static=level)


# Mean of the transmitted force over the largest one.
MEAN_LOAD = 0.5


def _loaded_from_coulomb(values: Mapping[str, float], s: Scales) -> list[Mapping[str, float]]:
    # The mean level is what a fitted Coulomb friction shows.
    level, load = values["Fc"], MEAN_LOAD * s.force
    return [{"Fc": share * level, "mu": (1 - share) * level / load} for share in (0.1, 0.5, 0.9)]


def _friction_by_direction(x: NamedValues, u: NamedValues, p: NamedValues) -> DryFriction:
    # Levels that differ are their mean with a constant force beside it, at standstill too.
    mean = (p.Fp + p.Fm) / 2
    return DryFriction(sliding=mean, static=mean)


coulomb_friction = Effect(
    "coulomb_friction",
    site="force",
    parameters=[
        amplitude_parameter("Fc", "{force}", "friction while sliding, and the most it holds at standstill", low=0.0)
    ],
    # Coulomb holds at standstill exactly what it takes while sliding.
    dry=lambda x, u, p: DryFriction(sliding=p.Fc, static=p.Fc),
    equation="-Fc sign(v)",
    parity="odd",
    tells_apart=(
        "Record two amplitudes: as the amplitude grows the damping by Coulomb friction falls and that by quadratic"
        " damping rises; Bouc-Wen hysteresis turns into a spring at small amplitudes, where Coulomb friction sticks."
    ),
    source=f"Coulomb 1785; {FULL}",
    probe=lambda s: {"Fc": s.visible_force},
    needs=("contact",),
    occurs=Occurrence.USUAL,
    occurs_with={"contact": Occurrence.USUAL, "free": Occurrence.RARE},
)

stribeck_friction = Effect(
    "stribeck_friction",
    site="force",
    parameters=FRICTION_LEVELS,
    dry=lambda x, u, p: DryFriction(sliding=_steady_level(x, p), static=ca.fmax(p.Fs, p.Fc)),
    equation="-(Fc + (Fs - Fc) exp(-(v/vs)^2)) sign(v), Fs >= Fc",
    parents=("coulomb_friction",),
    parity="odd",
    tells_apart=(
        "Record slow motion, with reversals and starts from rest: well above vs Stribeck friction is Coulomb friction."
    ),
    source=f"R. Stribeck 1902; {FULL}",
    probe=lambda s: {"Fc": s.visible_force, "Fs": FRICTION_RATIOS[1] * s.visible_force},
    grid=lambda s: {"vs": _speed_grid(s)},
    limits=_fall_within_record,
    from_parent=_stribeck_from_coulomb,
    needs=("contact",),
    occurs=Occurrence.OCCASIONAL,
    occurs_with={"gear": Occurrence.COMMON, "free": Occurrence.EXOTIC},
)

lugre_friction = Effect(
    "lugre_friction",
    site="force",
    parameters=(
        *FRICTION_LEVELS,
        shape_parameter("s0", "{force}/{displacement}", 1e4, (1e-9, 1e15), "stiffness of the bristles"),
        shape_parameter("s1", "{force}/{velocity}", 1.0, (0.0, 1e12), "damping of the bristles"),
    ),
    states=(State("z", "{displacement}", relaxing=True, description="mean bending of the bristles"),),
    terms=lambda x, u, p: ca.if_else(_steady_level(x, p) > 0, -(p.s0 * x.z + p.s1 * _bristle_rate(x, p)), 0),
    balances=lambda x, u, p: [Balance("bristles", "{velocity}", 1, "z", bending=_bristle_rate(x, p))],
    equation="-(s0 z + s1 z'), z' = v - s0 abs(v) z / (Fc + (Fs - Fc) exp(-(v/vs)^2)), Fs >= Fc",
    parents=("coulomb_friction", "stribeck_friction"),
    parity="odd",
    tells_apart=(
        "Record motion of less than Fs / s0 about a standstill: only bristles give way before they slide; otherwise"
        " LuGre and Stribeck friction are the same."
    ),
    source="Canudas de Wit, Olsson, Astrom, Lischinsky 1995, A new model for control of systems with friction",
    probe=lambda s: {"Fc": s.visible_force, "Fs": FRICTION_RATIOS[1] * s.visible_force},
    grid=_lugre_grid,
    # Bristles damped beyond ``s1`` stick to the body within a third of a sampling period, which no record shows.
    limits=lambda s: {**_fall_within_record(s), "s1": (0.0, 3 * s.storage / s.period)},
    from_parent=_lugre_from_parent,
    needs=("contact",),
    occurs=Occurrence.RARE,
    occurs_with={"seal": Occurrence.COMMON, "free": Occurrence.EXOTIC},
)

viscous_damping = Effect(
    "viscous_damping",
    site="force",
    parameters=[amplitude_parameter("B1", "{force}/{velocity}", "damping force over velocity", low=0.0)],
    terms=lambda x, u, p: -p.B1 * x.velocity,
    equation="-B1 v",
    parity="linear",
    tells_apart=(
        "Let it coast: under viscous damping the speed falls by equal ratios in equal times, under dry friction along a straight line."
    ),
    source="shear in a film of lubricant, force proportional to the speed (Newton)",
    probe=lambda s: {"B1": s.visible_force / s.velocity},
    occurs=Occurrence.COMMON,
    # Nothing shears a film there, and a flow past a body that can be filmed is turbulent.
    occurs_with={"free": Occurrence.RARE},
)

quadratic_damping = Effect(
    "quadratic_damping",
    site="force",
    parameters=[amplitude_parameter("B2", "{force}/{velocity}**2", "drag force over squared velocity", low=0.0)],
    terms=lambda x, u, p: -p.B2 * ca.fabs(x.velocity) * x.velocity,
    equation="-B2 abs(v) v",
    parity="odd",
    tells_apart=(
        "Record two amplitudes: the damping of a free decay or a resonance rises with the amplitude under quadratic"
        " damping and falls under Coulomb friction."
    ),
    source="turbulent drag, force over the square of speed (Newton)",
    probe=lambda s: {"B2": s.visible_force / s.velocity**2},
    needs=("fluid",),
    occurs=Occurrence.RARE,
    occurs_with={"fluid": Occurrence.USUAL, "motor": Occurrence.EXOTIC, "free": Occurrence.COMMON},
)

load_dependent_friction = Effect(
    "load_dependent_friction",
    site="force",
    parameters=[
        amplitude_parameter("Fc", "{force}", "friction without load", low=0.0),
        amplitude_parameter("mu", "1", "friction over the force transmitted", low=0.0, high=1.0),
    ],
    dry=_friction_under_load,
    equation="-(Fc + mu (sizes of the forces that do not depend on v)) sign(v)",
    parents=("coulomb_friction",),
    parity="odd",
    tells_apart=(
        "Move at one speed under several loads: this friction grows with the load, Coulomb and viscous friction do not."
    ),
    source=(
        "gears and harmonic drives: Hamon, Gautier, Garrec 2010, Dynamic identification of robots with a dry friction model depending"
        " on load and velocity"
    ),
    probe=lambda s: {"Fc": 0.5 * s.visible_force, "mu": VISIBLE_SHARE},
    from_parent=_loaded_from_coulomb,
    needs=("gear",),
    occurs=Occurrence.OCCASIONAL,
    occurs_with={"weight": Occurrence.COMMON},
)

asymmetric_friction = Effect(
    "asymmetric_friction",
    site="force",
    parameters=[
        amplitude_parameter("Fp", "{force}", "friction while sliding forward", low=0.0),
        amplitude_parameter("Fm", "{force}", "friction while sliding backward", low=0.0),
    ],
    dry=_friction_by_direction,
    terms=lambda x, u, p: (p.Fm - p.Fp) / 2,
    equation="-Fp for v > 0, +Fm for v < 0",
    parents=("coulomb_friction",),
    stands_for=("coulomb_friction", "constant_load"),
    parity="odd",
    tells_apart=(
        "Coulomb friction with a constant load is exactly the same. Turn the rig over, or take the load off: friction that differs by"
        " direction stays."
    ),
    source=(
        "Armstrong-Helouvry, Dupont, Canudas de Wit 1994, A survey of models, analysis tools and compensation methods for the"
        " control of machines with friction"
    ),
    probe=lambda s: {"Fp": s.visible_force, "Fm": 0.5 * s.visible_force},
    from_parent=lambda values, s: [
        {"Fp": share * values["Fc"], "Fm": (2 - share) * values["Fc"]} for share in (1.0, 1.5, 0.5)
    ],
    needs=("contact",),
    occurs=Occurrence.RARE,
    occurs_with={"weight": Occurrence.OCCASIONAL, "free": Occurrence.EXOTIC},
)

warming_friction = Effect(
    "warming_friction",
    site="force",
    parameters=[
        amplitude_parameter("Fc", "{force}", "friction while sliding, cold", low=0.0),
        amplitude_parameter(
            "cw", "1/({force}*{velocity})", "fall of the friction over the power that warms it", low=0.0
        ),
        shape_parameter(
            "tau_w", "s", 10.0, (1e-6, 1e9), "time in which it cools; far beyond the record it only runs in"
        ),
    ],
    states=(
        State(
            "z", "1", relaxing=True, description="share by which the warm friction is lower, over what is left of it"
        ),
    ),
    dry=lambda x, u, p: DryFriction(sliding=p.Fc / (1 + x.z), static=p.Fc / (1 + x.z)),
    balances=lambda x, u, p: [
        # What it turns into heat is the friction times the speed, here the cold one: warm oil takes less.
        Balance("warmth", "1", p.tau_w, "z", heating=p.cw * p.Fc * ca.fabs(x.velocity), cooling=-x.z)
    ],
    equation="-Fc/(1 + z) sign(v), tau_w z' = cw Fc abs(v) - z",
    parents=("coulomb_friction",),
    parity="slow",
    tells_apart=(
        "Move at one speed for minutes after a rest: friction that warms falls and settles, and is back after another rest; what runs in"
        " stays low."
    ),
    source=(
        "gears and bearings: A. Bittencourt, S. Gunnarsson 2012, Static friction in a robot joint: modeling and identification of load and"
        " temperature effects"
    ),
    probe=lambda s: {"Fc": s.visible_force, "cw": VISIBLE_SHARE / (s.visible_force * s.velocity)},
    grid=lambda s: {"tau_w": [share * s.duration for share in (0.1, 0.5, 3.0)]},
    limits=lambda s: {"tau_w": (10 * s.period, 100 * s.duration)},
    from_parent=lambda values, s: [
        {"Fc": ratio * values["Fc"], "cw": (ratio - 1) / (values["Fc"] * s.velocity), "tau_w": share * s.duration}
        for ratio, share in product((1.2, 2.0), (0.1, 0.5))
    ],
    needs=("contact",),
    occurs=Occurrence.RARE,
    occurs_with={"gear": Occurrence.OCCASIONAL, "free": Occurrence.EXOTIC},
)

FRICTION: tuple[Effect, ...] = (
    coulomb_friction,
    stribeck_friction,
    lugre_friction,
    viscous_damping,
    quadratic_damping,
    load_dependent_friction,
    asymmetric_friction,
    warming_friction,
)


# Damping that is not one constant: it grows with the amplitude, or differs by the direction of motion.

# What tells the members of the family apart: quadratic_damping (in friction) is one of them.
FAMILY = (
    "Record free decays or resonances of two amplitudes: all damping of this family grows with the amplitude; drive the body"
    " well below and well above its resonance at the same displacement: that which goes with the speed grows with the"
    " frequency, that which goes with the displacement does not."
)


displacement_damping = Effect(
    "displacement_damping",
    site="force",
    parameters=[
        amplitude_parameter(
            "D2", "{force}/({displacement}**2*{velocity})", "damping over squared displacement, either sign"
        )
    ],
    terms=lambda x, u, p: -p.D2 * x.displacement**2 * x.velocity,
    equation="-D2 x^2 v",
    parity="odd",
    tells_apart=FAMILY,
    source="B. van der Pol 1926, On relaxation-oscillations: the damping term of second order in the displacement",
    probe=lambda s: {"D2": s.visible_force / (s.displacement**2 * s.velocity)},
    needs=("spring", "rubber", "hysteretic"),
    occurs=Occurrence.EXOTIC,
)

cubic_damping = Effect(
    "cubic_damping",
    site="force",
    parameters=[amplitude_parameter("B3", "{force}/{velocity}**3", "damping force over cubed velocity", low=0.0)],
    terms=lambda x, u, p: -p.B3 * x.velocity**3,
    equation="-B3 v^3",
    parity="odd",
    tells_apart=FAMILY,
    source="first odd term of the series of a symmetric damper (Rayleigh, The Theory of Sound)",
    probe=lambda s: {"B3": s.visible_force / s.velocity**3},
    needs=("fluid",),
    occurs=Occurrence.RARE,
    occurs_with={"hull": Occurrence.COMMON, "free": Occurrence.EXOTIC},
)

directional_damping = Effect(
    "directional_damping",
    site="force",
    parameters=[
        amplitude_parameter(
            "Ba", "{force}/{velocity}", "half the difference of the viscous friction by direction, either sign"
        )
    ],
    terms=lambda x, u, p: -p.Ba * ca.fabs(x.velocity),
    equation="-Ba abs(v): damping B + Ba forward, B - Ba backward",
    parity="even",
    tells_apart=(
        "Move at two steady speeds both ways: the difference of the forces grows with the speed, that of a constant load or of"
        " Coulomb friction that differs by direction stays. At one speed they are the same."
    ),
    source=(
        "Armstrong-Helouvry, Dupont, Canudas de Wit 1994, A survey of models, analysis tools and compensation methods for the"
        " control of machines with friction"
    ),
    probe=lambda s: {"Ba": s.visible_force / s.velocity},
    needs=("gear", "valve"),
    occurs=Occurrence.RARE,
)

DAMPING: tuple[Effect, ...] = (displacement_damping, cubic_damping, directional_damping)
