"""What a model is made of: states, inputs, outputs and parameters, each with a name and a unit.

A *role* is the field's word for what a signal is in its domain (``displacement``, ``velocity``, ``current``,
``drive``, ``resistance`` ...). The catalogue's effects speak in roles, so that one Coulomb friction serves every
plant that has a velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from greybox.base import MissingNameError, ModelError, nearest

Expression = Any  # a CasADi SX expression, or a plain number


def _refuse_wrong_order(signal: State | Input | Output | Parameter, usage: str, **numbers: object) -> None:
    """Refuse numbers where texts belong, and texts where ``numbers`` do: they tell arguments in another order. All in one message."""
    texts = {"name": signal.name, "unit": signal.unit}
    wrong = [
        f"its {what} is {value!r}, which is no text" for what, value in texts.items() if not isinstance(value, str)
    ]
    wrong += [
        f"its {what} is {value!r}, which is no number"
        for what, value in numbers.items()
        if isinstance(value, str) or not hasattr(value, "__float__")
    ]
    if wrong:
        raise ModelError(f"{type(signal).__name__.lower()} {signal.name!r}: {'; '.join(wrong)}: write {usage}")


@dataclass(frozen=True)
class State:
    """A state variable.

    Parameters
    ----------
    name, unit
        ``x.<name>`` in the equations; the unit as text (``m/s``, ``N*s/m``).
    start
        The value at rest: where a record begins with ``at_rest=True``, and the first guess otherwise. A number, or a function of the
        parameters (``lambda p: p.P_S / 2``).
    bounds
        Physical limits (low, high): a run stops at them (a tank that is empty), and the equations never see the state beyond them.
    role
        What the state is physically (``displacement``, ``velocity``, ``current``); effects ask for roles.
    description
        One line for tables.
    relaxing
        Whether its own rate is linear in itself, ``dz/dt = alpha - beta z`` (``|z|`` may stand for ``z``), with a ``beta`` that may be
        large: a bristle, a spool, a winding that warms. The integrators step it by ``exp(-beta h)``, stable for every step.
    noise
        Process noise, ``dx = rate dt + noise dw`` with a Wiener process ``w``: something random pushes the state. Its intensity in the
        state's unit over sqrt(s): a number, the name of a parameter (bounded from 0 up; where it is free it is estimated), or a function
        of the parameters (``lambda p: p.sigma / p.M`` for a random force). A model with some of it is fitted by its prediction errors; a
        free run leaves it out.
    free_start
        Whether the initial value is estimated for every record, also with ``at_rest=True``: a disturbance from outside does not begin
        when the record does.

    Examples
    --------
    >>> State("x", "m", role="displacement").start
    0.0
    """

    name: str
    unit: str
    start: float | Callable[[NamedValues], Expression] = 0.0
    bounds: tuple[float, float] = (-math.inf, math.inf)
    role: str = ""
    description: str = ""
    relaxing: bool = False
    noise: float | str | Callable[[NamedValues], Expression] = 0.0
    free_start: bool = False

    def __post_init__(self) -> None:
        _refuse_wrong_order(self, 'State("x", "m", 0.0) with name, unit and start value')


@dataclass(frozen=True)
class Input:
    """A measured or commanded input.

    Parameters
    ----------
    name, unit
        ``u.<name>`` in the equations, and the header of its column in records; the unit as text.
    role
        What the input is physically (``drive``, ``valve``).
    description
        One line for tables.

    Examples
    --------
    >>> Input("u", "V", role="drive", description="amplifier voltage").name
    'u'
    """

    name: str
    unit: str
    role: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        _refuse_wrong_order(self, 'Input("u", "V") with name and unit')


@dataclass(frozen=True)
class Output:
    """A measured output.

    Parameters
    ----------
    name, unit
        The header of its column in records; the unit as text.
    equation
        ``equation(x, u, p)`` gives its value. None: it is the state of the same name.
    role
        What the output is physically.
    description
        One line for tables.
    wraps
        Period after which the reading starts anew, in ``unit``: 2 pi of an angle in rad, the modulus of a counter. Records that are read
        for the model have its jumps taken out, so that the reading goes on as the state does. 0: it does not wrap.

    Examples
    --------
    >>> force = Output("F", "N", lambda x, u, p: p.K * x.x)
    """

    name: str
    unit: str
    equation: Callable[[NamedValues, NamedValues, NamedValues], Expression] | None = None
    role: str = ""
    description: str = ""
    wraps: float = 0.0

    def __post_init__(self) -> None:
        _refuse_wrong_order(self, 'Output("x", "m") with name and unit')
        if not (math.isfinite(self.wraps) and self.wraps >= 0):
            raise ModelError(
                f"output {self.name!r}: wraps = {self.wraps:g}: give a period above 0 in {self.unit}, or 0 for none"
            )


@dataclass(frozen=True)
class Parameter:
    """A physical constant of a model.

    Parameters
    ----------
    name, unit
        ``p.<name>`` in the equations; the unit as text.
    value
        Where a fit starts, and what a simulation uses.
    bounds
        Physical limits (low, high). A lower bound above zero makes it a positive constant, which is fitted on a logarithmic scale.
    fixed
        Whether it is known and stays as it is.
    source
        Where the number is from: a data sheet, a measurement, a paper.
    role
        What the parameter is physically (``mass``, ``resistance``); effects ask for roles.
    description
        One line for tables.
    prior
        What is known of it without the records, as mean and standard deviation of a normal distribution: ``(0.0100, 0.0001)`` for a
        weighed mass.

    Raises
    ------
    ModelError
        For arguments in another order, empty bounds, a value that is not finite or lies outside them, and a prior that is none.

    Examples
    --------
    >>> Parameter("M", "kg", 0.010, bounds=(1e-4, 1.0), source="weighed").positive
    True
    """

    name: str
    unit: str
    value: float
    bounds: tuple[float, float] = (-math.inf, math.inf)
    fixed: bool = False
    source: str = ""
    role: str = ""
    description: str = ""
    prior: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        usage = 'Parameter("k", "1/s", 2.0, (low, high)) with name, unit, value and bounds'
        bounds: Any = self.bounds
        low, high = (*bounds,) if hasattr(bounds, "__len__") and len(bounds) == 2 else (None, bounds)
        _refuse_wrong_order(self, usage, value=self.value, **{"lower bound": low, "upper bound": high})
        if not low < high:
            raise ModelError(
                f"parameter {self.name!r}: bounds [{low:g}, {high:g}] {self.unit} are empty; give (low, high) with low < high"
            )
        if not math.isfinite(self.value):
            raise ModelError(
                f"parameter {self.name!r}: value {self.value} is not a finite number; give a rough physical value in {self.unit}"
            )
        unit = "" if self.unit.strip() in ("", "-", "1") else f" {self.unit}"
        if not low <= self.value <= high:
            raise ModelError(
                f"parameter {self.name!r}: {self.value:g}{unit} lies outside its bounds [{low:g}, {high:g}]{unit};"
                f" give a value inside, or widen them with model.bound({self.name}=(low, high))"
            )
        if self.prior is not None:
            _check_prior(self.name, self.unit, self.prior, self.bounds)

    @property
    def positive(self) -> bool:
        """Whether the constant can only be positive (fitted on a logarithmic scale)."""
        return self.bounds[0] > 0


def _check_prior(name: str, unit: str, prior: tuple[float, float], bounds: tuple[float, float]) -> None:
    if not isinstance(prior, tuple | list) or len(prior) != 2:
        raise ModelError(f"parameter {name!r}: prior {prior!r}: give the mean and the standard deviation, (mean, std)")
    mean, std = prior
    if not (math.isfinite(mean) and math.isfinite(std) and std > 0):
        raise ModelError(
            f"parameter {name!r}: prior {mean:g} +- {std:g} {unit}: give a finite mean and a standard deviation above zero"
        )
    if not bounds[0] <= mean <= bounds[1]:
        raise ModelError(
            f"parameter {name!r}: prior mean {mean:g} {unit} lies outside its bounds [{bounds[0]:g}, {bounds[1]:g}] {unit};"
            f" correct the prior, or widen them with model.bound({name}=(low, high))"
        )


Quantity = State | Input | Output | Parameter


class _WithRole(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def role(self) -> str: ...


def names_by_role(items: Sequence[_WithRole]) -> dict[str, str]:
    """Role -> name of the item that has it, the first one where several have it."""
    return {item.role: item.name for item in reversed(items) if item.role}


class NamedValues:
    """Values reached by name or by role: ``x.v``, ``u.u``, ``p.Kf``, ``x.velocity``. An unknown name lists the nearest ones."""

    __slots__ = ("_kind", "_roles", "_values")

    def __init__(self, kind: str, values: Mapping[str, Expression], roles: Mapping[str, str] | None = None) -> None:
        self._kind = kind
        self._values = dict(values)
        self._roles = dict(roles or {})

    def __getattr__(self, name: str) -> Expression:
        if name.startswith("__"):
            raise AttributeError(name)
        key = name if name in self._values else self._roles.get(name, name)
        if key not in self._values:
            raise MissingNameError(f"no {self._kind} {name!r}; {nearest(name, self.names)}", self._kind, name)
        return self._values[key]

    def __getitem__(self, name: str) -> Expression:
        return self.__getattr__(name)

    def __contains__(self, name: str) -> bool:
        return name in self._values or name in self._roles

    @property
    def names(self) -> list[str]:
        """Every name and role that can be asked for."""
        return [*self._values, *(r for r in self._roles if r not in self._values)]

    def replaced(self, values: Mapping[str, Expression], roles: Mapping[str, str] | None = None) -> NamedValues:
        """The same names with some values (and roles) replaced or added."""
        return NamedValues(self._kind, self._values | dict(values), self._roles | dict(roles or {}))

    def seen_from(self, effect_values: Mapping[str, Expression], roles: Mapping[str, str]) -> NamedValues:
        """The same as an effect sees it: ``roles`` mean the names given here (none where it is empty), and ``effect_values`` come first.

        A role goes on meaning what it meant, also where one of these values has its name.
        """
        values = {name: value for name, value in self._values.items() if name not in roles or roles[name] == name}
        meant = {role: self._values[name] for role, name in (self._roles | dict(roles)).items() if name in self._values}
        kept = {role: value for role, value in meant.items() if role in roles or self._roles[role] in effect_values}
        left = {role: name for role, name in self._roles.items() if roles.get(role, name)}
        return NamedValues(self._kind, {**values, **kept, **effect_values}, left)
