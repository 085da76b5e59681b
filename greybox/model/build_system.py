"""From what a model states to CasADi expressions: balances with every effect applied, right-hand side, outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any
from weakref import WeakSet

import casadi as ca

from greybox.base import MissingNameError, ModelError, nearest
from greybox.base.numerics import STATE_BOUND_MARGIN
from greybox.base.units import ONE, SECOND, format_unit, parse_unit
from greybox.model import ties, unit_check, validation
from greybox.model.balance import AlgebraicState, Balance, eliminate, solve_relations, stores_nothing
from greybox.model.effect import (
    EVERY_BALANCE,
    InputDelay,
    StateUpdate,
    build_delay,
    collect_updates,
    find_relaxing_states,
)
from greybox.model.expressions.operations import UnitMismatchError
from greybox.model.expressions.text import infer_unit
from greybox.model.signals import Input, NamedValues, State
from greybox.model.sites import PlaceKind, Site, complete_roles, list_sites, require_site
from greybox.model.system import (
    DryFrictionTerm,
    EffectEquations,
    Item,
    ParameterSymbol,
    PlacedEffect,
    Statement,
    System,
    build_diffusion,
    named_symbols,
)

# What can be done where a body cannot be held still.
SMOOTHED = "add the effect in its smoothed form, effect.smoothed(0.01), with the speed below which it is viscous"
NOWHERE = Site("", PlaceKind.BALANCE, "")
# Functions of an effect that need a place of that kind.
_ACTS = {
    PlaceKind.BALANCE: ("dry",),
    PlaceKind.INPUT: ("on_input", "delay"),
    PlaceKind.OUTPUT: ("on_output",),
}


def place_effects(statement: Statement) -> tuple[PlacedEffect, ...]:
    """Each effect with unique names, resolved units and its site.

    Raises ModelError for an effect that is added twice, acts at a place that the model does not have, or needs a unit of something that
    it does not have.
    """
    items: tuple[Item, ...] = (*statement.states, *statement.inputs, *statement.parameters)
    taken = {item.name for item in items}
    plant = read_plant(statement)
    placed: list[PlacedEffect] = []
    for effect in statement.effects:
        if any(effect.name == other.effect.name for other in placed):
            raise ModelError(
                f"model {statement.name!r} already has the effect {effect.name!r}; an effect can be added once"
            )
        site = require_site(effect.name, effect.site, statement.name, plant.sites) if effect.site else NOWHERE
        _check_place(effect, site, plant.relations)
        units = plant.units | _unit_words(site.units)
        words = {word: unit for word, unit in units.items() if site.states.get(word) != ""}
        own_items: tuple[Item, ...] = (*effect.parameters, *effect.states)
        names = {item.name: f"{effect.name}.{item.name}" if item.name in taken else item.name for item in own_items}
        parameters = tuple(
            ParameterSymbol(names[q.name], _fill_unit(q.unit, words, effect, statement.name), q.role)
            for q in effect.parameters
        )
        states = tuple(
            replace(s, name=names[s.name], unit=_fill_unit(s.unit, words, effect, statement.name))
            for s in effect.states
        )
        taken |= set(names.values())
        placed.append(PlacedEffect(effect, parameters, states, site))
    return tuple(placed)


def _check_place(effect: EffectEquations, site: Site, relations: Mapping[str, str]) -> None:
    """Refuse an effect at a place that does not have what it changes. Raises ModelError."""
    needed = [kind for kind, acts in _ACTS.items() if effect.site and any(getattr(effect, act) for act in acts)]
    if needed and site.kind not in needed:
        article = "a" if site.kind is PlaceKind.BALANCE else "an"
        raise ModelError(
            f"effect {effect.name!r} acts at {' or '.join(needed)}s, and {site.name!r} is {article} {site.kind}; name another place"
        )
    if effect.dry and site.name in relations:
        moves = site.states.get("velocity", relations[site.name])
        if moves in relations.values():
            raise ModelError(
                f"effect {effect.name!r} can hold a body still, and balance {site.name!r} stores nothing; give it a storage, or"
                f" {SMOOTHED}"
            )


@dataclass(frozen=True, eq=False)
class PlantEquations:
    """What a plant states itself, the same whatever effects are added to it.

    ``inputs``, ``parameters``: these with the roles that a balance tells; ``sites``: where effects may act; ``relations``: balance that
    stores nothing -> its state; ``units``: what the words in the units of an effect stand for; ``written``: every line that its functions
    state, by its place.
    """

    inputs: tuple[Input, ...]
    parameters: tuple[ParameterSymbol, ...]
    sites: tuple[Site, ...]
    relations: Mapping[str, str]
    units: dict[str, str]
    written: Mapping[str, str]


def read_plant(statement: Statement) -> PlantEquations:
    """The plant of a statement, checked: a search adds effects to one plant a thousand times.

    Raises ModelError for names that clash, and for balances and outputs that are no expressions.
    """
    plant = statement._replace(effects=(), ties=(), delay_ranges=())
    try:
        hash(plant)
    except TypeError:
        return _read_plant(plant)
    return _read_plant_once(plant)


def _read_plant(plant: Statement) -> PlantEquations:
    validation.check_names(plant)
    validation.check_expressions(plant)
    written = _write_plant(plant)
    balances = plant.balances(*_plant_symbols(plant))
    inputs, parameters = complete_roles(plant.states, plant.inputs, plant.parameters, balances)
    return PlantEquations(
        inputs,
        parameters,
        list_sites(plant.states, inputs, plant.outputs, balances),
        {b.name: b.state for b in balances if stores_nothing(b)},
        _units_by_word(plant._replace(inputs=inputs, parameters=parameters), balances),
        written,
    )


_read_plant_once = lru_cache(maxsize=64)(_read_plant)


def build_system(statement: Statement) -> System:
    """The equations of a model, effects applied in the order in which they were added."""
    effects = place_effects(statement)
    relations = {*read_plant(statement).relations.values()}
    dynamic = tuple(s for s in statement.states if s.name not in relations)
    states = (*dynamic, *(s for e in effects for s in e.states))
    every = (*statement.parameters, *(q for e in effects for q in e.parameters))
    tied = {tie.name for tie in statement.ties}
    parameters = [q for q in every if q.name not in tied]
    x, u, p = (
        named_symbols("state", (*statement.states, *(s for e in effects for s in e.states))),
        named_symbols("input", statement.inputs),
        named_symbols("parameter", every),
    )
    symbols_x, symbols_u, symbols_p = (
        ca.vertcat(*[named[item.name] for item in group])
        for named, group in ((x, states), (u, statement.inputs), (p, parameters))
    )

    plant_symbols = {s.name: x[s.name] for s in statement.states}
    p = ties.apply_ties(statement.ties, p)
    diffusion = build_diffusion(dynamic, effects, p)
    x, u, p, before = _transform_signals(statement, effects, x, u, p)
    items: tuple[Item, ...] = (*statement.states, *statement.inputs, *every)
    units = {item.name: item.unit for item in items}
    balances = {b.name: _in_stated_time(b, units) for b in statement.balances(x, u, p)}
    outputs = {o.name: ca.SX(o.equation(x, u, p) if o.equation else x[o.name]) for o in statement.outputs}
    plant = _solve_relations(statement, balances.values(), plant_symbols, p)
    # At rest, inputs are zero, where a relation that is not linear may have no solution: its state is at its start value there.
    first = _start_values([a.state for a in plant], p)
    at_start = [a if a.is_exact else replace(a, value=ca.SX(first[k])) for k, a in enumerate(plant)]
    readings = {name: eliminate(reading, at_start) for name, reading in outputs.items()}
    start = _start(statement, dynamic, effects, p, readings, symbols_x, symbols_u)
    ranges = dict(zip((q.name for q in every), statement.delay_ranges, strict=False))
    equations = _Equations(
        statement,
        [s.name for s in states],
        symbols_x,
        plant_symbols,
        balances,
        outputs,
        _units_by_word(statement, balances.values()),
        {name: ranges[name] for name in (q.name for q in parameters)} if ranges else {},
        {name: frozenset(b.terms) for name, b in balances.items()},
    )
    for effect in effects:
        equations.add(effect, *before.get(effect.effect.name, (x, u)), p)

    order = equations.states
    every_state = (*statement.states, *(s for e in effects for s in e.states))
    updated = {order[s.state]: s.effect for s in equations.updates}
    stated = _order_balances(statement.name, every_state, balances, updated)
    algebraic = _solve_relations(statement, stated, plant_symbols, p)
    ordered = tuple(_without_relations(b, algebraic) for b in stated if b.state not in relations)
    dry = [
        replace(d, sliding=eliminate(d.sliding, algebraic), static=eliminate(d.static, algebraic))
        for d in equations.dry
    ]
    shown = ca.vertcat(*outputs.values())
    held = {d.effect: d for d in dry if stores_nothing(balances[d.balance])}
    if held:
        force = {name: ca.SX.sym(name) for name in held}
        free = [b.with_terms_replaced({n: f for n, f in force.items() if held[n].balance == b.name}) for b in stated]
        solved = _solve_relations(statement, free, plant_symbols, p)
        felt = [_without_relations(b, solved) for b in stated if b.state not in relations]
        ordered, moved = _move_frictions(statement, held, force, felt, eliminate(shown, solved), order, symbols_x)
        dry = [moved.get(d.effect, d) for d in dry]
    direction = ca.SX.sym("direction", len(dry))
    storages, sums = ca.SX.ones(len(order)), ca.SX.zeros(len(order))
    rows = [order.index(b.state) for b in ordered]
    storages[rows] = ca.vertcat(*[ca.SX(b.storage) for b in ordered])
    sums[rows] = _sums(ordered, dry, direction)
    rhs = hold_inside_bounds(sums / storages, symbols_x, states)
    return System(
        x=symbols_x,
        u=symbols_u,
        p=symbols_p,
        direction=direction,
        states=states,
        input_names=tuple(i.name for i in statement.inputs),
        output_names=tuple(outputs),
        parameter_names=tuple(q.name for q in parameters),
        balances=ordered,
        storages=storages,
        rhs=rhs,
        outputs=eliminate(shown, algebraic),
        start=start,
        diffusion=diffusion,
        dry=tuple(dry),
        updates=tuple(replace(u, value=eliminate(u.value, algebraic)) for u in equations.updates),
        delays=tuple(equations.delays),
        relaxing=find_relaxing_states(statement.name, states, rhs, symbols_x),
        effects=effects,
        algebraic=algebraic,
        stated_balances=stated,
        stated_outputs=shown,
    )


def _solve_relations(
    statement: Statement, balances: Iterable[Balance], symbols: Mapping[str, ca.SX], p: NamedValues
) -> tuple[AlgebraicState, ...]:
    """The states of balances that store nothing."""
    states = {s.name: s for s in statement.states}
    relations = [b for b in balances if b.state in states and stores_nothing(b)]
    for b in relations:
        if callable(states[b.state].noise) or states[b.state].noise:
            raise ModelError(
                f"model {statement.name!r}: state {b.state!r} has process noise, but its balance {b.name!r} stores nothing and has no"
                " rate to push; put the noise on another state"
            )
    start = _start_values([states[b.state] for b in relations], p)
    return solve_relations(statement.name, relations, states, symbols, start)


def _without_relations(balance: Balance, algebraic: Sequence[AlgebraicState]) -> Balance:
    if not algebraic:
        return balance
    return balance.with_expressions(lambda value: eliminate(ca.SX(value), algebraic))


def _move_frictions(
    statement: Statement,
    dry: Mapping[str, DryFrictionTerm],
    force: Mapping[str, ca.SX],
    balances: Sequence[Balance],
    outputs: ca.SX,
    states: Sequence[str],
    x: ca.SX,
) -> tuple[tuple[Balance, ...], dict[str, DryFrictionTerm]]:
    """Dry friction of relations at the balances of the velocities that it stops: these balances, and the friction there by its effect.

    ``balances`` and ``outputs`` have a symbol in the place of each ``force``. Raises ModelError where another balance or an output feels
    it too: a body that is held pushes them by a force that nobody knows.
    """
    forces = ca.vertcat(*force.values())
    moved: dict[str, DryFrictionTerm] = {}
    result = [b.with_expressions(lambda value: ca.substitute(ca.SX(value), forces, 0 * forces)) for b in balances]
    for name, d in dry.items():
        # d(sum)/d(force) of a balance: its storage over the inertia behind the relation; 0 where the force is not felt.
        slopes = [ca.jacobian(sum(map(ca.SX, b.terms.values()), ca.SX(0)), force[name]) for b in balances]
        t = next(k for k, b in enumerate(balances) if b.state == states[d.state])
        felt = [k for k, slope in enumerate(slopes) if not slope.is_zero()]
        if felt != [t] or ca.depends_on(ca.vertcat(outputs, d.sliding, d.static, slopes[t]), forces):
            raise ModelError(
                f"model {statement.name!r}: effect {name!r} can hold a body still, and through balance {d.balance!r}, which stores nothing,"
                f" more than {states[d.state]} feels what holds it; {SMOOTHED}"
            )
        moved[name] = replace(d, balance=balances[t].name, sliding=slopes[t] * d.sliding, static=slopes[t] * d.static)
        result[t] = result[t].with_term(name, -moved[name].sliding * ca.sign(x[d.state]))
    return tuple(result), moved


@dataclass
class _Equations:
    """Balances, outputs and the rest of a model while its effects are applied one after the other."""

    statement: Statement
    states: list[str]
    x: ca.SX
    plant_symbols: Mapping[str, ca.SX]
    balances: dict[str, Balance]
    outputs: dict[str, ca.SX]
    units: Mapping[str, str]
    delay_ranges: Mapping[str, tuple[float, ...]]
    plant_terms: Mapping[str, frozenset[str]]
    dry: list[DryFrictionTerm] = field(default_factory=list)
    updates: list[StateUpdate] = field(default_factory=list)
    delays: list[InputDelay] = field(default_factory=list)

    def add(self, placed: PlacedEffect, x: NamedValues, u: NamedValues, p: NamedValues) -> None:
        """Apply an effect that comes to see the states ``x`` and the inputs ``u``."""
        effect, outputs = placed.effect, self.outputs
        # An effect at a sensor sees its reading; one elsewhere that of the first output.
        sensor = outputs[placed.site if placed.site in outputs else self.statement.outputs[0].name]
        seen = placed.sees_states(x.replaced({"sensor": sensor, **self._balance_sums(placed, u)}), u)
        names = seen, placed.sees_inputs(u), placed.sees_parameters(p)
        # What changes a term or a storage comes before what adds terms: an added term is not changed by its own effect.
        for site, changed in (effect.on_term(*names) if effect.on_term else {}).items():
            self.balances[site] = self._balance(site, effect).with_terms_replaced(changed)
        for site, factor in (effect.on_storage(*names) if effect.on_storage else {}).items():
            # What scales time scales every rate: those of the plant and of the effects before this one.
            stored = (
                [b.name for b in self.balances.values() if not stores_nothing(b)] if site == EVERY_BALANCE else [site]
            )
            for name in stored:
                self.balances[name] = self._balance(name, effect).with_storage(factor)
        if effect.terms:
            terms = effect.terms(*names)
            for site, term in (terms if isinstance(terms, Mapping) else {placed.site: terms}).items():
                # Dry friction has the name of the effect; what acts beside it has another.
                term_name = f"{effect.name}_beside" if effect.dry else effect.name
                self.balances[site] = self._balance(site, effect).with_term(term_name, term)
        if effect.dry:
            # Kept apart with the level at which the body sticks: the integrators decide between sliding and sticking. The term in the
            # balance is what a reader sees.
            target = self._balance(placed.site, effect)
            moves, friction = placed.place.states.get("velocity") or target.state, effect.dry(*names)
            sliding, static = ca.SX(friction.sliding), ca.SX(friction.static)
            if moves in self.states:
                state = self.states.index(moves)
                self.dry.append(DryFrictionTerm(effect.name, placed.site, state, sliding, static))
                velocity = self.x[state]
            else:  # an input moves as it is told, and nothing holds it
                velocity = seen.velocity
            self.balances[placed.site] = target.with_term(effect.name, -friction.sliding * ca.sign(velocity))
        model_names = placed.model_names
        for balance in effect.balances(*names) if effect.balances else ():
            name = f"{effect.name}.{balance.name}"
            words = {**self.units, **_unit_words(placed.place.units)}
            unit = _fill_unit(balance.unit, words, effect, self.statement.name)
            state_name = model_names.get(balance.state, balance.state)
            self.balances[name] = Balance(name, unit, balance.storage, state_name, **balance.terms)
        if effect.update:
            self.updates += collect_updates(effect.name, effect.update(*names), model_names, self.states)
        if effect.delay:
            inputs = [i.name for i in self.statement.inputs]
            self.delays.append(build_delay(effect.name, effect.delay(*names), placed.site, inputs, self.delay_ranges))
        if effect.on_output:
            outputs[placed.site] = effect.on_output(outputs[placed.site], *names)

    def _balance_sums(self, placed: PlacedEffect, u: NamedValues) -> dict[str, ca.SX]:
        """``x.transmitted``: the sizes of the terms at a balance that do not depend on its velocity; ``x.driven``: those of inputs."""
        balance = self.balances.get(placed.site)
        if balance is None:
            return {}
        terms = [ca.SX(t) for name, t in balance.terms.items() if name in self.plant_terms[placed.site]]
        velocity = self.plant_symbols[balance.state]
        if stores_nothing(
            balance
        ):  # what is solved for is no load, and an inertia that depends on the velocity of others is one
            terms = [t for t in terms if not ca.depends_on(t, velocity)]
        inputs = ca.SX(ca.vertcat(*[ca.SX(u[i.name]) for i in self.statement.inputs]))
        symbols = ca.vertcat(*ca.symvar(inputs))
        # What a bearing carries: friction under load grows with these, and not with losses that depend on the velocity.
        sizes = [ca.fabs(t) for t in terms if not ca.depends_on(t, velocity)]
        driven = [t for t in terms if symbols.numel() and ca.depends_on(t, symbols)]
        return {"transmitted": sum(sizes, ca.SX(0)), "driven": sum(driven, ca.SX(0))}

    def _balance(self, site: str, effect: EffectEquations) -> Balance:
        if site not in self.balances:
            raise MissingNameError(
                f"effect {effect.name!r} adds to a balance {site!r}; {nearest(site, self.balances)}", "site", site
            )
        return self.balances[site]


def _transform_signals(
    statement: Statement, effects: Sequence[PlacedEffect], x: NamedValues, u: NamedValues, p: NamedValues
) -> tuple[NamedValues, NamedValues, NamedValues, dict[str, tuple[NamedValues, NamedValues]]]:
    """States, inputs and parameters as the balances see them, and for effects that change them what came to each of these."""
    for placed in effects:  # parameters where they are used
        if placed.effect.on_parameter:
            used = placed.effect.on_parameter(
                placed.sees_states(x, u), placed.sees_inputs(u), placed.sees_parameters(p)
            )
            p = p.replaced({_name_of(name, statement.parameters): value for name, value in used.items()})
    before: dict[str, tuple[NamedValues, NamedValues]] = {}
    for placed in effects:  # inputs on their way in
        if placed.effect.on_input:
            before[placed.effect.name] = x, u
            names = placed.sees_states(x, u), placed.sees_inputs(u), placed.sees_parameters(p)
            value = placed.effect.on_input(u[placed.site], *names)
            u = u.replaced({placed.site: value})
    for placed in effects:  # states as the model sees them
        if placed.effect.on_state:
            seen = before[placed.effect.name] = x, before.get(placed.effect.name, (x, u))[1]
            names = placed.sees_states(x, u), placed.sees_inputs(seen[1]), placed.sees_parameters(p)
            used = placed.effect.on_state(*names)
            x = x.replaced({_name_of(name, statement.states): value for name, value in used.items()})
    return x, u, p, before


def _in_stated_time(balance: Balance, units: Mapping[str, str]) -> Balance:
    """The balance in seconds, whatever its unit counts in: in g/h, an hour's worth of seconds is stored of a state in g."""
    if stores_nothing(balance):
        return balance
    try:
        stored = infer_unit(balance.storage, units) or ONE
        rate, stated = stored * parse_unit(units[balance.state]) / SECOND, parse_unit(balance.unit)
    except (ModelError, UnitMismatchError, KeyError):  # what is wrong with it the checks of names and units say
        return balance
    if rate.dimensions != stated.dimensions or rate == stated:
        return balance
    # c d(state)/dt = terms in the stated unit, with c of it in one of storage * state / s
    return balance.with_storage(rate.factor / stated.factor)


