"""Test signals that excite a plant: a multisine and a swept sine."""

from __future__ import annotations

import numpy as np

from greybox.errors import DataError

ROUNDING = 1e-9  # of half the sampling frequency: a band may end there, whatever the digits of the stamps


def multisine(time: np.ndarray, low: float, high: float, rms: float, generator: np.random.Generator) -> np.ndarray:
    """Equal sines at every multiple of one over the record's length from ``low`` to ``high`` (Hz), with random phases.

    ``time`` (N,) is uniform; the signal (N,) has the given ``rms`` and no mean. Raises DataError for a band without a
    line, and for one that reaches beyond half the sampling frequency.
    """
    n, step = len(time), float(time[1] - time[0])
    _check_top("multisine", high, step, high * step > 0.5 * (1 + ROUNDING))
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
    step = float(t[1])
    _check_top("chirp", high, step, high * step >= 0.5)
    sweep = (high - low) / (2 * t[-1])
    return amplitude * np.sin(2 * np.pi * (low * t + sweep * t**2))


def _check_top(signal: str, high: float, step: float, beyond: bool) -> None:
    """Refuse a band up to ``high`` (Hz) where it is ``beyond`` what samples every ``step`` seconds can show."""
    if beyond:
        raise DataError(
            f"a {signal} up to {high:g} Hz: samples every {step:g} s show frequencies below {0.5 / step:g} Hz alone; end it lower, or"
            " sample faster"
        )
