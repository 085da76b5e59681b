"""Process noise: how strongly each state is pushed at random, and which intensities make sense."""

from __future__ import annotations

import math
from collections.abc import Sequence

import casadi as ca

from greybox.base import ModelError, format_unit, nearest
from greybox.model.signals import Expression, NamedValues, Parameter, State
from greybox.model.system import PlacedEffect, System


def build_diffusion(states: Sequence[State], effects: Sequence[PlacedEffect], p: NamedValues) -> ca.SX:
    """Intensity of each state's process noise (nx,), in the state's unit over sqrt(s): those of the plant, then of its effects.

    ``p`` are the parameters by name; a state of an effect sees the effect's own ones first.
    """
    plant = [_intensity(s, p) for s in states]
    of_effects = [_intensity(s, effect.sees_parameters(p)) for effect in effects for s in effect.states]
    return ca.SX(ca.vertcat(*map(ca.SX, (*plant, *of_effects))))


def _intensity(state: State, p: NamedValues) -> Expression:
    if callable(state.noise):
        return state.noise(p)
    if isinstance(state.noise, str) and state.noise not in p:
        raise ModelError(
            f"noise of state {state.name!r}: no parameter {state.noise!r}; {nearest(state.noise, p.names)}"
        )
    return p[state.noise] if isinstance(state.noise, str) else state.noise


def check_process_noise(title: str, system: System, parameters: Sequence[Parameter]) -> None:
    """Refuse process noise that cannot be one: negative or not finite, on a state that is set and not moved, of either sign.

    ``parameters`` are those of ``system.p``, in its order.
    """
    problems = []
    set_afterwards = {u.state for u in system.updates}
    for k, (state, value) in enumerate(zip(system.states, _intensities(system, parameters), strict=True)):
        subject = f"noise of state {state.name!r}"
        if not (math.isfinite(value) and value >= 0):
            problems.append(
                f"{subject}: {value:g} {intensity_unit(state)} is not an intensity; give a finite value of 0 or more"
            )
        # dx = f dt + sigma dw pushes the rate of a state; one that is set has no rate.
        elif k in set_afterwards and not system.diffusion[k].is_zero():
            problems.append(f"{subject}: this state is set after each step and has no rate to push; put it on another")
    intensities = set(find_noise_parameters(system))
    for q in parameters:
        if q.name in intensities and q.bounds[0] < 0:
            problems.append(
                f"parameter {q.name!r}: the intensity of process noise must be 0 or more; set"
                f" bounds=(0, {q.bounds[1]:g})"
            )
    if problems:
        raise ModelError(f"model {title!r}: {'; '.join(problems)}")


def intensity_name(state: str) -> str:
    """Name of the parameter that `Model.with_process_noise` makes for a state: ``noise_v``."""
    return f"noise_{state.replace('.', '_')}"


def intensity_unit(state: State) -> str:
    """Unit of the intensity of a state's process noise: the state's over the root of a second."""
    return format_unit(f"({state.unit or '1'})/s^0.5")


def noise_intensities(system: System, parameters: Sequence[Parameter]) -> dict[str, float]:
    """State -> intensity of its process noise at the values of ``parameters``, in the state's unit over sqrt(s)."""
    return dict(zip(system.state_names, _intensities(system, parameters), strict=True))


def find_noisy_states(system: System, parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """States with process noise: its intensity is not zero at the values of ``parameters``, or is free to become so."""
    free = {q.name for q in parameters if not q.fixed}
    return tuple(
        name
        for k, (name, value) in enumerate(noise_intensities(system, parameters).items())
        if value != 0 or free & {s.name() for s in ca.symvar(system.diffusion[k])}
    )


def find_noise_parameters(system: System) -> tuple[str, ...]:
    """Names of the parameters that are intensities of process noise: no other equation contains them."""
    in_diffusion = {s.name() for s in ca.symvar(system.diffusion)}
    if not in_diffusion:
        return ()
    # A parameter that another equation contains as well is a constant of the plant, whatever scales the noise.
    elsewhere = {s.name() for s in ca.symvar(ca.vertcat(*system.free_run_expressions))}
    return tuple(name for name in system.parameter_names if name in in_diffusion - elsewhere)


def _intensities(system: System, parameters: Sequence[Parameter]) -> list[float]:
    if system.diffusion.is_zero():
        return [0.0] * len(system.states)
    return system.diffusion_function([q.value for q in parameters]).full().ravel().tolist()
