"""Ties: a parameter given by a formula of others, ``Kv = Kf``. The formula replaces the parameter, so it holds exactly."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import casadi as ca
import numpy as np

from greybox.base import ModelError, format_unit, nearest
from greybox.model.effect import Effect
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


# Schedules: a parameter that changes with an operating condition, such as a valve gain with the supply pressure.


def schedule_effect(name: str, by: str, about: float, *, order: int = 1) -> Effect:
    """The effect by which a parameter follows an operating condition, as a polynomial about the condition's value ``about``::

        name (1 + c1 (by/about - 1) + c2 (by/about - 1)^2 ...)

    The coefficients ``c1`` (called ``<name>_<by>``), ``c2`` ... are free and have no unit: by which share the parameter changes where the
    condition doubles. Records under one condition alone do not determine them.

    Parameters
    ----------
    name
        The parameter. It keeps its meaning: it is the value at ``about``.
    by
        A parameter that the experiments give themselves (`Experiment.conditions`), or an input that was measured.
    about
        A usual value of ``by``, in its unit.
    order
        Of the polynomial.

    Returns
    -------
    Effect
        To be added to a model.

    Raises
    ------
    ModelError
        For ``about`` zero, and an order below one.
    """
    if about == 0:
        raise ModelError(f"schedule of {name} by {by}: about 0 is not a valid reference; give a typical value of {by}")
    if order < 1:
        raise ModelError(f"schedule of {name} by {by}: order {order}; give 1 for a straight line, 2 for a parabola")
    powers = range(1, order + 1)
    coefficients = {k: f"{name}_{by}" + (f"_{k}" if k > 1 else "") for k in powers}
    reference = f"{by}_ref"

    def used(x: NamedValues, u: NamedValues, p: NamedValues) -> Mapping[str, Expression]:
        away = (p[by] if by in p else u[by]) / p[reference] - 1
        return {name: p[name] * (1 + sum(p[coefficients[k]] * away**k for k in powers))}

    return Effect(
        f"{name}_by_{by}",
        "",
        [
            *(
                Parameter(coefficients[k], "1", 0.0, description=f"change of {name} with {by}, power {k}")
                for k in powers
            ),
            Parameter(reference, f"{{{by}}}", about, fixed=True, description=f"the {by} at which {name} holds"),
        ],
        on_parameter=used,
        equation=f"{name} (1 + {coefficients[1]} ({by}/{reference} - 1){' + ...' if order > 1 else ''})",
        amplitudes=tuple(coefficients.values()),
    )
