"""A pendulum whose constants were weighed, swung by a torque that is read: SciPy's run of it."""

import numpy as np
from scipy.integrate import solve_ivp

import greybox as gb
from fits.studies.measured_rigs import pendulum

# By scales and a ruler, to about one and two per cent.
WEIGHED = {"J": (0.147, 0.003), "mgl": (2.98, 0.03)}
NOISE = {"q": 1e-3}
WITH_FRICTION = pendulum().prior(**WEIGHED) + gb.effect("coulomb_friction")


def swung(gain=1.0, skew=0.0):
    """A swing under a held torque that reads ``gain`` times too large, and stamps by which too little time passes; LSODA's steps."""
    period, rows, friction, damping = 0.01, 600, 0.12, 0.03
    generator = np.random.default_rng(3)
    shown = np.repeat(generator.normal(size=rows // 30), 30) * 1.5
    q, w, path = 0.0, 0.0, []
    for torque in shown / gain:

        def rates(t, x, torque=torque):
            # The sign is smooth within a thousandth of the usual speed.
            loss = damping * x[1] + friction * np.tanh(x[1] / 2e-3)
            return [x[1], (torque - WEIGHED["mgl"][0] * np.sin(x[0]) - loss) / WEIGHED["J"][0]]

        path.append(q)
        run = solve_ivp(rates, (0.0, period * (1 + skew)), [q, w], method="LSODA", rtol=1e-8, atol=1e-10)
        q, w = run.y[:, -1]
    angle = np.array(path) + NOISE["q"] * generator.normal(size=rows)
    return gb.Experiment("swung", period * np.arange(rows), {"tau": shown}, {"q": angle})
