"""The search for the best input: every kind within the limits first, then the best of them refined sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from greybox.errors import DataError
from greybox.experiment_design.adjoint import SensitivityRun, is_differentiable
from greybox.experiment_design.goals import Goal
from greybox.experiment_design.inputs import (
    Chirp,
    InputShape,
    Multisine,
    PiecewiseConstant,
    Prbs,
    Steps,
    compress_multisine,
    staircase,
)
from greybox.experiment_design.limits import LimitKeeper, LimitPrediction, fit_into_limits
from greybox.experiment_design.plant import PlantScenario, list_plants
from greybox.experiment_design.play import envelope, play, smooth
from greybox.experiment_design.policy import InputSearchPolicy
from greybox.experiment_design.problem import DesignProblem
from greybox.experiment_design.sampling_times import weigh_optimally
from greybox.identifiability.generic_experiment import fastest_and_slowest_rate

GoalMaker = Callable[[int, float | None], Goal]
"""``(draws, step) -> Goal``: the goal with so many draws of the constants, at a sampling time (None: that of the question)."""


@dataclass(frozen=True, eq=False)
class TriedInput:
    """An input that was tried: shapes by input, amplitude, the signals (N,), what is predicted of the limits, and the goal's value."""

    shapes: Mapping[str, InputShape]
    amplitude: float
    inputs: Mapping[str, np.ndarray]
    limits: Mapping[str, LimitPrediction]
    value: float

    @property
    def kind(self) -> str:
        """What people call it."""
        return next(iter(self.shapes.values())).kind


def search_inputs(
    question: DesignProblem, keeper: LimitKeeper, make_goal: GoalMaker, share: float = 1.0
) -> list[TriedInput]:
    """Every kind of input at its best amplitude and band, and refined ones; the best first.

    Raises
    ------
    DataError
        Where no input keeps the limits.
    """
    policy = question.policy.search
    goal = make_goal(question.policy.margin.samples, None)
    tried = try_shapes(question, keeper, goal, list_shapes(question, goal), share)
    best_of_kind: dict[str, TriedInput] = {}
    for each in tried:
        best_of_kind.setdefault(each.kind, each)
    starts = list(best_of_kind.values())[: policy.starts]
    if all(is_differentiable(p) for p in (*goal.plants, *keeper.plants)):
        refined = [shape for start in starts for shape in refine(question, keeper, make_goal, start, share)]
        tried += try_shapes(question, keeper, goal, refined, share)
    return sorted(tried, key=lambda t: -t.value)


def try_shapes(
    question: DesignProblem,
    keeper: LimitKeeper,
    goal: Goal,
    shapes: Sequence[Mapping[str, InputShape]],
    share: float = 1.0,
) -> list[TriedInput]:
    """Each of the shapes at the best of the amplitudes that the limits allow, the best first.

    Raises
    ------
    DataError
        Where none keeps the limits.
    """
    tried: list[TriedInput] = []
    refusal: DataError | None = None
    for each in shapes:
        try:
            largest, inputs, limits = fit_into_limits(keeper, each, share)
        except DataError as error:
            refusal = error
            continue
        options = [TriedInput(each, largest, inputs, limits, -np.inf)]
        for smaller in question.policy.search.amplitudes[1:]:
            played = play(question, each, smaller * largest)
            options.append(TriedInput(each, smaller * largest, played, limits, -np.inf))
        valued = [replace(o, value=evaluate(goal, o.inputs)) for o in options]
        best = max(valued, key=lambda o: o.value)
        if best.amplitude < largest:
            best = replace(best, limits=keeper.predict(best.inputs))
        tried.append(best)
    if not tried:
        raise refusal or DataError("no input was tried")
    return sorted(tried, key=lambda t: -t.value)


def evaluate(goal: Goal, inputs: Mapping[str, np.ndarray], scale: float = 1.0) -> float:
    """The goal's value under inputs, by the compiled kernel."""
    return goal.value([plant.run(inputs) for plant in goal.plants], scale)


def list_shapes(question: DesignProblem, goal: Goal) -> list[dict[str, InputShape]]:
    """Chirps, steps, a staircase, PRBS and multisines over several bands; a multisine whose spectrum suits the model."""
    policy = question.policy.search
    lowest, bands = find_bands(question)
    generator = np.random.default_rng(policy.seed)
    shapes: list[InputShape] = [staircase(policy.staircase_levels, question.duration)]
    for high in bands:
        count = int(np.clip(3 * high * question.duration, policy.step_count, 0.4 * question.rows))
        shapes += [
            flat_multisine(high, policy),
            Chirp(lowest, high),
            Prbs(1 / (3 * high), policy.prbs_order),
            Steps(tuple(generator.uniform(-1, 1, count).tolist()), question.duration),
        ]
    shaped = shape_spectrum(question, goal.plants[0], bands[-1])
    shapes += [shaped] if shaped is not None else []
    return [{name: shape.shifted(k) for k, name in enumerate(question.driven)} for shape in shapes]


