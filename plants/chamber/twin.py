"""A simulated chamber to try things on: `python twin.py` writes train.csv and test.csv.

The twin has what the model lacks: the pressure arrives at the end of the hose 30 ms after it left the regulator.
Change its constants, or take it away.
"""

import numpy as np
from rk4 import draw_steps, simulate, write_record

V, R, T, AIR, HOSE, LEAK = 5e-5, 287.05, 293.15, 101325.0, 1.6e-14, 2.4e-15
SAMPLING_TIME, ROWS = 5e-3, 3000
DELAY_ROWS = 6
NOISE = {"p [Pa]": 200.0}


def rate(x, u):
    return np.array([R * T / V * (HOSE * (u[0] ** 2 - x[0] ** 2) - LEAK * (x[0] ** 2 - AIR**2))])


for file, seed in (("train.csv", 1), ("test.csv", 2)):
    rng = np.random.default_rng(seed)
    command = np.concatenate([np.full(50, AIR), draw_steps(rng, ROWS - 50, 70, AIR, 2.5 * AIR)])
    arriving = np.concatenate([np.full(DELAY_ROWS, AIR), command[:-DELAY_ROWS]])
    states = simulate(rate, [AIR], arriving[:, None], SAMPLING_TIME, substeps=4)
    noisy = {name: y + NOISE[name] * rng.standard_normal(ROWS) for name, y in zip(NOISE, states.T, strict=True)}
    write_record(file, SAMPLING_TIME, {"p_in [Pa]": command, **noisy})
