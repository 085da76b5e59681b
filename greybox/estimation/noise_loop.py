"""Estimation by simulation error: a solution by the transcription that suits, and the noise model in turn with it until both stand still.

The noise that a solution is weighed with may have to be learnt from its own residual: the level of an output that nothing else tells,
the scale of the bulk of a residual with outliers (a robust loss), the colour where that is asked for. Each changes the weights, and the
weights change the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from greybox.base import ModelError
from greybox.base.numerics import OVERFLOWING_CURVATURE
from greybox.data.noise.noise_model import AutoRegression, NoiseSource
from greybox.data.noise.spectrum import estimate_spread
from greybox.data.sensor_faults import find_strays
from greybox.estimation.objective import SimulationErrorObjective
from greybox.estimation.optim.methods import MinimisationMethod, minimise
from greybox.estimation.optim.minimisation import GaussNewtonPolicy, Termination, TerminationPolicy, TerminationStatus
from greybox.estimation.options import ColourTreatment, FitOptions, LossKind, RobustLoss, Transcription
from greybox.estimation.parameter_constancy import NOISE_RATIO
from greybox.estimation.result_parts import RobustReport
from greybox.estimation.sandwich import LEAST_LEVEL_READINGS, estimate_residual_colour
from greybox.estimation.transcription.collocation import solve_collocation
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.multiple_shooting import cut_records, evaluate_apart, solve_multiple_shooting
from greybox.estimation.transcription.plant_search import SHARES, solve_plant
from greybox.estimation.transcription.problem import Completion, EstimationProblem, FitProgressCallback, Runs, Solution
from greybox.estimation.transcription.segments import Cuts
from greybox.estimation.transcription.select import (
    TranscriptionChoice,
    select_transcription,
    shorten_steps,
    try_free_run,
)
from greybox.estimation.transcription.shooting_cost import Evaluation, PlantShooting
from greybox.estimation.transcription.single_shooting import solve_single_shooting
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import PlantModel


def solve(problem: EstimationProblem, options: FitOptions, report: FitProgressCallback | None = None) -> Solution:
    """Minimise the noise-weighted simulation error of ``problem``; `Solution.strategy` says how, and why so.

    The end is never worse than the present point of ``problem``, see `keep_best`. Raises ModelError for a transcription that the model
    does not allow.
    """
    if isinstance(problem.model, PlantModel):
        solution = solve_plant(problem, options, report)
    else:
        choice = try_free_run(select_transcription(problem, options), options)
        if choice.transcription is Transcription.ARCS:
            return solve_multiple_shooting(choice, options, report)
        solution = _search(choice, options, report)
        if solution.status is TerminationStatus.NO_START and (runnable := shorten_steps(choice.problem, options)):
            solution = _search(replace(choice, problem=runnable), options, report)
    # A search of whole records at one step has kept its start itself.
    if solution.is_single and not options.progressive and solution.problem.step is problem.step:
        return solution
    return keep_best(solution, problem.variables, options, report)


class StartCost:
    """What starts of ``problem`` cost that `solve` minimises: of free runs, or of arcs or segments where ``options`` ask for these.

    All starts have the same segments; the first state of each is searched for from where it was at the start before.
    """

    def __init__(self, problem: EstimationProblem, options: FitOptions) -> None:
        self.problem, self.options = problem, options
        self._cuts: Cuts = ()
        self._states: np.ndarray | None = None

    def evaluate(self, variables: DecisionVector) -> tuple[Evaluation, tuple[np.ndarray, np.ndarray]]:
        """Cost and derivatives at a start, and the distances of its unknowns to their bounds."""
        begun, options = replace(self.problem, variables=variables), self.options
        if not options.arc_length and options.transcription != Transcription.MULTIPLE:
            return begun.shooting().evaluate(variables.here), variables.bounds()
        # Steps that a stiff start needs follow the others as well.
        run_freely = replace(options, transcription=Transcription.SINGLE, arc_length=0.0)
        self.problem = begun = select_transcription(begun, run_freely).problem
        self._cuts = self._cuts or cut_records(begun, options)
        evaluation, bounds, states = evaluate_apart(begun, self._cuts, self._states)
        if np.isfinite(evaluation.cost):
            self._states = states
        return evaluation, bounds

    def predict(self, variables: DecisionVector) -> float:
        """The cost that one step of the quadratic model promises from a start; infinite where the model cannot be simulated there."""
        e, (low, high) = self.evaluate(variables)
        if not (np.isfinite(e.cost) and e.is_finite and np.abs(e.hessian).max(initial=0.0) < OVERFLOWING_CURVATURE):
            return np.inf
        # c + g'z + z'H z / 2 at its least within the bounds.
        return float(e.cost - e.predicted_decrease(low, high))


def _search(choice: TranscriptionChoice, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """The optimum by a free run, segments or collocation, as the ``choice`` is.

    Of a stiff model a free run costs a tenth of segments: where they were chosen, it is searched for first, and handed out where it
    leaves nothing but noise, or less than they do.
    """
    if choice.transcription is Transcription.SINGLE:
        solution = solve_single_shooting(choice.problem, options, report)
        return replace(solution, strategy=choice.to_strategy(**solution.strategy.values))
    free = None
    if choice.reason is not None and choice.problem.step.adaptive:
        free = solve_single_shooting(choice.problem, options, report)
        free = replace(free, strategy=choice.follow_freely().to_strategy(**free.strategy.values))
        if free.status is TerminationStatus.INTERRUPTED or is_at_told_noise(free):
            return free
    is_multiple = choice.transcription is Transcription.MULTIPLE
    solution = (solve_multiple_shooting if is_multiple else solve_collocation)(choice, options, report)
    solution = finish_by_simulation_error(solution, options, report)
    if free is None:
        return solution
    # Segments that failed, or do not meet, go on by a free run of their own.
    solution = keep_best(solution, choice.problem.variables, options, report)
    cost = solution.evaluation.cost if solution.is_run else np.inf
    is_better = free.status.success and free.evaluation.cost <= cost
    return free.with_work_of(solution) if is_better else solution.with_work_of(free)


def is_at_told_noise(solution: Solution) -> bool:
    """Whether every output is followed to its noise, and something tells that."""
    noise, evaluation = solution.problem.noise, solution.evaluation
    if any(noise.sources.get(name) is NoiseSource.RESIDUAL for name in noise.outputs):
        return False
    return bool(np.all(evaluation.squares <= NOISE_RATIO**2 * evaluation.counts))


def keep_best(
    solution: Solution, start: DecisionVector, options: FitOptions, report: FitProgressCallback | None = None
) -> Solution:
    """``solution``, unless the free run from ``start`` is better, or segments and collocation points led to no optimum.

    Then the search goes on by single shooting from the better of the two, with the steps and under the noise of the solution, by which all
    are compared; the best of them is handed out.
    """
    problem, status = solution.problem, solution.status
    # At implicit steps of one length a start may look worse than it is.
    if problem.step.implicit and not options.substeps:
        problem = problem.with_stable_steps()
    is_failed = not (status.success or solution.is_single or status is TerminationStatus.INTERRUPTED)
    ended = solution.evaluation.cost if solution.is_run else np.inf
    if not is_failed and is_worse_in_part(problem, start, ended, solution.shares):
        return solution
    runs = [(compute_cost(problem, start), start)]
    if runs[0][0] >= ended and not is_failed:
        return solution
    # Segments and collocation points may begin where explicit steps do not run.
    if not np.isfinite(runs[0][0]) and (runnable := shorten_steps(replace(problem, variables=start), options)):
        problem, runs = runnable, [(compute_cost(runnable, start), start)]
    if is_failed:
        runs.append((compute_cost(problem, solution.variables), solution.variables))
    best, variables = min(runs, key=lambda run: run[0])
    if not np.isfinite(best):
        return solution
    if status is TerminationStatus.INTERRUPTED:  # the better point is all that is asked for
        evaluation = problem.shooting(variables).evaluate(variables.here)
        return replace(solution, variables=variables, evaluation=evaluation, transcription="single", joined=None)
    search = solve_plant if isinstance(problem.model, PlantModel) else solve_single_shooting
    problem = replace(problem, variables=variables)
    again = search(problem, replace(options, progressive=False), report).with_work_of(solution)
    if not np.isfinite(again.evaluation.cost) or again.evaluation.cost > ended:
        return solution
    return replace(again, strategy=solution.strategy).with_strategy(completion=str(Completion.WENT_ON))


def is_worse_in_part(problem: EstimationProblem, start: DecisionVector, ended: float, shares: Sequence[float]) -> bool:
    """Whether the run from ``start`` costs more than ``ended`` over the first part already: no term of a cost is negative, and the whole
    need not be run.

    Of a plant, whose runs have a price, only where a search of such ``shares`` has run that part.
    """
    if isinstance(problem.model, PlantModel) and SHARES[0] not in shares:
        return False
    return compute_cost(problem.over_part(SHARES[0]), start) >= ended


def compute_cost(problem: EstimationProblem, variables: DecisionVector) -> float:
    """The cost of one free run of ``problem`` over each record at the present point of ``variables``."""
    shooting = problem.shooting(variables)
    if isinstance(shooting, PlantShooting):
        return shooting.cost(variables.here)
    return shooting.evaluate(variables.here).cost


# A free run follows the joined one if its cost is at most so many times as large ...
COST_RATIO = 1.1
# ... or larger by this misfit over noise squared for each sample.
PERFECT_NOISE_RATIO = 0.001


def finish_by_simulation_error(solution: Solution, options: FitOptions, report: FitProgressCallback | None) -> Solution:
    """``solution``, found with white noise and least squares; carried on by a free run where its problem asks for more.

    Where the free run does not follow it (an unstable plant) the noise's colour is left to the intervals, and the strategy says so;
    anything else is refused with ModelError.
    """
    problem = solution.at_optimum
    if problem.is_plain_squares or not solution.status.success:
        return solution
    # Whether a free run from the optimum follows the joined one: then it can go on with the cost as asked for.
    cost = problem.with_plain_squares().shooting().evaluate(problem.variables.here).cost
    if cost <= COST_RATIO * solution.evaluation.cost + PERFECT_NOISE_RATIO**2 * solution.evaluation.count:
        finished = solve_single_shooting(problem, replace(options, progressive=False), report).with_work_of(solution)
        return replace(finished, strategy=solution.strategy).with_strategy(completion=str(Completion.FREE_RUN))
    if problem.with_white_noise().is_plain_squares:
        white = replace(solution, problem=solution.problem.with_white_noise())
        return white.with_strategy(completion=str(Completion.WHITE_NOISE))
    title = "multiple shooting" if solution.transcription == Transcription.MULTIPLE else "collocation"
    raise ModelError(
        f"{problem.model.title}: {title} minimises plain squares of the error; a robust loss needs a free run, as noise does that is"
        " not the same in every row, and a free run does not follow this plant: leave the loss out, give each output one noise"
    )


def estimate_by_simulation_error(
    problem: EstimationProblem,
    options: FitOptions,
    colour: ColourTreatment | str = ColourTreatment.KNOWN,
    report: FitProgressCallback | None = None,
) -> Solution:
    """The solution of ``problem`` under a noise model that agrees with its residual.

    A failed solution ends the loop, and so does `EstimationPolicy.noise_rounds`. The last solution gets its last digits by Gauss-Newton
    steps.
    """
    if colour == ColourTreatment.WHITE:
        problem = problem.with_white_noise()
    begin = _begin_robust(problem, options)
    solution, noise = solve(begin, options, report), problem.noise
    if begin is not problem and solution.status.success:
        # What the first search left out is back with the first change of the noise, which gives the problem its loss again.
        solution = replace(solution, problem=replace(solution.problem, records=problem.records, loss=None))
    elif begin is not problem:
        solution = solve(problem, options, report).with_work_of(solution)
    for _ in range(options.policy.noise_rounds):
        wanted = update_noise(solution, options, colour) if solution.status.success else None
        if wanted is None and solution.problem.loss is not None and solution.status.success:
            # Found anew each time, in all readings: what was left out under a worse run comes back.
            whole = replace(solution.at_optimum, records=problem.records)
            cleared = without_bursts(whole, solution.simulate())
            pairs = zip(cleared.records, solution.problem.records, strict=True)
            stands = all(np.array_equal(new.y, old.y, equal_nan=True) for new, old in pairs)
            wanted = None if stands else cleared
        if wanted is not None:
            solution = solve(wanted, replace(options, progressive=False), report).with_work_of(solution)
            continue
        # Under the noise as it is known now the start may be better than where a search under another one led.
        if solution.problem.noise is noise or solution.transcription == Transcription.ARCS:
            break
        noise, ended = solution.problem.noise, solution
        solution = keep_best(ended, problem.variables, options, report)
        if solution is ended:
            break
    return polish_by_gauss_newton(solution, options)


def update_noise(
    solution: Solution, options: FitOptions, colour: ColourTreatment | str = ColourTreatment.KNOWN
) -> EstimationProblem | None:
    """The problem with what its residual says of the noise, begun at ``solution``; None where that stands still.

    One thing at a time: a level that it refutes, the other levels, how they grow with the signal, then the scale of a robust loss, then
    the colour.
    """
    problem = (
        _drop_refuted_level(solution)
        or _update_level(solution, options)
        or _update_growth(solution)
        or _update_loss(solution, options)
        or (_update_colour(solution, options) if colour == ColourTreatment.RESIDUAL else None)
    )
    return None if problem is None else replace(problem, variables=solution.variables)


# Noise that was estimated from repetition is none where the rms residual is below this share of it: a residual holds all the noise there
# is, and what repeats differ by holds as well how each began.
REFUTED_SHARE = 0.5


def _drop_refuted_level(solution: Solution) -> EstimationProblem | None:
    """The residual's own size, white, as the noise of outputs whose repetition in the records showed the plant, and not its noise."""
    problem, evaluation = solution.problem, solution.evaluation
    repeated = (NoiseSource.REPEATED_PERIODS, NoiseSource.REPEATED_EXPERIMENTS)
    outputs = [j for j, name in enumerate(problem.noise.outputs) if problem.noise.sources.get(name) in repeated]
    if not outputs or problem.loss is not None:
        return None
    noise, pairs = problem.noise, list(zip(problem.records, solution.simulate(), strict=True))
    std, colour, sources, bounds = noise.std.copy(), list(noise.colour), dict(noise.sources), dict(noise.bounds)
    inflation = evaluation.count / max(evaluation.count - solution.unknowns, 1)
    for j in outputs:
        errors = np.concatenate([record.samples(record.y - y)[:, j] for record, (y, _) in pairs])
        size = float(np.sqrt(np.nanmean(errors**2) * inflation))
        if np.isfinite(errors).sum() >= LEAST_LEVEL_READINGS and 0 < size < REFUTED_SHARE * std[j]:
            std[j], colour[j], sources[noise.outputs[j]] = size, AutoRegression(), NoiseSource.RESIDUAL
            bounds.pop(noise.outputs[j], None)
    if sources == dict(noise.sources):
        return None
    return replace(problem, noise=replace(noise, std=std, colour=tuple(colour), sources=sources, bounds=bounds))


