"""A fit before it starts: records, weights, first guesses, one discrete step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.experiment import Experiment
from greybox.experiment.holes import refuse_long_holes
from greybox.integrators import Step, discretise
from greybox.kernel import Kernel, Record, make_kernel
from greybox.model import Model
from greybox.noise import Noise, noise_of
from greybox.noise.differences import still
from greybox.transcription import InitialStates, SingleShooting, Variables, record_of
from greybox.transcription.loss import Loss
from greybox.transcription.records import experiments_of
from greybox.transcription.robust import RobustShooting
from greybox.transcription.whitened import WhitenedShooting


@dataclass(frozen=True)
class Problem:
    """Everything a fit needs, in plain arrays.

    ``loss``: None for least squares. ``still``: outputs that were left out because they read the same in every row.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    records: tuple[Record, ...]
    noise: Noise
    variables: Variables
    step: Step
    kernel: Kernel
    method: str
    loss: Loss | None = None
    still: tuple[str, ...] = ()

    def shooting(self, variables: Variables, share: float = 1.0) -> SingleShooting:
        """The cost over the first ``share`` of every record; whitened where the noise is known to be coloured, with the ``loss``."""
        if self.loss is not None:
            return RobustShooting(
                variables, self.step, self.kernel, self.records, 1 / self.noise.std, self.noise.colour, self.loss, share
            )  # fmt: skip
        if self.noise.coloured:
            return WhitenedShooting(
                variables, self.step, self.kernel, self.records, 1 / self.noise.std, self.noise.colour, share
            )  # fmt: skip
        return SingleShooting(variables, self.step, self.kernel, self.records, 1 / self.noise.std, share)

    @property
    def least(self) -> np.ndarray | None:
        """What the loss leaves of the variance of known noise, by output (ny,); None for least squares."""
        return None if self.loss is None else self.loss.least()

    def with_noise(self, noise: Noise) -> Problem:
        """The same with other weights."""
        return replace(self, noise=noise)

    def with_step(self, substeps: int, p: np.ndarray) -> Problem:
        """The same with another number of substeps."""
        step = _discretise(self.model, self.records, p, None, self.method, substeps)
        return replace(self, step=step, kernel=make_kernel(step))


def prepare(
    model: Model,
    experiments: Experiment | Sequence[Experiment],
    noise: Mapping[str, float] | Noise | None,
    *,
    at_rest: bool,
    method: str,
    substeps: int,
    quiet: Experiment | Sequence[Experiment] = (),
    own: Sequence[str] = (),
    robust: bool = False,
) -> Problem:
    """Check model and data against each other and lay out the problem; ``quiet`` records tell the noise (`greybox.noise`).

    ``noise`` as `greybox.noise.noise_of` takes it, or a `Noise` that is known from an earlier fit. ``own``: constants of which each
    experiment has a value of its own. ``robust``: outliers must not pass for noise. An output that reads the same in every row, and
    whose noise nothing tells, is left out (`Problem.still`).

    Raises DataError or ModelError with what is wrong and what to do.
    """
    group = experiments_of(experiments)
    for e in group:
        model.check_measured(f"experiment {e.name!r}", e.outputs)
    deviation = (
        noise if isinstance(noise, Noise) else noise_of(model, group, noise or {}, quiet, robust=robust, alike=not own)
    )
    resting = _resting(model, group, deviation)
    records = tuple(_without(record_of(model, e), [o.name in resting for o in model.outputs]) for e in group)
    initial = initial_states(model, records, at_rest, [e.conditions for e in group])
    p = np.array(list(model.values.values()))
    step = _discretise(model, records, p, initial.guess, method, substeps)
    if not step.per_interval:
        refuse_long_holes(group)
    conditions = [e.conditions for e in group] if any(e.conditions for e in group) else ()
    variables = Variables.of(model, initial, conditions, own, [e.name for e in group])
    return Problem(model, group, records, deviation, variables, step, make_kernel(step), method, still=resting)


def _resting(model: Model, experiments: Sequence[Experiment], noise: Noise) -> tuple[str, ...]:
    """Outputs that read the same in every row and have no noise from anywhere."""
    columns = {o.name: [e.outputs[o.name] for e in experiments if o.name in e.outputs] for o in model.outputs}
    return tuple(n for n, found in columns.items() if found and n not in noise.sources and all(map(still, found)))


def _without(record: Record, outputs: Sequence[bool]) -> Record:
    """``record`` as if some of its outputs had not been measured."""
    return replace(record, y=np.where(outputs, np.nan, record.y)) if any(outputs) else record


def initial_states(
    model: Model, records: Sequence[Record], at_rest: bool, conditions: Sequence[Mapping[str, float]] = ()
) -> InitialStates:
    """First guess of each record's initial state: as declared under its ``conditions``, and as measured where a state is an output."""
    known = model.values
    given = [known | {n: v for n, v in own.items() if n in known} for own in conditions or [{}] * len(records)]
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
    return InitialStates(guess, np.full(len(names), not at_rest), scale)


def _discretise(
    model: Model, records: Sequence[Record], p: np.ndarray, x: np.ndarray | None, method: str, substeps: int
) -> Step:
    lengths = np.unique(np.concatenate([r.lengths for r in records]))
    states = np.zeros((0, len(model.system.state_names))) if x is None else x
    return discretise(model.system, p, states, lengths, method=method, substeps=substeps)
