"""A model: states, inputs, outputs, parameters and balances as one frozen value."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import ModelError, Printable, nearest
from greybox.base.packing import MadeOfFunctions
from greybox.model import balance, build_system, validation
from greybox.model.effect import GUESSES, Effect
from greybox.model.parts import check_parts
from greybox.model.signals import Input, NamedValues, Output, Parameter, State, names_by_role
from greybox.model.sites import STORE, Site
from greybox.model.system import (
    BoundEffect,
    ParameterSymbol,
    Statement,
    System,
    check_process_noise,
    find_noise_parameters,
    find_noisy_states,
    intensity_name,
    noise_intensities,
)
from greybox.model.ties import Formula, Tie, apply_ties, as_formula, check_tie, check_tied_value, schedule_effect


@dataclass(frozen=True, eq=False)
class Model(MadeOfFunctions, Printable):
    """A physical model as a value: named balances of named terms, one for each state.

    Nothing changes a model in place: ``model + effect``, `fix`, `free`, `start`, `bound`, `prior` and `tie` return new models. Names and
    units are checked on construction, and so are the rules.

    Parameters
    ----------
    name
        Its name, of letters, digits, ``_`` and ``-``; it becomes the name of files.
    states, inputs, outputs, parameters
        What the equations speak of. The first input is the drive, the first output the main sensor.
    balances
        ``balances(x, u, p)`` returns a list of `Balance`, one for each state; ``x.v``, ``u.u``, ``p.Kf`` are states, inputs and
        parameters by name or role.
    effects
        Effects that were added; write ``model + effect``.
    description, source
        What the model is of, and where it is from.
    rules
        What several parameters must satisfy together, and what a sensor may show (`Rule`).
    candidates
        Names of the catalogue's effects that this rig may hide. None given means all that have a place in it. What a record of any plant
        may get wrong (a sign, a row) is tried as well.
    has, lacks
        Names of parts that the rig has, and of parts that it has not (`greybox.model.parts.PARTS`): effects that need one it lacks are not
        tried, and among sets of effects that do equally well those that are usual with its parts come first.
    ties
        Parameters that others give; write ``model.tie(Kv="Kf")``.

    Raises
    ------
    ModelError
        For names that clash or are unknown, balances that are missing, rules that the parameters break.
    UnitError
        For a term whose unit is not its balance's: all offenders, with the unit found and the unit expected.

    Examples
    --------
    >>> from greybox import Balance, Input, Model, Output, Parameter, State
    >>> def balances(x, u, p):
    ...     return [
    ...         Balance("position", "m/s", 1, "x", velocity=x.v),
    ...         Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x),
    ...     ]
    >>> rig = Model(
    ...     "rig",
    ...     states=[State("x", "m"), State("v", "m/s")],
    ...     inputs=[Input("F", "N")],
    ...     outputs=[Output("x", "m")],
    ...     parameters=[Parameter("M", "kg", 1.0, (0.1, 10)), Parameter("K", "N/m", 50.0, (1, 1e4))],
    ...     balances=balances,
    ... )
    >>> rig.fix(M=2.0).values
    {'M': 2.0, 'K': 50.0}
    """

    name: str
    states: Sequence[State]
    inputs: Sequence[Input]
    outputs: Sequence[Output]
    parameters: Sequence[Parameter]
    balances: Callable[[NamedValues, NamedValues, NamedValues], list[balance.Balance]]
    effects: tuple[Effect, ...] = ()
    description: str = ""
    source: str = ""
    rules: Sequence[validation.Rule] = ()
    candidates: Sequence[str] = ()
    ties: tuple[Tie, ...] = ()
    has: Sequence[str] = ()
    lacks: Sequence[str] = ()

    def restate(self) -> tuple[Any, ...]:
        """As it was stated: CasADi expressions are not sent to another process, a model is written out anew where it arrives."""
        return _restate, (type(self), {f.name: getattr(self, f.name) for f in fields(self) if f.init})

    def __post_init__(self) -> None:
        check_parts(f"model {self.name!r}", self.has, self.lacks)
        system, parameters = self.system, self.all_parameters  # writing the equations out checks them
        validation.check_outputs_known(self.title, self.rules, [o.name for o in self.outputs])
        check_process_noise(self.title, system, parameters)
        validation.check_constants(self.title, self.rules, self._present_values)

    @cached_property
    def statement(self) -> Statement:
        """Everything that determines the equations: models with equal statements share one system."""
        return Statement.of(
            self.name, self.states, self.inputs, self.outputs, self.parameters, self.balances, self.effects, self.ties
        )

    @cached_property
    def system(self) -> System:
        """The equations as CasADi expressions."""
        return build_system.SYSTEMS.system(self.statement)

    @cached_property
    def bound_effects(self) -> tuple[BoundEffect, ...]:
        """Each effect with the names and units it has in this model."""
        return tuple(
            BoundEffect(
                effect,
                tuple(
                    replace(q, name=s.name, unit=s.unit)
                    for q, s in zip(effect.parameters, placed.parameters, strict=True)
                ),
                placed,
            )
            for effect, placed in zip(self.effects, self.system.effects, strict=True)
        )

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Effects that were added, by name."""
        return tuple(effect.name for effect in self.effects)

    def names_of(self, effect: str) -> Mapping[str, str]:
        """Constant of an effect that the model has -> its name in the model."""
        return next(bound.model_names for bound in self.bound_effects if bound.effect.name == effect)

    @cached_property
    def sites(self) -> tuple[Site, ...]:
        """Every balance, input and output of the plant as a place where effects may act."""
        return build_system.read_plant(self.statement).sites

    @cached_property
    def roles(self) -> Mapping[str, str]:
        """Name -> role of the states, inputs and parameters that have one: told, or found by their balances."""
        plant = build_system.read_plant(self.statement)
        # A body's velocity and displacement are found by their balances.
        by_balance = {
            name: role for s in reversed(plant.sites) for role, name in s.states.items() if name and role != STORE
        }
        items: tuple[State | Input | ParameterSymbol, ...] = (*self.states, *plant.inputs, *plant.parameters)
        return by_balance | {item.name: item.role for item in items if item.role}

    @property
    def all_states(self) -> tuple[State, ...]:
        """States of the plant and of its effects."""
        return self.system.states

    @cached_property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the plant and of its effects, under the names they have in this model; those that are tied left out."""
        gone = {tie.name for tie in self.ties}
        return tuple(q for q in self.stated_parameters if q.name not in gone)

    @cached_property
    def stated_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the plant and of its effects, tied ones included."""
        return (*self.parameters, *(q for b in self.bound_effects for q in b.parameters))

    @property
    def tied_values(self) -> dict[str, float]:
        """Name -> present value of every parameter that is tied to others."""
        p = self.parameters_at(list(self.values.values()))
        return {tie.name: float(p[tie.name]) for tie in self.ties}

    @cached_property
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
        return find_noisy_states(self.system, self.all_parameters)

    @cached_property
    def noise_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that are intensities of process noise and nothing else."""
        return find_noise_parameters(self.system)

    @property
    def noise_intensities(self) -> dict[str, float]:
        """State -> present intensity of its process noise, in the state's unit over sqrt(s)."""
        return noise_intensities(self.system, self.all_parameters)

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
                    f"parameter {name!r} is tied, {tie}: set {' or '.join(tie.names)} instead, or untie it with untie({name!r})"
                )
        raise ModelError(f"model {self.title!r} has no parameter {name!r}; {nearest(name, self.values)}")

    @property
    def _present_values(self) -> NamedValues:
        return self.parameters_at(list(self.values.values()))

    def parameters_at(self, p: Sequence[float] | np.ndarray) -> NamedValues:
        """All parameters by name and role at the values ``p`` (np,), in the order of ``system.p``; tied ones as their ties say."""
        return self._named(dict(zip(self.values, map(float, p), strict=True)))

    def parameters_as_symbols(self, p: ca.SX) -> NamedValues:
        """The same with ``p`` as symbols, in the order of ``system.p``."""
        return self._named(dict(zip(self.values, ca.vertsplit(p), strict=True)))

    def _named(self, values: Mapping[str, Any]) -> NamedValues:
        return apply_ties(self.ties, NamedValues("parameter", values, names_by_role(self.parameters)))

    def check_measured(self, subject: str, measured: Mapping[str, np.ndarray]) -> None:
        """Refuse measured outputs, name -> (N,), that break a rule of this model; ``subject`` begins the message.

        Raises DataError with rows, the worst value and the remedy.
        """
        validation.check_measured(subject, self.rules, measured, self._present_values)

    @property
    def auxiliary(self) -> frozenset[str]:
        """States and inputs that stand for no quantity of the plant: nothing is looked for there, or as a function of them."""
        return frozenset()

    @property
    def identity(self) -> str:
        """What tells a plant that is run from outside from others; empty where the equations do."""
        return ""

    @property
    def has_equations(self) -> bool:
        """Whether there are equations; what is run from outside has none."""
        return not isinstance(self.balances, balance.ClosedBalances)

    def require_unchanged(self) -> None:
        """Refuse functions that state something else now than when the model was made: random numbers, a counter. Raises ModelError."""
        build_system.refuse_changing(self.statement, self.system.written)

    def require_equations(self, purpose: str) -> None:
        """Refuse ``purpose``, which begins the reason, where there are no equations. Raises ModelError."""
        if not self.has_equations:
            raise ModelError(f"{self.title}: {purpose} needs equations, and this plant is run from outside")

    def __add__(self, effect: Effect) -> Model:
        if not isinstance(effect, Effect):
            return NotImplemented
        return replace(self, effects=(*self.effects, effect))

    def without(self, effect: str) -> Model:
        """The model without one of its effects.

        Parameters
        ----------
        effect
            Its name.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            If the model does not have it.
        """
        if effect not in [e.name for e in self.effects]:
            raise ModelError(
                f"model {self.title!r} has no effect {effect!r}; {nearest(effect, [e.name for e in self.effects])}"
            )
        return replace(self, effects=tuple(e for e in self.effects if e.name != effect))

    def with_parts(self, *, has: Sequence[str] = (), lacks: Sequence[str] = ()) -> Model:
        """The model of a rig that has these parts and lacks those, beside what it says already; what is said now counts.

        Parameters
        ----------
        has, lacks
            Names of parts (`greybox.model.parts.PARTS`).

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For unknown names, with the nearest ones, and for a part in both.

        Examples
        --------
        ``model.with_parts(has=["gear"], lacks=["fluid"])``: friction of a gear is usual, and the drag of the air is not tried.
        """
        had, lacked = ([n for n in of if n not in (*has, *lacks)] for of in (self.has, self.lacks))
        return replace(self, has=(*had, *has), lacks=(*lacked, *lacks))

    def fix(self, /, *names: str, **values: float) -> Model:
        """The model with parameters that are known, so that a fit leaves them as they are.

        Parameters
        ----------
        *names
            Parameters that are fixed at their present values.
        **values
            Parameters that are fixed at these values, in their units.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For unknown names, values outside the bounds, and rules that they break: all of them in one message.

        Examples
        --------
        ``model.fix("Ra", M=0.01)``: the resistance as it is, the mass at 0.01 kg.
        """
        changes: dict[str, dict] = {n: {"fixed": True} for n in names}
        changes |= {n: {"fixed": True, "value": v} for n, v in values.items()}
        for name, change in changes.items():
            # What somebody knows is no guess of the catalogue's any more, which a record may still move.
            change |= {"source": ""} if name in self.values and self.parameter(name).source in GUESSES else {}
        return self._with_changes(changes)

    def free(self, *names: str) -> Model:
        """The model with the named parameters free: a fit may change them. Raises ModelError for an unknown name."""
        return self._with_changes({n: {"fixed": False} for n in names})

    def start(self, /, **values: float) -> Model:
        """The model with other values of its parameters.

        A fit starts from them and `simulate` uses them; what is fixed or free stays as it is.

        Parameters
        ----------
        **values
            Parameter -> value in its unit.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For unknown names, values outside the bounds, and rules that they break: all of them in one message.

        Examples
        --------
        ``model.start(K=6000, B=0.3)``
        """
        return self._with_changes({n: {"value": v} for n, v in values.items()})

    def bound(self, /, **bounds: tuple[float, float]) -> Model:
        """The model with other physical bounds of its parameters.

        Parameters
        ----------
        **bounds
            Parameter -> (low, high) in its unit. A lower bound above zero makes it a positive constant, fitted on a logarithmic scale.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For unknown names, empty bounds, and a present value outside them.

        Examples
        --------
        ``model.bound(Ra=(1, 20))``
        """
        return self._with_changes({n: {"bounds": b} for n, b in bounds.items()})

    def with_process_noise(self, /, *estimated: str, **known: float | str) -> Model:
        """The model with random pushes on some of its states, in the place of what these had.

        Parameters
        ----------
        *estimated
            States whose intensity is estimated, as a new parameter ``noise_<state>`` that starts at 0.
        **known
            State -> intensity in the state's unit over sqrt(s), or the name of a parameter that gives it. See `State`.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For an unknown state, and for one that is named twice.

        Examples
        --------
        ``model.with_process_noise("v")`` estimates how strongly ``v`` is pushed, ``model.with_process_noise(v=0.1)`` knows it.
        """
        self.require_equations("process noise")
        states = {s.name: s for s in self.all_states}
        unknown = [n for n in (*estimated, *known) if n not in states]
        if unknown:
            raise ModelError(f"model {self.title!r} has no state {unknown[0]!r}; {nearest(unknown[0], states)}")
        both = [n for n in estimated if n in known]
        if both:
            raise ModelError(f"process noise of {both[0]!r}: either estimated or known; name the state once")
        noise: dict[str, float | str] = {**known, **{name: intensity_name(name) for name in estimated}}
        added = [
            Parameter(
                intensity_name(name),
                f"({states[name].unit or '1'})/s^0.5",
                0.0,
                (0.0, math.inf),
                description=f"intensity of the process noise of {name}",
            )
            for name in estimated
            if intensity_name(name) not in self.values
        ]
        plant = tuple(replace(s, noise=noise[s.name]) if s.name in noise else s for s in self.states)
        effects = []
        for b in self.bound_effects:
            states_of_effect = [
                replace(inner, noise=noise[outer.name]) if outer.name in noise else inner
                for inner, outer in zip(b.effect.states, b.states, strict=True)
            ]
            effects.append(replace(b.effect, states=tuple(states_of_effect)))
        return replace(self, states=plant, parameters=(*self.parameters, *added), effects=tuple(effects))

    def prior(self, /, **priors: tuple[float, float] | None) -> Model:
        """The model with priors of its parameters.

        A fit starts at the mean, and weighs each prior as one more measurement (maximum a posteriori). It says where the records contradict
        a prior, and by what factor. A parameter that is held at its prior as well (``model.prior(M=(0.0100, 0.0001)).fix("M")``) stays at
        the mean; a second fit with it free says what the records want it to be.

        Parameters
        ----------
        **priors
            Parameter -> (mean, standard deviation) of a normal distribution in its unit. None takes a prior back.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For unknown names, a standard deviation that is not positive, and a mean outside the bounds.

        Examples
        --------
        A mass that was weighed as 10.0 g to a tenth of a gram: ``model.prior(M=(0.0100, 0.0001))``.
        """
        changes: dict[str, dict] = {}
        for name, given in priors.items():
            changes[name] = {"prior": given} if given is None else {"prior": given, "value": _pair(name, given)[0]}
        return self._with_changes(changes)

    def tie(self, *, new: Sequence[Parameter] = (), **formulas: Formula) -> Model:
        """The model with parameters that are given by others.

        The formula takes the place of the parameter, so it holds exactly and nothing is left to fit there; its unit is checked. Where the
        formula is one other parameter, that one takes over the bounds too.

        Parameters
        ----------
        new
            Parameters that only formulas contain.
        **formulas
            Parameter -> formula of other parameters: a text with names, numbers, ``+ - * / ^``, brackets and functions, or a function of
            ``p``.

        Returns
        -------
        Model
            A new model.

        Raises
        ------
        ModelError
            For an unknown name, a fixed parameter, a circle, and values out of bounds.
        UnitError
            For a formula whose unit is not the parameter's.

        Examples
        --------
        ``model.tie(Kv="Kf")``: back-EMF and force constant are one; ``model.tie(Kv=lambda p: p.Kf)`` is the same.

        One parameter below another, ``a < b``, is ``model.tie(b="a + gap", new=[Parameter("gap", "N", 1.0, (0, 10))])``.
        """
        return self.with_ties(formulas, new)

    def with_ties(self, formulas: Mapping[str, Formula], new: Sequence[Parameter] = ()) -> Model:
        """`tie` with the formulas as a dictionary: for names with a dot, such as an effect's ``creep.K``."""
        model = replace(self, parameters=(*self.parameters, *new)) if new else self
        known = {q.name: q for q in model.stated_parameters}
        roles = names_by_role(model.parameters)
        p = NamedValues("constant", {name: ca.SX.sym(name) for name in known}, roles)
        before = {tie.name: tie for tie in model.ties}
        for name in formulas:
            if name in before:
                raise ModelError(f"tie {name}: it is tied already, {before[name]}; first untie({name!r})")
        ties = [check_tie(Tie(name, as_formula(name, given, p)), known, roles) for name, given in formulas.items()]
        with_ties = replace(model, ties=(*model.ties, *ties))
        for tie in ties:
            if tie.formula in with_ties.values:
                # The model with the bounds of the one parameter that a tie's formula is narrowed to those of the tied one.
                quantity = known[tie.name]
                other = with_ties.parameter(tie.formula)
                low, high = max(other.bounds[0], quantity.bounds[0]), min(other.bounds[1], quantity.bounds[1])
                check_tied_value(tie, quantity, other.value)
                with_ties = with_ties.bound(**{other.name: (low, high)})
            check_tied_value(tie, known[tie.name], with_ties.tied_values[tie.name])
        return with_ties

    def untie(self, *names: str) -> Model:
        """The model with the named parameters standing for themselves again, at the values that their ties gave them.

        Raises ModelError for one that is not tied.
        """
        for name in names:
            if name not in self.tied_values:
                raise ModelError(f"parameter {name!r} is not tied; {nearest(name, self.tied_values)}")
        left = tuple(tie for tie in self.ties if tie.name not in names)
        return replace(self, ties=left).start(**{name: self.tied_values[name] for name in names})

    def schedule(self, name: str, *, by: str, about: float | None = None, order: int = 1) -> Model:
        """The model with a parameter that follows an operating condition, as a polynomial (`greybox.model.ties.schedule_effect`).

        Parameters
        ----------
        name
            The parameter.
        by
            A parameter that each experiment gives itself (its conditions), or a measured input.
        about
            The value of ``by`` at which ``name`` holds, in its unit; None takes the model's own.
        order
            Of the polynomial: 1 for a straight line, 2 for a parabola.

        Returns
        -------
        Model
            A new model, with the coefficients as free parameters.

        Raises
        ------
        ModelError
            For unknown names, and for an input without ``about``.

        Examples
        --------
        A valve gain that follows the supply pressure: ``model.schedule("K2", by="P_S")``.
        """
        parameters = [q.name for q in self.stated_parameters]
        conditions = [*self.values, *(i.name for i in self.inputs)]
        for wanted, known in ((name, parameters), (by, conditions)):
            if wanted not in known:
                raise ModelError(
                    f"schedule of {name} by {by}: model {self.title!r} has no {wanted!r}; {nearest(wanted, known)}"
                )
        if name == by:
            raise ModelError(
                f"schedule of {name} by {by}: a parameter cannot depend on itself; name the condition that it depends on"
            )
        if about is None and by not in self.values:
            raise ModelError(f"schedule of {name} by {by}: {by} is an input; give its reference value, as in about=7e5")
        return self + schedule_effect(name, by, self.values[by] if about is None else about, order=order)

    def _with_changes(self, changes: dict[str, dict]) -> Model:
        problems = []
        new: dict[str, Parameter] = {}
        for name, change in changes.items():
            try:
                known, stated = self.parameter(name), _numeric(name, change)
                # Another value is from elsewhere.
                is_other = stated.get("value", known.value) != known.value
                new[name] = replace(known, **{"source": "" if is_other else known.source, **stated})
            except ModelError as error:
                problems.append(str(error))
        if problems:
            raise ModelError("; ".join(problems))
        effects = []
        for b in self.bound_effects:
            parameters = [
                replace(new[outer.name], name=inner.name, unit=inner.unit) if outer.name in new else inner
                for inner, outer in zip(b.effect.parameters, b.parameters, strict=True)
            ]
            effects.append(replace(b.effect, parameters=tuple(parameters)))
        return replace(self, parameters=tuple(new.get(q.name, q) for q in self.parameters), effects=tuple(effects))

    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: a copy, here or in another process, writes out its own equations."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


def _pair(name: str, given: Any) -> tuple[float, float]:
    """A prior as two numbers."""
    try:
        mean, std = given
        return float(mean), float(std)
    except (TypeError, ValueError):
        raise ModelError(f"parameter {name!r}: prior {given!r}; give (mean, standard deviation), two numbers") from None


def _numeric(name: str, change: dict[str, Any]) -> dict[str, Any]:
    """``change`` of the parameter ``name`` with its value and bounds as numbers. Raises ModelError for what is none."""
    numbers = dict(change)
    try:
        if "value" in change:
            numbers["value"] = float(change["value"])
        if "bounds" in change:
            low, high = change["bounds"]
            numbers["bounds"] = (float(low), float(high))
        if change.get("prior") is not None:
            numbers["prior"] = _pair(name, change["prior"])
    except (TypeError, ValueError):
        key, given = next((k, v) for k, v in change.items() if k != "fixed")
        wanted = "(low, high), two numbers" if key == "bounds" else "a number, without its unit"
        raise ModelError(f"parameter {name!r}: {key} {given!r}; give {wanted}") from None
    return numbers


def _restate(kind: type[Model], stated: dict[str, Any]) -> Model:
    return kind(**stated)
