"""Chambers for the pneumatic chain: what mass flow and motion do to the two pressures, and what these do to the piston.

Mass balance of an ideal gas with polytropic exponent `n` in a volume that the piston changes (eqs. 10.3, 10.4)::

    p_a' = n [ R T m_a - p_a A_A v ] / V_a(s)        R T = P_a / rho_a
    p_b' = n [ R T m_b + p_b A_B v ] / V_b(s)

`n = 1` is isothermal, and then `p V / (R T)` is the mass in the chamber. The mass flow is at ambient temperature for
every `n`. Leakage passes from one chamber to the other, `k_i (p_a - p_b)`, and out to the air, `k_o (p - P_a)`.

`linear_chambers` is this about mid-stroke: `p = P_S / 2` and `V = V_total / 2` in front of the velocity (eq. 10.4).

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2.2.
"""

import math

import casadi as ca

from greybox import Parameter
from greybox.base.errors import ModelError, nearest
from greybox.model import Rule
from greybox.model.signals import Expression, NamedValues
from models.pneumatic_parts import STROKE, Chambers, Flows, Terms, half_supply

AREAS = ("equal", "rod")
# Beyond the stroke, where only a trial step goes, a chamber keeps this share of its volume at mid-stroke.
LEAST_VOLUME = 0.01
# A piston that rests on its end cap reads a little more than half the stroke.
STROKE_SLACK = 1.02
GAS = (0.0, math.inf)  # absolute pressures

MEAN_AREA = Parameter(
    "A_piston",
    "m**2",
    11.56e-4,
    (1e-5, 0.1),
    fixed=True,
    source="derived: bore 40 mm (Table 10.1), rod 16 mm (catalogue, assumed), mean of both sides",
    role="piston_area",
    description="effective piston area, eq. 10.3",
)
TOTAL_VOLUME = Parameter(
    "V_total",
    "m**3",
    6.98e-4,
    (1e-6, 0.1),
    fixed=True,
    source="derived: mean area x 0.5 m stroke (Table 10.1) and 2 x 60 cm3 of dead volume (assumed)",
    role="total_volume",
    description="air volume of both chambers, eq. 10.3",
)
ROD_SIDES = (
    Parameter(
        "A_A",
        "m**2",
        12.566e-4,
        (1e-5, 0.1),
        fixed=True,
        source="derived: bore 40 mm (Table 10.1)",
        description="piston area towards chamber A",
    ),
    Parameter(
        "A_B",
        "m**2",
        10.556e-4,
        (1e-5, 0.1),
        fixed=True,
        source="derived: bore 40 mm (Table 10.1) less a rod of 16 mm (catalogue, assumed)",
        description="piston area towards chamber B, around the rod",
    ),
    STROKE,
    Parameter(
        "V_dA",
        "m**3",
        6.0e-5,
        (1e-7, 1e-2),
        fixed=True,
        source="assumed, plausible: end cap, port and hose",
        description="dead volume of chamber A",
    ),
    Parameter(
        "V_dB",
        "m**3",
        6.0e-5,
        (1e-7, 1e-2),
        fixed=True,
        source="assumed, plausible: end cap, port and hose",
        description="dead volume of chamber B",
    ),
)
POLYTROPIC = Parameter(
    "n",
    "1",
    1.2,
    (0.9, 1.5),
    fixed=True,
    source="assumed: between isothermal (1) and adiabatic (1.4)",
    description="polytropic exponent of the gas in the chambers",
)
LEAKAGE = (
    Parameter(
        "k_i",
        "kg/(s*Pa)",
        0.0,
        (0.0, 1e-7),
        fixed=True,
        source="assumed: tight piston seal",
        description="leakage past the piston",
    ),
    Parameter(
        "k_o",
        "kg/(s*Pa)",
        0.0,
        (0.0, 1e-7),
        fixed=True,
        source="assumed: tight rod seal and fittings",
        description="leakage of each chamber to the air",
    ),
)
ROD_ON_ONE_SIDE = Rule(
    "no area below the rod's side", "m**2", lambda p: p.A_A - p.A_B + 1e-12, "chamber B is the one with the rod"
)
WITHIN_STROKE = Rule(
    "piston within its stroke",
    "m",
    lambda s, p: STROKE_SLACK * p.stroke / 2 - abs(s),
    "measure s from mid-stroke, in metre",
    "s",
)


