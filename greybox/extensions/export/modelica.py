"""The model as Modelica text: one equation for each balance, its terms written out, every quantity with its unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca

from greybox.base import ModelError, format_unit, write_file
from greybox.base.texts import to_comment, to_identifiers, to_line
from greybox.estimation.linear.exported_model import ExportedModel, to_plant
from greybox.estimation.result import Fit
from greybox.extensions.export.target import ExportTarget
from greybox.model import Balance, Model
from greybox.model.build_system import hold_inside_bounds
from greybox.model.expressions.operations import Binding
from greybox.model.expressions.printer import MODELICA, Printed, Printer

RESERVED = frozenset(
    re.findall(
        r"\w+",
        """
        algorithm and annotation assert block break class connect connector constant constrainedby der discrete
        each else elseif elsewhen encapsulated end enumeration equation expandable extends external false final
        flow for function if import impure in initial inner input loop model not operator or outer output package
        parameter partial protected public pure record redeclare replaceable return stream then true type when
        while within time pre reinit delay edge change sample noEvent smooth abs sign sqrt min max exp log sin
        cos tan asin acos atan atan2 sinh cosh tanh floor ceil Real Integer Boolean String
        AssertionLevel Clock ExternalObject StateSelect Subtask actualStream array backSample cardinality cat cross
        diagonal div fill firstTick hold homotopy identity inStream initial integer interval linspace log10 matrix mod
        ndims noClock ones outerProduct previous product promote rem rooted scalar semiLinear shiftSample size skew
        spatialDistribution subSample sum superSample symmetric terminal transpose vector zeros getInstanceName break
        """,
    )
)


def to_modelica(plant: Fit | Model, path: str | Path) -> Path:
    """Write a model as Modelica text, with its equations and present values.

    Effects are written out. Dry friction that sticks becomes an Integer that says which way it slides, changed at events; a delay
    becomes ``delay(u, T)``.

    Parameters
    ----------
    plant
        A fit, or a model at its present values.
    path
        Of the file, ``plant.mo``.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    ModelError
        For an effect that sets a state after each step (play), which equations cannot express.
    GreyboxError
        For a function that Modelica does not have.
    """
    source = to_plant(plant)
    target = Path(path).with_suffix(".mo")
    text = modelica_text(source)
    return write_file(target, text)


def modelica_text(plant: ExportedModel) -> str:
    """The text of the model."""
    model, s = plant.model, plant.model.system
    if s.updates:
        setting = ", ".join(f"{u.effect} (state {s.state_names[u.state]!r})" for u in s.updates)
        raise ModelError(
            f"{model.title} cannot be written in Modelica: {setting} is set after each step and has no equation; leave the effect out, or"
            " export C or an FMU, which contain it exactly"
        )
    names = ModelicaNames.of(model)
    printer = Printer(MODELICA, names.symbols)
    # The library's equations are cut off at the bounds of states; those of Modelica have to be as well.
    rows = [_guarded(b, model) for b in s.balances]
    outputs = [s.outputs[k] for k in range(len(model.outputs))]
    # What several equations use is written once, as a variable of its own.
    printer.count_uses([*(v for b in rows for v in (b.storage, *b.terms.values())), *outputs])
    equations = [line for b in rows for line in _balance(b, model, names, printer)]
    equations += [
        f"  {name} = {printer.write(value)};"
        for name, value, is_state in zip(names.outputs, outputs, names.is_state, strict=True)
        if not is_state
    ]
    for k, name in enumerate(names.late):
        seconds = [d.seconds for d in s.delays if d.column == k]
        if seconds:
            # Several delays of one input add up.
            late = printer.write(sum(seconds[1:], seconds[0]))
            equations.append(f"  {name} = delay({names.inputs[k]}, {late});")
    (head,) = to_identifiers([model.title], RESERVED)
    sticking = [names.states[k] for k in sorted({d.state for d in s.dry})]
    parts = [f"  {part} = {text};" for part, text in printer.shared]
    lines = [
        *(f"// {to_comment(line)}".rstrip() for line in (*plant.origin(), *map(str, plant.findings))),
        f'model {head} "{_string(model.description or model.title)}"',
        *_declarations(plant, names, printer),
        *(f"  Real {part};" for part, _ in printer.shared),
        *(["initial equation"] if sticking else []),
        # A body that starts at rest slides at once where the push exceeds what friction holds.
        *(
            f"  pre(way_{v}) = if {v} > 0 then 1 elseif {v} < 0 then -1 else"
            f" (if push_{v} > most_{v} then 1 elseif push_{v} < -most_{v} then -1 else 0);"
            for v in sticking
        ),
        "equation",
        *parts,
        *equations,
        f"end {head};",
        "",
    ]
    return "\n".join(lines)


def _balance(b: Balance, model: Model, names: ModelicaNames, printer: Printer) -> list[str]:
    """``M * der(v) = coil + ...``; with dry friction the way it slides decides which force it makes."""
    s = model.system
    state = names.symbols[b.state]
    dry = [d for d in s.dry if d.balance == b.name]
    # Dry friction stands apart: its force follows from the others while it holds.
    others = {name: term for name, term in b.terms.items() if name not in [d.effect for d in dry]}
    storage = printer.print(b.storage)
    factor = storage.text if storage.binding == Binding.ATOM else f"({storage.text})"
    # A storage of one is left out.
    left = f"der({state})" if storage.text == "1" else f"{factor} * der({state})"
    total = _sum([printer.print(term) for term in others.values()])
    label = f'"{_string(b.name)}: {_string(", ".join(b.terms))}"'
    if not dry:
        return [f"  {left} = {total} {label};"]
    sliding = _sum([printer.print(d.sliding) for d in dry])
    # The static level at standstill, whatever it is of the velocity.
    at_rest = s.x[dry[0].state]
    static = _sum([printer.print(ca.substitute(d.static, at_rest, 0)) for d in dry])
    return [
        f"  push_{state} = {total};",
        f"  level_{state} = {sliding};",
        f"  most_{state} = {static};",
        # At standstill the velocity is constant; while it slides friction points against the way, which changes at
        # events alone.
        f"  {left} = if way_{state} == 0 then 0 else push_{state} - way_{state} * level_{state} {label};",
        f"  when {{pre(way_{state}) > 0 and {state} <= 0, pre(way_{state}) < 0 and {state} >= 0,"
        f" pre(way_{state}) == 0 and abs(push_{state}) > most_{state}}} then",
        f"    way_{state} = if push_{state} > most_{state} then 1 elseif push_{state} < -most_{state} then -1 else 0;",
        # Exactly zero: the conditions of the events compare with it.
        f"    reinit({state}, 0);",
        "  end when;",
    ]


def _guarded(b: Balance, model: Model) -> Balance:
    """The balance with every bounded state held inside its bounds, as the library's equations hold it."""

    def held(value: ca.SX | float) -> ca.SX:
        return hold_inside_bounds(ca.SX(value), model.system.x, model.all_states)

    return b.with_expressions(held)


