"""Condensing: segments that must meet are eliminated from a least-squares problem; the remaining problem contains only the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bmat, coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from greybox.base.numerics import FREE_STATE_CURVATURE, TINY
from greybox.estimation.optim.quadratic_model import QuadraticModel


@dataclass(frozen=True)
class LinearisedSegment:
    """One linearised segment, in scaled states.

    ``residual`` (m,) with ``jacobian`` (m, n + nx) along the constants and its first state; ``ends`` (nx, n + nx) slopes of its last
    state; ``defect`` (nx,) that state minus the first of the next segment (zero after the last one). ``tie``, for states that begin
    as declared: their numbers, how far they are from that, and its slope along the constants (k, n).
    """

    residual: np.ndarray
    jacobian: np.ndarray
    ends: np.ndarray
    defect: np.ndarray
    tie: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class CondensedProblem(QuadraticModel):
    """The model of the cost along the constants, with every segment's first state at its best for them."""

    offset: np.ndarray
    """Step of the first states (segments, nx) where the constants stay."""

    slope: np.ndarray
    """How they follow the constants (segments, nx, n)."""

    segments: Sequence[LinearisedSegment]
    """What was condensed."""

    def step(self, dz: np.ndarray) -> np.ndarray:
        """``dz`` and the step of the first states that belongs to it."""
        return np.concatenate([dz, (self.offset + self.slope @ dz).ravel()])

    def cost_after(self, step: np.ndarray) -> float:
        """Cost of the linearised residuals after a step."""
        dz, states = np.split(step, [self.slope.shape[2]])
        pairs = zip(self.segments, states.reshape(self.offset.shape), strict=True)
        residuals = (s.residual + s.jacobian @ np.concatenate([dz, ds]) for s, ds in pairs)
        return float(sum(r @ r for r in residuals))


def condense(records: Sequence[Sequence[LinearisedSegment]], n: int) -> CondensedProblem | None:
    """Eliminate the first states of the segments from a constrained least-squares problem in the constants (n,) and all of them.

    With ``K = [[H, C'], [C, 0]]`` over the first states and their constraints, ``H = R'R`` block diagonal and the constants on the right:
    a sparse factorisation with pivoting, which is stable whether errors grow or decay along the record. None where there is no step,
    as with slopes of a segment so near to overflow that their squares are beyond it.
    """
    solutions = []
    for segments in records:
        nx = len(segments[0].defect)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix, right = _build_system(segments, n, nx)
        try:
            factors = splu(matrix)
        except RuntimeError:  # SuperLU: "Factor is exactly singular"
            return None
        solution = factors.solve(right)
        if not np.isfinite(solution).all():
            return None
        solutions.append(solution[: len(segments) * nx].reshape(len(segments), nx, n + 1))
    states, flat = np.concatenate(solutions), [s for segments in records for s in segments]
    offset, slope = states[:, :, 0], states[:, :, 1:]
    cost, gradient, hessian = 0.0, np.zeros(n), np.zeros((n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        for k, s in enumerate(flat):
            jz, js = s.jacobian[:, :n], s.jacobian[:, n:]
            residual, jacobian = s.residual + js @ offset[k], jz + js @ slope[k]
            cost += float(residual @ residual)
            gradient += 2 * jacobian.T @ residual
            hessian += 2 * jacobian.T @ jacobian
    if not (np.isfinite(cost) and np.isfinite(hessian).all()):
        return None
    return CondensedProblem(cost, gradient, hessian, offset, slope, flat)


def _build_system(segments: Sequence[LinearisedSegment], n: int, nx: int) -> tuple[csc_matrix, np.ndarray]:
    """The matrix ``K`` and its right-hand sides (., 1 + n): for the step as it is, and for each constant."""
    count = len(segments)
    states, joints = count * nx, (count - 1) * nx
    size = states + joints + sum(len(s.tie[0]) for s in segments if s.tie)
    right = np.zeros((size, n + 1))
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    entries: list[np.ndarray] = []

    def put(block: np.ndarray, row: int, column: int, mirrored: bool = False) -> None:
        i, j = np.indices(block.shape)
        for a, b, values in ((i + row, j + column, block), *(((j + column, i + row, block),) if mirrored else ())):
            rows.append(a.ravel())
            columns.append(b.ravel())
            entries.append(values.ravel())

    curvatures = [s.jacobian[:, n:].T @ s.jacobian[:, n:] for s in segments]
    regularisation = FREE_STATE_CURVATURE * np.mean([np.diag(c) for c in curvatures], axis=0)
    regularisation = np.diag(
        np.where(
            regularisation > 0, regularisation, FREE_STATE_CURVATURE * max(float(regularisation.max(initial=0.0)), 1.0)
        )
    )
    for k, s in enumerate(segments):
        node, next_node, joint = k * nx, (k + 1) * nx, states + k * nx
        put(curvatures[k] + regularisation, node, node)
        right[node:next_node, 0] = -s.jacobian[:, n:].T @ s.residual
        right[node:next_node, 1:] = -s.jacobian[:, n:].T @ s.jacobian[:, :n]
        if k + 1 < count:  # it ends where the next one begins
            put(s.ends[:, n:], joint, node, mirrored=True)
            put(-np.eye(nx), joint, next_node, mirrored=True)
            right[joint : joint + nx, 0] = -s.defect
            right[joint : joint + nx, 1:] = -s.ends[:, :n]
    row = states + joints
    for k, s in enumerate(segments):
        if s.tie:
            which, distance, slope = s.tie
            put(np.eye(nx)[which], row, k * nx, mirrored=True)
            right[row : row + len(which), 0] = distance
            right[row : row + len(which), 1:] = slope
            row += len(which)
    places = np.concatenate(rows), np.concatenate(columns)
    return coo_matrix((np.concatenate(entries), places), (size, size)).tocsc(), right


def compute_state_slopes(
    along: csc_matrix, states: csc_matrix, equations: csc_matrix, constraints: csc_matrix
) -> np.ndarray:
    """How states (ns, n) that satisfy linearised equations follow the constants, at their best for the residuals.

    The least ``|along dz + states dx|^2`` with ``equations dz + constraints dx = 0``: residuals (m, n) and (m, ns), equations (k, n) and
    (k, ns). Directions that no residual shows are held back a little, as in `condense`.
    """
    curvature = (states.T @ states).tocsc()
    diagonal = curvature.diagonal()
    regularisation = FREE_STATE_CURVATURE * max(float(diagonal.mean()) if diagonal.any() else 1.0, TINY)
    matrix = bmat(
        [[curvature + regularisation * diags(np.ones(len(diagonal))), constraints.T], [constraints, None]], format="csc"
    )
    right = -np.vstack([(states.T @ along).toarray(), equations.toarray()])
    return splu(matrix).solve(right)[: len(diagonal)]
