"""A direct-current motor that turns a load: voltage in, speed and current out. SI units.

    J w'  = Kt i - B w
    La i' = u - Ra i - Kt w

The torque constant is the constant of the back electromotive force, too. Speed and current together determine all
constants but one common scale, which the resistance from the data sheet closes.
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("torque", "N*m", p.J, "w", motor=p.Kt * x.i, viscous=-p.B * x.w),
        Balance("voltage", "V", p.La, "i", source=u.u, resistance=-p.Ra * x.i, back_emf=-p.Kt * x.w),
    ]


rotary_drive = Model(
    "rotary_drive",
    states=[
        State("w", "rad/s", role="velocity", description="speed of the shaft"),
        State("i", "A", role="current", description="current"),
    ],
    inputs=[Input("u", "V", role="drive", description="voltage")],
    outputs=[Output("w", "rad/s", description="speed"), Output("i", "A", description="current")],
    parameters=[
        Parameter(
            "J", "kg*m^2", 2e-4, (1e-6, 1e-1), role="mass", source="assumed", description="inertia, load included"
        ),
        Parameter("B", "N*m*s", 2e-4, (1e-7, 1.0), role="damping", source="assumed", description="bearing and windage"),
        Parameter(
            "Kt", "N*m/A", 0.04, (1e-4, 10.0), role="force_constant", source="data sheet", description="torque constant"
        ),
        Parameter(
            "Ra", "ohm", 1.2, (1e-2, 1e3), fixed=True, role="resistance", source="data sheet", description="resistance"
        ),
        Parameter("La", "H", 1.5e-3, (1e-6, 1.0), role="inductance", source="data sheet", description="inductance"),
    ],
    balances=balances,
    description="motor with a load on its shaft",
)