def _plant_symbols(statement: Statement) -> tuple[NamedValues, NamedValues, NamedValues]:
    return (
        named_symbols("state", statement.states),
        named_symbols("input", statement.inputs),
        named_symbols("parameter", statement.parameters),
    )


def _start(
    statement: Statement,
    dynamic: Sequence[State],
    effects: Sequence[PlacedEffect],
    p: NamedValues,
    outputs: Mapping[str, ca.SX],
    x: ca.SX,
    u: ca.SX,
) -> ca.SX:
    """The state at rest: that of the plant, and those of effects, which may speak of the reading and the displacement there at rest."""
    plant = _start_values(dynamic, p)
    # At rest the inputs are zero, and the reading is that of the plant there.
    at_rest = ca.vertcat(plant, ca.SX.zeros(u.numel()))
    # Of one symbol CasADi takes the first none as a row.
    symbols = ca.vertcat(*[x[k] for k in range(plant.numel())], u)
    numbers = {s.name: k for k, s in enumerate(dynamic)}
    starts = [plant]
    for placed in effects:
        reading = outputs[placed.site if placed.site in outputs else statement.outputs[0].name]
        known = {"sensor": ca.substitute(ca.SX(reading), symbols, at_rest)}
        by_role = next((s.name for s in dynamic if s.role == "displacement"), "")
        displacement = placed.place.states.get("displacement", by_role)
        if displacement in numbers:
            known["displacement"] = plant[numbers[displacement]]
        elif displacement in [i.name for i in statement.inputs]:
            known["displacement"] = ca.SX(0)
        if placed.place.states.get("temperature") in numbers:
            known["temperature"] = plant[numbers[placed.place.states["temperature"]]]
        starts.append(_start_values(placed.states, placed.sees_parameters(p.replaced(known))))
    return ca.vertcat(*starts)


