"""The model as Modelica text: one equation for each balance, its terms written out, every quantity with its unit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from greybox.errors import ModelError
from greybox.export.identifiers import to_identifier
from greybox.export.modelica_names import ModelicaNames, to_modelica_string, write_declarations
from greybox.export.plant import Plant, to_plant
from greybox.expressions.operations import Binding
from greybox.expressions.printer import MODELICA, Printed, Printer
from greybox.model import Balance, Model
from greybox.model.system import DryFrictionTerm
from greybox.numerics import STATE_BOUND_MARGIN
from greybox.result import Fit


def to_modelica(plant: Fit | Model, path: str | Path) -> Path:
    """Write ``path`` (``plant.mo``): the equations of the model with its present values as Modelica text.

    Effects are written out. Dry friction that sticks becomes an Integer that says which way it slides, changed at events; a delay
    becomes ``delay(u, T)``. Raises ModelError for an effect that sets a state after each step (play), which equations cannot say, and
    GreyboxError for a function that Modelica does not have.
    """
    source = to_plant(plant)
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
    names = ModelicaNames.of(model)
    writer = Printer(MODELICA, names.symbols)
    rows = [_guarded(b, model) for b in s.balances]
    outputs = [s.outputs[k] for k in range(len(model.outputs))]
    writer.count_uses([*(v for b in rows for v in (b.storage, *b.terms.values())), *outputs])
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
    head = to_identifier(model.title)
    parts = [f"  {part} = {text};" for part, text in writer.shared]
    lines = [
        *(f"// {line}".rstrip() for line in (*plant.origin(), *plant.notes)),
        f'model {head} "{to_modelica_string(model.description or model.title)}"',
        *write_declarations(plant, names, writer),
        *(f"  Real {part};" for part, _ in writer.shared),
        *_start_of_friction(model, names),
        "equation",
        *parts,
        *equations,
        f"end {head};",
        "",
    ]
    return "\n".join(lines)


def _balance(b: Balance, model: Model, names: ModelicaNames, writer: Printer) -> list[str]:
    """``M * der(v) = coil + ...``; with dry friction the way it slides decides which force it makes."""
    s = model.system
    state = names.symbols[b.state]
    dry = [d for d in s.dry if d.balance == b.name]
    others = {name: term for name, term in b.terms.items() if name not in [d.effect for d in dry]}
    storage = writer.print(b.storage)
    left = f"der({state})" if storage.text == "1" else f"{_bracketed(storage)} * der({state})"
    total = _sum([writer.print(term) for term in others.values()])
    label = f'"{to_modelica_string(b.name)}: {to_modelica_string(", ".join(b.terms))}"'
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


def _levels(dry: Sequence[DryFrictionTerm], state: str, model: Model, writer: Printer) -> list[str]:
    sliding = _sum([writer.print(d.sliding) for d in dry])
    at_rest = model.system.x[dry[0].state]
    static = _sum([writer.print(ca.substitute(d.static, at_rest, 0)) for d in dry])
    return [f"  level_{state} = {sliding};", f"  most_{state} = {static};"]


def _start_of_friction(model: Model, names: ModelicaNames) -> list[str]:
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
                value = ca.substitute(value, x[k], ca.fmax(x[k], low + STATE_BOUND_MARGIN))
            if high < ca.inf:
                value = ca.substitute(value, x[k], ca.fmin(x[k], high - STATE_BOUND_MARGIN))
        return value

    return Balance(b.name, b.unit, held(b.storage), b.state, **{name: held(term) for name, term in b.terms.items()})


def _sum(terms: Sequence[Printed]) -> str:
    text = ""
    for term in terms:
        if term.opposite:
            text += f" - {term.opposite}" if text else f"-{term.opposite}"
        else:
            inner = term.text if term.binding > Binding.SUM else f"({term.text})"
            text += f" + {inner}" if text else inner
    return text or "0"


def _bracketed(value: Printed) -> str:
    return value.text if value.binding == Binding.ATOM else f"({value.text})"
