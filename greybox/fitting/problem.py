"""A fit before it starts: records, weights, first guesses, one discrete step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.errors import DataError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.integrators import Step, discretise
from greybox.kernel import Kernel, Record, make_kernel
from greybox.model import Model
from greybox.noise import record_noise
from greybox.transcription import InitialStates, SingleShooting, Variables, record_of

# Where the noise is not given and the record shows none (a simulation), misfits are judged against this share of the signal.
LEAST_NOISE = 1e-6


@dataclass(frozen=True)
class Noise:
    """Standard deviation of each output (ny,) in the model's units, and where it comes from, in words."""

    std: np.ndarray
    source: str
    given: bool


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
        """The cost over the first ``share`` of every record."""
        return SingleShooting(variables, self.step, self.kernel, self.records, 1 / self.noise.std, share)

    def with_step(self, substeps: int, p: np.ndarray) -> Problem:
        """The same with another number of substeps."""
        step = _discretise(self.model, self.records, p, None, self.method, substeps)
        return Problem(
            self.model, self.experiments, self.records, self.noise, self.variables, step, make_kernel(step), self.method
        )  # fmt: skip


def prepare(
    model: Model, experiments: Experiment | Sequence[Experiment], noise: Mapping[str, float] | None, *, at_rest: bool, method: str, substeps: int
) -> Problem:
    """Check model and data against each other and lay out the problem.

    Raises DataError or ModelError with what is wrong and what to do.
    """
    group = (experiments,) if isinstance(experiments, Experiment) else tuple(experiments)
    if not group:
        raise DataError("no experiment to fit; give at least one")
    records = tuple(record_of(model, e) for e in group)
    deviation = noise_of(model, records, noise or {})
    initial = initial_states(model, records, at_rest)
    p = np.array(list(model.values.values()))
    step = _discretise(model, records, p, initial.guess, method, substeps)
    return Problem(model, group, records, deviation, Variables.of(model, initial), step, make_kernel(step), method)


def noise_of(model: Model, records: Sequence[Record], given: Mapping[str, float]) -> Noise:
    """Noise of each output: as given, else estimated from the records' high-order differences."""
    names = [o.name for o in model.outputs]
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"noise of {name!r}: the model has no such output; {nearest(name, names)}")
        if not (np.isfinite(value) and value > 0):
            raise ModelError(f"noise of {name!r}: {value} is not a positive standard deviation; give it in {model.outputs[names.index(name)].unit}")
    std = np.ones(len(names))
    estimated = []
    for j, name in enumerate(names):
        columns = [r.y[:, j] for r in records]
        values = np.concatenate(columns)
        if not np.isfinite(values).any():
            continue
        if name in given:
            std[j] = given[name]
            continue
        estimated.append(name)
        spread = float(np.nanstd(values)) or float(np.nanmax(np.abs(values))) or 1.0
        found = record_noise(columns)
        std[j] = max(found if np.isfinite(found) else 0.0, LEAST_NOISE * spread)
    if not estimated:
        return Noise(std, "given", True)
    rest = f" for {', '.join(estimated)}" if given else ""
    return Noise(std, f"estimated from the records' differences{rest} (too small if the noise is coloured)", False)


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


def _discretise(model: Model, records: Sequence[Record], p: np.ndarray, x: np.ndarray | None, method: str, substeps: int) -> Step:
    lengths = np.unique(np.concatenate([r.lengths for r in records]))
    states = np.zeros((0, len(model.system.state_names))) if x is None else x
    return discretise(model.system, p, states, lengths, method=method, substeps=substeps)
