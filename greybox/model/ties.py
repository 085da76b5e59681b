"""Ties: a parameter given by a formula of others, ``Kv = Kf``. The formula replaces the parameter, so it holds exactly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import casadi as ca
import numpy as np

from greybox.base.errors import ModelError, nearest
from greybox.base.units import format_unit
from greybox.model.expressions.text import evaluate_formula, format_formula, list_formula_names
from greybox.model.signals import Expression, NamedValues, Parameter

Formula = str | Callable[[NamedValues], Expression]


@dataclass(frozen=True)
class Tie:
    """``name = formula`` between parameters of a model; the formula contains other parameters, in their units."""

    name: str
    formula: str

    def value(self, p: NamedValues) -> ca.SX:
        """The formula at ``p``, symbols or numbers."""
        return evaluate_formula(f"tie {self}", self.formula, p)

    @property
    def names(self) -> list[str]:
        """The parameters that the formula contains."""
        return list_formula_names(f"tie {self}", self.formula)

    def __str__(self) -> str:
        return f"{self.name} = {self.formula}"


def apply_ties(ties: Sequence[Tie], p: NamedValues) -> NamedValues:
    """``p``, symbols or numbers, with every tied parameter as its formula gives it."""
    for tie in order_ties(ties):
        value = tie.value(p)
        p = p.replaced({tie.name: float(value) if value.is_constant() else value})
    return p


def order_ties(ties: Sequence[Tie]) -> list[Tie]:
    """The ties, each after those that it needs. Raises ModelError for a circle."""
    if len(ties) < 2:
        return list(ties)
    by_name = {tie.name: tie for tie in ties}
    needs = {tie.name: [n for n in tie.names if n in by_name] for tie in ties}
    try:
        order = list(TopologicalSorter(needs).static_order())
    except CycleError as error:
        circle = " -> ".join(reversed(error.args[1]))
        raise ModelError(f"ties are circular: {circle}; leave at least one of these parameters untied") from None
    return [by_name[name] for name in order]


def as_formula(name: str, given: Formula, p: NamedValues) -> str:
    """The text of a formula; a function of the constants ``p`` (symbols) is written out."""
    if isinstance(given, str):
        return given.strip()
    if not callable(given):
        raise ModelError(
            f"tie {name} = {given!r}: give a formula such as 'Kf', or a function lambda p: p.Kf; for a number fix it"
        )
    return format_formula(f"tie {name}", given(p))


def check_tie(tie: Tie, known: Mapping[str, Parameter], roles: Mapping[str, str]) -> Tie:
    """``tie`` with plain names for roles; refuses what cannot be tied: ModelError says why and what to do."""
    if tie.name not in known:
        raise ModelError(f"tie {tie}: no parameter {tie.name!r}; {nearest(tie.name, known)}")
    if known[tie.name].fixed:
        q = known[tie.name]
        raise ModelError(
            f"tie {tie}: {tie.name} is fixed at {q.value:g} {format_unit(q.unit)}, so there is nothing to tie; first free({tie.name!r})"
        )
    p = NamedValues("constant", {n: ca.SX.sym(n) for n in known}, roles)
    value = tie.value(p)
    names = [s.name() for s in ca.symvar(value)]
    if not names:
        raise ModelError(
            f"tie {tie}: no parameter in the formula; to give a number write fix({tie.name}={tie.formula})"
        )
    if tie.name in names:
        raise ModelError(f"tie {tie}: a parameter cannot be tied to itself")
    return Tie(tie.name, tie.formula if set(tie.names) == set(names) else format_formula(f"tie {tie}", value))


def check_tied_value(tie: Tie, quantity: Parameter, value: float) -> None:
    """Refuse a tie that takes a constant out of its bounds at the present values."""
    low, high = quantity.bounds
    if not (np.isfinite(value) and low <= value <= high):
        unit = format_unit(quantity.unit)
        raise ModelError(
            f"tie {tie}: gives {value:.6g} {unit}, outside the bounds [{low:g}, {high:g}] {unit} of {quantity.name};"
            " give other start values, or wider bounds before the tie"
        )
