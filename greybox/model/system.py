"""A model as CasADi expressions, and what determines them.

A `Statement` holds everything that the equations of a model depend on, a `System` the equations themselves. Two models with the same
statement share one system, whatever the values, bounds and priors of their parameters are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.base import ModelError, format_unit, nearest
from greybox.model.balance import AlgebraicState, Balance, eliminate
from greybox.model.effect import Effect, InputDelay, StateUpdate
from greybox.model.expressions.graph import as_scalar, count_operands, nodes
from greybox.model.expressions.operations import FLAT, OPERATIONS
from greybox.model.signals import Expression, Input, NamedValues, Output, Parameter, State, names_by_role

if TYPE_CHECKING:
    from greybox.model.sites import Site
    from greybox.model.ties import Tie


class ParameterSymbol(NamedTuple):
    """What the equations know of a parameter."""

    name: str
    unit: str
    role: str


Item = State | Input | Output | ParameterSymbol


class EffectEquations(NamedTuple):
    """What the equations know of an effect: its functions, its states and its parameters, without values. See `Effect`."""

    name: str
    site: str
    parameters: tuple[ParameterSymbol, ...]
    states: tuple[State, ...]
    terms: Callable[..., Any] | None
    dry: Callable[..., Any] | None
    balances: Callable[..., Any] | None
    update: Callable[..., Any] | None
    delay: Callable[..., Any] | None
    on_input: Callable[..., Any] | None
    on_output: Callable[..., Any] | None
    on_parameter: Callable[..., Any] | None
    on_state: Callable[..., Any] | None
    on_term: Callable[..., Any] | None
    on_storage: Callable[..., Any] | None

    @classmethod
    def of(cls, effect: Effect) -> EffectEquations:
        """The equations of ``effect``."""
        e = effect
        return cls(
            e.name,
            e.site,
            parameter_symbols(e.parameters),
            tuple(e.states),
            e.terms,
            e.dry,
            e.balances,
            e.update,
            e.delay,
            e.on_input,
            e.on_output,
            e.on_parameter,
            e.on_state,
            e.on_term,
            e.on_storage,
        )


class Statement(NamedTuple):
    """Everything that determines the equations of a model.

    ``delay_ranges`` are the values between which each parameter may lie, those of the plant and then those of its effects: how long the
    delay of an input can become is part of the equations. Without a delay they are left out.
    """

    name: str
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    parameters: tuple[ParameterSymbol, ...]
    balances: Callable[[NamedValues, NamedValues, NamedValues], list[Balance]]
    effects: tuple[EffectEquations, ...] = ()
    ties: tuple[Tie, ...] = ()
    delay_ranges: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def of(
        cls,
        name: str,
        states: Iterable[State],
        inputs: Iterable[Input],
        outputs: Iterable[Output],
        parameters: Sequence[Parameter],
        balances: Callable[[NamedValues, NamedValues, NamedValues], list[Balance]],
        effects: Sequence[Effect],
        ties: Iterable[Tie],
    ) -> Statement:
        """The statement of a model with these fields."""
        ranges: tuple[tuple[float, ...], ...] = ()
        if any(effect.delay for effect in effects):
            every = (*parameters, *(q for effect in effects for q in effect.parameters))
            ranges = tuple((q.value,) if q.fixed else tuple(q.bounds) for q in every)
        return cls(
            name,
            tuple(states),
            tuple(inputs),
            tuple(outputs),
            parameter_symbols(parameters),
            balances,
            tuple(map(EffectEquations.of, effects)),
            tuple(ties),
            ranges,
        )

    @property
    def title(self) -> str:
        """Name with effects: ``micro_actuator + coulomb_friction``."""
        return " + ".join([self.name, *(effect.name for effect in self.effects)])


@dataclass(frozen=True)
class PlacedEffect:
    """The equations of an effect as they stand in one model: names made unique, units resolved, site found."""

    effect: EffectEquations
    parameters: tuple[ParameterSymbol, ...]
    states: tuple[State, ...]
    place: Site

    @property
    def site(self) -> str:
        """The balance, input or output at which it acts."""
        return self.place.name

    @property
    def model_names(self) -> dict[str, str]:
        """The effect's own names -> the model's names."""
        inner: tuple[Item, ...] = (*self.effect.parameters, *self.effect.states)
        outer: tuple[Item, ...] = (*self.parameters, *self.states)
        return {own_item.name: placed.name for own_item, placed in zip(inner, outer, strict=True)}

    def sees_states(self, x: NamedValues, u: NamedValues) -> NamedValues:
        """The states as the effect's functions see them: its own names come first, and roles are those at its site."""
        names = self.model_names
        effect_states = {s.name: x[names[s.name]] for s in self.effect.states}
        # The motion at a relation may be an input.
        given = {role: u[name] for role, name in self.place.states.items() if name and name not in x}
        return x.seen_from(
            {**given, **effect_states}, {r: name for r, name in self.place.states.items() if r not in given}
        )

    def sees_inputs(self, u: NamedValues) -> NamedValues:
        """The inputs as the effect's functions see them: ``u.input`` and the like are the one at its site."""
        return u.seen_from({}, self.place.inputs)

    def sees_parameters(self, p: NamedValues) -> NamedValues:
        """The parameters as the effect's functions see them: its own names come first."""
        names = self.model_names
        return p.seen_from({q.name: p[names[q.name]] for q in self.effect.parameters}, {})


