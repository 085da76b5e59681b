"""A model: states, inputs, outputs, parameters and balances as one frozen value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from greybox.errors import ModelError, nearest
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.equations import model_text
from greybox.model.process_noise import check_process_noise, noise_parameters, noisy_states, with_process_noise
from greybox.model.rules import Rule, check_constants, check_measured, check_outputs_known
from greybox.model.schedules import schedule_effect
from greybox.model.signals import Input, NamedValues, Output, Parameter, State
from greybox.model.system import BoundEffect, System, bind_effects, build_system, inner_signals
from greybox.model.ties import Formula, Tie, apply_ties, as_formula, check_tie, check_tied_value, order_ties
from greybox.model.unit_check import check_units
from greybox.model.validation import check_expressions, check_names


@dataclass(frozen=True, eq=False)
class Model:
    """A physical model: ``balances(x, u, p)`` returns its list of `Balance`, one for each state.

    Nothing changes a model in place: ``model + effect``, ``fix``, ``free``, ``start``, ``bound``, ``prior`` and ``tie`` return new
    models.
    Names and units are checked on construction, and so are ``rules`` (`Rule`: what several constants must satisfy
    together). The first input is the drive, the first output the main sensor. ``candidates``: names of the catalogue's
    effects that this rig may hide; none given means all that have a place in it.

    Raises ModelError for names that clash or are unknown, UnitError for a term whose unit is not its balance's.
    """

    name: str
    states: Sequence[State]
    inputs: Sequence[Input]
    outputs: Sequence[Output]
    parameters: Sequence[Parameter]
    balances: Callable[[NamedValues, NamedValues, NamedValues], list[Balance]]
    effects: tuple[Effect, ...] = ()
    description: str = ""
    source: str = ""
    rules: Sequence[Rule] = ()
    candidates: Sequence[str] = ()
    ties: tuple[Tie, ...] = ()

    def __post_init__(self) -> None:
        if not self.states or not self.outputs:
            raise ModelError(f"model {self.name!r} needs at least one state and one output")
        inner = [item.name for item in inner_signals(self)]
        outer = [*(i.name for i in self.inputs), *(o.name for o in self.outputs)]
        for names in (inner, outer):
            twice = sorted({n for n in names if names.count(n) > 1})
            if twice:
                raise ModelError(
                    f"model {self.name!r}: the name {twice[0]!r} is used twice; every signal and parameter needs its own"
                )
        check_names(self)
        check_expressions(self)
        order_ties(self.ties)
        check_units(self)
        check_outputs_known(self.title, self.rules, [o.name for o in self.outputs])
        self._check_numbers()

    def _check_numbers(self) -> None:
        """What depends on the values and bounds of the parameters."""
        check_process_noise(self)
        check_constants(self.title, self.rules, self._constants)

    @cached_property
    def system(self) -> System:
        """The equations as CasADi expressions."""
        return build_system(self)

    @cached_property
    def bound_effects(self) -> tuple[BoundEffect, ...]:
        """Each effect with the names and units it has in this model."""
        return bind_effects(self)

    @property
    def all_states(self) -> tuple[State, ...]:
        """States of the plant and of its effects."""
        return (*self.states, *(s for b in self.bound_effects for s in b.states))

    @property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the plant and of its effects, under the names they have in this model; those that are tied left out."""
        gone = {tie.name for tie in self.ties}
        return tuple(q for q in self.stated_parameters if q.name not in gone)

    @property
    def stated_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the plant and of its effects, tied ones included."""
        return (*self.parameters, *(q for b in self.bound_effects for q in b.parameters))

    @property
    def tied_values(self) -> dict[str, float]:
        """Name -> present value of every constant that is tied to others."""
        p = self.parameters_at(list(self.values.values()))
        return {tie.name: float(p[tie.name]) for tie in self.ties}

    @property
    def free_parameters(self) -> tuple[Parameter, ...]:
        """The parameters that a fit may change."""
        return tuple(q for q in self.all_parameters if not q.fixed)

    @property
    def values(self) -> dict[str, float]:
        """Name -> value of every parameter, in the order of ``system.p``."""
        return {q.name: q.value for q in self.all_parameters}

    @cached_property
    def noisy_states(self) -> tuple[str, ...]:
        """States with process noise, or with an intensity that is free to become positive."""
        return noisy_states(self)

    @cached_property
    def noise_parameters(self) -> tuple[str, ...]:
        """Names of the constants that are intensities of process noise and nothing else."""
        return noise_parameters(self)

    @property
    def title(self) -> str:
        """Name with effects: ``micro_actuator + coulomb_friction``."""
        return " + ".join([self.name, *(e.name for e in self.effects)])

    def parameter(self, name: str) -> Parameter:
        """The parameter of this name; an unknown name lists the nearest ones."""
        for q in self.all_parameters:
            if q.name == name:
                return q
        for tie in self.ties:
            if tie.name == name:
                raise ModelError(
                    f"parameter {name!r} is tied, {tie}: set {' or '.join(tie.names)} instead, or let go of it with untie({name!r})"
                )
        raise ModelError(f"model {self.title!r} has no parameter {name!r}; {nearest(name, self.values)}")

    @property
    def _constants(self) -> NamedValues:
        return self.parameters_at(list(self.values.values()))

    def parameters_at(self, p: Sequence[float] | np.ndarray) -> NamedValues:
        """All constants by name and role at the values ``p`` (np,), in the order of ``system.p``; tied ones as their ties say."""
        return self._named(dict(zip(self.values, map(float, p), strict=True)))

    def parameters_as_symbols(self, p: ca.SX) -> NamedValues:
        """The same with ``p`` as symbols, in the order of ``system.p``."""
        return self._named(dict(zip(self.values, ca.vertsplit(p), strict=True)))

    def _named(self, values: Mapping[str, Any]) -> NamedValues:
        return apply_ties(
            self.ties, NamedValues("parameter", values, {q.role: q.name for q in self.parameters if q.role})
        )

    def check_measured(self, subject: str, measured: Mapping[str, np.ndarray]) -> None:
        """Refuse measured outputs, name -> (N,), that break a rule of this model; ``subject`` begins the message.

        Raises DataError with rows, the worst value and the remedy.
        """
        check_measured(subject, self.rules, measured, self._constants)

    def __add__(self, effect: Effect) -> Model:
        if not isinstance(effect, Effect):
            return NotImplemented
        effects = (*self.effects, effect)
        known = next((system for before, system in self.system.extended if before.has_same_equations(effect)), None)
        if known is not None:
            return self._written_as(known, effects=effects)
        found = replace(self, effects=effects)
        if not found.system.delays:  # how long these can be is in the bounds
            self.system.extended.append((effect, found.system))
        return found

    def without(self, effect: str) -> Model:
        """The model without the effect of this name."""
        if effect not in [e.name for e in self.effects]:
            raise ModelError(
                f"model {self.title!r} has no effect {effect!r}; {nearest(effect, [e.name for e in self.effects])}"
            )
        return replace(self, effects=tuple(e for e in self.effects if e.name != effect))

    def fix(self, *names: str, **values: float) -> Model:
        """Constants that are known: ``fix(M=0.01)`` at this value, ``fix("M")`` at the present one."""
        changes: dict[str, dict] = {n: {"fixed": True} for n in names}
        changes |= {n: {"fixed": True, "value": v} for n, v in values.items()}
        return self._changed(changes)

    def free(self, *names: str) -> Model:
        """Constants that a fit may change."""
        return self._changed({n: {"fixed": False} for n in names})

    def start(self, **values: float) -> Model:
        """Values from which a fit starts (and which `simulate` uses); fixed or free stays as it is."""
        return self._changed({n: {"value": v} for n, v in values.items()})

    def bound(self, **bounds: tuple[float, float]) -> Model:
        """Other physical bounds: ``bound(Ra=(1, 20))``."""
        return self._changed({n: {"bounds": b} for n, b in bounds.items()})

    def with_process_noise(self, *estimated: str, **known: float | str) -> Model:
        """Random pushes on states: ``with_process_noise("v")`` estimates the intensity, as a new parameter ``noise_v``;
        ``with_process_noise(v=0.1)`` knows it, in the state's unit over sqrt(s). See `State`.
        """
        return with_process_noise(self, estimated, known)

    def prior(self, **priors: tuple[float, float] | None) -> Model:
        """What is known of constants without the records: ``prior(M=(0.0100, 0.0001))``, mean and standard deviation.

        A fit starts at the mean, and weighs each prior as one more measurement (maximum a posteriori). None takes a prior back.
        """
        changes: dict[str, dict] = {}
        for name, given in priors.items():
            changes[name] = {"prior": given} if given is None else {"prior": given, "value": _pair(name, given)[0]}
        return self._changed(changes)

    def tie(self, *, new: Sequence[Parameter] = (), **formulas: Formula) -> Model:
        """Constants given by others: ``tie(Kv="Kf")``, ``tie(C="C0*(1 + c*(ps/p0 - 1))", new=[...])``, ``tie(Kv=lambda p: p.Kf)``.

        The formula takes the place of the constant, so it holds exactly and nothing is left to fit there; its unit is checked.
        ``new`` are constants that only formulas speak of. One constant below another, ``a < b``, is ``tie(b="a + gap")`` with a ``gap``
        that is bounded by zero. Where the formula is one other constant, that takes over the bounds too.

        Raises ModelError for an unknown name, a fixed constant, a circle, and values out of bounds; UnitError for a wrong unit.
        """
        return self.with_ties(formulas, new)

    def with_ties(self, formulas: Mapping[str, Formula], new: Sequence[Parameter] = ()) -> Model:
        """`tie` with the formulas as a dictionary: for names with a dot, such as an effect's ``creep.K``."""
        model = replace(self, parameters=(*self.parameters, *new)) if new else self
        known = {q.name: q for q in model.stated_parameters}
        roles = {q.role: q.name for q in model.parameters if q.role}
        p = NamedValues("constant", {name: ca.SX.sym(name) for name in known}, roles)
        before = {tie.name: tie for tie in model.ties}
        for name in formulas:
            if name in before:
                raise ModelError(f"tie {name}: it is tied already, {before[name]}; first untie({name!r})")
        ties = [check_tie(Tie(name, as_formula(name, given, p)), known, roles) for name, given in formulas.items()]
        found = replace(model, ties=(*model.ties, *ties))
        for tie in ties:
            if tie.formula in found.values:
                found = _within(found, tie, known[tie.name])
            check_tied_value(tie, known[tie.name], found.tied_values[tie.name])
        return found

    def untie(self, *names: str) -> Model:
        """The model with these constants standing for themselves again, at the values that their ties gave them."""
        for name in names:
            if name not in self.tied_values:
                raise ModelError(f"parameter {name!r} is not tied; {nearest(name, self.tied_values)}")
        left = tuple(tie for tie in self.ties if tie.name not in names)
        return replace(self, ties=left).start(**{name: self.tied_values[name] for name in names})

    def schedule(self, name: str, *, by: str, about: float | None = None, order: int = 1) -> Model:
        """The model with the constant ``name`` following an operating condition: ``schedule("K2", by="P_S")``.

        ``by`` is a parameter that each experiment gives itself (its conditions), or a measured input; ``about`` the value of it at
        which ``name`` holds, by default the model's own. See `greybox.model.schedules.schedule_effect`.

        Raises ModelError for unknown names, and for an input without ``about``.
        """
        constants = [q.name for q in self.stated_parameters]
        places = [*self.values, *(i.name for i in self.inputs)]
        for given, known in ((name, constants), (by, places)):
            if given not in known:
                raise ModelError(
                    f"schedule of {name} by {by}: model {self.title!r} has no {given!r}; {nearest(given, known)}"
                )
        if name == by:
            raise ModelError(
                f"schedule of {name} by {by}: a constant cannot follow itself; name the condition that it follows"
            )
        if about is None and by not in self.values:
            raise ModelError(
                f"schedule of {name} by {by}: {by} is an input; say about which value of it, as in about=7e5"
            )
        return self + schedule_effect(name, by, self.values[by] if about is None else about, order=order)

    def _changed(self, changes: dict[str, dict]) -> Model:
        problems = []
        new: dict[str, Parameter] = {}
        for name, change in changes.items():
            try:
                new[name] = replace(self.parameter(name), **_numeric(name, change))
            except ModelError as error:
                problems.append(str(error))
        if problems:
            raise ModelError("; ".join(problems))
        base = tuple(new.get(q.name, q) for q in self.parameters)
        bound = []
        for b in self.bound_effects:
            inner = [
                replace(new[outer.name], name=own.name) if outer.name in new else own
                for own, outer in zip(b.effect.parameters, b.parameters, strict=True)
            ]
            outer = tuple(new.get(q.name, q) for q in b.parameters)
            bound.append(replace(b, effect=replace(b.effect, parameters=tuple(inner)), parameters=outer))
        effects = tuple(b.effect for b in bound)
        if self.system.delays:  # how long these can be is in the bounds
            return replace(self, parameters=base, effects=effects)
        return self._written_as(self.system, parameters=base, effects=effects, bound_effects=tuple(bound))

    def _written_as(self, system: System, **changes: Any) -> Model:
        """The model with these fields changed, whose equations are ``system``: written out and checked before, with other numbers."""
        found = object.__new__(type(self))
        vars(found).update({f.name: getattr(self, f.name) for f in fields(self)} | changes | {"system": system})
        found._check_numbers()
        return found

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: a copy, here or in another process, writes out its own equations."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __str__(self) -> str:
        return model_text(self)


