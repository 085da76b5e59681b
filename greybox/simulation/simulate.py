"""`simulate`: a model and its inputs in, outputs and states out; and a twin of a rig, by another integrator."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import casadi as ca
import numpy as np

from greybox.base import TINY, ModelError, nearest, write_file
from greybox.base.frames import make_frame
from greybox.base.numerics import REFERENCE_TOLERANCE, ROWS_AT_A_TIME
from greybox.data.columns import ColumnMapping
from greybox.data.data_frame import Frame, is_frame, open_frame
from greybox.data.experiment import Experiment
from greybox.data.input_course import Hold, Holds
from greybox.data.policy import READING_POLICY, ReadingPolicy
from greybox.data.problems import find_array_problems, raise_problems
from greybox.data.read import WHOLE, Window, read_arrays
from greybox.model import Model
from greybox.simulation.free_run import (
    SIMULATION_POLICY,
    SettledStart,
    SimulationPolicy,
    find_inputs_before,
    run_freely,
)
from greybox.simulation.integrators.step import Step
from greybox.simulation.plant import Plant, PlantModel, as_model, make_plant_step
from greybox.simulation.plant_kernel import PlantKernel
from greybox.simulation.records import to_record

# The inputs of a file alone, for simulating where nothing was measured.


def read_inputs(
    path: str | os.PathLike[str] | Frame,
    model: Model,
    *,
    columns: ColumnMapping | Sequence[str] | None = None,
    sampling_time: float | None = None,
    hold: Holds = "auto",
    interpolation: Mapping[str, Hold] | None = None,
    before: Mapping[str, float] | None = None,
    window: Window = WHOLE,
    reading: ReadingPolicy = READING_POLICY,
) -> Experiment:
    """Read time and the inputs of a model from a file, to simulate where nothing was measured. Other columns are not read.

    Parameters
    ----------
    path
        The file, of a kind that `greybox.read_csv` reads; or a data frame, or arrays by name.
    model
        Its inputs are looked for, and their units are those of the record.
    columns, sampling_time, interpolation, before, window, reading
        As of `greybox.read_csv`.
    hold
        How the inputs move between samples, see `greybox.Experiment`.

    Returns
    -------
    Experiment
        A record without outputs.

    Raises
    ------
    DataError
        For a file that is missing, cannot be read, or lacks an input.
    """
    opened: Any = open_frame(path, reading) if is_frame(path) else path
    record = read_arrays(
        opened,
        model,
        columns=columns,
        sampling_time=sampling_time,
        inputs_only=True,
        hold=hold,
        interpolation=interpolation,
        reading=reading,
        before=before or {},
    ).cut(window)
    file, labels = record.file.path, record.labels
    if len(record.time) > 1:
        raise_problems(file.name, find_array_problems(record.time, record.inputs, {}, labels))
    else:
        raise_problems(file.name, [f"{len(record.time)} rows; a record needs at least 2"])
    past: dict[str, Any] = {"before": record.before, "before_ages": record.before_ages}
    return Experiment(file.stem, record.time, record.inputs, {}, record.courses, source=file.name, **past)


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

    def to_frame(self) -> Any:
        """A pandas data frame with the time in seconds as its index: inputs, outputs, and the states that no output is called like.

        Raises ModuleNotFoundError without pandas (``pip install 'greybox-sysid[frames]'``).
        """
        hidden = {name: values for name, values in self.states.items() if name not in self.outputs}
        return make_frame("time", self.time, {**self.inputs, **self.outputs, **hidden})

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
    model: Model | Plant,
    inputs: Experiment | Frame,
    *,
    initial: Mapping[str, float] | None = None,
    settled: bool = False,
    method: str = "automatic",
    substeps: int = 0,
    policy: SimulationPolicy = SIMULATION_POLICY,
) -> Simulation:
    """Run a model freely over given inputs, at its present values.

    Parameters
    ----------
    model
        The model, or a plant (`greybox.simulation.plant.Plant`).
    inputs
        An `Experiment` or a data frame, of which outputs are ignored, or ``{"time": ..., "u": ...}`` with arrays (N,), held between
        samples; headers and units of a table are read as those of a file.
    initial
        Values of states at the first row, by name; the others are as declared.
    settled
        Begin where the model comes to rest from there under the inputs before the first row, or under its first inputs.
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
    model = as_model(model)
    if isinstance(inputs, Experiment):
        experiment = inputs.with_outputs({})
    else:
        # Arrays by name are held, as they are documented; the inputs of a table move as those of a file that is fitted.
        experiment = read_inputs(inputs, model, hold="zero" if isinstance(inputs, Mapping) else "auto")
    record = to_record(model, experiment)
    p, x0 = np.array(list(model.values.values())), declared_initial_state(model, initial)
    if isinstance(model, PlantModel):
        step = make_plant_step(model, method, substeps)
        y, x = PlantKernel(model).simulate(record, np.empty((1, 0)), p, x0)
        return _to_simulation(model, experiment, y, x, step)
    if settled:
        before = find_inputs_before(record, model.system.u.numel())[None]
        rest, _ = SettledStart(model.system, before, max(record.duration, TINY)).at(p, 0, np.empty(0, int))
        given = [s.name in (initial or {}) for s in model.all_states]
        x0 = np.where(given, x0, rest)
        if not np.isfinite(x0).all():
            raise ModelError(f"{model.title}: it does not come to rest under its first inputs; leave settled out")
    y, x, step = run_freely(model, record, p, x0, method=method, substeps=substeps, policy=policy)
    if record.before is None and model.system.delays:
        # What the run took for its delayed inputs before the first row is told to whoever fits it, at rest or not.
        late = [model.inputs[d.column].name for d in model.system.delays]
        experiment = replace(experiment, before={name: experiment.inputs[name][0] for name in late})
    return _to_simulation(model, experiment, y, x, step)


