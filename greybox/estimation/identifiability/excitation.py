"""`analyse_excitation`: how much an input can tell, whatever the model, and whether that is enough for a given one."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from greybox.base import ROWS_AT_A_TIME, DataError, Finding, Printable, Severity
from greybox.data.experiment import Experiment
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode, fastest_and_slowest_rate
from greybox.estimation.identifiability.structural import StructuralIdentifiability, analyse_structural_identifiability
from greybox.model import Model


@dataclass(frozen=True)
class Excitation(Printable):
    """How rich the inputs of a record are.

    Parameters
    ----------
    orders
        Input -> order of persistent excitation, at most ``limit`` (``limit`` means: as rich as can be seen).
    bands
        Input -> frequency in rad/s below which 99.9 % of its movement lies.
    limit
        Highest order that the record can show.
    needed
        Order that the model needs; None without a model or for a nonlinear one, for which no order is enough or too little by itself.
    poles
        Fastest motion of the model in rad/s.
    findings
        Where the inputs are too poor for the model.
    """

    orders: Mapping[str, int]
    bands: Mapping[str, float]
    limit: int
    needed: int | None = None
    poles: float = 0.0
    findings: tuple[Finding, ...] = ()

    KEYS: ClassVar[str] = "* warnings=str(findings)"


# Band over the model's fastest motion, below which that motion hardly shows.
MIN_BAND_SHARE = 0.5


def analyse_excitation(
    experiment: Experiment, model: Model | None = None, *, structure: StructuralIdentifiability | None = None
) -> Excitation:
    """Persistent excitation of the inputs of a record, against what a model asks for.

    An input is persistently exciting of order ``n`` when ``n`` of its values at different lags are linearly independent
    throughout: 1 for a constant or a step, 2 for each sinusoid, any number for noise. Each of them carries one number
    about each measured output. Judged by the rank of the lagged inputs in short segments of the record, the median of
    these, so that a single step in a long record does not count; lags are spread over half a segment, so that slow tones
    in fast sampling are distinguished.

    Parameters
    ----------
    experiment
        The record.
    model
        What the inputs are to excite; None looks at the inputs alone.
    structure
        The model's `analyse_structural_identifiability`, if it is at hand: saves computing it.

    Returns
    -------
    Excitation
        Orders, bands, and findings where they are too low for the model.

    Raises
    ------
    DataError
        For an input of the model that the experiment does not have.

    Examples
    --------
    >>> analyse_excitation(record, model).orders  # doctest: +SKIP
    {'u': 40}
    """
    names = list(experiment.inputs) if model is None else [i.name for i in model.inputs]
    missing = [name for name in names if name not in experiment.inputs]
    if missing:
        raise DataError(
            f"experiment {experiment.name!r} has no input {missing[0]!r}; it has {', '.join(experiment.inputs) or 'none'}"
        )
    limit = _find_highest_order(experiment.rows)
    orders = {name: excitation_order(experiment.inputs[name]) for name in names}
    bands = {name: excitation_bandwidth(experiment.time, experiment.inputs[name]) for name in names}
    # What a model needs of an input is read off its equations.
    if model is None or not names or not model.has_equations:
        return Excitation(orders, bands, limit)
    fastest, _ = fastest_and_slowest_rate(model)
    needed = None
    if model.system.linear:
        measured = [o.name for o in model.outputs if o.name in experiment.outputs]
        structure = structure or analyse_structural_identifiability(model, measured or None)
        # Each measured output carries one number for each order of excitation.
        needed = math.ceil(structure.rank / len(structure.outputs))
    moves, total, widest = (
        any(np.ptp(experiment.inputs[name]) > 0 for name in names),
        sum(orders.values()),
        max(bands.values()),
    )
    findings = []
    # The order is that of the median segment: an input that steps now and then and rests at zero between has order 0, and moves.
    if not (total or moves):
        findings = [Finding(IdentifiabilityCode.NO_INPUT_MOVES, Severity.WARNING)]
    else:
        if needed is not None and total < needed and max(orders.values()) < limit:
            figures = {"inputs": list(orders), "order": total, "needed": needed}
            findings.append(Finding(IdentifiabilityCode.EXCITATION_ORDER_LOW, Severity.WARNING, values=figures))
        if 0 < widest < MIN_BAND_SHARE * fastest:
            rates = {"band": widest, "fastest": fastest}
            findings.append(Finding(IdentifiabilityCode.EXCITATION_BAND_NARROW, Severity.WARNING, values=rates))
    return Excitation(orders, bands, limit, needed, fastest, tuple(findings))


# Size of a direction of the lagged inputs, over the largest one, from which it counts.
ORDER_THRESHOLD = 0.001


def excitation_order(u: np.ndarray) -> int:
    """Order of persistent excitation of one input (N,), at most about a quarter of its rows and the policy's highest."""
    size = float(np.abs(u).max(initial=0.0))
    if size == 0.0:
        return 0
    length = _choose_segment(len(u))
    limit = _find_highest_order(len(u))
    generator = np.random.default_rng(0)  # lags without a common divisor: no two tones look alike
    lags = np.sort(generator.choice(np.arange(1, length // 2), limit - 1, replace=False))
    lags = np.concatenate([[0], lags])
    count = length - int(lags[-1])
    orders = []
    for k in range(len(u) // length):
        # Rank of U = [u(t + lag_1) ... u(t + lag_n)]: the order is the number of lags that are linearly independent. Its singular
        # values are the roots of the eigenvalues of U'U, which is summed over blocks of rows and keeps the digits that the threshold asks.
        gram = np.zeros((len(lags), len(lags)))
        for first in range(0, count, ROWS_AT_A_TIME):
            rows = min(ROWS_AT_A_TIME, count - first)
            begin = k * length + first
            delayed = np.stack([u[begin + lag : begin + lag + rows] for lag in lags]) / size
            gram += delayed @ delayed.T
        squares = np.linalg.eigvalsh(gram)
        orders.append(int((squares > ORDER_THRESHOLD**2 * squares[-1]).sum()) if squares[-1] > 0 else 0)
    return statistics.median_high(orders)


# Share of an input's movement that lies below its band.
BAND_POWER = 0.999


def excitation_bandwidth(time: np.ndarray, u: np.ndarray) -> float:
    """Frequency in rad/s below which nearly all of the movement of an input (N,) lies."""
    count, duration = len(time), float(time[-1] - time[0])
    even = np.interp(np.linspace(time[0], time[-1], count), time, u)
    even -= even.mean()
    for first in range(0, count, ROWS_AT_A_TIME):
        rows = np.arange(first, min(first + ROWS_AT_A_TIME, count))
        # Von Hann's window: the jump from the record's end to its beginning would look like a wide band.
        even[rows] *= 0.5 - 0.5 * np.cos(2 * np.pi * rows / max(count - 1, 1))
    spectrum = np.fft.rfft(even)
    del even
    power = np.square(spectrum.real)
    power += np.square(spectrum.imag)
    total = float(power.sum())
    if total <= 0:
        return 0.0
    # The first line below which this share of the power lies.
    k = int(np.searchsorted(np.cumsum(power, out=power), BAND_POWER * total))
    # Frequency k of n samples h seconds apart: k / (n h).
    return 2 * np.pi * min(k, len(power) - 1) * (count - 1) / (count * duration)


# Parts of a record of which the median order counts, so that a single step in a long record does not.
EXCITATION_SEGMENTS = 8
# Fewest rows of a part; shorter records have fewer parts.
MIN_SEGMENT_ROWS = 60


def _choose_segment(rows: int) -> int:
    return max(min(MIN_SEGMENT_ROWS, rows), rows // EXCITATION_SEGMENTS)


# Highest order of persistent excitation that is looked for; no model of an actuator needs more coefficients.
MAX_ORDER = 40


def _find_highest_order(rows: int) -> int:
    return max(1, min(MAX_ORDER, _choose_segment(rows) // 4))
