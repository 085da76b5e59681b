"""A problem laid out for a search: model and records checked against each other, and a first guess of how each record begins."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.base import TIME_ROUNDING, TINY, Finding, ModelError, nearest
from greybox.data.experiment import Experiment, refuse_long_time_gaps
from greybox.data.findings import RecordCode
from greybox.data.noise import GrowingNoise, NoiseModel, estimate_noise
from greybox.data.noise.spectrum import estimate_noise_from_differences
from greybox.data.problems import is_constant
from greybox.data.read import as_experiments
from greybox.data.sensor_faults import is_first_off
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.decision_vector import DecisionVector, InitialStates
from greybox.estimation.transcription.problem import EstimationProblem
from greybox.model import Model
from greybox.simulation.free_run import SettledStart, find_inputs_before
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.plant import PlantModel, make_plant_step
from greybox.simulation.plant_kernel import PlantKernel
from greybox.simulation.records import to_experiments, to_record


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
