"""The nonlinear model for python-control: continuous where it is smooth, sampled with everything in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from greybox.errors import ModelError
from greybox.export.discrete_step import DiscreteStep, find_delay_parameters, make_discrete_step, name_past_inputs
from greybox.export.identifiers import to_identifier, to_identifiers
from greybox.export.plant import Plant, to_plant
from greybox.model import Model
from greybox.result import Fit


def to_nonlinear_system(plant: Fit | Model, dt: float | None = None, *, substeps: int = 0) -> Any:
    """``control.NonlinearIOSystem`` of a fit or model, with signal names; its ``params`` are the constants by name (not of a delay).

    ``dt`` None: the continuous equations. ``dt`` in seconds: one sampling interval with held inputs, stepped as the library steps it,
    with dry friction that sticks, play and delays in it (earlier values of a delayed input are states ``u_1, u_2, ...``).

    Raises ModelError for a continuous system of a model with an effect that is more than a differential equation; it names the effect.
    """
    source = to_plant(plant)
    return _continuous(source) if dt is None else _sampled(source, make_discrete_step(source, dt, substeps=substeps))


def find_discontinuous_effects(model: Model) -> list[str]:
    """Effects of ``model`` that ordinary differential equations cannot hold, each with the reason."""
    s = model.system
    return [
        *(f"{d.effect} (it sticks: the velocity stays at zero for a while)" for d in s.dry),
        *(f"{u.effect} (its state {s.state_names[u.state]!r} is set, it has no rate)" for u in s.updates),
        *(f"{d.effect} (it needs earlier values of the input)" for d in s.delays),
    ]


def _continuous(plant: Plant) -> Any:
    import control

    model, s = plant.model, plant.model.system
    beyond = find_discontinuous_effects(model)
    if beyond:
        raise ModelError(
            f"{model.title} is no ordinary differential equation: {', '.join(beyond)}; give dt for a sampled system that holds it"
        )
    rates, outputs = s.rhs_function, s.output_function
    own, values = _constants(plant)

    def update(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        return rates(_row(x, s.x.numel()), _row(u, s.u.numel()), values(params)).full().ravel()

    def read(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        return outputs(_row(x, s.x.numel()), _row(u, s.u.numel()), values(params)).full().ravel()

    return control.NonlinearIOSystem(
        update, read, inputs=to_identifiers(s.input_names), outputs=to_identifiers(s.output_names),
        states=to_identifiers(s.state_names), params=own, name=to_identifier(model.title),
    )  # fmt: skip


def _sampled(plant: Plant, interval: DiscreteStep) -> Any:
    import control

    model, s = plant.model, plant.model.system
    nx, column = s.x.numel(), interval.late_input
    own, values = _constants(plant)

    def update(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        x, u = np.asarray(x, float).ravel(), _row(u, s.u.numel())
        after = interval.advanced(x[:nx], x[nx:], u, values(params))
        return np.concatenate([after, u[[column]], x[nx:-1]]) if interval.past else after

    def read(t: float, x: Any, u: Any, params: Mapping[str, float]) -> np.ndarray:
        x = np.asarray(x, float).ravel()
        return interval.outputs(x[:nx], x[nx:], _row(u, s.u.numel()), values(params))

    return control.NonlinearIOSystem(
        update, read, inputs=to_identifiers(s.input_names), outputs=to_identifiers(s.output_names),
        states=to_identifiers([*s.state_names, *name_past_inputs(interval)]), params=own, name=to_identifier(model.title), dt=interval.dt,
    )  # fmt: skip


def _row(values: Any, size: int) -> np.ndarray:
    return np.asarray(values, float).ravel()[:size]


def _constants(plant: Plant) -> tuple[dict[str, float], Callable[[Mapping[str, float]], np.ndarray]]:
    """The constants that may be changed, under names that control systems allow, and how they become an array again."""
    names, fixed = plant.model.system.parameter_names, find_delay_parameters(plant.model)
    own = dict(zip(to_identifiers(names), map(float, plant.p), strict=True))

    def values(params: Mapping[str, float]) -> np.ndarray:
        return np.array([params.get(name, value) for name, value in own.items()])

    return {name: value for (name, value), true in zip(own.items(), names, strict=True) if true not in fixed}, values
