"""A readable Python file of a model with its values: a person can read and edit it, and it imports back to the same model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi as ca

from greybox.errors import GreyboxError
from greybox.export.identifiers import to_identifier
from greybox.export.plant import Plant, to_plant
from greybox.export.python_effect import write_added_effects
from greybox.export.python_text import INDENT, balance, call, docstring, items, literal, signal
from greybox.expressions import NUMPY, PYTHON, Printer
from greybox.model import Model, Rule
from greybox.model.equations import equations_text
from greybox.model.signals import NamedValues, Parameter
from greybox.result import Fit

OUTPUT_VALUE = "measured value"  # a name that no signal can have


def to_python(plant: Fit | Model, path: str | Path) -> Path:
    """Write ``path`` (``rig.py``): the model with its present values, equations written out term by term with units.

    Effects of the catalogue are added by name, others are written out. The file is one that ``greybox`` commands take as a MODEL; it
    gives the same simulation to rounding errors. Raises GreyboxError for an equation that cannot be written.
    """
    source = to_plant(plant)
    target = Path(path).with_suffix(".py")
    text = python_text(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target


def python_text(plant: Plant) -> str:
    """The text of the file."""
    model, name = plant.model, to_identifier(plant.model.name)
    effects = write_added_effects(plant)
    body = [*_balances(model), "", f"{name} = {_model(plant)}", *effects.lines(name)]
    text = "\n".join(body)
    imports = [word for word in ("Balance", "DryFriction", "Effect", "Input", "Model", "Output", "Parameter", "State", "effect")
               if f"{word}(" in text]  # fmt: skip
    lines = [
        *_docstring(plant), "", *(["import math", ""] if "math." in text else []),
        *(["import casadi as ca"] if "ca." in text else []), *(["import numpy as np"] if "np." in text else []),
        *([""] if "ca." in text or "np." in text else []),
        f"from greybox import {', '.join(imports)}", *(["from greybox.model import Rule"] if "Rule(" in text else []), "", "", text, "",
    ]  # fmt: skip
    return "\n".join(lines)


def symbols_of(model: Model) -> dict[str, str]:
    """What the plant's symbols are called in a function of ``x``, ``u`` and ``p``."""
    groups = (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    return {s.name: f"{letter}.{s.name}" for letter, group in groups for s in group}


def named(model: Model) -> tuple[NamedValues, NamedValues, NamedValues]:
    """States, inputs and parameters of the plant as symbols, by name and by role."""
    groups = (("state", model.states), ("input", model.inputs), ("parameter", model.parameters))
    return tuple(  # type: ignore[return-value]
        NamedValues(kind, {s.name: ca.SX.sym(s.name) for s in group}, {s.role: s.name for s in group if s.role})
        for kind, group in groups
    )


def _docstring(plant: Plant) -> list[str]:
    model = plant.model
    title = f"{model.title}: {model.description}" if model.description else model.title
    source = [f"Source: {model.source}"] if model.source else []
    left_out = [
        f"Left out, because its function cannot be written out: the rule {rule.name!r}. It only refuses values."
        for rule in model.rules if not _rule(rule, model)
    ]  # fmt: skip
    return docstring(
        f"{title}.", [equations_text(model).splitlines(), source, [*plant.origin(), *plant.notes, *left_out]]
    )


def _balances(model: Model) -> list[str]:
    x, u, p = named(model)
    found = model.balances(x, u, p)
    writer = Printer(PYTHON, symbols_of(model))
    writer.count_uses(value for b in found for value in (b.storage, *b.terms.values()))
    rows = [balance(b, b.state, writer, 2) for b in found]
    shared = [f"{INDENT}{name} = {text}" for name, text in writer.shared]
    return ["def balances(x, u, p):", *shared, f"{INDENT}return {items('[', rows, ']', 1)}", ""]


def _model(plant: Plant) -> str:
    model = plant.model
    x, u, p = named(model)
    symbols = symbols_of(model)

    def of_constants(function: Callable[[NamedValues], object]) -> str:
        return f"lambda p: {Printer(PYTHON, symbols).write(function(p))}"

    states = []
    for s in model.states:
        texts = {f: of_constants(getattr(s, f)) for f in ("start", "noise") if callable(getattr(s, f))}
        states.append(signal(s, 2, written=texts))
    outputs = [
        signal(
            o,
            2,
            written={"equation": f"lambda x, u, p: {Printer(PYTHON, symbols).write(o.equation(x, u, p))}"}
            if o.equation
            else None,
        )
        for o in model.outputs
    ]
    lists = {
        "states": states, "inputs": [signal(i, 2) for i in model.inputs], "outputs": outputs,
        "parameters": [signal(_sourced(plant, q), 2) for q in model.parameters],
    }  # fmt: skip
    arguments = [
        literal(model.name),
        *(f"{key}={items('[', entries, ']', 1)}" for key, entries in lists.items()),
        "balances=balances",
    ]
    arguments += [f"{key}={literal(getattr(model, key))}" for key in ("description", "source") if getattr(model, key)]
    rules = [text for rule in model.rules if (text := _rule(rule, model))]
    arguments += [f"rules={items('[', rules, ']', 1)}"] * bool(rules)
    if model.candidates:
        arguments.append(f"candidates={call('', [literal(name) for name in (*model.candidates,)], 1)}")
    return call("Model", arguments, 0, 1)


def _sourced(plant: Plant, q: Parameter) -> Parameter:
    tied = {tie.name for tie in plant.model.ties}
    if plant.fit is None or q.fixed or q.name in tied:
        return q
    return Parameter(**{**vars(q), "source": plant.provenance(q.name)})


def _rule(rule: Rule, model: Model) -> str:
    """A rule as the call that makes it; empty for one whose function cannot be written out (it only refuses values)."""
    _, _, p = named(model)
    symbols = symbols_of(model) | {OUTPUT_VALUE: "value"}
    value = ca.SX.sym(OUTPUT_VALUE)
    try:
        margin = Printer(NUMPY, symbols).write(rule.margin(value, p) if rule.output else rule.margin(p))
    except (GreyboxError, NotImplementedError, RuntimeError, TypeError):
        return ""
    head = "lambda value, p: " if rule.output else "lambda p: "
    texts = [literal(rule.name), literal(rule.unit), head + margin, literal(rule.remedy)]
    return call("Rule", [*texts, *([literal(rule.output)] if rule.output else [])], 2)
