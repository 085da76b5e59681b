"""A rig's equations over a sampled input: the classical Runge-Kutta method, without greybox."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np


def simulate(
    rate: Callable[[np.ndarray, np.ndarray], np.ndarray],
    start: Sequence[float],
    inputs: np.ndarray,
    sampling_time: float,
    substeps: int,
) -> np.ndarray:
    """States (N, nx) of ``x' = rate(x, u)`` at each row; ``inputs`` (N, nu) are held from one row to the next."""
    x, h = np.array(start, float), sampling_time / substeps
    states = np.empty((len(inputs), len(x)))
    for k, u in enumerate(inputs):
        states[k] = x
        for _ in range(substeps):
            k1 = rate(x, u)
            k2 = rate(x + 0.5 * h * k1, u)
            k3 = rate(x + 0.5 * h * k2, u)
            k4 = rate(x + h * k3, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return states


def draw_multisine(
    rng: np.random.Generator, rows: int, sampling_time: float, low: float, high: float, rms: float
) -> np.ndarray:
    """A signal (N,) with equal power at every frequency from ``low`` to ``high`` Hz, drawn phases, and the given rms value."""
    frequencies = np.fft.rfftfreq(rows, sampling_time)
    inside = (frequencies >= low) & (frequencies <= high)
    spectrum = np.where(inside, np.exp(2j * np.pi * rng.random(len(frequencies))), 0)
    signal = np.fft.irfft(spectrum, rows)
    return signal * rms / np.sqrt(np.mean(signal**2))


def draw_steps(rng: np.random.Generator, rows: int, length: int, low: float, high: float) -> np.ndarray:
    """Levels (N,) drawn between ``low`` and ``high``, each held for ``length`` rows."""
    levels = rng.uniform(low, high, -(-rows // length))
    return np.repeat(levels, length)[:rows]


def write_record(file: str, sampling_time: float, columns: dict[str, np.ndarray]) -> None:
    """A CSV file with a time column and one column for each signal; the keys are the headers, ``name [unit]``."""
    rows = len(next(iter(columns.values())))
    time = sampling_time * np.arange(rows)
    with Path(file).open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time [s]", *columns])
        writer.writerows(zip(time.tolist(), *(column.tolist() for column in columns.values()), strict=True))
    print(f"{file}: {rows} rows")