def linear_chambers() -> Chambers:
    """Equation 10.4: equal areas, half the volume and half the supply pressure on each side, isothermal."""

    def rates(x: NamedValues, p: NamedValues, flows: Flows) -> tuple[Terms, Terms]:
        by_piston = p.P_S * p.A_piston / p.V_total * x.v
        by_a = {name: _about_mid_stroke(m, p) for name, m in flows[0].items()}
        by_b = {name: -_about_mid_stroke(-m, p) for name, m in flows[1].items()}  # both signs turned: prints shorter
        return by_a | {"displacement": -by_piston}, by_b | {"displacement": by_piston}

    return Chambers(rates, _equal_force, (half_supply, half_supply), (MEAN_AREA, TOTAL_VOLUME))


def gas_chambers(
    areas: str = "rod", *, moving: bool = True, polytropic: bool = False, leakage: bool = False
) -> Chambers:
    """The mass balances above, with the pressures as they are.

    `areas` `"equal"`: `A_piston` on both sides and `V = V_total / 2 +- A_piston s`, dead volumes included in `V_total`.
    `areas` `"rod"`: `A_A`, `A_B`, `V_a = V_dA + A_A (stroke / 2 + s)`, `V_b = V_dB + A_B (stroke / 2 - s)`, and the
    atmosphere on the rod. Without `moving` the volumes stay as at mid-stroke.
    """
    if areas not in AREAS:
        raise ModelError(f"areas {areas!r} of a cylinder are unknown; {nearest(areas, AREAS)}")
    equal = areas == "equal"

    def rates(x: NamedValues, p: NamedValues, flows: Flows) -> tuple[Terms, Terms]:
        a, b = (p.A_piston, p.A_piston) if equal else (p.A_A, p.A_B)
        middle = (p.V_total / 2, p.V_total / 2) if equal else (p.V_dA + a * p.stroke / 2, p.V_dB + b * p.stroke / 2)
        volume_a = _volume(middle[0], a * x.s) if moving else middle[0]
        volume_b = _volume(middle[1], -b * x.s) if moving else middle[1]
        n = p.n if polytropic else 1
        leaks = _leaks(x, p) if leakage else ({}, {})
        by_a, by_b = (
            {name: m * p.P_a / p.rho_a for name, m in (flow | leak).items()}
            for flow, leak in zip(flows, leaks, strict=True)
        )
        by_a["displacement"], by_b["displacement"] = -x.p_a * a * x.v, x.p_b * b * x.v
        return (
            {name: n * term / volume_a for name, term in by_a.items()},
            {name: n * term / volume_b for name, term in by_b.items()},
        )

    needed = (MEAN_AREA, TOTAL_VOLUME) if equal else ROD_SIDES
    parameters = (*needed, *([POLYTROPIC] if polytropic else []), *(LEAKAGE if leakage else ()))
    if equal:
        return Chambers(rates, _equal_force, (half_supply, half_supply), parameters, (), GAS)
    return Chambers(rates, _rod_force, (half_supply, _balanced), parameters, (ROD_ON_ONE_SIDE, WITHIN_STROKE), GAS)


def _about_mid_stroke(flow: Expression, p: NamedValues) -> Expression:
    return p.P_a * (2 * flow) / (p.rho_a * p.V_total)


def _leaks(x: NamedValues, p: NamedValues) -> tuple[Terms, Terms]:
    across = p.k_i * (x.p_a - x.p_b)
    return {"leakage": -across - p.k_o * (x.p_a - p.P_a)}, {"leakage": across - p.k_o * (x.p_b - p.P_a)}


def _volume(middle: Expression, change: Expression) -> Expression:
    return ca.fmax(middle + change, LEAST_VOLUME * middle)


def _equal_force(x: NamedValues, p: NamedValues) -> Expression:
    return p.A_piston * (x.p_a - x.p_b)


def _rod_force(x: NamedValues, p: NamedValues) -> Expression:
    # The atmosphere pushes on the rod's cross-section, A_A - A_B.
    return p.A_A * x.p_a - p.A_B * x.p_b - (p.A_A - p.A_B) * p.P_a


def _balanced(p: NamedValues) -> Expression:
    """Pressure in chamber B that holds the piston against half the supply pressure in chamber A."""
    return (p.A_A * half_supply(p) - (p.A_A - p.A_B) * p.P_a) / p.A_B
