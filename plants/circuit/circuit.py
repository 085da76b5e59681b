"""A series circuit of coil, resistor and capacitor: voltage in, voltage of the capacitor and current out. SI units.

    L i' = u - R i - q / C
    q'   = i

The capacitor's charge is the "position" of the circuit and the current its "velocity".
"""

from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("charge", "A", 1, "q", current=x.i),
        Balance("voltage", "V", p.L, "i", source=u.u, resistance=-p.R * x.i, capacitor=-x.q / p.C),
    ]


circuit = Model(
    "circuit",
    states=[
        State("q", "C", role="charge", description="charge of the capacitor"),
        State("i", "A", role="current", description="current"),
    ],
    inputs=[Input("u", "V", role="drive", description="voltage of the source")],
    outputs=[
        Output("uC", "V", lambda x, u, p: x.q / p.C, description="voltage of the capacitor"),
        Output("i", "A", description="current"),
    ],
    parameters=[
        Parameter(
            "R",
            "ohm",
            20.0,
            (1e-2, 1e5),
            role="resistance",
            source="colour code",
            description="resistance, coil included",
        ),
        Parameter("L", "H", 5e-3, (1e-6, 10.0), role="inductance", source="data sheet", description="inductance"),
        Parameter("C", "F", 2e-6, (1e-12, 1.0), source="data sheet", description="capacity"),
    ],
    balances=balances,
    description="series resonant circuit",
)
