"""A simulated drive to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: dry friction in the bearing. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_multisine, draw_steps, simulate, write_record

J, B, KT, RA, LA = 2.6e-4, 3.1e-4, 0.043, 1.2, 1.1e-3
FRICTION = 0.012  # N m
SAMPLING_TIME, ROWS = 2e-3, 3000
NOISE = {"w [rad/s]": 0.3, "i [A]": 0.01}


def rate(x, u):
    speed, current = x
    friction = FRICTION * np.tanh(speed / 0.05)
    return np.array([(KT * current - B * speed - friction) / J, (u[0] - RA * current - KT * speed) / LA])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    voltage = draw_steps(rng, ROWS, 250, -12, 12) + draw_multisine(rng, ROWS, SAMPLING_TIME, 0.2, 20, 2.0)
    states = simulate(rate, [0.0, 0.0], voltage[:, None], SAMPLING_TIME, substeps=20)
    outputs = dict(zip(NOISE, states.T, strict=True))
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in outputs.items()}
    write_record(file, SAMPLING_TIME, {"u [V]": voltage, **noisy})