def find_bands(question: DesignProblem) -> tuple[float, list[float]]:
    """The lowest frequency in Hz of a sweep, and upper ends of bands: from what is slow in the model to what is fast."""
    policy = question.policy
    lowest = 1 / question.duration
    top = policy.play.share_of_nyquist * 0.5 / question.sampling_time
    if question.hold != "zero":
        top /= policy.play.smoothing / 2
    fastest, slowest = fastest_and_slowest_rate(question.model)
    high = min(top, fastest / 2) if fastest else top
    low = min(max(4 * lowest, slowest / 20), high)
    high = max(high, min(4 * lowest, top))
    return lowest, list(np.geomspace(low, high, policy.search.bands) if high > low else [high])


def flat_multisine(high: float, policy: InputSearchPolicy) -> Multisine:
    """A multisine up to ``high`` Hz with lines on a logarithmic scale and a low crest factor."""
    harmonics = _spread_harmonics()
    phases = _compressed_phases(harmonics, tuple([1.0] * len(harmonics)), policy.crest_iterations)
    base = high / harmonics[-1]
    return Multisine(tuple(base * k for k in harmonics), tuple([1.0] * len(harmonics)), phases)


def shape_spectrum(question: DesignProblem, plant: PlantScenario, high: float) -> Multisine | None:
    """A multisine whose power is D-optimal for a plant of small motion; None where single lines do not determine the constants."""
    policy = question.policy.search
    harmonics = sorted({round(k) for k in np.geomspace(1, 100, policy.spectrum_lines)})
    base = high / harmonics[-1]
    information = []
    for k in harmonics:
        line = {name: Multisine((base * k,), (1.0,), (0.0,)) for name in question.driven}
        run = plant.run(play(question, line, 0.5))
        if not run.finite:
            return None
        information.append(run.information[: plant.count, : plant.count])
    try:
        weights = weigh_optimally(np.array(information))
    except DataError:
        return None
    kept = weights > 1e-3
    amplitudes = np.sqrt(weights[kept])
    lines = tuple(int(k) for k in np.array(harmonics)[kept])
    phases = _compressed_phases(lines, tuple(np.round(amplitudes, 6).tolist()), policy.crest_iterations)
    frequencies = tuple(base * k for k in lines)
    return Multisine(frequencies, tuple(amplitudes.tolist()), phases, "multisine with optimal spectrum")


@lru_cache(maxsize=1)
def _spread_harmonics() -> tuple[int, ...]:
    return tuple(sorted({round(k) for k in np.geomspace(1, 100, 40)}))


