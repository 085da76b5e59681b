"""A fit before it starts: records, weights, first guesses, one discrete step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.experiment import Experiment
from greybox.integrators import Step, discretise
from greybox.kernel import Kernel, Record, make_kernel
from greybox.model import Model
from greybox.noise import Noise, noise_of
from greybox.transcription import InitialStates, SingleShooting, Variables, record_of
from greybox.transcription.records import experiments_of
from greybox.transcription.whitened import WhitenedShooting


@dataclass(frozen=True)
class Problem:
    """Everything a fit needs, in plain arrays."""

    model: Model
    experiments: tuple[Experiment, ...]
    records: tuple[Record, ...]
    noise: Noise
    variables: Variables
    step: Step
    kernel: Kernel
    method: str

    def shooting(self, variables: Variables, share: float = 1.0) -> SingleShooting:
        """The cost over the first ``share`` of every record; whitened where the noise is known to be coloured."""
        if self.noise.coloured:
            return WhitenedShooting(
                variables, self.step, self.kernel, self.records, 1 / self.noise.std, self.noise.colour, share
            )  # fmt: skip
        return SingleShooting(variables, self.step, self.kernel, self.records, 1 / self.noise.std, share)

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
) -> Problem:
    """Check model and data against each other and lay out the problem; ``quiet`` records tell the noise (`greybox.noise`).

    ``noise`` as `greybox.noise.noise_of` takes it, or a `Noise` that is known from an earlier fit.

    Raises DataError or ModelError with what is wrong and what to do.
    """
    group = experiments_of(experiments)
    for e in group:
        model.check_measured(f"experiment {e.name!r}", e.outputs)
    records = tuple(record_of(model, e) for e in group)
    deviation = noise if isinstance(noise, Noise) else noise_of(model, group, noise or {}, quiet)
    initial = initial_states(model, records, at_rest)
    p = np.array(list(model.values.values()))
    step = _discretise(model, records, p, initial.guess, method, substeps)
    conditions = [e.conditions for e in group] if any(e.conditions for e in group) else ()
    variables = Variables.of(model, initial, conditions)
    return Problem(model, group, records, deviation, variables, step, make_kernel(step), method)


def initial_states(model: Model, records: Sequence[Record], at_rest: bool) -> InitialStates:
    """First guess of each record's initial state: as declared, and as measured where a state is an output."""
    p = np.array(list(model.values.values()))
    declared = np.asarray(model.system.start_function(p)[0]).ravel()
    guess = np.tile(declared, (len(records), 1))
    names = model.system.state_names
    if not at_rest:
        for j in range(len(model.outputs)):
            state = model.system.outputs[j]
            if state.is_symbolic() and state.name() in names:
                for e, record in enumerate(records):
                    first = record.y[:5, j]
                    if np.isfinite(first).any():
                        guess[e, names.index(state.name())] = first[np.isfinite(first)][0]
    scale = np.where(declared != 0, np.abs(declared), 1.0)
    return InitialStates(guess, np.full(len(names), not at_rest), scale)


def _discretise(
    model: Model, records: Sequence[Record], p: np.ndarray, x: np.ndarray | None, method: str, substeps: int
) -> Step:
    lengths = np.unique(np.concatenate([r.lengths for r in records]))
    states = np.zeros((0, len(model.system.state_names))) if x is None else x
    return discretise(model.system, p, states, lengths, method=method, substeps=substeps)
