"""What every goal of a design has: plants that must be run, a value to make large, and its slopes along what they show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from greybox.base import TINY, DataError, GreyboxError, ModelError
from greybox.extensions.design.plant import GOAL_PRIOR_SPREAD, PlantScenario, draw_plants, make_plant
from greybox.extensions.design.problem import CriterionName, DesignProblem
from greybox.model import Effect, Model
from greybox.model.effects.catalogue import applicable_effects, effect
from greybox.model.effects.scales import Scales, measure_scales, tailor_to_record


class Run(Protocol):
    """What a goal looks at: a run of the compiled kernel, or one that can be differentiated."""

    @property
    def outputs(self) -> np.ndarray:
        """(N, ny)"""

    @property
    def slopes(self) -> np.ndarray:
        """(N, ny, L), over the noise."""

    @property
    def finite(self) -> bool:
        """Whether the run went through."""


Slopes = tuple[np.ndarray, np.ndarray]
"""Slopes of a value along the outputs (N, ny) and along the slopes (N, ny, L) of one run."""


class Goal(Protocol):
    """A goal; its value is a logarithm: e to a difference is a factor on widths, amounts, or distances in noise."""

    @property
    def plants(self) -> Sequence[PlantScenario]:
        """What has to be run, in this order."""

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """The value that ``runs`` bring, each counted ``scale`` times; larger is better, minus infinity where a run overflows."""

    def differentiate(self, runs: Sequence[Run], scale: float = 1.0) -> tuple[float, list[Slopes]]:
        """The value and its slopes along each run; none where a run overflows."""


GoalMaker = Callable[[int, float | None], Goal]
"""``(draws, step) -> Goal``: the goal with so many draws of the constants, at a sampling time (None: that of the question)."""


def information_of(run: Run, scale: float) -> np.ndarray:
    """Fisher's information (L, L) of ``scale`` such runs; outputs without a sensor do not count."""
    # M = sum of S'S over samples and outputs, slopes over the noise; an output without a sensor has slope zero.
    rows = _fill_gaps(run.slopes).reshape(-1, run.slopes.shape[-1])
    return scale * rows.T @ rows


def _fill_gaps(slopes: np.ndarray) -> np.ndarray:
    """``slopes`` with zeros where there is no reading."""
    # Nearly every run of a search is whole, and to look takes a third of the time of a copy.
    return slopes if np.isfinite(slopes).all() else np.nan_to_num(slopes)


def _turn(slopes: np.ndarray, along: np.ndarray) -> np.ndarray:
    """``slopes`` (N, ny, L) times a matrix (L, L): as one product of many rows, not one for each sample."""
    flat = _fill_gaps(slopes).reshape(-1, slopes.shape[-1])
    return (flat @ along).reshape(slopes.shape)


def add_earlier(plant: PlantScenario, information: np.ndarray) -> np.ndarray:
    """Information (L, L) of a run with that of earlier records, and with the order of magnitude that is known anyway."""
    n = plant.count
    total = information.copy()
    # Adding a prior of a factor keeps the inverse finite where a record leaves a constant open, and hardly moves it
    # elsewhere.
    total[:n, :n] += plant.earlier + np.eye(n) / GOAL_PRIOR_SPREAD**2
    others = np.arange(n, len(total))
    total[others, others] += 1 / GOAL_PRIOR_SPREAD**2
    return total


# Precision: narrow intervals of chosen constants (A-, D-, E-optimality), averaged over what is not known of all constants.
#
# The value is minus half the logarithm of det C, trace C or the largest eigenvalue of C, per constant, where C is the covariance of the
# chosen constants in their scaled form (relative, for a positive constant), after this record and all earlier ones (Pronzato and
# Pazman, Design of experiments in nonlinear models, 2013, chapters 5 and 8).


