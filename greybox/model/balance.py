"""A balance: what is stored equals the sum of named terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

from greybox.base import ModelError, nearest
from greybox.model.signals import Expression, NamedValues, State


@dataclass(frozen=True)
class Block:
    """A long term under a short name: equations show the name, the model computes the expression.

    Parameters
    ----------
    label
        What stands in the equation, a minus before it included: ``"-rigid body of 7 links"``.
    expression
        The term.
    unit
        Its unit, where the numbers in it are not to be given units one by one: then it is taken as told. Empty: checked as any term.

    Examples
    --------
    ``Balance("joint_1", "N*m", 0, "tau1", motor=x.tau1, body=Block("-rigid body", -torque, "N*m"))``
    """

    label: str
    expression: Expression
    unit: str = ""

    @property
    def is_negative(self) -> bool:
        """Whether a minus stands before the name."""
        return self.label.startswith("-")

    @property
    def name(self) -> str:
        """The label without its sign."""
        return self.label.removeprefix("-").strip()


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
        The terms by name: expressions of states, inputs and parameters, numbers, or a `Block`. None for a random walk, whose state has
        process noise and nothing else that moves it.

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
    blocks: Mapping[str, Block]
    motion: Mapping[str, str]

    def __init__(self, name: str, unit: str, storage: Expression, state: str, /, **terms: Expression | Block) -> None:
        blocks = {name: term for name, term in terms.items() if isinstance(term, Block)}
        for field, value in {
            "name": name,
            "unit": unit,
            "storage": storage,
            "state": state,
            "terms": {name: term.expression if isinstance(term, Block) else term for name, term in terms.items()},
            "blocks": blocks,
            "motion": {},
        }.items():
            object.__setattr__(self, field, value)

    def _with(self, **changes: Any) -> Balance:
        other = copy(self)
        for field, value in changes.items():
            object.__setattr__(other, field, value)
        return other

    def moving(self, velocity: str, displacement: str = "") -> Balance:
        """The same balance, told which motion the forces in it act on: effects there take it for theirs.

        Parameters
        ----------
        velocity, displacement
            Names of a state or an input each. A balance of a velocity knows its own; a relation from which a torque or an acceleration is
            solved, where several bodies move, does not.

        Returns
        -------
        Balance
            A new balance.

        Examples
        --------
        ``Balance("joint_2", "N*m", 0, "tau2", motor=x.tau2, inertia=-p.J * u.ddq2).moving("dq2", "q2")``
        """
        return self._with(motion={"velocity": velocity, "displacement": displacement})

    def with_expressions(self, change: Callable[[Expression], Expression]) -> Balance:
        """The same balance with ``change`` made to its storage and to each term."""
        terms = {name: change(term) for name, term in self.terms.items()}
        return self._with(storage=change(self.storage), terms=terms)

    def with_term(self, name: str, expression: Expression) -> Balance:
        """The same balance with one more named term."""
        if name in self.terms:
            raise ModelError(f"balance {self.name!r} already has a term {name!r}; give the new one another name")
        return self._with(terms={**self.terms, name: expression})

    def with_terms_replaced(self, terms: Mapping[str, Expression]) -> Balance:
        """The same balance with other expressions for some of its terms."""
        unknown = [name for name in terms if name not in self.terms]
        if unknown:
            raise ModelError(
                f"balance {self.name!r} has no term {unknown[0]!r} to replace; {nearest(unknown[0], self.terms)}"
            )
        blocks = {name: block for name, block in self.blocks.items() if name not in terms}
        return self._with(terms={**self.terms, **terms}, blocks=blocks)

    def with_storage(self, factor: Expression) -> Balance:
        """The same balance with what it stores multiplied by ``factor``."""
        return self._with(storage=self.storage * factor)


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
