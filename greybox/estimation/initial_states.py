"""Initial states of records that are to be judged or predicted: estimated from so many first rows that these determine them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.base.linear_algebra import decompose_symmetric
from greybox.estimation.noise_loop import estimate_by_simulation_error
from greybox.estimation.options import FitOptions, Transcription
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.simulation.kernel.record import Record

# Fewest rows from which an initial state is estimated.
FIRST_ROWS = 50
# Share of what a whole record tells of its initial state that its first rows hold at least, along every direction: what they leave
# adds no more than twice its squares to the run.
INITIAL_STATE_SHARE = 0.5


def determine_initial_states(problem: EstimationProblem, options: FitOptions, least: int = 0) -> DecisionVector:
    """The variables of ``problem``, whose constants are known, with initial states from so many first rows that these determine them.

    Those are ``least`` rows, or 50, doubled until they do: a slow mode, or one that an output hardly shows, takes longer. The first
    rows are fitted with the error that the model has there, ``r``; along a direction of which they hold the share ``s`` of the
    information the run then errs by ``r' r / s`` at most. Each longer stretch is fitted from the states of the shorter one, so that a
    run which is sensitive to how it began is followed into the record rather than lost in it.
    """
    rows = [min(least or FIRST_ROWS, _count_samples(r)) for r in problem.records]
    while True:
        problem = replace(problem, variables=fit_first_rows(problem, rows, options))
        part = _initial_state_information(_cut_to_first_rows(problem, rows))
        whole = _initial_state_information(problem)
        more = [
            min(2 * n, _count_samples(r)) if _least_share(known, all_of_it) < INITIAL_STATE_SHARE else n
            for n, r, known, all_of_it in zip(rows, problem.records, part, whole, strict=True)
        ]
        if more == rows:
            return problem.variables
        rows = more


def fit_first_rows(problem: EstimationProblem, rows: Sequence[int], options: FitOptions) -> DecisionVector:
    """The variables of ``problem``, whose constants are known, with initial states from so many first rows of each record."""
    single = replace(options, transcription=Transcription.SINGLE, progressive=False)
    return estimate_by_simulation_error(_cut_to_first_rows(problem, rows), single).variables


def _initial_state_information(problem: EstimationProblem) -> list[np.ndarray]:
    """Information (states, states) of each record on its initial state where it is guessed; the constants are known."""
    variables = problem.variables
    information = problem.shooting().evaluate(variables.here).hessian
    columns = [variables.columns(e) for e in range(len(problem.records))]
    return [information[np.ix_(c, c)] for c in columns]


def _least_share(part: np.ndarray, whole: np.ndarray) -> float:
    """Least share of the information ``whole`` (n, n) that ``part`` holds along any direction; zero where the run fails."""
    if not (np.isfinite(whole).all() and np.isfinite(part).all()):
        return 0.0
    root = np.linalg.pinv(decompose_symmetric(whole).without_doubtful().root)
    return float(np.linalg.eigvalsh(root @ part @ root.T).min(initial=1.0))


def _count_samples(record: Record) -> int:
    return len(record.samples(record.y))


def _cut_to_first_rows(problem: EstimationProblem, rows: Sequence[int]) -> EstimationProblem:
    """The same problem on so many first rows of each record, as many as there are unknown states at least."""
    least = 2 * len(problem.model.system.state_names)
    records = tuple(
        r.first((min(max(n, least), _count_samples(r)) - 1) * r.rows_per_sample + 1)
        for n, r in zip(rows, problem.records, strict=True)
    )
    return replace(problem, records=records, experiments=())