@dataclass(frozen=True, eq=False)
class Precision:
    """The goal of narrow intervals.

    Parameters
    ----------
    plants
        One explanation at several sets of constants, the best one first.
    chosen
        Positions of the constants that count.
    criterion
        What of their covariance is made small.
    """

    plants: Sequence[PlantScenario]
    chosen: np.ndarray
    criterion: CriterionName

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Mean over the plants of minus the logarithm of the typical relative standard deviation."""
        if not all(run.finite for run in runs):
            return -np.inf
        return float(
            np.mean([self._measure(plant, run, scale)[0] for plant, run in zip(self.plants, runs, strict=True)])
        )

    def differentiate(self, runs: Sequence[Run], scale: float = 1.0) -> tuple[float, list[Slopes]]:
        """The value and its slopes along each run; outputs themselves do not matter."""
        if not all(run.finite for run in runs):
            return -np.inf, []
        values, result = [], []
        for plant, run in zip(self.plants, runs, strict=True):
            value, along = self._measure(plant, run, scale)
            values.append(value)
            # d(value) / dS = 2 S (d value / dM), M being S'S
            slopes = 2 * scale * _turn(run.slopes, along) / len(self.plants)
            result.append((np.zeros(run.outputs.shape), slopes))
        return float(np.mean(values)), result

    def covariance(self, number: int, run: Run, scale: float = 1.0) -> np.ndarray:
        """Covariance (n, n) of all scaled constants of plant ``number`` after ``run``."""
        plant = self.plants[number]
        n = plant.count
        # Cramer and Rao: the inverse of the information of this run and the earlier records.
        return np.linalg.inv(add_earlier(plant, information_of(run, scale)))[:n, :n]

    def _measure(self, plant: PlantScenario, run: Run, scale: float) -> tuple[float, np.ndarray]:
        """The value for one plant, and its slope along the information (L, L)."""
        total = add_earlier(plant, information_of(run, scale))
        inverse = np.linalg.inv(total)
        # Covariance of the chosen constants, the others estimated as well.
        c = inverse[np.ix_(self.chosen, self.chosen)]
        values, vectors = np.linalg.eigh((c + c.T) / 2)
        values = np.maximum(values, TINY)
        if self.criterion is CriterionName.D:
            # D: -(1 / 2n) ln det C, slope along C is C^-1 / n
            value, slope = -0.5 * np.mean(np.log(values)), np.linalg.inv(c) / len(c)
        elif self.criterion is CriterionName.A:
            # A: -(1/2) ln (trace C / n)
            value, slope = -0.5 * np.log(np.mean(values)), np.eye(len(c)) / np.sum(values)
        else:
            # E: -(1/2) ln lambda_max, whose slope is v v'; where two eigenvalues meet it is that of one of them.
            value, slope = -0.5 * np.log(values[-1]), np.outer(vectors[:, -1], vectors[:, -1]) / values[-1]
        columns = inverse[:, self.chosen]
        # dC = -M^-1 dM M^-1, and the value falls with C: the signs cancel.
        return float(value), 0.5 * columns @ slope @ columns.T


def make_precision(question: DesignProblem, draws: int, step: float | None = None) -> Precision:
    """The goal of ``question`` with so many ``draws`` of the constants; ``step``: another sampling time."""
    plant = make_plant(question, question.model, step=step)
    names = list(plant.variables.names)
    chosen = np.array([names.index(n) for n in (question.constants or names)], int)
    plants = [plant, *draw_plants(plant, question, draws)]
    return Precision(plants, chosen, question.criterion)


# Discrimination: rivals stay far apart after each has been refitted (T-optimality), for two explanations or more.
#
# For an explanation A that is right and a rival B, ``T = min over B's constants of |y_A - y_B|^2 + (what earlier records hold against the
# change)``, in units of the noise (Atkinson and Fedorov 1975): the cost by which B would lose. The minimum is that of B's linearisation.
# The value is half the logarithm of the harmonic mean of all ordered pairs, at the best constants of A and at drawn ones: the pair
# that lies closest counts most.


@dataclass(frozen=True)
class RivalPair:
    """The run of the plant that is right, and that of the rival, by their positions."""

    right: int
    rival: int


@dataclass(frozen=True, eq=False)
class Discrimination:
    """The goal of telling explanations apart.

    Parameters
    ----------
    plants
        Every explanation at its best constants, then the draws of each.
    pairs
        Which of them are compared.
    """

    plants: Sequence[PlantScenario]
    pairs: Sequence[RivalPair]

    def separations(self, runs: Sequence[Run], scale: float = 1.0) -> list[float]:
        """The cost by which the rival of each pair would lose."""
        return [self._compare(pair, runs, scale)[0] for pair in self.pairs]

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Half the logarithm of the harmonic mean of the costs."""
        if not all(run.finite for run in runs):
            return -np.inf
        return self._average(np.maximum(self.separations(runs, scale), TINY))

    @staticmethod
    def _average(costs: np.ndarray) -> float:
        # The harmonic mean: the pair that is told apart least weighs most.
        return float(-0.5 * np.log(np.mean(1 / costs)))

    def differentiate(self, runs: Sequence[Run], scale: float = 1.0) -> tuple[float, list[Slopes]]:
        """The value and its slopes along each run: at the minimum over the rival's constants these do not move (envelope theorem)."""
        if not all(run.finite for run in runs):
            return -np.inf, []
        result = [(np.zeros(run.outputs.shape), np.zeros(run.slopes.shape)) for run in runs]
        compared = [self._compare(pair, runs, scale) for pair in self.pairs]
        costs = np.maximum([cost for cost, _, _ in compared], TINY)
        # d/dc_k of -(1/2) ln mean(1 / c) = (1/2) c_k^-2 / sum(1 / c)
        weights = 0.5 / costs**2 / np.sum(1 / costs)
        for pair, weight, (_, left, change) in zip(self.pairs, weights, compared, strict=True):
            plant = self.plants[pair.rival]
            pull = 2 * scale * weight * left
            noise = np.where(plant.measured, plant.weight, 0.0)
            result[pair.right][0][:] += pull * noise
            result[pair.rival][0][:] -= pull * noise
            result[pair.rival][1][:] -= pull[:, :, None] * change
        return self._average(costs), result

    def _compare(self, pair: RivalPair, runs: Sequence[Run], scale: float) -> tuple[float, np.ndarray, np.ndarray]:
        """The cost, what the refitted rival leaves (N, ny), and the change of its constants (L,)."""
        plant, right, rival = self.plants[pair.rival], runs[pair.right], runs[pair.rival]
        weight = np.where(plant.measured, plant.weight, 0.0)
        apart = (right.outputs - rival.outputs) * weight
        rows = _fill_gaps(rival.slopes)
        flat = rows.reshape(-1, rows.shape[-1])
        total = add_earlier(plant, information_of(rival, scale))
        # Linearised refit: min |a - S d|^2 + d'(earlier) d, hence (S'S + earlier) d = S'a.
        change = np.linalg.solve(total, scale * (flat.T @ apart.ravel()))
        left = apart - rows @ change
        # At the minimum the cost is a'(a - S d), earlier records included.
        cost = scale * float(np.sum(apart * left))
        return max(cost, 0.0), left, change