@dataclass(frozen=True)
class BoundEffect:
    """An effect as it sits in one model: ``parameters`` with the names and units that they have there, and their values."""

    effect: Effect
    parameters: tuple[Parameter, ...]
    placed: PlacedEffect

    @property
    def states(self) -> tuple[State, ...]:
        """The effect's states with the names and units that they have in the model."""
        return self.placed.states

    @property
    def site(self) -> str:
        """The balance, input or output at which it acts."""
        return self.placed.site

    @property
    def model_names(self) -> dict[str, str]:
        """The effect's own names -> the model's names."""
        return self.placed.model_names


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

    ``x`` (nx,), ``u`` (nu,), ``p`` (np,) are columns of symbols in the order of ``states``, the inputs and ``parameter_names``. ``start``
    (nx,) is the state at rest, a function of ``p``. In ``rhs`` dry friction is written with ``direction`` (one symbol for each entry of
    ``dry``), the sign of motion that the integrator decides; ``explicit`` is the same with ``sign(v)`` in its place.

    ``states`` are those of the plant and of its effects. ``balances`` are in the order of the states that have one; a state in
    ``updates`` has none (its rate is zero). ``relaxing`` are the numbers of the states whose rate is linear in themselves. With
    ``delays`` the symbol ``u`` is the input as it arrives. ``diffusion`` (nx,) is the intensity of each state's process noise, a function
    of ``p``; no other equation contains it.

    ``algebraic`` are states whose balances store nothing: every equation holds their values in their place. ``stated_balances`` and
    ``stated_outputs`` are written with the symbols of these states, for people and for the check of units. ``written`` is what each
    function of the plant stated, by its place.
    """

    x: ca.SX
    u: ca.SX
    p: ca.SX
    direction: ca.SX
    states: tuple[State, ...]
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
    effects: tuple[PlacedEffect, ...] = ()
    algebraic: tuple[AlgebraicState, ...] = ()
    stated_balances: tuple[Balance, ...] = ()
    stated_outputs: ca.SX | None = None
    written: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def relations(self) -> ca.Function:
        """``(x, u, p) -> (residual, largest term)`` of each balance that stores nothing."""
        # Each sum beside its largest term: how well a relation holds is judged by what cancels in it.
        rows = [eliminate(ca.vertcat(*map(ca.SX, a.balance.terms.values())), self.algebraic) for a in self.algebraic]
        sums = ca.vertcat(*[ca.sum1(row) for row in rows])
        largest = ca.vertcat(*[ca.mmax(ca.fabs(row)) for row in rows])
        return ca.Function("relations", [self.x, self.u, self.p], [sums, largest])

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in the order of ``x``."""
        return tuple(state.name for state in self.states)

    @cached_property
    def explicit(self) -> ca.SX:
        """The right-hand side with dry friction as ``-level * sign(velocity)``."""
        if not self.dry:
            return self.rhs
        # The right-hand side has a symbol for the direction of motion, which integrators set; sliding it is sign(v).
        signs = ca.vertcat(*[ca.sign(self.x[d.state]) for d in self.dry])
        return ca.substitute(self.rhs, self.direction, signs)

    @property
    def free_run_expressions(self) -> list[ca.SX]:
        """Every expression of the free run: all but the process noise."""
        parts = [self.rhs, self.outputs, self.start, *(d.static for d in self.dry)]
        return parts + [update.value for update in self.updates] + [delay.seconds for delay in self.delays]

    @cached_property
    def limits(self) -> tuple[tuple[int, float, float], ...]:
        """Number, low and high limit of every state that has a finite one."""
        bounds = enumerate(s.bounds for s in self.states)
        return tuple((k, low, high) for k, (low, high) in bounds if low > -math.inf or high < math.inf)

    @cached_property
    def linear(self) -> bool:
        """Whether state and output equations are affine in ``x`` and ``u`` (``dx/dt = A x + B u + c``), with no state that is set or stops
        at a limit.
        """
        # Affine: no entry of the Jacobian over (x, u) depends on (x, u).
        xu = ca.vertcat(self.x, self.u)
        equations = ca.vertcat(self.rhs, self.outputs)
        if self.dry or self.updates or self.limits or ca.depends_on(ca.jacobian(equations, xu), xu):
            return False
        # `sign(v)` has no slope: alone it would pass for a constant.
        return not any(
            count_operands(node)
            and node.op() in OPERATIONS
            and OPERATIONS[node.op()].derivative is FLAT
            and ca.depends_on(node, xu)
            for node in nodes([as_scalar(equations[k]) for k in range(equations.numel())])
        )

    @cached_property
    def jacobian(self) -> ca.Function:
        """``(x, u, p) -> d rhs / d x`` (nx, nx), dry friction left out (it has no slope)."""
        smooth = ca.substitute(self.rhs, self.direction, ca.SX.zeros(len(self.dry)))
        return ca.Function("jacobian", [self.x, self.u, self.p], [ca.densify(ca.jacobian(smooth, self.x))])

    @cached_property
    def rhs_function(self) -> ca.Function:
        """``(x, u, p) -> dx/dt`` with dry friction explicit."""
        return ca.Function("rhs", [self.x, self.u, self.p], [self.explicit])

    @cached_property
    def output_function(self) -> ca.Function:
        """``(x, u, p) -> y``."""
        return ca.Function("outputs", [self.x, self.u, self.p], [self.outputs])

    @cached_property
    def diffusion_function(self) -> ca.Function:
        """``p -> intensities`` (nx,) of the process noise."""
        return ca.Function("noise", [self.p], [self.diffusion])

    @cached_property
    def constant_start(self) -> np.ndarray | None:
        """The state at rest (nx,) where it is the same whatever the parameters are, else None."""
        if ca.depends_on(self.start, self.p):
            return None
        # Any values serve: the state at rest depends on none of them.
        return np.asarray(self.start_function(np.ones(self.p.numel()))[0]).ravel()

    @cached_property
    def start_function(self) -> ca.Function:
        """``p -> (x0, d x0 / d p)``: the state at rest and its sensitivity."""
        return ca.Function("start", [self.p], [self.start, ca.jacobian(self.start, self.p)])


