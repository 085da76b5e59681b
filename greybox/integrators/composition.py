"""How a substep is put together: delay, dry friction, the smooth method, updates.

Within one substep, in this order: the input is taken as it arrives after its delay; dry friction cuts the substep where the
velocity crosses zero; each piece is one step of the smooth method (with the exponentials of relaxing states inside); at the end
the states that are set (play) are set.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox.errors import ModelError
from greybox.integrators.dry_friction import split_at_standstill
from greybox.integrators.input_delay import count_history_columns, delay_input, delay_outputs
from greybox.integrators.state_updates import apply_updates
from greybox.integrators.step import AdvanceFunction, InputHistory, IntegrationMethod, Step
from greybox.model.system import System


def make_step(name: str, system: System, method: IntegrationMethod, substeps: int, past: InputHistory | None) -> Step:
    """The step of ``system`` by a smooth ``method``; a delayed input needs the ``past`` and takes at least two substeps."""
    if system.delays and past is None:
        raise ModelError(f"the delayed input of {system.delays[0].effect!r} needs its past; use discretise")
    advance = split_at_standstill(system, method) if system.dry else method(make_rate_function(system))
    if system.updates:
        advance = apply_updates(system, advance)
    outputs = system.output_function
    if past is not None:
        substeps = max(substeps, 2)
        advance, outputs = delay_input(system, advance, past), delay_outputs(system, past)
    return Step(name, _function(system, advance, past), outputs, as_coefficients, substeps, past=past)


def make_rate_function(system: System) -> ca.Function:
    """``(x, u, p) -> dx/dt`` without dry friction."""
    return ca.Function("f", [system.x, system.u, system.p], [system.rhs])


def as_coefficients(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of a step that takes the parameters as they are: one row for every interval length."""
    return p[None, :], np.eye(len(p))[None, :, which]


def _function(system: System, advance: AdvanceFunction, past: InputHistory | None) -> ca.Function:
    x, p, h = ca.SX.sym("x", system.x.numel()), ca.SX.sym("p", system.p.numel()), ca.SX.sym("h")
    columns = system.u.numel() + count_history_columns(past)
    ua, ub = ca.SX.sym("ua", columns), ca.SX.sym("ub", columns)
    return ca.Function("advance", [x, ua, ub, p, h], [ca.cse(advance(x, ua, ub, p, h))])
