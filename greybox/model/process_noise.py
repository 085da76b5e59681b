"""Process noise: how strongly each state is pushed at random, what may be said about it, and how a model is given some."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import casadi as ca

from greybox.errors import ModelError, nearest
from greybox.model.signals import Expression, NamedValues, Parameter, State
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.model.model import Model
    from greybox.model.system import BoundEffect


def build_diffusion(states: Sequence[State], effects: Sequence[BoundEffect], p: NamedValues) -> ca.SX:
    """Intensity of each state's process noise (nx,), in the state's unit over sqrt(s): those of the plant, then of its effects.

    ``p`` are the constants by name; a state of an effect sees the effect's own ones first.
    """
    own = [_intensity(s, b.within(p, b.effect.parameters)) for b in effects for s in b.states]
    return ca.vertcat(*[ca.SX(value) for value in (*(_intensity(s, p) for s in states), *own)])


def _intensity(state: State, p: NamedValues) -> Expression:
    if callable(state.noise):
        return state.noise(p)
    if isinstance(state.noise, str) and state.noise not in p:
        raise ModelError(
            f"noise of state {state.name!r}: no parameter {state.noise!r}; {nearest(state.noise, p.names)}"
        )
    return p[state.noise] if isinstance(state.noise, str) else state.noise


def check_process_noise(model: Model) -> None:
    """Refuse process noise that cannot be one: negative or not finite, on a state that is set and not moved, of either sign."""
    system = model.system
    problems = []
    values = noise_intensities(model)
    set_afterwards = {u.state for u in system.updates}
    for k, (state, value) in enumerate(zip(model.all_states, values.values(), strict=True)):
        subject = f"noise of state {state.name!r}"
        if not (math.isfinite(value) and value >= 0):
            problems.append(
                f"{subject}: {value:g} {intensity_unit(state)} is no intensity; give a finite one from 0 up"
            )
        elif k in set_afterwards and not system.diffusion[k].is_zero():
            problems.append(f"{subject}: this state is set after each step and has no rate to push; put it on another")
    for name in noise_parameters(model):
        q = model.parameter(name)
        if q.bounds[0] < 0:
            problems.append(
                f"parameter {name!r}: an intensity of process noise has no sign; bound it from 0 up:"
                f" bounds=(0, {q.bounds[1]:g})"
            )
    if problems:
        raise ModelError(f"model {model.title!r}: {'; '.join(problems)}")


def intensity_name(state: str) -> str:
    """Name of the parameter that `with_process_noise` makes for a state: ``noise_v``."""
    return f"noise_{state.replace('.', '_')}"


def intensity_unit(state: State) -> str:
    """Unit of the intensity of a state's process noise: the state's over the root of a second."""
    return format_unit(f"({state.unit or '1'})/s^0.5")


def noisy_states(model: Model) -> tuple[str, ...]:
    """States with process noise: its intensity is not zero at the present values, or is free to become so."""
    system = model.system
    free = {q.name for q in model.free_parameters}
    return tuple(
        name
        for k, (name, value) in enumerate(noise_intensities(model).items())
        if value != 0 or free & {s.name() for s in ca.symvar(system.diffusion[k])}
    )


def noise_intensities(model: Model) -> dict[str, float]:
    """Intensity of each state's process noise at the present values, in the state's unit over sqrt(s)."""
    system = model.system
    values = ca.Function("noise", [system.p], [system.diffusion])(list(model.values.values())).full().ravel()
    return dict(zip(system.state_names, values.tolist(), strict=True))


def noise_parameters(model: Model) -> tuple[str, ...]:
    """Names of the constants that are intensities of process noise: no other equation speaks of them."""
    system = model.system
    pushed = {s.name() for s in ca.symvar(system.diffusion)}
    elsewhere = {s.name() for s in ca.symvar(ca.vertcat(*system.free_run_expressions))}
    return tuple(name for name in system.parameter_names if name in pushed - elsewhere)


def with_process_noise(model: Model, estimated: Sequence[str], known: Mapping[str, float | str]) -> Model:
    """``model`` with process noise on some of its states, in the place of what they had.

    ``estimated``: states whose intensity is a new parameter ``noise_<state>`` that starts at 0; ``known``: state -> intensity or the
    name of a parameter. Raises ModelError for an unknown state.
    """
    names = [s.name for s in model.all_states]
    unknown = [n for n in (*estimated, *known) if n not in names]
    if unknown:
        raise ModelError(f"model {model.title!r} has no state {unknown[0]!r}; {nearest(unknown[0], names)}")
    units = {s.name: s.unit for s in model.all_states}
    both = [n for n in estimated if n in known]
    if both:
        raise ModelError(f"process noise of {both[0]!r}: either estimated or known; name the state once")
    noise: dict[str, float | str] = dict(known)
    added = []
    for name in estimated:
        parameter = intensity_name(name)
        noise[name] = parameter
        if parameter not in model.values:
            unit = f"({units[name] or '1'})/s^0.5"
            described = f"intensity of the process noise of {name}"
            added.append(Parameter(parameter, unit, 0.0, (0.0, math.inf), description=described))
    plant = tuple(replace(s, noise=noise[s.name]) if s.name in noise else s for s in model.states)
    effects = []
    for b in model.bound_effects:
        own = [
            replace(inner, noise=noise[outer.name]) if outer.name in noise else inner
            for inner, outer in zip(b.effect.states, b.states, strict=True)
        ]
        effects.append(replace(b.effect, states=tuple(own)))
    return replace(model, states=plant, parameters=(*model.parameters, *added), effects=tuple(effects))
