"""Damping that is not one constant: it grows with the amplitude, or differs by the direction of motion."""

from __future__ import annotations

import casadi as ca

from greybox.effects.parameters import amplitude_parameter
from greybox.effects.scales import Scales
from greybox.model import Effect
from greybox.model.signals import Expression, NamedValues

# What tells the members of the family apart: quadratic_damping (in friction) is one of them.
FAMILY = (
    "Record free decays or resonances of two amplitudes: all damping of this family grows with the amplitude; drive the body"
    " well below and well above its resonance at the same displacement: that which goes with the speed grows with the"
    " frequency, that which goes with the displacement does not."
)


def _displacement_damping(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.D2 * x.displacement**2 * x.velocity


def _cubic_damping(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.B3 * x.velocity**3


def _directional_damping(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    return -p.Ba * ca.fabs(x.velocity)


def _displacement_probe(s: Scales) -> dict[str, float]:
    return {"D2": s.visible_force / (s.displacement**2 * s.velocity)}


displacement_damping = Effect(
    "displacement_damping",
    site="force",
    parameters=[
        amplitude_parameter(
            "D2", "{force}/({displacement}**2*{velocity})", "damping over squared displacement, either sign"
        )
    ],
    terms=_displacement_damping,
    equation="-D2 x^2 v",
    parity="odd",
    tells_apart=FAMILY,
    source="B. van der Pol 1926, On relaxation-oscillations: the damping term of second order in the displacement",
    amplitudes=("D2",),
    probe=_displacement_probe,
)

cubic_damping = Effect(
    "cubic_damping",
    site="force",
    parameters=[amplitude_parameter("B3", "{force}/{velocity}**3", "damping force over cubed velocity", low=0.0)],
    terms=_cubic_damping,
    equation="-B3 v^3",
    parity="odd",
    tells_apart=FAMILY,
    source="first odd term of the series of a symmetric damper (Rayleigh, The Theory of Sound)",
    amplitudes=("B3",),
    probe=lambda s: {"B3": s.visible_force / s.velocity**3},
)

directional_damping = Effect(
    "directional_damping",
    site="force",
    parameters=[
        amplitude_parameter(
            "Ba", "{force}/{velocity}", "half the difference of the viscous friction by direction, either sign"
        )
    ],
    terms=_directional_damping,
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
    amplitudes=("Ba",),
    probe=lambda s: {"Ba": s.visible_force / s.velocity},
)

DAMPING: tuple[Effect, ...] = (displacement_damping, cubic_damping, directional_damping)
