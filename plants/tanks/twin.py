"""Two simulated tanks to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the pump delivers nothing below 0.8 V. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_steps, simulate, write_record

A1, A2, OUTLET1, OUTLET2, PUMP, G = 0.015, 0.015, 2.6e-5, 2.4e-5, 1.3e-5, 9.81
DEAD_ZONE = 0.8  # V
SAMPLING_TIME, ROWS = 4.0, 2000
NOISE = {"h1 [m]": 5e-4, "h2 [m]": 5e-4}


def rate(x, u):
    upper = OUTLET1 * np.sqrt(2 * G * max(x[0], 0.0))
    lower = OUTLET2 * np.sqrt(2 * G * max(x[1], 0.0))
    return np.array([(PUMP * max(u[0] - DEAD_ZONE, 0.0) - upper) / A1, (upper - lower) / A2])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    voltage = draw_steps(rng, ROWS, 60, 0.0, 6.0)
    states = simulate(rate, [0.10, 0.10], voltage[:, None], SAMPLING_TIME, substeps=4)
    outputs = dict(zip(NOISE, states.T, strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"u [V]": voltage, **noisy})
