"""A simulated stage to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: leaf springs that stiffen with the deflection. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_multisine, simulate, write_record

M, B, K, KF = 0.62, 5.5, 2600.0, 12.0
CUBIC = 2e7  # N/m^3
SAMPLING_TIME, ROWS = 1e-3, 3000
NOISE = {"x [m]": 2e-6}


def rate(x, u):
    position, velocity = x
    return np.array([velocity, (KF * u[0] - B * velocity - K * position - CUBIC * position**3) / M])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    current = draw_multisine(rng, ROWS, SAMPLING_TIME, 0.5, 60, 0.35)
    states = simulate(rate, [0.0, 0.0], current[:, None], SAMPLING_TIME, substeps=10)
    noisy = {"x [m]": states[:, 0] + NOISE["x [m]"] * rng.standard_normal(ROWS)}
    write_record(file, SAMPLING_TIME, {"i [A]": current, **noisy})
