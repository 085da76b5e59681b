"""The numbers that the pneumatic ARX paper prints (chapter 10, Linear ARX modelling of pneumatic actuator system).

Position is in the unit of the sensor, which the paper does not name.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from greybox.comparison.blackbox.polynomial import PolynomialModel

SAMPLING_TIME = 0.01  # s
# Table 10.2 by input: mean, largest, smallest value in V, variance (N - 1) in V^2, over 10001 samples in 100 s.
TABLE_10_2 = {
    "u1": (4.5e-4, 4.5, -3.9878, 4.3770),
    "u2": (4.5e-4, 4.5, -3.9308, 3.5645),
    "u3": (3.5e-4, 3.5, -3.1562, 2.5637),
}
AMPLITUDES_10_10 = {"u1": (0.5, 1.5, 2.5), "u2": (0.8, 0.5, 3.0), "u3": (0.75, 0.75, 2.5)}  # V; two of them misprinted


@dataclass(frozen=True)
class Cell:
    """Best fit in percent, loss function and mean square error of one model on one experiment."""

    best_fit: float
    loss: float
    mse: float


EXPERIMENTS = tuple(f"u{i}_{k}" for i in (1, 2, 3) for k in (1, 2, 3))
ORDERS, DELAYS = (2, 3, 4), (0, 1, 2)
_ROWS = {
    0: """
        65.93 5.02e-4 0.2917  67.86 5.50e-4 0.2595  78.73 1.91e-3 0.1137
        78.98 4.15e-4 0.1107  78.68 5.18e-4 0.1140  78.71 1.63e-3 0.1137
        61.10 4.98e-4 0.3744  63.23 5.23e-4 0.3346  75.02 1.72e-3 0.1544
        90.24 3.91e-4 0.0697  87.68 3.98e-4 0.1109  88.93 1.86e-3 0.0896
        91.83 4.20e-4 0.0490  89.98 3.95e-4 0.0737  91.91 1.78e-3 0.0481
        93.04 3.82e-4 0.0363  90.71 3.83e-4 0.0645  92.84 2.30e-3 0.0384
        87.88 4.47e-4 0.0311  68.02 2.37e-4 0.2164  72.44 1.34e-3 0.1607
        85.04 4.34e-4 0.0482  65.70 2.50e-4 0.2533  69.07 1.29e-3 0.2060
        89.30 4.27e-4 0.0243  71.97 2.51e-4 0.1667  80.83 1.22e-3 0.0780""",
    1: """
        65.96 4.68e-4 0.2911  69.89 5.31e-4 0.2277  76.114 1.91e-3 0.1433
        79.01 3.99e-4 0.1105  78.71 5.21e-4 0.1136  78.712 1.63e-3 0.1136
        61.18 4.71e-4 0.3730  67.82 4.92e-4 0.2563  77.781 1.72e-3 0.1222
        90.32 3.88e-4 0.0685  87.93 3.96e-4 0.1066  89.058 1.86e-3 0.0875
        91.94 4.18e-4 0.0477  90.35 4.00e-4 0.0683  91.940 1.78e-3 0.0477
        93.10 3.81e-4 0.0356  90.65 3.80e-4 0.0654  92.883 2.29e-3 0.0379
        87.78 4.47e-4 0.0316  68.14 2.37e-4 0.2148  72.787 1.34e-3 0.1567
        84.95 4.33e-4 0.0488  65.59 2.52e-4 0.2549  69.856 1.30e-3 0.1956
        89.10 4.27e-4 0.0252  72.50 2.55e-4 0.1604  81.363 1.22e-3 0.0737""",
    2: """
        66.49 4.17e-4 0.2822  70.37 5.46e-4 0.2205  76.787 1.92e-3 0.1354
        79.03 3.88e-4 0.1102  78.15 5.32e-4 0.1197  78.670 1.63e-3 0.1141
        61.89 4.28e-4 0.3594  66.93 5.11e-4 0.2707  76.546 1.72e-3 0.1361
        90.44 3.85e-4 0.0669  88.23 4.00e-4 0.1013  89.388 1.86e-3 0.0823
        92.02 4.18e-4 0.0468  90.44 4.02e-4 0.0671  91.857 1.79e-3 0.0487
        93.13 3.80e-4 0.0353  90.75 3.84e-4 0.0641  92.730 2.30e-3 0.0396
        88.44 4.46e-4 0.0283  66.70 2.43e-4 0.2346  69.635 1.34e-3 0.1951
        85.81 4.31e-4 0.0434  66.15 2.59e-4 0.2468  69.166 1.29e-3 0.2047
        89.41 4.26e-4 0.0238  73.16 2.60e-4 0.1528  78.662 1.22e-3 0.0966""",
}


def _read(text: str) -> dict[str, dict[int, Cell]]:
    lines = [[float(word) for word in line.split()] for line in text.strip().splitlines()]
    return {
        name: {n: Cell(*line[3 * i : 3 * i + 3]) for i, n in enumerate(ORDERS)}
        for name, line in zip(EXPERIMENTS, lines, strict=True)
    }


# Tables 10.3 (nk = 0), 10.4 (nk = 1) and 10.5 (nk = 2): TABLES[nk][experiment][order].
TABLES = {nk: _read(text) for nk, text in _ROWS.items()}

# Equation 10.12 by nk: a1, a2, b1, b2 of the model of experiment u2_3.
EQUATION_10_12 = {
    0: (-1.988, 0.9876, 0.007788, -0.007671),
    1: (-1.988, 0.9885, 0.007966, -0.007856),
    2: (-1.988, 0.9893, 0.008141, -0.00804),
}


def variance(experiment: str) -> np.ndarray:
    """Variance of position that each of the nine cells of an experiment implies: ``MSE / (1 - BF / 100)^2``."""
    return np.array(
        [c.mse / (1 - c.best_fit / 100) ** 2 for table in TABLES.values() for c in table[experiment].values()]
    )


def median_losses(order: int, nk: int = 0) -> np.ndarray:
    """Median loss over the experiments of each input."""
    table = TABLES[nk]
    return np.array([np.median([row[order].loss for e, row in table.items() if e.startswith(u)]) for u in TABLE_10_2])


def model(nk: int, **changed: float) -> PolynomialModel:
    """Equation 10.12 as printed, with some of ``a1``, ``a2``, ``b1``, ``b2`` changed."""
    a1, a2, b1, b2 = (dict(zip(("a1", "a2", "b1", "b2"), EQUATION_10_12[nk], strict=True)) | changed).values()
    return PolynomialModel(
        "arx", "y", ("u",), SAMPLING_TIME, (nk,), (np.array([0.0] * nk + [b1, b2]),), a=np.array([1, a1, a2])
    )
