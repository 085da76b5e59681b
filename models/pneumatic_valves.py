"""Valves for the pneumatic chain: the linear law of eq. 10.2, and the flow of ISO 6358 through metering edges.

A voltage `u > 0` connects chamber A to the supply and chamber B to the atmosphere, `u < 0` the other way round.

ISO 6358 (eq. 10.1 with its bracket put right), from an upstream pressure `P_u` to a downstream one `P_d`, both gases
at ambient temperature::

    m = C P_u rho_a phi(P_d / P_u)       phi(r) = 1                                  r <= b   choked
                                         phi(r) = sqrt(1 - ((r - b) / (1 - b))^2)    r > b    subsonic

The root has an infinite slope where both pressures are equal. Below `phi = 0.1`, that is within 0.4 % of equal
pressures, `phi^2 / 0.1` takes its place: the flow is laminar there. Where the downstream pressure is the higher one, as
in a chamber that a load pushes beyond the supply, the two change places.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), equations 10.1 and 10.2; ISO 6358-1.
"""

import casadi as ca

from greybox import Balance, Parameter, State
from greybox.base.errors import ModelError, nearest
from greybox.model import Rule
from greybox.model.signals import Expression, NamedValues
from models.pneumatic_parts import Terms, Valve

LAMINAR = 0.01  # phi^2 below which the flow is laminar
SHUT = 1e-30  # opening of a shut edge: keeps the slope of opening^q along q finite

CONDUCTANCE = {
    "linear": Parameter(
        "C",
        "m**3/(s*Pa)",
        5.4e-10,
        (1e-12, 1e-7),
        source="derived: speed per volt of eq. 10.12 at 0.05 m/V (assumed) with a choked exhaust, v = P_a C / A",
        description="sonic conductance at u_ref, eq. 10.1",
    ),
    "power": Parameter(
        "C",
        "m**3/(s*Pa)",
        1.62e-10,
        (1e-13, 1e-8),
        source="derived: the variances of the nine experiments of Table 10.2 at 0.05 m/V (assumed), with q = 2.1",
        description="sonic conductance at u_ref, eq. 10.1",
    ),
}
EXPONENT = Parameter(
    "q",
    "1",
    2.1,
    (0.3, 10.0),
    source="derived: v = 0.279 |u|^2.1 fits the variances of the nine experiments of Table 10.2 to 0.6 %",
    description="exponent of the opening, C (|u| / u_ref)^q",
)
REFERENCE = Parameter(
    "u_ref", "V", 1.0, (1e-3, 1e3), fixed=True, source="choice of unit", description="voltage at which C is stated"
)
CRITICAL = Parameter(
    "b",
    "1",
    0.3,
    (0.01, 0.9),
    fixed=True,
    source="assumed, plausible: spool valves have 0.2 to 0.4",
    description="critical pressure ratio, eq. 10.1",
)
DEAD_ZONE = Parameter(
    "d",
    "V",
    1.59,
    (0.0, 20.0),
    source="derived: dead band of 1.59 V fits the variances of Table 10.2 as well as q = 2.1 does",
    description="voltage within which the spool covers the ports",
)
LAG = Parameter(
    "tau_v",
    "s",
    2e-3,
    (5e-5, 0.5),
    fixed=True,
    source="assumed, plausible: 100 Hz valve (section 10.3.2)",
    description="lag of the spool behind the voltage",
)
RATIO = Parameter(
    "C_ratio",
    "1",
    0.84,
    (0.05, 20.0),
    fixed=True,
    source="assumed: flow controls set for equal speeds both ways, A_B / A_A",
    description="conductance towards chamber B over that towards chamber A",
)
K2 = Parameter(
    "K2",
    "kg/(s*Pa*V)",
    6.5e-10,
    (1e-12, 1e-7),
    source="derived: K2 = rho_a A / P_a x 0.0472 m/s/V, the gain of eq. 10.12 at 0.05 m/V (assumed)",
    role="valve_gain",
    description="mass flow of the valve per volt and pascal, eq. 10.2",
)
BETWEEN_0_AND_1 = Rule(
    "critical pressure ratio between 0 and 1",
    "1",
    lambda p: p.b * (1 - p.b),
    "valves have 0.1 to 0.5: it is the ratio of absolute pressures below which the flow is choked",
)
OPENINGS = ("linear", "power")


def linear_valve() -> Valve:
    """Equation 10.2 with `P_n = P_S / 2`: `m_a = K2 (P_S / 2) u`, `m_b = -m_a`, whatever the pressures are."""

    def flows(x: NamedValues, u: NamedValues, p: NamedValues) -> tuple[Terms, Terms]:
        into_a = p.K2 * p.P_S * u.u / 2
        return {"valve_flow": into_a}, {"valve_flow": -into_a}

    return Valve(flows, (K2,))


def iso6358_valve(
    opening: str = "linear", *, dead_zone: bool = False, lag: bool = False, unequal: bool = False
) -> Valve:
    """Equation 10.1 at the four edges of the spool, each with the conductance `C (max(+-w - d, 0) / u_ref)^q`.

    `w` is the voltage, or with `lag` the spool behind it, `tau_v w' = u - w` (a state, in volt). `d` is there with
    `dead_zone`, `q` with the opening `"power"` (`"linear"`: 1). `unequal` gives the edges of chamber B `C_ratio` times
    the conductance.
    """
    if opening not in OPENINGS:
        raise ModelError(f"opening {opening!r} of a valve is unknown; {nearest(opening, OPENINGS)}")

    def conductance(w: Expression, p: NamedValues) -> Expression:
        """Of the edges that a positive `w` opens."""
        share = ca.fmax(w - p.d if dead_zone else w, 0) / p.u_ref
        return p.C * (ca.fmax(share, SHUT) ** p.q if opening == "power" else share)

    def flows(x: NamedValues, u: NamedValues, p: NamedValues) -> tuple[Terms, Terms]:
        w = x.w if lag else u.u
        forth, back = conductance(w, p), conductance(-w, p)
        ratio = p.C_ratio if unequal else 1
        return (
            {"filling": flow(forth, p.P_S, x.p_a, p), "venting": -flow(back, x.p_a, p.P_a, p)},
            {"filling": flow(ratio * back, p.P_S, x.p_b, p), "venting": -flow(ratio * forth, x.p_b, p.P_a, p)},
        )

    def balances(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        return [Balance("spool", "V", p.tau_v, "w", voltage=u.u, spool=-x.w)]

    parameters = [CONDUCTANCE[opening], REFERENCE, CRITICAL]
    parameters += [EXPONENT] * (opening == "power") + [DEAD_ZONE] * dead_zone + [LAG] * lag + [RATIO] * unequal
    states = (
        (State("w", "V", relaxing=True, description="spool position, as the voltage that would hold it"),)
        if lag
        else ()
    )
    return Valve(flows, tuple(parameters), states, balances if lag else None, (BETWEEN_0_AND_1,))


def flow(conductance: Expression, upstream: Expression, downstream: Expression, p: NamedValues) -> Expression:
    """Mass flow [kg/s] from `upstream` to `downstream`, negative where the latter is higher (eq. 10.1, `T_u = T_a`)."""
    high = ca.fmax(upstream, downstream)
    # 1 - (r - b) / (1 - b) between -1 and 1, with the sign of the flow; phi^2 is this times (2 - its size)
    fall = ca.fmin(ca.fmax((upstream - downstream) / ((1 - p.b) * high), -1), 1)
    square = fall * (2 - ca.fabs(fall))
    return conductance * p.rho_a * high * square / ca.sqrt(ca.fmax(ca.fabs(square), LAMINAR))