def _update_level(solution: Solution, options: FitOptions) -> EstimationProblem | None:
    """The residual's own size as the noise of the outputs whose noise nothing else tells, as long as it counts as white."""
    problem, evaluation = solution.problem, solution.evaluation
    untold = np.array(
        [
            problem.noise.sources.get(o.name) is NoiseSource.RESIDUAL
            and not a.order
            and o.name not in problem.noise.growth
            for o, a in zip(problem.model.outputs, problem.noise.colour, strict=True)
        ]
    )
    if problem.loss is not None:
        return None
    counts, squares = np.maximum(evaluation.counts, 1), evaluation.squares.copy()
    for outputs in map(list, problem.noise.sharing):  # of all of them together
        counts[outputs], squares[outputs] = counts[outputs].sum(), squares[outputs].sum()
    if len(counts) > 1:
        untold &= counts >= LEAST_LEVEL_READINGS
    # Unbiased: the unknowns have taken their share of the residual, N / (N - p) gives it back.
    size = np.sqrt(squares / counts * evaluation.count / max(evaluation.count - solution.unknowns, 1))
    ratio = np.where(untold & (size > 0), np.maximum(size, options.policy.noise.min_relative_level), 1.0)
    if is_settled(ratio):
        return None
    return replace(problem, noise=replace(problem.noise, std=problem.noise.std * ratio))


