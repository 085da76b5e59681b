"""Elasticity: springs whose force is not proportional to the displacement."""

from __future__ import annotations

from greybox.model import Effect
from greybox.signals import Expression, Named, Parameter


def _cubic(x: Named, u: Named, p: Named) -> Expression:
    return -p.K3 * x.displacement**3


def _quadratic(x: Named, u: Named, p: Named) -> Expression:
    return -p.K2 * x.displacement**2


cubic_stiffness = Effect(
    "cubic_stiffness",
    site="force",
    parameters=[
        Parameter(
            "K3",
            "{force}/{displacement}**3",
            0.0,
            source="amplitude, absent until fitted",
            description="cubic stiffness, positive for a spring that hardens",
        )
    ],
    terms=_cubic,
    equation="-K3 x^3",
    parity="odd",
    tells_apart=(
        "Measure the current: a force constant that falls with displacement changes the force per ampere and the back"
        " EMF, a cubic spring changes neither."
    ),
    source="Duffing oscillator: first odd term of the series of a symmetric spring",
)

quadratic_stiffness = Effect(
    "quadratic_stiffness",
    site="force",
    parameters=[
        Parameter(
            "K2",
            "{force}/{displacement}**2",
            0.0,
            source="amplitude, absent until fitted",
            description="quadratic stiffness of a spring that differs by side, either sign",
        )
    ],
    terms=_quadratic,
    equation="-K2 x^2",
    parity="even",
    tells_apart=(
        "Reach the same displacement slowly and at resonance: a curved sensor bends both readings alike, a spring makes"
        " a mean shift and harmonics that the dynamics filter."
    ),
    source="first even term of the series of an asymmetric spring",
)

ELASTICITY: tuple[Effect, ...] = (cubic_stiffness, quadratic_stiffness)
