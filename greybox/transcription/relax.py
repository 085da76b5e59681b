"""Constants from arcs that need not meet: where a search over joined segments begins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from greybox.transcription.guess import nodes_of, run_pieces, settled
from greybox.transcription.projected import ProjectedShooting
from greybox.transcription.shooting import SingleShooting
from greybox.transcription.variables import Variables

# A step changes a constant by at most a factor e^1.5.
LONGEST = 1.5
# Far enough when a step gains less than this share of the cost; it is only a start.
ENOUGH, STEPS = 1e-2, 15
DAMPING = (0.0, 1e-2, 1.0, 1e2)
# Short arcs may leave a constant open: positive ones are held weakly, a factor e^2 is one standard deviation.
PRIOR = 0.25


def relaxed(projected: ProjectedShooting) -> np.ndarray:
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
            trial = z + bounded_step(v, z, gradient, hessian, damping)
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


def relaxed_start(single: SingleShooting, cuts: Sequence[Sequence[int]]) -> tuple[Variables, list[np.ndarray]]:
    """Variables with ``z = 0`` at the relaxed constants, and states (N, nx) along each record: a start for `Collocation`.

    ``cuts`` of each record as for `guess_nodes`.
    """
    arcs, v = settled(single, cuts), single.variables
    z = np.zeros(v.size)
    z[: arcs.size] = relaxed(arcs)
    nodes = nodes_of(single, cuts, arcs)
    own = v.states_each
    for e in range(v.experiments):
        z[v.columns(e)[arcs.size :]] = (nodes[e][0][own] - v.initial.guess[e, own]) / v.initial.scale[own]
    return v.moved(z), [run_pieces(single, z, e, cuts[e], nodes[e])[1] for e in range(v.experiments)]


def bounded_step(
    variables: Variables, z: np.ndarray, gradient: np.ndarray, hessian: np.ndarray, damping: float
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
