"""Simulated tanks in series to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the last tank leaks through a narrow gap, in proportion to its level.
Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_steps, simulate, write_record

A, OUTLET, PUMP, G = 0.015, 2.4e-5, 1.3e-5, 9.81
LEAK = 4e-5  # m^2/s
SAMPLING_TIME, ROWS = 5.0, 2000
NOISE = {"h1 [m]": 5e-4, "h3 [m]": 5e-4}


def rate(x, u):
    flows = OUTLET * np.sqrt(2 * G * np.maximum(x, 0.0))
    inflows = np.array([PUMP * u[0], *flows[:-1]])
    leaks = np.array([0.0, 0.0, LEAK * x[2]])
    return (inflows - flows - leaks) / A


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    voltage = draw_steps(rng, ROWS, 80, 0.5, 5.0)
    states = simulate(rate, [0.10, 0.10, 0.10], voltage[:, None], SAMPLING_TIME, substeps=4)
    outputs = dict(zip(NOISE, states.T[[0, 2]], strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"u [V]": voltage, **noisy})
