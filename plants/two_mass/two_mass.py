"""Two inertias on an elastic shaft: torque at the motor in, both angles out. SI units.

    J1 w1' = T - d1 w1 - Tc
    J2 w2' = Tc - d2 w2
    Tc     = c (a1 - a2) + d (w1 - w2)

From the torque and one angle, too, all constants can be determined; the second encoder tells which body has a missing effect.
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    twist = p.c * (x.a1 - x.a2)
    slip = p.d * (x.w1 - x.w2)
    return [
        Balance("motor_angle", "rad/s", 1, "a1", speed=x.w1),
        Balance("motor_torque", "N*m", p.J1, "w1", drive=u.T, viscous=-p.d1 * x.w1, shaft=-twist, shaft_damping=-slip),
        Balance("load_angle", "rad/s", 1, "a2", speed=x.w2),
        Balance("load_torque", "N*m", p.J2, "w2", viscous=-p.d2 * x.w2, shaft=twist, shaft_damping=slip),
    ]


two_mass = Model(
    "two_mass",
    states=[
        State("a1", "rad", role="displacement", description="angle of the motor"),
        State("w1", "rad/s", role="velocity", description="speed of the motor"),
        State("a2", "rad", description="angle of the load"),
        State("w2", "rad/s", description="speed of the load"),
    ],
    inputs=[Input("T", "N*m", role="drive", description="torque of the motor")],
    outputs=[
        Output("a1", "rad", description="angle of the motor"),
        Output("a2", "rad", description="angle of the load"),
    ],
    parameters=[
        Parameter(
            "J1", "kg*m^2", 1.5e-3, (1e-6, 1.0), role="mass", source="assumed", description="inertia of the motor"
        ),
        Parameter("J2", "kg*m^2", 3e-3, (1e-6, 1.0), source="assumed", description="inertia of the load"),
        Parameter("c", "N*m/rad", 8.0, (1e-2, 1e5), source="assumed", description="stiffness of the shaft"),
        Parameter("d", "N*m*s/rad", 5e-3, (1e-6, 10.0), source="assumed", description="damping of the shaft"),
        Parameter(
            "d1", "N*m*s/rad", 1e-2, (1e-6, 10.0), role="damping", source="assumed", description="bearing of the motor"
        ),
        Parameter("d2", "N*m*s/rad", 1e-2, (1e-6, 10.0), source="assumed", description="bearing of the load"),
    ],
    balances=balances,
    description="motor, elastic shaft, load",
)
