"""An input improved sample by sample: L-BFGS-B within the range of each input, every other limit by an augmented Lagrangian.

The limits are those that the finished input is judged by: the middle of the runs at the best and at drawn constants, with the
spread between them, at every sample. A limit ``g <= 0`` of a sample with multiplier ``l`` adds ``(max(0, l + r g)^2 - l^2) / (2 r)`` to the
cost, and ``l`` becomes ``max(0, l + r g)`` after each round (Rockafellar 1974; Nocedal and Wright 2006, section 17.4).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base import TINY
from greybox.extensions.design.adjoint import SensitivityRun
from greybox.extensions.design.goals import Goal, GoalMaker
from greybox.extensions.design.inputs import (
    MARGIN_DEVIATIONS,
    MARGIN_RESERVE,
    PLAY_SMOOTHING,
    InputShape,
    LimitKeeper,
    PiecewiseConstant,
    envelope,
    play,
    smooth,
)
from greybox.extensions.design.plant import PlantScenario, list_plants
from greybox.extensions.design.problem import DesignPolicy, DesignProblem


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


# Samples that are refined one by one: a longer record repeats them or holds each for several samples.
INPUT_SEARCH_MOST_ROWS = 1200
# Samples that the refined input has in a period of the highest frequency of the input that it starts from.
INPUT_SEARCH_POINTS_PER_PERIOD = 5.0


def choose_grid(question: DesignProblem, highest: float) -> DesignGrid:
    """The grid for an input with frequencies up to ``highest`` in Hz."""
    policy = question.policy
    hold = max(1, int(1 / (INPUT_SEARCH_POINTS_PER_PERIOD * highest * question.sampling_time)))
    hold = min(hold, max(1, question.rows // policy.least_rows))
    rows = min(INPUT_SEARCH_MOST_ROWS, question.rows // hold)
    return DesignGrid(rows, hold, question.rows / (rows * hold))


def refine(
    question: DesignProblem,
    keeper: LimitKeeper,
    make_goal: GoalMaker,
    shapes: Mapping[str, InputShape],
    inputs: Mapping[str, np.ndarray],
) -> list[dict[str, InputShape]]:
    """``shapes``, which give ``inputs`` (N,), improved level by level.

    One shape for each round: the first ones may pass limits, to which they are scaled down afterwards.
    """
    from scipy.optimize import minimize

    policy = question.policy
    grid = choose_grid(question, max(shape.highest for shape in shapes.values()))
    step = grid.hold * question.sampling_time
    small = replace(question, duration=grid.rows * step, sampling_time=step)
    goal = make_goal(policy.refined_scenarios, step)
    plants, draws = list_plants(small) if keeper.needs_runs else ([], [])
    groups = [(plant, *drawn) for plant, drawn in zip(plants, draws, strict=True)]
    program = InputRefinement(small, goal, groups, grid.scale)
    iterations = program.affordable_iterations(policy)
    levels = program.read_levels(inputs, grid)
    refined: list[dict[str, InputShape]] = []
    for _ in range(1 if program.is_free else policy.rounds):
        result = minimize(
            program,
            levels.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=program.bounds,
            options={"maxiter": iterations * (policy.rounds if program.is_free else 1)},
        )
        levels = result.x.reshape(levels.shape)
        refined.append(program.to_shapes(levels, grid))
        if not program.is_free:
            predictions = keeper.predict(play(question, refined[-1], 1.0))
            others = {n: p for n, p in predictions.items() if n not in program.order}
            program.end_round(levels, keeper.load(others)[0] if others else 0.0)
    return refined


@dataclass(frozen=True)
class SampledLimit:
    """One limit over all samples: ``values`` (n,) are to be at most zero; ``slopes`` are those along each run's signal, or the input."""

    key: tuple[str | int, ...]
    values: np.ndarray
    slopes: Sequence[np.ndarray]


# Factor on the weight of violated limits from round to round.
VIOLATION_GROWTH = 3.0
# Fewest of them.
LEAST_ITERATIONS = 8
# Samples times substeps times states with their sensitivities that a round may run: some seconds.
INPUT_SEARCH_WORK = 200000000.0
# Weight of half the mean square of what limits are passed by, as a share of the room to them, in the first round; multipliers make the
# limits exact afterwards.
VIOLATION_WEIGHT = 600.0