def _start_values(states: Sequence[State], p: NamedValues) -> ca.SX:
    return ca.SX(ca.vertcat(*[ca.SX(s.start(p) if callable(s.start) else s.start) for s in states]))


def _name_of(name: str, items: Sequence[ParameterSymbol] | Sequence[State]) -> str:
    """The name of the item that ``name`` is the name or the role of."""
    return next((q.name for q in items if name in (q.name, q.role)), name)


def _units_by_word(statement: Statement, balances: Iterable[Balance]) -> dict[str, str]:
    """What the words in the units of an effect stand for: roles, names, balances, ``sensor`` and ``input``."""
    items: tuple[Item, ...] = (*statement.states, *statement.inputs, *statement.parameters)
    words = {b.name: b.unit for b in balances} | {item.name: item.unit for item in items}
    # An effect asks for a role; a balance that happens to be called "pressure" does not take its place.
    words |= {item.role: item.unit for item in reversed(items) if item.role}
    words["sensor"] = statement.outputs[0].unit
    if statement.inputs:
        words["input"] = statement.inputs[0].unit
    return _unit_words(words)


def _unit_words(units: Mapping[str, str]) -> dict[str, str]:
    return {word: f"({unit or '1'})" for word, unit in units.items()}


def _fill_unit(unit: str, words: Mapping[str, str], effect: EffectEquations, model: str) -> str:
    try:
        return format_unit(unit.format_map(words))
    except KeyError as missing:
        word = missing.args[0]
        raise MissingNameError(
            f"effect {effect.name!r} needs a {word}, which model {model!r} does not have; {nearest(word, words)}",
            "unit",
            word,
        ) from None
    except ModelError as error:
        raise ModelError(f"effect {effect.name!r}: {error}") from None


