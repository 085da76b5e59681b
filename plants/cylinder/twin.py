"""A simulated cylinder to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the spool's lands overlap its ports, so that small commands move nothing.
Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_multisine, draw_steps, simulate, write_record

M, A, B, V, E, KQ, CL = 80.0, 1.2e-3, 1100.0, 6e-4, 7.5e8, 3.4e-5, 4e-12
OVERLAP = 0.25  # V
SAMPLING_TIME, ROWS = 2e-3, 3000
NOISE = {"x [m]": 2e-5, "pL [Pa]": 5e3}


def rate(x, u):
    _, velocity, pressure = x
    opening = u[0] - np.clip(u[0], -OVERLAP, OVERLAP)
    return np.array(
        [
            velocity,
            (A * pressure - B * velocity) / M,
            4 * E / V * (KQ * opening - A * velocity - CL * pressure),
        ]
    )


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    command = draw_steps(rng, ROWS, 150, -3, 3) + draw_multisine(rng, ROWS, SAMPLING_TIME, 0.5, 30, 1.0)
    states = simulate(rate, [0.0, 0.0, 0.0], command[:, None], SAMPLING_TIME, substeps=10)
    outputs = dict(zip(NOISE, (states[:, 0], states[:, 2]), strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"u [V]": command, **noisy})