def _to_simulation(model: Model, experiment: Experiment, y: np.ndarray, x: np.ndarray, step: Step) -> Simulation:
    """Outputs (N, ny) and states (N, nx) by name."""
    return Simulation(
        experiment.time,
        {i.name: experiment.inputs[i.name] for i in model.inputs},
        {o.name: y[:, j] for j, o in enumerate(model.outputs)},
        {name: x[:, j] for j, name in enumerate(model.system.state_names)},
        step.label,
        experiment,
    )


def declared_initial_state(model: Model, given: Mapping[str, float] | None = None) -> np.ndarray:
    """The declared initial state of a model at its present values.

    Parameters
    ----------
    model
        The model.
    given
        State -> value in its unit, in the place of what is declared.

    Returns
    -------
    array (nx,)
        In the order of the states, in their units.

    Raises
    ------
    ModelError
        For a state that the model does not have.

    Examples
    --------
    >>> declared_initial_state(micro_actuator, {"x": 1e-5})  # doctest: +SKIP
    """
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


# A stand-in for a rig: records made by an integrator that shares nothing with the identification.


def simulate_twin(
    model: Model,
    inputs: Mapping[str, np.ndarray],
    sampling_time: float,
    noise: Mapping[str, float] | None = None,
    seed: int = 0,
    *,
    name: str = "twin",
) -> Experiment:
    """A record of ``model``, simulated by CVODES (variable step and order, implicit), which no fit uses.

    Parameters
    ----------
    model
        The plant, at its present values; the run begins at the initial state that it declares.
    inputs
        An array (N,) for each input, by name, held over each sampling interval.
    sampling_time
        Seconds between samples.
    noise
        Standard deviation of the white noise on each output, in its unit; no noise if left out.
    seed
        Seed of the noise.
    name
        Name of the record.

    Returns
    -------
    Experiment
        N samples of all inputs and outputs, in the model's units.

    Raises
    ------
    ModelError
        For a missing input, and for a model with dry friction, whose jumps CVODES cannot follow (`simulate` can).

    Examples
    --------
    >>> import numpy as np
    >>> from greybox.shell.project import find_model
    >>> record = simulate_twin(find_model("micro_actuator"), {"u": np.ones(20)}, 2.5e-4, {"x": 2e-7}, seed=1)
    >>> record.rows
    20
    """
    missing = [i.name for i in model.inputs if i.name not in inputs]
    if missing:
        raise ModelError(
            f"twin of {model.title}: no input {missing[0]!r}; give an array for each of the model's inputs"
        )
    system = model.system
    if system.dry:
        raise ModelError(
            f"twin of {model.title}: CVODES cannot follow dry friction that sticks; use simulate,"
            f" or leave {system.dry[0].effect} out"
        )
    u = np.array([np.asarray(inputs[i.name], float) for i in model.inputs])
    rows = u.shape[1]
    p, x0 = np.array(list(model.values.values())), declared_initial_state(model)
    # In units of its size each state has the same absolute tolerance, be it micrometres or pascals: d(x / s)/dt = f(s (x / s)) / s.
    size = ca.DM(np.where(x0 != 0, np.abs(x0), 1e-3))
    rate = ca.substitute(system.explicit, system.x, size * system.x) / size
    equations = {"x": system.x, "p": ca.vertcat(system.u, system.p), "ode": rate}
    tolerances = {"abstol": REFERENCE_TOLERANCE, "reltol": REFERENCE_TOLERANCE, "max_num_steps": 100_000}
    solver = ca.integrator("twin", "cvodes", equations, 0.0, sampling_time, tolerances)
    # The solver starts anew in each interval, because the input jumps between them.
    constants = np.vstack([u[:, :-1], np.tile(p[:, None], rows - 1)])
    x = np.column_stack([x0, size.full() * solver.mapaccum(rows - 1)(x0=x0 / size, p=constants)["xf"].full()])
    grid = sampling_time * np.arange(rows)
    y = system.output_function.map(rows)(x, u, np.tile(p[:, None], rows)).full()
    outputs = add_noise({o.name: y[j] for j, o in enumerate(model.outputs)}, noise or {}, np.random.default_rng(seed))
    return Experiment.from_arrays(grid, {i.name: u[j] for j, i in enumerate(model.inputs)}, outputs, name=name)


