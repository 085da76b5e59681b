"""What may be played: kinds of inputs as shapes between -1 and 1, and the largest amplitude at which they keep all limits of the rig."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from greybox.base import TINY, DataError
from greybox.data.signals import SignalLimit, chirp, prbs
from greybox.extensions.design.plant import PlantScenario
from greybox.extensions.design.problem import DesignPolicy, DesignProblem, LimitPrediction
from greybox.show.sentences.wording import limit_text


class InputShape(Protocol):
    """A shape that an input may take."""

    @property
    def kind(self) -> str:
        """What people call it."""

    @property
    def highest(self) -> float:
        """The frequency in Hz up to which most of its power lies."""

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The shape (N,), between -1 and 1, at uniform times (N,)."""

    def shifted(self, number: int) -> InputShape:
        """The shape for input ``number`` of several, which must not move together."""


@dataclass(frozen=True)
class Multisine:
    """Sines of given frequencies in Hz, relative amplitudes and phases (as cosines); its peak is one."""

    frequencies: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases: tuple[float, ...]
    kind: str = "multisine"

    @property
    def highest(self) -> float:
        """Below it lie 95 % of the power."""
        # Power of a sine is proportional to the square of its amplitude.
        power = np.cumsum(np.square(self.amplitudes))
        return self.frequencies[int(np.searchsorted(power, 0.95 * power[-1]))]

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The sum over time."""
        total = np.zeros(len(time))
        for f, a, phase in zip(self.frequencies, self.amplitudes, self.phases, strict=True):
            total += a * np.cos(2 * np.pi * f * (time - time[0]) + phase)
        return total / max(float(np.abs(total).max()), TINY)

    def shifted(self, number: int) -> Multisine:
        """The same spectrum with other phases."""
        # Multiples of the golden section: phases of no two inputs fall into step.
        turn = [p + 2 * np.pi * ((number * (k + 1) * 0.618) % 1) for k, p in enumerate(self.phases)]
        return replace(self, phases=tuple(turn)) if number else self


@dataclass(frozen=True)
class Chirp:
    """A sine that sweeps from ``low`` to ``high`` Hz."""

    low: float
    high: float
    kind: str = "chirp"

    @property
    def highest(self) -> float:
        """Its last frequency."""
        return self.high

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The sweep."""
        return chirp(time, self.low, self.high, 1.0)

    def shifted(self, number: int) -> Chirp:
        """Swept downwards for every other input."""
        return replace(self, low=self.high, high=self.low) if number % 2 else self


@dataclass(frozen=True)
class Prbs:
    """Two levels that alternate like a coin, each kept for ``hold`` seconds at least."""

    hold: float
    order: int
    kind: str = "PRBS"

    @property
    def highest(self) -> float:
        """A third of the clock frequency, up to which its spectrum is flat."""
        return 1 / (3 * self.hold)

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The sequence."""
        return prbs(time, self.order, hold=max(1, round(self.hold / (time[1] - time[0]))))

    def shifted(self, number: int) -> Prbs:
        """Another clock: sequences of one clock would be delayed copies."""
        return replace(self, hold=self.hold * (1 + 0.37 * number))


@dataclass(frozen=True)
class Steps:
    """Random levels between -1 and 1, each kept for an equal time."""

    levels: tuple[float, ...]
    duration: float
    kind: str = "steps"

    @property
    def highest(self) -> float:
        """A third of the frequency of the steps."""
        return len(self.levels) / (3 * self.duration)

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The levels over time; beyond their duration they begin anew."""
        number = np.floor((time - time[0]) / self.duration * len(self.levels) + 1e-9).astype(int)
        return np.array(self.levels)[number % len(self.levels)]

    def shifted(self, number: int) -> Steps:
        """The same levels in another order."""
        return replace(self, levels=tuple(np.roll(self.levels[:: (-1) ** number], 3 * number)))


@dataclass(frozen=True)
class PiecewiseConstant:
    """Levels between -1 and 1 that were chosen one by one, each kept for ``hold`` seconds; repeated where the record is longer."""

    levels: tuple[float, ...]
    hold: float
    kind: str = "piecewise constant"

    @property
    def highest(self) -> float:
        """Half the frequency of its levels."""
        return 0.5 / self.hold

    def sample(self, time: np.ndarray) -> np.ndarray:
        """The levels over time."""
        number = np.floor((time - time[0]) / self.hold + 1e-6).astype(int)
        return np.array(self.levels)[number % len(self.levels)]

    def shifted(self, number: int) -> PiecewiseConstant:
        """Itself: each input has levels of its own."""
        return self


