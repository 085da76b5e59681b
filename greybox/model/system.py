"""From a stated model to CasADi expressions: balances with every effect applied, right-hand side, outputs."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from greybox.errors import ModelError, nearest
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.effect_hooks import InputDelay, StateUpdate, build_delay, collect_updates, find_relaxing_states
from greybox.model.process_noise import build_diffusion
from greybox.model.signals import NamedValues, Output, Parameter, Quantity, State
from greybox.model.ties import apply_ties
from greybox.numerics import STATE_BOUND_MARGIN
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.model.model import Model

KEPT = 64  # extended systems, for the next time: more than the catalogue has effects


@dataclass(frozen=True)
class BoundEffect:
    """An effect as it sits in one model: names made unique, units resolved, site found."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    states: tuple[State, ...]
    site: str

    @property
    def own(self) -> dict[str, str]:
        """The effect's own names -> the model's names."""
        inner: tuple[Quantity, ...] = (*self.effect.parameters, *self.effect.states)
        outer: tuple[Quantity, ...] = (*self.parameters, *self.states)
        return {own.name: there.name for own, there in zip(inner, outer, strict=True)}

    def within(self, names: NamedValues, of: Sequence[Parameter] | Sequence[State]) -> NamedValues:
        """``names`` as the effect's functions see them: its own names come first."""
        return names.replaced({inner.name: names[self.own[inner.name]] for inner in of})


@dataclass(frozen=True)
class DryFrictionTerm:
    """Dry friction in a system: it acts against the rate of state number ``state``; magnitudes are of the rate's unit times storage."""

    effect: str
    balance: str
    state: int
    sliding: ca.SX
    static: ca.SX


@dataclass(frozen=True, eq=False)
class System:
    """A model as expressions: ``dx/dt = rhs(x, u, p)``, ``y = outputs(x, u, p)``.

    ``x`` (nx,), ``u`` (nu,), ``p`` (np,) are columns of symbols in the order of the name tuples. ``start`` (nx,) is the state at
    rest, a function of ``p``. In ``rhs`` dry friction is written with ``direction`` (one symbol for each entry of ``dry``), the
    sign of motion that the integrator decides; ``explicit`` is the same with ``sign(v)`` in its place.

    ``balances`` are in the order of the states that have one; a state in ``updates`` has none (its rate is zero). ``relaxing`` are
    the numbers of the states whose rate is linear in themselves. With ``delays`` the symbol ``u`` is the input as it arrives.
    ``diffusion`` (nx,) is the intensity of each state's process noise, a function of ``p``; no other equation contains it.
    """

    x: ca.SX
    u: ca.SX
    p: ca.SX
    direction: ca.SX
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    balances: tuple[Balance, ...]
    storages: ca.SX
    rhs: ca.SX
    outputs: ca.SX
    start: ca.SX
    diffusion: ca.SX
    dry: tuple[DryFrictionTerm, ...]
    updates: tuple[StateUpdate, ...] = ()
    delays: tuple[InputDelay, ...] = ()
    relaxing: tuple[int, ...] = ()
    # What was added last to a model of these equations, and the equations with it.
    extended: deque[tuple[Effect, System]] = field(default_factory=partial(deque, maxlen=KEPT), repr=False)

    @cached_property
    def explicit(self) -> ca.SX:
        """The right-hand side with dry friction as ``-level * sign(velocity)``."""
        if not self.dry:
            return self.rhs
        signs = ca.vertcat(*[ca.sign(self.x[d.state]) for d in self.dry])
        return ca.substitute(self.rhs, self.direction, signs)

    @property
    def free_run_expressions(self) -> list[ca.SX]:
        """Every expression of the free run: all but the process noise."""
        parts = [self.rhs, self.outputs, self.start, *(d.static for d in self.dry)]
        return parts + [update.value for update in self.updates] + [delay.seconds for delay in self.delays]

    @cached_property
    def linear(self) -> bool:
        """Whether state and output equations are affine in ``x`` and ``u`` (``dx/dt = A x + B u + c``), with no state that is set."""
        xu = ca.vertcat(self.x, self.u)
        jacobian = ca.jacobian(ca.vertcat(self.rhs, self.outputs), xu)
        return not self.dry and not self.updates and not ca.depends_on(jacobian, xu)

    @cached_property
    def jacobian(self) -> ca.Function:
        """``(x, u, p) -> d rhs / d x`` (nx, nx), dry friction left out (it has no slope)."""
        smooth = ca.substitute(self.rhs, self.direction, ca.SX.zeros(len(self.dry)))
        return ca.Function("jacobian", [self.x, self.u, self.p], [ca.jacobian(smooth, self.x)])

    @cached_property
    def rhs_function(self) -> ca.Function:
        """``(x, u, p) -> dx/dt`` with dry friction explicit."""
        return ca.Function("rhs", [self.x, self.u, self.p], [self.explicit])

    @cached_property
    def output_function(self) -> ca.Function:
        """``(x, u, p) -> y``."""
        return ca.Function("outputs", [self.x, self.u, self.p], [self.outputs])

    @cached_property
    def constant_start(self) -> np.ndarray | None:
        """The state at rest (nx,) where it is the same whatever the parameters are, else None."""
        if ca.depends_on(self.start, self.p):
            return None
        return np.asarray(self.start_function(np.ones(self.p.numel()))[0]).ravel()

    @cached_property
    def start_function(self) -> ca.Function:
        """``p -> (x0, d x0 / d p)``: the state at rest and its sensitivity."""
        return ca.Function("start", [self.p], [self.start, ca.jacobian(self.start, self.p)])


