"""A readable Python file of a model with its values: a person can read and edit it, and it imports back to the same model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from keyword import iskeyword, kwlist
from pathlib import Path
from typing import Any

import casadi as ca

from greybox.base import GreyboxError, to_identifiers, write_file
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export.observer import Observer, write_observer_class
from greybox.extensions.export.target import ExportTarget
from greybox.model import Effect, Model, Rule, equations_text
from greybox.model.effects.catalogue import AT, all_effects, place_effect
from greybox.model.expressions.printer import (
    INDENT,
    NUMPY,
    PYTHON,
    Printer,
    balance,
    call,
    docstring,
    items,
    keywords,
    literal,
    signal,
)
from greybox.model.signals import NamedValues, State, names_by_role
from greybox.model.system import BoundEffect, named_symbols

PUBLIC = ("Balance", "DryFriction", "Effect", "Input", "Model", "Output", "Parameter", "State", "effect")
# What else a text may import or define.
OTHER_NAMES = ("math", "ca", "np", "gb", "Block", "Rule", "balances")
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
TRANSFORMS = ("on_input", "on_output")  # functions of a value besides x, u and p
DESCRIPTIONS = ("hold", "equation", "parity", "tells_apart", "source")
# Symbols with names that no signal can have.
OUTPUT_VALUE, SENSOR, SENSOR_AT_REST = "measured value", "reading of the sensor", "reading at rest"
DISPLACEMENT_AT_REST = "displacement at rest"
TRANSFORMED = "value to be changed"


def to_python(plant: Fit | Model | Observer, path: str | Path) -> Path:
    """Write a model as a Python file: its equations term by term with units, and its present values.

    Effects of the catalogue are added by name, others are written out. The file is one that ``greybox`` commands take as a MODEL; it
    gives the same simulation to rounding errors.

    Parameters
    ----------
    plant
        A fit, a model at its present values, or an `Observer`: then the file holds a class that needs NumPy alone.
    path
        Of the file, ``rig.py``.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    GreyboxError
        For an equation that cannot be written.
    """
    target = Path(path).with_suffix(".py")
    # An observer needs no greybox where it runs.
    text = write_observer_class(plant) if isinstance(plant, Observer) else python_text(to_plant(plant))
    return write_file(target, text)


def python_text(plant: ExportedModel) -> str:
    """The text of the file."""
    # The model is a variable beside what the text imports.
    model, (name,) = plant.model, to_identifiers([plant.model.name], [*kwlist, *PUBLIC, *OTHER_NAMES])
    model.require_unchanged()
    # The body first: what is imported follows from what it names.
    printer = Printer(PYTHON, _plant_names(model))
    balances = model.balances(*_plant_symbols(model))
    # Counted over all balances: what several of them use is written once, before them.
    printer.count_uses(value for b in balances for value in (b.storage, *b.terms.values()))
    rows = items("[", [balance(b, b.state, printer, 2) for b in balances], "]", 1)
    shared = [f"{INDENT}{part} = {value}" for part, value in printer.shared]
    equations = ["def balances(x, u, p):", *shared, f"{INDENT}return {rows}", "", ""]
    text = "\n".join([*equations, f"{name} = {_model(plant)}", *_additions(model, name)])
    # Only what the text calls is imported.
    imports = [word for word in PUBLIC if f"{word}(" in text]
    title = f"{model.title}: {model.description}" if model.description else model.title
    source = [f"Source: {model.source}"] if model.source else []
    left_out = [
        f"Left out, because its function cannot be written out: the rule {rule.name!r}. It only refuses values."
        for rule in model.rules
        if not _rule(rule, model)
    ]
    origin = [*plant.origin(), *map(str, plant.findings), *left_out]
    lines = [*docstring(f"{title}.", [equations_text(model).splitlines(), source, origin]), ""]
    if "math." in text:
        lines += ["import math", ""]
    third_party = ["import casadi as ca"] * ("ca." in text) + ["import numpy as np"] * ("np." in text)
    lines += [*third_party, *[""] * bool(third_party), f"from greybox import {', '.join(imports)}"]
    if inner := [word for word in ("Block", "Rule") if f"{word}(" in text]:
        lines.append(f"from greybox.model import {', '.join(inner)}")
    return "\n".join([*lines, "", "", text, ""])


def _plant_symbols(model: Model) -> tuple[NamedValues, NamedValues, NamedValues]:
    """States, inputs and parameters of the plant as symbols, by name and by role."""
    stated = model.statement
    groups = (("state", stated.states), ("input", stated.inputs), ("parameter", stated.parameters))
    x, u, p = (named_symbols(kind, group) for kind, group in groups)
    return x, u, p


def _plant_names(model: Model) -> dict[str, str]:
    """What the plant's symbols are called in a function of ``x``, ``u`` and ``p``."""
    groups = (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    return {s.name: _read(letter, s.name) for letter, group in groups for s in group}


def _read(letter: str, name: str) -> str:
    return f"{letter}.{name}" if name.isidentifier() and not iskeyword(name) else f"{letter}[{literal(name)}]"


def _model(plant: ExportedModel) -> str:
    model = plant.model
    x, u, p = _plant_symbols(model)

    def write(value: Any) -> str:
        return Printer(PYTHON, _plant_names(model)).write(value)

    # Functions are called with symbols: what they return is their equation, whatever way they were written.
    states = [signal(s, 2, written=_functions_of(s, lambda f: write(f(p)))) for s in model.states]
    outputs = [
        signal(o, 2, written={"equation": f"lambda x, u, p: {write(o.equation(x, u, p))}"} if o.equation else None)
        for o in model.outputs
    ]
    # What was estimated says by which fit.
    stated = {tie.name for tie in model.ties} | {q.name for q in model.parameters if q.fixed or plant.fit is None}
    parameters = [
        signal(q if q.name in stated else replace(q, source=plant.provenance(q.name)), 2) for q in model.parameters
    ]
    lists = {
        "states": states,
        "inputs": [signal(i, 2) for i in model.inputs],
        "outputs": outputs,
        "parameters": parameters,
    }
    arguments = [literal(model.name), *(f"{key}={items('[', entries, ']', 1)}" for key, entries in lists.items())]
    arguments.append("balances=balances")
    arguments += [f"{key}={literal(getattr(model, key))}" for key in ("description", "source") if getattr(model, key)]
    rules = [text for rule in model.rules if (text := _rule(rule, model))]
    if rules:
        arguments.append(f"rules={items('[', rules, ']', 1)}")
    names = {key: list(map(literal, getattr(model, key))) for key in ("candidates", "has", "lacks")}
    # One name alone in brackets is no tuple.
    arguments += [
        f"{key}={call('', listed, 1) if len(listed) > 1 else f'({listed[0]},)'}"
        for key, listed in names.items()
        if listed
    ]
    return call("Model", arguments, 0, 1)


def _functions_of(state: State, write: Callable[[Callable[..., Any]], str]) -> dict[str, str]:
    """Start and process noise of a state where they are functions of the parameters."""
    functions = {name: getattr(state, name) for name in ("start", "noise")}
    return {name: f"lambda p: {write(function)}" for name, function in functions.items() if callable(function)}


def _rule(rule: Rule, model: Model) -> str:
    """A rule as the call that makes it; empty for one whose function cannot be written out (it only refuses values)."""
    p = _plant_symbols(model)[2]
    value = ca.SX.sym(OUTPUT_VALUE)
    try:
        margin = Printer(NUMPY, _plant_names(model) | {OUTPUT_VALUE: "value"}).write(
            rule.margin(value, p) if rule.output else rule.margin(p)
        )
    # A rule may look at numbers (a table, a comparison) that symbols do not have.
    except (GreyboxError, NotImplementedError, RuntimeError, TypeError):
        return ""
    head = "lambda value, p: " if rule.output else "lambda p: "
    texts = [literal(rule.name), literal(rule.unit), head + margin, literal(rule.remedy)]
    return call("Rule", [*texts, *([literal(rule.output)] if rule.output else [])], 2)


def _additions(model: Model, name: str) -> list[str]:
    """Statements that bring the plant called ``name`` to the model: effects, the values and bounds of their parameters, ties."""
    lines = []
    wider: dict[str, str] = {}
    bounds: dict[str, str] = {}
    values: dict[str, str] = {}
    fixed: list[str] = []
    for b in model.bound_effects:
        entry = _catalogue_entry(b.effect)
        # An effect of its own comes with its constants as they stand.
        if entry is None:
            lines.append(f"{name} = {name} + {_effect(b, model)}")
            continue
        lines.append(f"{name} = {name} + {call('effect', [literal(b.effect.name)])}")
        # Of one of the catalogue only what differs from it is said.
        stated = {q.name: q for q in entry.parameters}
        for inner, outer in zip(b.effect.parameters, b.parameters, strict=True):
            (low, high), value = stated[inner.name].bounds, float(inner.value)
            if not low <= value <= high:  # the value moves first, and the catalogue's bounds would refuse it
                wider[outer.name] = literal((min(low, value), max(high, value)))
            if inner.bounds != stated[inner.name].bounds or outer.name in wider:
                bounds[outer.name] = literal(inner.bounds)
            if inner.value != stated[inner.name].value:
                values[outer.name] = literal(float(inner.value))
            if inner.fixed:
                fixed.append(literal(outer.name))
    # A model refuses a value outside its bounds, and bounds that its value is outside of: the fitted bounds may leave out the catalogue's
    # value, which is neutral, so that they come after the fitted value.
    changes = (
        (".bound", keywords(wider)),
        (".start", keywords(values)),
        (".bound", keywords(bounds)),
        (".fix", fixed),
        (".tie", keywords({tie.name: literal(tie.formula) for tie in model.ties})),
    )
    return lines + [f"{name} = {name}{call(verb, arguments)}" for verb, arguments in changes if arguments]


def _catalogue_entry(effect: Effect) -> Effect | None:
    """The entry of the catalogue that ``effect`` is, values and bounds aside; None if it is another."""

    def parts(e: Effect) -> tuple[Any, ...]:
        # What makes it the same effect: its parts and its functions, not the values of its constants.
        names = [q.name for q in e.parameters], [s.name for s in e.states]
        return e.name, e.site, *names, *(getattr(e, hook) for hook in HOOKS)

    # By its functions, not by its name alone: an effect that somebody has changed is written out.
    entries = [entry for entry in all_effects() if effect.name.startswith(entry.name)]
    placed = [place_effect(e, effect.site) for e in entries if effect.name == f"{e.name}{AT}{effect.site}"]
    return next((entry for entry in (*entries, *placed) if parts(entry) == parts(effect)), None)


def _effect(bound: BoundEffect, model: Model) -> str:
    """An effect as the call that makes it, each of its functions written out."""
    effect = bound.effect
    # States, inputs and parameters as the effect's functions see them.
    roles = names_by_role((*model.states, *model.inputs, *model.parameters))
    x = NamedValues("state", {s.name: ca.SX.sym(s.name) for s in model.all_states}, roles)
    u = NamedValues("input", {i.name: ca.SX.sym(i.name) for i in model.inputs}, roles)
    p = NamedValues("parameter", {q.name: ca.SX.sym(q.name) for q in model.stated_parameters}, roles)
    x = bound.placed.sees_states(x.replaced({"sensor": ca.SX.sym(SENSOR)}), u)
    u = bound.placed.sees_inputs(u)
    at_rest = {"sensor": ca.SX.sym(SENSOR_AT_REST), "displacement": ca.SX.sym(DISPLACEMENT_AT_REST)}
    p = bound.placed.sees_parameters(p.replaced(at_rest))
    # What each symbol is called in them: the effect's own names come first.
    names = {SENSOR: "x.sensor", SENSOR_AT_REST: "p.sensor", TRANSFORMED: "value"}
    names[DISPLACEMENT_AT_REST] = "p.displacement"
    effect_names = {outer: inner for inner, outer in bound.model_names.items()}
    for letter, group in (("x", model.all_states), ("u", model.inputs), ("p", model.stated_parameters)):
        for s in group:
            name = effect_names.get(s.name, s.name)
            names[s.name] = _read(letter, name)
    printer = Printer(PYTHON, names)
    value = ca.SX.sym(TRANSFORMED)
    parameters = [
        signal(replace(outer, name=inner.name), 2)
        for inner, outer in zip(effect.parameters, bound.parameters, strict=True)
    ]
    states = [
        signal(replace(outer, name=inner.name), 2, written=_functions_of(inner, lambda f: printer.write(f(p))))
        for inner, outer in zip(effect.states, bound.states, strict=True)
    ]
    arguments = [literal(effect.name), literal(effect.site), items("[", parameters, "]", 1)]
    if states:
        arguments.append(f"states={items('[', states, ']', 1)}")
    for hook in HOOKS:
        function = getattr(effect, hook)
        if function is None:
            continue
        head = "lambda value, x, u, p: " if hook in TRANSFORMS else "lambda x, u, p: "
        returned = function(value, x, u, p) if hook in TRANSFORMS else function(x, u, p)
        arguments.append(f"{hook}={head}{_returned(hook, returned, printer)}")
    arguments += [
        f"{f.name}={literal(getattr(effect, f.name))}"
        for f in fields(effect)
        if f.name in DESCRIPTIONS and getattr(effect, f.name)
    ]
    return call("Effect", arguments, 0, 2)


def _returned(hook: str, value: Any, printer: Printer) -> str:
    """What a function of an effect returns, as text."""
    # Dry friction has two levels: while it slides, and at standstill.
    if hook == "dry":
        return f"DryFriction({printer.write(value.sliding)}, {printer.write(value.static)})"
    if hook == "balances":
        return "[" + ", ".join(balance(b, b.state, printer, 3) for b in value) + "]"
    if isinstance(value, Mapping):
        entries = [f"{literal(str(key))}: {_returned(hook, entry, printer)}" for key, entry in value.items()]
        return "{" + ", ".join(entries) + "}"
    return printer.write(value)


TARGET = ExportTarget("a Python model file", ".py", to_python, options=frozenset(["observer"]))
