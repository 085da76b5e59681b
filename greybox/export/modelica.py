"""The model as Modelica text: one equation for each balance, its terms written out, every quantity with its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from greybox.errors import ModelError
from greybox.export.identifiers import identifier, identifiers
from greybox.export.plant import Plant, plant_of
from greybox.export.writer import ADD, AND, ATOM, OR, Dialect, Writer, Written, function_call
from greybox.model import Balance, Model
from greybox.model.system import BOUND_GUARD, Dry
from greybox.result import Fit
from greybox.units import tidy

RESERVED = [
    "algorithm",
    "and",
    "annotation",
    "assert",
    "block",
    "break",
    "class",
    "connect",
    "connector",
    "constant",
    "constrainedby",
    "der",
    "discrete",
    "each",
    "else",
    "elseif",
    "elsewhen",
    "encapsulated",
    "end",
    "enumeration",
    "equation",
    "expandable",
    "extends",
    "external",
    "false",
    "final",
    "flow",
    "for",
    "function",
    "if",
    "import",
    "impure",
    "in",
    "initial",
    "inner",
    "input",
    "loop",
    "model",
    "not",
    "operator",
    "or",
    "outer",
    "output",
    "package",
    "parameter",
    "partial",
    "protected",
    "public",
    "pure",
    "record",
    "redeclare",
    "replaceable",
    "return",
    "stream",
    "then",
    "true",
    "type",
    "when",
    "while",
    "within",
    "time",
    "pre",
    "reinit",
    "delay",
    "edge",
    "change",
    "sample",
    "noEvent",
    "smooth",
    "abs",
    "sign",
    "sqrt",
    "min",
    "max",
    "exp",
    "log",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "floor",
    "ceil",
    "Real",
    "Integer",
    "Boolean",
    "String",
]
NAMES = {"fabs": "abs", "fmin": "min", "fmax": "max"}
LACKS = frozenset(["asinh", "acosh", "atanh", "erf", "==", "!="])


def _call(name: str, arguments: Sequence[str]) -> str:
    if name == "hypot":
        return f"sqrt(({arguments[0]})^2 + ({arguments[1]})^2)"
    if name in ("log1p", "expm1"):
        return f"log(1 + ({arguments[0]}))" if name == "log1p" else f"(exp({arguments[0]}) - 1)"
    return function_call(NAMES.get(name, name), arguments)


def _choose(condition: str, yes: str, no: str) -> Written:
    return Written(f"(if {condition} then {yes} else {no})", ATOM)


def _logic(word: str, operands: Sequence[Written]) -> Written:
    if word == "not":
        return Written(f"not ({operands[0].text})", AND)
    return Written(f" {word} ".join(f"({operand.text})" for operand in operands), AND if word == "and" else OR)


MODELICA = Dialect("Modelica", "^", "1e300", _call, _choose, _logic, LACKS)


def to_modelica(plant: Fit | Model, path: str | Path) -> Path:
    """Write ``path`` (``plant.mo``): the equations of the model with its present values as Modelica text.

    Effects are written out. Dry friction that sticks becomes an Integer that says which way it slides, changed at events; a delay
    becomes ``delay(u, T)``. Raises ModelError for an effect that sets a state after each step (play), which equations cannot say, and
    GreyboxError for a function that Modelica does not have.
    """
    source = plant_of(plant)
    target = Path(path).with_suffix(".mo")
    text = modelica_text(source)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    return target


def modelica_text(plant: Plant) -> str:
    """The text of the model."""
    model, s = plant.model, plant.model.system
    if s.updates:
        setting = ", ".join(f"{u.effect} (state {s.state_names[u.state]!r})" for u in s.updates)
        raise ModelError(
            f"{model.title} cannot be written in Modelica: {setting} is set after each step and has no equation; leave the effect out, or"
            " export C or an FMU, which carry it exactly"
        )
    names = _Names.of(model)
    writer = Writer(MODELICA, names.symbols)
    rows = [_guarded(b, model) for b in s.balances]
    outputs = [s.outputs[k] for k in range(len(model.outputs))]
    writer.look_at([*(v for b in rows for v in (b.storage, *b.terms.values())), *outputs])
    equations = [line for b in rows for line in _balance(b, model, names, writer)]
    equations += [
        f"  {name} = {writer.write(value)};"
        for name, value, shown in zip(names.outputs, outputs, names.shown, strict=True)
        if not shown
    ]
    for k, name in enumerate(names.late):
        seconds = [d.seconds for d in s.delays if d.column == k]
        if seconds:
            late = writer.write(sum(seconds[1:], seconds[0]))
            equations.append(f"  {name} = delay({names.inputs[k]}, {late});")
    head = identifier(model.title)
    parts = [f"  {part} = {text};" for part, text in writer.shared]
    lines = [
        *(f"// {line}".rstrip() for line in (*plant.origin(), *plant.notes)), f'model {head} "{_safe(model.description or model.title)}"',
        *_declarations(plant, names, writer), *(f"  Real {part};" for part, _ in writer.shared),
        *_start_of_friction(model, names), "equation", *parts, *equations, f"end {head};", "",
    ]  # fmt: skip
    return "\n".join(lines)


@dataclass(frozen=True)
class _Names:
    """What everything is called: ``shown`` outputs are states as they are and have no name of their own."""

    states: list[str]
    inputs: list[str]
    outputs: list[str]
    parameters: list[str]
    late: list[str]
    shown: list[bool]
    symbols: Mapping[str, str]

    @classmethod
    def of(cls, model: Model) -> _Names:
        s = model.system
        inner = identifiers([*s.state_names, *s.input_names, *s.parameter_names], RESERVED)
        nx, nu = len(s.state_names), len(s.input_names)
        states, inputs, parameters = inner[:nx], inner[nx : nx + nu], inner[nx + nu :]
        delayed = {d.column for d in s.delays}
        late = [f"{name}_late" if k in delayed else name for k, name in enumerate(inputs)]
        symbols = dict(
            zip((*s.state_names, *s.input_names, *s.parameter_names), (*states, *late, *parameters), strict=True)
        )
        shown: list[bool] = []
        outputs: list[str] = []
        for k, name in enumerate(s.output_names):
            value = s.outputs[k]
            same = value.is_symbolic() and value.name() in s.state_names and symbols[value.name()] not in outputs
            shown.append(same)
            outputs.append(
                symbols[value.name()] if same else identifiers([name], [*RESERVED, *inner, *late, *outputs])[0]
            )
        return cls(states, inputs, outputs, parameters, late, shown, symbols)


def _declarations(plant: Plant, names: _Names, writer: Writer) -> list[str]:
    model, s = plant.model, plant.model.system
    lines = []
    for name, q in zip(names.parameters, model.all_parameters, strict=True):
        limits = {"min": q.bounds[0], "max": q.bounds[1]}
        inside = [*_unit(q.unit), *(f"{key} = {value!r}" for key, value in limits.items() if abs(value) < 1e300)]
        remark = f"{q.description} ({plant.provenance(q.name)})".strip()
        lines.append(f'  parameter Real {name}{_brackets(inside)} = {float(q.value)!r} "{_safe(remark)}";')
    lines += [
        f'  input Real {name}{_brackets(_unit(i.unit))} "{_safe(i.description)}";'
        for name, i in zip(names.inputs, model.inputs, strict=True)
    ]
    lines += [
        f"  Real {late}{_brackets(_unit(i.unit))};"
        for late, name, i in zip(names.late, names.inputs, model.inputs, strict=True)
        if late != name
    ]
    for k, (name, x) in enumerate(zip(names.states, model.all_states, strict=True)):
        seen = "output " if name in [n for n, shown in zip(names.outputs, names.shown, strict=True) if shown] else ""
        inside = [*_unit(x.unit), f"start = {writer.write(s.start[k])}", "fixed = true"]
        lines.append(f'  {seen}Real {name}{_brackets(inside)} "{_safe(x.description)}";')
    for name, o, shown in zip(names.outputs, model.outputs, names.shown, strict=True):
        if not shown:
            lines.append(f'  output Real {name}{_brackets(_unit(o.unit))} "{_safe(o.description)}";')
    for k in sorted({d.state for d in s.dry}):
        unit = _brackets(_unit(next(b.unit for b in s.balances if b.state == s.state_names[k])))
        lines += [
            f'  discrete Integer way_{names.states[k]} "way it slides: -1 or 1; 0: friction holds it";',
            f'  Real push_{names.states[k]}{unit} "all but dry friction";',
            f'  Real level_{names.states[k]}{unit} "dry friction while it slides";',
            f'  Real most_{names.states[k]}{unit} "the most that it holds at standstill";',
        ]
    return lines


def _balance(b: Balance, model: Model, names: _Names, writer: Writer) -> list[str]:
    """``M * der(v) = coil + ...``; with dry friction the way it slides decides which force it makes."""
    s = model.system
    state = names.symbols[b.state]
    dry = [d for d in s.dry if d.balance == b.name]
    others = {name: term for name, term in b.terms.items() if name not in [d.effect for d in dry]}
    storage = writer.written(b.storage)
    left = f"der({state})" if storage.text == "1" else f"{_bracketed(storage)} * der({state})"
    total = _sum([writer.written(term) for term in others.values()])
    label = f'"{_safe(b.name)}: {_safe(", ".join(b.terms))}"'
    if not dry:
        return [f"  {left} = {total} {label};"]
    return [
        f"  push_{state} = {total};", *_levels(dry, state, model, writer),
        f"  {left} = if way_{state} == 0 then 0 else push_{state} - way_{state} * level_{state} {label};",
        f"  when {{pre(way_{state}) > 0 and {state} <= 0, pre(way_{state}) < 0 and {state} >= 0,"
        f" pre(way_{state}) == 0 and abs(push_{state}) > most_{state}}} then",
        f"    way_{state} = if push_{state} > most_{state} then 1 elseif push_{state} < -most_{state} then -1 else 0;",
        f"    reinit({state}, 0);", "  end when;",
    ]  # fmt: skip


def _levels(dry: Sequence[Dry], state: str, model: Model, writer: Writer) -> list[str]:
    sliding = _sum([writer.written(d.sliding) for d in dry])
    at_rest = model.system.x[dry[0].state]
    static = _sum([writer.written(ca.substitute(d.static, at_rest, 0)) for d in dry])
    return [f"  level_{state} = {sliding};", f"  most_{state} = {static};"]


def _start_of_friction(model: Model, names: _Names) -> list[str]:
    bodies = sorted({d.state for d in model.system.dry})
    if not bodies:
        return []
    lines = ["initial equation"]
    for k in bodies:
        v = names.states[k]
        pushed = f"if push_{v} > most_{v} then 1 elseif push_{v} < -most_{v} then -1 else 0"
        lines.append(f"  pre(way_{v}) = if {v} > 0 then 1 elseif {v} < 0 then -1 else ({pushed});")
    return lines


def _guarded(b: Balance, model: Model) -> Balance:
    """The balance with every bounded state held inside its bounds, as the library's equations hold it."""
    x = model.system.x

    def held(value: ca.SX | float) -> ca.SX:
        value = ca.SX(value)
        for k, state in enumerate(model.all_states):
            low, high = state.bounds
            if low > -ca.inf:
                value = ca.substitute(value, x[k], ca.fmax(x[k], low + BOUND_GUARD))
            if high < ca.inf:
                value = ca.substitute(value, x[k], ca.fmin(x[k], high - BOUND_GUARD))
        return value

    return Balance(b.name, b.unit, held(b.storage), b.state, **{name: held(term) for name, term in b.terms.items()})


def _sum(terms: Sequence[Written]) -> str:
    text = ""
    for term in terms:
        if term.opposite:
            text += f" - {term.opposite}" if text else f"-{term.opposite}"
        else:
            inner = term.text if term.binds > ADD else f"({term.text})"
            text += f" + {inner}" if text else inner
    return text or "0"


def _bracketed(value: Written) -> str:
    return value.text if value.binds == ATOM else f"({value.text})"


def _unit(unit: str) -> list[str]:
    """``unit = "N.s/m"`` as Modelica writes units; nothing for one that it cannot write."""
    text = tidy(unit).replace("*", ".").replace("^", "").replace("ohm", "Ohm")
    if text in ("", "-", "1") or re.search(r"\.\d|%|\d\.", text):
        return []
    return [f'unit = "{text}"']


def _brackets(inside: Sequence[str]) -> str:
    return f"({', '.join(inside)})" if inside else ""


def _safe(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', "'")
