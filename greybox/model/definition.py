"""What a model states, as a value that a result keeps: how a result is joined with a model, and how finished work is known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca

from greybox.base import format_unit
from greybox.model.equations import equations_text
from greybox.model.expressions.text import expression_text
from greybox.model.model import Model


class Difference(NamedTuple):
    """A line of a stored definition and the line of the model in its place; "" where one of them has none."""

    stored: str
    present: str

    def __str__(self) -> str:
        return f"{self.stored or 'nothing'} -> {self.present or 'nothing'}"


def declare(model: Model) -> dict[str, str]:
    """What a model states besides its equations, a line for each name: constants with units and bounds, states with starts, the plant."""
    system = model.system
    # Bounds of an effect follow the records that it is fitted to, and the plant that a search puts it into.
    tailored = {q.name for bound in model.bound_effects for q in bound.parameters}
    lines = {
        q.name: _declare_constant(q.name, q.unit)
        + ("" if q.name in tailored else f" within {q.bounds[0]:.12g} to {q.bounds[1]:.12g}")
        for q in model.all_parameters
    }
    for k, state in enumerate(system.states):
        limits = f", within {state.bounds[0]:.12g} to {state.bounds[1]:.12g}"
        start = expression_text(system.start[k])
        lines[f"state {state.name}"] = (
            f"state {state.name} [{format_unit(state.unit) or '-'}] starts at {start}{limits}"
        )
    lines |= {f"record of {e.name}": f"{e.name} holds {e.hold}, late {e.late}" for e in model.effects if e.is_of_record}
    return lines | ({"plant": f"plant {model.identity}"} if model.identity else {})


def _declare_constant(name: str, unit: str) -> str:
    return f"{name} [{format_unit(unit) or '-'}]"


def compare_definition(
    model: Model, equations: str, declared: Mapping[str, str], units: Mapping[str, str]
) -> tuple[Difference, ...]:
    """What a model states otherwise than the definition that a result keeps.

    Parameters
    ----------
    model
        The model of today, with the effects and ties of the result.
    equations
        The equations of the result (`equations_text`).
    declared
        What else its model stated (`declare`); empty in files of earlier versions, of which constants are compared by name and unit.
    units
        Constant -> unit, of the result.

    Returns
    -------
    tuple of Difference
        Each line that differs; none where the result belongs to this model.
    """
    present = declare(model) if declared else {q.name: _declare_constant(q.name, q.unit) for q in model.all_parameters}
    stored = declared or {name: _declare_constant(name, unit) for name, unit in units.items()}
    pairs = [(stored.get(name, ""), present.get(name, "")) for name in {**stored, **present}]
    if equations:
        before, now = _entries(equations), _entries(equations_text(model))
        pairs = [pair for head in {**before, **now} for pair in _pair(before.get(head, []), now.get(head, []))] + pairs
    return tuple(Difference(*pair) for pair in pairs if pair[0] != pair[1])


def _entries(equations: str) -> dict[str, list[str]]:
    """Name of a balance, or of another part -> its lines, without the spaces that align them."""
    entries: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in equations.splitlines():
        text = " ".join(line.split())
        # A part begins two characters in; what goes on stands below its equation.
        if line[2:3].strip():
            lines = entries.setdefault(text.partition("[")[0] if "[" in text else text, [])
        lines.append(text)
    return entries


def _pair(before: list[str], now: list[str]) -> list[tuple[str, str]]:
    if len(before) == len(now):
        return list(zip(before, now, strict=True))
    return [(" ".join(before), " ".join(now))]


def identify(model: Model) -> list[Any]:
    """Everything about a model that decides where a search ends: equations or the plant, constants, ties, bounds."""
    system = model.system
    return [
        str(ca.vertcat(*map(ca.vec, [*system.free_run_expressions, system.diffusion]))),
        [(q.name, q.value, q.bounds, q.fixed, q.prior) for q in model.all_parameters],
        [(tie.name, tie.formula) for tie in model.ties],
        [(s.name, s.bounds) for s in model.all_states],
        [(e.hold, e.late) for e in model.effects],
        # Of a plant without equations these say nothing.
        model.identity,
    ]