def parameter_symbols(parameters: Iterable[Parameter]) -> tuple[ParameterSymbol, ...]:
    """The parameters without their values."""
    return tuple(ParameterSymbol(q.name, q.unit, q.role) for q in parameters)


def named_symbols(kind: str, items: Sequence[Item]) -> NamedValues:
    """A CasADi symbol for each item, by name and by role; a role that several have means the first of them."""
    return NamedValues(kind, {i.name: ca.SX.sym(i.name) for i in items}, names_by_role(items))


def unused_parameters(system: System) -> tuple[str, ...]:
    """Names of the parameters that no equation uses."""
    used = {symbol.name() for symbol in ca.symvar(ca.vertcat(*system.free_run_expressions, system.diffusion))}
    return tuple(name for name in system.parameter_names if name not in used)


# Process noise: how strongly each state is pushed at random, and which intensities make sense.


def build_diffusion(states: Sequence[State], effects: Sequence[PlacedEffect], p: NamedValues) -> ca.SX:
    """Intensity of each state's process noise (nx,), in the state's unit over sqrt(s): those of the plant, then of its effects.

    ``p`` are the parameters by name; a state of an effect sees the effect's own ones first.
    """
    plant = [_intensity(s, p) for s in states]
    of_effects = [_intensity(s, effect.sees_parameters(p)) for effect in effects for s in effect.states]
    return ca.SX(ca.vertcat(*map(ca.SX, (*plant, *of_effects))))


