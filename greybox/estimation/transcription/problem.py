"""A fit before it starts (records, weights, first guesses, one discrete step), and what a search ends with."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import casadi as ca
import numpy as np

from greybox.base import TIME_ROUNDING, TINY, Finding, ModelError, Severity, nearest
from greybox.data.experiment import Experiment, refuse_long_time_gaps
from greybox.data.findings import RecordCode
from greybox.data.noise import AutoRegression, GrowingNoise, NoiseModel, estimate_noise
from greybox.data.noise.spectrum import estimate_noise_from_differences
from greybox.data.problems import is_constant
from greybox.data.read import as_experiments
from greybox.data.sensor_faults import is_first_off
from greybox.estimation.optim.minimisation import TerminationStatus
from greybox.estimation.options import DEFAULT_POLICY, EstimationPolicy, FitOptions, RobustLoss
from greybox.estimation.transcription.decision_vector import DecisionVector, InitialStates
from greybox.estimation.transcription.shooting_cost import Evaluation, PlantShooting, SingleShooting, WhitenedShooting
from greybox.model import Model
from greybox.simulation.free_run import SettledStart, find_inputs_before
from greybox.simulation.integrators.discretisation import ADAPTIVE, choose_implicit_method, discretise
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import Kernel
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import PlantModel, make_plant_step
from greybox.simulation.plant_kernel import PlantKernel
from greybox.simulation.records import to_experiments, to_record

# Rows of a record that a part of it has at least.
LEAST_PART_ROWS = 50


@dataclass(frozen=True)
class EstimationProblem:
    """Everything a fit needs, in plain arrays.

    ``loss``: None for least squares. ``constant_outputs``: outputs that were left out because they read the same in every row.
    ``policy``: the numbers it was laid out by, and that what is made of it goes by. ``written_out``: its step is one that a filter takes.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    records: tuple[Record, ...]
    noise: NoiseModel
    variables: DecisionVector
    step: Step
    kernel: Kernel
    method: str
    loss: RobustLoss | None = None
    constant_outputs: tuple[str, ...] = ()
    policy: EstimationPolicy = DEFAULT_POLICY
    written_out: bool = False

    def shooting(self, variables: DecisionVector | None = None, share: float = 1.0) -> SingleShooting:
        """The cost of free runs over the first ``share`` of every record, for its own variables or others.

        Whitened where the noise is known to be coloured, with the ``loss``.
        """
        base = variables or self.variables, self.step, self.kernel, self.records, 1 / self.noise.std, share
        if isinstance(self.kernel, PlantKernel):
            return PlantShooting(*base, colour=self.noise.colour, loss=self.loss)
        if self.loss is None and not self.is_whitened:
            return SingleShooting(*base)
        return WhitenedShooting(*base, colour=self.noise.colour, loss=self.loss)

    def over_part(self, share: float) -> EstimationProblem:
        """The same over the first ``share`` of every record, and some rows of it at least."""
        records = []
        for record in self.records:
            samples = max(round(share * len(record.u)), LEAST_PART_ROWS) // record.rows_per_sample
            records.append(record.first(min(samples * record.rows_per_sample, len(record.u))))
        return replace(self, records=tuple(records))

    @property
    def is_whitened(self) -> bool:
        """Whether errors are more than divided by the noise of their output: of noise with a colour, or of another size in each row."""
        return self.noise.coloured or any(r.spread is not None or r.log_std is not None for r in self.records)

    @property
    def is_plain_squares(self) -> bool:
        """Whether the cost is the sum of squared errors over white noise of one size, and of nothing else."""
        return self.loss is None and not self.is_whitened and not self.variables.has_prior.any()

    def with_white_noise(self) -> EstimationProblem:
        """The same with the noise taken to be white."""
        return replace(self, noise=replace(self.noise, colour=tuple(AutoRegression() for _ in self.noise.colour)))

    def with_plain_squares(self) -> EstimationProblem:
        """The same with the noise taken to be white and of one size for each output, and no other loss than squares."""
        records = tuple(replace(record, spread=None, log_std=None) for record in self.records)
        return replace(self.with_white_noise(), records=records, loss=None)

    @property
    def left_out(self) -> dict[str, int]:
        """How many readings that the experiments have the search does not see, by output."""
        left_out = {
            o.name: sum(
                int(np.isfinite(e.outputs[o.name]).sum() - np.isfinite(r.samples(r.y)[:, j]).sum())
                for e, r in zip(self.experiments, self.records, strict=True)
                if o.name in e.outputs
            )
            for j, o in enumerate(self.model.outputs)
            if o.name not in self.constant_outputs
        }
        return {name: count for name, count in left_out.items() if count}

    def with_growing_noise(self, growth: Mapping[str, GrowingNoise], runs: Sequence[np.ndarray]) -> EstimationProblem:
        """The same with noise that grows with the signal as ``growth`` says, of the runs (N, ny) of its records; all of it has values."""
        names, std = self.noise.outputs, self.noise.std.copy()
        spreads = [
            np.ones((len(r.samples(r.y)), len(names))) if r.spread is None else r.spread.copy() for r in self.records
        ]
        log_std = np.full(len(names), np.nan)
        for j, name in enumerate(names):
            if name not in growth:
                continue
            sizes = [growth[name].std(run[:, j]) for run in runs]
            measured = [np.isfinite(r.samples(r.y)[:, j]) for r in self.records]
            together = np.concatenate([s[m] for s, m in zip(sizes, measured, strict=True)])
            std[j] = np.sqrt(np.mean(together**2)) if len(together) else 1.0
            if growth[name].logarithmic:
                log_std[j] = growth[name].share
                continue
            for spread, size in zip(spreads, sizes, strict=True):
                spread[:, j] = size / std[j]
        has_logarithms = bool(np.isfinite(log_std).any())
        records = tuple(
            replace(r, spread=spread, log_std=log_std if has_logarithms else None)
            for r, spread in zip(self.records, spreads, strict=True)
        )
        return replace(self, records=records, noise=replace(self.noise, std=std, growth=dict(growth)))

    @property
    def variance_floor(self) -> np.ndarray | None:
        """What the loss leaves of the variance of known noise, by output (ny,); None for least squares."""
        return None if self.loss is None else self.loss.least()

    @property
    def start_parameters(self) -> np.ndarray:
        """The parameters (np,) at the present point, without any experiment's own."""
        return self.variables.parameters(self.variables.here)

    def with_step(self, substeps: int, p: np.ndarray) -> EstimationProblem:
        """The same with a step made anew: another method, or another number of substeps (0 to choose)."""
        lengths, no_states = (
            np.unique(np.concatenate([r.lengths for r in self.records])),
            np.zeros((0, self.model.system.x.numel())),
        )
        policy = self.policy.discretisation
        step = discretise(
            self.model.system,
            p,
            no_states,
            lengths,
            method=self.method,
            substeps=substeps,
            rows=0 if self.model.noisy_states else sum(len(r.u) for r in self.records),
            directions=self.variables.size,
            written_out=self.written_out,
            policy=policy,
        )
        return replace(self, step=step, kernel=make_kernel(step, self.variables.which))

    def with_substeps(self, substeps: int) -> EstimationProblem:
        """The same step, repeated more often: nothing is compiled. A delayed input is cut differently, so its step is made anew."""
        if self.step.past is not None:
            return self.with_step(substeps, self.variables.fixed)
        step = replace(self.step, substeps=substeps)
        return replace(self, step=step, kernel=self.kernel.with_substeps(substeps))

    def with_steps_of(self, other: EstimationProblem) -> EstimationProblem:
        """The same with the steps of another problem of its model."""
        return replace(self, method=other.method, step=other.step, kernel=other.kernel)

    def with_stable_steps(self) -> EstimationProblem:
        """The same with steps that follow the error in place of implicit ones of one length, where the model is smooth."""
        method = choose_implicit_method(self.model.system, written_out=self.written_out)
        if method != ADAPTIVE or self.step.adaptive:
            return self
        return replace(self, method=method).with_step(0, self.start_parameters)

    def halve_step(self) -> EstimationProblem:
        """The same with half the step."""
        return self.with_substeps(2 * self.step.substeps)


