"""A fitted model on records that were not used to fit it: constants kept, only the initial state estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base.errors import DataError
from greybox.data.experiment import Experiment
from greybox.estimation.initial_states import determine_initial_states, fit_first_rows
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.optimum import compute_misfits, make_traces
from greybox.estimation.options import FitOptions, Hessian, Transcription, resolve_options
from greybox.estimation.result_parts import Validation
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.problem import EstimationProblem, guess_initial_states, prepare_problem
from greybox.estimation.transcription.select import select_transcription
from greybox.estimation.transcription.single_shooting import refine_step, solve_with_refined_steps
from greybox.estimation.transcription.solution import Solution
from greybox.estimation.transcription.solve import solve
from greybox.model.model import Model


def validate(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float] | None = None,
    skip: int = 0,
    initial_rows: int = 0,
    options: FitOptions | None = None,
) -> Validation:
    """Run ``model`` freely over records that were not used to fit it and measure the error; the parameters are kept.

    The initial state is the declared one (``options.at_rest``), or estimated from so many first rows that they determine it: half of
    what the whole record tells of it. An unstable model cannot run freely
    for long: there the initial state is estimated from the whole record, ``at_rest`` or not, and the run is that of segments that meet.
    With a robust ``options.loss`` outliers among the first rows do not spoil it.

    Parameters
    ----------
    model
        The model with its fitted values.
    experiments
        Validation records.
    noise
        Standard deviation by output in the model's units; estimated where it is left out.
    skip
        Rows at the beginning of each record that the errors leave out.
    initial_rows
        Rows from which the initial state is estimated; 0 takes the ``skip`` rows or the first 50, and more where they do not
        determine it.
    options
        Options of the fit.

    Returns
    -------
    Validation
        Misfit by output, and the runs.

    Raises
    ------
    DataError
        For more rows than the shortest record has.

    Examples
    --------
    >>> validate(fit.model, other_record, noise=fit.noise.std).misfit["x"].noise_ratio  # doctest: +SKIP
    1.02
    """
    options = replace(
        resolve_options(options),
        per_experiment=(),
        transcription=Transcription.AUTOMATIC,
        arc_length=0.0,
        hessian=Hessian.GAUSS_NEWTON,
    )
    frozen = model.fix(*model.values)
    problem = prepare_problem(frozen, experiments, noise, options)
    shortest = min(len(r.u) for r in problem.records)
    if skip < 0 or skip >= shortest:
        raise DataError(f"skip: {skip} rows, but the shortest validation record has {shortest}; leave out fewer rows")
    if initial_rows < 0 or initial_rows > shortest:
        raise DataError(
            f"initial_rows: {initial_rows} rows, but the shortest validation record has {shortest}; take fewer rows"
        )
    choice = select_transcription(problem, replace(options, progressive=False))
    problem = choice.problem
    if choice.transcription == Transcription.MULTIPLE:
        conditions = [e.conditions for e in problem.experiments]
        initial = guess_initial_states(frozen, problem.records, False, conditions)
        problem = replace(problem, variables=replace(problem.variables, initial=initial))
        runs = solve(problem, replace(options, transcription=Transcription.MULTIPLE)).simulate()
    else:
        variables = problem.variables
        if variables.initial.free.any():
            variables = (
                fit_first_rows(problem, [initial_rows] * len(problem.records), options)
                if initial_rows
                else determine_initial_states(problem, options, skip)
            )
        problem = _refine_until_fine(problem, variables, options)
        runs = tuple(problem.shooting(variables).simulate(variables.here))
    traces = make_traces(problem, runs)
    return Validation(compute_misfits(problem, traces, skip), traces)


def _refine_until_fine(problem: EstimationProblem, variables: DecisionVector, options: FitOptions) -> EstimationProblem:
    """The same problem with a step that is as small for these records as a fit to them would have made it."""

    def evaluate(problem: EstimationProblem) -> Solution:
        evaluation, nothing = problem.shooting().evaluate(problem.variables.here), np.zeros(len(problem.noise.std))
        return Solution(
            problem, problem.variables, evaluation, TerminationStatus.CONVERGED, "", 0, 1, 0.0, (1.0,), nothing
        )

    at_start = replace(problem, variables=variables)
    policy = options.policy.step_refinement
    return solve_with_refined_steps(at_start, evaluate, lambda s: refine_step(s, options), policy).problem
