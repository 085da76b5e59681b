"""Steps whose length follows the error, for stiff smooth models of any size: ESDIRK4(3)6L[2]SA.

C. A. Kennedy, M. H. Carpenter, Additive Runge-Kutta schemes for convection-diffusion-reaction equations, Applied Numerical Mathematics 44
(2003): order 4 with an embedded method of order 3, L-stable, the last stage is the end of the step. Each stage after the first solves
``X = x + h sum_j a_ij K_j + h gamma f(X)`` by Newton's iteration, all with one matrix ``I - h gamma J``.
"""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np

from greybox.base import ModelError
from greybox.model import System
from greybox.simulation.integrators.composition import as_coefficients, make_rate_function
from greybox.simulation.integrators.runge_kutta import rk4_step
from greybox.simulation.integrators.step import AdaptiveRates, Step

GAMMA = Fraction(1, 4)
# Rows of the table below the diagonal; the diagonal is GAMMA but for the first stage, which is explicit.
_ROWS = (
    (),
    (GAMMA,),
    (Fraction(8611, 62500), Fraction(-1743, 31250)),
    (Fraction(5012029, 34652500), Fraction(-654441, 2922500), Fraction(174375, 388108)),
    (
        Fraction(15267082809, 155376265600),
        Fraction(-71443401, 120774400),
        Fraction(730878875, 902184768),
        Fraction(2285395, 8070912),
    ),
    (Fraction(82889, 524892), Fraction(0), Fraction(15625, 83664), Fraction(69875, 102672), Fraction(-2260, 8211)),
)
STAGES = len(_ROWS)
# Weights of the embedded method, of order 3.
_EMBEDDED = (
    Fraction(4586570599, 29645900160),
    Fraction(0),
    Fraction(178811875, 945068544),
    Fraction(814220225, 1159782912),
    Fraction(-3700637, 11593932),
    Fraction(61727, 225920),
)
TABLE = np.array(
    [
        [*map(float, row), *([0.0] if i == 0 else [float(GAMMA)]), *[0.0] * (STAGES - 1 - i)]
        for i, row in enumerate(_ROWS)
    ]
)
NODES = TABLE.sum(axis=1)
# What the weights of the method, the last row, are more than those of the embedded one.
LESS = TABLE[-1] - np.array(list(map(float, _EMBEDDED)))
# Of the error of the embedded method: error ~ h^4.
ERROR_ORDER = 4.0


# Relative error of each state that a step may make. Halving the steps takes a sixteenth of it, as the method is of order 4.
TOLERANCE = 1e-6
# States up to which the linear equations of a step are solved as dense ones.
MOST_STATES = 200


def esdirk(system: System, refinement: int = 1) -> Step:
    """Steps of ``system`` whose lengths follow the error; ``refinement`` times shorter ones than `TOLERANCE` asks for.

    Raises ModelError for a model that is not smooth (dry friction, states that are set, a delayed input) and for one of more than
    `MOST_STATES` states.
    """
    obstacles = {
        "dry friction": system.dry,
        "states that are set (play)": system.updates,
        "a delayed input": system.delays,
    }
    if present := [name for name, parts in obstacles.items() if parts]:
        raise ModelError(
            f"steps that follow the error take smooth models, this one has {' and '.join(present)}; use 'rk4'"
        )
    if system.x.numel() > MOST_STATES:
        raise ModelError(
            f"steps that follow the error take up to {MOST_STATES} states, this model has {system.x.numel()}; use 'rk4'"
        )
    rates = make_rate_function(system)
    x, ua, ub, p, h = (
        ca.SX.sym(name, size)
        for name, size in (
            ("x", system.x.numel()),
            ("ua", system.u.numel()),
            ("ub", system.u.numel()),
            ("p", system.p.numel()),
            ("h", 1),
        )
    )
    advance = ca.Function("advance", [x, ua, ub, p, h], [rk4_step(rates)(x, ua, ub, p, h)])
    adaptive = AdaptiveRates(rates, tuple(state.unit for state in system.states), TOLERANCE, system.limits)
    return Step(
        "ESDIRK4(3)", advance, system.output_function, as_coefficients, refinement, implicit=True, adaptive=adaptive
    )
