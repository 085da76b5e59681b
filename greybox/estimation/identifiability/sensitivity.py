"""What the outputs do when constants change: a matrix of slopes, whichever way it was computed, and its rank."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.linalg import block_diag

from greybox.base import DataError, Finding, ModelError
from greybox.base.linear_algebra import COLUMN_RANK, ColumnDecomposition, decompose_columns, range_basis
from greybox.base.numerics import COLUMN_CUTOFF, INTEGRATING_POLE, TINY
from greybox.data.experiment import Experiment, stack_signals
from greybox.estimation.transcription.decision_vector import DecisionVector, InitialStates
from greybox.estimation.transcription.shooting_cost import SingleShooting
from greybox.model import Model
from greybox.model.validation import check_constants
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.kernel.interpreted import InterpretedKernel
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.records import to_record
from greybox.simulation.simulate import declared_initial_state, simulate


class IdentifiabilityCode(StrEnum):
    """Findings about models, records and inputs, and what would determine more constants."""

    MEASURE_OUTPUT = "measure_output"
    ADD_SENSOR = "add_sensor"
    FIX_CONSTANTS = "fix_constants"
    RICHER_RECORD = "richer_record"

    NO_INPUT_MOVES = "no_input_moves"
    EXCITATION_ORDER_LOW = "excitation_order_low"
    EXCITATION_BAND_NARROW = "excitation_band_narrow"

    OTHER_ANSWER = "other_answer"
    EXCHANGEABLE = "exchangeable"

    RECORDS_SHOW_FEWER = "records_show_fewer"
    AVERAGING_ONLY = "averaging_only"
    PRIORS_COUNT = "priors_count"
    NO_FREE_CONSTANT = "no_free_constant"
    MODEL_OVERFLOWS = "model_overflows"
    SIMULATED_RECORD = "simulated_record"


# Where nothing special is true: random constants near the nominal ones, and records with a rich input.


# Seed of the simulated record that stands in for data.
RANDOM_EXPERIMENT_SEED = 1
# Noise of each output of that record, over its movement.
RANDOM_EXPERIMENT_NOISE_SHARE = 0.01


def simulate_generic_record(model: Model) -> tuple[Experiment, Finding]:
    """A simulated record of ``model`` at its start values, and a finding that says what was assumed.

    The input takes a new random level, between -1 and 1 in its unit, every few samples (between 0 and 1 where a state
    would reach its bound otherwise). Raises DataError where the model cannot be simulated that way.
    """
    step, rows = choose_sampling(model)
    time = step * np.arange(rows)
    for low in lowest_input_levels(model):
        generator = np.random.default_rng(RANDOM_EXPERIMENT_SEED)
        inputs = {i.name: draw_levels(generator, rows, low) for i in model.inputs}
        run = simulate(model, {"time": time, **inputs})
        # At a bound the equations are cut off, and constants beside it do not show.
        if run.overflow is None and not touches_bounds(model, stack_signals(list(run.states.values()), rows)):
            break
    if run.overflow is not None:
        raise DataError(
            f"{model.title} cannot be simulated at its start values: it overflows after {run.overflow:.3g} s;"
            " give other values with --start, or a record to check it with"
        )
    outputs = {name: values for name, values in run.outputs.items() if np.ptp(values) > 0}
    if not outputs:
        raise DataError(f"{model.title}: no output moves when every input does; check the equations of the outputs")
    noise = {name: RANDOM_EXPERIMENT_NOISE_SHARE * float(np.std(values)) for name, values in outputs.items()}
    record = Experiment("generic", time, inputs, run.record(noise, generator).outputs)
    figures = {
        "rows": rows,
        "step": step,
        "inputs": {i.name: {"low": low, "high": 1.0, "unit": i.unit} for i in model.inputs},
        "noise_share": RANDOM_EXPERIMENT_NOISE_SHARE,
    }
    return record, Finding(IdentifiabilityCode.SIMULATED_RECORD, values=figures)


# Fewest rows of that record.
RANDOM_EXPERIMENT_MIN_ROWS = 1000
# Most rows; of a stiffer model the slow end counts, and what is faster is integrated between the samples.
MAX_ROWS = 12000
# Length of that record in the slowest time constants of the model.
SLOW_TIME_CONSTANTS = 10.0
# Samples in the fastest time constant of the model.
SAMPLES_PER_TIME_CONSTANT = 2.0


def choose_sampling(model: Model) -> tuple[float, int]:
    """Sampling time in seconds and number of rows that show the model's fastest and slowest motion."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return 0.01, RANDOM_EXPERIMENT_MIN_ROWS
    step = 1 / (SAMPLES_PER_TIME_CONSTANT * fastest)
    rows = math.ceil(SLOW_TIME_CONSTANTS / slowest / step)
    if rows > MAX_ROWS:  # the slow end counts: what is faster is integrated between the samples
        return SLOW_TIME_CONSTANTS / slowest / MAX_ROWS, MAX_ROWS
    return step, max(rows, RANDOM_EXPERIMENT_MIN_ROWS)


