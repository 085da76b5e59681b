"""A model on records that it was not fitted to: constants kept, the initial state estimated from as many first rows as determine it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from greybox.base import DataError, decompose_symmetric
from greybox.data.experiment import Experiment
from greybox.data.noise.growing import GrowingNoise
from greybox.data.read import as_experiments
from greybox.estimation import errors, noise_loop, optimum, result_parts
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import FitOptions, Hessian, Transcription, explain_unknown, resolve_options
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import begin_with_known_past, guess_initial_states, prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, Runs, Solution
from greybox.estimation.transcription.select import select_transcription
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.estimation.transcription.single_shooting import refine_step, solve_with_refined_steps
from greybox.model import Model
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import Plant, PlantModel, as_model
from greybox.simulation.records import to_experiments

# Fewest rows from which an initial state is estimated.
FIRST_ROWS = 50
# Share of what a whole record tells of its initial state that its first rows hold at least, along every direction: what they leave
# adds no more than twice its squares to the run.
INITIAL_STATE_SHARE = 0.5


def refine_integration(problem: EstimationProblem, options: FitOptions) -> EstimationProblem:
    """``problem``, whose constants are known, with a step as small for its records as a fit to them would have made it."""

    def evaluate(problem: EstimationProblem) -> Solution:
        evaluation, nothing = problem.shooting().evaluate(problem.variables.here), np.zeros(len(problem.noise.std))
        work = TerminationStatus.CONVERGED, "", 0, 1, 0.0, (1.0,)
        return Solution(problem, problem.variables, evaluation, *work, nothing)

    policy = options.policy.step_refinement
    return solve_with_refined_steps(problem, evaluate, lambda s: refine_step(s, options), policy).problem


def determine_initial_states(
    problem: EstimationProblem, options: FitOptions, least: Sequence[int] = ()
) -> tuple[DecisionVector, list[int]]:
    """The variables of ``problem``, whose constants are known, with initial states from so many first rows that these determine them.

    Those are the ``least`` rows of each record, or 50, doubled until they do: a slow mode, or one that an output hardly shows, takes
    longer; how many they became is returned as well. The first rows are fitted with the error that the model has there, ``r``; along a
    direction of which they hold the share ``s`` of the information the run then errs by ``r' r / s`` at most. A longer stretch is fitted
    from the states of a shorter one that follows the readings, so that a run which is sensitive to how it began is followed into the
    record rather than lost in it.
    """
    least = least or [0] * len(problem.records)
    rows = [min(few or FIRST_ROWS, _count_samples(r)) for few, r in zip(least, problem.records, strict=True)]
    while True:
        problem = replace(problem, variables=fit_first_rows(problem, rows, options))
        longer = _lengthen(problem, rows)
        if longer == rows:
            return problem.variables, rows
        rows = longer


# Mean square error over a doubled stretch, over that of the stretch that was fitted, from which the run has lost the readings: twice the
# rms error.
LOST_RATIO = 4.0


def _lengthen(problem: EstimationProblem, rows: Sequence[int]) -> list[int]:
    """The first rows that determine the initial states along the run from the present ones; no more than twice those that it follows."""
    variables, counts = problem.variables, [_count_samples(r) for r in problem.records]
    whole = _split_information(problem.shooting().evaluate(variables.here), variables)
    fitted, rows = list(rows), list(rows)
    most = np.inf
    while True:
        evaluation = _cut_to_first_rows(problem, rows).shooting().evaluate(variables.here)
        error = evaluation.cost / max(evaluation.count, 1)
        if rows == fitted:
            most = LOST_RATIO * error if np.isfinite(error) else 0.0
        elif not error <= most:
            return rows
        part = _split_information(evaluation, variables)
        shares = [_measure_share(known, everything) for known, everything in zip(part, whole, strict=True)]
        more = [
            n if share >= INITIAL_STATE_SHARE else min(2 * n, count)
            for n, share, count in zip(rows, shares, counts, strict=True)
        ]
        if more == rows:
            return rows
        rows = more


def _measure_share(known: np.ndarray, everything: np.ndarray) -> float:
    """Least share of the information ``everything`` that ``known`` holds along any direction; zero where the run fails."""
    if not (np.isfinite(everything).all() and np.isfinite(known).all()):
        return 0.0
    # With W = F F' the least eigenvalue of F^+ P F^+'.
    root = np.linalg.pinv(decompose_symmetric(everything).without_doubtful().root)
    return float(np.linalg.eigvalsh(root @ known @ root.T).min(initial=1.0))


def fit_first_rows(problem: EstimationProblem, rows: Sequence[int], options: FitOptions) -> DecisionVector:
    """The variables of ``problem``, whose constants are known, with initial states from so many first rows of each record."""
    single = replace(options, transcription=Transcription.SINGLE, progressive=False)
    return noise_loop.estimate_by_simulation_error(_cut_to_first_rows(problem, rows), single).variables


def _split_information(evaluation: Evaluation, variables: DecisionVector) -> list[np.ndarray]:
    """Information (states, states) of each record on its initial state where it is guessed; the constants are known."""
    columns = [variables.columns(e) for e in range(len(variables.initial.guess))]
    return [evaluation.hessian[np.ix_(c, c)] for c in columns]


def _count_samples(record: Record) -> int:
    return len(record.samples(record.y))


def _cut_to_first_rows(problem: EstimationProblem, rows: Sequence[int]) -> EstimationProblem:
    """The same problem on so many first rows of each record, as many as there are unknown states at least."""
    # Two rows for each unknown at least.
    least = 2 * len(problem.model.system.state_names)
    records = tuple(
        r.first((min(max(n, least), _count_samples(r)) - 1) * r.rows_per_sample + 1)
        for n, r in zip(rows, problem.records, strict=True)
    )
    return replace(problem, records=records, experiments=())


@explain_unknown
def validate(
    model: Model | Plant,
    experiments: Experiment | Sequence[Experiment],
    *,
    noise: Mapping[str, float | GrowingNoise] | None = None,
    skip: int = 0,
    initial_rows: int = 0,
    options: FitOptions | None = None,
) -> result_parts.Validation:
    """Run ``model`` freely over records that were not used to fit it and measure the error; the parameters are kept.

    The initial state is the declared one (``options.at_rest``), or estimated from so many first rows that they determine it: half of
    what the whole record tells of it. An unstable model cannot run freely
    for long: there the initial state is estimated from the whole record, ``at_rest`` or not, and the run is that of segments that meet,
    unless single shooting is asked for.
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
    options = resolve_options(options)
    is_free = options.transcription == Transcription.SINGLE
    options = replace(
        options,
        per_experiment=(),
        transcription=Transcription.SINGLE if is_free else Transcription.AUTOMATIC,
        arc_length=0.0,
        hessian=Hessian.GAUSS_NEWTON,
    )
    # Only the initial states are left to estimate.
    model = as_model(model)
    frozen = model.fix(*model.values)
    experiments = begin_with_known_past(frozen, to_experiments(as_experiments(experiments, frozen)), options)
    problem = prepare_problem(frozen, experiments, noise, options)
    shortest = min(len(r.u) for r in problem.records)
    if skip < 0 or skip >= shortest:
        raise DataError(f"skip: {skip} rows, but the shortest validation record has {shortest}; leave out fewer rows")
    if initial_rows < 0 or initial_rows > shortest:
        raise DataError(
            f"initial_rows: {initial_rows} rows, but the shortest validation record has {shortest}; take fewer rows"
        )
    transcription = Transcription.SINGLE
    if not isinstance(frozen, PlantModel):
        choice = select_transcription(problem, replace(options, progressive=False))
        problem, transcription = choice.problem, choice.transcription
    if transcription == Transcription.MULTIPLE:
        conditions = [e.conditions for e in problem.experiments]
        initial = guess_initial_states(frozen, problem.records, False, conditions)
        problem = replace(problem, variables=replace(problem.variables, initial=initial))
        runs = noise_loop.solve(problem, replace(options, transcription=Transcription.MULTIPLE)).simulate()
    else:
        variables = problem.variables
        if variables.initial.free.any():
            variables = (
                fit_first_rows(problem, [initial_rows] * len(problem.records), options)
                if initial_rows
                else determine_initial_states(problem, options, [skip] * len(problem.records))[0]
            )

        problem = refine_integration(replace(problem, variables=variables), options)
        runs = tuple(problem.shooting(variables).simulate(variables.here))
    return _compare_with_records(problem, runs, skip, options)