@lru_cache(maxsize=16)
def _compressed_phases(harmonics: tuple[int, ...], amplitudes: tuple[float, ...], iterations: int) -> tuple[float, ...]:
    return tuple(compress_multisine(harmonics, amplitudes, iterations // 8).tolist())


@dataclass(frozen=True)
class DesignGrid:
    """The samples that are refined: ``rows`` of them, each held for ``hold`` samples of the record, all of it ``repeats`` times."""

    rows: int
    hold: int
    repeats: float

    @property
    def scale(self) -> float:
        """How many times the information of one pass over the grid the record brings."""
        return self.hold * self.repeats


def choose_grid(question: DesignProblem, highest: float) -> DesignGrid:
    """The grid for an input with frequencies up to ``highest`` in Hz."""
    policy = question.policy
    hold = max(1, int(1 / (policy.search.points_per_period * highest * question.sampling_time)))
    hold = min(hold, max(1, question.rows // policy.least_rows))
    rows = min(policy.search.most_rows, question.rows // hold)
    return DesignGrid(rows, hold, question.rows / (rows * hold))


def refine(
    question: DesignProblem, keeper: LimitKeeper, make_goal: GoalMaker, start: TriedInput, share: float = 1.0
) -> list[dict[str, InputShape]]:
    """``start`` improved level by level: L-BFGS-B within the range of each input, other limits as penalties that grow in rounds.

    One shape for each round: the first ones bring more and break limits, to which they are scaled down afterwards.
    """
    from scipy.optimize import minimize

    policy = question.policy.search
    grid = choose_grid(question, max(shape.highest for shape in start.shapes.values()))
    step = grid.hold * question.sampling_time
    small = replace(question, duration=grid.rows * step, sampling_time=step)
    goal = make_goal(policy.refined_scenarios, step)
    plants, draws = list_plants(small) if keeper.needs_runs else ([], [])
    others = [
        p
        for plant, drawn in zip(plants, draws, strict=True)
        for p in (plant, *drawn[: policy.refined_scenarios])
        if plant.number not in goal.explanations
    ]
    program = _Refinement(small, goal, others, keeper.needs_runs, grid.scale, share)
    iterations = program.affordable_iterations(policy)
    levels = program.read_levels(start, grid)
    shapes: list[dict[str, InputShape]] = []
    weight = policy.violation_weight
    for _ in range(1 if program.is_free else policy.rounds):
        result = minimize(
            program,
            levels.ravel(),
            args=(weight,),
            jac=True,
            method="L-BFGS-B",
            bounds=[(-1.0, 1.0)] * levels.size,
            options={"maxiter": iterations * (policy.rounds if program.is_free else 1)},
        )
        levels, weight = result.x.reshape(levels.shape), policy.violation_growth * weight
        shapes.append(program.to_shapes(levels, grid))
        if keeper.needs_runs:
            predictions = keeper.predict(play(question, shapes[-1], 1.0))
            program.tighten(max(p.usage for n, p in predictions.items() if n not in program.order), levels)
    return shapes


class _Refinement:
    """The cost of a refinement and its gradient, as a function of the levels (inputs x rows) between -1 and 1."""

    def __init__(
        self,
        question: DesignProblem,
        goal: Goal,
        others: Sequence[PlantScenario],
        watches: bool,
        scale: float,
        share: float,
    ) -> None:
        self.question, self.goal, self.others, self.watches, self.scale = question, goal, others, watches, scale
        self.names, self.order = question.driven, [i.name for i in question.model.inputs]
        self.share, self.tightness = share * (1 - question.policy.margin.reserve), 1.0
        self.envelope = envelope(question.rows, question.policy.play)
        self.smooths = question.hold != "zero"

    @property
    def is_free(self) -> bool:
        """Whether no limit but the ranges of the inputs can be violated on the way."""
        return not self.watches and not any(np.isfinite(self.question.limits[n].rate) for n in self.names)

    def affordable_iterations(self, policy: InputSearchPolicy) -> int:
        """Iterations of a round: fewer where one takes long, so that a design takes about as long for every model."""
        work = 0.0
        for plant in (*self.goal.plants, *self.others):
            size = len(plant.model.all_states) * (1 + plant.variables.size)
            work += self.question.rows * plant.problem.step.substeps * size
        return int(np.clip(policy.work / work, policy.least_iterations, policy.iterations))

    def read_levels(self, start: TriedInput, grid: DesignGrid) -> np.ndarray:
        """The levels (inputs, rows) of an input that was tried."""
        rows = len(next(iter(start.inputs.values())))
        rising = np.maximum(envelope(rows, self.question.policy.play), 0.1)
        levels = []
        for name in self.names:
            limit, rest = self.question.limits[name], self.question.rest(name)
            inside = rest + (start.inputs[name] - rest) / rising
            level = (inside - (limit.high + limit.low) / 2) / ((limit.high - limit.low) / 2)
            levels.append(level[:: grid.hold][: grid.rows])
        return np.clip(np.array(levels), -1.0, 1.0)

    def to_shapes(self, levels: np.ndarray, grid: DesignGrid) -> dict[str, InputShape]:
        """The levels as shapes; where the record repeats them, each pass begins and ends at rest."""
        inputs = self.inputs(levels.ravel())
        shapes: dict[str, InputShape] = {}
        for k, name in enumerate(self.names):
            limit = self.question.limits[name]
            middle, half = (limit.high + limit.low) / 2, (limit.high - limit.low) / 2
            chosen = (inputs[name] - middle) / half if grid.repeats > 1.5 else levels[k]
            shapes[name] = PiecewiseConstant(tuple(chosen.tolist()), self.question.sampling_time)
        return shapes

    def tighten(self, usage: float, levels: np.ndarray) -> None:
        """Take in how much wider than these runs ranges are predicted: ``usage`` of the limits, with everything that is not known."""
        inputs = self.inputs(levels.ravel())
        plants = [*self.others, *(self.goal.plants if self.goal.explanations else ())]
        own_usage = max(self._usage(plant, SensitivityRun(plant, inputs)) for plant in plants)
        if np.isfinite(usage) and own_usage > 0:
            self.tightness = max(1.0, usage / own_usage)

    def inputs(self, v: np.ndarray) -> dict[str, np.ndarray]:
        """All inputs at these levels."""
        levels = v.reshape(len(self.names), -1)
        result = {i.name: np.full(self.question.rows, self.question.rest(i.name)) for i in self.question.model.inputs}
        for k, name in enumerate(self.names):
            limit, rest = self.question.limits[name], self.question.rest(name)
            deviation = (limit.low + limit.high) / 2 + (limit.high - limit.low) / 2 * levels[k] - rest
            result[name] = rest + self.envelope * self._smoothed(deviation)
        return result

    def __call__(self, v: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
        """Cost and gradient."""
        inputs = self.inputs(v)
        order = [i.name for i in self.question.model.inputs]
        along = np.zeros((len(order), self.question.rows))
        runs = [SensitivityRun(plant, inputs) for plant in self.goal.plants]
        value = self.goal.value(runs, self.scale)
        if not np.isfinite(value):
            return 1e6, np.zeros_like(v)
        cost = -value
        shows_limits = self.watches and bool(self.goal.explanations)
        for run, (outputs, slopes) in zip(runs, self.goal.slopes(runs, self.scale), strict=True):
            states = np.zeros(run.states.shape)
            if shows_limits:
                penalty, along_outputs, states = self._range_penalty(run.plant, run)
                cost, outputs, states = cost + weight * penalty, outputs - weight * along_outputs, -weight * states
            along -= run.gradient(outputs, slopes, states)
        for name in self.names:
            penalty, slope = self._rate_penalty(name, inputs[name])
            cost += weight * penalty
            along[order.index(name)] += weight * slope
        for plant in self.others:
            run = SensitivityRun(plant, inputs)
            penalty, outputs, states = self._range_penalty(plant, run)
            cost += weight * penalty
            if penalty:
                along += run.gradient(weight * outputs, np.zeros(run.slopes.shape), weight * states)
        gradient = []
        for name in self.names:
            limit = self.question.limits[name]
            gradient.append((limit.high - limit.low) / 2 * self._smoothed(self.envelope * along[order.index(name)]))
        return float(cost), np.array(gradient).ravel()

    def _smoothed(self, values: np.ndarray) -> np.ndarray:
        return smooth(values, self.question.policy.play.smoothing) if self.smooths else values

    def _rate_penalty(self, name: str, u: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean square of what an input is too fast, as a share of its rate, and its slope."""
        limit = self.question.limits[name]
        slope = np.zeros(len(u))
        if not np.isfinite(limit.rate):
            return 0.0, slope
        most = limit.rate * self.question.sampling_time
        excess = np.diff(u) / most
        over = np.sign(excess) * np.maximum(np.abs(excess) - 1, 0)
        push = 2 * over / most / len(u)
        slope[1:] += push
        slope[:-1] -= push
        return float(np.sum(over**2) / len(u)), slope

    def _usage(self, plant: PlantScenario, run: SensitivityRun) -> float:
        """Share of the way to the limits that a run uses."""
        used = [0.0]
        for signal, _, _, room in self._limited(plant, run):
            used.append(float(signal.max() / room) * self.share / self.tightness)
        return max(used)

    def _limited(self, plant: PlantScenario, run: SensitivityRun) -> Iterator[tuple[np.ndarray, str, int, float]]:
        """Each limited signal as its distance from rest towards one end, its group and column, and the room to that end."""
        seen = set(self.order)
        groups = (
            ("outputs", [o.name for o in plant.model.outputs], run.outputs),
            ("states", [s.name for s in plant.model.all_states], run.states),
        )
        for group, names, signals in groups:
            for j, name in enumerate(names):
                if name in seen or name not in self.question.limits:
                    continue
                seen.add(name)
                limit, rest = self.question.limits[name], signals[0, j]
                for sign, end in ((1.0, limit.high - rest), (-1.0, rest - limit.low)):
                    room = end * self.share / self.tightness
                    if np.isfinite(room) and room > 0:
                        yield sign * (signals[:, j] - rest), f"{group}{'+' if sign > 0 else '-'}", j, room

    def _range_penalty(self, plant: PlantScenario, run: SensitivityRun) -> tuple[float, np.ndarray, np.ndarray]:
        """Mean square of what states and outputs are beyond their tightened limits, as a share of the room, and its slopes."""
        outputs, states = np.zeros(run.outputs.shape), np.zeros(run.states.shape)
        total, rows = 0.0, len(run.outputs)
        for distance, group, j, room in self._limited(plant, run):
            over = np.maximum(distance / room - 1, 0)
            total += float(np.sum(over**2)) / rows
            slopes = outputs if group.startswith("outputs") else states
            slopes[:, j] += (1.0 if group.endswith("+") else -1.0) * 2 * over / room / rows
        return total, outputs, states


def kinds_of(tried: Sequence[TriedInput]) -> Iterator[TriedInput]:
    """The best of each kind, the best kind first."""
    seen: set[str] = set()
    for each in tried:
        if each.kind not in seen:
            seen.add(each.kind)
            yield each