def fastest_and_slowest_rate(model: Model) -> tuple[float, float]:
    """The fastest pole and the slowest decay at the start values, in 1/s; zeros for a model without either."""
    p = np.array(list(model.values.values()))
    jacobian = model.system.jacobian(declared_initial_state(model), np.zeros(len(model.inputs)), p).full()
    if not np.isfinite(jacobian).all():
        return 0.0, 0.0
    eigenvalues = np.linalg.eigvals(jacobian)
    size = np.abs(eigenvalues)
    moving = size > INTEGRATING_POLE * max(size.max(initial=0.0), TINY)
    if not moving.any():
        return 0.0, 0.0
    # Decays alone end a motion: an unstable or undamped mode has no time constant to wait for.
    decays = -eigenvalues.real[moving & (eigenvalues.real < -INTEGRATING_POLE * size.max())]
    return float(size[moving].max()), float(decays.min() if len(decays) else size[moving].min())


def lowest_input_levels(model: Model) -> tuple[float, ...]:
    """Least levels of a generic input to try: where a state has a lower bound, an input below zero may take it there."""
    return (-1.0, 0.0) if any(math.isfinite(s.bounds[0]) for s in model.all_states) else (-1.0,)


# Distance of a state from its bound, as a share of its movement, from which it touches it.
BOUND_MARGIN = 1e-06


def touches_bounds(model: Model, x: np.ndarray) -> bool:
    """Whether a state, of (N, nx), comes to its bounds."""
    low, high = np.array([s.bounds for s in model.all_states]).reshape(-1, 2).T
    near = BOUND_MARGIN * np.ptp(x, axis=0)
    return bool((x <= low + near).any() or (x >= high - near).any())


def draw_levels(generator: np.random.Generator, rows: int, low: float) -> np.ndarray:
    """Random levels (rows,), each kept for a random number of samples, short and long ones alike."""
    # Uniform in the logarithm: fast and slow parts of a model are both excited.
    lengths = np.ceil(np.exp(generator.uniform(0, np.log(rows / 20), rows))).astype(int)
    return np.repeat(generator.uniform(low, 1, rows), lengths)[:rows]


# Free constants are drawn within a factor ``exp`` of this about their values: two.
RANDOM_EXPERIMENT_CONSTANT_SPREAD: float = math.log(2.0)
# Draws of constants before the values themselves are taken, where rules leave no room.
RANDOM_EXPERIMENT_TRIES = 20