def prepare_problem(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float | str | GrowingNoise] | NoiseModel | None,
    options: FitOptions,
    *,
    quiet: Experiment | Sequence[Experiment] = (),
    initial: Sequence[Mapping[str, float]] = (),
    begun: Collection[str] = (),
    written_out: bool = False,
) -> EstimationProblem:
    """Check model and data against each other and lay out the problem as ``options`` say.

    ``noise`` as `greybox.data.noise.noise_sources.estimate_noise` takes it, or a `NoiseModel` that is known from an earlier fit; ``quiet``
    records tell it (`greybox.data.noise`). ``initial``: the first guess of each record's initial state, see `apply_initial_guess`; that of
    states in ``begun`` is set by whoever asks, and not looked for in the records. An
    output that reads the same in every row, and whose noise is not known, is left out (`EstimationProblem.constant_outputs`).
    ``written_out``: whether a filter will take the step, as that of every model with process noise does.

    Raises DataError or ModelError with what is wrong and what to do.
    """
    policy, written_out = options.policy, written_out or bool(model.noisy_states)
    group = to_experiments(as_experiments(experiments, model))
    for e in group:
        model.check_measured(f"experiment {e.name!r}", e.outputs)
    if options.at_rest and not isinstance(model, PlantModel) and model.system.delays:
        group = tuple(_begin_at_rest(model, e) for e in group)
    arrays = [to_record(model, e) for e in group]  # before the noise: it refuses records that do not go with the model
    if not isinstance(noise, NoiseModel):
        noise = estimate_noise(
            model,
            group,
            noise or {},
            quiet,
            robust=options.to_loss() is not None,  # outliers must not pass for noise
            alike=not options.per_experiment,
            common=options.common_noise,
            policy=policy.noise,
        )
    # Outputs that read the same in every row and have no noise from anywhere count as not measured.
    columns = {o.name: [e.outputs[o.name] for e in group if o.name in e.outputs] for o in model.outputs}
    constant = tuple(
        n for n, signals in columns.items() if signals and n not in noise.sources and all(map(is_constant, signals))
    )
    records = tuple(_spread_noise(r, e, noise) for r, e in zip(arrays, group, strict=True))
    if options.to_loss() is not None:
        records = tuple(map(without_first_outlier, records))
    if constant:
        dead = [o.name in constant for o in model.outputs]
        records = tuple(replace(r, y=np.where(dead, np.nan, r.y)) for r in records)
    beginning = guess_initial_states(model, records, options.at_rest, [e.conditions for e in group])
    if options.settled:
        beginning = settle(model, records, beginning, [e.conditions for e in group])
    if initial:
        beginning = apply_initial_guess(model, beginning, initial)
    p, lengths = np.array(list(model.values.values())), np.unique(np.concatenate([r.lengths for r in records]))
    if isinstance(model, PlantModel):
        named = options.transcription not in ("automatic", "single")
        step = make_plant_step(
            model,
            options.method,
            options.substeps,
            transcription=options.transcription if named else "",
            arc_length=options.arc_length,
        )
    else:
        step = discretise(
            model.system,
            p,
            beginning.guess,
            lengths,
            method=options.method,
            substeps=options.substeps,
            # A Kalman filter takes the matrices apart.
            rows=0 if model.noisy_states else sum(len(r.u) for r in records),
            directions=len(model.free_parameters) + int(beginning.free.sum()),
            written_out=written_out,
            policy=policy.discretisation,
        )
    if not step.per_interval:
        refuse_long_time_gaps(group)
    conditions = [e.conditions for e in group] if any(e.conditions for e in group) else ()
    variables = DecisionVector.of(model, beginning, conditions, options.per_experiment, [e.name for e in group])
    problem = EstimationProblem(
        model,
        group,
        records,
        noise,
        variables,
        step,
        PlantKernel(model) if isinstance(model, PlantModel) else make_kernel(step, variables.which),
        options.method,
        constant_outputs=constant,
        policy=policy,
        written_out=written_out,
    )
    # A filter finds its states by itself, and a run of a plant from outside has its price.
    if isinstance(model, PlantModel) or model.noisy_states:
        return problem
    known = {*begun, *(name for values in initial for name in values)}
    return place_in_play(set_in_motion(problem, known), known)


