"""Effects stated as a formula: one line of text in the names of a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from greybox.base import ModelError, nearest
from greybox.model.balance import Balance
from greybox.model.effect import Effect
from greybox.model.expressions.text import evaluate_formula, list_formula_names
from greybox.model.signals import Expression, NamedValues, Parameter, State

# Name of the state of a formula with memory.
LAGGED = "lagged"


def formula_effect(
    name: str,
    site: str,
    formula: str,
    parameters: Sequence[Parameter],
    *,
    amplitude: str = "k",
    lag: str = "T",
    lag_unit: str | None = None,
    source: str = "",
) -> Effect:
    """An effect that adds a formula to a balance.

    Parameters
    ----------
    name, site
        As of `greybox.model.Effect`.
    formula
        What acts there, in the names of the model's states and inputs and of ``parameters``, with ``+ - * / **``, ``abs``, ``sign``,
        ``exp``, ``tanh``, ``sqrt``, ``sin``, ``cos``, ``max`` and ``min``.
    parameters
        The constants in it, with units.
    amplitude
        The constant that multiplies the formula: with it at zero the effect is absent.
    lag, lag_unit
        Of a formula with memory the constant that is its time constant, and the unit of the formula without its amplitude, which then acts
        through a lag of first order. No unit is no memory.
    source
        Where it is from.

    Returns
    -------
    Effect
        Like one of the catalogue.

    Raises
    ------
    ModelError
        For text that is no formula, and for an amplitude that is not among the parameters.

    Examples
    --------
    >>> drag = formula_effect("drag", "force", "k*abs(v)*v", [Parameter("k", "N*s^2/m^2", -0.3)])
    >>> drag.equation
    'k*abs(v)*v'
    """
    subject, constants = f"effect {name!r}", [q.name for q in parameters]
    if amplitude not in constants:
        raise ModelError(
            f"{subject}: no parameter {amplitude!r} to multiply the formula; {nearest(amplitude, constants)}"
        )
    list_formula_names(subject, formula)  # refuses text that is none
    values = {q.name: q.value for q in parameters}
    shapes = [q for q in parameters if q.name not in (amplitude,) and not q.fixed]
    start = values[amplitude] or 1.0

    def inner(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return evaluate_formula(subject, formula, _Names(x, u, p))

    def through_lag(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
        return p[amplitude] * x[LAGGED]

    def memory(x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        # What the amplitude multiplies: a formula with memory begins with it, ``k*v**2``.
        undelayed = evaluate_formula(subject, formula.removeprefix(f"{amplitude}*"), _Names(x, u, p))
        return [Balance(f"{name}_memory", lag_unit or "1", p[lag], LAGGED, arriving=undelayed, leaving=-x[LAGGED])]

    has_memory = lag_unit is not None
    return Effect(
        name,
        site,
        tuple(parameters),
        terms=through_lag if has_memory else inner,
        states=(State(LAGGED, lag_unit, relaxing=True),) if lag_unit is not None else (),
        balances=memory if has_memory else None,
        equation=formula,
        amplitudes=(amplitude,),
        probe=_constant({amplitude: start}),
        grid=_constant({q.name: (q.value,) for q in shapes}) if shapes else None,
        source=source or "stated as a formula",
    )


class _Names:
    """States, inputs and parameters under one roof; an effect's own constants come first."""

    def __init__(self, x: NamedValues, u: NamedValues, p: NamedValues) -> None:
        self._groups = (p, x, u)

    def __contains__(self, name: str) -> bool:
        return any(name in group for group in self._groups)

    def __getitem__(self, name: str) -> Any:
        return next(group for group in self._groups if name in group)[name]

    @property
    def names(self) -> list[str]:
        """Every name that can be asked for."""
        return [name for group in self._groups for name in group.names]


def _constant(values: Mapping[str, Any]) -> Callable[[Any], Mapping[str, Any]]:
    return lambda scales: values