def draw_constants(
    model: Model, generator: np.random.Generator, spread: float = RANDOM_EXPERIMENT_CONSTANT_SPREAD
) -> np.ndarray:
    """All parameters (np,): free ones at random within ``e^spread`` times their values, fixed ones as they are.

    Inside bounds and rules; where these leave no room the spread shrinks, down to the values themselves.
    """
    parameters = model.all_parameters
    for _ in range(RANDOM_EXPERIMENT_TRIES):
        draw = generator.uniform(-1.0, 1.0, len(parameters))
        p = [q.value for q in parameters]
        for k, q in enumerate(parameters):
            (low, high), exponent = q.bounds, spread * draw[k]
            if q.fixed:
                continue
            drawn = q.value * math.exp(exponent)
            if (
                q.value == 0.0
            ):  # off: a hundredth of its range, so that a slope along it shows, on the side where it may be
                span = high - low if math.isfinite(high - low) else 1.0
                drawn = 0.01 * span * (abs(exponent) if low == 0.0 else exponent)
            p[k] = min(max(drawn, low), high)
        try:
            check_constants(model.title, model.rules, model.parameters_at(p))
        except ModelError:
            spread /= 2
            continue
        return np.array(p)
    return np.array([q.value for q in parameters])


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Slopes of the outputs at one point, along the logarithm (or the scale) of each free constant.

    ``blocks``: output -> ``(states, constants)``, matrices (R, nx) along the initial states, which are unknown as well, and
    (R, np) along the constants. ``doubtful``: singular values below this may come from the integration.
    """

    blocks: dict[str, tuple[np.ndarray, np.ndarray]]
    doubtful: float = COLUMN_RANK.certain

    def compress(self) -> Sensitivity:
        """The same information in as few rows as there are columns."""
        small = {}
        for name, (states, constants) in self.blocks.items():
            # R'R = X'X: rank and singular values are those of all the rows.
            r = np.asarray(np.linalg.qr(np.hstack([states, constants]), mode="r"))
            small[name] = r[:, : states.shape[1]], r[:, states.shape[1] :]
        return Sensitivity(small, self.doubtful)

    def decompose(self, outputs: Sequence[str]) -> ColumnDecomposition:
        """Slopes along the constants that no change of the initial states can undo, columns scaled to length one before that."""
        # Initial states are unknown, too: what they can make up for tells nothing of the constants.
        basis = range_basis(np.vstack([self.blocks[name][0] for name in outputs]))
        constants = np.vstack([self.blocks[name][1] for name in outputs])
        for _ in range(2):  # the second time for what rounding left
            constants = constants - basis @ (basis.T @ constants)
        return decompose_columns(constants, replace(COLUMN_RANK, certain=self.doubtful), self.lengths(outputs))

    def lengths(self, outputs: Sequence[str]) -> np.ndarray:
        """Length of each constant's column: how much it moves the outputs."""
        return np.linalg.norm(np.vstack([self.blocks[name][1] for name in outputs]), axis=0)


def highest_ranks(points: Sequence[Sensitivity], outputs: Sequence[str]) -> dict[int, ColumnDecomposition]:
    """Number of a point -> its decomposition with only ``outputs`` measured and what is doubtful left out, where the rank is highest.

    Among the points that are certain if there are any.
    """
    ranks = {k: point.decompose(outputs).without_doubtful() for k, point in enumerate(points)}
    # Rank drops on special points alone: the highest one that was seen is that of almost all.
    ranks = {k: r for k, r in ranks.items() if r.is_certain} or ranks
    highest = max(r.rank for r in ranks.values())
    return {k: r for k, r in ranks.items() if r.rank == highest}


# Sensitivities of any other model: free runs over records with a rich random input, differentiated by the kernel.


# Amplitudes of the input, in its unit, one after the other.
RANDOM_EXPERIMENT_AMPLITUDES: tuple[float, ...] = (1.0, 0.3, 3.0)
# Wide points for constants that show at none of the others.
WIDE_POINTS = 2
# Other constants that are tried where a run overflows.
TRIES_PER_POINT = 3
# Singular values up to this may be integration error.
INTEGRATION_DOUBT = 1e-06