# Share of the rates under the first input below which those without it count as rest.
REST_SHARE = 1e-6


def _begin_at_rest(model: Model, experiment: Experiment) -> Experiment:
    """``experiment`` with a delayed input that was zero before, where the plant rests at its declared start without it and not under its
    first value: the input began with the record. What is told of it stands, and this is told to whoever runs the record again.
    """
    late = [model.inputs[d.column].name for d in model.system.delays]
    if len(experiment.before_ages) or not all(i.name in experiment.inputs for i in model.inputs):
        return experiment
    p = np.array(list(model.values.values()))
    x = np.asarray(model.system.start_function(p)[0]).ravel()
    rates = [
        float(np.linalg.norm(np.asarray(model.system.rhs_function(x, u, p)).ravel()))
        for u in (
            [0.0 if i.name in none else experiment.inputs[i.name][0] for i in model.inputs] for none in ((), late)
        )
    ]
    is_rest = rates[1] < REST_SHARE * rates[0]
    return replace(experiment, before=dict.fromkeys(late, np.zeros(1))) if is_rest else experiment


# Rows in which no input moves, from which they show whether the plant rests.
STANDING_ROWS = 4
# How far an output moves meanwhile, in its noise, from which that is no rest.
MOVES_STANDING = 6.0
# Share of a record that may be given for the past of the rest; beyond it the first value is taken for what was before, with a warning.
MOST_PAST = 0.1


