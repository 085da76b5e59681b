"""Positions, velocities and accelerations of a log: filtered without a shift in time, differentiated, with what is left of the noise.

Each axis is filtered forwards and backwards up to the frequency at which its motion sinks into the noise of its encoder (Gautier,
Poignet, Control Engineering Practice 9, 2001, choose it by hand). Torques are not filtered: noise that no regressor has costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfiltfilt, welch

from greybox.base import DataError
from greybox.base.values import ReadOnly
from greybox.data.experiment import Experiment
from greybox.data.noise.repeats import estimate_written_step
from greybox.data.sensor_faults import compute_rounding_std

# Order of the filter in each direction.
FILTER_ORDER = 4
# Above this share of the sampling rate the differences below are no derivatives any more.
HIGHEST_CUTOFF = 0.1
# A spectrum that is so many times its floor is motion, and no noise.
MOTION_OVER_NOISE = 4.0
# The floor is the median of a spectrum above this share of half the sampling rate.
FLOOR_FROM = 0.6
# Rows of a stretch of which a spectrum is averaged, at most; a record has four at least.
SPECTRUM_ROWS = 4096
# A longer step in the time of a record than so many usual ones is a gap, over which nothing can be differentiated.
LONGEST_STEP = 5.0
# Periods of the cutoff at both ends of a record where a filter still swings in.
SWINGING_PERIODS = 2.0
# An axis that moves more slowly than so many standard deviations of what noise is left in its velocity, or than this share of its usual
# speed, may as well stand: what dry friction holds there is anything up to its level.
RESTING_DEVIATIONS, RESTING_SHARE = 4.0, 0.02
# ... or than this, in rad/s or m/s: nothing on Earth moves so slowly on purpose.
RESTING_SPEED = 1e-6
# A velocity that is so many times the slope of its position, or as many times smaller, is in another unit, or of another joint.
# Of 24 logs that did not set it, behind filters of 3 to 50 Hz with noise up to their rms: 0 of 120 right ones are refused and 0 of 120 of
# joints that stand; degrees and other signs 240 of 240; those of another joint 112 of 120, the others are too noisy to be used.
SAME_SPEED = 2.0
# Counts by which a reading moves at once, from which it is not the next count of a slow motion; and share of such moves behind which it
# stands still, from which rows are written more often than the sensor is read.
SEVERAL_COUNTS, HELD_SHARE = 3.0, 0.5
# Fewer rows than this show no motion that could be differentiated.
LEAST_ROWS = 64
# Central differences of sixth order for values three rows before to three rows after (Fornberg, Mathematics of Computation 51, 1988).
FIRST_DIFFERENCE = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60


@dataclass(frozen=True, eq=False)
class Motion(ReadOnly):
    """A log as it is regressed on.

    Parameters
    ----------
    time
        Times (N,) in s, evenly spaced.
    q, dq, ddq
        Positions, velocities, accelerations (N, n).
    tau
        Torques (N, n) as measured, or currents in A where there is no torque; NaN where neither is.
    is_moving
        Where each axis moves (N, n): elsewhere dry friction may have any value up to its level.
    lags
        Seconds (n,) by which velocities that were used were late, and are brought forward.
    """

    time: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    tau: np.ndarray
    is_moving: np.ndarray
    lags: np.ndarray

    def thin(self, every: int) -> Motion:
        """Every so many-th row."""
        rows = {name: getattr(self, name)[::every] for name in ("time", "q", "dq", "ddq", "tau", "is_moving")}
        return replace(self, **rows)

    @property
    def step(self) -> float:
        """Seconds between rows."""
        return float(self.time[1] - self.time[0])


def reconstruct_motion(
    record: Experiment, axes: Sequence[int], shake: float = 0.0, *, keep_ends: bool = False
) -> Motion:
    """Filter and differentiate the positions ``q1`` ... of a record; velocities ``dq1`` ... are used where they are less noisy.

    Parameters
    ----------
    record
        Its columns ``q1`` ... ``qn`` in rad or m, ``tau1`` ... in N m or N or ``i1`` ... in A, ``dq1`` ... in rad/s or m/s where there
        are some.
    axes
        Numbers (n,) of the axes in the names of the columns.
    shake
        Add so many times the noise that each reading has: what that changes tells what the noise of the sensors has changed.

    keep_ends
        Keep the rows at both ends where the filter swings in.

    Returns
    -------
    Motion
        Its rows.

    Raises
    ------
    DataError
        For a record that is too short, has gaps in time, readings of position that are missing, or velocities that contradict them.
    """
    columns = {**record.inputs, **record.outputs}
    empty = np.full(record.rows, np.nan)
    new = {f"q{k}": _find_new_rows(np.asarray(columns.get(f"q{k}", empty))) for k in axes}
    # What is held between readings is read as seldom as it is new.
    time, step = _space_evenly(record, slice(None) if keep_ends else min(new.values(), key=len))
    n, rate, generator = len(time), 1 / step, np.random.default_rng(0)

    def read(name: str) -> np.ndarray:
        values, rows = np.asarray(columns.get(name, empty)), new.get(name, slice(None))
        is_as_written = record.sampling_time and n == record.rows == len(values[rows])
        return values if is_as_written else np.interp(time, record.time[rows], values[rows])

    q, dq, ddq = np.empty((3, n, len(axes)))
    tau = np.column_stack([read(f"tau{k}" if f"tau{k}" in columns else f"i{k}") for k in axes])
    # One number in all rows was not measured.
    tau[:, np.ptp(tau, axis=0) == 0] = np.nan
    cutoffs, quiet, lags = np.zeros((3, len(axes)))
    for k, number in enumerate(axes):
        position, velocity = read(f"q{number}"), read(f"dq{number}")
        if not np.isfinite(position).all():
            raise DataError(f"record {record.name!r}: {int((~np.isfinite(position)).sum())} readings of q{number} are missing; cut them off"
                            " with --from and --until")  # fmt: skip
        cutoffs[k], noise = _find_cutoff(position, rate)
        # White noise of density S behind a differentiator up to fc: S (2 pi)^2 fc^3 / 3.
        density = 2 * noise**2 / rate
        quiet[k] = np.sqrt(density * (2 * np.pi) ** 2 * cutoffs[k] ** 3 / 3)
        position = position + shake * noise * generator.normal(size=n)
        q[:, k] = _smooth(position, cutoffs[k], rate)
        dq[:, k] = _differentiate(q[:, k], step)
        if np.isfinite(velocity).all():
            cutoff, level = _find_cutoff(velocity, rate)
            velocity = velocity + shake * level * generator.normal(size=n)
            lag, factor = _compare_velocity(q[:, k], velocity, min(cutoffs[k], cutoff) / 2, rate)
            remaining, smooth = level * np.sqrt(2 * cutoff / rate), _smooth(velocity, cutoff, rate)
            both_move = (
                np.std(dq[:, k]) > RESTING_DEVIATIONS * quiet[k] and np.std(smooth) >= RESTING_DEVIATIONS * remaining
            )
            if both_move and not 1 / SAME_SPEED < factor < SAME_SPEED:
                raise DataError(
                    f"record {record.name!r}: dq{number} is {factor:.3g} times the slope of q{number}; state the unit of what is off, q, dq"
                    f" or time (--column 'dq{number} [deg/s]=HEADER'), or name its column"
                )
            if remaining < quiet[k]:
                quiet[k], lags[k] = remaining, lag
                # What a filter of the sensor delays is brought forward.
                dq[:, k] = np.interp(time + lags[k], time, smooth)
                cutoffs[k] = cutoff
        ddq[:, k] = _differentiate(dq[:, k], step)
    speed = np.sqrt(np.mean(dq**2, axis=0))
    is_moving = np.abs(dq) > np.maximum.reduce(
        [RESTING_DEVIATIONS * quiet, RESTING_SHARE * speed, np.full(len(axes), RESTING_SPEED)]
    )
    swing = min(int(np.ceil(SWINGING_PERIODS * rate / cutoffs.min())) + len(FIRST_DIFFERENCE), n // 8)
    rows = slice(0, n) if keep_ends else slice(swing, n - swing)
    return Motion(time[rows], q[rows], dq[rows], ddq[rows], tau[rows], is_moving[rows], lags)


def _compare_velocity(position: np.ndarray, velocity: np.ndarray, cutoff: float, rate: float) -> tuple[float, float]:
    """Below a frequency: seconds by which a velocity (N,) follows the position late, ``v = dq - lag ddq``, and its size over that of dq."""
    dq, v = (_smooth(x, cutoff, rate) for x in (_differentiate(position, 1 / rate), velocity))
    inner = slice(len(dq) // 16, -(len(dq) // 16))
    # The velocity, and its slope, are the instruments: their noise is not that of the position, which would make both small.
    slope, ddq = (_differentiate(x, 1 / rate)[inner] for x in (v, dq))
    dq, v = dq[inner], v[inner]
    lag = float(-((v - dq) @ slope) / (ddq @ slope)) if ddq @ slope else 0.0
    return lag, float(v @ v / (dq @ v)) if dq @ v else 0.0


def _find_new_rows(values: np.ndarray) -> np.ndarray:
    """Rows (N,) in which a reading is new, where rows are written more often than it is read; else all of them."""
    moves = np.abs(np.diff(values))
    far = moves > SEVERAL_COUNTS * estimate_written_step([values])
    is_held = far[:-1].any() and np.mean(moves[1:][far[:-1]] == 0) > HELD_SHARE
    return np.flatnonzero(np.concatenate([[True], (moves > 0) | (not is_held)]))


def _space_evenly(record: Experiment, rows: np.ndarray | slice) -> tuple[np.ndarray, float]:
    """Times with one step, that of some rows. Raises DataError where that cannot be."""
    if record.rows < LEAST_ROWS:
        raise DataError(
            f"record {record.name!r} has {record.rows} rows; at least {LEAST_ROWS} are needed to differentiate"
        )
    usual = float(np.median(np.diff(record.time)))
    longest = int(np.argmax(np.diff(record.time)))
    if np.diff(record.time)[longest] > LONGEST_STEP * usual:
        raise DataError(
            f"record {record.name!r} has a gap of {np.diff(record.time)[longest]:.3g} s after {record.time[longest]:.6g} s, over which"
            " nothing can be differentiated; split it with --split-holes"
        )
    step = max(usual, float(np.median(np.diff(record.time[rows]))))
    is_even = record.sampling_time and step == usual
    count = record.rows if is_even else int((record.time[-1] - record.time[0]) / step) + 1
    return record.time[0] + step * np.arange(count), step


def _find_cutoff(values: np.ndarray, rate: float) -> tuple[float, float]:
    """Frequency in Hz up to which a signal moves more than its noise, and the standard deviation of that noise in one reading."""
    rows = min(SPECTRUM_ROWS, len(values) // 4)
    frequency, power = welch(values, rate, "blackmanharris", rows, detrend="linear")
    floor = float(np.median(power[frequency > FLOOR_FROM * rate / 2]))
    # A written step is noise even where the signal stays within one.
    floor = max(floor, 2 * compute_rounding_std(estimate_written_step([values])) ** 2 / rate)
    moving = np.flatnonzero(power > MOTION_OVER_NOISE * floor)
    # The first frequency from which on noise is louder; a lone line further up is a disturbance.
    quiet = np.flatnonzero(np.convolve(power > MOTION_OVER_NOISE * floor, np.ones(3), "same") == 0)
    last = quiet[0] if len(quiet) else (moving[-1] if len(moving) else 1)
    lowest = 4 * frequency[1]
    cutoff = min(max(float(frequency[last]), lowest), HIGHEST_CUTOFF * rate)
    return cutoff, float(np.sqrt(floor * rate / 2))


def _smooth(values: np.ndarray, cutoff: float, rate: float) -> np.ndarray:
    sections = butter(FILTER_ORDER, cutoff, fs=rate, output="sos")
    # About a line from end to end: a filter swings in from what it is given first.
    line = np.linspace(values[0], values[-1], len(values))
    return np.asarray(sosfiltfilt(sections, values - line) + line)


def _differentiate(values: np.ndarray, step: float) -> np.ndarray:
    return np.convolve(np.pad(values, 3, mode="reflect", reflect_type="odd"), FIRST_DIFFERENCE[::-1], "valid") / step