def staircase(levels: int, duration: float) -> Steps:
    """Steps up to one, down to minus one and back, an input to be scaled.

    Parameters
    ----------
    levels
        Levels on each way, zero and the end included.
    duration
        Of the whole in seconds.

    Returns
    -------
    Steps
        Levels between -1 and 1, each held for as long.
    """
    up = np.linspace(0, 1, levels)
    # Up, back, down and back: each level is met from both sides, which shows play and hysteresis.
    way = np.concatenate([up, up[-2::-1], -up[1:], -up[-2::-1]])
    return Steps(tuple(way.tolist()), duration, "staircase")


def compress_multisine(
    harmonics: Sequence[int], amplitudes: Sequence[float], iterations: int, seed: int = 0
) -> np.ndarray:
    """Phases of a multisine whose peak is low over its rms: the p-norm of one period is minimised for growing p.

    Guillaume, Schoukens, Pintelon and Kollar (1991) proposed that way to the maximum norm, with Gauss-Newton steps; here the p-norm's
    logarithm is minimised by L-BFGS from Schroeder's phases and from the best of some random ones.

    Parameters
    ----------
    harmonics
        Whole multiples of the base frequency.
    amplitudes
        Amplitude of each.
    iterations
        Steps at each p.
    seed
        Of the random phases.

    Returns
    -------
    array (K,)
        Phases in rad, of cosines.
    """
    from scipy.optimize import minimize

    k, a = np.asarray(harmonics, int), np.asarray(amplitudes, float)
    # Sixteen points in a period of the highest line: peaks between points are small.
    n = 16 * (int(k.max()) + 1)
    time = np.arange(n) / n
    basis = np.exp(2j * np.pi * np.outer(k, time))
    # Parseval: each cosine has half the square of its amplitude.
    rms = np.sqrt(np.sum(a**2) / 2)

    def norm(phase: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        waves = (a * np.exp(1j * phase))[:, None] * basis
        signal = waves.real.sum(axis=0) / rms
        top = np.abs(signal).max()
        ratio = np.abs(signal) / top
        total = np.mean(ratio**power)
        # d ln |s|_p / d s, s over its peak so that a high power does not overflow.
        slope = ratio ** (power - 1) * np.sign(signal) / (n * total * top)
        return float(np.log(top) + np.log(total) / power), -(waves.imag / rms) @ slope

    def peak(phase: np.ndarray) -> float:
        return float(np.abs(((a * np.exp(1j * phase))[:, None] * basis).real.sum(axis=0)).max() / rms)

    generator = np.random.default_rng(seed)
    power_share = np.concatenate([[0.0], np.cumsum(a**2)[:-1]]) / np.sum(a**2)
    # Schroeder: phase differences follow the power below each line (IEEE Trans. Information Theory 16, 1970).
    starts = [-2 * np.pi * np.cumsum(np.concatenate([[0.0], power_share[1:]]) * np.diff(k, prepend=k[0]))]
    starts += [generator.uniform(0, 2 * np.pi, len(k)) for _ in range(3)]
    best = min(starts, key=peak)
    for start in starts:
        phase = start
        # Growing p, each from the last one: the maximum norm itself has kinks.
        for power in (4, 8, 16, 32, 64, 128, 256):
            phase = minimize(
                norm, phase, args=(float(power),), jac=True, method="L-BFGS-B", options={"maxiter": iterations // 8 + 1}
            ).x
        best = min(best, phase, key=peak)
    return best


# From a shape to what a generator plays: within the range, no faster than allowed, from rest to rest.


# Samples over which a generator that is not held (``hold`` first or band-limited) averages a designed input: what it cannot play above
# half the sampling frequency is gone.
PLAY_SMOOTHING = 5


def play(question: DesignProblem, shapes: Mapping[str, InputShape], amplitude: float) -> dict[str, np.ndarray]:
    """All inputs (N,) of the model: those that may move follow their shape, the others rest.

    Parameters
    ----------
    question
        Gives ranges, rates and the hold of the generator.
    shapes
        By input.
    amplitude
        Share of the way from rest to the ends of the range, 0 to 1.
    """
    t = question.time
    inputs = {}
    for i in question.model.inputs:
        middle, half, rest = question.span(i.name)
        if i.name not in shapes:
            inputs[i.name] = np.full(len(t), rest)
            continue
        deviation = middle + half * shapes[i.name].sample(t) - rest
        if question.hold != "zero":
            deviation = smooth(deviation, PLAY_SMOOTHING)
        # About the rest, not the middle of the range: an amplitude of zero is no input.
        u = rest + amplitude * envelope(len(t), question.policy) * deviation
        inputs[i.name] = limit_rate(u, rest, question.limits[i.name], float(t[1] - t[0]))
    return inputs


def envelope(rows: int, policy: DesignPolicy) -> np.ndarray:
    """What an input is multiplied with (N,): it rises softly from zero, and is back at zero before the end."""
    ramp, rest = round(policy.soft_start * rows), round(policy.rest_share * rows)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(ramp) / max(ramp, 1))
    shape = np.ones(rows)
    shape[:ramp] = rise
    shape[rows - rest - ramp : rows - rest] = rise[::-1]
    shape[rows - rest :] = 0.0
    return shape


def smooth(values: np.ndarray, length: int) -> np.ndarray:
    """Values (N,) averaged with weights that fall off to both sides over ``length`` samples; zero beyond the ends."""
    weights = np.hanning(length + 2)[1:-1]
    return np.convolve(values, weights / weights.sum(), mode="same")


def limit_rate(u: np.ndarray, rest: float, limit: SignalLimit, step: float) -> np.ndarray:
    """``u`` (N,) made no faster than the rate of its limit, from rest and back to rest."""
    if not math.isfinite(limit.rate):
        return u
    most = limit.rate * step
    for _ in range(2):  # forward and backward in time: the second pass keeps what the first one made
        u = u.copy()
        previous = rest
        for k in range(len(u)):
            previous = u[k] = min(max(u[k], previous - most), previous + most)
        u = u[::-1]
    return u


# What an input does to the plant: ranges with a margin for what is not known.

# Standard deviations, over these draws, that the predicted range is widened by at every time.
MARGIN_DEVIATIONS = 3.0
# Share of the distance from rest to a limit that stays free in any case: rounding of the generator, noise.
MARGIN_RESERVE = 0.02


@dataclass(frozen=True, eq=False)
class LimitKeeper:
    """Predicts ranges under every explanation: ``plants`` at their best constants, ``draws`` of each."""

    question: DesignProblem
    plants: Sequence[PlantScenario]
    draws: Sequence[Sequence[PlantScenario]]

    @property
    def needs_runs(self) -> bool:
        """Whether anything but the inputs is limited."""
        return not {i.name for i in self.question.model.inputs}.issuperset(self.question.limits)

    def predict(self, inputs: Mapping[str, np.ndarray]) -> dict[str, LimitPrediction]:
        """Each limit with its predicted range; infinite usage where a run overflows."""
        model, limits, predictions = self.question.model, self.question.limits, {}
        for i in model.inputs:
            limit, u, rest = limits[i.name], inputs[i.name], self.question.rest(i.name)
            low, high, rate = (
                float(u.min()),
                float(u.max()),
                float(np.abs(np.diff(u)).max()) / self.question.sampling_time,
            )
            # An input is what is played: it needs no reserve, unlike a predicted signal.
            usage = max(_usage(low, high, rest, limit, 0.0), rate / limit.rate)
            predictions[i.name] = LimitPrediction(limit.low, limit.high, i.unit, low, high, limit.rate, rate, usage)
        if not self.needs_runs:
            return predictions
        units = {s.name: s.unit for s in model.all_states} | {o.name: o.unit for o in model.outputs}
        ranges = self._ranges(inputs)
        for name, limit in limits.items():
            if name not in predictions:
                low, high, rest = ranges.get(name, (-math.inf, math.inf, 0.0))
                usage = _usage(low, high, rest, limit, MARGIN_RESERVE)
                unit = units.get(name, "")
                predictions[name] = LimitPrediction(limit.low, limit.high, unit, low, high, math.inf, 0.0, usage)
        return predictions

    def _ranges(self, inputs: Mapping[str, np.ndarray]) -> dict[str, tuple[float, float, float]]:
        """Predicted low, high and value at rest of each limited state and output."""
        ranges: dict[str, tuple[float, float, float]] = {}
        for plant, drawn in zip(self.plants, self.draws, strict=True):
            runs = [p.simulate(inputs) for p in (plant, *drawn)]
            if not all(np.isfinite(y).all() and np.isfinite(x).all() for y, x in runs):
                # No range of an explanation that overflows: its limits then count as broken without end.
                return {}
            for name, place in plant.locate(self.question.limits).items():
                signals = np.array([run[place.kind][:, place.column] for run in runs])
                # Whichever is wider at each time: the extreme draw, or mean and deviations, which reach beyond few draws.
                middle, spread = signals.mean(axis=0), MARGIN_DEVIATIONS * signals.std(axis=0)
                low = float(min(signals.min(), (middle - spread).min()))
                high = float(max(signals.max(), (middle + spread).max()))
                before = ranges.get(name, (low, high, float(signals[0, 0])))
                ranges[name] = min(low, before[0]), max(high, before[1]), before[2]
        return ranges

    def load(self, predictions: Mapping[str, LimitPrediction]) -> tuple[float, str]:
        """The signal that comes closest to what it may use of its limit: how much of that it uses, and its name."""
        loads = {name: p.usage / self.question.share(name) for name, p in predictions.items()}
        name = max(loads, key=lambda n: loads[n])
        return loads[name], name


def largest_usage(predictions: Mapping[str, LimitPrediction]) -> tuple[float, str]:
    """The limit that rules: how much of it is used, and its name."""
    name = max(predictions, key=lambda n: predictions[n].usage)
    return predictions[name].usage, name


# Times that an input is made smaller until every limit holds; each comes close, so that more would mean that none does.
MARGIN_TRIES = 14
# Share of the input's range below which an input counts as none.
LEAST_AMPLITUDE = 0.0001


def fit_into_limits(
    keeper: LimitKeeper, shapes: Mapping[str, InputShape]
) -> tuple[float, dict[str, np.ndarray], dict[str, LimitPrediction]]:
    """The largest amplitude (a share of the range) at which all limits hold, the inputs there, and what is predicted.

    Raises
    ------
    DataError
        Where no amplitude keeps the limits.
    """
    amplitude, kept = 1.0, None
    low, high = 0.0, 1.0
    for _ in range(MARGIN_TRIES):
        inputs = play(keeper.question, shapes, amplitude)
        predictions = keeper.predict(inputs)
        load, ruling = keeper.load(predictions)
        if load <= 1 + 1e-9:
            low, kept = amplitude, (amplitude, inputs, predictions)
            if amplitude == 1.0 or load >= 1 - MARGIN_RESERVE:
                break
            # By the rule of three: exact where the plant is linear about its rest; bisection where that does not
            # move any more.
            grown = min(amplitude / max(load, 0.1), high)
            amplitude = grown if grown < high else (low + high) / 2
            if high - low < MARGIN_RESERVE * high:
                break
        else:
            high = amplitude
            # 0.99 so that a linear plant keeps the limit at the next try; nothing is known of the load of a run that
            # overflows.
            shrunk = amplitude * 0.3 if not math.isfinite(load) else 0.99 * amplitude / load
            amplitude = max(shrunk, (low + high) / 2) if kept else shrunk
        if amplitude < LEAST_AMPLITUDE:
            break
    if kept is None:
        limit = keeper.question.limits[ruling]
        raise DataError(
            f"limit of {ruling!r}: no input keeps {limit_text(limit.low, limit.high, digits=6)} under every explanation and what is not"
            " known of its constants; widen the limit, or determine the constants better first"
        )
    return kept


def _usage(low: float, high: float, rest: float, limit: SignalLimit, reserve: float) -> float:
    """Share of the way from rest to the limits that is used."""
    used = 0.0
    for value, end in ((high - rest, limit.high - rest), (rest - low, rest - limit.low)):
        # A limit that lies on the rest leaves no room: any movement towards it breaks it.
        room = (1 - reserve) * end
        if not math.isfinite(value):
            return math.inf
        if value > 0 and math.isfinite(room):
            used = max(used, value / room if room > 0 else math.inf)
    return float(used)
