"""Friction: forces against the motion that viscous damping does not cover."""

from __future__ import annotations

import math

import casadi as ca

from greybox.model import DryFriction, Effect
from greybox.signals import Expression, Named, Parameter


def _coulomb(x: Named, u: Named, p: Named) -> DryFriction:
    # Coulomb holds at standstill exactly what it takes while sliding.
    return DryFriction(sliding=p.Fc, static=p.Fc)


def _quadratic_damping(x: Named, u: Named, p: Named) -> Expression:
    return -p.B2 * ca.fabs(x.velocity) * x.velocity


coulomb_friction = Effect(
    "coulomb_friction",
    site="force",
    parameters=[
        Parameter(
            "Fc",
            "{force}",
            0.0,
            (0.0, math.inf),
            source="amplitude, absent until fitted",
            description="friction force while sliding, and the most it holds at standstill",
        )
    ],
    dry=_coulomb,
    equation="-Fc sign(v)",
    parity="odd",
    tells_apart=(
        "Record two amplitudes: as the amplitude grows the damping by Coulomb friction falls and that by quadratic"
        " damping rises; Bouc-Wen hysteresis turns into a spring at small amplitudes, where Coulomb friction sticks."
    ),
    source="Coulomb 1785; Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky 1998, Friction models and compensation",
)

quadratic_damping = Effect(
    "quadratic_damping",
    site="force",
    parameters=[
        Parameter(
            "B2",
            "{force}/{velocity}**2",
            0.0,
            (0.0, math.inf),
            source="amplitude, absent until fitted",
            description="drag force over squared velocity",
        )
    ],
    terms=_quadratic_damping,
    equation="-B2 abs(v) v",
    parity="odd",
    tells_apart=(
        "Record two amplitudes: the damping of a free decay or a resonance rises with the amplitude under quadratic"
        " damping and falls under Coulomb friction."
    ),
    source="turbulent drag, force over the square of speed (Newton)",
)

FRICTION: tuple[Effect, ...] = (coulomb_friction, quadratic_damping)