def _update_growth(solution: Solution) -> EstimationProblem | None:
    """Noise that grows with the signal, at the run of ``solution``, with the parts that are not told as the residual shows them."""
    problem = solution.problem
    if not problem.noise.growth:
        return None
    pairs = list(zip(problem.records, (y for y, _ in solution.simulate()), strict=True))
    runs = [record.samples(y) if len(y) == len(record.u) else y for record, y in pairs]
    seen = [record.samples(record.y) for record in problem.records]
    inflation = solution.evaluation.count / max(solution.evaluation.count - solution.unknowns, 1)
    growth = {}
    for name, noise in problem.noise.growth.items():
        j = problem.noise.outputs.index(name)
        growth[name] = noise.estimate(
            np.concatenate([y[:, j] for y in seen]), np.concatenate([y[:, j] for y in runs]), inflation
        )
    if any(noise.unknown for noise in growth.values()):  # nothing was measured, or nothing is left over
        return None
    wanted = problem.with_growing_noise(growth, runs)
    before, after = (_list_noise_levels(p) for p in (problem, wanted))
    return None if after.shape == before.shape and is_settled(after / before) else wanted


def _list_noise_levels(problem: EstimationProblem) -> np.ndarray:
    """The standard deviation of every measured row, and of logarithms."""
    levels = []
    for record in problem.records:
        measured = np.isfinite(record.samples(record.y))
        spread = np.ones(measured.shape) if record.spread is None else record.spread
        levels.append((problem.noise.std * spread)[measured])
        levels.append(np.empty(0) if record.log_std is None else record.log_std[np.isfinite(record.log_std)])
    return np.concatenate(levels)


