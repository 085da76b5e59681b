"""Two small plants with published constants."""

import numpy as np

from greybox import Balance, Model, Output, Parameter, State
from greybox.estimation.options import FitOptions

REST = FitOptions(at_rest=True)

# Rooney and Biegler 2001: y = a (1 - exp(-b t)), stated as the balance that it solves.
SATURATION = Model(
    "saturation",
    [State("y", "m", 0.0)],
    [],
    [Output("y", "m")],
    [Parameter("a", "m", 15.0, (1.0, 100.0)), Parameter("b", "1/s", 0.5, (0.01, 10.0))],
    lambda x, u, p: [Balance("uptake", "m/s", 1, "y", gap=p.b * (p.a - x.y))],
)
TIMES, VALUES = np.array([1.0, 2, 3, 4, 5, 7]), np.array([8.3, 10.3, 19.0, 16.0, 15.6, 19.8])

PREY = Model(
    "prey",
    [State("x1", "1", 1.0), State("x2", "1", 1.0)],
    [],
    [Output("x1", "1"), Output("x2", "1")],
    [
        Parameter("beta", "1/s", 1.0, (0.01, 10.0)),
        Parameter("delta", "1/s", 0.5, (0.01, 10.0)),
        Parameter("one", "1/s", 1.0, fixed=True),
    ],
    lambda x, u, p: [
        Balance("first", "1/s", 1, "x1", death=-p.one * x.x1, birth=p.beta * x.x1 * x.x2),
        Balance("second", "1/s", 1, "x2", birth=p.one * x.x2, death=-p.delta * x.x1 * x.x2),
    ],
)