def _order_balances(
    model: str, states: Sequence[State], balances: Mapping[str, Balance], updated: Mapping[str, str]
) -> tuple[Balance, ...]:
    """The balances in the order of the states; a state that an effect sets after each step has none."""
    by_state: dict[str, Balance] = {}
    for b in balances.values():
        if b.state in by_state:
            raise ModelError(
                f"model {model!r}: balances {by_state[b.state].name!r} and {b.name!r} both give the rate of {b.state!r};"
                " each state needs one"
            )
        by_state[b.state] = b
    both = [n for n in updated if n in by_state]
    if both:
        raise ModelError(
            f"effect {updated[both[0]]!r} sets the state {both[0]!r} after each step, but balance {by_state[both[0]].name!r} gives"
            " its rate; leave out one of the two"
        )
    names = [s.name for s in states if s.name not in updated]
    missing = [n for n in names if n not in by_state]
    unknown = [n for n in by_state if n not in names]
    if missing or unknown:
        problems = [f"no balance gives the rate of {n!r}" for n in missing] + [
            f"balance {by_state[n].name!r} names an unknown state {n!r}" for n in unknown
        ]
        raise ModelError(
            f"model {model!r}: {'; '.join(problems)}; every state needs exactly one balance (states: {', '.join(names)})"
        )
    return tuple(by_state[n] for n in names)