def _update_loss(solution: Solution, options: FitOptions) -> EstimationProblem | None:
    """The robust loss at the scale of the bulk of each output's residual.

    Huber's loss first: its cost has one minimum where least squares has one, and what it finds is near enough for a loss that bends
    down. The ``scale`` of each output is that of the bulk of its residual over the noise (1.48 times the median size), and where the
    noise is known one at least: what the model lacks is not to be taken for outliers. It is constant while the cost is minimised.
    """
    loss, before = options.to_loss(), solution.problem.loss
    if loss is None:
        return None
    # Of the bulk, which outliers do not enlarge: 1.48 times the median size.
    scale = estimate_bulk_scale(solution)
    if before is None or not is_settled(scale / before.scale, SETTLED_SCALE):
        wanted = to_huber(loss, options) if before is None else before
    elif before.kind != loss.kind:
        wanted = loss
    else:
        return None
    return replace(solution.problem, loss=replace(wanted, scale=scale))


def to_huber(loss: RobustLoss, options: FitOptions) -> RobustLoss:
    """Huber's loss in place of one that bends down."""
    return loss if loss.kind == LossKind.HUBER else RobustLoss(LossKind.HUBER, options.policy.huber_threshold)


def _begin_robust(problem: EstimationProblem, options: FitOptions) -> EstimationProblem:
    """``problem`` without readings far beside their neighbours, and with Huber's loss at the scale of the bulk of its errors at the start.

    Least squares would follow outliers first, from where no robust loss leads back. On this scale few errors but theirs are outliers, and
    from search to search it shrinks to that of the noise: graduated non-convexity (Blake and Zisserman 1987).
    """
    loss = options.to_loss()
    if loss is None:
        return problem
    records = []
    for record in problem.records:
        y = record.y.copy()
        for column in y.T:
            column[find_strays(column, list(record.u.T))] = np.nan
        records.append(replace(record, y=y))
    problem = replace(problem, records=tuple(records))
    errors = compute_whitened_residuals(problem, problem.shooting().simulate(problem.variables.here))
    scale = np.array([estimate_spread(column, robust=True) or 1.0 for column in errors.T])
    return replace(problem, loss=replace(to_huber(loss, options), scale=scale)) if np.isfinite(scale).all() else problem


