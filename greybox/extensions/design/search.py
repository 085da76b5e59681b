"""The search for the best input: every kind within the limits first, then the best of them refined sample by sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from greybox.base import TINY, DataError
from greybox.estimation.identifiability.sensitivity import fastest_and_slowest_rate
from greybox.extensions.design.adjoint import is_differentiable
from greybox.extensions.design.goals import Goal, GoalMaker
from greybox.extensions.design.inputs import (
    PLAY_SMOOTHING,
    Chirp,
    InputShape,
    LimitKeeper,
    Multisine,
    Prbs,
    Steps,
    compress_multisine,
    fit_into_limits,
    play,
    staircase,
)
from greybox.extensions.design.plant import INPUT_SEARCH_SEED, PlantScenario, make_plant
from greybox.extensions.design.problem import DesignPolicy, DesignProblem, LimitPrediction
from greybox.extensions.design.refinement import refine

# Optimal weights of given pieces of information: which sampling times, which lines of a spectrum, which of many small experiments.
#
# For the sum of information matrices ``M(w) = sum w_i M_i`` with ``w >= 0`` and ``sum w = 1`` the D-optimal weights follow from the
# multiplicative algorithm ``w_i <- w_i trace(M(w)^-1 M_i) / p`` (Silvey, Titterington and Torsney 1978), which climbs at every step; at the
# optimum no trace exceeds ``p`` (Kiefer and Wolfowitz 1960).


@dataclass(frozen=True)
class SamplingTimes:
    """When to sample.

    Parameters
    ----------
    times
        In seconds, ascending.
    weights
        Share of all samples that belongs there.
    efficiency
        Determinant per constant over that of sampling evenly, as a factor: how many times fewer samples do as well.
    """

    times: tuple[float, ...]
    weights: tuple[float, ...]
    efficiency: float


def weigh_optimally(information: np.ndarray, iterations: int = 2000, tolerance: float = 1e-6) -> np.ndarray:
    """The D-optimal weights of information matrices.

    Parameters
    ----------
    information : array (K, p, p)
        What each piece brings.
    iterations, tolerance
        The algorithm ends where no trace exceeds ``p`` by this share, or after so many steps.

    Returns
    -------
    array (K,)
        Weights that add up to one.

    Raises
    ------
    DataError
        Where all pieces together do not determine every constant.
    """
    count, p, _ = information.shape
    weights = np.full(count, 1 / count)
    scale = np.sqrt(np.maximum(np.diagonal(information.sum(axis=0)), TINY))
    # D-optimal weights do not depend on units; the inverse does not have to either.
    scaled = information / scale[:, None] / scale
    if np.linalg.cond(scaled.mean(axis=0)) > 1e13:
        raise DataError(
            "optimal weights: the pieces together do not determine every constant; fix one, or add a sensor"
        )
    for _ in range(iterations):
        inverse = np.linalg.inv(np.tensordot(weights, scaled, 1))
        # trace(M(w)^-1 M_i) / p: above one a piece brings more than its share, and gets more weight.
        gain = np.einsum("ij,kji->k", inverse, scaled) / p
        weights = weights * gain
        weights /= weights.sum()
        if gain.max() < 1 + tolerance:
            break
    return weights


def choose_sampling_times(
    question: DesignProblem, inputs: Mapping[str, np.ndarray], *, least_weight: float = 0.02
) -> SamplingTimes:
    """The D-optimal times at which to sample a run, in the approximate theory: a share of all samples for each.

    Parameters
    ----------
    question
        Its sampling time is the grid of the times that are considered; earlier records are not counted.
    inputs
        Name -> array (N,) over that grid.
    least_weight
        Neighbouring times are merged, and those of less weight left out.

    Returns
    -------
    SamplingTimes
        Times and weights.

    Raises
    ------
    DataError
        Where the run does not determine every constant.
    """
    plant = make_plant(question, question.model)
    run = plant.run(inputs)
    rows = np.nan_to_num(run.slopes)[:, :, : plant.count]
    information = np.einsum("kip,kiq->kpq", rows, rows)
    weights = weigh_optimally(information)
    active = weights > least_weight / 10
    edges = np.flatnonzero(np.diff(active.astype(int))) + 1
    # Weights on neighbouring grid points stand for one time between them.
    groups = [g for g in np.split(np.arange(len(weights)), edges) if active[g[0]] and weights[g].sum() >= least_weight]
    times = tuple(float(np.average(question.time[g], weights=weights[g])) for g in groups)
    shares = np.array([weights[g].sum() for g in groups])
    best = np.linalg.slogdet(np.tensordot(weights, information, 1))[1]
    even = np.linalg.slogdet(information.mean(axis=0))[1]
    return SamplingTimes(times, tuple((shares / shares.sum()).tolist()), float(np.exp((best - even) / plant.count)))


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


# Fewest of them, where several models are run: the number above is for one.
LEAST_STARTS = 2


def search_inputs(question: DesignProblem, keeper: LimitKeeper, make_goal: GoalMaker) -> list[TriedInput]:
    """Every kind of input at its best amplitude and band, and refined ones; the best first.

    Raises
    ------
    DataError
        Where no input keeps the limits.
    """
    policy = question.policy
    goal = make_goal(question.policy.scenarios, None)
    tried = try_shapes(question, keeper, goal, list_shapes(question, goal))
    # Rivals lie far apart on many inputs: the more models there are to run, the fewer starts are needed.
    models = {plant.model.title for plant in goal.plants}
    # Work of a refinement grows with the models that are run.
    count = max(policy.starts // len(models), LEAST_STARTS)
    starts = kinds_of(tried)[:count]
    if all(is_differentiable(p) for p in (*goal.plants, *keeper.plants)):
        refined = [s for start in starts for s in refine(question, keeper, make_goal, start.shapes, start.inputs)]
        # Refined inputs are judged like any other, by the compiled kernel and the whole record.
        tried += try_shapes(question, keeper, goal, refined)
    return sorted(tried, key=lambda t: -t.value)


# Shares of the largest allowed amplitude that are tried: a nonlinear effect may show at a small one.
INPUT_SEARCH_AMPLITUDES: tuple[float, ...] = (1.0, 0.4)


def try_shapes(
    question: DesignProblem, keeper: LimitKeeper, goal: Goal, shapes: Sequence[Mapping[str, InputShape]]
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
            largest, inputs, limits = fit_into_limits(keeper, each)
        except DataError as error:
            refusal = error
            continue
        options = [TriedInput(each, largest, inputs, limits, -np.inf)]
        # Smaller amplitudes keep the limits that the largest one keeps as far as the plant is near its rest; what is
        # chosen is predicted anew below.
        for smaller in INPUT_SEARCH_AMPLITUDES[1:]:
            played = play(question, each, smaller * largest)
            options.append(TriedInput(each, smaller * largest, played, limits, -np.inf))
        valued = [replace(o, value=evaluate(goal, o.inputs)) for o in options]
        best = max(valued, key=lambda o: o.value)
        if best.amplitude < largest:
            # A nonlinear plant may come closer to a limit under a smaller input: the prediction of the large one
            # does not vouch for it.
            best = replace(best, limits=keeper.predict(best.inputs))
        tried.append(best)
    if not tried:
        raise refusal or DataError("no input was tried")
    return sorted(tried, key=lambda t: -t.value)


def evaluate(goal: Goal, inputs: Mapping[str, np.ndarray], scale: float = 1.0) -> float:
    """The goal's value under inputs, by the compiled kernel."""
    return goal.value([plant.run(inputs) for plant in goal.plants], scale)


