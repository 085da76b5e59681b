"""Records made without the library's integrators: scipy's discretisation and solvers only."""

import casadi as ca
import numpy as np
from scipy.integrate import ode
from scipy.signal import cont2discrete

from greybox.data.experiment import Experiment


def values(model):
    """Parameter values in the order of the system."""
    return np.array(list(model.values.values()))


def linear_matrices(model):
    """A, B, C, D and the constant of a linear model at its present values."""
    s = model.system
    xu = ca.vertcat(s.x, s.u)
    at_zero = [ca.substitute(e, xu, 0) for e in (s.rhs, s.outputs)]
    f = ca.Function(
        "m",
        [s.p],
        [
            ca.jacobian(s.rhs, s.x),
            ca.jacobian(s.rhs, s.u),
            ca.jacobian(s.outputs, s.x),
            ca.jacobian(s.outputs, s.u),
            *at_zero,
        ],
    )
    a, b, c, d, a0, c0 = (m.full() for m in f(values(model)))
    return a, b, c, d, a0.ravel(), c0.ravel()


def linear_record(model, u, period, x0=None, noise=None, seed=0, name="twin"):
    """Held input over a linear model, discretised by scipy."""
    a, b, c, d, a0, c0 = linear_matrices(model)
    nx = len(a)
    phi, gamma, *_ = cont2discrete(
        (a, np.column_stack([b, a0]), np.eye(nx), np.zeros((nx, b.shape[1] + 1))), period, "zoh"
    )
    x = np.zeros(nx) if x0 is None else np.array(x0, float)
    u = np.asarray(u, float).reshape(len(u), -1)
    driven, states = u @ gamma[:, :-1].T + gamma[:, -1], np.empty((len(u), nx))
    for k, push in enumerate(driven):
        states[k] = x
        x = phi @ x + push
    y = states @ c.T + u @ d.T + c0
    return experiment(model, np.arange(len(u)) * period, u, y, noise, seed, name)


def quick(inputs, output):
    """``output`` of the symbols ``inputs`` as a function of arrays, without the detours of an ordinary call into CasADi."""
    function = ca.Function("f", inputs, [ca.densify(output)])
    buffer, evaluate = function.buffer()
    held, result = [np.zeros(symbol.numel()) for symbol in inputs], np.zeros(output.numel())
    for k, array in enumerate(held):
        if array.size:
            buffer.set_arg(k, memoryview(array))
    buffer.set_res(0, memoryview(result))

    def called(*arrays):
        for array, given in zip(held, arrays, strict=True):
            array[:] = given
        evaluate()
        return result.copy() if output.is_column() else result.reshape(output.shape, order="F").copy()

    called.memory = function, buffer  # CasADi keeps neither alive
    return called


def rates_of(model):
    """``(x, u, p) -> dx/dt`` of arrays."""
    s = model.system
    return quick([s.x, s.u, s.p], s.explicit)


def solved_record(model, u, time, x0, noise=None, seed=0, name="twin", hold="zero"):
    """Any smooth model, solved interval by interval to 1e-11."""
    s, p = model.system, values(model)
    f, g = rates_of(model), quick([s.x, s.u, s.p], s.outputs)
    u = np.asarray(u, float).reshape(len(u), -1)
    x, y = np.array(x0, float), []
    for k, row in enumerate(u):
        y.append(g(x, row, p))
        if k + 1 < len(u):
            h = time[k + 1] - time[k]
            slope = (u[k + 1] - row) / h if hold == "first" else 0 * row
            solver = ode(lambda t, x, row=row, slope=slope: f(x, row + slope * t, p))
            x = solver.set_integrator("dop853", rtol=1e-11, atol=1e-13, nsteps=10000).set_initial_value(x).integrate(h)
    return experiment(model, time, u, np.array(y), noise, seed, name, hold)


def experiment(model, time, u, y, noise=None, seed=0, name="twin", hold="zero"):
    """Arrays as an Experiment, with white noise of the given standard deviations."""
    rng = np.random.default_rng(seed)
    y = np.array(y, float)
    for j, o in enumerate(model.outputs):
        y[:, j] += (noise or {}).get(o.name, 0.0) * rng.normal(size=len(y))
    inputs = {i.name: u[:, j] for j, i in enumerate(model.inputs)}
    outputs = {o.name: y[:, j] for j, o in enumerate(model.outputs)}
    return Experiment(name, np.asarray(time, float), inputs, outputs, hold=hold)


def multisine(rng, rows, period, low, high, amplitude, lines=40):
    """Random-phase multisine between two frequencies (Hz), peak about ``amplitude``."""
    t = np.arange(rows) * period
    f = np.exp(rng.uniform(np.log(low), np.log(high), lines))
    signal = np.cos(2 * np.pi * f[:, None] * t + rng.uniform(0, 2 * np.pi, (lines, 1))).sum(axis=0)
    return amplitude * signal / np.abs(signal).max()
