"""How an input moves between the rows of a record: what was told of it, and what its values show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Literal, get_args

import numpy as np

from greybox.base import nearest

Hold = Literal["auto", "zero", "first", "band-limited", "mean"]
"""``"zero"``: held until the next row (a computer drives it). ``"first"``: straight to the next row (a measured, smooth signal).
``"band-limited"``: no content above half the sampling rate (a smooth signal behind an anti-alias filter). ``"mean"``: the mean over
the interval that ends at its row (a meter, a logger of energy or weather). ``"auto"``: first where the values show a measured, smooth
signal, else zero."""
Holds = Hold | Mapping[str, Hold]
"""One course for all inputs, or input -> course; inputs that are not named are ``"auto"``. ``"mean"`` for all says it of the outputs too,
and a mapping may say it of outputs."""
HOLDS: tuple[Hold, ...] = get_args(Hold)


class CourseEvidence(StrEnum):
    """What the values of an input show of its course between rows."""

    STEPS = "steps"
    """It steps from row to row: a straight line between these would be a ramp that nothing made."""

    SMOOTH_AND_NOISY = "smooth_and_noisy"
    """A smooth signal with the noise of a sensor: it was measured and moved on between its rows."""

    NONE = "none"
    """Smooth and exact, as a generator's table is and a good sensor's record may be; or between the two."""


# Second differences over first ones (rms): 1.41 of single steps, 1.73 of white noise, 2 sin(pi / n) of a sine with n rows to a period.
# From six rows to a period down an input is no smoother than its steps ...
STEPPED_RATIO = 1.0
# ... and above some twelve it is smooth.
SMOOTH_RATIO = 0.5
# A white floor may have so many times the squared first differences that the signal has: else the noise hides whether that is smooth.
MOST_NOISE = 1.0
# The usual move over the root mean square of all: 0.67 of noise, 0.7 of a sine; an input that stands most of the time has less.
EVEN_MOVE = 0.4
# Moves below this share of the range are rounding of the arithmetic.
ROUNDED_MOVE = 1e-9
# Readings of more than so many levels that move by no more than so many of their steps are coarse: a slow signal, and no generator's steps.
COARSE_LEVELS, COARSE_STEPS = 4, 2.0


def inspect_course(values: np.ndarray, noise: float | None = None) -> CourseEvidence:
    """What the values (N,) of an input show of its course between rows; their ``noise`` as `find_input_noise` has it, if that is known."""
    first = np.diff(values)
    moves = np.abs(first)
    moves = moves[moves > ROUNDED_MOVE * np.ptp(values)]
    if not len(moves):
        return CourseEvidence.STEPS
    step, slope, bend = moves.min(), np.mean(first**2), np.mean(np.diff(first) ** 2) if len(first) > 1 else math.inf
    if variance := (find_input_noise(values) if noise is None else noise) ** 2:
        # White noise of variance s^2 has first differences of 2 s^2, and second ones of 6 s^2.
        slope, bend = slope - 2 * variance, bend - 6 * variance
        if slope * MOST_NOISE < 2 * variance:
            return CourseEvidence.NONE
        if bend < SMOOTH_RATIO**2 * slope:
            return CourseEvidence.SMOOTH_AND_NOISY
    if bend < STEPPED_RATIO**2 * slope:
        return CourseEvidence.NONE
    is_coarse = np.median(moves) <= COARSE_STEPS * step and np.ptp(values) > COARSE_LEVELS * step
    return CourseEvidence.NONE if is_coarse else CourseEvidence.STEPS


def find_input_noise(values: np.ndarray) -> float:
    """Standard deviation of the white noise of the sensor that measured an input (N,); zero where its values show none."""
    moves = np.abs(np.diff(values))
    slope, moved = np.mean(moves**2), moves[moves > ROUNDED_MOVE * np.ptp(values)]
    variance = _find_white_floor(values) or 0.0
    moves_evenly = np.median(moves) > EVEN_MOVE * math.sqrt(slope)
    # A floor below the smallest move is rounding: of a sensor's readings, or of a table of commands.
    shows = moves_evenly and len(moved) and variance > moved.min() ** 2 and 2 * variance < np.var(values) / 2
    return math.sqrt(variance) if shows else 0.0


# Rows from which a spectrum tells a floor.
LEAST_ROWS = 50
# Bands of the spectrum, in shares of the sampling rate, in which white noise has one level within this factor: what a filter has smoothed,
# as a generator may do, falls by 3.8 (two poles) from the one to the other, steps fall by 2.
LOW_BAND, HIGH_BAND, SAME_LEVEL = (0.2, 0.3), (0.4, 0.5), 1.7
# Order of the differences that take away what lies below the bands, before a window that leaks into them.
PREWHITENING_ORDER = 4


def _find_white_floor(values: np.ndarray) -> float | None:
    """Variance of the white noise in ``values`` (N,); None where they have no such floor."""
    if len(values) < LEAST_ROWS:
        return None
    differences = np.diff(values, PREWHITENING_ORDER)
    window = np.hanning(len(differences))
    frequency = np.fft.rfftfreq(len(differences))
    power = np.abs(np.fft.rfft(differences * window)) ** 2 / np.sum(window**2)
    low, high = (
        # A difference has the gain 2 sin(pi f).
        float(np.mean(power[inside] / (2 * np.sin(np.pi * frequency[inside])) ** (2 * PREWHITENING_ORDER)))
        for inside in ((frequency >= a) & (frequency <= b) for a, b in (LOW_BAND, HIGH_BAND))
    )
    return high if high / SAME_LEVEL < low < high * SAME_LEVEL else None


def find_hold_problems(hold: Holds, inputs: Iterable[str], outputs: Iterable[str] = ()) -> list[str]:
    """What is wrong with a ``hold`` for these ``inputs`` and ``outputs``."""
    asked, inputs, outputs = hold if isinstance(hold, Mapping) else {"": hold}, list(inputs), list(outputs)
    unknown = [n for n, course in asked.items() if n and n not in inputs and not (n in outputs and course == "mean")]
    means = [n for n in outputs if asked.get(n) == "mean"]
    return [
        *(f"hold names {n!r}, which is no input; {nearest(n, inputs)}" for n in unknown),
        *(
            f"hold says of output {n!r} that it is a mean, and nothing of {o!r}; one run compares all outputs of a record at one time: say"
            " it of all of them"
            for n in means[:1]
            for o in [o for o in outputs if o not in means][:1]
        ),
        *(
            f"hold {course!r}{f' of {n!r}' if n else ''} is unknown; {nearest(str(course), HOLDS)}: 'zero' (held), 'first' (straight"
            " between rows), 'band-limited' (no content above half the rate), 'mean' (over the interval before each row), 'auto' (as the"
            " values show)"
            for n, course in asked.items()
            if course not in HOLDS
        ),
    ]


def choose_courses(hold: Holds, inputs: Mapping[str, np.ndarray]) -> dict[str, Hold]:
    """Input -> its course between rows: as told, else as its values (N,) show."""
    asked = dict(hold) if isinstance(hold, Mapping) else dict.fromkeys(inputs, hold)
    return {n: choose_course(values) if asked.get(n, "auto") == "auto" else asked[n] for n, values in inputs.items()}


def choose_course(values: np.ndarray) -> Hold:
    """The course that an input has where nobody tells it."""
    return "first" if inspect_course(values) is CourseEvidence.SMOOTH_AND_NOISY else "zero"
