"""Tanks in series: a pump fills the first, each drains into the next. The first and the last level are measured. SI units.

    A h1' = kp u - a sqrt(2 g h1)
    A hk' = a sqrt(2 g h(k-1)) - a sqrt(2 g hk)        k = 2 .. N

Outflow after Torricelli. The tanks are alike: one cross-section `A`, measured with a ruler, and one effective area `a` of the
outlets. `N` below is the number of tanks.
"""

import math

import casadi as ca

from greybox import Balance, Input, Model, Output, Parameter, State

N = 3
LEVELS = [f"h{k}" for k in range(1, N + 1)]


def balances(x, u, p):
    # Torricelli: the flow out of each tank, and into the next.
    flows = [p.kp * u.u, *(p.a * ca.sqrt(2 * p.g * x[level]) for level in LEVELS)]
    return [
        Balance(f"tank_{k}", "m^3/s", p.A, level, inflow=flows[k - 1], outflow=-flows[k])
        for k, level in enumerate(LEVELS, 1)
    ]


tank_chain = Model(
    "tank_chain",
    states=[
        State(level, "m", 0.10, (0.0, math.inf), role="level", description=f"level of tank {k}")
        for k, level in enumerate(LEVELS, 1)
    ],
    inputs=[Input("u", "V", role="drive", description="voltage of the pump")],
    outputs=[
        Output(LEVELS[0], "m", description="level of the first tank"),
        Output(LEVELS[-1], "m", description="level of the last tank"),
    ],
    parameters=[
        Parameter("A", "m^2", 0.015, fixed=True, source="ruler", description="cross-section of each tank"),
        Parameter("a", "m^2", 2e-5, (1e-7, 1e-2), source="assumed", description="effective area of each outlet"),
        Parameter("kp", "m^3/s/V", 1e-5, (1e-8, 1e-2), source="assumed", description="flow of the pump per volt"),
        Parameter("g", "m/s^2", 9.81, fixed=True, source="standard gravity", description="gravity"),
    ],
    balances=balances,
    description=f"pump and {N} tanks in series",
)
