"""Condensing: segments that must meet are eliminated from a least-squares problem; the remaining problem contains only the parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import bmat, coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu

from greybox.numerics import FREE_STATE_CURVATURE, TINY


@dataclass(frozen=True)
class LinearisedSegment:
    """One linearised segment, in scaled states.

    ``residual`` (m,) with ``jacobian`` (m, n + nx) along the constants and its first state; ``ends`` (nx, n + nx) slopes of its last
    state; ``defect`` (nx,) that state minus the first of the next segment. ``tie``, for states that begin as declared: their
    numbers, how far they are from that, and its slope along the constants (k, n).
    """

    residual: np.ndarray
    jacobian: np.ndarray
    ends: np.ndarray
    defect: np.ndarray
    tie: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True)
class CondensedProblem:
    """The quadratic ``cost + 2 g'dz + dz'H dz`` with every node at its best for ``dz``, and the nodes that belong to it.

    ``prior``: what priors of the constants add to the cost, its slope (n,) and its curvature (n,).
    """

    gradient: np.ndarray
    hessian: np.ndarray
    offset: list[np.ndarray]
    slope: list[np.ndarray]
    segments: list[list[LinearisedSegment]]
    prior: tuple[float, np.ndarray | float, np.ndarray | float] = (0.0, 0.0, 0.0)

    def with_penalty(self, cost: float, slope: np.ndarray, curvature: np.ndarray) -> CondensedProblem:
        """The same with priors of the constants."""
        gradient, hessian = self.gradient + slope / 2, self.hessian + np.diag(curvature / 2)
        return replace(self, gradient=gradient, hessian=hessian, prior=(cost, slope, curvature))

    def step(self, dz: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """``dz`` and the steps of the nodes (segments + 1, nx) of each record."""
        return dz, [offset + slope @ dz for offset, slope in zip(self.offset, self.slope, strict=True)]

    def cost_after(self, step: tuple[np.ndarray, list[np.ndarray]]) -> float:
        """Cost of the linearised residuals, and of the priors, after a step."""
        dz, nodes = step
        cost, slope, curvature = self.prior
        residuals = (
            s.residual + s.jacobian[:, : len(dz)] @ dz + s.jacobian[:, len(dz) :] @ ds[k]
            for segments, ds in zip(self.segments, nodes, strict=True)
            for k, s in enumerate(segments)
        )
        return float(sum(r @ r for r in residuals) + cost + np.sum(slope * dz + 0.5 * curvature * dz**2))


def condense(records: list[list[LinearisedSegment]], n: int) -> CondensedProblem | None:
    """Eliminate the nodes of each record from a constrained least-squares problem in the constants (n,) and all nodes.

    With ``K = [[H, C'], [C, 0]]`` over the nodes and their constraints, ``H = R'R`` block diagonal and the constants on the right:
    a sparse factorisation with pivoting, which is stable whether errors grow or decay along the record. None where there is no step,
    as with slopes of a segment so near to overflow that their squares are beyond it.
    """
    gradient, hessian = np.zeros(n), np.zeros((n, n))
    offsets, slopes = [], []
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
        states = (len(segments) + 1) * nx
        nodes = solution[:states].reshape(len(segments) + 1, nx, n + 1)
        offset, slope = nodes[:, :, 0], nodes[:, :, 1:]
        for k, s in enumerate(segments):
            jz, js = s.jacobian[:, :n], s.jacobian[:, n:]
            jacobian = jz + js @ slope[k]
            gradient += jacobian.T @ (s.residual + js @ offset[k])
            hessian += jacobian.T @ jacobian
        offsets.append(offset)
        slopes.append(slope)
    return CondensedProblem(gradient, hessian, offsets, slopes, records)


def _build_system(segments: Sequence[LinearisedSegment], n: int, nx: int) -> tuple[coo_matrix, np.ndarray]:
    """The matrix ``K`` and its right-hand sides (., 1 + n): for the step as it is, and for each constant."""
    count = len(segments)
    states = (count + 1) * nx
    size = states + count * nx + sum(len(s.tie[0]) for s in segments if s.tie)
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
        node, next_node, constraint = k * nx, (k + 1) * nx, states + k * nx
        put(curvatures[k] + regularisation, node, node)
        right[node:next_node, 0] = -s.jacobian[:, n:].T @ s.residual
        right[node:next_node, 1:] = -s.jacobian[:, n:].T @ s.jacobian[:, :n]
        put(s.ends[:, n:], constraint, node, mirrored=True)
        put(-np.eye(nx), constraint, next_node, mirrored=True)
        right[constraint : constraint + nx, 0] = -s.defect
        right[constraint : constraint + nx, 1:] = -s.ends[:, :n]
    put(regularisation, states - nx, states - nx)
    row = states + count * nx
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
