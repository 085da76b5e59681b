"""Kalman filters of models, with a tank whose level is pushed, an independent discretisation, and a check of slopes."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.data.experiment import Experiment
from greybox.simulation.filtering.kalman_filter import KalmanFilter
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.records import to_record
from tests.oracles.independent import linear_matrices, values

NOISE = {"x": 2e-7, "i": 5e-3}


def discrete(model, h):
    """Transition, gains of the input at both ends, constant, and noise covariance of one interval, by Gauss's quadrature."""
    a, b, _, _, constant, _ = linear_matrices(model)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    share, weights = (nodes + 1) / 2, weights / 2 * h
    decay = expm(a * (h * (1 - share))[:, None, None])
    early = np.einsum("s,sij,jk->ik", weights * (1 - share), decay, b)
    late = np.einsum("s,sij,jk->ik", weights * share, decay, b)
    steady = np.einsum("s,sij,j->i", weights, decay, constant)
    noise = np.einsum("s,sij,jk,slk->il", weights, decay, intensity(model), decay)
    return expm(a * h), early, late, steady, noise


def intensity(model):
    """Diagonal matrix of squared process noise intensities."""
    return np.diag(ca.Function("d", [model.system.p], [model.system.diffusion])(values(model)).full().ravel() ** 2)


def filter_of(model, data, method="automatic", substeps=0):
    rows = to_record(model, data)
    p = values(model)
    step = discretise(
        model.system, p, np.zeros((1, model.system.x.numel())), rows.lengths, method=method, substeps=substeps
    )
    return KalmanFilter.of(model.system, step), rows, np.append(p, [NOISE.get(o.name, 1.0) for o in model.outputs])


def check_slopes(kalman, rows, pn, x0, relative=1e-5):
    """The exact slope of the likelihood, along everything, against central differences of two widths (Richardson)."""
    nx = len(x0)
    moving = np.flatnonzero(pn)
    directions = len(moving) + nx
    dpn, dx0 = np.zeros((len(pn), directions)), np.zeros((nx, directions))
    dpn[moving, np.arange(len(moving))] = pn[moving]
    dx0[:, len(moving) :] = np.diag(np.where(x0 != 0, np.abs(x0), 1.0))
    found = kalman.slopes(rows, pn, dpn, x0, dx0)
    exact = -0.5 * (2 * found.e @ found.de + found.dlog_variance.sum(axis=0))

    def difference(k, width):
        ends = [kalman.run(rows, pn + w * dpn[:, k], x0 + w * dx0[:, k]).log_likelihood for w in (width, -width)]
        return (ends[0] - ends[1]) / (2 * width)

    for k in range(directions):
        numerical = (4 * difference(k, 1e-4) - difference(k, 2e-4)) / 3
        size = np.sqrt(np.sum(found.de[:, k] ** 2)) + 1e-3 * abs(exact[k])
        assert exact[k] == pytest.approx(numerical, abs=relative * max(size, 1e-3 * np.abs(exact).max()))


def tank():
    """A tank that drains through a hole, with an unsteady inflow."""
    return Model(
        "tank",
        [State("h", "m", 0.4, bounds=(0.0, 1.0), noise="gust")],
        [Input("q", "m/s")],
        [Output("h", "m"), Output("out", "m/s", lambda x, u, p: p.c * ca.sqrt(x.h))],
        [Parameter("c", "m^0.5/s", 0.05, (1e-3, 1.0)), Parameter("gust", "m/s^0.5", 0.003, (0.0, 1.0))],
        lambda x, u, p: [Balance("volume", "m/s", 1, "h", inflow=u.q, outflow=-p.c * ca.sqrt(x.h))],
    )


def tank_record(rows=60, seed=2):
    rng = np.random.default_rng(seed)
    model, period = tank(), 5.0
    x, h = 0.4, []
    q = 0.03 + 0.01 * np.sign(np.sin(0.05 * np.arange(rows)))
    for k in range(rows):
        h.append(x)
        for _ in range(500):
            x += (q[k] - 0.05 * np.sqrt(x)) * period / 500 + 0.003 * np.sqrt(period / 500) * rng.normal()
    h = np.array(h)
    outputs = {"h": h + 0.005 * rng.normal(size=rows), "out": 0.05 * np.sqrt(h) + 1e-3 * rng.normal(size=rows)}
    outputs["out"][20:30] = np.nan
    return model, Experiment("tank", np.arange(rows) * period, {"q": q}, outputs)
