"""How much of a record to fit at first, and how much more next.

A start that is far off runs out of step with a long record and locks onto a wrong oscillation. Over the first few time
constants it cannot; what is found there is good enough to go on from, as long as it foretells the next part. It is also
cheap: most iterations see a tenth of the record.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from greybox.transcription.policy import ProgressiveHorizonPolicy
from greybox.transcription.problem import EstimationProblem
from greybox.transcription.simulation_error import Evaluation


def choose_first_share(problem: EstimationProblem, policy: ProgressiveHorizonPolicy) -> float:
    """Share of the record for the first stage: a few time constants with some movement in them."""
    v = problem.variables
    rows = max(len(r.u) for r in problem.records)
    period = max(float(np.median(r.h[: policy.inspected_rows])) for r in problem.records)
    jacobian = problem.model.system.jacobian(v.initial.guess[0], problem.records[0].u[0], v.fixed).full()
    decays = -np.linalg.eigvals(jacobian).real if np.isfinite(jacobian).all() else np.empty(0)
    slowest = 1 / decays[decays > 0].min() if np.any(decays > 0) else 0.0
    first = max(policy.least_rows, policy.rows_per_unknown * v.size, policy.time_constants * slowest / period) / rows
    first = max(first, min(_find_movement_share(r.y, policy) for r in problem.records))
    return float(first) if first < policy.almost_whole else 1.0


def choose_next_share(
    problem: EstimationProblem,
    share: float,
    reached: Evaluation,
    measure: Callable[[float], Evaluation],
    policy: ProgressiveHorizonPolicy,
) -> tuple[float, Evaluation]:
    """The next share and the evaluation there: as much more of the record as the present part foretells."""
    expected = policy.surprise * max(_compute_noise_ratio(reached), 1.0)
    for factor in policy.growth:
        wider = factor * share if factor * share < policy.almost_whole else 1.0
        ahead = measure(wider)
        if (
            _compute_noise_ratio(ahead) <= expected
            or compute_explained_share(problem, ahead, wider) >= policy.foretold_share
        ):
            break
    return wider, ahead


def compute_explained_share(problem: EstimationProblem, e: Evaluation, share: float) -> float:
    """Share of the outputs' movement, in units of their noise, that the model follows over part of the record; 1 is all of it."""
    movement = np.zeros(len(e.squares))
    for record in problem.records:
        for j, column in enumerate(record.y[: max(2, round(share * len(record.y)))].T):
            values = column[np.isfinite(column)]
            movement[j] += len(values) * np.var(values) if len(values) else 0.0
    total = float(np.sum(movement / problem.noise.std**2))
    return 1.0 - float(e.squares.sum()) / total if total > 0 else 1.0


def shorten_share(problem: EstimationProblem, share: float, policy: ProgressiveHorizonPolicy) -> float:
    """The next shorter beginning, or the same where it cannot be shorter."""
    rows = max(len(r.u) for r in problem.records)
    least = max(policy.least_rows, policy.rows_per_unknown * problem.variables.size) / rows
    return max(share / policy.shrink, least) if share > policy.least_shrink * least else share


def _compute_noise_ratio(e: Evaluation) -> float:
    """Misfit over noise."""
    return float(np.sqrt(e.cost / max(e.count, 1)))


def _find_movement_share(y: np.ndarray, policy: ProgressiveHorizonPolicy) -> float:
    """Share of the record after which an output has shown the policy's share of its range."""
    shares = []
    for column in y[:: max(1, len(y) // policy.inspected_rows)].T:
        finite = np.flatnonzero(np.isfinite(column))
        if len(finite) == 0:
            continue
        values = column[finite]
        seen = np.maximum.accumulate(values) - np.minimum.accumulate(values)
        if seen[-1] > 0:
            shares.append(finite[np.argmax(seen >= policy.movement * seen[-1])] / len(column))
    return min(shares, default=1.0)
