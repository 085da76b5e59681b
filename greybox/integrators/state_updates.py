"""States that are set after each substep instead of having a rate: play, ``w+ = min(max(w, s - gap), s + gap)``."""

from __future__ import annotations

import casadi as ca

from greybox.integrators.step import AdvanceFunction
from greybox.model.system import System


def apply_updates(system: System, advance: AdvanceFunction) -> AdvanceFunction:
    """``advance`` followed by the updates of ``system``.

    They see the other states and the input at the end of the substep and their own state as it was before it. Play is exact
    while the motion keeps its direction; a reversal inside a substep is missed by the way run beyond its ends (order 2).
    """
    values = ca.vertcat(*[update.value for update in system.updates])
    update = ca.Function("update", [system.x, system.u, system.p], [values])

    def step(x: ca.SX, ua: ca.SX, ub: ca.SX, p: ca.SX, h: ca.SX) -> ca.SX:
        following = ca.SX(advance(x, ua, ub, p, h))
        after = update(following, ub, p)  # a state without a rate stayed where it was
        for k, entry in enumerate(system.updates):
            following[entry.state] = after[k]
        return following

    return step
