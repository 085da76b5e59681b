"""Whether the units of a model agree: each term in its balance's, each transform in that of what it replaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import casadi as ca

from greybox.base.errors import ModelError, UnitError, nearest
from greybox.base.units import ONE, Unit, format_unit, parse_unit, unit_converter, unit_name
from greybox.model.balance import Balance, stores_nothing
from greybox.model.expressions.operations import UnitMismatchError
from greybox.model.expressions.text import infer_unit
from greybox.model.signals import NamedValues, names_by_role
from greybox.model.system import Item, PlacedEffect, Statement, System, intensity_unit
from greybox.model.ties import apply_ties

MEASURED = "measured value"  # what a sensor effect is given; the blank keeps it apart from a state of that name


def check_units(statement: Statement, system: System) -> None:
    """Refuse a model whose units disagree: UnitError with every offender, by balance and term, found and expected.

    Checked are each term of each balance, the dimension of ``storage * state / s``, dry friction, outputs, starts, process noise, and what
    effects put in the place of inputs, outputs and parameters. A literal number has no unit, except 0 and infinity, which fit
    anything. In a model of plain numbers, in which nothing has a unit, time is a number too, in the unit of its records, and so it is in
    the units of the effects that are added to it.
    """
    check = _UnitCheck(statement, system)
    # Transforms before equations, each on its own: a wrong one would hide behind every term that it makes wrong.
    for step in (check.declarations, check.ties, check.transforms, check.equations):
        problems = list(step())
        if problems:
            raise UnitError(
                f"model {statement.title!r}: {'; '.join(problems)}. Correct the equation, or the unit of a parameter in it"
            )


class _UnitCheck:
    """The units of one model; each method yields what is wrong in one part of it."""

    def __init__(self, statement: Statement, system: System) -> None:
        self.statement, self.system = statement, system
        self.parameters = (*statement.parameters, *(q for placed in system.effects for q in placed.parameters))

    @cached_property
    def is_plain(self) -> bool:
        """Whether nothing that the user states has a unit; effects, which are added, have no say in it."""
        statement = self.statement
        added = {state.name for placed in self.system.effects for state in placed.states}
        items: tuple[Item, ...] = (*statement.states, *statement.inputs, *statement.parameters)
        balances = (b for b in self.system.stated_balances if b.state not in added)
        units = {*(i.unit for i in items), *(o.unit for o in statement.outputs), *(b.unit for b in balances)}
        return all(parse_unit(unit) == ONE for unit in units)

    @cached_property
    def units(self) -> dict[str, str]:
        """The unit of each state, input and parameter by name, as they are checked."""
        relations = tuple(a.state for a in self.system.algebraic)
        items: tuple[Item, ...] = (*self.system.states, *relations, *self.statement.inputs, *self.parameters)
        return {item.name: self._as_checked(item.unit) for item in items}

    def _as_checked(self, unit: str) -> str:
        """``unit``; without its power of time in a model of plain numbers, where a second is a number as all others are."""
        power = dict(parse_unit(unit).dimensions).get("s") if self.is_plain else None
        return f"({unit})*s^({-power})" if power else unit

    @cached_property
    def symbols(self) -> tuple[NamedValues, NamedValues, NamedValues]:
        """States, inputs and parameters as the symbols of the system, under their names and roles."""
        s, roles = self.system, names_by_role(self.parameters)
        relations = {a.state.name: a.symbol for a in s.algebraic}
        roles_of_states = names_by_role((*s.states, *(a.state for a in s.algebraic)))
        x = NamedValues("state", _by_name(s.state_names, s.x) | relations, roles_of_states)
        inputs = self.statement.inputs
        u = NamedValues("input", _by_name(s.input_names, s.u), names_by_role(inputs))
        p = NamedValues("parameter", _by_name(s.parameter_names, s.p), roles)
        return x, u, apply_ties(self.statement.ties, p)

    def declarations(self) -> Iterator[str]:
        """Units that cannot be read, each once with all that have it."""
        groups: dict[str, Sequence[Item | Balance]] = {
            "state": self.system.states,
            "input": self.statement.inputs,
            "output": self.statement.outputs,
            "parameter": self.parameters,
            "balance": self.system.stated_balances,
        }
        by_reason: dict[str, list[str]] = {}
        for kind, items in groups.items():
            for item in items:
                try:
                    parse_unit(item.unit)
                except ModelError as error:
                    by_reason.setdefault(str(error), []).append(f"{kind} {item.name!r}")
        for reason, named in by_reason.items():
            yield f"{', '.join(named)}: {reason}"

    def ties(self) -> Iterator[str]:
        """Formulas of tied parameters."""
        for tie in self.statement.ties:
            yield from self._expect(f"tie {tie}", self.symbols[2][tie.name], self.units[tie.name])

    def transforms(self) -> Iterator[str]:
        """What effects put in the place of a parameter, a state, an input or an output."""
        for placed in self.system.effects:
            yield from self._transforms_of(placed)

    def _transforms_of(self, placed: PlacedEffect) -> Iterator[str]:
        (x, u, p), effect, subject = self.symbols, placed.effect, f"effect {placed.effect.name!r}"
        outputs = {o.name: o.unit for o in self.statement.outputs}
        reading = ca.SX.sym(MEASURED)
        seen = placed.sees_states(x.replaced({"sensor": reading}), u)
        names = seen, placed.sees_inputs(u), placed.sees_parameters(p)
        known = {**self.units, MEASURED: outputs.get(placed.site, self.statement.outputs[0].unit)}
        for given, value in (effect.on_parameter(*names) if effect.on_parameter else {}).items():
            parameter = next((q.name for q in self.parameters if given in (q.name, q.role)), None)
            if parameter is None:
                yield f"{subject}: no parameter {given!r} to change; {nearest(given, self.system.parameter_names)}"
            else:
                yield from self._expect(f"{subject} on parameter {parameter!r}:", value, self.units[parameter])
        for given, value in (effect.on_state(*names) if effect.on_state else {}).items():
            state = next((s.name for s in self.system.states if given in (s.name, s.role)), None)
            if state is None:
                yield f"{subject}: no state {given!r} to change; {nearest(given, self.system.state_names)}"
            else:
                yield from self._expect(f"{subject} on state {state!r}:", value, self.units[state])
        if effect.on_input:
            value = effect.on_input(u[placed.site], *names)
            yield from self._expect(f"{subject} on input {placed.site!r}:", value, self.units[placed.site])
        if effect.delay:
            yield from self._expect(f"{subject} delay of input {placed.site!r}:", effect.delay(*names), "s")
        for given, value in (effect.update(*names) if effect.update else {}).items():
            state = placed.model_names[given]
            yield from self._expect(f"{subject} update of state {state!r}:", value, self.units[state], known)
        if effect.on_output:
            value = effect.on_output(reading, *names)
            yield from self._expect(f"{subject} on output {placed.site!r}:", value, outputs[placed.site], known)

    def equations(self) -> Iterator[str]:
        """Balances, dry friction, outputs, starts and process noise."""
        system = self.system
        dry = {(d.balance, d.effect): d for d in system.dry}
        for balance in system.stated_balances:
            place = f"balance {balance.name!r} [{format_unit(balance.unit)}]:"
            if not stores_nothing(balance):
                yield from self._storage(place, balance)
            for term, value in balance.terms.items():
                friction, block = dry.get((balance.name, term)), balance.blocks.get(term)
                if block is not None and block.unit:  # as told
                    yield from self._told(f"{place} term {term!r}", block.unit, balance.unit)
                elif friction is None:
                    yield from self._expect(f"{place} term {term!r}", value, balance.unit)
                else:  # the term itself is the sliding friction times a sign
                    yield from self._expect(f"{place} sliding friction {term!r}", friction.sliding, balance.unit)
                    if friction.static.element_hash() != friction.sliding.element_hash():
                        yield from self._expect(f"{place} static friction {term!r}", friction.static, balance.unit)
        outputs = system.outputs if system.stated_outputs is None else system.stated_outputs
        for k, output in enumerate(self.statement.outputs):
            for problem in self._expect(f"output {output.name!r}", outputs[k], output.unit):
                yield problem + self._explain_scale(outputs[k], output.unit)
        for k, state in enumerate(system.states):
            start, noise = system.start[k], system.diffusion[k]
            if not start.is_constant():  # a number is in the unit of its state
                yield from self._expect(f"start of state {state.name!r}", start, state.unit)
            if not noise.is_constant():
                yield from self._expect(f"noise of state {state.name!r}", noise, intensity_unit(state))

    def _storage(self, place: str, balance: Balance) -> Iterator[str]:
        subject = f"{place} storage times d{balance.state}/dt"
        try:
            stored = infer_unit(balance.storage, self.units) or ONE
        except UnitMismatchError as mismatch:
            yield f"{subject}: {mismatch}"
            return
        rate = stored * parse_unit(self.units[balance.state]) / parse_unit(self._as_checked("s"))
        # Another scale of the same dimension is no mistake: the system is written out in it.
        if rate.dimensions != parse_unit(self._as_checked(balance.unit)).dimensions:
            yield f"{subject} has {self._describe(rate)}, expected {format_unit(balance.unit) or '1'}"

    def _told(self, subject: str, unit: str, expected: str) -> Iterator[str]:
        if parse_unit(unit) != parse_unit(expected):
            yield f"{subject} has unit {format_unit(unit)}, expected {format_unit(expected) or '1'}"

    def _expect(
        self, subject: str, value: ca.SX | float, unit: str, units: Mapping[str, str] | None = None
    ) -> Iterator[str]:
        units = units or self.units
        try:
            inferred = infer_unit(value, units)
        except UnitMismatchError as mismatch:
            yield f"{subject.removesuffix(':')}: {mismatch}"
            return
        if inferred is not None and inferred != parse_unit(self._as_checked(unit)):
            yield f"{subject} has {self._describe(inferred, units)}, expected {format_unit(unit) or '1'}"

    def _explain_scale(self, value: ca.SX | float, unit: str) -> str:
        """What to do about an output that is computed in another unit of the same quantity: records need not be in the model's."""
        try:
            inferred = infer_unit(value, self.units)
        except UnitMismatchError:
            return ""
        if inferred is None or inferred.dimensions != parse_unit(unit).dimensions:
            return ""
        computed = unit_name(inferred, self.units.values())
        if inferred == ONE:
            computed = "rad" if _is_angle(unit) else "1"
        return f" (it is computed in {computed}: declare it so, and records in {format_unit(unit)} are converted)"

    def _describe(self, unit: Unit, units: Mapping[str, str] | None = None) -> str:
        return "no unit" if unit == ONE else f"unit {unit_name(unit, (units or self.units).values())}"


def _is_angle(unit: str) -> bool:
    try:
        unit_converter("rad", unit)
    except UnitError:
        return False
    return True


def _by_name(names: tuple[str, ...], symbols: ca.SX) -> dict[str, ca.SX]:
    return {name: symbols[k] for k, name in enumerate(names)}
