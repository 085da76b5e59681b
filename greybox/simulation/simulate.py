"""`simulate`: a model and its inputs in, outputs and states out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from greybox.errors import DataError, ModelError, nearest
from greybox.experiment import Experiment
from greybox.experiment.experiment import UNNAMED
from greybox.integrators import DiscretisationPolicy, Step, choose_substeps, discretise
from greybox.kernel import Record, make_kernel
from greybox.model import Model
from greybox.transcription import to_record
from greybox.transcription.policy import BandLimitedPolicy


@dataclass(frozen=True)
class SimulationPolicy:
    """How fine a model is integrated."""

    max_change: float = 1e-6
    """The step is halved until that changes no output by more than this share of its movement (rms)."""
    max_halvings: int = 6
    """Most halvings; a run that still changes is returned as it is."""
    discretisation: DiscretisationPolicy = field(default_factory=DiscretisationPolicy)
    """How the first step is chosen; that of `EstimationPolicy` simulates as a fit does."""
    band_limited: BandLimitedPolicy = field(default_factory=BandLimitedPolicy)
    """How a band-limited input is filled in between samples."""


SIMULATION_POLICY = SimulationPolicy()


@dataclass(frozen=True, eq=False)
class Simulation:
    """A free run of a model. Values are not finite from where a run overflows.

    Parameters
    ----------
    time : array (N,)
        Time in seconds.
    inputs, outputs, states
        By name, each an array (N,) in the model's unit.
    discretisation
        How it was integrated.
    source
        The inputs as an experiment.
    """

    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    states: Mapping[str, np.ndarray]
    discretisation: str
    source: Experiment

    @property
    def overflow(self) -> float | None:
        """Time in seconds from which an output or a state is not finite; None for a run that went through."""
        everything = np.column_stack([*self.outputs.values(), *self.states.values()])
        bad = np.flatnonzero(~np.isfinite(everything).all(axis=1))
        return float(self.time[bad[0]]) if len(bad) else None

    def record(
        self, noise: Mapping[str, float] | None = None, generator: np.random.Generator | None = None
    ) -> Experiment:
        """The run as a record, with white noise on the outputs.

        Parameters
        ----------
        noise
            Standard deviations by output; others stay without noise.
        generator
            Draws the noise; needed where there is any.

        Raises
        ------
        ModelError
            For noise on an unknown output, or without a generator.
        DataError
            For a run that overflowed.
        """
        outputs = add_noise(self.outputs, noise or {}, generator)
        return self.source.with_outputs(outputs)


def simulate(
    model: Model,
    inputs: Experiment | Mapping[str, ArrayLike],
    *,
    initial: Mapping[str, float] | None = None,
    method: str = "automatic",
    substeps: int = 0,
    policy: SimulationPolicy = SIMULATION_POLICY,
) -> Simulation:
    """Run a model freely over given inputs, at its present values.

    Parameters
    ----------
    model
        The model.
    inputs
        An `Experiment`, of which outputs are ignored, or ``{"time": ..., "u": ...}`` with arrays (N,), held between samples.
    initial
        Values of states at the first row, by name; the others are as declared.
    method, substeps
        As in `greybox.FitOptions`; 0 substeps halves the step until nothing visible changes.
    policy
        What counts as visible.

    Returns
    -------
    Simulation
        Outputs and states. A run that overflows is returned, too: see `Simulation.overflow`.

    Raises
    ------
    DataError
        For a missing input.
    ModelError
        For an unknown state.

    Examples
    --------
    >>> time = 2.5e-4 * np.arange(2000)  # doctest: +SKIP
    >>> run = simulate(micro_actuator, {"time": time, "u": np.ones(2000)})  # doctest: +SKIP
    >>> run.outputs["x"][-1]  # doctest: +SKIP
    """
    experiment = inputs.with_outputs({}) if isinstance(inputs, Experiment) else _experiment(model, inputs)
    record, rules = to_record(model, experiment, policy.band_limited), policy.discretisation
    p, x0 = np.array(list(model.values.values())), declared_initial_state(model, initial)
    step = discretise(model.system, p, x0[None, :], record.lengths, method=method, substeps=substeps, policy=rules)
    y, x = _run(step, record, p, x0)
    for _ in range(0 if substeps or step.per_interval else policy.max_halvings):
        visited = x[np.isfinite(x).all(axis=1)][:: max(1, len(x) // 10)]
        longest = float(record.lengths.max(initial=0.0))
        needed = choose_substeps(model.system, p, visited, longest, policy=rules)
        more = max(2 * step.substeps, needed)
        finer = discretise(model.system, p, visited, record.lengths, method=method, substeps=more, policy=rules)
        before = y
        step, (y, x) = finer, _run(finer, record, p, x0)
        if _has_settled(before, y, policy.max_change):
            break
    return Simulation(
        experiment.time,
        {i.name: experiment.inputs[i.name] for i in model.inputs},
        {o.name: y[:, j] for j, o in enumerate(model.outputs)},
        {name: x[:, j] for j, name in enumerate(model.system.state_names)},
        step.label,
        experiment,
    )


def declared_initial_state(model: Model, given: Mapping[str, float] | None = None) -> np.ndarray:
    """The declared initial state (nx,) of ``model`` at its present values, with the ``given`` states put in."""
    p = np.array(list(model.values.values()))
    x0 = np.asarray(model.system.start_function(p)[0]).ravel().copy()
    names = model.system.state_names
    for name, value in (given or {}).items():
        if name not in names:
            raise ModelError(f"model {model.title!r} has no state {name!r}; {nearest(name, names)}")
        x0[names.index(name)] = value
    return x0


def add_noise(
    outputs: Mapping[str, np.ndarray], noise: Mapping[str, float], generator: np.random.Generator | None
) -> dict[str, np.ndarray]:
    """``outputs`` with white Gaussian noise of the given standard deviations."""
    for name, std in noise.items():
        if name not in outputs:
            raise ModelError(f"noise of {name!r}: the model has no such output; {nearest(name, outputs)}")
        if not (np.isfinite(std) and std >= 0):
            raise ModelError(f"noise of {name!r}: {std} is not a standard deviation; give a number of 0 or more")
    if noise and generator is None:
        raise ModelError("noise needs a generator; give numpy.random.default_rng(seed)")
    noisy = dict(outputs)
    for name in outputs:  # in the order of the outputs, so that the same seed gives the same record
        if generator is not None and name in noise:
            noisy[name] = outputs[name] + noise[name] * generator.standard_normal(len(outputs[name]))
    return noisy


def _experiment(model: Model, arrays: Mapping[str, ArrayLike]) -> Experiment:
    if "time" not in arrays:
        raise DataError(
            f"inputs have no 'time'; give {{'time': ..., {', '.join(repr(i.name) + ': ...' for i in model.inputs)}}}"
        )
    values = {name: np.asarray(v, float) for name, v in arrays.items()}
    return Experiment(UNNAMED, values.pop("time"), values, {})


def _run(step: Step, record: Record, p: np.ndarray, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (N, ny) and states (N, nx)."""
    q, _ = step.coefficients(p, record.lengths, np.empty(0, int))
    record = record.read_by(step)
    y, x = make_kernel(step).simulate(record, q, p, x0)
    return record.samples(y), record.samples(x)


def _has_settled(before: np.ndarray, after: np.ndarray, max_change: float) -> bool:
    """Whether halving the step changed nothing visible: no output (N, ny), and not where the run overflows."""
    rows = np.isfinite(before).all(axis=1)
    if not np.array_equal(rows, np.isfinite(after).all(axis=1)):
        return False
    change, movement = after[rows] - before[rows], after[rows] - after[0]
    return bool(np.all(np.sum(change**2, axis=0) <= max_change**2 * np.sum(movement**2, axis=0)))
