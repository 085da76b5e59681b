"""`analyse_excitation`: how much an input can tell, whatever the model, and whether that is enough for a given one."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError
from greybox.experiment import Experiment
from greybox.identifiability.generic_experiment import fastest_and_slowest_rate
from greybox.identifiability.structural import StructuralIdentifiability, analyse_structural_identifiability
from greybox.model import Model

MOST_ORDER = 40
SEGMENTS, LEAST_ROWS = 8, 60  # of each segment
# A direction of the lagged inputs counts when its size is at least this share of the largest one.
COUNTS = 1e-3
POWER = 0.999  # share of an input's movement that lies below its band


@dataclass(frozen=True)
class Excitation:
    """``orders``: input -> order of persistent excitation, at most ``limit`` (``limit`` means: as rich as can be seen).

    ``bands``: input -> frequency in rad/s below which 99.9 % of its movement lies. ``needed``: the order that the model
    needs, None without a model or for a nonlinear one, for which no order is enough or too little by itself. ``poles``:
    the fastest motion of the model in rad/s. ``warnings``: sentences.
    """

    orders: Mapping[str, int]
    bands: Mapping[str, float]
    limit: int
    needed: int | None = None
    poles: float = 0.0
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        said = [
            f"{name}: persistently exciting of order {f'{order} or more' if order == self.limit else order}, moves below"
            f" {self.bands[name]:.3g} rad/s"
            for name, order in self.orders.items()
        ]
        return "\n".join([*said, *self.warnings])


def analyse_excitation(
    experiment: Experiment, model: Model | None = None, *, structure: StructuralIdentifiability | None = None
) -> Excitation:
    """Persistent excitation of the inputs of ``experiment``, against what ``model`` asks for.

    An input is persistently exciting of order ``n`` when ``n`` of its values at different lags are linearly independent
    throughout: 1 for a constant or a step, 2 for each sinusoid, any number for noise. Each of them carries one number
    about each measured output. Judged by the rank of the lagged inputs in short segments of the record, the median of
    these, so that a single step in a long record does not count; lags are spread over half a segment, so that slow tones
    in fast sampling are told apart.

    ``structure`` saves the time of finding out again what the model's outputs can tell. Raises DataError for an input of
    the model that the experiment does not have.
    """
    names = list(experiment.inputs) if model is None else [i.name for i in model.inputs]
    missing = [name for name in names if name not in experiment.inputs]
    if missing:
        raise DataError(
            f"experiment {experiment.name!r} has no input {missing[0]!r}; it has {', '.join(experiment.inputs) or 'none'}"
        )
    limit = _limit(experiment.rows)
    orders = {name: excitation_order(experiment.inputs[name]) for name in names}
    bands = {name: excitation_bandwidth(experiment.time, experiment.inputs[name]) for name in names}
    if model is None or not names:
        return Excitation(orders, bands, limit)
    fastest, _ = fastest_and_slowest_rate(model)
    linear, needed = model.system.linear, None
    if linear:
        measured = [o.name for o in model.outputs if o.name in experiment.outputs]
        found = structure or analyse_structural_identifiability(model, measured or None)
        needed = math.ceil(found.rank / len(found.outputs))
    return Excitation(orders, bands, limit, needed, fastest, tuple(_warnings(orders, bands, limit, needed, fastest)))


def excitation_order(u: np.ndarray) -> int:
    """Order of persistent excitation of one input (N,), at most about a quarter of its rows and `MOST_ORDER`."""
    size = float(np.abs(u).max(initial=0.0))
    if size == 0.0:
        return 0
    length = _segment(len(u))
    limit = _limit(len(u))
    generator = np.random.default_rng(0)  # lags without a common divisor: no two tones look alike
    lags = np.sort(generator.choice(np.arange(1, length // 2), limit - 1, replace=False))
    lags = np.concatenate([[0], lags])
    starts = np.arange(length - lags[-1])
    found = []
    for k in range(len(u) // length):
        part = u[k * length : (k + 1) * length] / size
        s = np.linalg.svd(part[starts[:, None] + lags], compute_uv=False)
        found.append(int((s > COUNTS * s[0]).sum()) if s[0] > 0 else 0)
    return statistics.median_high(found)


def excitation_bandwidth(time: np.ndarray, u: np.ndarray) -> float:
    """Frequency in rad/s below which nearly all of the movement of an input (N,) lies."""
    grid = np.linspace(time[0], time[-1], len(time))
    even = np.interp(grid, time, u)
    even = (even - even.mean()) * np.hanning(len(even))
    power = np.abs(np.fft.rfft(even)) ** 2
    if power.sum() <= 0:
        return 0.0
    k = int(np.searchsorted(np.cumsum(power), POWER * power.sum()))
    return float(2 * np.pi * np.fft.rfftfreq(len(even), grid[1] - grid[0])[min(k, len(power) - 1)])


def _segment(rows: int) -> int:
    return max(min(LEAST_ROWS, rows), rows // SEGMENTS)


def _limit(rows: int) -> int:
    return max(1, min(MOST_ORDER, _segment(rows) // 4))


def _warnings(
    orders: Mapping[str, int], bands: Mapping[str, float], limit: int, needed: int | None, fastest: float
) -> list[str]:
    total = sum(orders.values())
    found = []
    if not total:
        return ["no input moves: only the way from the initial state tells anything"]
    if needed is not None and total < needed and max(orders.values()) < limit:
        found.append(
            f"{', '.join(orders)}: order {total}, but the model has {needed} coefficients for each output: the rest is known"
            " from transients alone; use more tones, a sweep or random levels"
        )
    widest = max(bands.values())
    if 0 < widest < 0.5 * fastest:
        found.append(
            f"the input stops at {widest:.3g} rad/s, the model's fastest motion is at {fastest:.3g} rad/s: what happens there"
            " hardly shows; excite up to it"
        )
    return found
