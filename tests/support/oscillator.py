"""A driven oscillator with a cubic spring: stable, or with two wells."""

from greybox.model.balance import Balance
from greybox.model.model import Model
from greybox.model.signals import Input, Output, Parameter, State

RANGE = (1e-3, 1e3)


def oscillator(name, d, k, c, b):
    """``v' = b u - d v - k x - c x^3``: hardening for k, c > 0, two wells (chaotic when driven) for k < 0."""
    return Model(
        name,
        [State("x", "m"), State("v", "m/s")],
        [Input("u", "m/s**2")],
        [Output("x", "m")],
        [
            Parameter("d", "1/s", d, RANGE),
            Parameter("k", "1/s**2", k, (-1e3, 1e3)),
            Parameter("c", "1/(m**2*s**2)", c, RANGE),
            Parameter("b", "1", b, RANGE),
        ],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance(
                "force",
                "m/s**2",
                1,
                "v",
                drive=p.b * u.u,
                damping=-p.d * x.v,
                spring=-p.k * x.x,
                hardening=-p.c * x.x**3,
            ),
        ],
    )
