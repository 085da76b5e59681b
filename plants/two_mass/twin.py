"""A simulated pair of inertias to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: dry friction at the motor. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_multisine, draw_steps, simulate, write_record

J1, J2, C, D, D1, D2 = 1.2e-3, 2.4e-3, 11.0, 4e-3, 2e-2, 3e-2
FRICTION = 0.015  # N m
SAMPLING_TIME, ROWS = 2e-3, 3000
NOISE = {"a1 [rad]": 1e-3, "a2 [rad]": 1e-3}


def rate(x, u):
    a1, w1, a2, w2 = x
    shaft = C * (a1 - a2) + D * (w1 - w2)
    friction = FRICTION * np.tanh(w1 / 0.02)
    return np.array([w1, (u[0] - D1 * w1 - shaft - friction) / J1, w2, (shaft - D2 * w2) / J2])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    torque = draw_steps(rng, ROWS, 200, -0.2, 0.2) + draw_multisine(rng, ROWS, SAMPLING_TIME, 0.5, 40, 0.15)
    states = simulate(rate, [0.0, 0.0, 0.0, 0.0], torque[:, None], SAMPLING_TIME, substeps=20)
    outputs = dict(zip(NOISE, (states[:, 0], states[:, 2]), strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"T [N*m]": torque, **noisy})