def _update_colour(solution: Solution, options: FitOptions) -> EstimationProblem | None:
    """The noise coloured as the residual is, where its colour is not known already."""
    noise, policy = solution.problem.noise, options.policy
    residual = estimate_residual_colour(solution.residuals(), solution.unknowns, noise.known, noise_policy=policy.noise)
    models = tuple(
        known if known.order else estimated for known, estimated in zip(noise.colour, residual.models, strict=True)
    )
    if all(a.order == b.order for a, b in zip(models, noise.colour, strict=True)):
        return None
    coloured = frozenset(
        o for o, known, a in zip(noise.outputs, noise.colour, models, strict=True) if a.order > known.order
    )
    return replace(solution.problem, noise=replace(noise, colour=models, by_residual=noise.by_residual | coloured))


# The level of a noise stands still when it changes by less than this share from round to round ...
SETTLED_SIZE = 0.02
# ... and the scale of a robust loss, which the constants depend on, when it changes by less than this.
SETTLED_SCALE = 0.002


def is_settled(ratio: np.ndarray, share: float = SETTLED_SIZE) -> bool:
    """Whether what is known of the noise stands still: ``ratio`` (ny,) of the new sizes to those before."""
    return bool(np.all(np.abs(ratio - 1) < share))


# Gauss-Newton steps after the last round at most, which give the parameters their last digits.
POLISHING_STEPS = 3
# The same with a robust loss, where each step of reweighted least squares is nearer by about the same share.
ROBUST_POLISHING_STEPS = 30
# They end where the next one would move the parameters by a millionth of their standard deviations.
LAST_DIGITS = TerminationPolicy(negligible_decrease=1e-12, perfect_noise_ratio=0.0, little_gain=0.0)
# Undamped, so that they go to the end along sloppy directions as well; the first that gains nothing is the last.
POLISHING = GaussNewtonPolicy(initial_damping=0.0, max_rejections=1)


