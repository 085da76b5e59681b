"""A balance: what is stored equals the sum of named terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from greybox.base import ModelError, nearest
from greybox.model.signals import Expression, NamedValues, State


@dataclass(frozen=True, init=False)
class Balance:
    """What is stored equals the sum of named terms: ``storage * d(state)/dt = term + term + ...``.

    Parameters
    ----------
    name
        The name of the balance (``force``, ``voltage``); effects add to balances by name.
    unit
        The unit of every term. It also says the time that the equation counts in: in ``g/h``, of a state in g, rates are those of hours.
    storage
        What multiplies the rate: a mass, an inductance, 1. The number 0 makes the balance a relation: its terms add up to zero, and its
        state is solved for (from `State.start`, where the relation is not linear).
    state
        Name of the state whose rate the balance gives.
    **terms
        The terms by name: expressions of states, inputs and parameters, or numbers. None for a random walk, whose state has process
        noise and nothing else that moves it.

    Examples
    --------
    ``M dv/dt = Kf i - B v`` inside ``balances(x, u, p)`` of a model::

        Balance("force", "N", p.M, "v", coil=p.Kf * x.i, damping=-p.B * x.v)
    """

    name: str
    unit: str
    storage: Expression
    state: str
    terms: Mapping[str, Expression]

    def __init__(self, name: str, unit: str, storage: Expression, state: str, /, **terms: Expression) -> None:
        for field, value in {
            "name": name,
            "unit": unit,
            "storage": storage,
            "state": state,
            "terms": dict(terms),
        }.items():
            object.__setattr__(self, field, value)

    def with_term(self, name: str, expression: Expression) -> Balance:
        """The same balance with one more named term."""
        if name in self.terms:
            raise ModelError(f"balance {self.name!r} already has a term {name!r}; give the new one another name")
        return Balance(self.name, self.unit, self.storage, self.state, **{**self.terms, name: expression})

    def with_terms_replaced(self, terms: Mapping[str, Expression]) -> Balance:
        """The same balance with other expressions for some of its terms."""
        unknown = [name for name in terms if name not in self.terms]
        if unknown:
            raise ModelError(
                f"balance {self.name!r} has no term {unknown[0]!r} to replace; {nearest(unknown[0], self.terms)}"
            )
        return Balance(self.name, self.unit, self.storage, self.state, **{**self.terms, **terms})

    def with_storage(self, factor: Expression) -> Balance:
        """The same balance with what it stores multiplied by ``factor``."""
        return Balance(self.name, self.unit, self.storage * factor, self.state, **self.terms)


@dataclass(frozen=True)
class ClosedBalances:
    """The balances of what is run from outside: no equation is known, its ``states`` only say how a record begins."""

    states: tuple[State, ...] = ()

    def __call__(self, x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        """Each state stays where it began."""
        return [Balance(s.name, f"({s.unit or '1'})/s", 1.0, s.name, rest=0.0) for s in self.states]


def closed_output(x: NamedValues, u: NamedValues, p: NamedValues) -> Expression:
    """In the place of an output's equation that nobody knows."""
    return 0.0
