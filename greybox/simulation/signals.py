"""Test signals that excite a plant: a multisine and a swept sine."""

from __future__ import annotations

import numpy as np

from greybox.errors import DataError


def multisine(time: np.ndarray, low: float, high: float, rms: float, generator: np.random.Generator) -> np.ndarray:
    """Equal sines at every multiple of one over the record's length from ``low`` to ``high`` (Hz), with random phases.

    ``time`` (N,) is uniform; the signal (N,) has the given ``rms`` and no mean. Raises DataError for a band without a
    line.
    """
    n, step = len(time), float(time[1] - time[0])
    frequency = np.fft.rfftfreq(n, step)
    lines = (frequency >= low) & (frequency <= high) & (frequency > 0) & (frequency < 0.5 / step)
    if not lines.any():
        raise DataError(
            f"a multisine from {low:g} to {high:g} Hz has no line in a record of {n} rows every {step:g} s, whose"
            f" lines lie {1 / (n * step):g} Hz apart below {0.5 / step:g} Hz; give another band"
        )
    phase = generator.uniform(0, 2 * np.pi, lines.sum())
    spectrum = np.zeros(len(frequency), complex)
    spectrum[lines] = np.exp(1j * phase)
    signal = np.fft.irfft(spectrum, n)
    return rms * signal / np.sqrt(np.mean(signal**2))


def chirp(time: np.ndarray, low: float, high: float, amplitude: float) -> np.ndarray:
    """A sine whose frequency runs evenly from ``low`` to ``high`` (Hz) over ``time`` (N,), starting at zero.

    Raises DataError where ``high`` reaches half the sampling frequency: beyond, the samples show a lower frequency.
    """
    t = time - time[0]
    fastest = 0.5 / float(time[1] - time[0])
    if high >= fastest:
        raise DataError(
            f"a chirp up to {high:g} Hz: samples every {0.5 / fastest:g} s show frequencies below {fastest:g} Hz alone;"
            " end it lower, or sample faster"
        )
    sweep = (high - low) / (2 * t[-1])
    return amplitude * np.sin(2 * np.pi * (low * t + sweep * t**2))
