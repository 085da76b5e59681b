"""What an input may do to the plant: ranges with a margin for what is not known, and the largest amplitude that keeps all limits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.base.errors import DataError
from greybox.extensions.design.inputs import InputShape, play
from greybox.extensions.design.plant import PlantScenario
from greybox.extensions.design.problem import DesignProblem


@dataclass(frozen=True)
class LimitPrediction:
    """One limit and what is predicted: the range over every explanation and every draw of its constants, with its margin.

    Parameters
    ----------
    low, high, unit
        The limit.
    predicted_low, predicted_high
        The predicted range.
    rate, predicted_rate
        Of an input: the largest change in a second that is allowed, and that occurs.
    usage
        Share of the way from rest to the limit that is used; above one it is broken.
    """

    low: float
    high: float
    unit: str
    predicted_low: float
    predicted_high: float
    rate: float
    predicted_rate: float
    usage: float


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
        inputs = {i.name for i in self.question.model.inputs}
        return any(name not in inputs for name in self.question.limits)

    def predict(self, inputs: Mapping[str, np.ndarray]) -> dict[str, LimitPrediction]:
        """Each limit with its predicted range; infinite usage where a run overflows."""
        predictions = {}
        step = self.question.sampling_time
        model = self.question.model
        units = {s.name: s.unit for s in model.all_states} | {o.name: o.unit for o in model.outputs}
        for i in self.question.model.inputs:
            limit, u, rest = self.question.limits[i.name], inputs[i.name], self.question.rest(i.name)
            rate = float(np.abs(np.diff(u)).max()) / step
            # An input is what is played: it needs no reserve, unlike a predicted signal.
            usage = max(_usage(u.min(), u.max(), limit.low, limit.high, rest, 0.0), rate / limit.rate)
            predictions[i.name] = LimitPrediction(
                limit.low, limit.high, i.unit, float(u.min()), float(u.max()), limit.rate, rate, usage
            )
        if not self.needs_runs:
            return predictions
        ranges = self._ranges(inputs)
        for name, limit in self.question.limits.items():
            if name in predictions:
                continue
            low, high, rest = ranges.get(name, (-math.inf, math.inf, 0.0))
            usage = _usage(low, high, limit.low, limit.high, rest, MARGIN_RESERVE)
            predictions[name] = LimitPrediction(
                limit.low, limit.high, units.get(name, ""), low, high, math.inf, 0.0, usage
            )
        return predictions

    def _ranges(self, inputs: Mapping[str, np.ndarray]) -> dict[str, tuple[float, float, float]]:
        """Predicted low, high and value at rest of each limited state and output."""
        ranges: dict[str, tuple[float, float, float]] = {}
        for plant, drawn in zip(self.plants, self.draws, strict=True):
            runs = [p.simulate(inputs) for p in (plant, *drawn)]
            if not all(np.isfinite(y).all() and np.isfinite(x).all() for y, x in runs):
                # No range of an explanation that overflows: its limits then count as broken without end.
                return {}
            names = [s.name for s in plant.model.all_states], [o.name for o in plant.model.outputs]
            for name in self.question.limits:
                if name in names[1]:
                    signals = np.array([y[:, names[1].index(name)] for y, _ in runs])
                elif name in names[0]:
                    signals = np.array([x[:, names[0].index(name)] for _, x in runs])
                else:
                    continue
                # Whichever is wider at each time: the extreme draw, or mean and deviations, which reach beyond few
                # draws.
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
            f"limit of {ruling!r}: no input keeps {limit.low:g} to {limit.high:g} under every explanation and what is not known of its"
            " constants; widen the limit, or determine the constants better first"
        )
    return kept


def _usage(low: float, high: float, least: float, most: float, rest: float, reserve: float) -> float:
    """Share of the way from rest to the limits that is used."""
    used = 0.0
    for value, end in ((high - rest, most - rest), (rest - low, rest - least)):
        # A limit that lies on the rest leaves no room: any movement towards it breaks it.
        room = (1 - reserve) * end
        if not math.isfinite(value):
            return math.inf
        if value > 0 and math.isfinite(room):
            used = max(used, value / room if room > 0 else math.inf)
    return float(used)