def polish_by_gauss_newton(solution: Solution, options: FitOptions) -> Solution:
    """``solution`` of free runs after some plain Gauss-Newton steps, each kept only if it lowers the cost.

    The search ends where nothing is left to gain statistically; these give the parameters their last digits. With a robust loss they are
    steps of reweighted least squares, each nearer by about the same share: there are more of them.
    """
    problem = solution.problem
    if solution.joined or not solution.status.success:
        return solution
    # Slopes by differences of runs have no more digits than the search has used.
    if isinstance(problem.model, PlantModel) and not problem.model.is_cheap:
        return solution
    objective = SimulationErrorObjective(solution.at_optimum)
    low, high = solution.variables.bounds()
    outcome = minimise(
        objective.evaluate,
        solution.variables.here,
        low,
        high,
        method=MinimisationMethod.GAUSS_NEWTON,
        value_at_start=solution.evaluation,
        iterations=POLISHING_STEPS if problem.loss is None else ROBUST_POLISHING_STEPS,
        termination_test=Termination(LAST_DIGITS, low, high, objective.squares).test,
        policy=replace(options.policy.minimisation, damped=POLISHING),
    )
    if not outcome.evaluations:
        return solution
    return replace(
        solution,
        variables=solution.variables.recentre(outcome.z),
        evaluation=outcome.value,
        evaluations=solution.evaluations + outcome.evaluations,
        seconds=solution.seconds + outcome.seconds,
    )


# Lower limit of the scale of a robust loss over an estimated noise, which outliers may have made so much too large; less is rounding.
LEAST_SCALE = 0.3


