"""A stage on a spring that a force drives and whose position is read: the rig that several tests of a search share."""

from greybox import Balance, Input, Model, Output, Parameter, State

STAGE = Model(
    "stage",
    states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity")],
    inputs=[Input("F", "N", role="drive")],
    outputs=[Output("x", "m")],
    parameters=[
        Parameter("M", "kg", 0.6, (0.01, 10.0)),
        Parameter("K", "N/m", 300.0, (1.0, 1e5)),
        Parameter("B", "N*s/m", 6.0, (0.01, 100.0)),
    ],
    balances=lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x, damping=-p.B * x.v),
    ],
)
