"""How a substep is composed: input delay, dry friction, the smooth method, state updates.

Within one substep, in this order: the input is taken as it arrives after its delay; dry friction splits the substep where the
velocity crosses zero; each piece is one step of the smooth method (with the exponentials of relaxing states inside); a state that
would leave its bounds stops there; at the end come the states that are set instead of having a rate (play,
``w+ = min(max(w, s - gap), s + gap)``).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.model import System
from greybox.simulation.integrators.dry_friction import split_at_standstill
from greybox.simulation.integrators.input_delay import count_history_columns, delay_input, delay_outputs
from greybox.simulation.integrators.step import AdvanceFunction, InputHistory, IntegrationMethod, Step


def make_step(
    name: str,
    system: System,
    method: IntegrationMethod,
    substeps: int,
    past: InputHistory | None,
    reach: float | None = None,
) -> Step:
    """The step of ``system`` by a smooth ``method``; a delayed input needs the ``past`` and takes at least two substeps.

    ``reach``: see `Step.reach`.
    """
    if system.delays and past is None:
        raise ModelError(f"the delayed input of {system.delays[0].effect!r} needs its past; use discretise")
    # Friction runs the smooth method on pieces of a substep, and the delay hands friction its substeps: a body may
    # stop on either side of the cut of a delayed input, and each piece has one course of the input.
    advance = split_at_standstill(system, method) if system.dry else method(make_rate_function(system))
    advance = stop_at_bounds(system, advance)
    if system.updates:
        # Inside the delay, which hands each substep its own ends of the input: play follows the input that has
        # arrived.
        advance = apply_updates(system, advance)
    outputs = system.output_function
    if past is not None:
        # One substep at least on either side of the cut where the delayed input changes its row.
        substeps = max(substeps, 2)
        advance, outputs = delay_input(system, advance, past), delay_outputs(system, past)
    x, p, h = ca.SX.sym("x", system.x.numel()), ca.SX.sym("p", system.p.numel()), ca.SX.sym("h")
    columns = system.u.numel() + count_history_columns(past)
    ua, ub = ca.SX.sym("ua", columns), ca.SX.sym("ub", columns)
    # Stages repeat subexpressions of the equations; without `cse` each would be an instruction of its own, with its tangent.
    whole = ca.Function("advance", [x, ua, ub, p, h], [ca.cse(advance(x, ua, ub, p, h))])
    return Step(name, whole, outputs, as_coefficients, substeps, past=past, reach=reach)


def stop_at_bounds(system: System, advance: AdvanceFunction) -> AdvanceFunction:
    """``advance`` with every bounded state at its bound where the substep would lead beyond it.

    A tank that has run empty is empty: what it held before, and so every slope along constants, is forgotten there. The rate of a root has
    no finite slope at its zero, which a run through it would carry on and multiply by the next.
    """
    if not system.limits:
        return advance

    def step(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        following = ca.SX(advance(x, ua, ub, p, h))
        for k, low, high in system.limits:
            following[k] = ca.fmax(following[k], low) if low > -ca.inf else following[k]
            following[k] = ca.fmin(following[k], high) if high < ca.inf else following[k]
        return following

    return step


def make_rate_function(system: System) -> ca.Function:
    """``(x, u, p) -> dx/dt`` without dry friction."""
    return ca.Function("f", [system.x, system.u, system.p], [system.rhs])


def as_coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of a step that takes the parameters as they are: one row for every interval length."""
    # q = p, so dq / dp[which] is the columns ``which`` of the identity.
    return p[None, :], np.eye(len(p))[None, :, which]


def apply_updates(system: System, advance: AdvanceFunction) -> AdvanceFunction:
    """``advance`` followed by the updates of ``system``.

    They see the other states and the input at the end of the substep and their own state as it was before it. Play is exact
    while the motion keeps its direction; a reversal inside a substep is missed by the way run beyond its ends (order 2).
    """
    values = ca.vertcat(*[update.value for update in system.updates])
    update = ca.Function("update", [system.x, system.u, system.p], [values])

    def step(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        following = ca.SX(advance(x, ua, ub, p, h))
        updated = update(following, ub, p)  # a state without a rate stayed where it was
        for k, entry in enumerate(system.updates):
            following[entry.state] = updated[k]
        return following

    return step
