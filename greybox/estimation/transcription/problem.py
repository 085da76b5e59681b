"""A fit before it starts: records, weights, first guesses, one discrete step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.base.errors import ModelError, nearest
from greybox.base.numerics import OVERFLOWING_CURVATURE
from greybox.data.experiment import Experiment, refuse_long_time_gaps
from greybox.data.noise.noise_model import AutoRegression, NoiseModel
from greybox.data.noise.noise_sources import estimate_noise
from greybox.data.problems import is_constant
from greybox.estimation.transcription.decision_vector import DecisionVector, InitialStates
from greybox.estimation.transcription.policy import DEFAULT_SOLVER_POLICY, SolverPolicy
from greybox.estimation.transcription.simulation_error import (
    RobustLoss,
    RobustShooting,
    SingleShooting,
    WhitenedShooting,
)
from greybox.model.model import Model
from greybox.simulation.integrators.discretisation import DiscretisationPolicy, discretise
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.interface import Kernel
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record
from greybox.simulation.records import to_experiments, to_record


@dataclass(frozen=True)
class EstimationProblem:
    """Everything a fit needs, in plain arrays.

    ``loss``: None for least squares. ``constant_outputs``: outputs that were left out because they read the same in every row.
    ``policy``: the numbers it was laid out by, and that what is made of it goes by.
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
    policy: SolverPolicy = DEFAULT_SOLVER_POLICY

    def predict_cost(self, variables: DecisionVector) -> float:
        """The cost that one step of the quadratic model promises from ``variables``; infinite where the model cannot be simulated there."""
        e = self.shooting(variables).evaluate(variables.here)
        if not (np.isfinite(e.cost) and e.is_finite and np.abs(e.hessian).max(initial=0.0) < OVERFLOWING_CURVATURE):
            return math.inf
        return float(e.cost - e.predicted_decrease(*variables.bounds()))

    def shooting(self, variables: DecisionVector | None = None, share: float = 1.0) -> SingleShooting:
        """The cost of free runs over the first ``share`` of every record, for its own variables or others.

        Whitened where the noise is known to be coloured, with the ``loss``.
        """
        base = variables or self.variables, self.step, self.kernel, self.records, 1 / self.noise.std, share
        if self.loss is not None:
            return RobustShooting(*base, colour=self.noise.colour, loss=self.loss)
        return WhitenedShooting(*base, colour=self.noise.colour) if self.is_whitened else SingleShooting(*base)

    @property
    def is_whitened(self) -> bool:
        """Whether errors are more than divided by the noise of their output: of noise with a colour, or of another size in each row."""
        return self.noise.coloured or any(record.spread is not None for record in self.records)

    @property
    def is_plain_squares(self) -> bool:
        """Whether the cost is the sum of squared errors over white noise of one size, and of nothing else."""
        return self.loss is None and not self.is_whitened and not self.variables.has_prior.any()

    def with_white_noise(self) -> EstimationProblem:
        """The same with the noise taken to be white."""
        return replace(self, noise=replace(self.noise, colour=tuple(AutoRegression() for _ in self.noise.colour)))

    def with_plain_squares(self) -> EstimationProblem:
        """The same with the noise taken to be white, and no other loss than squares."""
        return replace(self.with_white_noise(), loss=None)

    @property
    def variance_floor(self) -> np.ndarray | None:
        """What the loss leaves of the variance of known noise, by output (ny,); None for least squares."""
        return None if self.loss is None else self.loss.least()

    @property
    def start_parameters(self) -> np.ndarray:
        """The parameters (np,) at the present point, without any experiment's own."""
        return self.variables.parameters(self.variables.here)

    def with_noise(self, noise: NoiseModel) -> EstimationProblem:
        """The same with other weights."""
        return replace(self, noise=noise)

    def with_step(self, substeps: int, p: np.ndarray) -> EstimationProblem:
        """The same with a step made anew: another method, or another number of substeps (0 to choose)."""
        step = _discretise(self.model, self.records, p, None, self.method, substeps, self.policy.discretisation)
        return replace(self, step=step, kernel=make_kernel(step, self.variables.which))

    def with_substeps(self, substeps: int) -> EstimationProblem:
        """The same step, repeated more often: nothing is compiled. A delayed input is cut differently, so its step is made anew."""
        if self.step.past is not None:
            return self.with_step(substeps, self.variables.fixed)
        step = replace(self.step, substeps=substeps)
        return replace(self, step=step, kernel=self.kernel.with_substeps(substeps))

    def halve_step(self) -> EstimationProblem:
        """The same with half the step."""
        return self.with_substeps(2 * self.step.substeps)


