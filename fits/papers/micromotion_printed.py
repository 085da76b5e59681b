"""The numbers that Wang's paper prints (Micro motion actuator of compliant mechanism for parameter estimation).

Errors are mean squares of a free run over the whole record, in um^2 (equation 1), whatever the paper's text calls them; time in
seconds, displacement in um, voltage in V.
"""

from __future__ import annotations

import numpy as np

from fits.papers.micromotion_smoothing import DrawIntervals, MonteCarloSmoothing, StepResponseConstants

SAMPLING_TIME = 2.5e-4
DELAYS, ORDERS = (1, 2, 3), (2, 3, 4, 5)  # rows and columns of Tables 1 and 2
TABLE_1 = np.array([[27.128, 17.442, 12.911, 10.189], [27.541, 16.490, 10.660, 7.087], [28.008, 16.194, 9.474, 5.370]])
TABLE_2 = np.array([[5.818, 4.486, 5.136, 4.952], [5.376, 2.513, 2.546, 2.693], [5.309, 2.281, 1.729, 1.871]])
# Table 3: direct (D-E) and smoothed (S-E), in the order of `fits.papers.micromotion_smoothing.NUMERATOR_STRUCTURES`.
TABLE_3_DIRECT = (16.241, 16.281, 16.549, 16.959, 27.539, 27.716, 27.891)
TABLE_3_SMOOTHED = (None, None, None, None, 0.652, 13.614, 9.925)

# Section 4.2: the intervals of the Monte-Carlo search, the specification ("less than 1 um"), and its result.
INTERVALS = DrawIntervals(
    amplitude=(28.09, 31.44), ratio=(0.0, 1.0), phase=(0.48, 1.24), frequency=(739.0, 785.0), decay=(12.0, 36.0)
)
SPECIFICATION = 1.0
SMOOTHED = StepResponseConstants(
    amplitude=29.539, ratio=0.915, phase=1.235, frequency=767.977, decay=25.596, error=0.652
)
SPECTRAL_PEAK = 760.8545  # rad/s, figure 6
DISCRETE_B, DISCRETE_A = (4.030, -8.919, 5.969), (1.0, -1.951, 0.987)
S_NUMERATOR, S_DENOMINATOR = (4.03, -5970.61, 17441286.92), (1.0, 51.19, 590444.53)


def smoothing(samples: int) -> MonteCarloSmoothing:
    """The printed result as a model, for a record of so many rows."""
    return MonteCarloSmoothing("x", "u", SAMPLING_TIME, 1.0, SMOOTHED, samples)
