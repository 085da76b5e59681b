"""Pneumatic cylinder as the paper's state-space form: position, velocity, acceleration (eqs. 10.8, 10.9). SI units.

The linear chain of `models.pneumatic_cylinder` with the pressures eliminated, `a = A (p_a - p_b) / M - f_v v`::

    s' = v
    v' = a
    a' = - (2 P_S A^2 / (M V)) v - f_v a + (2 P_a K2 P_S A / (rho_a M V)) u

The response from `u` to `s` is that of `pneumatic_cylinder`, constant for constant; the pressures, and with them the
place for a force or a leakage, are gone. `f_v` is mass-normalised, in 1/s.

Source: Linear ARX modelling of pneumatic actuator system (book chapter 10), section 10.2.4.
"""

from greybox import Balance, Input, Model, Output, State
from models.pneumatic_cylinder import pneumatic_cylinder


def balances(x, u, p):
    spring = 2 * p.P_S * p.A_piston**2 / (p.M_piston * p.V_total)  # wn^2
    valve = 2 * p.P_a * p.K2 * p.P_S * p.A_piston / (p.rho_a * p.M_piston * p.V_total)
    return [
        Balance("position", "m/s", 1, "s", velocity=x.v),
        Balance("velocity", "m/s**2", 1, "v", acceleration=x.a),
        # eq. 10.8
        Balance(
            "acceleration", "m/s**3", 1, "a", air_spring=-spring * x.v, viscous=-p.f_v * x.a, valve_flow=valve * u.u
        ),
    ]


pneumatic_pva = Model(
    "pneumatic_pva",
    states=[
        State("s", "m", role="displacement", description="piston displacement from mid-stroke"),
        State("v", "m/s", role="velocity", description="piston velocity"),
        State("a", "m/s**2", description="piston acceleration"),
    ],
    inputs=[Input("u", "V", role="valve", description="valve voltage, eq. 10.2")],
    outputs=[Output("s", "m", description="piston displacement")],
    parameters=pneumatic_cylinder.parameters,
    balances=balances,
    description="double-acting cylinder with a proportional valve, position-velocity-acceleration form",
    source="Linear ARX modelling of pneumatic actuator system (chapter 10), section 10.2.4, eq. 10.9",
)