def prepare_problem(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | NoiseModel | None,
    *,
    at_rest: bool,
    method: str,
    substeps: int,
    quiet: Experiment | Sequence[Experiment] = (),
    per_experiment: Sequence[str] = (),
    robust: bool = False,
    common_noise: bool = False,
    initial: Sequence[Mapping[str, float]] = (),
    policy: SolverPolicy = DEFAULT_SOLVER_POLICY,
) -> EstimationProblem:
    """Check model and data against each other and lay out the problem; ``quiet`` records tell the noise (`greybox.data.noise`).

    ``noise`` as `greybox.data.noise.noise_sources.estimate_noise` takes it, or a `NoiseModel` that is known from an earlier fit.
    ``per_experiment``: parameters of which each experiment has a value of its own. ``robust``: outliers must not pass for noise.
    ``common_noise``: outputs whose noise nothing tells have one level in common.
    ``initial``: the first guess of each record's initial state, see `apply_initial_guess`. An output that reads the same in every row, and
    whose noise is not known, is left out (`EstimationProblem.constant_outputs`). ``policy``: how noise is estimated and a step chosen.

    Raises DataError or ModelError with what is wrong and what to do.
    """
    group = to_experiments(experiments)
    for e in group:
        model.check_measured(f"experiment {e.name!r}", e.outputs)
    deviation = (
        noise
        if isinstance(noise, NoiseModel)
        else estimate_noise(
            model,
            group,
            noise or {},
            quiet,
            robust=robust,
            alike=not per_experiment,
            common=common_noise,
            policy=policy.noise,
        )
    )
    constant = _find_constant_outputs(model, group, deviation)
    is_constant_output = [o.name in constant for o in model.outputs]
    records = tuple(_drop_outputs(_spread_noise(to_record(model, e), e, deviation), is_constant_output) for e in group)
    beginning = guess_initial_states(model, records, at_rest, [e.conditions for e in group])
    if initial:
        beginning = apply_initial_guess(model, beginning, initial)
    p = np.array(list(model.values.values()))
    step = _discretise(model, records, p, beginning.guess, method, substeps, policy.discretisation)
    if not step.per_interval:
        refuse_long_time_gaps(group)
    conditions = [e.conditions for e in group] if any(e.conditions for e in group) else ()
    variables = DecisionVector.of(model, beginning, conditions, per_experiment, [e.name for e in group])
    return EstimationProblem(
        model,
        group,
        records,
        deviation,
        variables,
        step,
        make_kernel(step, variables.which),
        method,
        constant_outputs=constant,
        policy=policy,
    )


def _find_constant_outputs(model: Model, experiments: Sequence[Experiment], noise: NoiseModel) -> tuple[str, ...]:
    """Outputs that read the same in every row and have no noise from anywhere."""
    columns = {o.name: [e.outputs[o.name] for e in experiments if o.name in e.outputs] for o in model.outputs}
    return tuple(
        n for n, signals in columns.items() if signals and n not in noise.sources and all(map(is_constant, signals))
    )


def _spread_noise(record: Record, experiment: Experiment, noise: NoiseModel) -> Record:
    """``record`` with the noise of each row over that of its output, where the experiment tells it."""
    if not experiment.noise:
        return record
    spread = np.ones((experiment.rows, len(noise.outputs)))
    for j, name in enumerate(noise.outputs):
        if name in experiment.noise:
            spread[:, j] = experiment.noise[name] / noise.std[j]
    return replace(record, spread=spread)


def _drop_outputs(record: Record, outputs: Sequence[bool]) -> Record:
    """``record`` as if some of its outputs had not been measured."""
    return replace(record, y=np.where(outputs, np.nan, record.y)) if any(outputs) else record


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
                        guess[e, names.index(state.name())] = first[np.isfinite(first)][0]
    scale = np.where(declared != 0, declared, 1.0)
    return InitialStates(guess, np.array([not at_rest or s.free_start for s in model.all_states], bool), scale)


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


def _discretise(
    model: Model,
    records: Sequence[Record],
    p: np.ndarray,
    x: np.ndarray | None,
    method: str,
    substeps: int,
    policy: DiscretisationPolicy,
) -> Step:
    lengths = np.unique(np.concatenate([r.lengths for r in records]))
    states = np.zeros((0, len(model.system.state_names))) if x is None else x
    return discretise(model.system, p, states, lengths, method=method, substeps=substeps, policy=policy)