def begin_with_known_past(
    model: Model, experiments: Sequence[Experiment], options: FitOptions, delay: float = 0.0
) -> tuple[Experiment, ...]:
    """Records, each from the row on whose past it holds itself as far back as an input may act late, unless its first rows show rest.

    Of a plant in motion nobody can say what its inputs were before; an input that acts late brings that into the first rows. What is told
    of it stands (`Experiment.before`), and at rest each input was what it is in the first row.

    Parameters
    ----------
    model
        What will be fitted or judged.
    experiments
        The records.
    options
        Whether they begin at rest.
    delay
        The longest delay that will be added to the model, in s.
    """
    if isinstance(model, PlantModel) or options.at_rest:
        return tuple(experiments)
    reach = max(delay, sum(d.longest for d in model.system.delays))
    return tuple(_begin_with_known_past(model, e, reach) for e in experiments)


def _begin_with_known_past(model: Model, experiment: Experiment, reach: float) -> Experiment:
    inputs = [experiment.inputs[i.name] for i in model.inputs if i.name in experiment.inputs]
    rows = math.ceil(reach / float(np.median(experiment.intervals)) - TIME_ROUNDING)
    if len(experiment.before_ages) or not inputs or not 0 < rows <= MOST_PAST * experiment.rows:
        return experiment
    moved = [np.flatnonzero(u != u[0]) for u in inputs]
    standing = min((int(m[0]) for m in moved if len(m)), default=experiment.rows)
    measured = [experiment.outputs[o.name] for o in model.outputs if o.name in experiment.outputs]
    if standing >= STANDING_ROWS and all(_stands(y, standing) for y in measured):
        return experiment
    note = Finding(RecordCode.ROWS_OF_PAST, values={"rows": rows, "seconds": reach})
    part = experiment.window(rows, experiment.rows)
    return replace(part, name=experiment.name, findings=(*experiment.findings, note))


def _stands(readings: np.ndarray, rows: int) -> bool:
    """Whether the first ``rows`` of ``readings`` (N,) show no more than noise."""
    first = readings[:rows][np.isfinite(readings[:rows])]
    # Of a signal without noise the differences are those of rounding.
    noise = np.nan_to_num(estimate_noise_from_differences(readings)) + TINY
    return len(first) < 2 or float(np.ptp(first)) <= MOVES_STANDING * noise


def _spread_noise(record: Record, experiment: Experiment, noise: NoiseModel) -> Record:
    """``record`` with the noise of each row over that of its output, where the experiment tells it."""
    if not experiment.noise:
        return record
    spread = np.ones((experiment.rows, len(noise.outputs)))
    for j, name in enumerate(noise.outputs):
        if name in experiment.noise:
            spread[:, j] = experiment.noise[name] / noise.std[j]
    return replace(record, spread=spread)


def without_first_outlier(record: Record) -> Record:
    """``record`` without a first reading that lies far off the next ones.

    A robust loss bounds what it costs and not what it does: the initial state of a fast state follows it, and the constants with it.
    """
    y = record.y.copy()
    for column in y.T:
        rows = np.flatnonzero(np.isfinite(column))
        if is_first_off(column[rows]):
            column[rows[0]] = np.nan
    return replace(record, y=y)


def guess_initial_states(
    model: Model, records: Sequence[Record], at_rest: bool, conditions: Sequence[Mapping[str, float]] = ()
) -> InitialStates:
    """First guess of each record's initial state: as declared under its ``conditions``, and as measured where a state is an output."""
    known = model.values
    given = [
        known | {n: v for n, v in per_experiment.items() if n in known}
        for per_experiment in conditions or [{}] * len(records)
    ]
    guess = np.array([model.system.start_function(list(p.values()))[0].full().ravel() for p in given])
    declared = np.abs(guess).max(axis=0)
    names = model.system.state_names
    if not at_rest:
        for j in range(len(model.outputs)):
            state = model.system.outputs[j]
            if state.is_symbolic() and state.name() in names:
                for e, record in enumerate(records):
                    first = record.y[:5, j]
                    if np.isfinite(first).any():
                        # The first reading, where one of the first rows has any: one that is late is of another state.
                        guess[e, names.index(state.name())] = first[np.isfinite(first)][0]
    scale = np.where(declared != 0, declared, 1.0)
    # The effects of a plant that is run from outside begin as declared, as it does itself: each other start would cost a run.
    begins = {s.name for s in (model.states if isinstance(model, PlantModel) else model.all_states)}
    free = [s.free_start or (not at_rest and s.name in begins) for s in model.all_states]
    return InitialStates(guess, np.array(free, bool), scale)


