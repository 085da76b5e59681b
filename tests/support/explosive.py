"""A model whose state grows beyond all bounds within a moment."""

from greybox import Balance, Input, Model, Output, Parameter, State


def explosive() -> Model:
    """``dx/dt = a x^2``: infinite at ``t = 1 / (a x0)``, which is 20 ms."""
    return Model(
        "explosive",
        [State("x", "m", 1.0)],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter("a", "1/s/m", 50.0, (1e-3, 1e3))],
        lambda x, u, p: [Balance("growth", "m/s", 1, "x", square=p.a * x.x * x.x)],
    )
