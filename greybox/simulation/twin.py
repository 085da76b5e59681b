"""A stand-in for a rig: records made by an integrator that shares nothing with the identification."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from greybox.base.errors import ModelError
from greybox.base.numerics import REFERENCE_TOLERANCE
from greybox.data.experiment import Experiment
from greybox.model.model import Model
from greybox.simulation.simulate import add_noise, declared_initial_state


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
    grid = sampling_time * np.arange(rows)
    x = np.column_stack([x0, _integrate(model, sampling_time, u, p, x0)])
    y = system.output_function.map(rows)(x, u, np.tile(p[:, None], rows)).full()
    outputs = add_noise({o.name: y[j] for j, o in enumerate(model.outputs)}, noise or {}, np.random.default_rng(seed))
    return Experiment.from_arrays(grid, {i.name: u[j] for j, i in enumerate(model.inputs)}, outputs, name=name)


def _integrate(model: Model, interval: float, u: np.ndarray, p: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """States (nx, N-1) after each interval; the solver starts anew in each, because the input jumps between them."""
    system, size = model.system, ca.DM(_sizes(x0))
    # In units of its size each state has the same absolute tolerance: d(x / s)/dt = f(s (x / s)) / s.
    rate = ca.substitute(system.explicit, system.x, size * system.x) / size
    equations = {"x": system.x, "p": ca.vertcat(system.u, system.p), "ode": rate}
    options = {"abstol": REFERENCE_TOLERANCE, "reltol": REFERENCE_TOLERANCE, "max_num_steps": 100_000}
    solver = ca.integrator("twin", "cvodes", equations, 0.0, interval, options)
    held = u.shape[1] - 1
    constants = np.vstack([u[:, :held], np.tile(p[:, None], held)])
    run = solver.mapaccum(held)(x0=x0 / size, p=constants)
    return size.full() * run["xf"].full()


def _sizes(x0: np.ndarray) -> np.ndarray:
    """Rough size of each state, so that one absolute tolerance serves micrometres and pascals."""
    return np.where(x0 != 0, np.abs(x0), 1e-3)
