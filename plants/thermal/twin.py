"""A simulated block to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the heater starts to give less than commanded above 40 W. Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_steps, simulate, write_record

C, H, SENSOR = 520.0, 1.1, 12.0
LIMIT = 40.0  # W
SAMPLING_TIME, ROWS = 2.0, 2000
NOISE = {"S [K]": 0.02}


def rate(x, u):
    block, reading = x
    power, ambient = u
    return np.array([(min(power, LIMIT) - H * (block - ambient)) / C, (block - reading) / SENSOR])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    power = draw_steps(rng, ROWS, 80, 0, 60)
    ambient = 20 + 2 * np.sin(2 * np.pi * np.arange(ROWS) / ROWS)
    states = simulate(rate, [20.0, 20.0], np.stack([power, ambient], axis=1), SAMPLING_TIME, substeps=4)
    noisy = {"S [K]": states[:, 1] + NOISE["S [K]"] * rng.standard_normal(ROWS)}
    write_record(file, SAMPLING_TIME, {"P [W]": power, "Ta [K]": ambient, **noisy})