def compute_free_run_sensitivities(
    model: Model, at_rest: bool, seed: int, count: int
) -> list[tuple[Sensitivity, np.ndarray]]:
    """Sensitivities at ``count`` random points, or a few more, and all parameters (np,) there.

    Constants that are zero, which switches an effect off, are given a value that shows. Raises DataError where the model
    cannot be run at any point. Points where a state touches its bound are taken only if there are no others: the
    equations are cut off there.
    """
    model = switch_on(model, np.random.default_rng((seed, 0)))
    points: list[tuple[Sensitivity, np.ndarray]] = []
    touching: list[tuple[Sensitivity, np.ndarray]] = []
    draws = count * TRIES_PER_POINT
    for k, amplitude in enumerate((RANDOM_EXPERIMENT_AMPLITUDES * draws)[:draws]):
        if len(points) >= count:
            break
        generator = np.random.default_rng((seed, k))
        # Where runs overflow or touch bounds, points nearer to the nominal one are tried.
        p = draw_constants(model, generator, RANDOM_EXPERIMENT_CONSTANT_SPREAD / 4 ** (k // count))
        point = _compute_point(set_parameters(model, p), at_rest, amplitude, generator)
        if point is not None:
            # Cut off at a bound the slopes are those of other equations.
            (touching if point.doubtful > INTEGRATION_DOUBT else points).append((point, p))
    moved = [s.lengths(list(s.blocks)) > 0 for s, _ in points]
    for k in range(0 if moved and np.any(moved, axis=0).all() else WIDE_POINTS):
        generator = np.random.default_rng((seed, draws + k))
        p = draw_constants(model, generator, RANDOM_EXPERIMENT_CONSTANT_SPREAD / 4)
        wide = _compute_wide_point(set_parameters(model, p), at_rest, generator)
        if wide is not None:
            points.append((wide, p))
    points = points or touching[:count]
    if not points:
        raise DataError(
            f"{model.title} overflows at every random point near its values: it cannot be checked;"
            " give other values with model.start(...), or with --start"
        )
    return points


# Share of the outputs' movement that an effect makes which is off, such as a friction of zero, once it is switched on.
SWITCHED_ON_SHARE = 0.1
# Rounds of switching on: some constants show only after others are on.
SWITCHING_ROUNDS = 4


def switch_on(model: Model, generator: np.random.Generator) -> Model:
    """``model`` with its free constants of zero at values that move the outputs by about a tenth.

    Some show only after others have been switched on, and too large a value may be cut off by the equations: hence
    several rounds.
    """
    off = [q for q in model.free_parameters if q.value == 0.0]
    names = [q.name for q in model.free_parameters]
    for _ in range(SWITCHING_ROUNDS if off else 0):
        # Movement of the outputs, as a share of their own, that a unit of each free constant makes.
        records = [_make_record(model, step, 1.0, generator) for step in choose_sampling_times(model)]
        start = declared_initial_state(model)
        sensitivity = _compute_sensitivity(model, records, np.tile(start, (len(records), 1)), True, 1)
        slope = np.zeros(len(names))
        if sensitivity is not None:
            slope = sensitivity.lengths(list(sensitivity.blocks)) / np.sqrt(RUN_ROWS * len(records))
        values = {}
        for q in off:
            value, moves = model.values[q.name], slope[names.index(q.name)]
            if value != 0.0:  # too large where the equations cut it off
                values[q.name] = value if moves > 0 else value / 10
                continue
            up, down = (
                np.clip([SWITCHED_ON_SHARE / moves, -SWITCHED_ON_SHARE / moves], *q.bounds) if moves else (0.0, 0.0)
            )
            values[q.name] = float(up or down)
        if all(values[q.name] == model.values[q.name] for q in off):
            break
        model = model.start(**values)
    return model


# Rows of each run whose slopes are computed.
RUN_ROWS = 600


# Share of its start value by which an initial state is off.
STATE_OFFSET = 0.05
# Times as many substeps of a second run, which tells small singular values from integration error.
SUBSTEP_FACTOR = 4
# Singular values up to this are looked at again with finer steps: integration error shrinks.
RECHECK_BELOW = 1e-05


def _compute_point(model: Model, at_rest: bool, amplitude: float, generator: np.random.Generator) -> Sensitivity | None:
    """One point, None where a run overflows. A second, finer run tells small singular values from integration error."""
    records = [_make_record(model, step, amplitude, generator) for step in choose_sampling_times(model)]
    start = declared_initial_state(model)
    nudges = 1 + STATE_OFFSET * generator.uniform(-1, 1, (len(records), len(start))) * (not at_rest)
    factor = SUBSTEP_FACTOR

    def compute(finer: int) -> Sensitivity | None:
        return _compute_sensitivity(model, records, start * nudges, at_rest, finer)

    # A coarse step may overflow where a finer one does not.
    runs = ((finer, compute(finer)) for finer in (1, factor))
    finer, coarse = next(((finer, s) for finer, s in runs if s is not None), (1, None))
    if coarse is None:
        return None
    names = list(coarse.blocks)
    before = coarse.decompose(names).values
    # Neither rounding nor surely information: only these are worth a second run.
    small = (before > COLUMN_CUTOFF) & (before < RECHECK_BELOW)
    if not small.any():
        return coarse
    fine = compute(factor * finer)
    if fine is None:
        return coarse
    # Information stays where the step is refined; the error of a method of order four falls by far more than the
    # factor.
    shrunk = before[small & (fine.decompose(names).values < before / factor)]
    return replace(coarse, doubtful=max(coarse.doubtful, 2 * float(shrunk.max(initial=0.0))))


# Amplitudes of the records of a wide point, each with the factor to the next one: from what an open valve sees to a dead zone of any unit.
WIDE_AMPLITUDES: tuple[float, ...] = tuple(3.0**k for k in range(-2, 16))
# Share of its range that a state may begin in.
WIDE_STARTS = 0.9
# Share of its movement that a state keeps from its bounds: an integration with other steps does not come to them either.
WIDE_MARGIN = 1e-3
# A state beyond this is on its way to overflow.
LARGEST_STATE = 1e12
# Fewest rows before a record of a wide point comes to a bound.
WIDE_ROWS = 20


def _compute_wide_point(model: Model, at_rest: bool, generator: np.random.Generator) -> Sensitivity | None:
    """One point whose records go as far as states may: a dead zone, a curve over a state that moves slowly; None where none runs.

    Its records have inputs of any size and, unless ``at_rest``, begin anywhere between the bounds of the states. Each ends before it comes
    to a bound or overflows.
    """
    start = declared_initial_state(model)
    bounds = np.array([s.bounds for s in model.all_states]).reshape(-1, 2)
    ranged = np.isfinite(bounds).all(axis=1) & (not at_rest)
    parts = []
    for amplitude, step in itertools.product(WIDE_AMPLITUDES, choose_sampling_times(model)):
        record, begin = _make_record(model, step, amplitude, generator), start.copy()
        begin[ranged] = bounds[ranged].mean(axis=1)
        begin[ranged] += WIDE_STARTS / 2 * np.ptp(bounds[ranged], axis=1) * generator.uniform(-1, 1, int(ranged.sum()))
        with np.errstate(all="ignore"):  # rows that are not finite are left out
            run = simulate(model, record, initial=dict(zip(model.system.state_names, begin.tolist(), strict=True)))
        states = stack_signals(list(run.states.values()), record.rows)
        near = WIDE_MARGIN * np.ptp(np.where(np.abs(states) < LARGEST_STATE, states, 0.0), axis=0)
        inside = (states > bounds[:, 0] + near) & (states < bounds[:, 1] - near)
        outside = ~(inside & (np.abs(states) < LARGEST_STATE)).all(axis=1)
        rows = int(np.argmax(outside)) if outside.any() else len(states)
        if rows >= WIDE_ROWS:
            inputs, outputs = ({n: y[:rows] for n, y in group.items()} for group in (record.inputs, record.outputs))
            record = Experiment(record.name, record.time[:rows], inputs, outputs)
            parts.append(_compute_sensitivity(model, [record], begin[None], at_rest, 1))
    whole = [part for part in parts if part is not None and part.doubtful <= INTEGRATION_DOUBT]
    if not whole:
        return None
    # First states of each record have columns of their own: a block diagonal.
    blocks = {
        name: (
            block_diag(*(part.blocks[name][0] for part in whole)),
            np.vstack([part.blocks[name][1] for part in whole]),
        )
        for name in whole[0].blocks
    }
    return Sensitivity(blocks, INTEGRATION_DOUBT).compress()


def set_parameters(model: Model, p: np.ndarray) -> Model:
    """``model`` with these values of all its parameters (np,)."""
    return model.start(**{name: float(v) for name, v in zip(model.values, p, strict=True)})


# Samples in the fastest time constant of such a run.
RUN_SAMPLES_PER_TIME_CONSTANT = 3.0
# Slowest time constants in such a run.
RUN_SLOW_TIME_CONSTANTS = 5.0
# Longest step of such a run in fastest time constants: a leak that takes a year is left to its beginning.
LONGEST_STEP = 20.0


def choose_sampling_times(model: Model) -> list[float]:
    """Sampling times (s) that show the fastest motion, and the slowest where one record cannot show both."""
    fastest, slowest = fastest_and_slowest_rate(model)
    if not fastest:
        return [0.01]
    short = 1 / (RUN_SAMPLES_PER_TIME_CONSTANT * fastest)
    # Two records, one for each end, in the place of one that is as long as the slow end and as fine as the fast one.
    long = min(RUN_SLOW_TIME_CONSTANTS / (slowest * RUN_ROWS), LONGEST_STEP / fastest)
    return [short] if long < 2 * short else [short, long]


def _make_record(model: Model, step: float, amplitude: float, generator: np.random.Generator) -> Experiment:
    rows = RUN_ROWS
    time = step * np.arange(rows)
    low = generator.choice(lowest_input_levels(model))
    inputs = {i.name: amplitude * draw_levels(generator, rows, low) for i in model.inputs}
    return Experiment("random", time, inputs, {o.name: np.zeros(rows) for o in model.outputs})


# Singular values up to this are doubtful where a state touches its bound.
BOUND_DOUBT = 0.001
# Directions times substeps that CasADi's virtual machine runs in less time than it takes to compile them.
INTERPRETED_OPERATIONS = 100


def _compute_sensitivity(
    model: Model, experiments: list[Experiment], starts: np.ndarray, at_rest: bool, finer: int
) -> Sensitivity | None:
    """Slopes of the outputs over the records with ``finer`` times the usual substeps; None where a run overflows."""
    records = tuple(to_record(model, e) for e in experiments)
    nx, ny = starts.shape[1], len(model.outputs)
    scale = np.where(starts[0] != 0, np.abs(starts[0]), 1.0)
    free = np.full(nx, not at_rest)
    p = np.array(list(model.values.values()))
    jacobians, touched = [], False
    for e, record in enumerate(records):
        variables = DecisionVector.of(model, InitialStates(starts[e : e + 1], free, scale))
        step = discretise(model.system, p, starts[e : e + 1], record.lengths)
        if finer > 1:
            step = discretise(model.system, p, starts[e : e + 1], record.lengths, substeps=finer * step.substeps)
        is_short = step.adaptive is None and variables.size * step.substeps <= INTERPRETED_OPERATIONS
        kernel = InterpretedKernel(step) if is_short else make_kernel(step)
        shooting = SingleShooting(variables, step, kernel, (record,), np.ones(ny))
        ((residual, jacobian),) = shooting.residuals(variables.here)
        if not np.isfinite(jacobian).all():
            return None
        jacobians.append((np.std(residual, axis=0), jacobian))
        touched |= touches_bounds(model, shooting.simulate(variables.here)[0][1])
    n = len(variables.which)
    blocks = {}
    for j, output in enumerate(model.outputs):
        size = max(float(movement[j]) for movement, _ in jacobians) or 1.0
        # Over the movement of the output: outputs of any unit weigh alike.
        parts = [jacobian[:, j, :] / size for _, jacobian in jacobians]
        # First states of each record have columns of their own: a block diagonal.
        states = block_diag(*(part[:, n:] for part in parts))
        blocks[output.name] = states, np.vstack([part[:, :n] for part in parts])
    return Sensitivity(blocks, BOUND_DOUBT if touched else INTEGRATION_DOUBT).compress()