def bind_effects(model: Model) -> tuple[BoundEffect, ...]:
    """Each effect of ``model`` with unique names, resolved units and its site; refuses what does not fit the model."""
    taken = {s.name for s in inner_signals(model)}
    base = _base_balances(model)
    units = _unit_words(model, base)
    sites = [*(b.name for b in base), *(i.name for i in model.inputs), *(o.name for o in model.outputs)]
    places = {"sensor": model.outputs[0].name} | {i.role: i.name for i in model.inputs if i.role}
    if model.inputs:
        places = {"input": model.inputs[0].name} | places
    bound: list[BoundEffect] = []
    for effect in model.effects:
        if any(effect.name == other.effect.name for other in bound):
            raise ModelError(
                f"model {model.name!r} already has the effect {effect.name!r}; an effect can be added once"
            )
        site = places.get(effect.site, effect.site)
        if effect.site and site not in sites:
            raise ModelError(
                f"effect {effect.name!r} acts at {effect.site!r}, which model {model.name!r} does not have; {nearest(site, sites)}"
            )

        def resolved(item: Any, effect: Effect = effect, used: frozenset[str] = frozenset(taken)) -> Any:
            name = f"{effect.name}.{item.name}" if item.name in used else item.name
            return replace(item, name=name, unit=_fill(item.unit, units, effect, model.name))

        parameters, states = tuple(map(resolved, effect.parameters)), tuple(map(resolved, effect.states))
        taken |= {item.name for item in (*parameters, *states)}
        bound.append(BoundEffect(effect, parameters, states, site))
    return tuple(bound)


