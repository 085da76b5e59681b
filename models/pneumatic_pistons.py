"""Pistons for the pneumatic chain.

    M v' = pressure force - M f_v v - end stops - friction - load        (eqs. 10.6, 10.7)

`f_v` is mass-normalised, in 1/s, as equations 10.7 to 10.9 need it (the paper's text before them has it in N s/m).
An end cap pushes back once the piston is beyond the stroke by `e`, after Hunt and Crossley: `k_stop e (1 + c_stop e')`,
never pulling, so that a contact begins and ends without a jump.

Dry friction (Coulomb, Stribeck, LuGre) and loads are effects of the catalogue, for any of these pistons.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2.3; K. H. Hunt, F. R. E.
Crossley 1975, Coefficient of restitution interpreted as damping in vibroimpact.
"""

import casadi as ca

from greybox import Parameter
from greybox.model.signals import Expression, NamedValues
from models.pneumatic_parts import STROKE, Piston, Terms

VISCOUS = Parameter(
    "f_v",
    "1/s",
    46.15,
    (0.05, 5000.0),
    source="assumed, plausible: 60 N s/m over M_piston = 1.3 kg",
    description="viscous friction over mass, eq. 10.7",
)
MASS = Parameter(
    "M_piston",
    "kg",
    1.3,
    (0.05, 50.0),
    fixed=True,
    source="assumed, plausible: piston and rod of a 40 mm x 500 mm cylinder",
    role="mass",
    description="moving mass, eq. 10.6",
)
END_CAPS = (
    Parameter(
        "k_stop",
        "N/m",
        1e5,
        (1e3, 1e8),
        fixed=True,
        source="assumed: elastic cushion, 10 mm under the full force of the supply",
        description="stiffness of the end caps",
    ),
    Parameter(
        "c_stop",
        "s/m",
        2.0,
        (0.0, 100.0),
        fixed=True,
        source="assumed, plausible: a piston at 0.3 m/s loses half its energy",
        description="dissipation of the end caps, over stiffness and depth",
    ),
)


def viscous_piston(*, end_stops: bool = False) -> Piston:
    """A mass with viscous friction, `M f_v v`; with `end_stops` it is stopped beyond `stroke / 2` on either side."""

    def forces(x: NamedValues, p: NamedValues) -> Terms:
        viscous = {"viscous": -p.M_piston * p.f_v * x.v}
        return viscous | ({"end_stop": _end_stop(x, p)} if end_stops else {})

    return Piston(forces, (VISCOUS, MASS, *((STROKE, *END_CAPS) if end_stops else ())))


def _end_stop(x: NamedValues, p: NamedValues) -> Expression:
    side = ca.sign(x.s)
    depth = ca.fmax(ca.fabs(x.s) - p.stroke / 2, 0)
    return -side * p.k_stop * depth * ca.fmax(1 + p.c_stop * side * x.v, 0)