def make_discrimination(question: DesignProblem, draws: int, step: float | None = None) -> Discrimination:
    """The goal of ``question`` with so many ``draws`` of the constants of each explanation."""
    plants = [make_plant(question, model, k, step) for k, model in enumerate(question.models)]
    count = len(plants)
    pairs = [RivalPair(a, b) for a in range(count) for b in range(count) if a != b]
    everything = list(plants)
    # Each draw is right once, and every other explanation has to be far from it.
    for a in range(count):
        for drawn in draw_plants(plants[a], question, draws):
            everything.append(drawn)
            pairs += [RivalPair(len(everything) - 1, b) for b in range(count) if b != a]
    return Discrimination(everything, pairs)


def closest_pairs(goal: Discrimination, costs: Sequence[float]) -> Mapping[tuple[int, int], float]:
    """For each pair of explanations the smaller cost of both orders and all draws."""
    closest: dict[tuple[int, int], float] = {}
    for pair, cost in zip(goal.pairs, costs, strict=True):
        one, other = goal.plants[pair.right].number, goal.plants[pair.rival].number
        key = min(one, other), max(one, other)
        closest[key] = min(cost, closest.get(key, np.inf))
    return closest


# Detection: the record that would show the smallest amount of each effect that could still hide.
#
# Each effect is put into the model nearly absent. The standard deviation of its amplitude, all other constants free, times a detection
# ratio is the smallest amount that would be seen. The value is minus the mean logarithm of these amounts, over the effects and over
# what is not known of the constants.


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that may hide: the model with a little of it, and the amplitude that tells how much."""

    name: str
    model: Model
    amplitude: str
    unit: str


# Share of what is known without data that is assumed of the amplitude of an effect which may hide: an effect that no record shows has a
# large amount, not an infinite one.
LEAST_PRIOR = 1e-08


@dataclass(frozen=True, eq=False)
class Detection:
    """The goal of showing small amounts of effects.

    Parameters
    ----------
    plants
        For each effect the model with a little of it, at several sets of constants.
    positions
        For each plant the position of the amplitude among its constants.
    """

    plants: Sequence[PlantScenario]
    positions: Sequence[int]

    def value(self, runs: Sequence[Run], scale: float = 1.0) -> float:
        """Minus the mean logarithm of the standard deviations of the amplitudes."""
        if not all(run.finite for run in runs):
            return -np.inf
        return self._average([self.amplitude_std(k, run, scale) for k, run in enumerate(runs)])

    @staticmethod
    def _average(stds: Sequence[float]) -> float:
        return float(-np.mean(np.log(np.maximum(stds, TINY))))

    def amplitude_std(self, number: int, run: Run | None, scale: float = 1.0) -> float:
        """Scaled standard deviation of the amplitude of plant ``number`` after ``run``; None: from the earlier records alone."""
        plant, k = self.plants[number], self.positions[number]
        information = np.zeros((plant.count, plant.count)) if run is None else information_of(run, scale)
        return float(np.sqrt(np.linalg.inv(self._total(plant, information, k))[k, k]))

    def differentiate(self, runs: Sequence[Run], scale: float = 1.0) -> tuple[float, list[Slopes]]:
        """The value and its slopes along each run."""
        if not all(run.finite for run in runs):
            return -np.inf, []
        stds, result = [], []
        for plant, run, k in zip(self.plants, runs, self.positions, strict=True):
            column = np.linalg.inv(self._total(plant, information_of(run, scale), k))[:, k]
            stds.append(float(np.sqrt(column[k])))
            # d(-ln std) / dM = (1/2) M^-1 e e' M^-1 / (M^-1)_kk
            along = 0.5 * np.outer(column, column) / max(column[k], TINY) / len(self.plants)
            result.append((np.zeros(run.outputs.shape), 2 * scale * _turn(run.slopes, along)))
        return self._average(stds), result

    def _total(self, plant: PlantScenario, information: np.ndarray, k: int) -> np.ndarray:
        """Information with what is known before; of the amplitude itself nothing is."""
        total = add_earlier(plant, information)
        # Of the amplitude nothing is known: all but a little of the prior on it is taken out again.
        total[k, k] -= (1 - LEAST_PRIOR) / GOAL_PRIOR_SPREAD**2
        return total


def list_hidden_effects(
    question: DesignProblem, reference: PlantScenario, inputs: Mapping[str, np.ndarray]
) -> list[HiddenEffect]:
    """The effects that may hide in the model, made ready by the size of things in a run over ``inputs``.

    Raises
    ------
    DataError, ModelError
        For an effect that has no place in the model, and where none has one.
    """
    _, states = reference.simulate(inputs)
    u = np.column_stack([inputs[i.name] for i in question.model.inputs])
    scales = measure_scales(question.model, states, u, question.sampling_time)
    named = list(question.effects)
    entries = [effect(name) for name in named] if named else applicable_effects(question.model)
    hidden, refused = [], {}
    for entry in entries:
        try:
            ready = _nearly_absent(question.model, tailor_to_record(entry, scales), scales)
        except GreyboxError as error:
            refused[entry.name] = str(error)
            continue
        if ready is not None:
            hidden.append(ready)
    if named and refused:
        raise ModelError(next(iter(refused.values())))
    if not hidden:
        raise DataError(
            f"{question.model.title}: no effect of the catalogue has a place in it; give roles to its signals, or name effects"
        )
    return hidden


# Multiple of an effect's usual amplitude at which its smallest visible amount is asked for: nearly absent.
DETECTION_PROBE = 0.02


def _nearly_absent(model: Model, entry: Effect, scales: Scales) -> HiddenEffect | None:
    """``model`` with a little of an effect; None where it is present already or its amount is no number of its own."""
    if entry.name in {e.name for e in model.effects}:
        return None
    extended = model + entry
    bound = extended.bound_effects[-1]
    probe = entry.probe(scales) if entry.probe else {}
    grid = entry.grid(scales) if entry.grid else {}
    values = {bound.model_names[n]: v[len(v) // 2] for n, v in grid.items()}
    values |= {bound.model_names[n]: DETECTION_PROBE * v for n, v in probe.items()}
    for name, value in values.items():
        low, high = extended.parameter(name).bounds
        extended = extended.start(**{name: min(max(value, low), high)})
    amplitudes = [bound.model_names[n] for n in entry.amplitudes]
    free = [q.name for q in extended.free_parameters]
    shown = [n for n in amplitudes if n in free]
    if not shown:
        return None
    return HiddenEffect(entry.name, extended, shown[0], extended.parameter(shown[0]).unit)


# Information that keeps such an amplitude where it is while the other constants are drawn.
HELD_AMPLITUDE = 10000.0


def make_detection(
    question: DesignProblem, hidden: Sequence[HiddenEffect], draws: int, step: float | None = None
) -> Detection:
    """The goal of ``question`` with so many ``draws`` of the constants of each model."""
    plants: list[PlantScenario] = []
    positions: list[int] = []
    for k, each in enumerate(hidden):
        plant = make_plant(replace(question, models=(each.model,), constants=()), each.model, k, step)
        position = plant.variables.names.index(each.amplitude)
        # Of the amount nothing is known; it stays small in every draw.
        held = plant.earlier.copy()
        held[position, position] += HELD_AMPLITUDE
        drawn = draw_plants(replace(plant, earlier=held), question, draws)
        plants += [plant, *(replace(p, earlier=plant.earlier) for p in drawn)]
        positions += [position] * (1 + len(drawn))
    return Detection(plants, positions)
