"""From where a fit is searched: as its model stands, with its effects or without, with bodies at rest, and far about it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import reduce

import numpy as np

from greybox.base import Finding, ModelError, Severity
from greybox.base.interrupts import HeldInterrupt
from greybox.base.linear_algebra import eliminate
from greybox.base.numerics import RANK_CUTOFF
from greybox.data.experiment import Experiment
from greybox.data.noise import NoiseModel
from greybox.estimation import result_parts
from greybox.estimation.findings import (
    LAST_DIGIT,
    EstimationCode,
    is_at_noise,
    is_output_at_noise,
)
from greybox.estimation.noise_loop import (
    StartCost,
    estimate_by_simulation_error,
    to_huber,
)
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.optimum import SimulationOptimum
from greybox.estimation.options import ColourTreatment, FitOptions, Transcription
from greybox.estimation.transcription.decision_vector import DecisionVector
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.problem import EstimationProblem, FitProgressCallback, TranscriptionReason
from greybox.estimation.transcription.shooting_cost import Evaluation
from greybox.model import Effect, Model
from greybox.model.effects.scales import (
    MANY_SHAPES_STARTS,
    Scales,
    count_starts,
    is_neutral,
    list_effect_values,
    list_neutral_values,
    measure_scales,
)

# Best fit in per cent below which the free run of an output is hardly better than a constant: a tenth of its variance, which a jump at
# the beginning or a trend explains already.
LEAST_BEST_FIT = 5.0
# Where the model's own start explains nothing, others lie between value / factor and value x factor: three decades, as whoever
# guesses a constant seldom misses it by more.
STARTS_FACTOR = 30.0


@dataclass(frozen=True, eq=False)
class StartSearch:
    """A fit as it searches, wherever it begins.

    Parameters
    ----------
    problem
        The estimation problem with the model's own start.
    experiments
        The records, from which that of another start is laid out.
    options
        Options of the fit.
    colour
        How coloured noise is treated.
    report
        Called with the progress of a search.
    """

    problem: EstimationProblem
    experiments: Experiment | Sequence[Experiment]
    options: FitOptions
    colour: ColourTreatment | str = ColourTreatment.KNOWN
    report: FitProgressCallback | None = None

    @property
    def near(self) -> StartSearch:
        """The same from an optimum on: no part of the records comes before the whole."""
        return replace(self, options=replace(self.options, progressive=False))

    def prepare(self, model: Model, initial: Sequence[Mapping[str, float]] = ()) -> EstimationProblem:
        """The problem from where ``model`` stands, its records from the ``initial`` states."""
        return prepare_problem(model, self.experiments, self.problem.noise, self.options, initial=initial)

    def search(self, problem: EstimationProblem, model: Model | None = None) -> SimulationOptimum:
        """The end of a search from where ``problem`` begins; of ``model``, where that has start values of its own."""
        end = estimate_by_simulation_error(problem, self.options, self.colour, self.report)
        return SimulationOptimum(model or problem.model, end)

    def rank(self, end: SimulationOptimum) -> float:
        """`compute_ratio` of an end: the smaller the better."""
        return compute_ratio(end.evaluation.cost, end.misfit, self.problem.noise)

    def leaves_known_noise(self, end: SimulationOptimum) -> bool:
        """Whether only noise is left whose level something tells: no other start finds more."""
        return self.problem.noise.is_level_known and is_at_noise(end)


def search_from_starts(
    fit: StartSearch, interrupt: HeldInterrupt, *, goes_on: bool
) -> tuple[SimulationOptimum, SimulationOptimum, tuple[result_parts.StartResult, ...], tuple[Finding, ...]]:
    """The end from the model's own start, the best end of all starts, where each other one ended, and what is to be said of it.

    A search that ``goes_on`` from where another ended is not to end elsewhere: it has one start.
    """
    with_effects = None if goes_on else _begin_with_effects(fit)
    begun = with_effects or fit.search(fit.problem)
    if goes_on:
        return begun, begun, (), ()
    # A model whose effects had no values of their own began where they change nothing already.
    beginnings = (_search_from_rest,) if with_effects else (_search_from_neutral_effects, _search_from_rest)
    for search_from_there in beginnings:
        if begun.status is TerminationStatus.INTERRUPTED:
            return begun, begun, (), ()
        again = search_from_there(fit, begun)
        if again is not None and fit.rank(again) < fit.rank(begun):
            begun = SimulationOptimum(begun.model, again.solution.with_work_of(begun.solution))
    if begun.status is TerminationStatus.INTERRUPTED or not begun.model.free_parameters:
        return begun, begun, (), ()
    # Other starts are compared by the steps that the search took: at explicit ones a stiff model runs from few of them.
    if begun.solution.problem.step.adaptive:
        fit = replace(fit, problem=fit.problem.with_steps_of(begun.solution.problem))
    trouble = find_trouble(begun, fit.problem, with_effects is None and fit.options.other_starts > 0)
    if trouble is None:
        return begun, begun, (), ()
    return begun, *_try_other_starts(fit, begun, trouble, interrupt)


@dataclass(frozen=True, eq=False)
class FreshEffects:
    """The ``effects`` of a model that change nothing as they stand, and what the records can show of them.

    ``plain`` is the optimum without them, ``scales`` are the peaks and times of its runs.
    """

    effects: Sequence[Effect]
    plain: SimulationOptimum
    scales: Scales


def measure_fresh_effects(fit: StartSearch) -> FreshEffects | None:
    """The effects of the model of a fit that have no values of their own yet; None without one, or where nothing runs without them.

    Their constants may have no slope where they change nothing, so what the records can show of them is measured on the model without.
    """
    model = fit.problem.model
    fresh = [e for e in model.effects if is_neutral(model, e)] if fit.options.other_starts else []
    if not fresh:
        return None
    try:
        plain = reduce(Model.without, (e.name for e in fresh), model)
    except ModelError:  # a tie or a schedule of the user's needs them
        return None
    optimum = fit.search(fit.prepare(plain))
    if not np.isfinite(optimum.evaluation.cost):
        return None
    # As it was fitted: the free run of an unstable plant may leave the record.
    _, states = optimum.solution.simulate()[0]
    record = optimum.problem.records[0]
    scales = measure_scales(optimum.fitted_model, states, record.u, float(np.median(record.h)))
    return FreshEffects(fresh, optimum, scales)


def _begin_with_effects(fit: StartSearch, fresh: FreshEffects | None = None) -> SimulationOptimum | None:
    """The best end of searches that begin where the effects of a model begin; None where every effect has values of its own.

    The model is fitted without its fresh effects first; from that optimum, and from the constants as given, the effects begin at sizes and
    shapes that the record can show (those that a discovery begins at). The optimum without them is a start as well: a model with an
    effect more is never worse.
    """
    fresh = fresh or measure_fresh_effects(fit)
    if fresh is None:
        return None
    model, smaller, scales, near = fit.problem.model, fresh.plain, fresh.scales, fit.near
    plain = smaller.model
    # Only a state that is estimated is given where it began: at rest, or at a declared start value, the model says it itself.
    began = [plain.system.state_names[k] for k in smaller.variables.free_states]
    initial = [{name: t.initial_state[name] for name in began} for t in smaller.traces] if began else []
    fitted = {name: smaller.fitted_model.values[name] for name in (q.name for q in plain.free_parameters)}
    # Its best point is that of the whole model, whose effects are neutral.
    if smaller.status is TerminationStatus.INTERRUPTED:
        began_at = near.prepare(model.start(**fitted), initial)
        evaluation = began_at.shooting().evaluate(began_at.variables.here)
        ended = replace(
            smaller.search, problem=began_at, variables=began_at.variables, evaluation=evaluation, joined=None
        )
        return SimulationOptimum(model, ended)

    begun = near.prepare(model, initial)
    # By the cost that the search will have: segments of an unstable plant, where the model without them was fitted so.
    is_segmented = smaller.solution.transcription == Transcription.MULTIPLE
    searched_by = replace(near.options, transcription=Transcription.MULTIPLE) if is_segmented else near.options
    start_cost = StartCost(begun, searched_by)
    begins: list[dict[str, float]] = [fitted]
    searched = 0
    # One effect after the other, each beside the best of those before it.
    for each in fresh.effects:
        values, count = list(list_effect_values(model, each, scales)), count_starts(each, scales)
        searched = max(searched, count)
        bases = [begins[0]]
        if count <= MANY_SHAPES_STARTS:
            bases.append({**begins[0], **{q.name: q.value for q in plain.free_parameters}})
        more = [{**base, **value} for base in bases for value in values]
        promised = (start_cost.predict(begun.variables.start_at(begin)) for begin in more)
        costs = {k: cost for k, cost in enumerate(promised) if np.isfinite(cost)}
        begins = [*(more[k] for k in sorted(costs, key=costs.__getitem__)), *begins]
    ends: list[SimulationOptimum] = []

    for begin in (*begins[:searched], fitted):
        # The optimum without the effects is searched from only where no other start does better.
        if begin is fitted and any(fit.rank(end) <= fit.rank(smaller) for end in ends):
            continue
        ends.append(near.search(near.prepare(model.start(**begin), initial), model))
        if ends[-1].status is TerminationStatus.INTERRUPTED or fit.leaves_known_noise(ends[-1]):
            break
    return min(ends, key=fit.rank)


def _search_from_neutral_effects(fit: StartSearch, begun: SimulationOptimum) -> SimulationOptimum | None:
    """The end of searches from where effects change nothing, of a model whose effects began at values of their own.

    Those are made where the model without them does as well or better: a model with an effect more is never worse. None where they are
    not, and where only noise is left to explain.
    """
    model, values = begun.model, list_neutral_values(begun.model)
    if not values or fit.leaves_known_noise(begun):
        return None
    absent = replace(fit, problem=replace(fit.problem, model=model.start(**values)))
    fresh = measure_fresh_effects(absent)
    if fresh is None or fit.rank(fresh.plain) >= fit.rank(begun):
        return None
    return _begin_with_effects(absent, fresh)


# Standard deviations of the cost of noise alone, the square root of twice the number of readings, below which nothing is left to explain.
CHANCE_OF_COST = 4.0


def _search_from_rest(fit: StartSearch, begun: SimulationOptimum) -> SimulationOptimum | None:
    """The end of a search from the constants of ``begun`` with bodies at rest that it has set in motion from there; None without one.

    A first velocity that dry friction stops within a few rows makes up for constants that are wrong at the time, and no slope leads back.
    """
    system, first = fit.problem.model.system, fit.problem.variables.initial
    moved = [
        system.state_names[j]
        for j in sorted({d.state for d in system.dry})
        if first.free[j] and not first.guess[:, j].all()
    ]
    is_moving = any(trace.initial_state[name] for trace in begun.traces for name in moved)
    cost, count = begun.evaluation.cost, sum(misfit.samples for misfit in begun.misfit.values())
    is_noise = fit.problem.noise.is_level_known and cost <= count + CHANCE_OF_COST * np.sqrt(2 * count)
    if not is_moving or is_noise:
        return None
    free = [system.state_names[j] for j in np.flatnonzero(first.free)]
    rest = [{n: 0.0 if n in moved else trace.initial_state[n] for n in free} for trace in begun.traces]
    model = begun.model.start(**{q.name: begun.fitted_model.values[q.name] for q in begun.model.free_parameters})
    return fit.search(fit.prepare(model, rest), begun.model)


class SearchTrouble(StrEnum):
    """Why another start may do better than the one that was searched from."""

    EXPLAINS_NOTHING = "explains_nothing"
    """The end is hardly better than a constant for some output."""

    STANDS = "stands"
    """The search stands where it began."""

    GAVE_UP = "gave_up"
    """It reached its iteration limit."""

    LOST_CONSTANTS = "lost_constants"
    """It ended where constants that the records determine elsewhere change nothing."""

    ANOTHER_COURSE = "another_course"
    """It ended above a noise that is known where errors grow along the record: free runs of such a model have many optima."""


def find_trouble(begun: SimulationOptimum, problem: EstimationProblem, looks_elsewhere: bool) -> SearchTrouble | None:
    """What is wrong with the end of a search; lost constants, which take some runs to see, only where one ``looks_elsewhere``."""
    if explains_nothing(begun):
        return SearchTrouble.EXPLAINS_NOTHING
    if stands_where_it_began(begun):
        return SearchTrouble.STANDS
    if begun.status is TerminationStatus.ITERATION_LIMIT:
        return SearchTrouble.GAVE_UP
    if looks_elsewhere and has_lost_constants(begun, problem):
        return SearchTrouble.LOST_CONSTANTS
    return SearchTrouble.ANOTHER_COURSE if may_follow_another_course(begun) else None


def may_follow_another_course(optimum: SimulationOptimum) -> bool:
    """Whether a free run of a stiff model that is unstable along the record ended above a noise that is known: an oscillation of another
    period is an optimum of its own.
    """
    solution = optimum.solution
    return (
        solution.strategy.values.get("reason") in (TranscriptionReason.UNSTABLE, TranscriptionReason.FREE_RUN_FOLLOWS)
        and solution.problem.step.adaptive is not None
        and solution.problem.noise.is_level_known
        and not is_at_noise(optimum)
    )


def explains_nothing(optimum: SimulationOptimum) -> bool:
    """Whether there is no run, or one that is hardly better than a constant for an output that has more than noise to explain."""
    return not np.isfinite(optimum.evaluation.cost) or bool(list_unexplained(optimum))


def list_unexplained(optimum: SimulationOptimum) -> dict[str, float]:
    """Best fit in per cent of the outputs above their noise for which the free run is hardly better than a constant."""
    return {
        name: m.best_fit_percent
        for name, m in optimum.misfit.items()
        if m.best_fit_percent < LEAST_BEST_FIT and not is_output_at_noise(optimum, name)
    }


def stands_where_it_began(optimum: SimulationOptimum) -> bool:
    """Whether a search got stuck without having moved any free constant in its digits."""
    end, begin = optimum.fitted_model.values, optimum.model.values
    return optimum.status is TerminationStatus.STUCK and all(
        abs(end[q.name] - begin[q.name]) <= LAST_DIGIT * abs(begin[q.name]) for q in optimum.model.free_parameters
    )


# Points about the start at which a model shows how many of its constants the records could tell.
LOOKS_ELSEWHERE = 3
# A direction that a thousand times the size a constant began with does not show has gone: what a rate that runs away leaves behind ...
LOST_SIZES = 1e3
# ... where a hundred times that size show it elsewhere: between the two a direction may be either, and none is counted twice.
SHOWN_SIZES = 1e2
# Share of the cost that a search must have gained to have been under way.
NOTHING_GAINED = 0.01


def has_lost_constants(optimum: SimulationOptimum, problem: EstimationProblem) -> bool:
    """Whether a search ended, above the noise, where more directions of the constants change nothing than at its start or near it.

    There a term has gone (an exponent that left the record, two of a sum that became one, a rate that ran away), and the slopes with it:
    nothing leads back. A model whose constants the records never tell apart has as many such directions everywhere, and loses none. Of
    joined segments nothing is said: what they show is not what free runs from elsewhere show.
    """
    if optimum.solution.joined or is_at_noise(optimum) or not np.isfinite(optimum.evaluation.cost):
        return False
    start = problem.variables
    size = np.where(start.base == 0, start.scale, np.abs(start.base))
    if not (lost := count_open_directions(optimum.variables, optimum.evaluation, LOST_SIZES * size, 0.0)):
        return False
    begin = problem.shooting().evaluate(start.here)
    # A search that began at the optimum has lost nothing on its way.
    if begin.cost <= (1 + NOTHING_GAINED) * optimum.evaluation.cost:
        return False
    near = draw_starts(optimum.model, LOOKS_ELSEWHERE, seed=0, factor=STARTS_FACTOR)
    evaluations = ((v, problem.shooting(v).evaluate(v.here)) for v in map(start.with_values, near))
    return any(
        # What may be rounding there is not what has gone here.
        count_open_directions(v, elsewhere, SHOWN_SIZES * size, RANK_CUTOFF) < lost
        for v, elsewhere in itertools.chain([(start, begin)], evaluations)
        if np.isfinite(elsewhere.hessian).all()
    )


def count_open_directions(variables: DecisionVector, evaluation: Evaluation, step: np.ndarray, rounding: float) -> int:
    """Directions of the constants along which a ``step`` of each (nf,) changes the cost by less than the residual's variance there.

    That is of the point itself: a run that has gone far astray shows any direction beside the noise, and few beside its own errors. So do
    those whose curvature is less than the share ``rounding`` of the largest.
    """
    n, span = len(variables.which), step / variables.spans
    constants, states = np.arange(n), np.arange(n, len(evaluation.hessian))
    # First states are estimated as well: Schur's complement; d'Hd / 2 is the change of the cost by a step d.
    reduced = np.nan_to_num(eliminate(evaluation.hessian, constants, states) @ evaluation.hessian[:, constants])
    curvature = np.linalg.eigvalsh(reduced * np.outer(span, span) / 2)
    variance = evaluation.cost / max(evaluation.count, 1)
    return int(np.sum(curvature < max(variance, rounding * curvature.max(initial=0.0))))


def _try_other_starts(
    fit: StartSearch, first: SimulationOptimum, trouble: SearchTrouble, held: HeldInterrupt
) -> tuple[SimulationOptimum, tuple[result_parts.StartResult, ...], tuple[Finding, ...]]:
    """The best end of ``first`` and of other starts, where each ended, best first, and what is to be said of it.

    After Ctrl-C, which ``held`` notes, that of those that are done.

    Of many starts, drawn far about the model's own, those are searched whose first run fits best: one run tells most of what a search
    from there is worth, and a search takes dozens. Where the best end explains nothing yet, as many follow about the scales that the
    records show (`find_scales`).
    """
    model, problem, options = first.model, fit.problem, fit.options
    loss = options.to_loss()
    # One run from each start, judged as its search will judge it: squares would tell how it follows the outliers.
    judged = StartCost(problem if loss is None else replace(problem, loss=to_huber(loss, options)), options)

    def compute_cost(begin: Mapping[str, float]) -> float:
        if held.requested:  # by Ctrl-C: no search follows, and what was found so far is kept
            return np.inf
        variables = problem.variables.with_values(begin)
        return float(judged.evaluate(variables)[0].cost)

    begins, ends = [{q.name: q.value for q in model.free_parameters}], [first]
    ratios = [fit.rank(first)]
    best, drawn = first, 0
    for seed in range(2 if options.other_starts and not held.requested else 0):
        about = model.start(**find_scales(model, compute_cost)) if seed else model
        # Ten draws for each search, and as many with other signs: a draw takes one run, and a search dozens.
        open_signs = any(q.bounds[0] < 0 < q.bounds[1] for q in model.free_parameters)
        near = draw_starts(about, 10 * options.other_starts * (1 + open_signs), seed=seed, factor=STARTS_FACTOR)
        costs = [compute_cost(begin) for begin in near]
        drawn += len(near)
        for k in [k for k in np.argsort(costs) if np.isfinite(costs[k])][: options.other_starts]:
            ends.append(fit.search(fit.prepare(model.start(**near[k])), model))
            begins.append(near[k])
            ratios.append(fit.rank(ends[-1]))
            if ends[-1].status is TerminationStatus.INTERRUPTED or fit.leaves_known_noise(ends[-1]):
                break
        best = ends[int(np.argmin(ratios))]
        if ends[-1].status is TerminationStatus.INTERRUPTED or not explains_nothing(best):
            break
    ranked = sorted(range(len(ends)), key=lambda k: ratios[k])
    before, after = ({n: m.best_fit_percent for n, m in end.misfit.items()} for end in (first, best))
    starts = tuple(
        result_parts.StartResult(
            begins[k],
            {q.name: ends[k].fitted_model.values[q.name] for q in model.free_parameters}
            if np.isfinite(ratios[k])
            else {},
            ratios[k],
            str(ends[k].status),
            ends[k].search.seconds,
        )
        for k in ranked
    )
    starts = starts if drawn else ()
    counts = {"drawn": drawn, "searched": len(ends) - 1}
    if explains_nothing(best):
        is_run = bool(np.isfinite(ratios[ranked[0]]))
        values = {**counts, "best_fit": list_unexplained(best) if is_run else {}}
        # Without a run, and without another start, the status has said it.
        is_news = is_run or bool(drawn)
        return (
            best,
            starts,
            (Finding(EstimationCode.NO_START_HELPS, Severity.WARNING, "", values),) * is_news,
        )
    if best is first:
        return best, starts, ()
    values = {
        **counts,
        "trouble": str(trouble),
        "before": (list_unexplained(first) or before) if np.isfinite(first.evaluation.cost) else {},
        "after": after,
    }
    return best, starts, (Finding(EstimationCode.OTHER_START_TAKEN, Severity.NOTE, "", values),)


# Decades from its own value over which the scale of a constant is looked for: no slip of a unit is farther off.
SCALE_DECADES = 6


def find_scales(model: Model, compute_cost: Callable[[Mapping[str, float]], float]) -> dict[str, float]:
    """Values of the free constants, each in turn at the decade from its own value, of either sign within its bounds, whose run fits best.

    A constant far outside of what the records can show (a rate of 1e-6/h in a record of hours) changes nothing there, and so does all
    that is drawn about it. Where no decade fits better it stays.
    """
    values = {q.name: q.value for q in model.free_parameters}
    for q in model.free_parameters:
        sizes = [q.value * 10.0**k for k in range(-SCALE_DECADES, SCALE_DECADES + 1) if q.value]
        decades = (sign * size for sign in (1, -1) for size in sizes if sign * size != q.value)
        tried = [q.value, *(value for value in decades if q.bounds[0] < value < q.bounds[1])]
        costs = [compute_cost({**values, q.name: value}) for value in tried]
        values[q.name] = tried[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]
    return values


def draw_starts(
    model: Model, starts: int, seed: int | np.random.Generator = 0, factor: float = 3.0
) -> list[dict[str, float]]:
    """Start values about the model's own: each free constant log-uniform between value / factor and value x factor, within its bounds.

    In every second start the constants whose bounds hold zero inside take either sign. A constant at zero has no size to vary: it is
    uniform within its bounds, and stays where they are open. Raises ModelError for a factor of one or less.
    """
    if not factor > 1:
        raise ModelError(f"factor {factor:g} of the random starts: it must be greater than one; 3 is usual")
    rng = np.random.default_rng(seed)
    drawn = []
    for number in range(max(starts, 0)):
        begin = {}
        for q in model.free_parameters:
            (low, high), share = q.bounds, rng.uniform()
            if q.value == 0:
                begin[q.name] = float(low + share * (high - low)) if np.isfinite(low) and np.isfinite(high) else 0.0
                continue
            sign = np.sign(q.value)
            # Half of the starts keep the signs that were given: where several are open, all of these are seldom right by chance.
            if number % 2 and low < 0 < high:
                sign = rng.choice((-1.0, 1.0))
            smaller, larger = np.clip(sorted((sign * abs(q.value) / factor, sign * abs(q.value) * factor)), low, high)
            # Uniform in the logarithm, from the smaller to the larger: a factor up is as likely as one down.
            begin[q.name] = float(sign * np.exp(np.log(sign * smaller) + share * np.log(larger / smaller)))
        drawn.append(begin)
    return drawn


def compute_ratio(cost: float, misfit: Mapping[str, result_parts.Misfit], known: NoiseModel) -> float:
    """Rms of the misfits of all outputs over their ``known`` noise; infinite where there is no run, and no ``cost``.

    Known before any search: a level that each end learns from its own residual makes all alike.
    """
    std = dict(zip(known.outputs, known.std.tolist(), strict=True))
    if not np.isfinite(cost) or not misfit:
        return float(np.inf)
    # Of a robust fit without its outliers: they would rank the ends by how each follows them.
    errors = {name: m.error if m.without_outliers and m.error is not None else m.rmse for name, m in misfit.items()}
    return float(np.sqrt(np.mean([(error / std[name]) ** 2 for name, error in errors.items()])))
