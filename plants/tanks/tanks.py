"""Two tanks in cascade: a pump fills the upper one, which drains into the lower one. Both levels are measured. SI units.

    A1 h1' = kp u - a1 sqrt(2 g h1)
    A2 h2' = a1 sqrt(2 g h1) - a2 sqrt(2 g h2)

Outflow after Torricelli through holes of the effective areas `a1` and `a2`. The cross-sections are measured with a ruler.
"""

import math

import casadi as ca

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    upper = p.a1 * ca.sqrt(2 * p.g * x.h1)
    lower = p.a2 * ca.sqrt(2 * p.g * x.h2)
    return [
        Balance("upper_tank", "m^3/s", p.A1, "h1", pump=p.kp * u.u, outflow=-upper),
        Balance("lower_tank", "m^3/s", p.A2, "h2", inflow=upper, outflow=-lower),
    ]


tanks = Model(
    "tanks",
    states=[
        State("h1", "m", 0.10, (0.0, math.inf), role="upper_head", description="level of the upper tank"),
        State("h2", "m", 0.10, (0.0, math.inf), role="lower_head", description="level of the lower tank"),
    ],
    inputs=[Input("u", "V", role="drive", description="voltage of the pump")],
    outputs=[Output("h1", "m", description="upper level"), Output("h2", "m", description="lower level")],
    parameters=[
        Parameter("A1", "m^2", 0.015, fixed=True, source="ruler", description="cross-section of the upper tank"),
        Parameter("A2", "m^2", 0.015, fixed=True, source="ruler", description="cross-section of the lower tank"),
        Parameter("a1", "m^2", 2e-5, (1e-7, 1e-2), source="assumed", description="outlet of the upper tank"),
        Parameter("a2", "m^2", 2e-5, (1e-7, 1e-2), source="assumed", description="outlet of the lower tank"),
        Parameter("kp", "m^3/s/V", 1e-5, (1e-8, 1e-2), source="assumed", description="flow of the pump per volt"),
        Parameter("g", "m/s^2", 9.81, fixed=True, source="standard gravity", description="gravity"),
    ],
    balances=balances,
    description="pump and two tanks in cascade",
)
