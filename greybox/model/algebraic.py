"""Balances that store nothing: what they say of their states is solved once, and these states are no states of the system.

A valve in front of a volume without capacity, a joint without mass, the node of a circuit: the terms of such a balance add up to zero at
every moment. Where they are linear in the unknown states the solution is exact; otherwise it is that of a fixed number of damped Newton
steps from the states' start values, kept within their bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.base.numerics import ALGEBRAIC_HALVINGS, ALGEBRAIC_NEWTON_STEPS
from greybox.model.balance import Balance
from greybox.model.signals import State


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