def settle(
    model: Model, records: Sequence[Record], beginning: InitialStates, conditions: Sequence[Mapping[str, float]]
) -> InitialStates:
    """``beginning`` where the model comes to rest before each record, under its ``conditions``. Raises ModelError where it does not."""
    inputs, known = model.system.u.numel(), model.values
    before = np.array([find_inputs_before(record, inputs) for record in records]).reshape(len(records), inputs)
    settled = SettledStart(model.system, before, max(max(r.duration for r in records), TINY))
    guess, nothing = beginning.guess.copy(), np.empty(0, int)
    for e, given in enumerate(conditions):
        p = np.array([given.get(name, value) for name, value in known.items()], float)
        guess[e] = np.where(beginning.free, guess[e], settled.at(p, e, nothing)[0])
    if not np.isfinite(guess).all():
        raise ModelError(
            f"{model.title}: it does not come to rest under its first inputs at the start values; leave settled out, fix what drives it, or"
            " give other start values"
        )
    return replace(beginning, guess=guess, settled=settled)


# First rows over which a first velocity is looked for, at least; as many times more each time, until they show one.
LEAST_MOVING_ROWS = 10
MORE_MOVING_ROWS = 3
# Squares over the residual's variance that a first velocity has to save: chance saves as much in one of a thousand records at rest.
MOTION_GAIN = 10.8


def set_in_motion(problem: EstimationProblem, known: Collection[str] = ()) -> EstimationProblem:
    """``problem`` with a first guess of each velocity with dry friction that no reading tells: that with which the first rows fit best.

    Friction stops a small velocity at once: at a standstill the run has no slope along it, and no search leads away. Without friction it
    has one, along which a Gauss-Newton step over a few rows tells how the record began. States in ``known`` keep their guess.
    """
    system, initial = problem.model.system, problem.variables.initial
    velocities = [j for j in sorted({d.state for d in system.dry}) if system.state_names[j] not in known]
    velocities = [j for j in velocities if initial.free[j]]
    at_rest = (initial.guess[:, velocities] == 0).any(axis=1)
    if not at_rest.any():
        return problem
    smooth = _without_dry_friction(problem)
    rows, most = LEAST_MOVING_ROWS, max(len(record.samples(record.y)) for record in problem.records)
    while at_rest.any() and rows < MORE_MOVING_ROWS * most:
        records = tuple(r.first((min(rows, len(r.samples(r.y))) - 1) * r.rows_per_sample + 1) for r in problem.records)
        variables = replace(problem.variables, initial=initial)
        reached = _find_first_states(replace(smooth, records=records, variables=variables))
        guess = initial.guess.copy()
        guess[:, velocities] = np.where(guess[:, velocities] == 0, reached[:, velocities], guess[:, velocities])
        # Judged with friction, by the rows that told it.
        part, moving = replace(problem, records=records), replace(initial, guess=guess)
        before, after = (_square_errors(part, replace(variables, initial=each)) for each in (initial, moving))
        counts = np.array([np.isfinite(record.y).sum() for record in records])
        moves = at_rest & (before > after + MOTION_GAIN * np.maximum(1.0, after / np.maximum(counts, 1)))
        initial = replace(initial, guess=np.where(moves[:, None], guess, initial.guess))
        at_rest, rows = at_rest & ~moves, MORE_MOVING_ROWS * rows
    return replace(problem, variables=replace(problem.variables, initial=initial))


def _without_dry_friction(problem: EstimationProblem) -> EstimationProblem:
    """``problem`` with the step of the same equations without dry friction."""
    system, variables = problem.model.system, problem.variables
    # -level * direction, with every direction at zero.
    rates = ca.substitute(system.rhs, system.direction, 0 * system.direction)
    smooth = replace(system, rhs=rates, direction=ca.SX.sym("direction", 0), dry=())
    lengths = np.unique(np.concatenate([record.lengths for record in problem.records]))
    policy = problem.policy.discretisation
    step = discretise(smooth, variables.fixed, variables.initial.guess, lengths, method="automatic", policy=policy)
    return replace(problem, step=step, kernel=make_kernel(step, variables.which))


def _find_first_states(problem: EstimationProblem) -> np.ndarray:
    """The first state of each record (experiments, nx) to which one Gauss-Newton step leads, with the constants and the noise held."""
    variables = problem.variables
    states = variables.split(np.arange(variables.size)).initial_states
    low, high = variables.bounds()
    for bound in (low, high):
        bound[np.setdiff1d(np.arange(variables.size), states)] = 0.0
    step = problem.shooting().evaluate(variables.here).bounded_step(low, high)
    initial, first = variables.initial, variables.initial.guess.copy()
    first[:, initial.free] += initial.scale[initial.free] * step[states]
    return first


