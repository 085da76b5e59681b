"""Direct collocation: the states at every point of the record are variables, the equations constraints between them.

Over each element the states are a polynomial through its first value and ``degree`` points ``tau_j``, and satisfy the equations
at these points: ``sum_r C_rj x_r = h f(x_j, u_j, p)``. Radau points include the end of the element (order ``2 d - 1``, damps fast
modes: for stiff plants), Legendre points do not (order ``2 d``). Nothing is simulated, so nothing can overflow, and the
states' physical bounds hold as path constraints. Memory grows with the record: for at most some ten thousand samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.errors import ModelError, nearest
from greybox.kernel import Record
from greybox.numerics import AT_BOUND, CONSTANT_STATE
from greybox.transcription.condensing import compute_state_slopes
from greybox.transcription.decision_vector import DecisionVector
from greybox.transcription.simulation_error import Evaluation, add_prior_penalty

SCHEMES = ("radau", "legendre")
HESSIANS = ("gauss-newton", "exact")


@dataclass(frozen=True)
class CollocationResult:
    """What a solution of the program means."""

    variables: DecisionVector
    """The decision vector with ``z = 0`` at the solution."""

    states: tuple[np.ndarray, ...]
    """States (N, nx) of each record at its samples."""

    at_bound: int = 0
    """Samples at which a state lies at one of its bounds."""


class Collocation:
    """The sparse nonlinear program of a fit by direct collocation.

    The program is ``problem()``; a solver's answer becomes a `CollocationResult` by ``interpret(w)``.

    Parameters
    ----------
    variables, records, weight
        As for `SingleShooting`.
    start
        States (N, nx) of each record to begin with, see `initialise_without_continuity`.
    scheme
        ``radau`` or ``legendre`` points.
    degree
        Points in each element, 1 to 9.
    elements
        Elements in each sampling interval.
    hessian
        ``gauss-newton`` leaves out the curvature of residuals and constraints (right where the misfit is small, and safe far from the
        optimum), ``exact`` does not.

    Raises
    ------
    ModelError
        For equations that are not smooth (dry friction, states that are set after each step), for a delayed input, and for an
        unknown scheme or Hessian.
    """

    def __init__(
        self,
        variables: DecisionVector,
        records: Sequence[Record],
        weight: np.ndarray,
        start: Sequence[np.ndarray],
        *,
        scheme: str = "radau",
        degree: int = 3,
        elements: int = 1,
        hessian: str = "gauss-newton",
    ) -> None:
        _check_options(variables, scheme, degree, elements, hessian)
        self.variables, self.records, self.weight = variables, tuple(records), weight
        self.scheme, self.degree, self.elements, self.exact = scheme, degree, elements, hessian == "exact"
        self.start = [np.asarray(x, float) for x in start]
        together = np.concatenate(self.start)
        spread, size = np.ptp(together, axis=0), np.abs(together).max(axis=0)
        self.scale = np.where(spread > CONSTANT_STATE * size, spread, np.where(size > 0, size, 1.0))
        self.nx = together.shape[1]

    def problem(self) -> dict[str, Any]:
        """The program as keyword arguments of `greybox.optim.solve_sparse`: ``nlp`` (x, f, g as MX), ``start``, ``low``, ``high``,
        ``hessian``; every constraint is an equation ``g = 0``."""
        w, r, g = self._build_expressions()
        r = ca.vertcat(r, self._prior_residuals(w[: len(self.variables.which)]))
        start, low, high = self._start_and_bounds()
        cost, scale = ca.sumsqr(r), self._cost_of_standstill()
        curvature = None
        if not self.exact:
            slopes = ca.jacobian(r, w)
            by, lam = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
            gauss_newton = ca.triu(2 * by / scale * (slopes.T @ slopes))
            curvature = ca.Function("nlp_hess_l", [w, ca.MX(0, 1), by, lam], [gauss_newton])
        nlp = {"x": w, "f": cost / scale, "g": g}
        return {"nlp": nlp, "start": start, "low": low, "high": high, "hessian": curvature, "scale": scale}

    def linearise(self, w: np.ndarray) -> tuple[Evaluation, tuple[tuple[np.ndarray, np.ndarray], ...]]:
        """The problem linearised at a point ``w`` that satisfies the equations.

        The cost, and the weighted residuals (N, ny) of each record with their Jacobian (N, ny, L) along `DecisionVector.columns`: every
        state at its best for the constants, so that the columns of the initial states are zero. Bounds of states do not count in it.
        """
        n, ny = len(self.variables.which), len(self.weight)
        x, r, g = self._build_expressions()
        values = ca.Function("linearised", [x], [r, ca.jacobian(r, x), ca.jacobian(g, x)])(w)
        residual = values[0].full().ravel()
        along, equations = (m.sparse()[:, :n].tocsc() for m in values[1:])
        states, constraints = (m.sparse()[:, n:].tocsc() for m in values[1:])
        slopes = along.toarray() + states @ compute_state_slopes(along, states, equations, constraints)
        rows, first = [], 0
        squares, counts = np.zeros(ny), np.zeros(ny, int)
        for record in self.records:
            is_measured = np.isfinite(record.y)
            in_record = slice(first, first + int(is_measured.sum()))
            record_residual = np.full(record.y.shape, np.nan)
            record_residual[is_measured] = residual[in_record]
            jacobian = np.full((*record.y.shape, n + len(self.variables.free_states)), np.nan)
            jacobian[is_measured] = np.pad(slopes[in_record], ((0, 0), (0, len(self.variables.free_states))))
            rows.append((record_residual, jacobian))
            squares += np.nansum(record_residual**2, axis=0)
            counts += is_measured.sum(axis=0)
            first = in_record.stop
        size = self.variables.size
        gradient, hessian = np.zeros(size), np.zeros((size, size))
        gradient[:n], hessian[:n, :n] = 2 * slopes.T @ residual, 2 * slopes.T @ slopes
        evaluation = Evaluation(float(residual @ residual), gradient, hessian, squares, counts)
        return add_prior_penalty(self.variables, w, evaluation), tuple(rows)

    def interpret(self, w: np.ndarray) -> CollocationResult:
        """What a point ``w`` of the program means."""
        v, n = self.variables, len(self.variables.which)
        z, states, position, held = v.here, [], n, 0
        z[:n] = w[:n]
        edges = np.array([s.bounds for s in v.model.all_states], float).T
        for e, record in enumerate(self.records):
            nodes, count = self._count_nodes(record), self._inner_size * len(record.h)
            node_states = w[position : position + nodes * self.nx].reshape(nodes, self.nx)
            points = w[position + node_states.size : position + node_states.size + count].reshape(
                len(record.h), self._inner_size
            )
            x = (node_states if nodes > 1 else np.vstack([node_states, points[:, -self.nx :]])) * self.scale
            free = v.free_states
            z[v.columns(e)[n:]] = (x[0, free] - v.initial.guess[e, free]) / v.initial.scale[free]
            states.append(x)
            held += int((np.abs(x[:, None, :] - edges) <= AT_BOUND * self.scale).any(axis=(1, 2)).sum())
            position += node_states.size + count
        return CollocationResult(v.recentre(z), tuple(states), held)

    def _build_expressions(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """All variables, all residuals, all equations."""
        z = ca.MX.sym("z", len(self.variables.which))
        columns, residuals, constraints = [z], [], []
        for e, record in enumerate(self.records):
            first = ca.MX.sym("x", self.nx, self._count_nodes(record))
            points = ca.MX.sym("points", self._inner_size, len(record.h))
            columns += [ca.vec(first), ca.vec(points)]
            r, g = self._build_record(z, first, points, e)
            residuals.append(r)
            constraints += g
        return ca.vertcat(*columns), ca.vertcat(*residuals), ca.vertcat(*constraints)

    def _cost_of_standstill(self) -> float:
        """Chi-square of a model that stands still: the cost over it is of order one, and so are its derivatives."""
        y = np.concatenate([r.y for r in self.records]) * self.weight
        y = y[:, np.isfinite(y).any(axis=0)]
        total = np.nansum(np.square(y - np.nanmean(y, axis=0)))
        return float(total) or 1.0

    @property
    def _inner_size(self) -> int:
        """Unknowns at the points of one interval."""
        return self.nx * self.degree * self.elements

    def _count_nodes(self, record: Record) -> int:
        """Samples whose states are variables of their own: with Radau points the end of an interval is its last point."""
        return 1 if self.scheme == "radau" else len(record.u)

    def _build_record(self, z: ca.MX, first: ca.MX, points: ca.MX, e: int) -> tuple[ca.MX, list[ca.MX]]:
        """Weighted residuals of one record where it was measured, and the equations that its states must satisfy."""
        v, record, system = self.variables, self.records[e], self.variables.model.system
        p, count = self._parameter_expressions(z, e), len(record.h)
        nodes = first if first.size2() > 1 else ca.horzcat(first, points[-self.nx :, :])
        u = ca.DM(record.u.T)
        after = u[:, 1:] if record.first_order else u[:, :-1]
        interval = self._build_interval().map(count)
        defects, ends = interval(nodes[:, :-1], points, u[:, :-1], after, ca.DM(record.h).T, ca.repmat(p, 1, count))
        constraints = [ca.vec(defects)]
        if self.scheme == "legendre":
            constraints.append(ca.vec(nodes[:, 1:] - ends))
        declared_states = np.flatnonzero(~v.initial.free)
        if len(declared_states):  # states that begin as declared, perhaps by the constants
            declared_start = system.start_function(p)[0]
            constraints.append((nodes[:, 0] - declared_start / ca.DM(self.scale))[declared_states.tolist()])
        x, v_u, v_p = ca.SX.sym("x", self.nx), ca.SX.sym("u", system.u.numel()), ca.SX.sym("p", system.p.numel())
        outputs = ca.Function("y", [x, v_u, v_p], [system.output_function(x * self.scale, v_u, v_p) * self.weight])
        model = ca.vec(outputs.map(count + 1)(nodes, u, ca.repmat(p, 1, count + 1)))
        measured = (record.y * self.weight).ravel()
        is_measured = np.flatnonzero(np.isfinite(measured))
        return measured[is_measured] - model[is_measured.tolist()], constraints

    def _build_interval(self) -> ca.Function:
        """``(x, points, ua, ub, h, p) -> (equations at the points, state at the end)`` of one sampling interval, states scaled."""
        system, d, m, nx = self.variables.model.system, self.degree, self.elements, self.nx
        tau = ca.collocation_points(d, self.scheme)
        slope, end, _ = ca.collocation_coeff(tau)
        rhs = ca.Function("rhs", [system.x, system.u, system.p], [system.rhs])
        x, points, h = ca.SX.sym("x", nx), ca.SX.sym("points", self._inner_size), ca.SX.sym("h")
        nu, p = system.u.numel(), ca.SX.sym("p", system.p.numel())
        ua, ub = ca.SX.sym("ua", nu), ca.SX.sym("ub", nu)
        x_start, equations = x, []
        for k in range(m):
            x_points = ca.reshape(points[k * nx * d : (k + 1) * nx * d], nx, d)
            x_element = ca.horzcat(x_start, x_points)
            rates = x_element @ slope
            for j in range(d):
                u = ua + (ub - ua) * ((k + tau[j]) / m)
                equations.append(rates[:, j] - h / m * rhs(x_points[:, j] * self.scale, u, p) / self.scale)
            x_start = x_points[:, -1] if self.scheme == "radau" else x_element @ end
        return ca.Function("interval", [x, points, ua, ub, h, p], [ca.vertcat(*equations), x_start], {"cse": True})

    def _parameter_expressions(self, z: ca.MX, e: int) -> ca.MX:
        """All parameters as expressions of the scaled constants, as `DecisionVector.parameters` computes them."""
        v = self.variables
        p = [ca.MX(value) for value in v.fixed]
        for k in np.flatnonzero(~v.is_foreign(e)):
            p[v.which[k]] = self._constant_expression(z, int(k))
        for place, value in (v.conditions[e] if v.conditions else {}).items():
            p[place] = ca.MX(value)
        return ca.vertcat(*p)

    def _constant_expression(self, z: ca.MX, k: int) -> ca.MX:
        v = self.variables
        return v.base[k] * ca.exp(z[k]) if v.logarithmic[k] else v.base[k] + v.scale[k] * z[k]

    def _prior_residuals(self, z: ca.MX) -> ca.MX:
        """What is known of the constants without the records, as further residuals."""
        v = self.variables
        with_prior = np.flatnonzero(v.has_prior)
        return ca.vertcat(
            *[(self._constant_expression(z, int(k)) - v.prior[k, 0]) / v.prior[k, 1] for k in with_prior], ca.MX(0, 1)
        )

    def _start_and_bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start and bounds of all variables; states start on straight lines between the samples of ``start``."""
        v, n = self.variables, len(self.variables.which)
        low, high = (edge[:n] for edge in v.bounds())
        starts, lows, highs = [np.zeros(n)], [low], [high]
        edges = np.array([s.bounds for s in v.model.all_states], float).T / self.scale
        tau = np.array(ca.collocation_points(self.degree, self.scheme))
        inside = np.concatenate([(k + tau) / self.elements for k in range(self.elements)])
        for record, x in zip(self.records, self.start, strict=True):
            x = x / self.scale
            points = x[:-1, None, :] + inside[:, None] * (x[1:] - x[:-1])[:, None, :]
            record_start = np.concatenate([x[: self._count_nodes(record)].ravel(), points.ravel()])
            repetitions = len(record_start) // self.nx
            starts.append(np.clip(record_start, np.tile(edges[0], repetitions), np.tile(edges[1], repetitions)))
            lows.append(np.tile(edges[0], repetitions))
            highs.append(np.tile(edges[1], repetitions))
        return np.concatenate(starts), np.concatenate(lows), np.concatenate(highs)


def _check_options(variables: DecisionVector, scheme: str, degree: int, elements: int, hessian: str) -> None:
    system = variables.model.system
    if scheme not in SCHEMES:
        raise ModelError(f"unknown collocation points {scheme!r}; {nearest(scheme, SCHEMES)}")
    if hessian not in HESSIANS:
        raise ModelError(f"unknown Hessian {hessian!r}; {nearest(hessian, HESSIANS)}")
    if not 1 <= degree <= 9:
        raise ModelError(f"collocation of degree {degree}: give 1 to 9 points an element")
    if elements < 1:
        raise ModelError(f"{elements} collocation elements a sample: give at least 1")
    kinks = [*(d.effect for d in system.dry), *(s.effect for s in system.updates)]
    if kinks:
        raise ModelError(
            f"direct collocation needs smooth equations, but {', '.join(kinks)} sticks or switches; use single or multiple shooting"
        )
    if system.delays:
        names = ", ".join(d.effect for d in system.delays)
        raise ModelError(f"direct collocation cannot delay an input yet ({names}); use single or multiple shooting")
