"""Where a search over segments or by collocation begins: states along the record, and constants without continuity."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from greybox.numerics import FLATTEST_CURVATURE, TINY
from greybox.transcription.arcs import cut_at_rows, slice_rows
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.policy import DEFAULT_POLICY, ProjectionPolicy, RelaxationPolicy, TranscriptionPolicy
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.simulation_error import SingleShooting


def estimate_nodes(
    single: SingleShooting, cuts: Sequence[Sequence[int]], policy: ProjectionPolicy = DEFAULT_POLICY.projection
) -> list[np.ndarray]:
    """States (segments + 1, nx) of each record at its ``cuts`` (first rows of the segments and, at the end, the number of rows).

    A state that is an output is taken as measured to begin with, a hidden one from the end of the segment before; then both are
    estimated from the samples of the segment, with the constants at their start values. A short segment, which a wrong
    constant cannot spoil much, acts as an observer. The state at the end is a copy of the one before it.
    """
    return to_nodes(single, cuts, estimate_arc_states(single, cuts, policy))


def estimate_arc_states(
    single: SingleShooting, cuts: Sequence[Sequence[int]], policy: ProjectionPolicy = DEFAULT_POLICY.projection
) -> ProjectedShooting:
    """The records cut in arcs, with the initial state of each estimated in turn."""
    arcs = cut_at_rows(single, cuts)
    projected = ProjectedShooting(arcs.shooting, policy)
    projected.carry_states(arcs.starts_record)
    return projected


def to_nodes(single: SingleShooting, cuts: Sequence[Sequence[int]], projected: ProjectedShooting) -> list[np.ndarray]:
    """The present initial states of the arcs as nodes of each record; states that begin as declared do so."""
    v, initial = single.variables, projected.variables.initial
    arc_states = initial.guess + initial.scale * projected.own
    nodes, first_arc, is_declared = [], 0, ~v.initial.free
    for e, places in enumerate(cuts):
        states = arc_states[first_arc : first_arc + len(places) - 1]
        states[0, is_declared] = v.initial.guess[e, is_declared]
        nodes.append(np.vstack([states, states[-1:]]))
        first_arc += len(states)
    return nodes


def simulate_segments(
    single: SingleShooting, z: np.ndarray, e: int, cuts: Sequence[int], nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and states (N, nx) of record ``e``, each segment run from its own node."""
    p = single.variables.parameters(z, e)
    q, *_ = single.at(z, p, e)
    pieces = [slice_rows(single.records[e], a, b) for a, b in pairwise(cuts)]
    runs = [single.kernel.simulate(piece, q, p, node) for piece, node in zip(pieces, nodes, strict=False)]
    return np.concatenate([y for y, _ in runs]), np.concatenate([x for _, x in runs])


def fit_without_continuity(
    projected: ProjectedShooting, policy: RelaxationPolicy = DEFAULT_POLICY.relaxation
) -> np.ndarray:
    """Constants (n,) near the best for arcs with initial states of their own, by damped Gauss-Newton steps from the start.

    An arc cannot lose its place in an oscillation, so this search is spared the wrong optima of a long run; its result is good to the
    noise over one arc. The initial states in ``projected`` follow.
    """
    v = projected.variables
    z = np.zeros(projected.size)
    prior = np.where(v.logarithmic, policy.prior_weight, 0.0)
    current = projected.evaluate(z)
    for _ in range(policy.max_steps if np.isfinite(current.cost) else 0):
        for damping in policy.dampings:
            gradient, hessian = current.gradient / 2 + prior * z, current.hessian / 2 + np.diag(prior)
            trial_z = z + compute_bounded_step(v, z, gradient, hessian, damping, policy)
            trial = projected.evaluate(trial_z)
            gain = current.cost + prior @ z**2 - trial.cost - prior @ trial_z**2
            if gain > 0:
                break
        else:
            break
        z, previous, current = trial_z, current, trial
        if gain <= policy.enough_gain * previous.cost:
            break
    projected.evaluate(z)
    return z


def initialise_without_continuity(
    single: SingleShooting, cuts: Sequence[Sequence[int]], policy: TranscriptionPolicy = DEFAULT_POLICY
) -> tuple[DecisionVector, list[np.ndarray]]:
    """Variables with ``z = 0`` at constants fitted without continuity, and states (N, nx) along each record: a start for `Collocation`.

    ``cuts`` of each record as for `estimate_nodes`.
    """
    arcs, v = estimate_arc_states(single, cuts, policy.projection), single.variables
    z = v.here
    z[: arcs.size] = fit_without_continuity(arcs, policy.relaxation)
    nodes = to_nodes(single, cuts, arcs)
    free = v.free_states
    for e in range(v.experiments):
        z[v.columns(e)[arcs.size :]] = (nodes[e][0][free] - v.initial.guess[e, free]) / v.initial.scale[free]
    return v.recentre(z), [simulate_segments(single, z, e, cuts[e], nodes[e])[1] for e in range(v.experiments)]


def compute_bounded_step(
    variables: DecisionVector,
    z: np.ndarray,
    gradient: np.ndarray,
    hessian: np.ndarray,
    damping: float,
    policy: RelaxationPolicy = DEFAULT_POLICY.relaxation,
) -> np.ndarray:
    """The step of the constants (n,) that minimises ``2 g'd + d'H d`` within their bounds and a largest factor.

    ``damping`` is added to the curvatures after scaling; directions without curvature are held.
    """
    n = len(variables.which)
    if n == 0:
        return np.zeros(0)
    from scipy.optimize import lsq_linear  # slow to import, and single shooting does not need it

    low, high = (edge[:n] - z[:n] for edge in variables.bounds())
    reach = np.where(variables.logarithmic, policy.max_log_step, np.inf)
    low, high = np.minimum(np.maximum(low, -reach), 0.0), np.maximum(np.minimum(high, reach), 0.0)
    scale = np.sqrt(np.maximum(np.diag(hessian), TINY))
    values, vectors = np.linalg.eigh(hessian / np.outer(scale, scale))
    values = np.maximum(values, FLATTEST_CURVATURE * values.max()) + damping
    root = np.sqrt(values)[:, None] * vectors.T
    target = -(vectors.T @ (gradient / scale)) / np.sqrt(values)
    is_free = low < high
    step = np.zeros(n)
    if is_free.any():
        bounds = low[is_free] * scale[is_free], high[is_free] * scale[is_free]
        solution = lsq_linear(root[:, is_free], target, bounds, method="bvls", tol=FLATTEST_CURVATURE)
        step[is_free] = solution.x / scale[is_free]
    return step
