"""Direct collocation: the states at every point of the record are variables, the equations constraints between them.

Over each element the states are a polynomial through its first value and ``degree`` points ``tau_j``, and satisfy the equations
at these points: ``sum_r C_rj x_r = h f(x_j, u_j, p)``. Radau points include the end of the element (order ``2 d - 1``, damps fast
modes: for stiff plants), Legendre points do not (order ``2 d``). Nothing is simulated, so nothing can overflow, and the
states' physical bounds hold as path constraints. Memory grows with the record: for at most some ten thousand samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import AT_BOUND, ModelError, nearest
from greybox.estimation.optim.ipopt import solve_sparse
from greybox.estimation.optim.minimisation import MinimisationResult
from greybox.estimation.options import FitOptions, Hessian
from greybox.estimation.transcription import single_shooting
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.eliminated_states import compute_state_slopes
from greybox.estimation.transcription.problem import (
    EstimationProblem,
    FitProgressCallback,
    ProgressMonitor,
    Runs,
    SegmentedRun,
    Solution,
)
from greybox.estimation.transcription.segments import cut_by_growth, initialise_without_continuity, measure_state_ranges
from greybox.estimation.transcription.select import TranscriptionChoice
from greybox.estimation.transcription.shooting_cost import Evaluation, add_prior_penalty
from greybox.simulation.kernel.record import Record

SCHEMES = ("radau", "legendre")
HESSIANS = tuple(map(str, Hessian))
# Three points are of third order at least, also on stiff equations (Hairer, Wanner, Solving Ordinary Differential Equations II, stage
# order): halving an interval again changes eight times less than halving it once did.
_ORDER = 3
_POINTS = 3
_TITLES = {"radau": "Radau", "legendre": "Legendre"}


def solve_collocation(
    choice: TranscriptionChoice, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """Minimise over the constants and the states at three points of every sampling interval.

    The intervals are halved once, to see what that changes, and again until it changes too little to matter. ``substeps`` of
    the options are the elements of an interval, if given.
    """
    search = _CollocationSearch(choice, options, report)
    policy = options.policy.step_refinement
    # The first solution has halved them once already.
    solution = single_shooting.solve_with_refined_steps(
        choice.problem, search.solve, search.refine, replace(policy, halvings=policy.halvings - 1)
    )
    problem, elements = solution.problem, search.elements
    if not problem.step.per_interval:  # whoever continues with a free run needs steps as fine as these
        problem = solution.at_optimum.with_substeps(max(problem.step.substeps, _POINTS * elements))
    return replace(
        solution,
        problem=problem,
        transcription=str(choice.transcription),
        strategy=choice.to_strategy(held_samples=search.at.held),
        joined=search.join() if solution.status.success else None,
        discretisation=f"collocation, three {_TITLES[search.scheme]} points"
        + (" a sample" if elements == 1 else f" in each of {elements} elements a sample"),
    )


class _CollocationSearch:
    """A search with ever shorter elements, each from the optimum of those twice as long."""

    def __init__(self, choice: TranscriptionChoice, options: FitOptions, report: FitProgressCallback | None) -> None:
        problem = choice.problem
        self.options, self.report = options, report
        self.scheme = choice.transcription.removeprefix("collocation-")
        self.elements, self.is_over = max(options.substeps, 1), False
        self.error: np.ndarray = np.zeros(len(problem.noise.std))
        self.shift: np.ndarray = np.zeros(len(problem.variables.which))
        guess = problem.variables.initial.guess
        start, states = initialise_without_continuity(problem, cut_by_growth(problem))
        # Where no piece of a record can be simulated, its first states stay.
        states = [np.where(np.isfinite(x), x, guess[e]) for e, x in enumerate(states)]
        self.at = self._solve(start, states, self.elements)
        self.work = [self.at.outcome]

    def solve(self, problem: EstimationProblem) -> Solution:
        """The optimum with half the elements' length, and what the halving changed."""
        self.is_over = not self.at.outcome.status.success
        if not self.is_over:
            finer = self._solve(self.at.problem, self.at.states, 2 * self.elements)
            self.work.append(finer.outcome)
            self.is_over = not finer.outcome.status.success or bool(self.options.substeps)
            if finer.outcome.status.success:
                before, after = self.at.problem.variables, finer.problem.variables
                self.error = single_shooting.compute_change_over_noise(problem, self.at.simulate(), finer.simulate())
                self.shift = (after.base - before.base) / after.spans
            if not self.is_over:
                self.at, self.elements = finer, 2 * self.elements
                # Halving again changes 2^order times less: that is what is left.
                self.error, self.shift = self.error / 2.0**_ORDER, self.shift / 2.0**_ORDER
        work, self.work = self.work, []
        outcome, problem = self.at.outcome, self.at.problem
        return Solution(
            problem,
            problem.variables,
            self.at.evaluation,
            outcome.status,
            outcome.solver_status,
            sum(w.iterations for w in work),
            sum(w.evaluations for w in work),
            sum(w.seconds for w in work),
            (1.0,),
            self.error,
            solver=outcome.solver,
        )

    def refine(self, solution: Solution) -> single_shooting.Refinement:
        """The same problem, if shorter elements are needed."""
        substeps = _POINTS * self.elements
        is_coarse = not self.is_over and single_shooting.is_too_coarse(
            self.error, solution.problem, solution.evaluation, substeps
        )
        return solution.problem if is_coarse else None, self.error

    def join(self) -> SegmentedRun:
        """The collocated run."""
        return SegmentedRun(self.at.simulate(), self.at.rows, self.at.problem.variables.size, self.shift)

    def _solve(self, problem: EstimationProblem, states: Sequence[np.ndarray], elements: int) -> _CollocationPoint:
        program = Collocation(problem, states, scheme=self.scheme, elements=elements, hessian=self.options.hessian)
        monitor = ProgressMonitor(problem, self.report)
        outcome = solve_sparse(**program.problem(), iterations=self.options.iterations, progress=monitor)
        point = program.interpret(outcome.z)
        at, reached = replace(problem, variables=point.variables), (point.states, point.at_bound)
        if not outcome.status.success:
            free_run = at.with_plain_squares().shooting()
            return _CollocationPoint(outcome, at, *reached, free_run.evaluate(at.variables.here), ())
        return _CollocationPoint(outcome, at, *reached, *program.linearise(outcome.z))


