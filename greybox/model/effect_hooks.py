"""What an effect may bring besides terms: states that are set after each step, delays, and states that relax."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from greybox.errors import ModelError, nearest
from greybox.model.signals import Expression, State


@dataclass(frozen=True)
class StateUpdate:
    """State number ``state`` becomes ``value(x, u, p)`` after each substep, ``x`` and ``u`` at its end."""

    effect: str
    state: int
    value: ca.SX


@dataclass(frozen=True)
class InputDelay:
    """Input number ``column`` arrives ``seconds`` (an expression of the parameters) late, at most ``longest`` seconds."""

    effect: str
    column: int
    seconds: ca.SX
    longest: float


def collect_updates(
    effect: str, updates: Mapping[str, Expression], model_names: Mapping[str, str], states: Sequence[str]
) -> list[StateUpdate]:
    """The states that an effect sets; ``model_names`` leads from its names to the model's.

    Raises ModelError for a state that is not the effect's own.
    """
    others = [name for name in updates if model_names.get(name) not in states]
    if others:
        own_states = [inner for inner, name in model_names.items() if name in states]
        raise ModelError(
            f"effect {effect!r} sets {others[0]!r}, which is not a state of its own; {nearest(others[0], own_states)}"
        )
    return [StateUpdate(effect, list(states).index(model_names[name]), ca.SX(value)) for name, value in updates.items()]


def build_delay(
    effect: str, seconds: Expression, site: str, inputs: Sequence[str], ranges: Mapping[str, tuple[float, ...]]
) -> InputDelay:
    """The delay of an input, with the longest one that the ``ranges`` of the parameters allow: bounds, or the value of a fixed one.

    Raises ModelError for a site that is no input, an expression of states or inputs, and a delay that may be negative or
    has no upper bound.
    """
    if site not in inputs:
        raise ModelError(f"effect {effect!r} delays {site!r}, which is not an input; {nearest(site, inputs)}")
    value = ca.SX(seconds)
    symbols = ca.symvar(value)
    others = [s.name() for s in symbols if s.name() not in ranges]
    if others:
        raise ModelError(
            f"effect {effect!r}: its delay changes with {others[0]!r}; a delay may depend on parameters alone"
        )
    delay = ca.Function("seconds", [ca.vertcat(*symbols)], [value])
    corners = [float(delay(list(corner))) for corner in itertools.product(*(ranges[s.name()] for s in symbols))]
    low, high = min(corners), max(corners)
    if not (low >= 0 and high < ca.inf):
        names = ", ".join(s.name() for s in symbols)
        raise ModelError(
            f"effect {effect!r}: within the bounds of {names} its delay runs from {low:g} to {high:g} s; bound it between 0 and the"
            " longest delay that is possible"
        )
    return InputDelay(effect, list(inputs).index(site), value, high)


def find_relaxing_states(model: str, states: Sequence[State], rhs: ca.SX, x: ca.SX) -> tuple[int, ...]:
    """Numbers of the states declared ``relaxing``. Raises ModelError where a rate is not linear in its own state."""
    numbers = [k for k, s in enumerate(states) if s.relaxing]
    for k in numbers:
        # |z| is allowed: it is linear on either side of zero.
        if not ca.jacobian(ca.jacobian(rhs[k], x[k]), x[k]).is_zero():
            raise ModelError(
                f"model {model!r}: the rate of the relaxing state {states[k].name!r} is not linear in it; write it as alpha - beta z"
                " or leave out relaxing=True"
            )
    return tuple(numbers)
