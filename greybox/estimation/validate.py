"""A fitted model on records that were not used to fit it: constants kept, only the initial state estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.errors import DataError
from greybox.estimation.options import FitOptions, resolve_options
from greybox.estimation.problem import EstimationProblem, guess_initial_states, prepare_problem
from greybox.estimation.robust_estimation import refit_robustly
from greybox.estimation.select_transcription import select_transcription
from greybox.estimation.solve import solve
from greybox.estimation.step_refinement import HALVINGS, refine_step
from greybox.estimation.traces import compute_misfits, make_traces
from greybox.experiment import Experiment
from greybox.model import Model
from greybox.result import Validation
from greybox.transcription import DecisionVector

# Rows from which the initial state of a validation record is estimated, if `skip` does not say.
FIRST_ROWS = 50


def validate(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | None = None,
    skip: int = 0,
    beginning: int = 0,
    options: FitOptions | None = None,
) -> Validation:
    """Run ``model`` freely over each experiment and measure the error.

    The initial state is the declared one (``options.at_rest``), or estimated from the first rows: the first ``beginning`` rows, or by
    default the ``skip`` rows that are left out of the errors, or the first 50. The constants are not touched. An unstable model cannot
    run freely for long: there the initial state is estimated from the whole record, ``at_rest`` or not, and the run is that of segments
    that meet. With a robust ``options.loss`` outliers among the first rows do not spoil it.

    Raises DataError for more rows than the shortest record has.
    """
    options = replace(resolve_options(options), transcription="automatic", arc_length=0.0, hessian="gauss-newton")
    frozen = model.fix(*model.values)
    problem = prepare_problem(
        frozen, experiments, noise, at_rest=options.at_rest, method=options.method, substeps=options.substeps, robust=options.robust
    )  # fmt: skip
    shortest = min(len(r.u) for r in problem.records)
    if skip < 0 or skip >= shortest:
        raise DataError(f"skip: {skip} rows, but the shortest validation record has {shortest}; leave out fewer rows")
    if beginning < 0 or beginning > shortest:
        raise DataError(
            f"beginning: {beginning} rows, but the shortest validation record has {shortest}; take fewer rows"
        )
    choice = select_transcription(problem, replace(options, progressive=False))
    problem = choice.problem
    if choice.transcription == "multiple":
        conditions = [e.conditions for e in problem.experiments]
        initial = guess_initial_states(frozen, problem.records, False, conditions)
        problem = replace(problem, variables=replace(problem.variables, initial=initial))
        runs = solve(problem, replace(options, transcription="multiple")).simulate()
    else:
        variables = problem.variables
        if variables.initial.free.any():
            first = _beginning(problem, beginning or skip or FIRST_ROWS)
            single = replace(options, transcription="single", progressive=False)
            variables = refit_robustly(solve(first, single), single, None).variables
        problem = _fine_enough(problem, variables, options)
        runs = tuple(problem.shooting(variables).simulate(np.zeros(variables.size)))
    found = make_traces(problem, runs)
    return Validation(compute_misfits(problem, found, skip), found)


def _fine_enough(problem: EstimationProblem, variables: DecisionVector, options: FitOptions) -> EstimationProblem:
    """The same problem with a step that is as small for these records as a fit to them would have made it."""
    for _ in range(HALVINGS):
        evaluation = problem.shooting(variables).evaluate(np.zeros(variables.size))
        smaller, _ = refine_step(problem, variables, evaluation, options)
        if smaller is None:
            break
        problem = smaller
    return problem


def _beginning(problem: EstimationProblem, rows: int) -> EstimationProblem:
    """The same problem on the first rows only, as many as there are unknown states at least."""
    least = max(rows, 2 * len(problem.model.system.state_names))
    return replace(problem, records=tuple(r.first(min(least, len(r.u))) for r in problem.records), experiments=())