def _within(model: Model, tie: Tie, quantity: Parameter) -> Model:
    """``model`` with the bounds of the one constant that a tie speaks of narrowed to those of the tied one."""
    other = model.parameter(tie.formula)
    low, high = max(other.bounds[0], quantity.bounds[0]), min(other.bounds[1], quantity.bounds[1])
    check_tied_value(tie, quantity, other.value)
    return model.bound(**{other.name: (low, high)})


def _pair(name: str, given: Any) -> tuple[float, float]:
    """A prior as two numbers."""
    try:
        mean, std = given
        return float(mean), float(std)
    except (TypeError, ValueError):
        raise ModelError(f"parameter {name!r}: prior {given!r}; give (mean, standard deviation), two numbers") from None


def _numeric(name: str, change: dict[str, Any]) -> dict[str, Any]:
    """``change`` of the parameter ``name`` with its value and bounds as numbers. Raises ModelError for what is none."""
    found = dict(change)
    try:
        if "value" in change:
            found["value"] = float(change["value"])
        if "bounds" in change:
            low, high = change["bounds"]
            found["bounds"] = (float(low), float(high))
        if change.get("prior") is not None:
            found["prior"] = _pair(name, change["prior"])
    except (TypeError, ValueError):
        key, given = next((k, v) for k, v in change.items() if k != "fixed")
        wanted = "(low, high), two numbers" if key == "bounds" else "a number, without its unit"
        raise ModelError(f"parameter {name!r}: {key} {given!r}; give {wanted}") from None
    return found
