"""A balance: what is stored equals the sum of named terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import ModelError, nearest
from greybox.base.numerics import ALGEBRAIC_HALVINGS, ALGEBRAIC_NEWTON_STEPS
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


# Balances that store nothing: what they say of their states is solved once, and these states are no states of the system.
#
# A valve in front of a volume without capacity, a joint without mass, the node of a circuit: the terms of such a balance add up to zero at
# every moment. Where they are linear in the unknown states the solution is exact; otherwise it is that of a fixed number of damped Newton
# steps from the states' start values, kept within their bounds.


@dataclass(frozen=True)
class AlgebraicState:
    """A state that a balance without storage determines.

    Parameters
    ----------
    state
        What the model states of it.
    balance
        Its balance with every effect applied, terms in the symbols of all states.
    symbol
        Its symbol in them.
    value
        The state as an expression of the states of the system, inputs and parameters.
    is_exact
        Whether the relations are linear in such states.
    """

    state: State
    balance: Balance
    symbol: ca.SX
    value: ca.SX
    is_exact: bool


def stores_nothing(balance: Balance) -> bool:
    """Whether a balance is a relation without a rate: its storage is the number 0."""
    return bool(ca.SX(balance.storage).is_zero())


def solve_relations(
    model: str, balances: Sequence[Balance], states: Mapping[str, State], symbols: Mapping[str, ca.SX], p_start: ca.SX
) -> tuple[AlgebraicState, ...]:
    """The states of balances that store nothing.

    Parameters
    ----------
    model
        Its name, for messages.
    balances
        Those that store nothing, with every effect applied.
    states, symbols
        The states of the plant by name, and their symbols.
    p_start
        Start values (n,) of these states, in the order of ``balances``.

    Raises
    ------
    ModelError
        Where the balances do not determine their states.
    """
    if not balances:
        return ()
    # 0 = g(z), the sum of the terms of each balance, in all such states together.
    z = ca.vertcat(*[symbols[b.state] for b in balances])
    residual = ca.vertcat(*[sum(map(ca.SX, b.terms.values()), ca.SX(0)) for b in balances])
    slope = ca.jacobian(residual, z)
    # The structural rank is known before any value is: below full rank no value of a parameter determines z.
    if ca.sprank(slope) < z.numel():
        names = ", ".join(repr(b.name) for b in balances)
        raise ModelError(
            f"model {model!r}: balance {names} stores nothing, and its terms do not determine {', '.join(b.state for b in balances)};"
            " let a term depend on it, or give the balance a storage"
        )
    is_exact = not ca.depends_on(slope, z)
    if is_exact:
        # g is affine: z = -(dg/dz)^-1 g(0), exact and without iterations.
        value = -ca.solve(slope, ca.substitute(residual, z, ca.SX.zeros(z.numel())))
    else:
        bounds = [states[b.state].bounds for b in balances]
        value = _newton(z, residual, slope, ca.vertcat(p_start), np.array(bounds))
    return tuple(
        AlgebraicState(states[b.state], b, symbols[b.state], value[k], is_exact) for k, b in enumerate(balances)
    )


def _newton(z: ca.SX, residual: ca.SX, slope: ca.SX, start: ca.SX, bounds: np.ndarray) -> ca.SX:
    """Where ``residual`` vanishes: damped Newton steps from ``start``, within ``bounds`` (n, 2).

    A step is halved until the residual falls. Beyond the domain of a root it is not a number, which is no fall either; such points decide,
    and do not enter the value, so its slopes stay finite.
    """
    others = [s for s in ca.symvar(ca.vertcat(residual, start)) if not ca.depends_on(z, s)]
    # |g|^2 and the Newton step -(dg/dz)^-1 g, as functions: written out at every trial point they would grow without end.
    size = ca.Function("size", [z, *others], [ca.sumsqr(residual)])
    step = ca.Function("step", [z, *others], [-ca.solve(slope, residual)])
    value = start
    for _ in range(ALGEBRAIC_NEWTON_STEPS):
        present, full = size(value, *others), step(value, *others)
        trials = [
            ca.fmin(ca.fmax(value + 0.5**k * full, bounds[:, 0]), bounds[:, 1]) for k in range(ALGEBRAIC_HALVINGS + 1)
        ]
        # The longest of the steps 1, 1/2, 1/4 ... that does not raise |g|^2; the shortest one where none does.
        chosen = trials[-1]
        for trial in reversed(trials[:-1]):
            chosen = ca.if_else(size(trial, *others) <= present, trial, chosen)
        value = chosen
    return value


def eliminate(expression: ca.SX, algebraic: Sequence[AlgebraicState]) -> ca.SX:
    """``expression`` with the states that relations determine replaced by their values."""
    if not algebraic:
        return expression
    return ca.substitute(
        ca.SX(expression), ca.vertcat(*[a.symbol for a in algebraic]), ca.vertcat(*[a.value for a in algebraic])
    )