def build_system(model: Model) -> System:
    """Write out ``model``, effects applied in the order in which they were added."""
    effects = model.bound_effects
    states = (*model.states, *(s for b in effects for s in b.states))
    parameters = model.all_parameters
    x, u, p = _symbols("state", states), _symbols("input", model.inputs), _symbols("parameter", model.stated_parameters)
    raw_x, raw_u, raw_p = (
        ca.vertcat(*[n[s.name] for s in group]) for n, group in ((x, states), (u, model.inputs), (p, parameters))
    )

    p = apply_ties(model.ties, p)
    diffusion = build_diffusion(model.states, effects, p)
    x, u, p, coming = _transformed(model, x, u, p)
    balances = {b.name: b for b in model.balances(x, u, p)}
    y = {o.name: _output(o, x, u, p) for o in model.outputs}
    start = _start(model, p, y[model.outputs[0].name], raw_x, raw_u)
    words = _unit_words(model, balances.values())
    dry: list[DryFrictionTerm] = []
    updates: list[StateUpdate] = []
    delays: list[InputDelay] = []
    order = [s.name for s in states]
    for b in effects:
        seen, entering = coming.get(b.effect.name, (x, u))
        seen = seen.replaced({"sensor": y[b.site if b.site in y else model.outputs[0].name]})
        names = b.within(seen, b.effect.states), entering, b.within(p, b.effect.parameters)
        for site, changed in (b.effect.on_term(*names) if b.effect.on_term else {}).items():
            balances[site] = _at(balances, site, b.effect).with_terms_replaced(changed)
        for site, factor in (b.effect.on_storage(*names) if b.effect.on_storage else {}).items():
            balances[site] = _at(balances, site, b.effect).with_storage(factor)
        if b.effect.terms:
            terms = b.effect.terms(*names)
            for site, term in (terms if isinstance(terms, Mapping) else {b.site: terms}).items():
                balances[site] = _at(balances, site, b.effect).with_term(b.effect.name, term)
        if b.effect.dry:
            target = _at(balances, b.site, b.effect)
            friction = b.effect.dry(*names)
            dry.append(
                DryFrictionTerm(
                    b.effect.name, b.site, order.index(target.state), ca.SX(friction.sliding), ca.SX(friction.static)
                )
            )
            balances[b.site] = target.with_term(
                b.effect.name, -friction.sliding * ca.sign(raw_x[order.index(target.state)])
            )
        if b.effect.balances:
            for own in b.effect.balances(*names):
                renamed = Balance(
                    f"{b.effect.name}.{own.name}",
                    _fill(own.unit, words, b.effect, model.name),
                    own.storage,
                    b.own.get(own.state, own.state),
                    **own.terms,
                )
                balances[renamed.name] = renamed
        if b.effect.update:
            updates += collect_updates(b.effect.name, b.effect.update(*names), b.own, order)
        if b.effect.delay:
            delays.append(
                build_delay(b.effect.name, b.effect.delay(*names), b.site, [i.name for i in model.inputs], parameters)
            )
        if b.effect.on_output:
            y[b.site] = b.effect.on_output(y[b.site], *names)

    ordered = _one_balance_each(model.name, states, balances, {order[s.state]: s.effect for s in updates})
    direction = ca.SX.sym("direction", len(dry))
    storages, sums = ca.SX.ones(len(order)), ca.SX.zeros(len(order))
    rows = [order.index(b.state) for b in ordered]
    storages[rows] = ca.vertcat(*[ca.SX(b.storage) for b in ordered])
    sums[rows] = _sums(ordered, dry, direction)
    rhs = _guarded(sums / storages, raw_x, states)
    return System(
        x=raw_x, u=raw_u, p=raw_p, direction=direction,
        state_names=tuple(order), input_names=tuple(i.name for i in model.inputs),
        output_names=tuple(y), parameter_names=tuple(q.name for q in parameters),
        balances=ordered, storages=storages, rhs=rhs, outputs=ca.vertcat(*y.values()), start=start, diffusion=diffusion, dry=tuple(dry),
        updates=tuple(updates), delays=tuple(delays), relaxing=find_relaxing_states(model.name, states, rhs, raw_x),
    )  # fmt: skip


def _transformed(
    model: Model, x: NamedValues, u: NamedValues, p: NamedValues
) -> tuple[NamedValues, NamedValues, NamedValues, dict[str, tuple[NamedValues, NamedValues]]]:
    """States, inputs and parameters as the balances see them, and for effects that change them what came to each of these."""
    effects = model.bound_effects
    for b in effects:  # parameters where they are used
        if b.effect.on_parameter:
            used = b.effect.on_parameter(b.within(x, b.effect.states), u, b.within(p, b.effect.parameters))
            p = p.replaced({_canonical(name, model.parameters): value for name, value in used.items()})
    coming: dict[
        str, tuple[NamedValues, NamedValues]
    ] = {}  # states and inputs as they come to an effect that changes them
    for b in effects:  # inputs on their way in
        if b.effect.on_input:
            coming[b.effect.name] = x, u
            value = b.effect.on_input(u[b.site], b.within(x, b.effect.states), u, b.within(p, b.effect.parameters))
            u = u.replaced({b.site: value})
    for b in effects:  # states as the model sees them
        if b.effect.on_state:
            before = coming[b.effect.name] = x, coming.get(b.effect.name, (x, u))[1]
            used = b.effect.on_state(b.within(x, b.effect.states), before[1], b.within(p, b.effect.parameters))
            x = x.replaced({_canonical(name, model.states): value for name, value in used.items()})
    return x, u, p, coming


def inner_signals(model: Model) -> tuple[Quantity, ...]:
    """States, inputs and parameters of the plant: what its equations speak of."""
    return (*model.states, *model.inputs, *model.parameters)


