"""Whether the units of a model agree: each term in its balance's, each transform in that of what it replaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import casadi as ca

from greybox.errors import ModelError, UnitError, nearest
from greybox.expressions.unit_rules import UnitMismatchError
from greybox.expressions.units import infer_unit
from greybox.model.balance import Balance
from greybox.model.signals import Input, NamedValues, Output, Parameter, State
from greybox.model.system import System
from greybox.model.ties import apply_ties
from greybox.units import ONE, Unit, format_unit, parse_unit, unit_name

if TYPE_CHECKING:
    from greybox.model.model import Model

Signal = State | Input | Output | Parameter

SECOND = parse_unit("s")
MEASURED = "measured value"  # what a sensor effect is given; the blank keeps it apart from a state of that name


def check_units(model: Model) -> None:
    """Refuse a model whose units disagree: UnitError with every offender, by balance and term, found and expected.

    Checked are each term of each balance, ``storage * state / s``, dry friction, outputs, starts, process noise, and what
    effects put in the place of inputs, outputs and parameters. A literal number has no unit, except 0 and infinity, which fit
    anything.
    """
    problems = list(_declared(model))
    if not problems:
        units = _units(model)
        # Transforms first, each on its own: a wrong one would hide behind every term that it makes wrong.
        problems = (
            list(_ties(model, units)) or list(_transforms(model, units)) or list(_equations(model.system, units, model))
        )
    if problems:
        raise UnitError(
            f"model {model.title!r}: {'; '.join(problems)}. Correct the equation, or the unit of a parameter in it"
        )


def _declared(model: Model) -> Iterator[str]:
    """Problems with the units as they are written down."""
    groups: dict[str, Sequence[Signal]] = {
        "state": model.all_states,
        "input": model.inputs,
        "output": model.outputs,
        "parameter": model.stated_parameters,
    }
    for kind, items in groups.items():
        for item in items:
            yield from _unreadable(f"{kind} {item.name!r}", item.unit)
    for balance in model.system.balances:
        yield from _unreadable(f"balance {balance.name!r}", balance.unit)


def _unreadable(subject: str, unit: str) -> Iterator[str]:
    try:
        parse_unit(unit)
    except ModelError as error:
        yield f"{subject}: {error}"


def _units(model: Model) -> dict[str, str]:
    items: tuple[Signal, ...] = (*model.all_states, *model.inputs, *model.stated_parameters)
    return {item.name: item.unit for item in items}


def _transforms(model: Model, units: Mapping[str, str]) -> Iterator[str]:
    """Problems with what effects put in the place of a parameter, an input or an output."""
    x, u, p = _names(model)
    outputs = {o.name: o.unit for o in model.outputs}
    for b in model.bound_effects:
        reading = ca.SX.sym(MEASURED)
        inside = b.within(x.replaced({"sensor": reading}), b.effect.states), u, b.within(p, b.effect.parameters)
        known = {**units, MEASURED: outputs.get(b.site, model.outputs[0].unit)}
        effect = f"effect {b.effect.name!r}"
        for given, value in (b.effect.on_parameter(*inside) if b.effect.on_parameter else {}).items():
            parameter = next((q.name for q in model.stated_parameters if given in (q.name, q.role)), None)
            if parameter is None:
                yield f"{effect}: no parameter {given!r} to change; {nearest(given, model.values)}"
            else:
                yield from _expected(f"{effect} on parameter {parameter!r}:", value, units[parameter], units=units)
        for given, value in (b.effect.on_state(*inside) if b.effect.on_state else {}).items():
            state = next((s.name for s in model.all_states if given in (s.name, s.role)), None)
            if state is None:
                yield f"{effect}: no state {given!r} to change; {nearest(given, model.system.state_names)}"
            else:
                yield from _expected(f"{effect} on state {state!r}:", value, units[state], units=units)
        if b.effect.on_input:
            value = b.effect.on_input(u[b.site], *inside)
            yield from _expected(f"{effect} on input {b.site!r}:", value, units[b.site], units=units)
        if b.effect.delay:
            yield from _expected(f"{effect} delay of input {b.site!r}:", b.effect.delay(*inside), "s", units=units)
        for given, value in (b.effect.update(*inside) if b.effect.update else {}).items():
            state = b.own[given]
            yield from _expected(f"{effect} update of state {state!r}:", value, units[state], units=known)
        if b.effect.on_output:
            value = b.effect.on_output(reading, *inside)
            yield from _expected(f"{effect} on output {b.site!r}:", value, outputs[b.site], units=known)


def _names(model: Model) -> tuple[NamedValues, NamedValues, NamedValues]:
    """States, inputs and parameters as the symbols of the expanded model, under their names and roles."""
    s = model.system
    groups: tuple[tuple[str, Sequence[Signal], ca.SX], ...] = (
        ("state", model.all_states, s.x),
        ("input", model.inputs, s.u),
        ("parameter", model.all_parameters, s.p),
    )
    named = []
    for kind, items, symbols in groups:
        values = {item.name: symbols[k] for k, item in enumerate(items)}
        named.append(NamedValues(kind, values, {item.role: item.name for item in items if item.role}))
    roles = {q.role: q.name for q in model.stated_parameters if q.role}
    return named[0], named[1], apply_ties(model.ties, named[2].replaced({}, roles))


def _ties(model: Model, units: Mapping[str, str]) -> Iterator[str]:
    """Problems with the formulas of tied constants."""
    p = _names(model)[2]
    for tie in model.ties:
        yield from _expected(f"tie {tie}", p[tie.name], units[tie.name], units=units)


def _equations(system: System, units: Mapping[str, str], model: Model) -> Iterator[str]:
    """Problems in balances, dry friction, outputs, starts and process noise."""
    dry = {(d.balance, d.effect): d for d in system.dry}
    for balance in system.balances:
        place = f"balance {balance.name!r} [{format_unit(balance.unit)}]:"
        check = partial(_expected, unit=balance.unit, units=units)
        yield from _storage(place, balance, units)
        for term, value in balance.terms.items():
            friction = dry.get((balance.name, term))
            if friction is None:
                yield from check(f"{place} term {term!r}", value)
            else:  # the term itself is the sliding friction times a sign
                yield from check(f"{place} sliding friction {term!r}", friction.sliding)
                if friction.static.element_hash() != friction.sliding.element_hash():
                    yield from check(f"{place} static friction {term!r}", friction.static)
    for k, output in enumerate(model.outputs):
        yield from _expected(f"output {output.name!r}", system.outputs[k], output.unit, units=units)
    for k, state in enumerate(model.all_states):
        start = system.start[k]
        if not start.is_constant():  # a number is in the unit of its state
            yield from _expected(f"start of state {state.name!r}", start, state.unit, units=units)
        noise = system.diffusion[k]
        if not noise.is_constant():
            yield from _expected(f"noise of state {state.name!r}", noise, f"({state.unit or '1'})/s^0.5", units=units)


def _storage(place: str, balance: Balance, units: Mapping[str, str]) -> Iterator[str]:
    subject = f"{place} storage times d{balance.state}/dt"
    try:
        stored = infer_unit(balance.storage, units) or ONE
    except UnitMismatchError as mismatch:
        yield f"{subject}: {mismatch}"
        return
    rate = stored * parse_unit(units[balance.state]) / SECOND
    if rate != parse_unit(balance.unit):
        yield f"{subject} has {_called(rate, units)}, expected {format_unit(balance.unit) or '1'}"


def _expected(subject: str, value: ca.SX | float, unit: str, *, units: Mapping[str, str]) -> Iterator[str]:
    try:
        found = infer_unit(value, units)
    except UnitMismatchError as mismatch:
        yield f"{subject.removesuffix(':')}: {mismatch}"
        return
    if found is not None and found != parse_unit(unit):
        yield f"{subject} has {_called(found, units)}, expected {format_unit(unit) or '1'}"


def _called(unit: Unit, units: Mapping[str, str]) -> str:
    return "no unit" if unit == ONE else f"unit {unit_name(unit, units.values())}"
