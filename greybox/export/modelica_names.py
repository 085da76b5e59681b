"""Names and declarations of a Modelica model: every quantity with its unit, bounds, start value and where it comes from."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from greybox.export.identifiers import to_identifiers
from greybox.export.plant import Plant
from greybox.expressions.printer import Printer
from greybox.model import Model
from greybox.units import format_unit

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
        """,
    )
)


@dataclass(frozen=True)
class ModelicaNames:
    """What everything is called: ``shown`` outputs are states as they are and have no name of their own."""

    states: list[str]
    inputs: list[str]
    outputs: list[str]
    parameters: list[str]
    late: list[str]
    shown: list[bool]
    symbols: Mapping[str, str]

    @classmethod
    def of(cls, model: Model) -> ModelicaNames:
        """The names of ``model`` as Modelica allows them; outputs that are states share theirs."""
        s = model.system
        inner = to_identifiers([*s.state_names, *s.input_names, *s.parameter_names], RESERVED)
        nx, nu = len(s.state_names), len(s.input_names)
        states, inputs, parameters = inner[:nx], inner[nx : nx + nu], inner[nx + nu :]
        delayed = {d.column for d in s.delays}
        late = [to_identifiers([f"{name}_late"], inner)[0] if k in delayed else name for k, name in enumerate(inputs)]
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
                symbols[value.name()] if same else to_identifiers([name], [*RESERVED, *inner, *late, *outputs])[0]
            )
        return cls(states, inputs, outputs, parameters, late, shown, symbols)


def write_declarations(plant: Plant, names: ModelicaNames, writer: Printer) -> list[str]:
    """Parameters, inputs, states and outputs, and what dry friction needs, a line each."""
    model, s = plant.model, plant.model.system
    lines = []
    for name, q in zip(names.parameters, model.all_parameters, strict=True):
        limits = {"min": q.bounds[0], "max": q.bounds[1]}
        inside = [*_unit(q.unit), *(f"{key} = {value!r}" for key, value in limits.items() if abs(value) < 1e300)]
        remark = f"{q.description} ({plant.provenance(q.name)})".strip()
        lines.append(f'  parameter Real {name}{_brackets(inside)} = {float(q.value)!r} "{to_modelica_string(remark)}";')
    lines += [
        f'  input Real {name}{_brackets(_unit(i.unit))} "{to_modelica_string(i.description)}";'
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
        lines.append(f'  {seen}Real {name}{_brackets(inside)} "{to_modelica_string(x.description)}";')
    for name, o, shown in zip(names.outputs, model.outputs, names.shown, strict=True):
        if not shown:
            lines.append(f'  output Real {name}{_brackets(_unit(o.unit))} "{to_modelica_string(o.description)}";')
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
    text = format_unit(unit).replace("*", ".").replace("^", "").replace("ohm", "Ohm")
    if text in ("", "-", "1") or re.search(r"\.\d|%|\d\.", text):
        return []
    return [f'unit = "{text}"']


def _brackets(inside: Sequence[str]) -> str:
    return f"({', '.join(inside)})" if inside else ""


def to_modelica_string(text: str) -> str:
    """Text inside a Modelica string."""
    return text.replace("\\", "\\\\").replace('"', "'")