def _sums(ordered: Sequence[Balance], dry: Sequence[DryFrictionTerm], direction: ca.SX) -> ca.SX:
    """Sum of the terms of each balance, dry friction written with the direction of motion as a symbol."""
    rows = []
    for balance in ordered:
        frictions = {d.effect: -d.sliding * direction[k] for k, d in enumerate(dry) if d.balance == balance.name}
        # -F_sliding * direction in place of -F_sliding * sign(v): a symbol has a derivative, sign(v) has none at v = 0.
        rows.append(sum((frictions.get(name, ca.SX(term)) for name, term in balance.terms.items()), ca.SX(0)))
    return ca.vertcat(*rows)


def hold_inside_bounds(rhs: ca.SX, x: ca.SX, states: Sequence[State]) -> ca.SX:
    """The right-hand side, or a part of it, with every bounded state held inside its bounds."""
    for k, state in enumerate(states):
        low, high = state.bounds
        if low > -ca.inf:
            rhs = ca.substitute(rhs, x[k], ca.fmax(x[k], low + STATE_BOUND_MARGIN))
        if high < ca.inf:
            rhs = ca.substitute(rhs, x[k], ca.fmin(x[k], high - STATE_BOUND_MARGIN))
    return rhs


# The equations of models that were written out before: a search changes numbers a thousand times and equations rarely.


