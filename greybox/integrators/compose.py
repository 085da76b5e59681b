"""How a substep is put together: delay, dry friction, the smooth method, updates.

Within one substep, in this order: the input is taken as it arrives after its delay; dry friction cuts the substep where the
velocity crosses zero; each piece is one step of the smooth method (with the exponentials of relaxing states inside); at the end
the states that are set (play) are set.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from greybox.errors import ModelError
from greybox.integrators.dry import sticking
from greybox.integrators.past import arriving, extra_columns, late_outputs
from greybox.integrators.step import Advance, Method, Past, Step
from greybox.integrators.update import updating
from greybox.model.system import System


def stepped(name: str, system: System, method: Method, substeps: int, past: Past | None) -> Step:
    """The step of ``system`` by a smooth ``method``; a delayed input needs the ``past`` and takes at least two substeps."""
    if system.delays and past is None:
        raise ModelError(f"the delayed input of {system.delays[0].effect!r} needs its past; use discretise")
    advance = sticking(system, method) if system.dry else method(rate_of(system))
    if system.updates:
        advance = updating(system, advance)
    outputs = system.output_function
    if past is not None:
        substeps = max(substeps, 2)
        advance, outputs = arriving(system, advance, past), late_outputs(system, past)
    return Step(name, _function(system, advance, past), outputs, parameters_themselves, substeps, past=past)


def rate_of(system: System) -> ca.Function:
    """``(x, u, p) -> dx/dt`` without dry friction."""
    return ca.Function("f", [system.x, system.u, system.p], [system.rhs])


def parameters_themselves(p: np.ndarray, lengths: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of a step that takes the parameters as they are: one row for every interval length."""
    return p[None, :], np.eye(len(p))[None, :, which]


def _function(system: System, advance: Advance, past: Past | None) -> ca.Function:
    x, p, h = ca.SX.sym("x", system.x.numel()), ca.SX.sym("p", system.p.numel()), ca.SX.sym("h")
    columns = system.u.numel() + extra_columns(past)
    ua, ub = ca.SX.sym("ua", columns), ca.SX.sym("ub", columns)
    return ca.Function("advance", [x, ua, ub, p, h], [ca.cse(advance(x, ua, ub, p, h))])
