"""Models for tests that look at what a model writes."""

import math

from greybox import Balance, Input, Model, Output, Parameter, State


def actuator() -> Model:
    """The micro-motion actuator of the literature in its three balances."""

    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", coil=p.Kf * x.i, damping=-p.B * x.v, spring=-p.K * x.x),
            Balance("voltage", "V", p.La, "i", supply=u.u, resistance=-p.Ra * x.i, back_emf=-p.Kv * x.v),
        ]

    return Model(
        "actuator",
        states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity"), State("i", "A")],
        inputs=[Input("u", "V")],
        outputs=[Output("x", "m"), Output("i", "A")],
        parameters=[
            Parameter("M", "kg", 0.010, (1e-4, 1.0), source="weighed", fixed=True),
            Parameter("B", "N*s/m", 0.2691, (0.0, math.inf)),
            Parameter("K", "N/m", 5895.5, (10.0, 1e6)),
            Parameter("Kf", "N/A", 1.3932),
            Parameter("Kv", "V*s/m", 1.3932),
            Parameter("Ra", "ohm", 8.0),
            Parameter("La", "H", 0.5e-3, source="data sheet"),
        ],
        balances=balances,
        description="coil and flexure",
    )