def follow_records(
    problem: EstimationProblem, options: FitOptions, skip: int = 0, least: Sequence[int] = ()
) -> tuple[result_parts.Validation, list[int]]:
    """One of many models run freely over the records of ``problem`` from where it begins: its constants are held, its step stays as it is.

    Parameters
    ----------
    problem
        The records, and the model with its values and a first guess of how each record begins.
    options
        Options of the fit.
    skip
        Rows at the beginning of each record that the errors leave out.
    least
        Rows of each record from which the initial state is estimated at least; none takes the ``skip`` rows or the first 50.

    Returns
    -------
    Validation, list of int
        Misfit by output and the runs; from how many rows of each record the initial state was estimated.
    """
    refinement = replace(options.policy.step_refinement, halvings=0)
    options = replace(options, thorough=False, policy=replace(options.policy, step_refinement=refinement))
    model, initial = problem.model, problem.variables.initial
    conditions = [e.conditions for e in problem.experiments] if any(e.conditions for e in problem.experiments) else ()
    # The problem keeps the model of its fit, and so its kernel: one of a model without free constants would be made anew.
    held = DecisionVector.of(model.fix(*model.values), initial, conditions)
    problem, rows = replace(problem, variables=held), list(least)
    if initial.free.any():
        variables, rows = determine_initial_states(problem, options, least or [skip] * len(problem.records))
        problem = replace(problem, variables=variables)
    runs = tuple(problem.shooting().simulate(problem.variables.here))
    return _compare_with_records(problem, runs, skip, options), rows


def _compare_with_records(
    problem: EstimationProblem, runs: Runs, skip: int, options: FitOptions
) -> result_parts.Validation:
    traces = optimum.make_traces(problem, runs)
    return result_parts.Validation(errors.compute_misfits(problem, traces, skip, options.to_loss()), traces)
