"""Monte-Carlo smoothing of a step response (Wang, Micro motion actuator of compliant mechanism, section 4.2).

Equation 17 is fitted to a measured step response by random search; least squares on the measured and on the smoothed response then give
difference equations of several numerators (equations 18 and 19, Table 3). A procedure of this paper alone: for a record of one's own
`greybox.blackbox.output_error` finds the same response without intervals, and a delay too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from scipy.signal import welch

from greybox.base.errors import DataError, nearest
from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.linear_regression import SampledData, to_sampled_data
from greybox.comparison.blackbox.polynomial import InitialChoice, PolynomialModel
from greybox.comparison.blackbox.rounding import ContinuousTransferFunction
from greybox.data.experiment import Experiment

# From a measured step response to the intervals in which the five constants of equation 17 are drawn.
#
# ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}``: the frequency from the power spectral density, the amplitude from the
# tail, decay and ratio from the envelope of the oscillation, the phase from the first passage through the final value.

NO_OSCILLATION = "the response does not oscillate, so equation 17 does not describe it: use output_error"


# Share of an interval within which a best draw allows the interval to be halved.
WELL_INSIDE = 0.8
# Frequency, decay and ratio stay above this share of their interval's upper end.
LOWER_END = 1e-09


@dataclass(frozen=True)
class DrawIntervals:
    """Lower and upper end of each constant of equation 17: ``amplitude`` A in the output's unit, ``ratio`` r, ``phase`` theta in
    rad, ``frequency`` w in rad/s, ``decay`` sigma in 1/s (the paper's zeta_M, which is not a damping ratio).

    Raises DataError for ends that are not finite or not in order, and for a frequency, decay or ratio below zero.
    """

    amplitude: tuple[float, float]
    ratio: tuple[float, float]
    phase: tuple[float, float]
    frequency: tuple[float, float]
    decay: tuple[float, float]

    def __post_init__(self) -> None:
        for axis in AXES:
            low, high = getattr(self, axis)
            if not (np.isfinite([low, high]).all() and low < high):
                raise DataError(
                    f"interval of {axis}: [{low:g}, {high:g}]; give two finite numbers, the lower one first"
                )
            if axis in POSITIVE and low < 0:
                raise DataError(f"interval of {axis}: [{low:g}, {high:g}] begins below zero; begin it at 0")
            object.__setattr__(self, axis, (float(low), float(high)))

    def with_some(self, given: Mapping[str, tuple[float, float]]) -> DrawIntervals:
        """These intervals with the ``given`` ones, by axis, put in. Raises DataError for an unknown axis."""
        for axis in given:
            if axis not in AXES:
                raise DataError(f"no parameter {axis!r} in equation 17; {nearest(axis, AXES)}")
        return replace(self, **given)

    def around(self, best: Mapping[str, float]) -> DrawIntervals:
        """The adjusted intervals of figure 1: centred on the ``best`` values, half as wide where they lay well inside."""
        adjusted = {}
        for axis in AXES:
            low, high = getattr(self, axis)
            half, middle = (high - low) / 2, (high + low) / 2
            half *= 0.5 if abs(best[axis] - middle) < WELL_INSIDE * half else 1.0
            floor = LOWER_END * high if axis in POSITIVE else -np.inf
            adjusted[axis] = (max(best[axis] - half, floor), best[axis] + half)
        return DrawIntervals(**adjusted)


AXES = tuple(f.name for f in fields(DrawIntervals))
POSITIVE = ("ratio", "frequency", "decay")


def estimate_spectrum(y: np.ndarray, sampling_time: float, points: int = 1024) -> tuple[np.ndarray, np.ndarray]:
    """One-sided power spectral density of ``y`` (N,): frequencies in rad/s and density in its unit squared per rad/s.

    Hann windows of ``points`` rows, side by side (a shorter record: one window, padded with zeros), the mean not taken out.
    """
    window = min(points, len(y))
    f, density = welch(y, 1 / sampling_time, "hann", nperseg=window, noverlap=0, nfft=points, detrend=False)
    return 2 * np.pi * f, density / (2 * np.pi)


def find_resonance(w: np.ndarray, density: np.ndarray) -> float:
    """The frequency of the highest peak beyond the one at zero, in the units of ``w`` (n,). Raises DataError without one."""
    # A one-sided density counts every line but the one at zero twice, so that a broad peak at zero may rise to its second line.
    change = np.diff(density)
    down = int(np.argmax(change < 0))
    rising = down + np.flatnonzero(change[down:] > 0)
    if len(rising) == 0 or rising[0] >= len(w) - 2:
        raise DataError(f"the power spectral density has no peak besides the one at 0 rad/s; {NO_OSCILLATION}")
    start = int(rising[0])
    return float(w[start + int(np.argmax(density[start:]))])


# The last ``1 / tail`` of the record shows the final value.
SMOOTHING_TAIL = 4
# Factor by which the estimated decay may be off either way.
DECAY_FACTOR = 1.6
# Factor by which the estimated ratio may be off either way.
RATIO_FACTOR = 1.25
# Half width of the amplitude's interval, relative, where the tail is constant.
LEVEL_SPREAD = 0.01


def estimate_intervals(time: np.ndarray, y: np.ndarray, sampling_time: float, points: int) -> DrawIntervals:
    """The intervals that the step response ``y`` (N,) at ``time`` (N,) after the step itself suggests.

    Frequency: the spectrum's peak, one of its ``points`` bins to either side. Amplitude: extremes of the last quarter. Decay and
    ratio: a straight line through the logarithm of the envelope, by factors of 1.6 and 1.25. Phase: ``pi - w t`` of the first
    passage through that amplitude. Raises DataError for a response that does not oscillate about a final value.
    """
    tail = y[-max(len(y) // SMOOTHING_TAIL, 2) :]
    level, low, high = float(tail.mean()), float(tail.min()), float(tail.max())
    if low <= 0 <= high:
        raise DataError(
            f"the last quarter of the response runs from {low:.4g} to {high:.4g}: its final value is not distinguishable from zero, but"
            " equation 17 oscillates about a final value; take a longer record, or use output_error"
        )
    if not low < high:
        low, high = level - LEVEL_SPREAD * abs(level), level + LEVEL_SPREAD * abs(level)
    w = _frequency(y, level, sampling_time, points)
    bin_width = 2 * np.pi / (points * sampling_time)
    decay, size = _estimate_envelope(time, y - level, w, sampling_time)
    ratio = size / abs(level)
    # A level below zero turns the order of the tail's ends: the passage at the smaller share of the level comes first.
    first, last = (_first_passage(time, y, part * level) for part in sorted((low / level, high / level)))
    if w * first > 2 * np.pi:
        raise DataError(
            f"the final value is first passed {first:.4g} s after the step, {w * first / (2 * np.pi):.1f} periods of the spectrum's"
            f" peak at {w:.4g} rad/s; {NO_OSCILLATION}"
        )
    slowest, fastest = max(w - bin_width, bin_width / 2), w + bin_width
    slack = w * sampling_time
    return DrawIntervals(
        amplitude=(low, high),
        ratio=(ratio / RATIO_FACTOR, ratio * RATIO_FACTOR),
        phase=(np.pi - fastest * last - slack, np.pi - slowest * first + slack),
        frequency=(slowest, fastest),
        decay=(decay / DECAY_FACTOR, decay * DECAY_FACTOR),
    )


def _frequency(y: np.ndarray, level: float, sampling_time: float, points: int) -> float:
    """The oscillation's frequency in rad/s: the spectrum's peak besides the one at zero."""
    if len(y) >= points:
        return find_resonance(*estimate_spectrum(y, sampling_time, points))
    # The one window of a shorter record is padded with zeros: the final value would leak over the oscillation, so it is taken out.
    w, density = estimate_spectrum(y - level, sampling_time, points)
    peak = int(np.argmax(density))
    if peak in (0, len(w) - 1):
        raise DataError(
            f"the power spectral density of the oscillation is largest at {w[peak]:.4g} rad/s; {NO_OSCILLATION}"
        )
    return float(w[peak])


# An envelope counts while it is this many times what is left of it at the end.
ABOVE_FLOOR = 4.0
# Share of the largest deviation that an oscillation which does not decay must have.
SMOOTHING_PERSISTENT = 0.5
# Least decay, over the inverse of the record's length, where the oscillation does not decay within the record.
HIDDEN_DECAY = 0.1
# Periods that are needed to see an oscillation decay.
SMOOTHING_FEWEST_PERIODS = 3


def _estimate_envelope(time: np.ndarray, swing: np.ndarray, w: float, sampling_time: float) -> tuple[float, float]:
    """Decay (1/s) and size at time zero of an oscillation of about ``w`` rad/s: its amplitude over each period, in a line."""
    period = max(round(2 * np.pi / (w * sampling_time)), 2)
    count = len(swing) // period
    if count < SMOOTHING_FEWEST_PERIODS:
        raise DataError(
            f"the record holds {count} periods of {w:.4g} rad/s; at least {SMOOTHING_FEWEST_PERIODS} show how the oscillation decays:"
            " take a longer record, or use output_error"
        )
    # Demodulated: the mean over whole periods of swing e^{-iwt} is half the complex amplitude there.
    turned = swing[: count * period] * np.exp(-1j * w * time[: count * period])
    size = 2 * np.abs(turned.reshape(count, period).mean(axis=1))
    middle = time[: count * period].reshape(count, period).mean(axis=1)
    floor = float(np.median(size[-max(count // SMOOTHING_TAIL, 1) :]))
    fading = floor < size[0] / ABOVE_FLOOR
    if not fading and size[0] <= SMOOTHING_PERSISTENT * np.abs(swing).max():
        raise DataError(
            f"the oscillation at {w:.4g} rad/s is not larger after the step than at the end; {NO_OSCILLATION}"
        )
    clear = int(np.argmax(np.append(size, 0.0) <= ABOVE_FLOOR * floor)) if fading else count
    used = slice(0, max(clear, 2))
    size = np.maximum(size, LOWER_END * size[0])
    # ln of the envelope: -sigma t + ln size, weighted by size because noise in the logarithm grows as the swing
    # fades.
    slope, start = np.polyfit(middle[used], np.log(size[used]), 1, w=size[used])
    # an oscillation that does not fade within the record: a tenth of its length is the fastest that it could hide
    least = HIDDEN_DECAY / float(time[-1])
    return max(-float(slope), least), float(np.exp(start))


def _first_passage(time: np.ndarray, y: np.ndarray, level: float) -> float:
    """When ``y`` first passes ``level``, linear between rows, in seconds after the step."""
    share = y / level
    k = int(np.argmax(share >= 1))
    if share[k] < 1 or k == 0:
        return float(time[k])
    return float(time[k] - (time[k] - time[k - 1]) * (share[k] - 1) / (share[k] - share[k - 1]))


# Random jumping over a full factorial of draws, exact and cheap: three of the five constants are linear.
#
# Equation 17 is ``A - A r cos(theta) e^(-sigma t) sin(w t) - A r sin(theta) e^(-sigma t) cos(w t)``: for given ``(w, sigma)`` the
# mean square error is a quadratic form in three numbers. One Gram matrix for each drawn pair replaces a simulation of every
# combination, and of the drawn amplitudes the one nearest to the vertex of a parabola is the best: nothing is approximated.


@dataclass(frozen=True)
class DrawCounts:
    """How many values are drawn on each axis (the paper's numbers); all their combinations are tried."""

    amplitude: int = 50
    ratio: int = 10
    phase: int = 10
    frequency: int = 20
    decay: int = 20

    @property
    def combinations(self) -> int:
        """Number of combinations in one evaluation."""
        return int(np.prod([getattr(self, axis) for axis in AXES]))


@dataclass(frozen=True)
class StepResponseConstants:
    """The best combination of one evaluation: a value on each axis, and its mean square error."""

    amplitude: float
    ratio: float
    phase: float
    frequency: float
    decay: float
    error: float


def draw_and_search(
    time: np.ndarray, y: np.ndarray, intervals: DrawIntervals, draws: DrawCounts, generator: np.random.Generator
) -> StepResponseConstants:
    """The best of all combinations of fresh uniform draws on each axis; ``time`` (N,) in seconds after the step, ``y`` (N,)."""
    ends: dict[str, tuple[float, float]] = {axis: getattr(intervals, axis) for axis in AXES}
    values = {axis: generator.uniform(low, high, size=getattr(draws, axis)) for axis, (low, high) in ends.items()}
    return search_grid(time, y, values)


def search_grid(time: np.ndarray, y: np.ndarray, values: dict[str, np.ndarray]) -> StepResponseConstants:
    """The combination of ``values`` (by axis) with the smallest mean square of ``y - yhat`` (equation 17), over all of them."""
    w, sigma, amplitude = values["frequency"], values["decay"], np.sort(values["amplitude"])
    gram, product = _grams(time, y, w, sigma)
    # directions v of the three linear coefficients A v = A (1, -r cos theta, -r sin theta), for every (theta, r)
    theta, r = (axis.ravel() for axis in np.meshgrid(values["phase"], values["ratio"], indexing="ij"))
    v = np.column_stack([np.ones_like(r), -r * np.cos(theta), -r * np.sin(theta)])
    along = product @ v.T
    square = np.einsum("pij,vi,vj->pv", gram, v, v, optimize=True)
    # |y - A v|^2 = y'y - 2 A v'y + A^2 v'v: lowest at A = v'y / v'v, and on a grid at its nearest point.
    wanted = along / square
    above = np.clip(np.searchsorted(amplitude, wanted), 1, max(len(amplitude) - 1, 1))
    low, high = amplitude[above - 1], amplitude[np.minimum(above, len(amplitude) - 1)]
    chosen = np.where(wanted - low <= high - wanted, low, high)
    error = (y @ y - 2 * chosen * along + chosen**2 * square) / len(y)
    pair, direction = np.unravel_index(np.argmin(error), error.shape)
    return StepResponseConstants(
        float(chosen[pair, direction]),
        float(r[direction]),
        float(theta[direction]),
        float(w[pair // len(sigma)]),
        float(sigma[pair % len(sigma)]),
        float(error[pair, direction]),
    )


def _grams(time: np.ndarray, y: np.ndarray, w: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (pairs, 3, 3) of ``1, e^(-sigma t) sin(w t), e^(-sigma t) cos(w t)`` and their products with y (pairs, 3)."""
    angle, fading = np.outer(w, time), np.exp(-np.outer(sigma, time))
    sine, cosine, faded = np.sin(angle), np.cos(angle), fading**2
    shape = (len(w) * len(sigma),)
    gram, product = np.empty((*shape, 3, 3)), np.empty((*shape, 3))
    gram[:, 0, 0], product[:, 0] = len(time), y.sum()
    for k, wave in enumerate((sine, cosine), 1):
        gram[:, 0, k] = gram[:, k, 0] = (wave @ fading.T).ravel()
        gram[:, k, k] = (wave**2 @ faded.T).ravel()
        product[:, k] = ((wave * y) @ fading.T).ravel()
    gram[:, 1, 2] = gram[:, 2, 1] = ((sine * cosine) @ faded.T).ravel()
    return gram, product


# What Monte-Carlo smoothing finds: equation 17, as a step response, as a difference equation, and in the s-domain.

SYMBOLS = {"amplitude": "A", "ratio": "r", "phase": "theta", "frequency": "w", "decay": "sigma"}


@dataclass(frozen=True)
class SmoothingRound:
    """The evaluations between two adjustments of the intervals: ``candidates``, the best of each evaluation."""

    intervals: DrawIntervals
    candidates: tuple[StepResponseConstants, ...]

    @property
    def best(self) -> StepResponseConstants:
        """The best of them all."""
        return min(self.candidates, key=lambda c: c.error)


@dataclass(frozen=True, eq=False)
class MonteCarloSmoothing:
    """A step response ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}`` after a step of ``height``, and the model behind it.

    ``best`` holds the five constants and the mean square error (equation 1) over ``samples`` rows after the step. ``rounds`` are
    the evaluations (none for constants from elsewhere), ``specification`` the error that was asked for. `simulate` is that of
    ``model``, its exact difference equation for a held input.
    """

    output: str
    input: str
    sampling_time: float
    height: float
    best: StepResponseConstants
    samples: int
    rounds: tuple[SmoothingRound, ...] = ()
    draws: DrawCounts = field(default_factory=DrawCounts)
    specification: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def coefficients(self) -> dict[str, float]:
        """The constants by their letters in equation 17: A, r, theta, w, sigma."""
        return {SYMBOLS[axis]: getattr(self.best, axis) for axis in AXES}

    @property
    def error(self) -> float:
        """Mean square error over the step response, in the output's unit squared."""
        return self.best.error

    @property
    def met(self) -> bool | None:
        """Whether the error meets the specification; None where there was none."""
        return None if self.specification is None else self.error <= self.specification

    def response(self, time: np.ndarray) -> np.ndarray:
        """Equation 17 at ``time`` in seconds after the step; zero before it."""
        b, t = self.best, np.asarray(time, float)
        swing = b.ratio * np.exp(-b.decay * np.maximum(t, 0)) * np.sin(b.frequency * t + b.phase)
        return np.where(t >= 0, b.amplitude * (1 - swing), 0.0)

    @property
    def jump(self) -> float:
        """What equation 17 does at once, ``yhat(0+) = A (1 - r sin(theta))``: zero for anything with a mass."""
        return float(self.best.amplitude * (1 - self.best.ratio * np.sin(self.best.phase)))

    @property
    def damping(self) -> float:
        """Damping ratio ``sigma / sqrt(sigma^2 + w^2)``."""
        return float(self.best.decay / np.hypot(self.best.decay, self.best.frequency))

    @property
    def delay(self) -> float:
        """The delay in seconds that the phase shows, ``(arccos(zeta) - theta) / w``.

        A second-order system without a zero has ``theta = arccos(zeta)`` and ``r = 1 / sqrt(1 - zeta^2)``; the same response
        ``Td`` later has ``theta - w Td`` and ``r e^(sigma Td)`` in their place.
        """
        return float((np.arccos(self.damping) - self.best.phase) / self.best.frequency)

    @property
    def transfer_function(self) -> ContinuousTransferFunction:
        """The transfer function of equation 17 over the step's height, with the feed-through that ``r`` and ``theta`` leave."""
        b = self.best
        sine, cosine = b.ratio * np.sin(b.phase), b.ratio * np.cos(b.phase)
        above = np.array([1 - sine, b.decay * (2 - sine) - b.frequency * cosine, b.decay**2 + b.frequency**2])
        below = np.array([1.0, 2 * b.decay, b.decay**2 + b.frequency**2])
        return ContinuousTransferFunction(b.amplitude / self.height * above, below)

    @cached_property
    def model(self) -> PolynomialModel:
        """The exact difference equation for an input held between samples, ``y = (b0 + b1 q^-1 + b2 q^-2) / F(q) u + e``."""
        b, h = self.best, self.sampling_time
        # Poles e^{(-sigma +- i w) h}
        f = np.array([1.0, -2 * np.exp(-b.decay * h) * np.cos(b.frequency * h), np.exp(-2 * b.decay * h)])
        first = self.response(h * np.arange(3)) / self.height
        # y = B / F applied to a step: its first three rows give the three numbers of B
        numbers = np.convolve(f, first)[:3] - np.append(0.0, np.convolve(f, first)[:2])
        # The last one from the final value: B(1) / F(1) = A / height exactly.
        numbers[2] = b.amplitude / self.height * f.sum() - numbers[0] - numbers[1]
        return PolynomialModel(
            "monte-carlo smoothing",
            self.output,
            (self.input,),
            h,
            (0,),
            (numbers,),
            f=(f,),
            noise_std=float(np.sqrt(self.error)),
            samples=self.samples,
            loss=self.error,
            history="zero",
            focus="simulation",
            units=self.units,
        )

    def simulate(
        self, experiment: Experiment, *, initial: InitialChoice = "estimated", rows: int | None = None
    ) -> dict[str, np.ndarray]:
        """Free run, as `PolynomialModel.simulate`."""
        return self.model.simulate(experiment, initial=initial, rows=rows)


# Order of the denominator, first and last lag of the numerator: the seven columns of Table 3.
NUMERATOR_STRUCTURES = ((3, 0, 3), (3, 1, 3), (3, 2, 3), (3, 3, 3), (2, 0, 2), (2, 1, 2), (2, 2, 2))


@dataclass(frozen=True, eq=False)
class NumeratorComparison:
    """One structure: ``order`` of the denominator, ``lags`` of the numerator, and what least squares makes of it.

    ``direct`` (D-E) and ``smoothed`` (S-E) are mean squares of the measured response less the free run from rest, in the
    output's unit squared, of ``direct_model`` and ``smoothed_model``. An error is None where the equations are collinear or
    their solution is unstable; ``remark`` then says which.
    """

    order: int
    lags: tuple[int, ...]
    direct: float | None
    smoothed: float | None
    direct_model: PolynomialModel | None
    smoothed_model: PolynomialModel | None
    remark: str = ""

    @property
    def label(self) -> str:
        """``b1 b2 over a1 a2``."""
        return f"{' '.join(f'b{k}' for k in self.lags)} over {' '.join(f'a{k}' for k in range(1, self.order + 1))}"


def compare_numerators(
    experiment: Experiment,
    smoothing: MonteCarloSmoothing,
    structures: Sequence[tuple[int, int, int]] = NUMERATOR_STRUCTURES,
) -> tuple[NumeratorComparison, ...]:
    """Least squares on the record itself (D-E) and on its smoothed response (S-E), judged on the record.

    ``y(k) = -a1 y(k-1) - ... + b0 u(k) + b1 u(k-1) + ...`` with the rows of the record's first instants, zeros before it: a step
    has no others that tell the lags of its input apart. The smoothed response obeys a second-order equation exactly, so a third
    order on it leaves its coefficients open. ``structures``: order, first and last lag.
    """
    edge = int(np.flatnonzero(experiment.inputs[smoothing.input])[0])
    rows = np.arange(experiment.rows) - edge
    smooth = experiment.with_outputs({smoothing.output: smoothing.response(rows * smoothing.sampling_time)})
    compared = []
    for order, first, last in structures:
        fits = (_fit_arx(record, experiment, smoothing, order, first, last) for record in (experiment, smooth))
        (direct, direct_model, problem), (smoothed, smoothed_model, other) = fits
        remark = "; ".join(f"{name}: {text}" for name, text in (("D-E", problem), ("S-E", other)) if text)
        lags = tuple(range(first, last + 1))
        compared.append(NumeratorComparison(order, lags, direct, smoothed, direct_model, smoothed_model, remark))
    return tuple(compared)


def _fit_arx(
    record: Experiment, measured: Experiment, smoothing: MonteCarloSmoothing, order: int, first: int, last: int
) -> tuple[float | None, PolynomialModel | None, str]:
    """Least squares on ``record``: the mean square error on ``measured``, the model, and what went wrong."""
    y, u = smoothing.output, smoothing.input
    try:
        model = arx(record, na=order, nb=last - first + 1, nk=first, history="zero", output=y, inputs=u)
    except DataError as problem:
        return None, None, str(problem)
    if not model.stable:
        return None, model, f"unstable, a pole of size {abs(model.poles[0]):.4g}"
    run = model.simulate(measured, initial="zero")[y]
    return float(np.mean((measured.outputs[y] - run) ** 2)), model, ""


@dataclass(frozen=True)
class SmoothingProgress:
    """Where a smoothing is: evaluation ``evaluation`` of ``evaluations`` in round ``round`` of at most ``rounds``; best so far."""

    round: int
    rounds: int
    evaluation: int
    evaluations: int
    error: float


def monte_carlo_smoothing(
    experiment: Experiment,
    *,
    seed: int | np.random.Generator,
    output: str | None = None,
    input: str | None = None,
    intervals: DrawIntervals | Mapping[str, tuple[float, float]] | None = None,
    draws: DrawCounts | None = None,
    evaluations: int = 20,
    specification: float | None = None,
    adjustments: int = 5,
    spectrum_points: int = 1024,
    units: Mapping[str, str] | None = None,
    report: Callable[[SmoothingProgress], None] | None = None,
) -> MonteCarloSmoothing:
    """Fit ``yhat(t) = A {1 - r e^(-sigma t) sin(w t + theta)}`` (equation 17) to a step response by random search.

    Each evaluation draws values on every axis, uniformly in its interval, and tries all their combinations; the best of
    ``evaluations`` by the mean square error (equation 1) counts. Then the loop of figure 1: while that error exceeds the
    ``specification``, the intervals are put around the best values, narrower where those lay well inside, and it is done again.

    This is least squares by random search: maximum likelihood for white Gaussian noise, and blind to a delay, which it takes for
    a feed-through (`MonteCarloSmoothing.delay`). Prefer `output_error`, or a physical model with a delay; use it to repeat
    published results.

    Parameters
    ----------
    experiment
        A record whose input steps once, from zero, at any row.
    seed
        A number or a generator: the same seed draws the same.
    output, input
        Names of the signals; needed where the record has several.
    intervals
        All of them, or some by axis (``amplitude, ratio, phase, frequency, decay``); the others come from the data, the frequency
        from the power spectral density of ``spectrum_points`` points.
    draws
        Number of values on each axis; None: 20 frequencies, 10 phases, 10 ratios, 50 amplitudes, 20 decays, two million
        combinations in all.
    evaluations
        Number of evaluations between two adjustments of the intervals.
    specification
        Mean square error to reach, in the output's unit squared; None: adjust while it still falls by 2 %.
    adjustments
        How often the intervals are adjusted at most (0: never).
    spectrum_points
        Points of the power spectral density.
    units
        Name of a signal -> unit.
    report
        Called with a `SmoothingProgress` after every evaluation.

    Returns
    -------
    MonteCarloSmoothing
        The five constants, and the difference equation behind them.

    Raises
    ------
    DataError
        For an input that is no single step from zero, gaps, fewer than 32 rows after the step, and a response without a resonance.

    Examples
    --------
    >>> smoothing = monte_carlo_smoothing(record, seed=1)  # doctest: +SKIP
    """
    if evaluations < 1 or adjustments < 0:
        raise DataError(f"{evaluations} evaluations, {adjustments} adjustments; give at least 1 and 0")
    generator, counts = np.random.default_rng(seed), draws or DrawCounts()
    data, height, y = _extract_step(experiment, output, input)
    time = data.sampling_time * np.arange(len(y))
    chosen = intervals if isinstance(intervals, DrawIntervals) else None
    if chosen is None:
        chosen = estimate_intervals(time, y, data.sampling_time, spectrum_points).with_some(intervals or {})  # type: ignore[arg-type]
    rounds: list[SmoothingRound] = []
    while True:
        evaluated: list[StepResponseConstants] = []
        for k in range(evaluations):
            evaluated.append(draw_and_search(time, y, chosen, counts, generator))
            if report is not None:
                best = min(c.error for c in [*evaluated, *(r.best for r in rounds)])
                report(SmoothingProgress(len(rounds) + 1, adjustments + 1, k + 1, evaluations, best))
        rounds.append(SmoothingRound(chosen, tuple(evaluated)))
        if len(rounds) > adjustments or _is_good_enough(rounds, specification):
            break
        best_yet = min((r.best for r in rounds), key=lambda c: c.error)
        # Around the best of all rounds: a round may find nothing better than the one before.
        chosen = chosen.around({axis: getattr(best_yet, axis) for axis in AXES})
    best_of_all = min((r.best for r in rounds), key=lambda c: c.error)
    return MonteCarloSmoothing(
        data.output,
        data.inputs[0],
        data.sampling_time,
        height,
        best_of_all,
        len(y),
        tuple(rounds),
        counts,
        specification,
        dict(units or {}),
    )


# Share by which another adjustment of the intervals must lower the mean square error.
SMOOTHING_IMPROVEMENT = 0.02


def _is_good_enough(rounds: Sequence[SmoothingRound], specification: float | None) -> bool:
    errors = [r.best.error for r in rounds]
    if specification is not None:
        return min(errors) <= specification
    # Without a specification it ends where a round gained less than 2 %.
    return len(errors) > 1 and errors[-1] > (1 - SMOOTHING_IMPROVEMENT) * min(errors[:-1])


# Rows after the step that are needed for a spectrum and a final value.
SMOOTHING_FEWEST_ROWS = 32


def _extract_step(
    experiment: Experiment, output: str | None, input: str | None
) -> tuple[SampledData, float, np.ndarray]:
    """The signals of a record that is one step from zero, the step's height, and the output (N,) from the step on."""
    data = to_sampled_data(experiment, output, input)
    (record,) = data.records
    if len(data.inputs) > 1:
        raise DataError(
            f"experiment {experiment.name!r}: several inputs; name the one that steps with input=...; known: {', '.join(data.inputs)}"
        )
    u, name = record.signals[0][:], data.inputs[0]
    changes = np.flatnonzero(np.diff(u, prepend=0.0))
    if len(changes) != 1:
        movement = (
            "never moves"
            if not len(changes)
            else f"changes at {len(changes)} rows ({', '.join(map(str, changes[:3]))} ...)"
        )
        raise DataError(
            f"experiment {experiment.name!r}: input {name!r} {movement}, but Monte-Carlo smoothing needs one step from zero;"
            " cut the record there, or use output_error, which takes any input"
        )
    edge = int(changes[0])
    y = record.y[edge:]
    if np.isnan(y).any():
        raise DataError(
            f"experiment {experiment.name!r}: {int(np.isnan(y).sum())} of {len(y)} rows after the step lack {data.output!r};"
            " smoothing needs them all: cut the record, or use output_error"
        )
    if len(y) < SMOOTHING_FEWEST_ROWS:
        raise DataError(
            f"experiment {experiment.name!r}: {len(y)} rows after the step; smoothing needs {SMOOTHING_FEWEST_ROWS} and a final value"
        )
    return data, float(u[edge]), y
