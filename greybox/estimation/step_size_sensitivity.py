"""One Gauss-Newton step from the optimum: the last digits of the constants, and what half the integrator's step does to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.transcription import DecisionVector
from greybox.transcription.policy import ConvergencePolicy
from greybox.transcription.simulation_error import compute_gauss_newton_step
from greybox.transcription.solution import Solution


def polish_by_gauss_newton(solution: Solution, policy: ConvergencePolicy) -> Solution:
    """``solution`` of free runs after some plain Gauss-Newton steps, each kept only if it lowers the cost.

    With a robust loss they are steps of reweighted least squares, each nearer by about the same share: there are more of them.
    """
    problem, evaluation = solution.problem, solution.evaluation
    if solution.joined or not solution.status.success or not solution.variables.size:
        return solution
    variables, passes = solution.variables, 0
    for _ in range(policy.polishing_steps if problem.loss is None else policy.robust_polishing_steps):
        moved = variables.recentre(_clip_to_bounds(variables, compute_gauss_newton_step(variables, evaluation)))
        after = problem.shooting(moved).evaluate(moved.here)
        passes += 1
        if not after.cost < evaluation.cost:
            break
        variables, evaluation = moved, after
    return replace(solution, variables=variables, evaluation=evaluation, evaluations=solution.evaluations + passes)


def measure_discretisation_shift(solution: Solution, deviations: np.ndarray) -> np.ndarray:
    """Change of each free constant (nf,) when the step is halved, over its standard deviation (``deviations`` (nf,)).

    Zero for a discretisation that is exact. NaN where the finer run overflows or the deviation is unknown. The Gauss-Newton steps
    at the present step and at half of it are compared, so that what the search has left over does not count.
    """
    problem, variables = solution.problem, solution.variables
    n = len(variables.which)
    if solution.joined:
        change = solution.joined.shift
    elif problem.step.per_interval or not n:
        return np.zeros(n)
    else:
        halved = problem.with_step(2 * problem.step.substeps, variables.fixed)
        finer = halved.shooting(variables).evaluate(variables.here)
        if not (np.isfinite(finer.cost) and np.isfinite(solution.evaluation.cost)):
            return np.full(n, np.nan)
        change = compute_gauss_newton_step(variables, finer) - compute_gauss_newton_step(variables, solution.evaluation)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.abs(change[:n] * variables.spans) / deviations


def _clip_to_bounds(variables: DecisionVector, step: np.ndarray) -> np.ndarray:
    """``step`` shortened to the bounds, entry by entry."""
    low, high = variables.bounds()
    return np.clip(step, np.minimum(low, 0.0), np.maximum(high, 0.0))
