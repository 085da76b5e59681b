"""A spring-guided stage moved by a voice coil whose current is controlled: current in, position out. SI units.

    x'   = v
    M v' = Kf i - B v - K x

From current and position alone `M`, `B`, `K` and `Kf` have one common scale: the force constant from the data sheet, or a
weighed mass, closes it.
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", coil=p.Kf * u.i, viscous=-p.B * x.v, spring=-p.K * x.x),
    ]


stage = Model(
    "stage",
    states=[
        State("x", "m", role="displacement", description="position"),
        State("v", "m/s", role="velocity", description="velocity"),
    ],
    inputs=[Input("i", "A", role="drive", description="current of the coil")],
    outputs=[Output("x", "m", description="position")],
    parameters=[
        Parameter("M", "kg", 0.5, (1e-3, 100.0), role="mass", source="assumed", description="moving mass"),
        Parameter("B", "N*s/m", 4.0, (1e-3, 1e4), role="damping", source="assumed", description="damping of the guide"),
        Parameter(
            "K", "N/m", 3000.0, (1.0, 1e7), role="stiffness", source="assumed", description="stiffness of the guide"
        ),
        Parameter(
            "Kf",
            "N/A",
            12.0,
            (1e-2, 1e3),
            fixed=True,
            role="force_constant",
            source="data sheet",
            description="force constant",
        ),
    ],
    balances=balances,
    description="voice-coil stage on leaf springs",
)
