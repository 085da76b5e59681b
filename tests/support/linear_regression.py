"""A model that is linear in its parameters, so that a fit of it is a linear regression with a closed solution."""

import numpy as np

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State

REST = FitOptions(at_rest=True)

# y = a u + b u^2 + c: linear in its constants, beside a state that nothing measures and nothing asks for.
LINE = Model(
    "line",
    [State("s", "1")],
    [Input("u", "1")],
    [Output("y", "m", lambda x, u, p: p.a * u.u + p.b * u.u**2 + p.c)],
    [
        Parameter("a", "m", 0.5),
        Parameter("b", "m", 0.1),
        Parameter("c", "m", 0.0),
        Parameter("tau", "s", 1.0, fixed=True),
    ],
    lambda x, u, p: [Balance("rest", "1", p.tau, "s", decay=-x.s)],
)
NOISE = 0.3


def regression(rows=40, seed=1, louder=1.0):
    """A record of the line, its design matrix (N, 3) and measurements (N,); the noise may be louder than it is said to be."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=rows)
    design = np.column_stack([u, u**2, np.ones(rows)])
    y = design @ [1.2, -0.4, 0.7] + louder * NOISE * rng.normal(size=rows)
    return Experiment("line", np.arange(rows) * 0.1, {"u": u}, {"y": y}), design, y