# Stages of the shift register: the sequence repeats after 4095 values.
PRBS_ORDER = 12
# Levels of a staircase up and down.
STAIRCASE_LEVELS = 7
# Random levels of a sequence of steps at the lowest band, more for higher ones.
STEP_COUNT = 12


def list_shapes(question: DesignProblem, goal: Goal) -> list[dict[str, InputShape]]:
    """Chirps, steps, a staircase, PRBS and multisines over several bands; a multisine whose spectrum suits the model."""
    policy = question.policy
    lowest, bands = find_bands(question)
    generator = np.random.default_rng(INPUT_SEARCH_SEED)
    shapes: list[InputShape] = [staircase(STAIRCASE_LEVELS, question.duration)]
    for high in bands:
        # Steps have their power up to a third of their frequency: three a period of ``high``.
        count = int(np.clip(3 * high * question.duration, STEP_COUNT, 0.4 * question.rows))
        shapes += [
            flat_multisine(high, policy),
            Chirp(lowest, high),
            Prbs(1 / (3 * high), PRBS_ORDER),
            Steps(tuple(generator.uniform(-1, 1, count).tolist()), question.duration),
        ]
    shaped = shape_spectrum(question, goal.plants[0], bands[-1])
    shapes += [shaped] if shaped is not None else []
    return [{name: shape.shifted(k) for k, name in enumerate(question.driven)} for shape in shapes]


