"""A rig as a program, without greybox: a mass on a hardening spring. ``rig_program.py MODE INPUT RECORD [NUMBER]``."""

import csv
import sys
import time

import numpy as np

mode, asked, target = sys.argv[1:4]
MASS, DAMPING, STIFFNESS, HARDENING, NOISE = 1.1, 0.6, 11.0, 120.0, 1e-3
if mode == "fail":
    print("the amplifier is off")
    sys.exit(3)
if mode == "hang":
    time.sleep(60)
if mode == "silent":
    sys.exit(0)
with open(asked, newline="", encoding="utf-8") as file:
    rows = list(csv.reader(file))[1:]
t, force = np.array(rows, float).T
if mode == "other":
    force = force[::-1]
strength = 12.0 if mode == "wild" else 1.0  # an amplifier with another gain
if mode == "plain":
    HARDENING = 0.0


def rate(state, u):
    x, v = state
    return np.array([v, (strength * u - DAMPING * v - STIFFNESS * x - HARDENING * x**3) / MASS])


state, positions, fine = np.zeros(2), [], 20
for k in range(len(t)):
    positions.append(state[0])
    h = (t[1] - t[0]) / fine
    for _ in range(fine):
        k1 = rate(state, force[k])
        k2 = rate(state + h / 2 * k1, force[k])
        k3 = rate(state + h / 2 * k2, force[k])
        k4 = rate(state + h * k3, force[k])
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
seed = int(sys.argv[4]) if len(sys.argv) > 4 else 0
measured = np.array(positions) + NOISE * np.random.default_rng(seed).standard_normal(len(t))
with open(target, "w", newline="", encoding="utf-8") as file:
    writer = csv.writer(file)
    writer.writerow(["time [s]", "F [N]", "x [m]"])
    writer.writerows(
        [repr(float(a)), repr(float(b)), repr(float(c))] for a, b, c in zip(t, force, measured, strict=True)
    )
