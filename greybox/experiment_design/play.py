"""From a shape to what a generator plays: within the range, no faster than allowed, from rest to rest."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from greybox.experiment_design.inputs import InputShape
from greybox.experiment_design.policy import PlayPolicy
from greybox.experiment_design.problem import DesignProblem, SignalLimit


def play(
    question: DesignProblem, shapes: Mapping[str, InputShape], amplitude: float, time: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """All inputs (N,) of the model: those that may move follow their shape, the others rest.

    Parameters
    ----------
    question
        Gives ranges, rates and the hold of the generator.
    shapes
        By input.
    amplitude
        Share of the way from rest to the ends of the range, 0 to 1.
    time
        Other times than the question's.
    """
    t = question.time if time is None else time
    inputs = {}
    for i in question.model.inputs:
        limit, rest = question.limits[i.name], question.rest(i.name)
        if i.name not in shapes:
            inputs[i.name] = np.full(len(t), rest)
            continue
        middle, half = (limit.low + limit.high) / 2, (limit.high - limit.low) / 2
        deviation = middle + half * shapes[i.name].sample(t) - rest
        if question.hold != "zero":
            deviation = smooth(deviation, question.policy.play.smoothing)
        u = rest + amplitude * envelope(len(t), question.policy.play) * deviation
        inputs[i.name] = limit_rate(u, rest, limit, float(t[1] - t[0]))
    return inputs


def envelope(rows: int, policy: PlayPolicy) -> np.ndarray:
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