def _sum(terms: Sequence[Printed]) -> str:
    text = ""
    for term in terms:
        if term.opposite:
            text += f" - {term.opposite}" if text else f"-{term.opposite}"
        else:
            inner = term.text if term.binding > Binding.SUM else f"({term.text})"
            text += f" + {inner}" if text else inner
    return text or "0"


@dataclass(frozen=True)
class ModelicaNames:
    """What everything is called: ``is_state`` outputs are states as they are and have no name of their own."""

    states: list[str]
    inputs: list[str]
    outputs: list[str]
    parameters: list[str]
    late: list[str]
    is_state: list[bool]
    symbols: Mapping[str, str]

    @classmethod
    def of(cls, model: Model) -> ModelicaNames:
        """The names of ``model`` as Modelica allows them; outputs that are states share theirs."""
        s = model.system
        # Made different together: two names that Modelica cannot tell apart would be one variable.
        inner = to_identifiers([*s.state_names, *s.input_names, *s.parameter_names], RESERVED)
        nx, nu = len(s.state_names), len(s.input_names)
        states, inputs, parameters = inner[:nx], inner[nx : nx + nu], inner[nx + nu :]
        delayed = {d.column for d in s.delays}
        late = [to_identifiers([f"{name}_late"], inner)[0] if k in delayed else name for k, name in enumerate(inputs)]
        symbols = dict(
            zip((*s.state_names, *s.input_names, *s.parameter_names), (*states, *late, *parameters), strict=True)
        )
        is_state: list[bool] = []
        outputs: list[str] = []
        for k, name in enumerate(s.output_names):
            value = s.outputs[k]
            # A state that is measured as it is needs no second variable.
            same = value.is_symbolic() and value.name() in s.state_names and symbols[value.name()] not in outputs
            is_state.append(same)
            outputs.append(
                symbols[value.name()] if same else to_identifiers([name], [*RESERVED, *inner, *late, *outputs])[0]
            )
        return cls(states, inputs, outputs, parameters, late, is_state, symbols)