def _symbols(kind: str, items: Sequence[Quantity]) -> NamedValues:
    return NamedValues(kind, {i.name: ca.SX.sym(i.name) for i in items}, {i.role: i.name for i in items if i.role})


def _base_balances(model: Model) -> list[Balance]:
    groups = ("state", model.states), ("input", model.inputs), ("parameter", model.parameters)
    return model.balances(*(_symbols(kind, items) for kind, items in groups))


def _start(model: Model, p: NamedValues, reading: ca.SX, x: ca.SX, u: ca.SX) -> ca.SX:
    """The state at rest: that of the plant, and those of effects, which may speak of the main output ``reading`` at rest."""
    plant = _started(model.states, p)
    at_rest = ca.substitute(
        ca.SX(reading), ca.vertcat(x[: plant.numel()], u), ca.vertcat(plant, ca.SX.zeros(u.numel()))
    )
    known = p.replaced({"sensor": at_rest})
    own = [_started(b.states, b.within(known, b.effect.parameters)) for b in model.bound_effects]
    return ca.vertcat(plant, *own)


def _started(states: Sequence[State], p: NamedValues) -> ca.SX:
    return ca.vertcat(*[ca.SX(s.start(p) if callable(s.start) else s.start) for s in states])


def _canonical(name: str, items: Sequence[Parameter] | Sequence[State]) -> str:
    return next((q.name for q in items if name in (q.name, q.role)), name)


def _unit_words(model: Model, balances: Iterable[Balance]) -> dict[str, str]:
    words = {item.role: item.unit for item in inner_signals(model) if item.role}
    words |= {item.name: item.unit for item in inner_signals(model)}
    words |= {b.name: b.unit for b in balances}
    words["sensor"] = model.outputs[0].unit
    if model.inputs:
        words["input"] = model.inputs[0].unit
    return {word: f"({unit or '1'})" for word, unit in words.items()}


def _fill(unit: str, words: Mapping[str, str], effect: Effect, model: str) -> str:
    try:
        return format_unit(unit.format_map(words))
    except KeyError as missing:
        raise ModelError(
            f"effect {effect.name!r} needs a {missing.args[0]}, which model {model!r} does not have; {nearest(missing.args[0], words)}"
        ) from None
    except ModelError as error:
        raise ModelError(f"effect {effect.name!r}: {error}") from None


def _at(balances: Mapping[str, Balance], site: str, effect: Effect) -> Balance:
    if site not in balances:
        raise ModelError(f"effect {effect.name!r} adds to a balance {site!r}; {nearest(site, balances)}")
    return balances[site]


def _output(output: Output, x: NamedValues, u: NamedValues, p: NamedValues) -> ca.SX:
    return ca.SX(output.equation(x, u, p) if output.equation else x[output.name])


def _one_balance_each(
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
    strange = [n for n in by_state if n not in names]
    if missing or strange:
        found = [f"no balance gives the rate of {n!r}" for n in missing] + [
            f"balance {by_state[n].name!r} names an unknown state {n!r}" for n in strange
        ]
        raise ModelError(
            f"model {model!r}: {'; '.join(found)}; every state needs exactly one balance (states: {', '.join(names)})"
        )
    return tuple(by_state[n] for n in names)


def _sums(ordered: Sequence[Balance], dry: Sequence[DryFrictionTerm], direction: ca.SX) -> ca.SX:
    """Sum of the terms of each balance, dry friction written with the direction of motion as a symbol."""
    rows = []
    for balance in ordered:
        frictions = {d.effect: -d.sliding * direction[k] for k, d in enumerate(dry) if d.balance == balance.name}
        rows.append(sum((frictions.get(name, ca.SX(term)) for name, term in balance.terms.items()), ca.SX(0)))
    return ca.vertcat(*rows)


def _guarded(rhs: ca.SX, x: ca.SX, states: Sequence[State]) -> ca.SX:
    """The right-hand side with every bounded state held inside its bounds."""
    for k, state in enumerate(states):
        low, high = state.bounds
        if low > -ca.inf:
            rhs = ca.substitute(rhs, x[k], ca.fmax(x[k], low + STATE_BOUND_MARGIN))
        if high < ca.inf:
            rhs = ca.substitute(rhs, x[k], ca.fmin(x[k], high - STATE_BOUND_MARGIN))
    return rhs
