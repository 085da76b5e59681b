"""A decay from an amplitude: the simplest plant whose signal, and noise that grows with it, changes by decades."""

from functools import cache

from greybox import Balance, Model, Output, Parameter, State


@cache
def decay() -> Model:
    """y' = -k y, y(0) = A; y = A exp(-k t)."""
    return Model(
        "decay",
        states=[State("y", "g", lambda p: p.A)],
        inputs=[],
        outputs=[Output("y", "g")],
        parameters=[Parameter("A", "g", 3.0, (1e-3, 1e3)), Parameter("k", "1/s", 0.5, (1e-3, 10.0))],
        balances=lambda x, u, p: [Balance("rate", "g/s", 1, "y", loss=-p.k * x.y)],
    )