def estimate_bulk_scale(solution: Solution) -> np.ndarray:
    """Size of the bulk of each output's residual over its noise (ny,), one at least where the noise is given."""
    r = compute_whitened_residuals(solution.problem, solution.simulate())
    least = 1.0 if solution.problem.noise.known else LEAST_SCALE
    return np.array([max(estimate_spread(column, robust=True), least) for column in r.T])


# Size of a residual over the bulk, from which no noise explains it, and by which it jumps from one reading to the next where a burst of
# wrong readings begins and ends: what a model lacks comes and goes with the motion.
BURST_SIZE = 4.0
# Readings in a row from which such residuals are a burst: single ones pull to either side.
BURST_ROWS = 3


def without_bursts(problem: EstimationProblem, runs: Runs) -> EstimationProblem:
    """``problem`` without the readings of bursts of wrong ones, as its ``runs`` show them.

    A robust loss bounds what each outlier pulls. Those of a burst pull the same way, over one stretch of the motion: together as much as
    the rest of it.
    """
    errors = [_scale_errors(problem, record, y) for record, (y, _) in zip(problem.records, runs, strict=True)]
    bulk = [estimate_spread(column, robust=True) or np.inf for column in np.concatenate(errors).T]
    records = []
    for record, error in zip(problem.records, errors, strict=True):
        y = record.y.copy()
        for column, residual in zip(record.samples(y).T, (error / bulk).T, strict=True):
            rows = np.flatnonzero(np.isfinite(residual))
            column[rows[_find_bursts(residual[rows])]] = np.nan
        records.append(replace(record, y=y))
    return replace(problem, records=tuple(records))


def _find_bursts(residual: np.ndarray) -> np.ndarray:
    """Which residuals (N,), over the bulk, stand in a burst."""
    sign = np.where(np.abs(residual) > BURST_SIZE, np.sign(residual), 0.0)
    edges = np.flatnonzero(np.diff(sign, prepend=np.nan, append=np.nan) != 0)
    jumps = np.abs(np.diff(residual, prepend=np.nan, append=np.nan))
    is_burst = np.zeros(len(residual), bool)
    for first, end in pairwise(edges):
        # At an end of the record there is no other side to jump from.
        sides = [jumps[k] for k in (first, end) if 0 < k < len(residual)]
        if sign[first] and end - first >= BURST_ROWS and sides and min(sides) > BURST_SIZE:
            is_burst[first:end] = True
    return is_burst


def _scale_errors(problem: EstimationProblem, record: Record, y: np.ndarray) -> np.ndarray:
    """The residuals (samples, ny) of one record of the run ``y`` over their noise."""
    r = record.samples(record.y - y) / problem.noise.std
    record.scale_errors(r, np.empty((*r.shape, 0)), 1 / problem.noise.std)
    return r


def compute_whitened_residuals(problem: EstimationProblem, runs: Runs) -> np.ndarray:
    """The residuals (samples, ny) of all records over their noise, whitened where the noise's colour is known; NaN in gaps."""
    residuals = []
    for record, (y, _) in zip(problem.records, runs, strict=True):
        r = _scale_errors(problem, record, y)
        residuals.append(np.column_stack([colour.whiten(r[:, j]) for j, colour in enumerate(problem.noise.colour)]))
    return np.concatenate(residuals)


def summarise_outliers(problem: EstimationProblem, runs: Runs) -> RobustReport:
    """What a robust fit made of the samples that it took for outliers; nothing for least squares."""
    loss = problem.loss
    if loss is None:
        return RobustReport()
    r = compute_whitened_residuals(problem, runs)
    names, left_out = [o.name for o in problem.model.outputs], problem.left_out
    gone = np.array([left_out.get(name, 0) for name in names])
    shares = (loss.outliers(r).sum(axis=0) + gone) / np.maximum(np.isfinite(r).sum(axis=0) + gone, 1)
    measured = [j for j in range(len(names)) if np.isfinite(r[:, j]).any()]
    return RobustReport(
        str(loss), {names[j]: float(loss.scale[j]) for j in measured}, {names[j]: float(shares[j]) for j in measured}
    )