# States at either side of play: so many values of one between its ends are tried at a time ...
PLACES_IN_PLAY = 9
# ... and as many about the best of them, so often in all: to a hundredth of the play.
PLACING_ROUNDS = 3
# Where a play is taken to, far below and far above, to see its ends.
FAR_AWAY = 1e12


def place_in_play(problem: EstimationProblem, known: Collection[str] = ()) -> EstimationProblem:
    """``problem`` with a first guess of each state that play may hold anywhere between its ends: where the free run fits best.

    Until the play closes, what is behind it tells nothing of what is before it: no gradient leads away from a guess with which it never
    closes. A state that an output shows begins at its reading, and the one before it lies within the play about that; one that is
    set by an input lies within the play about the input. States in ``known`` keep their guess.
    """
    initial = problem.variables.initial
    for state, low, high in _list_plays(problem):
        if problem.model.system.state_names[state] in known or not initial.free[state]:
            continue
        for _ in range(PLACING_ROUNDS if (high > low).any() else 1):
            places = np.linspace(low, high, PLACES_IN_PLAY if (high > low).any() else 1)
            guesses = [initial.guess.copy() for _ in places]
            for guess, place in zip(guesses, places, strict=True):
                guess[:, state] = place
            tried = [replace(problem.variables, initial=replace(initial, guess=guess)) for guess in guesses]
            costs = np.array([_square_errors(problem, variables) for variables in tried])
            # Of equals, with which the play does not close, the one in the middle.
            middle = np.abs(np.arange(len(places)) - len(places) // 2)
            best = np.array([np.lexsort((middle, column))[0] for column in costs.T])
            guess = initial.guess.copy()
            guess[:, state] = places[best, np.arange(len(best))]
            initial = replace(initial, guess=guess)
            step = (high - low) / (PLACES_IN_PLAY - 1)
            low, high = np.maximum(guess[:, state] - step, low), np.minimum(guess[:, state] + step, high)
    return replace(problem, variables=replace(problem.variables, initial=initial))


def _list_plays(problem: EstimationProblem) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Numbers of the states that a play may hold anywhere, with the ends in each record (experiments,)."""
    system, guess = problem.model.system, problem.variables.initial.guess
    p, inputs = list(problem.model.values.values()), [record.u[0] for record in problem.records]
    shown = {system.outputs[j].name() for j in range(system.outputs.numel()) if system.outputs[j].is_symbolic()}
    for update in system.updates:
        state = update.state
        # w+ = min(max(w, s - gap), s + gap): from far below and far above it goes to its ends.
        end = ca.Function("end", [system.x, system.u, system.p], [update.value])
        ends = []
        for far in (-FAR_AWAY, FAR_AWAY):
            begun = guess.copy()
            begun[:, state] = far
            ends.append(np.array([float(end(x, u, p)) for x, u in zip(begun, inputs, strict=True)]))
        low, high = ends
        if system.state_names[state] in shown:
            before = [
                k for k in range(len(system.state_names)) if k != state and ca.depends_on(update.value, system.x[k])
            ]
            if len(before) != 1:
                continue
            # Its reading w is known, and s lies between w - gap and w + gap.
            reading, front = guess[:, state], guess[:, before[0]]
            state, low, high = before[0], reading + front - high, reading + front - low
        low, high = (np.clip(side, *problem.model.all_states[state].bounds) for side in (low, high))
        if (np.abs([low, high]) < FAR_AWAY / 2).all():
            yield state, low, high


def _square_errors(problem: EstimationProblem, variables: DecisionVector) -> np.ndarray:
    """Squared errors over the noise of the free run over each record (experiments,); infinite where it fails."""
    runs, squares = problem.shooting(variables).simulate(variables.here), []
    for record, (y, _) in zip(problem.records, runs, strict=True):
        measured = np.isfinite(record.y)
        with np.errstate(over="ignore", invalid="ignore"):
            squares.append(np.sum(np.square((record.y - y) / problem.noise.std)[measured]))
    return np.nan_to_num(squares, nan=np.inf)


def apply_initial_guess(
    model: Model, beginning: InitialStates, initial: Sequence[Mapping[str, float]]
) -> InitialStates:
    """``beginning`` with the first guesses of ``initial``: one mapping from state to value for each record, in their order.

    States that a mapping leaves out keep their guess. Raises ModelError for states that the model does not have, values that are not
    finite or lie outside the state's bounds, a wrong number of mappings, and states that are not estimated.
    """
    if isinstance(initial, Mapping) or len(initial) != len(beginning.guess):
        given = "a bare mapping" if isinstance(initial, Mapping) else _count(len(initial), "mapping")
        raise ModelError(
            f"initial states: {given} for {_count(len(beginning.guess), 'experiment')}: give a sequence with one mapping from state to"
            " value for each experiment, in their order"
        )
    names, guess, wrong = model.system.state_names, beginning.guess.copy(), []
    bounds = {s.name: (s.bounds, s.unit) for s in model.all_states}
    for e, values in enumerate(initial):
        for name, value in values.items():
            if name not in names:
                raise ModelError(f"initial states: {model.title} has no state {name!r}; {nearest(name, names)}")
            if not beginning.free[names.index(name)]:
                raise ModelError(
                    f"initial states: at_rest=True begins {name!r} at the value that the model declares; leave out one of the two"
                )
            (low, high), unit = bounds[name]
            if not (np.isfinite(value) and low <= value <= high):
                wrong.append(
                    f"{name} = {value:g} {unit}".rstrip() + f" of experiment {e + 1} (bounds [{low:g}, {high:g}])"
                )
            guess[e, names.index(name)] = value
    if wrong:
        raise ModelError(f"initial states: {'; '.join(wrong)}: give finite values within the states' bounds")
    return replace(beginning, guess=guess)


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


# A search that is not IPOPT's, watched: progress to report, and Ctrl-C that ends it after the present iteration.


@dataclass(frozen=True)
class FitProgress:
    """Where a running fit is: stage ``stage`` of ``stages`` (a growing part of the record), iteration, misfit over noise."""

    stage: int
    stages: int
    iteration: int
    noise_ratio: float


FitProgressCallback = Callable[[FitProgress], None]


class ProgressMonitor:
    """Called with the number of each iteration and its cost, over the first ``share`` of the records; whether to ``stop``."""

    def __init__(
        self,
        problem: EstimationProblem,
        report: FitProgressCallback | None,
        share: float = 1.0,
        stage: int = 1,
        stages: int = 1,
    ) -> None:
        self.report, self.stop, self.stage, self.stages = report, False, stage, stages
        parts = (r.y[: round(share * len(r.u))] for r in problem.records)
        self.count = max(sum(int(np.isfinite(y).sum()) for y in parts), 1) if report else 1

    def __call__(self, iteration: int, cost: float) -> bool:
        """Report where the search is; whether to end it."""
        if self.report:
            self.report(FitProgress(self.stage, self.stages, iteration, float(np.sqrt(cost / self.count))))
        return self.stop


# Codes of what a transcription and a solution say about themselves.


class TranscriptionReason(StrEnum):
    """Why a transcription suits a model and its record."""

    STABLE = "transcription_stable"
    """Neither unstable, nor stiff, nor integrating."""

    UNSTABLE = "transcription_unstable"
    """Errors grow along the record. Values: ``rate`` (1/s), ``exponent`` (over the record), ``duration`` (s)."""

    STIFF_IMPLICIT = "transcription_stiff_implicit"
    """A fast mode, which implicit steps follow. Values: ``fastest`` (s), ``substeps`` (explicit ones in a sample)."""

    FREE_RUN_FOLLOWS = "transcription_free_run_follows"
    """A fast mode, and errors that grow; yet a free run gains what its slopes promise. Values: those of both."""

    STIFF_NOT_SMOOTH = "transcription_stiff_not_smooth"
    """A fast mode, too many states for implicit steps, and equations that collocation cannot take. Values as before."""

    STIFF_LONG = "transcription_stiff_long"
    """A fast mode, too many states for implicit steps, and a record too long for collocation. Values as before, and ``samples``."""

    STIFF_COLLOCATION = "transcription_stiff_collocation"
    """A fast mode and too many states for implicit steps: collocation takes it. Values as before."""

    INTEGRATING_SHORT = "transcription_integrating_short"
    """An integrator whose drift stays near the data. Values: ``duration`` (s), ``time_constants`` (of the slowest other mode, or None)."""

    INTEGRATING_GROWING = "transcription_integrating_growing"
    """An integrator; a growing part of the record keeps the run near the data. Values as before."""


class SolutionCode(StrEnum):
    """What a solution says about itself."""

    SEARCH_STRATEGY = "search_strategy"
    """How it was searched for: the transcription, what it was made of, and why it was chosen."""


# Two arrays for each record: outputs and states, or residuals and their Jacobian.
Runs = Sequence[tuple[np.ndarray, np.ndarray]]


class Completion(StrEnum):
    """How a fit went on where its way of solving led to no optimum, or minimises less than was asked for."""

    NONE = ""
    FREE_RUN = "free_run"
    """By a free run from the optimum of the segments."""

    WHITE_NOISE = "white_noise"
    """With the noise taken as white, as a free run does not follow this plant."""

    WENT_ON = "went_on"
    """By single shooting from the best point: the search failed, or its start was better than its end."""


def make_strategy(transcription: str, **values: object) -> Finding:
    """How a fit searched; ``values`` depend on the transcription, see `greybox.show.sentences.estimation`."""
    return Finding(SolutionCode.SEARCH_STRATEGY, Severity.NOTE, transcription, values)


@dataclass(frozen=True)
class SegmentedRun:
    """A run that is more than one simulation from an initial state: segments, joined or not, or collocated points.

    For each record ``runs`` are outputs (N, ny) and states (N, nx); ``rows`` the weighted residuals (N, ny) and their Jacobian
    (N, ny, L) along `DecisionVector.columns`, every state at its best for the constants (the columns of the initial states are zero);
    ``unknowns`` how many numbers were estimated, states included; ``shift`` (nf,) the change of the constants in ``z`` with half
    the step.
    """

    runs: Runs
    rows: Runs
    unknowns: int
    shift: np.ndarray


# A free run from the initial states is that of the segments if it differs by at most this share of the noise anywhere.
FREE_RUN_NOISE_SHARE = 0.1


@dataclass(frozen=True)
class Solution:
    """The optimum: ``variables`` with ``z = 0`` there, the evaluation, how it ended, and the work it took.

    ``shares`` of the record that were fitted one after the other; ``integration_error`` of each output over its noise (ny,);
    ``transcription`` what was used, ``strategy`` what was chosen, and why. ``joined`` is None where the model ran freely from each
    initial state. ``discretisation`` is empty where it is the step of the problem. ``solver``: which solvers ran over whole records.
    """

    problem: EstimationProblem
    variables: DecisionVector
    evaluation: Evaluation
    status: TerminationStatus
    solver_status: str
    iterations: int
    evaluations: int
    seconds: float
    shares: tuple[float, ...]
    integration_error: np.ndarray
    strategy: Finding = field(default_factory=lambda: make_strategy("single"))
    transcription: str = "single"
    joined: SegmentedRun | None = None
    discretisation: str = ""
    solver: str = ""

    @property
    def at_optimum(self) -> EstimationProblem:
        """The problem with its present point at the optimum."""
        return replace(self.problem, variables=self.variables)

    @property
    def unknowns(self) -> int:
        """How many numbers were estimated."""
        return self.joined.unknowns if self.joined else self.variables.size

    @property
    def is_single(self) -> bool:
        """Whether each record was run freely from its initial state."""
        return self.transcription == "single"

    @property
    def is_run(self) -> bool:
        """Whether the cost is that of a run: of segments that end where the next one begins, if it is more than one."""
        return True

    def with_work_of(self, earlier: Solution) -> Solution:
        """The same with the work of the search that it began from."""
        return replace(
            self,
            iterations=self.iterations + earlier.iterations,
            evaluations=self.evaluations + earlier.evaluations,
            seconds=self.seconds + earlier.seconds,
            solver=self.solver or earlier.solver,
        )

    def with_strategy(self, **values: object) -> Solution:
        """The same with more to say of how it was searched."""
        return replace(self, strategy=replace(self.strategy, values={**self.strategy.values, **values}))

    def is_free_run(self) -> bool:
        """Whether one simulation from each initial state gives the run, to a share of the noise."""
        if not self.joined:
            return True
        free = self.problem.shooting(self.variables).simulate(self.variables.here)
        pairs = zip(free, self.joined.runs, strict=True)
        # Wherever it differs by more than a share of the noise, a free run would be another statement.
        away = np.concatenate([(a - b) / self.problem.noise.std for (a, _), (b, _) in pairs])
        return bool(np.all(np.abs(away) < FREE_RUN_NOISE_SHARE))

    def simulate(self) -> Runs:
        """For each record outputs (N, ny) and states (N, nx) of the model at the optimum."""
        if self.joined:
            return self.joined.runs
        return tuple(self.problem.shooting(self.variables).simulate(self.variables.here))

    def linearise(self) -> tuple[Runs, Runs]:
        """`simulate`, of the states the first row at least, and `residuals`."""
        if self.joined:
            return self.joined.runs, self.residuals()
        return self.problem.shooting(self.variables).linearise(self.variables.here)

    def residuals(self) -> Runs:
        """For each record the weighted residuals (N, ny) of its samples and their Jacobian (N, ny, L) at the optimum."""
        if self.joined:
            pairs = zip(self.problem.records, self.joined.rows, strict=True)
            return tuple((_samples(record, r), _samples(record, jacobian)) for record, (r, jacobian) in pairs)
        return tuple(self.problem.shooting(self.variables).residuals(self.variables.here))


def _samples(record: Record, values: np.ndarray) -> np.ndarray:
    """The samples among values that are there for every row of ``record``."""
    return record.samples(values) if len(values) == len(record.u) else values
