"""A simulated circuit to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the source is an amplifier that clips at 8 V. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_multisine, simulate, write_record

R, L, C = 26.0, 6.1e-3, 1.7e-6
CLIP = 8.0  # V
SAMPLING_TIME, ROWS = 2e-5, 3000
NOISE = {"uC [V]": 0.01, "i [A]": 1e-3}


def rate(x, u):
    charge, current = x
    source = min(max(u[0], -CLIP), CLIP)
    return np.array([current, (source - R * current - charge / C) / L])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    voltage = draw_multisine(rng, ROWS, SAMPLING_TIME, 100, 3000, 5.0)
    states = simulate(rate, [0.0, 0.0], voltage[:, None], SAMPLING_TIME, substeps=10)
    outputs = dict(zip(NOISE, (states[:, 0] / C, states[:, 1]), strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"u [V]": voltage, **noisy})