def _intensity(state: State, p: NamedValues) -> Expression:
    if callable(state.noise):
        return state.noise(p)
    if isinstance(state.noise, str) and state.noise not in p:
        raise ModelError(
            f"noise of state {state.name!r}: no parameter {state.noise!r}; {nearest(state.noise, p.names)}"
        )
    return p[state.noise] if isinstance(state.noise, str) else state.noise


def check_process_noise(title: str, system: System, parameters: Sequence[Parameter]) -> None:
    """Refuse process noise that cannot be one: negative or not finite, on a state that is set and not moved, of either sign.

    ``parameters`` are those of ``system.p``, in its order.
    """
    problems = []
    set_afterwards = {u.state for u in system.updates}
    for k, (state, value) in enumerate(zip(system.states, _intensities(system, parameters), strict=True)):
        subject = f"noise of state {state.name!r}"
        if not (math.isfinite(value) and value >= 0):
            problems.append(
                f"{subject}: {value:g} {intensity_unit(state)} is not an intensity; give a finite value of 0 or more"
            )
        # dx = f dt + sigma dw pushes the rate of a state; one that is set has no rate.
        elif k in set_afterwards and not system.diffusion[k].is_zero():
            problems.append(f"{subject}: this state is set after each step and has no rate to push; put it on another")
    intensities = set(find_noise_parameters(system))
    for q in parameters:
        if q.name in intensities and q.bounds[0] < 0:
            problems.append(
                f"parameter {q.name!r}: the intensity of process noise must be 0 or more; set"
                f" bounds=(0, {q.bounds[1]:g})"
            )
    if problems:
        raise ModelError(f"model {title!r}: {'; '.join(problems)}")


def intensity_name(state: str) -> str:
    """Name of the parameter that `Model.with_process_noise` makes for a state: ``noise_v``."""
    return f"noise_{state.replace('.', '_')}"


def intensity_unit(state: State) -> str:
    """Unit of the intensity of a state's process noise: the state's over the root of a second."""
    return format_unit(f"({state.unit or '1'})/s^0.5")


def noise_intensities(system: System, parameters: Sequence[Parameter]) -> dict[str, float]:
    """State -> intensity of its process noise at the values of ``parameters``, in the state's unit over sqrt(s)."""
    return dict(zip(system.state_names, _intensities(system, parameters), strict=True))


def find_noisy_states(system: System, parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """States with process noise: its intensity is not zero at the values of ``parameters``, or is free to become so."""
    free = {q.name for q in parameters if not q.fixed}
    return tuple(
        name
        for k, (name, value) in enumerate(noise_intensities(system, parameters).items())
        if value != 0 or free & {s.name() for s in ca.symvar(system.diffusion[k])}
    )


def find_noise_parameters(system: System) -> tuple[str, ...]:
    """Names of the parameters that are intensities of process noise: no other equation contains them."""
    in_diffusion = {s.name() for s in ca.symvar(system.diffusion)}
    if not in_diffusion:
        return ()
    # A parameter that another equation contains as well is a constant of the plant, whatever scales the noise.
    elsewhere = {s.name() for s in ca.symvar(ca.vertcat(*system.free_run_expressions))}
    return tuple(name for name in system.parameter_names if name in in_diffusion - elsewhere)


def _intensities(system: System, parameters: Sequence[Parameter]) -> list[float]:
    if system.diffusion.is_zero():
        return [0.0] * len(system.states)
    return system.diffusion_function([q.value for q in parameters]).full().ravel().tolist()
