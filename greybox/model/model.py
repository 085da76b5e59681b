"""A model: states, inputs, outputs, parameters and balances as one frozen value."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from greybox.errors import ModelError, nearest
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.rule import Rule, check_constants, check_measured, check_outputs_known
from greybox.model.show import show
from greybox.model.stated import check_names, check_stated
from greybox.model.system import Bound, System, bind, expand, inner_signals
from greybox.model.units_check import check_units
from greybox.signals import Input, Named, Output, Parameter, State


@dataclass(frozen=True, eq=False)
class Model:
    """A physical model: ``balances(x, u, p)`` returns its list of `Balance`, one for each state.

    Nothing changes a model in place: ``model + effect``, ``fix``, ``free``, ``start`` and ``bound`` return new models.
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
    balances: Callable[[Named, Named, Named], list[Balance]]
    effects: tuple[Effect, ...] = ()
    description: str = ""
    source: str = ""
    rules: Sequence[Rule] = ()
    candidates: Sequence[str] = ()

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
        check_stated(self)
        check_units(self)
        check_outputs_known(self.title, self.rules, [o.name for o in self.outputs])
        check_constants(self.title, self.rules, self._constants)

    @cached_property
    def system(self) -> System:
        """The equations as CasADi expressions."""
        return expand(self)

    @cached_property
    def bound_effects(self) -> tuple[Bound, ...]:
        """Each effect with the names and units it has in this model."""
        return bind(self)

    @property
    def all_states(self) -> tuple[State, ...]:
        """States of the plant and of its effects."""
        return (*self.states, *(s for b in self.bound_effects for s in b.states))

    @property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the plant and of its effects, under the names they have in this model."""
        return (*self.parameters, *(q for b in self.bound_effects for q in b.parameters))

    @property
    def free_parameters(self) -> tuple[Parameter, ...]:
        """The parameters that a fit may change."""
        return tuple(q for q in self.all_parameters if not q.fixed)

    @property
    def values(self) -> dict[str, float]:
        """Name -> value of every parameter, in the order of ``system.p``."""
        return {q.name: q.value for q in self.all_parameters}

    @property
    def title(self) -> str:
        """Name with effects: ``micro_actuator + coulomb_friction``."""
        return " + ".join([self.name, *(e.name for e in self.effects)])

    def parameter(self, name: str) -> Parameter:
        """The parameter of this name; an unknown name lists the nearest ones."""
        for q in self.all_parameters:
            if q.name == name:
                return q
        raise ModelError(f"model {self.title!r} has no parameter {name!r}; {nearest(name, self.values)}")

    @property
    def _constants(self) -> Named:
        return Named("parameter", self.values, {q.role: q.name for q in self.parameters if q.role})

    def check_measured(self, subject: str, measured: Mapping[str, np.ndarray]) -> None:
        """Refuse measured outputs, name -> (N,), that break a rule of this model; ``subject`` begins the message.

        Raises DataError with rows, the worst value and the remedy.
        """
        check_measured(subject, self.rules, measured, self._constants)

    def __add__(self, effect: Effect) -> Model:
        if not isinstance(effect, Effect):
            return NotImplemented
        return replace(self, effects=(*self.effects, effect))

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
        effects = []
        for b in self.bound_effects:
            inner = [
                replace(new[outer.name], name=own.name) if outer.name in new else own
                for own, outer in zip(b.effect.parameters, b.parameters, strict=True)
            ]
            effects.append(replace(b.effect, parameters=tuple(inner)))
        return replace(self, parameters=base, effects=tuple(effects))

    def __str__(self) -> str:
        return show(self)


def _numeric(name: str, change: dict[str, Any]) -> dict[str, Any]:
    """``change`` of the parameter ``name`` with its value and bounds as numbers. Raises ModelError for what is none."""
    found = dict(change)
    try:
        if "value" in change:
            found["value"] = float(change["value"])
        if "bounds" in change:
            low, high = change["bounds"]
            found["bounds"] = (float(low), float(high))
    except (TypeError, ValueError):
        key, given = next((k, v) for k, v in change.items() if k != "fixed")
        wanted = "(low, high), two numbers" if key == "bounds" else "a number, without its unit"
        raise ModelError(f"parameter {name!r}: {key} {given!r}; give {wanted}") from None
    return found
