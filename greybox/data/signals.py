"""Test signals that excite a plant: multisine, swept sine (chirp), steps, and pseudo-random binary sequences (PRBS).

Each signal is an array over given times, for `greybox.simulate` or for driving a rig. Which one: a multisine puts its power exactly
where it is wanted and repeats, which shows the noise; a chirp is smooth and easy on a rig; steps show gains and slow motion; a PRBS
has the most power that a limited amplitude allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from greybox.base import TIME_ROUNDING, DataError

__all__ = ["SignalLimit", "chirp", "multisine", "prbs", "steps"]


def multisine(time: np.ndarray, low: float, high: float, rms: float, generator: np.random.Generator) -> np.ndarray:
    """Sines of equal amplitude at every multiple of one over the record's length in a band, with random phases.

    Parameters
    ----------
    time : array (N,)
        Uniform times in seconds.
    low, high
        The band in Hz; ``high`` at most half the sampling frequency.
    rms
        Root mean square of the signal, in its unit.
    generator
        Draws the phases.

    Returns
    -------
    array (N,)
        A signal without mean, periodic over the record.

    Raises
    ------
    DataError
        For an RMS value that is not above zero, for a band without a line, and for one that reaches beyond half the sampling
        frequency.

    Examples
    --------
    >>> time = 1e-3 * np.arange(1000)
    >>> u = multisine(time, 5, 100, 2.0, np.random.default_rng(0))
    >>> round(float(np.sqrt(np.mean(u**2))), 6)
    2.0
    """
    if not rms > 0:
        raise DataError(f"a multisine with an RMS value of {rms:g}; give a number above 0")
    n, step = len(time), float(time[1] - time[0])
    # A band may end at half the sampling rate, the rounding of the times aside.
    _check_highest_frequency("multisine", high, step, high * step > 0.5 * (1 + TIME_ROUNDING))
    frequency = np.fft.rfftfreq(n, step)
    # Neither the mean nor the line at half the sampling rate: both are real.
    lines = (frequency >= low) & (frequency <= high) & (frequency > 0) & (frequency < 0.5 / step)
    if not lines.any():
        raise DataError(
            f"a multisine from {low:g} to {high:g} Hz has no line in a record of {n} rows every {step:g} s, whose"
            f" lines lie {1 / (n * step):g} Hz apart below {0.5 / step:g} Hz; give another band"
        )
    # Random phases spread the lines over the record: equal ones would meet in one peak.
    phase = generator.uniform(0, 2 * np.pi, lines.sum())
    spectrum = np.zeros(len(frequency), complex)
    spectrum[lines] = np.exp(1j * phase)
    signal = np.fft.irfft(spectrum, n)
    # The lines have equal amplitudes; their common size follows from the rms.
    return rms * signal / np.sqrt(np.mean(signal**2))


def chirp(time: np.ndarray, low: float, high: float, amplitude: float) -> np.ndarray:
    """A sine whose frequency runs evenly from ``low`` to ``high``, starting at zero.

    Parameters
    ----------
    time : array (N,)
        Uniform times in seconds.
    low, high
        First and last frequency in Hz; both below half the sampling frequency.
    amplitude
        Amplitude of the sine, in the signal's unit.

    Returns
    -------
    array (N,)
        The swept sine.

    Raises
    ------
    DataError
        Where ``high`` reaches half the sampling frequency: beyond, the samples show a lower frequency.

    Examples
    --------
    >>> u = chirp(1e-3 * np.arange(1000), 1, 50, 2.0)
    """
    t = time - time[0]
    step = float(t[1])
    _check_highest_frequency("chirp", high, step, high * step >= 0.5)
    # f(t) = low + (high - low) t / T, and its phase 2 pi (low t + (high - low) t^2 / (2 T)).
    sweep = (high - low) / (2 * t[-1])
    return amplitude * np.sin(2 * np.pi * (low * t + sweep * t**2))


def steps(time: np.ndarray, at: ArrayLike, levels: ArrayLike, initial: float = 0.0) -> np.ndarray:
    """A signal that is constant between steps.

    Parameters
    ----------
    time : array (N,)
        Times in seconds.
    at : array (k,)
        Times in seconds at which the signal changes, increasing. A row at exactly such a time has the new level.
    levels : array (k,)
        The level from each of these times on, in the signal's unit.
    initial
        The level before the first step.

    Returns
    -------
    array (N,)
        The levels over time.

    Raises
    ------
    DataError
        For another number of levels than of times, times that do not increase, and values that are not finite.

    Examples
    --------
    >>> steps(np.arange(5.0), at=[1, 3], levels=[2.0, -1.0]).tolist()
    [0.0, 2.0, 2.0, -1.0, -1.0]
    """
    changes, values = np.atleast_1d(np.asarray(at, float)), np.atleast_1d(np.asarray(levels, float))
    if changes.ndim != 1 or changes.shape != values.shape:
        raise DataError(f"steps: {values.size} levels for {changes.size} times; give one level for each time")
    if not (np.isfinite(changes).all() and np.isfinite(values).all() and np.isfinite(initial)):
        raise DataError("steps: times and levels must be finite numbers")
    if np.any(np.diff(changes) <= 0):
        raise DataError("steps: times must increase; sort them, and give each step once")
    # How many changes a row has behind it, those at its own time included, is the number of its level.
    return np.concatenate([[initial], values])[np.searchsorted(changes, np.asarray(time, float), side="right")]


def prbs(
    time: np.ndarray, order: int, levels: Sequence[float] = (-1.0, 1.0), hold: int = 1, state: ArrayLike | None = None
) -> np.ndarray:
    """A pseudo-random binary sequence: two levels that alternate like a coin, from a shift register of maximal length.

    It repeats after ``(2**order - 1) * hold`` rows. Over one period its autocorrelation is that of white noise but for one part in
    ``2**order - 1``, and its spectrum is flat up to about a third of ``1 / (hold * sampling time)`` (Ljung, System identification,
    2nd ed., section 13.3). The sequence is that of `scipy.signal.max_len_seq`.

    Parameters
    ----------
    time : array (N,)
        Uniform times in seconds.
    order
        Stages of the shift register, 2 to 32.
    levels
        The two levels, in the signal's unit.
    hold
        Rows for which each value is held: moves the power to lower frequencies.
    state : array (order,), optional
        Contents of the register at the start, zeros and ones, not all zero; another state shifts the sequence. All ones if left out.

    Returns
    -------
    array (N,)
        The sequence, repeated as often as ``time`` is long.

    Raises
    ------
    DataError
        For an order outside 2 to 32, a hold below one row, other than two levels, or an empty register.

    Examples
    --------
    >>> u = prbs(1e-3 * np.arange(7), order=3)
    >>> sorted(set(u.tolist())), float(u.sum())
    ([-1.0, 1.0], 1.0)
    """
    if order not in range(2, 33):
        raise DataError(f"prbs: order {order}; give the stages of the shift register, 2 to 32")
    if hold < 1:
        raise DataError(f"prbs: hold {hold}; give the rows for which each value is held, from 1")
    if len(levels) != 2:
        raise DataError(f"prbs: {len(levels)} levels; give two")
    register = None if state is None else np.asarray(state, np.int8)
    if register is not None and (register.shape != (order,) or not register.any()):
        raise DataError(f"prbs: the register holds {order} zeros and ones, not all zero; give such a state or none")
    from scipy.signal import max_len_seq  # half a second to import

    # As many bits as begin within the record: the division rounded up.
    count = -(-len(time) // hold)
    bits, _ = max_len_seq(order, state=register, length=count)
    low, high = levels
    return np.repeat(np.where(bits > 0, float(high), float(low)), hold)[: len(time)]


def _check_highest_frequency(signal: str, high: float, step: float, beyond: bool) -> None:
    """Refuse a band up to ``high`` (Hz) where it is ``beyond`` what samples every ``step`` seconds can show."""
    if beyond:
        raise DataError(
            f"a {signal} up to {high:g} Hz: samples every {step:g} s show only frequencies below {0.5 / step:g} Hz; end it lower, or"
            " sample faster"
        )


@dataclass(frozen=True)
class SignalLimit:
    """What a rig allows of one signal, in the model's unit.

    Parameters
    ----------
    low, high
        Between which it must stay.
    rate
        Largest change in a second, of an input.
    """

    low: float = -math.inf
    high: float = math.inf
    rate: float = math.inf

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise DataError(f"a limit from {self.low:g} to {self.high:g}: the low end must not lie above the high end")
        if not self.rate > 0:
            raise DataError(f"a rate of {self.rate:g} per second: give a number above 0")