def build_checked_system(statement: Statement, asked: WeakSet[Callable[..., Any]] | None = None) -> System:
    """Write out the equations of a model and check all of it that no value of a parameter can change.

    ``asked`` holds the functions of effects that stated the same when they were asked twice, at whatever site: they are asked once now.

    Raises ModelError for names that clash or are unknown and for balances or outputs that are no expressions, UnitError for a term whose
    unit is not its balance's.
    """
    plant = read_plant(statement)
    written, statement = plant.written, statement._replace(inputs=plant.inputs, parameters=plant.parameters)
    system = build_system(statement)
    unit_check.check_units(statement, system)
    functions = [function for effect in statement.effects for function in effect if callable(function)]
    if not functions or asked is None or not all(function in asked for function in functions):
        refuse_changing(statement, written)
        if statement.effects and str(build_system(statement).rhs) != str(system.rhs):
            raise ModelError(_say_changing(statement, ", ".join(e.name for e in statement.effects), "", ""))
    if asked is not None:
        asked.update(functions)
    return replace(system, written=written)


def refuse_changing(statement: Statement, written: Mapping[str, str]) -> None:
    """Refuse functions of a plant that state something else than what was ``written`` before. Raises ModelError with both lines."""
    now = _write_plant(statement)
    for place in {**written, **now}:
        before, after = written.get(place, "nothing"), now.get(place, "nothing")
        if before != after:
            raise ModelError(_say_changing(statement, place, before, after))


