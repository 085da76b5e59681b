"""How large things are in a record: what start values of effects are measured by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from greybox.effects.policy import START
from greybox.errors import DataError
from greybox.model import Effect, Model
from greybox.numerics import INTEGRATING_POLE


@dataclass(frozen=True)
class Scales:
    """How large and how fast things are in a record, in the units of the model: what start values of effects are measured by.

    A peak is 0 where the model has no such signal, and 1 where it has one and nothing moves.

    Attributes
    ----------
    displacement, velocity, current
        Peak absolute values of the states with these roles.
    input
        Peak of the first input.
    sensor
        How far the main output moves from its first value.
    force, storage
        Largest term of the balance ``force``, and what it stores (the mass).
    balances
        Largest term of each balance, by its name.
    period, duration
        Time between samples and length of the record, in s.
    fastest, slowest
        Time constants ``1 / |lambda|`` of the model along the record in s, integrators left out, at most the duration.
    reading
        Peak of the main output itself.
    peaks
        Peak of every state that has a role, by role.
    """

    displacement: float
    velocity: float
    current: float
    input: float
    sensor: float
    force: float
    storage: float
    balances: Mapping[str, float]
    period: float
    duration: float
    fastest: float
    slowest: float
    reading: float = 1.0
    peaks: Mapping[str, float] = field(default_factory=dict)

    @property
    def visible_force(self) -> float:
        """A small share of the largest force: an effect of this size is visible but small (`StartingValues.visible_share`)."""
        return START.visible_share * self.force


def measure_scales(model: Model, x: np.ndarray, u: np.ndarray, period: float) -> Scales:
    """The scales of a model along a record or a simulation of it.

    Parameters
    ----------
    model
        The model; its parameters have the values of the simulation.
    x, u
        Its states (N, nx) and inputs (N, nu). Rows that are not finite are left out.
    period
        Time between rows in s.

    Returns
    -------
    Scales
        Peaks, largest terms and time constants.

    Raises
    ------
    DataError
        If no row is finite.
    """
    system, p = model.system, np.array(list(model.values.values()))
    duration = period * max(len(x) - 1, 1)
    every = max(1, len(x) // START.rows)
    x, u = np.asarray(x, float)[::every], np.asarray(u, float).reshape(len(u), -1)[::every]
    is_finite = np.isfinite(x).all(axis=1) & np.isfinite(u).all(axis=1)
    x, u = x[is_finite], u[is_finite]
    if not len(x):
        raise DataError(
            f"model {model.title!r}: no row of the simulated states is finite; start from other values of its parameters"
        )
    roles = {state.role: k for k, state in enumerate(model.all_states) if state.role}

    def peak(role: str) -> float:
        return _peak(x[:, roles[role]]) if role in roles else 0.0

    arguments = [system.x, system.u, system.p]
    every_term = [ca.Function("terms", arguments, [ca.vertcat(*b.terms.values())]) for b in system.balances]
    balances = {b.name: _peak(np.asarray(f(x.T, u.T, p))) for b, f in zip(system.balances, every_term, strict=True)}
    stored = next((b.storage for b in system.balances if b.name == "force"), 0)
    shown = np.asarray(system.output_function(x.T, u.T, p))[0]
    storage = ca.Function("storage", arguments, [ca.SX(stored)])
    fastest, slowest = _time_constants(model, x, u, p, duration)
    return Scales(
        displacement=peak("displacement"),
        velocity=peak("velocity"),
        current=peak("current"),
        input=_peak(u[:, 0]) if u.shape[1] else 0.0,
        sensor=_peak(shown - shown[0]),
        force=balances.get("force", 0.0),
        storage=float(storage(x[0], u[0], p)),
        balances=balances,
        period=period,
        duration=duration,
        fastest=fastest,
        slowest=slowest,
        reading=_peak(shown),
        peaks={role: peak(role) for role in roles},
    )


def tailor_to_record(entry: Effect, scales: Scales) -> Effect:
    """An effect of the catalogue made ready for a record.

    Shape parameters start inside their grid, and their bounds reach `StartingValues.bounds_reach` times further; a delay gets its longest
    value: the catalogue cannot know how the record is sampled.

    Parameters
    ----------
    entry
        An effect.
    scales
        Those of the record, from `measure_scales`.

    Returns
    -------
    Effect
        The same effect with other start values and bounds.
    """
    grid = entry.grid(scales) if entry.grid else {}
    limits = dict(entry.limits(scales)) if entry.limits else {}
    parameters = []
    for q in entry.parameters:
        low, high = q.bounds
        value = q.value
        if q.name in limits:
            low, high = limits[q.name]
        elif q.name in grid and q.name not in entry.amplitudes:
            values = sorted(grid[q.name])
            value = values[len(values) // 2]
            if q.positive and low < values[0] and values[-1] < high:
                low, high = max(low, values[0] / START.bounds_reach), min(high, values[-1] * START.bounds_reach)
        parameters.append(replace(q, bounds=(low, high), value=min(max(value, low), high)))
    return replace(entry, parameters=tuple(parameters))


def _peak(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0)) or 1.0


def _time_constants(model: Model, x: np.ndarray, u: np.ndarray, p: np.ndarray, duration: float) -> tuple[float, float]:
    rates = []
    for k in range(0, len(x), max(1, len(x) // 10)):
        jacobian = model.system.jacobian(x[k], u[k], p).full()
        if np.isfinite(jacobian).all():
            rates.append(np.abs(np.linalg.eigvals(jacobian)))
    magnitudes = np.concatenate([*rates, np.empty(0)])
    moving = magnitudes[magnitudes > INTEGRATING_POLE * magnitudes.max(initial=0.0)]
    if not len(moving):
        return duration, duration
    return min(1 / float(moving.max()), duration), min(1 / float(moving.min()), duration)
