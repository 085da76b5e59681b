"""How much of a record to fit at first, and how much more next.

A start that is far off runs out of step with a long record and locks onto a wrong oscillation. Over the first few time
constants it cannot; what is found there is good enough to go on from, as long as it foretells the next part. It is also
cheap: most iterations see a tenth of the record.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from greybox.estimation.problem import EstimationProblem
from greybox.transcription import Evaluation

# The first part holds this many of the slowest time constants, this share of an output's movement, and so many rows at least.
TIME_CONSTANTS, MOVEMENT, LEAST_ROWS, ROWS_PER_UNKNOWN = 2.0, 0.1, 60, 5
# The movement is looked at in this many places of a record.
PLACES = 2000
# The record grows by the first of these factors with which the misfit grows at most so many times (of the noise at least).
GROWTH, SURPRISE = (10.0, 4.0, 2.0, 1.4), 3.0
# ... or with which the model still follows this share of the movement.
FORETOLD = 0.8
# From this share on the next part is the whole.
ALMOST_WHOLE = 0.5
# A first part of whose movement less than this can be followed is too long for that start: it is cut to a third.
FOLLOWED, SHRINK, LITTLE_LONGER = 0.5, 3.0, 1.2


def choose_first_share(problem: EstimationProblem) -> float:
    """Share of the record for the first stage: a few time constants with some movement in them."""
    v = problem.variables
    rows = max(len(r.u) for r in problem.records)
    period = max(float(np.median(r.h[:PLACES])) for r in problem.records)
    jacobian = problem.model.system.jacobian(v.initial.guess[0], problem.records[0].u[0], v.fixed).full()
    decays = -np.linalg.eigvals(jacobian).real if np.isfinite(jacobian).all() else np.empty(0)
    slowest = 1 / decays[decays > 0].min() if np.any(decays > 0) else 0.0
    first = max(LEAST_ROWS, ROWS_PER_UNKNOWN * v.size, TIME_CONSTANTS * slowest / period) / rows
    first = max(first, min(_moving(r.y) for r in problem.records))
    return float(first) if first < ALMOST_WHOLE else 1.0


def choose_next_share(
    problem: EstimationProblem, share: float, reached: Evaluation, measure: Callable[[float], Evaluation]
) -> tuple[float, Evaluation]:
    """The next share and the evaluation there: as much more of the record as the present part foretells."""
    expected = SURPRISE * max(_ratio(reached), 1.0)
    for factor in GROWTH:
        wider = factor * share if factor * share < ALMOST_WHOLE else 1.0
        ahead = measure(wider)
        if _ratio(ahead) <= expected or compute_explained_share(problem, ahead, wider) >= FORETOLD:
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


def shorten_share(problem: EstimationProblem, share: float) -> float:
    """The next shorter beginning, or the same where it cannot be shorter."""
    rows = max(len(r.u) for r in problem.records)
    least = max(LEAST_ROWS, ROWS_PER_UNKNOWN * problem.variables.size) / rows
    return max(share / SHRINK, least) if share > LITTLE_LONGER * least else share


def _ratio(e: Evaluation) -> float:
    """Misfit over noise."""
    return float(np.sqrt(e.cost / max(e.count, 1)))


def _moving(y: np.ndarray) -> float:
    """Share of the record after which an output has shown `MOVEMENT` of its range."""
    shares = []
    for column in y[:: max(1, len(y) // PLACES)].T:
        finite = np.flatnonzero(np.isfinite(column))
        if len(finite) == 0:
            continue
        values = column[finite]
        seen = np.maximum.accumulate(values) - np.minimum.accumulate(values)
        if seen[-1] > 0:
            shares.append(finite[np.argmax(seen >= MOVEMENT * seen[-1])] / len(column))
    return min(shares, default=1.0)