@dataclass(frozen=True)
class _CollocationPoint:
    """What a solver ended with: the states (N, nx) of each record and, if it succeeded, the problem linearised there."""

    outcome: MinimisationResult
    problem: EstimationProblem
    states: Sequence[np.ndarray]
    held: int
    evaluation: Evaluation
    rows: Runs

    def simulate(self) -> Runs:
        """Outputs and states at the rows of each record."""
        output, v, runs = self.problem.model.system.output_function, self.problem.variables, []
        for e, (record, x) in enumerate(zip(self.problem.records, self.states, strict=True)):
            runs.append((output(x.T, record.u.T, v.parameters(v.here, e)).full().T, x))
        return tuple(runs)


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
    problem
        The problem; nothing of its discrete step is used.
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
        problem: EstimationProblem,
        start: Sequence[np.ndarray],
        *,
        scheme: str = "radau",
        degree: int = 3,
        elements: int = 1,
        hessian: str = "gauss-newton",
    ) -> None:
        if scheme not in SCHEMES:
            raise ModelError(f"unknown collocation points {scheme!r}; {nearest(scheme, SCHEMES)}")
        if hessian not in HESSIANS:
            raise ModelError(f"unknown Hessian {hessian!r}; {nearest(hessian, HESSIANS)}")
        if not 1 <= degree <= 9:
            raise ModelError(f"collocation of degree {degree}: give 1 to 9 points an element")
        if elements < 1:
            raise ModelError(f"{elements} collocation elements a sample: give at least 1")
        system = problem.model.system
        kinks = [*(d.effect for d in system.dry), *(s.effect for s in system.updates)]
        if kinks:
            raise ModelError(
                f"direct collocation needs smooth equations, but {', '.join(kinks)} sticks or switches; use single or multiple shooting"
            )
        if system.delays:
            names = ", ".join(d.effect for d in system.delays)
            raise ModelError(f"direct collocation cannot delay an input yet ({names}); use single or multiple shooting")
        self.variables, self.records, self.weight = problem.variables, problem.records, 1 / problem.noise.std
        self.scheme, self.degree, self.elements, self.exact = scheme, degree, elements, hessian == "exact"
        self.start = [np.asarray(x, float) for x in start]
        self.scale = measure_state_ranges(np.concatenate(self.start))
        self.nx = len(self.scale)

    def problem(self) -> dict[str, Any]:
        """The program as keyword arguments of `greybox.estimation.optim.ipopt.solve_sparse`: ``nlp`` (x, f, g as MX), ``start``, ``low``,
        ``high``, ``hessian``; every constraint is an equation ``g = 0``."""
        w, r, g = self._build_expressions()
        v, n = self.variables, len(self.variables.which)
        # What is known of the constants without the records, as further residuals.
        priors = [
            (self._constant_expression(w, int(k)) - v.prior[k, 0]) / v.prior[k, 1] for k in np.flatnonzero(v.has_prior)
        ]
        r = ca.vertcat(r, ca.vertcat(*priors, ca.MX(0, 1)))
        # States start on straight lines between the samples of the start, within their bounds.
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
        start, low, high = (np.concatenate(parts) for parts in (starts, lows, highs))
        # Over chi-square of a model that stands still the cost is of order one, and so are its derivatives.
        y = np.concatenate([record.y for record in self.records]) * self.weight
        y = y[:, np.isfinite(y).any(axis=0)]
        cost, scale = ca.sumsqr(r), float(np.nansum(np.square(y - np.nanmean(y, axis=0)))) or 1.0
        curvature = None
        if not self.exact:
            slopes = ca.jacobian(r, w)
            by, lam = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
            # 2 J'J of sum r^2: the equations and the residuals count as straight.
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
        # dr/dz = r_z + r_x dx/dz, every state at its best for the constants.
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
        v.split(z).parameters[:] = w[:n]
        edges = np.array([s.bounds for s in v.model.all_states], float).T
        for record in self.records:
            nodes, count = self._count_nodes(record), self._inner_size * len(record.h)
            node_states = w[position : position + nodes * self.nx].reshape(nodes, self.nx)
            points = w[position + node_states.size : position + node_states.size + count].reshape(
                len(record.h), self._inner_size
            )
            x = (node_states if nodes > 1 else np.vstack([node_states, points[:, -self.nx :]])) * self.scale
            states.append(x)
            held += int((np.abs(x[:, None, :] - edges) <= AT_BOUND * self.scale).any(axis=(1, 2)).sum())
            position += node_states.size + count
        z = v.place_initial_states(z, np.array([x[0] for x in states]))
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
        # All parameters as expressions of the scaled constants, as `DecisionVector.parameters` computes them.
        values = [ca.MX(value) for value in v.fixed]
        for k in np.flatnonzero(~v.is_foreign(e)):
            values[v.which[k]] = self._constant_expression(z, int(k))
        for place, value in (v.conditions[e] if v.conditions else {}).items():
            values[place] = ca.MX(value)
        p, count = ca.vertcat(*values), len(record.h)
        nodes = first if first.size2() > 1 else ca.horzcat(first, points[-self.nx :, :])
        u, after = ca.DM(record.u.T), ca.DM(record.find_ends(np.arange(count)).T)
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
        # Residuals (y - yhat) / s of the rows that were measured.
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
            # h dx/dt at the points is the derivative of the polynomial through them: sum_r C_rj x_r.
            rates = x_element @ slope
            for j in range(d):
                # A straight line for a first-order hold, constant otherwise (ua = ub).
                u = ua + (ub - ua) * ((k + tau[j]) / m)
                equations.append(rates[:, j] - h / m * rhs(x_points[:, j] * self.scale, u, p) / self.scale)
            x_start = x_points[:, -1] if self.scheme == "radau" else x_element @ end
        return ca.Function("interval", [x, points, ua, ub, h, p], [ca.vertcat(*equations), x_start], {"cse": True})

    def _constant_expression(self, z: ca.MX, k: int) -> ca.MX:
        v = self.variables
        return v.base[k] * ca.exp(z[k]) if v.logarithmic[k] else v.base[k] + v.scale[k] * z[k]
