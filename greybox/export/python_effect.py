"""Effects in a Python model file: those of the catalogue by name, others written out hook by hook."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca

from greybox.effects import CATALOGUE
from greybox.export.plant import Plant
from greybox.export.python_text import balance, call, items, keywords, literal, signal
from greybox.expressions import PYTHON, Printer
from greybox.model import Effect, Model
from greybox.model.signals import Input, NamedValues, Parameter, State
from greybox.model.system import BoundEffect

HOOKS = (
    "terms",
    "dry",
    "balances",
    "update",
    "delay",
    "on_input",
    "on_output",
    "on_parameter",
    "on_state",
    "on_term",
    "on_storage",
)
TRANSFORMS = ("on_input", "on_output")
# Names that no signal can have.
SENSOR, SENSOR_AT_REST, VALUE = "reading of the sensor", "reading at rest", "value to be changed"


@dataclass(frozen=True)
class AddedEffects:
    """Effects and values that a model has beyond its plant, as lines to stand below it."""

    effects: tuple[str, ...]
    changes: tuple[str, ...]

    def lines(self, name: str) -> list[str]:
        """Statements that bring the plant called ``name`` to the model."""
        return [f"{name} = {name} + {text}" for text in self.effects] + [
            f"{name} = {name}{text}" for text in self.changes
        ]


def write_added_effects(plant: Plant) -> AddedEffects:
    """The effects of the model, the values and bounds of their constants, and its ties."""
    model = plant.model
    known = {b.effect.name: entry for b in model.bound_effects if (entry := write_catalogued(b.effect)) is not None}
    effects = [
        call("effect", [literal(b.effect.name)]) if b.effect.name in known else write_effect(b, model)
        for b in model.bound_effects
    ]
    changes = []
    bounds, values, fixed = {}, {}, []
    for b in model.bound_effects:
        if b.effect.name not in known:
            continue
        stated = {q.name: q for q in known[b.effect.name].parameters}
        for own, there in zip(b.effect.parameters, b.parameters, strict=True):
            if own.bounds != stated[own.name].bounds:
                bounds[there.name] = literal(own.bounds)
            if own.value != stated[own.name].value:
                values[there.name] = literal(float(own.value))
            fixed += [there.name] * own.fixed
    changes += [call(".bound", keywords(bounds))] * bool(bounds)
    changes += [call(".start", keywords(values))] * bool(values)
    changes += [call(".fix", [literal(name) for name in fixed])] * bool(fixed)
    changes += [call(".tie", keywords({tie.name: literal(tie.formula) for tie in model.ties}))] * bool(model.ties)
    return AddedEffects(tuple(effects), tuple(changes))


def write_catalogued(effect: Effect) -> Effect | None:
    """The entry of the catalogue that ``effect`` is, values and bounds aside; None if it is another."""
    for entry in CATALOGUE:
        if (
            entry.name == effect.name
            and all(getattr(entry, h) is getattr(effect, h) for h in HOOKS)
            and entry.site == effect.site
        ):
            names = [q.name for q in entry.parameters] == [q.name for q in effect.parameters]
            return entry if names and [s.name for s in entry.states] == [s.name for s in effect.states] else None
    return None


def write_effect(bound: BoundEffect, model: Model) -> str:
    """An effect as the call that makes it, each of its functions written out."""
    effect, (x, u, p) = bound.effect, _seen(bound, model)
    writer = Printer(PYTHON, _symbols(bound, model))
    value = ca.SX.sym(VALUE)
    outer: Sequence[Parameter] = bound.parameters
    parameters = [Parameter(**{**vars(q), "name": own.name}) for own, q in zip(effect.parameters, outer, strict=True)]
    states = []
    for own, state in zip(effect.states, bound.states, strict=True):
        texts = {
            f: f"lambda p: {writer.write(getattr(own, f)(p))}" for f in ("start", "noise") if callable(getattr(own, f))
        }
        states.append(signal(type(own)(**{**vars(state), "name": own.name}), 2, written=texts))
    arguments = [literal(effect.name), literal(effect.site), items("[", [signal(q, 2) for q in parameters], "]", 1)]
    arguments += [f"states={items('[', states, ']', 1)}"] * bool(states)
    for hook in HOOKS:
        function = getattr(effect, hook)
        if function is None:
            continue
        head = "lambda value, x, u, p: " if hook in TRANSFORMS else "lambda x, u, p: "
        found = function(value, x, u, p) if hook in TRANSFORMS else function(x, u, p)
        arguments.append(f"{hook}={head}{_result(hook, found, writer)}")
    plain = ("hold", "equation", "parity", "tells_apart", "source")
    arguments += [
        f"{f.name}={literal(getattr(effect, f.name))}"
        for f in fields(effect)
        if f.name in plain and getattr(effect, f.name)
    ]
    return call("Effect", arguments, 0, 2)


def _result(hook: str, found: Any, writer: Printer) -> str:
    """What a hook returns, as text."""
    if hook == "dry":
        return f"DryFriction({writer.write(found.sliding)}, {writer.write(found.static)})"
    if hook == "balances":
        return "[" + ", ".join(balance(b, b.state, writer, 3) for b in found) + "]"
    if isinstance(found, Mapping):
        entries = [f"{literal(str(key))}: {_result(hook, entry, writer)}" for key, entry in found.items()]
        return "{" + ", ".join(entries) + "}"
    return writer.write(found)


def _seen(bound: BoundEffect, model: Model) -> tuple[NamedValues, NamedValues, NamedValues]:
    """States, inputs and constants as the effect's functions see them."""
    signals: tuple[State | Input | Parameter, ...] = (*model.states, *model.inputs, *model.parameters)
    roles = {s.role: s.name for s in signals if s.role}
    x = NamedValues("state", {s.name: ca.SX.sym(s.name) for s in model.all_states}, roles)
    u = NamedValues("input", {i.name: ca.SX.sym(i.name) for i in model.inputs}, roles)
    p = NamedValues("parameter", {q.name: ca.SX.sym(q.name) for q in model.stated_parameters}, roles)
    x, p = x.replaced({"sensor": ca.SX.sym(SENSOR)}), p.replaced({"sensor": ca.SX.sym(SENSOR_AT_REST)})
    return bound.placed.sees_states(x), u, bound.placed.sees_parameters(p)


def _symbols(bound: BoundEffect, model: Model) -> dict[str, str]:
    """What each symbol is called inside the effect's functions: its own names come first."""
    own = {there: inner for inner, there in bound.model_names.items()}
    groups = (("x", model.all_states), ("u", model.inputs), ("p", model.stated_parameters))
    found = {SENSOR: "x.sensor", SENSOR_AT_REST: "p.sensor", VALUE: "value"}
    for letter, group in groups:
        for s in group:
            name = own.get(s.name, s.name)
            found[s.name] = f"{letter}.{name}" if name.isidentifier() else f"{letter}[{literal(name)}]"
    return found