def _say_changing(statement: Statement, place: str, before: str, after: str) -> str:
    lines = f" ({before}, then {after})" if before else ""
    return (
        f"model {statement.title!r}: {place} states something else each time it is asked{lines}; a model is one set of equations: take"
        " random numbers, counters, clocks and files out of its functions, and give what varies as an input or a parameter"
    )


def _write_plant(statement: Statement) -> dict[str, str]:
    """Every line that the functions of a plant state, by its place."""
    x, u, p = named = _plant_symbols(statement)
    lines: dict[str, str] = {}
    for b in statement.balances(*named):
        lines |= {f"balance {b.name!r}, term {term!r}": str(value) for term, value in b.terms.items()}
        lines[f"balance {b.name!r}, storage"] = str(b.storage)
    lines |= {f"output {o.name!r}": str(o.equation(x, u, p)) for o in statement.outputs if o.equation}
    lines |= {f"start of {s.name!r}": str(s.start(p)) for s in statement.states if callable(s.start)}
    return lines | {f"noise of {s.name!r}": str(s.noise(p)) for s in statement.states if callable(s.noise)}


class SystemCache:
    """Systems by the `Statement` that determines them, the most recently used ones.

    Parameters
    ----------
    size
        How many are kept: more than a search over pairs of effects of the catalogue has in use at a time.
    """

    def __init__(self, size: int = 1024) -> None:
        self._build = lru_cache(maxsize=size)(partial(build_checked_system, asked=WeakSet()))

    def system(self, statement: Statement) -> System:
        """The checked equations of a statement; one that cannot be hashed is written out every time.

        Raises ModelError and UnitError as `build_checked_system` does.
        """
        try:
            hash(statement)
        except TypeError:
            return build_checked_system(statement)
        return self._build(statement)

    def clear(self) -> None:
        """Forget every system."""
        self._build.cache_clear()

    def __len__(self) -> int:
        return self._build.cache_info().currsize


SYSTEMS = SystemCache()