# Records as CSV files that `read_csv` reads back without loss.


def write_csv(experiment: Experiment, model: Model, path: str | os.PathLike[str]) -> Path:
    """Write a record as a CSV file that `greybox.read_csv` reads back without loss.

    Parameters
    ----------
    experiment
        The record; gaps become empty fields. What a delayed input was before its first row stands in a comment above the headers.
    model
        Its units go into the headers, ``name [unit]``; signals that it does not have are left out.
    path
        The file; folders are made.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If it cannot be written; an older file is then left as it was.

    Examples
    --------
    >>> write_csv(simulate(model, inputs).record({"x": 2e-7}, rng), model, "run.csv")  # doctest: +SKIP
    """
    inputs = [(s.name, s.unit, experiment.inputs[s.name]) for s in model.inputs if s.name in experiment.inputs]
    outputs = [(s.name, s.unit, experiment.outputs[s.name]) for s in model.outputs if s.name in experiment.outputs]
    signals = [("time", "s", experiment.time), *inputs, *outputs]
    heads = [f"{name} [{unit}]" if unit else name for name, unit, _ in signals]
    past = [
        f"# before {s.name} = {float(experiment.before[s.name][0])!r} {s.unit}\n"
        for s in model.inputs
        # Without a word it is what the input is in the first row.
        if model.system.delays and s.name in experiment.before and len(experiment.before_ages) == 1
        if experiment.before[s.name][0] != experiment.inputs[s.name][0]
    ]

    def write_rows(file: BinaryIO) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        text.writelines(past)
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(heads)
        # `repr` has every digit that a double needs to be read back the same.
        for first in range(0, experiment.rows, ROWS_AT_A_TIME):  # a number of Python takes four times the memory
            columns = [values[first : first + ROWS_AT_A_TIME].tolist() for _, _, values in signals]
            writer.writerows(["" if math.isnan(v) else repr(v) for v in row] for row in zip(*columns, strict=True))
        text.flush()
        text.detach()

    return write_file(path, write_rows)
