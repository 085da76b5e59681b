"""Constants from arcs that need not meet: where a search over joined segments begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.initialisation import estimate_arc_states, simulate_segments, to_nodes
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.single_shooting import SingleShooting

# A step changes a constant by at most a factor e^1.5.
LONGEST = 1.5
# Far enough when a step gains less than this share of the cost; it is only a start.
ENOUGH, STEPS = 1e-2, 15
DAMPING = (0.0, 1e-2, 1.0, 1e2)
# Short arcs may leave a constant open: positive ones are held weakly, a factor e^2 is one standard deviation.
PRIOR = 0.25


def fit_without_continuity(projected: ProjectedShooting) -> np.ndarray:
    """Constants (n,) near the best for arcs with initial states of their own, by damped Gauss-Newton steps from the start.

    An arc cannot lose its place in an oscillation, so this search is spared the wrong optima of a long run; what it finds is
    good to the noise over one arc. The initial states in ``projected`` follow.
    """
    v = projected.variables
    z = np.zeros(projected.size)
    held = np.where(v.logarithmic, PRIOR, 0.0)
    here = projected.evaluate(z)
    for _ in range(STEPS if np.isfinite(here.cost) else 0):
        for damping in DAMPING:
            gradient, hessian = here.gradient / 2 + held * z, here.hessian / 2 + np.diag(held)
            trial = z + compute_bounded_step(v, z, gradient, hessian, damping)
            there = projected.evaluate(trial)
            gain = here.cost + held @ z**2 - there.cost - held @ trial**2
            if gain > 0:
                break
        else:
            break
        z, last, here = trial, here, there
        if gain <= ENOUGH * last.cost:
            break
    projected.evaluate(z)
    return z


def initialise_without_continuity(
    single: SingleShooting, cuts: Sequence[Sequence[int]]
) -> tuple[DecisionVector, list[np.ndarray]]:
    """Variables with ``z = 0`` at the relaxed constants, and states (N, nx) along each record: a start for `Collocation`.

    ``cuts`` of each record as for `estimate_nodes`.
    """
    arcs, v = estimate_arc_states(single, cuts), single.variables
    z = np.zeros(v.size)
    z[: arcs.size] = fit_without_continuity(arcs)
    nodes = to_nodes(single, cuts, arcs)
    own = v.free_states
    for e in range(v.experiments):
        z[v.columns(e)[arcs.size :]] = (nodes[e][0][own] - v.initial.guess[e, own]) / v.initial.scale[own]
    return v.moved(z), [simulate_segments(single, z, e, cuts[e], nodes[e])[1] for e in range(v.experiments)]


def compute_bounded_step(
    variables: DecisionVector, z: np.ndarray, gradient: np.ndarray, hessian: np.ndarray, damping: float
) -> np.ndarray:
    """The step of the constants (n,) that minimises ``2 g'd + d'H d`` within their bounds and a factor e^1.5.

    ``damping`` is added to the curvatures after scaling, directions without curvature are held.
    """
    n = len(variables.which)
    if n == 0:
        return np.zeros(0)
    from scipy.optimize import lsq_linear  # slow to import, and single shooting does not need it

    low, high = (edge[:n] - z[:n] for edge in variables.bounds())
    reach = np.where(variables.logarithmic, LONGEST, np.inf)
    low, high = np.minimum(np.maximum(low, -reach), 0.0), np.maximum(np.minimum(high, reach), 0.0)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    values = np.maximum(values, 1e-14 * values.max()) + damping
    root = np.sqrt(values)[:, None] * vectors.T
    target = -(vectors.T @ (gradient / scale)) / np.sqrt(values)
    free = low < high
    found = np.zeros(n)
    if free.any():
        bounds = low[free] * scale[free], high[free] * scale[free]
        found[free] = lsq_linear(root[:, free], target, bounds, method="bvls", tol=1e-14).x / scale[free]
    return found
