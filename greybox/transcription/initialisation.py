"""Where a search over segments or by collocation begins: states along the record, and constants without continuity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from greybox.optim.gauss_newton import run_gauss_newton
from greybox.optim.minimisation import Minimisation
from greybox.optim.policy import DEFAULT_POLICY as MINIMISATION
from greybox.optim.termination import Termination
from greybox.transcription.policy import DEFAULT_POLICY, RelaxationPolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.projected_initial_states import ProjectedShooting
from greybox.transcription.segments import Cuts, SegmentedProblem
from greybox.transcription.simulation_error import Evaluation


def estimate_segment_states(segmented: SegmentedProblem) -> ProjectedShooting:
    """The cost of the segments with the initial state of each estimated in turn, the constants at their start values.

    A state that is an output is taken as measured to begin with, a hidden one from the end of the segment before; then both are
    estimated from the samples of the segment. A short segment, which a wrong constant cannot spoil much, acts as an observer.
    """
    pieces = segmented.pieces.with_plain_squares()
    projected = ProjectedShooting(pieces.shooting(), pieces.policy.transcription.projection)
    projected.carry_states(segmented.starts_record)
    return projected


def fit_without_continuity(
    projected: ProjectedShooting, policy: RelaxationPolicy = DEFAULT_POLICY.relaxation
) -> np.ndarray:
    """A point of the variables near the best for segments that need not meet, by damped Gauss-Newton steps from the start.

    A segment cannot lose its place in an oscillation, so this search is spared the wrong optima of a long run; its result is good to
    the noise over one segment.
    """
    v, start = projected.variables, np.zeros(projected.size)
    precision = np.where(v.logarithmic, policy.prior_weight, 0.0)
    reach = np.where(v.logarithmic, policy.max_log_change, np.inf)
    low, high = projected.bounds()

    def evaluate(z: np.ndarray) -> Evaluation:
        e = projected.evaluate(z)
        cost, hessian = e.cost + precision @ z**2, e.hessian + np.diag(2 * precision)
        return replace(e, cost=cost, gradient=e.gradient + 2 * precision * z, hessian=hessian)

    low, high = np.minimum(np.maximum(low, -reach), 0.0), np.maximum(np.minimum(high, reach), 0.0)
    search = Minimisation(evaluate, 1.0, Termination(policy.termination, low, high, 1).test, None, MINIMISATION)
    if np.isfinite(search(start).cost) and not search.test_termination():
        run_gauss_newton(search, low, high, policy.damped, steps=policy.max_steps)
    return projected.full(search.best)


def initialise_without_continuity(problem: EstimationProblem, cuts: Cuts) -> tuple[EstimationProblem, list[np.ndarray]]:
    """``problem`` at constants fitted without continuity, and states (N, nx) along each record: a start for `Collocation`."""
    segmented = SegmentedProblem.of(problem, cuts)
    arcs = estimate_segment_states(segmented)
    z = fit_without_continuity(arcs, problem.policy.transcription.relaxation)
    segmented = segmented.at(segmented.pieces.variables.recentre(z))
    return segmented.whole, [x for _, x in segmented.simulate()]