# Share of half the sampling frequency up to which inputs are designed.
SHARE_OF_NYQUIST = 0.8


def find_bands(question: DesignProblem) -> tuple[float, list[float]]:
    """The lowest frequency in Hz of a sweep, and upper ends of bands: from what is slow in the model to what is fast."""
    policy = question.policy
    lowest = 1 / question.duration
    top = SHARE_OF_NYQUIST * 0.5 / question.sampling_time
    if question.hold != "zero":
        # A generator that averages samples takes away what lies above the band of that average.
        top /= PLAY_SMOOTHING / 2
    fastest, slowest = fastest_and_slowest_rate(question.model)
    high = min(top, fastest / 2) if fastest else top
    low = min(max(4 * lowest, slowest / 20), high)
    high = max(high, min(4 * lowest, top))
    return lowest, list(np.geomspace(low, high, policy.bands) if high > low else [high])


# Lines of a multisine over two decades.
FLAT_HARMONICS = tuple(sorted({round(k) for k in np.geomspace(1, 100, 40)}))


def flat_multisine(high: float, policy: DesignPolicy) -> Multisine:
    """A multisine up to ``high`` Hz with lines on a logarithmic scale and a low crest factor."""
    amplitudes = (1.0,) * len(FLAT_HARMONICS)
    phases = _compressed_phases(FLAT_HARMONICS, amplitudes, policy.crest_iterations)
    base = high / FLAT_HARMONICS[-1]
    return Multisine(tuple(base * k for k in FLAT_HARMONICS), amplitudes, phases)


# Lines of the spectrum whose power is optimised.
SPECTRUM_LINES = 12


def shape_spectrum(question: DesignProblem, plant: PlantScenario, high: float) -> Multisine | None:
    """A multisine whose power is D-optimal for a plant of small motion; None where single lines do not determine the constants."""
    policy = question.policy
    harmonics = sorted({round(k) for k in np.geomspace(1, 100, SPECTRUM_LINES)})
    base = high / harmonics[-1]
    information = []
    for k in harmonics:
        line = {name: Multisine((base * k,), (1.0,), (0.0,)) for name in question.driven}
        # Half the range, the same for every line: only the ratio of what they bring counts.
        run = plant.run(play(question, line, 0.5))
        if not run.finite:
            return None
        information.append(run.information[: plant.count, : plant.count])
    try:
        # Information of each line by itself adds up for a linear plant: sum w_i M_i; hence for small motion alone.
        weights = weigh_optimally(np.array(information))
    except DataError:
        return None
    kept = weights > 1e-3
    # Power is the square of an amplitude.
    amplitudes = np.sqrt(weights[kept])
    lines = tuple(int(k) for k in np.array(harmonics)[kept])
    phases = _compressed_phases(lines, tuple(np.round(amplitudes, 6).tolist()), policy.crest_iterations)
    frequencies = tuple(base * k for k in lines)
    return Multisine(frequencies, tuple(amplitudes.tolist()), phases, "multisine with optimal spectrum")


@lru_cache(maxsize=16)
def _compressed_phases(harmonics: tuple[int, ...], amplitudes: tuple[float, ...], iterations: int) -> tuple[float, ...]:
    return tuple(compress_multisine(harmonics, amplitudes, iterations // 8).tolist())


def kinds_of(tried: Sequence[TriedInput]) -> list[TriedInput]:
    """The best of each kind, the best kind first, of inputs of which the best comes first."""
    best: dict[str, TriedInput] = {}
    for each in tried:
        best.setdefault(each.kind, each)
    return list(best.values())