class InputRefinement:
    """The cost of a refinement and its gradient, as a function of the levels (inputs x rows) between -1 and 1.

    Parameters
    ----------
    question
        On the grid that is refined.
    goal
        What is to be made large.
    groups
        For each explanation the plants whose runs show states and outputs that are limited; empty where only inputs are.
    scale
        How many times the information of the grid counts.
    """

    def __init__(
        self, question: DesignProblem, goal: Goal, groups: Sequence[Sequence[PlantScenario]], scale: float
    ) -> None:
        self.question, self.goal, self.groups, self.scale = question, goal, groups, scale
        self.names, self.order = question.driven, [i.name for i in question.model.inputs]
        # (inputs, 1) each, to stand beside levels (inputs, rows)
        self.middle, self.half, self.rest = np.array([question.span(name) for name in self.names]).T[:, :, None]
        self.tightness, self.weight = 1.0, VIOLATION_WEIGHT
        self.multipliers: dict[tuple[str | int, ...], np.ndarray] = {}
        self.envelope = envelope(question.rows, question.policy)

    @property
    def is_free(self) -> bool:
        """Whether no limit but the ranges of the inputs can be violated on the way."""
        return not self.groups and not any(np.isfinite(self.question.limits[n].rate) for n in self.names)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Lowest and highest value of each level: the range of its input, or the share of it that may be used."""
        ends: list[tuple[float, float]] = []
        for name in self.names:
            limit, share = self.question.limits[name], self.question.share(name)
            middle, half, rest = self.question.span(name)
            low, high = ((rest + share * (end - rest) - middle) / half for end in (limit.low, limit.high))
            ends += [(max(low, -1.0), min(high, 1.0))] * self.question.rows
        return ends

    def affordable_iterations(self, policy: DesignPolicy) -> int:
        """Iterations of a round: fewer where one takes long, so that a design takes about as long for every model."""
        sizes = [(plant, 1 + plant.variables.size) for plant in self.goal.plants]
        sizes += [(plant, 1) for group in self.groups for plant in group]
        substates = sum(p.problem.step.substeps * len(p.model.all_states) * columns for p, columns in sizes)
        return int(np.clip(INPUT_SEARCH_WORK / (self.question.rows * substates), LEAST_ITERATIONS, policy.iterations))

    def read_levels(self, inputs: Mapping[str, np.ndarray], grid: DesignGrid) -> np.ndarray:
        """The levels (inputs, rows) of an input that was tried."""
        tried = np.array([inputs[name] for name in self.names])
        # Undo the soft start; where that is nearly zero the level cannot be told, and a tenth bounds what is read.
        rising = np.maximum(envelope(tried.shape[1], self.question.policy), 0.1)
        levels = (self.rest + (tried - self.rest) / rising - self.middle) / self.half
        return np.clip(levels[:, :: grid.hold][:, : grid.rows], -1.0, 1.0)

    def to_shapes(self, levels: np.ndarray, grid: DesignGrid) -> dict[str, InputShape]:
        """The levels as shapes; where the record repeats them, each pass begins and ends at rest."""
        chosen = levels if grid.repeats <= 1.5 else (self._play(levels) - self.middle) / self.half
        step = self.question.sampling_time
        return {n: PiecewiseConstant(tuple(c.tolist()), step) for n, c in zip(self.names, chosen, strict=True)}

    def _play(self, levels: np.ndarray) -> np.ndarray:
        """The inputs that move (inputs, rows) at these levels, as `play` makes them: the gradient is that of what is played."""
        # u = rest + envelope * smoothed(middle + half v - rest)
        return self.rest + self.envelope * self._smoothed(self.middle + self.half * levels - self.rest)

    def inputs(self, levels: np.ndarray) -> dict[str, np.ndarray]:
        """All inputs at these levels."""
        resting = {name: np.full(self.question.rows, self.question.rest(name)) for name in self.order}
        return resting | dict(zip(self.names, self._play(levels), strict=True))

    def end_round(self, levels: np.ndarray, load: float) -> None:
        """Move the multipliers; take in how much wider than these runs the whole record is predicted: ``load`` of what it may use."""
        inputs = self.inputs(levels)
        constraints = list(self._rates(inputs))
        loads = [0.0]
        for group in self.groups:
            ranges = list(self._ranges(self._runs(group, inputs)))
            loads += [float(c.values.max() + 1) / self.tightness for c in ranges]
            constraints += ranges
        for c in constraints:
            # l <- max(0, l + r g)
            pushed = np.maximum(self.multipliers.get(c.key, 0.0) + self.weight * c.values, 0.0)
            if np.isfinite(pushed).all():
                self.multipliers[c.key] = pushed
        self.weight *= VIOLATION_GROWTH
        if np.isfinite(load) and np.isfinite(max(loads)) and max(loads) > 0:
            # The whole record, with more draws, is predicted to load this much more than the refined part: limits of
            # the next round are as much closer.
            self.tightness = max(1.0, load / max(loads))

    def __call__(self, v: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and gradient."""
        inputs = self.inputs(v.reshape(len(self.names), -1))
        along = np.zeros((len(self.order), self.question.rows))
        runs = [SensitivityRun(plant, inputs) for plant in self.goal.plants]
        value, slopes_of_runs = self.goal.differentiate(runs, self.scale)
        if not np.isfinite(value):
            return 1e6, np.zeros_like(v)
        cost = -value
        for run, (outputs, slopes) in zip(runs, slopes_of_runs, strict=True):
            along -= run.gradient(outputs, slopes, np.zeros(run.states.shape))
        for constraint in self._rates(inputs):
            penalty, push = self._penalise(constraint)
            cost += penalty
            # d(u_{k+1} - u_k): the later sample with plus, the earlier one with minus.
            slope, row = push * constraint.slopes[0], self.order.index(str(constraint.key[1]))
            along[row, 1:] += slope
            along[row, :-1] -= slope
        for group in self.groups:
            watched = self._runs(group, inputs)
            if not all(run.finite for run in watched):
                return 1e6, np.zeros_like(v)
            pushes = [(np.zeros(run.outputs.shape), np.zeros(run.states.shape)) for run in watched]
            active = False
            for constraint in self._ranges(watched):
                penalty, push = self._penalise(constraint)
                cost += penalty
                if not push.any():
                    continue
                active, (_, kind, column, _) = True, map(int, constraint.key)
                for both, slope in zip(pushes, constraint.slopes, strict=True):
                    both[kind][:, column] += push * slope
            if active:
                for run, (outputs, states) in zip(watched, pushes, strict=True):
                    along += run.gradient(outputs, np.zeros(run.slopes.shape), states)
        # Back through what makes the input of a level: du/dv = half * smoothing * envelope, and the symmetric average is its own
        # transpose.
        driven = along[[self.order.index(name) for name in self.names]]
        return float(cost), (self.half * self._smoothed(self.envelope * driven)).ravel()

    def _runs(self, group: Sequence[PlantScenario], inputs: Mapping[str, np.ndarray]) -> list[SensitivityRun]:
        return [SensitivityRun(plant, inputs, sensitive=False) for plant in group]

    def _smoothed(self, rows: np.ndarray) -> np.ndarray:
        if self.question.hold == "zero":
            return rows
        return np.array([smooth(row, PLAY_SMOOTHING) for row in rows])

    def _penalise(self, constraint: SampledLimit) -> tuple[float, np.ndarray]:
        """What a limit adds to the cost, and the slopes (n,) of that along its values."""
        before = self.multipliers.get(constraint.key, 0.0)
        push = np.maximum(before + self.weight * constraint.values, 0.0)
        count = len(constraint.values)
        # (max(0, l + r g)^2 - l^2) / 2 r, mean over samples
        return float(np.sum(push**2 - np.square(before))) / (2 * self.weight * count), push / count

    def _rates(self, inputs: Mapping[str, np.ndarray]) -> Iterator[SampledLimit]:
        """The rate of each input, both ways."""
        for name in self.names:
            most = self.question.limits[name].rate * self.question.sampling_time * self.question.share(name)
            if np.isfinite(most):
                for sign in (1, -1):
                    slope = np.full(self.question.rows - 1, sign / most)
                    yield SampledLimit(("rate", name, sign), sign * np.diff(inputs[name]) / most - 1, [slope])

    def _ranges(self, runs: Sequence[SensitivityRun]) -> Iterator[SampledLimit]:
        """Each limited output and state of an explanation, both ends: the middle of its runs with their spread, over the room."""
        plant, limits = runs[0].plant, self.question.limits
        for name, (kind, column) in plant.locate(n for n in limits if n not in self.order).items():
            signals = np.array([(run.outputs, run.states)[kind][:, column] for run in runs])
            rest, middle = signals[0, 0], signals.mean(axis=0)
            apart = signals - middle
            std = np.sqrt(np.mean(apart**2, axis=0))
            # d std / d signal_i = (signal_i - mean) / (n std)
            along_std = apart / np.maximum(std, TINY) / len(runs)
            for sign, end in ((1, limits[name].high - rest), (-1, rest - limits[name].low)):
                room = end * (1 - MARGIN_RESERVE) * self.question.share(name) / self.tightness
                if not (np.isfinite(room) and room > 0):
                    continue
                # (mean + 3 std - rest) / room - 1 <= 0, and the same downwards
                values = (sign * (middle - rest) + MARGIN_DEVIATIONS * std) / room - 1
                slopes = (sign / len(runs) + MARGIN_DEVIATIONS * along_std) / room
                yield SampledLimit((plant.number, kind, column, sign), values, list(slopes))