def _declarations(plant: ExportedModel, names: ModelicaNames, printer: Printer) -> list[str]:
    """Parameters, inputs, states and outputs, and what dry friction needs, a line each."""
    model, s = plant.model, plant.model.system
    lines = []
    for name, q in zip(names.parameters, model.all_parameters, strict=True):
        limits = {"min": q.bounds[0], "max": q.bounds[1]}
        inside = [*_unit(q.unit), *(f"{key} = {value!r}" for key, value in limits.items() if abs(value) < 1e300)]
        remark = f"{q.description} ({plant.provenance(q.name)})".strip()
        lines.append(f'  parameter Real {name}{_brackets(inside)} = {float(q.value)!r} "{_string(remark)}";')
    lines += [
        f'  input Real {name}{_brackets(_unit(i.unit))} "{_string(i.description)}";'
        for name, i in zip(names.inputs, model.inputs, strict=True)
    ]
    lines += [
        f"  Real {late}{_brackets(_unit(i.unit))};"
        for late, name, i in zip(names.late, names.inputs, model.inputs, strict=True)
        if late != name
    ]
    for k, (name, x) in enumerate(zip(names.states, model.all_states, strict=True)):
        # A measured state is an output of the block by itself.
        prefix = (
            "output "
            if name in [n for n, is_state in zip(names.outputs, names.is_state, strict=True) if is_state]
            else ""
        )
        inside = [*_unit(x.unit), f"start = {printer.write(s.start[k])}", "fixed = true"]
        lines.append(f'  {prefix}Real {name}{_brackets(inside)} "{_string(x.description)}";')
    for name, o, is_state in zip(names.outputs, model.outputs, names.is_state, strict=True):
        if not is_state:
            lines.append(f'  output Real {name}{_brackets(_unit(o.unit))} "{_string(o.description)}";')
    # One friction state a body, whatever number of effects rub on it.
    for k in sorted({d.state for d in s.dry}):
        unit = _brackets(_unit(next(b.unit for b in s.balances if b.state == s.state_names[k])))
        lines += [
            f'  discrete Integer way_{names.states[k]} "way it slides: -1 or 1; 0: friction holds it";',
            f'  Real push_{names.states[k]}{unit} "all but dry friction";',
            f'  Real level_{names.states[k]}{unit} "dry friction while it slides";',
            f'  Real most_{names.states[k]}{unit} "the most that it holds at standstill";',
        ]
    return lines


def _unit(unit: str) -> list[str]:
    """``unit = "N.s/m"`` as Modelica writes units; nothing for one that it cannot write."""
    # Modelica writes N.m2 where the library writes N*m^2.
    text = format_unit(unit).replace("*", ".").replace("^", "").replace("ohm", "Ohm")
    if text in ("", "-", "1") or re.search(r"\.\d|%|\d\.", text):
        return []
    return [f'unit = "{text}"']


def _brackets(inside: Sequence[str]) -> str:
    return f"({', '.join(inside)})" if inside else ""


def _string(text: str) -> str:
    """Text inside a Modelica string, without backslashes: not every reader takes them as the standard has it."""
    return to_line(text).replace("\\", "/").replace('"', "'")


TARGET = ExportTarget("Modelica", ".mo", to_modelica)
