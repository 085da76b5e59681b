"""Slopes of a run with dry friction along its first state, against differences of whole runs: also where a held body has none."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.simulation.integrators.runge_kutta import rk4
from greybox.simulation.kernel.gradual import GradualKernel, GradualPolicy
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record

STEP, ROWS = 0.01, 300


def spring_and_mass() -> Model:
    return Model(
        "spring_and_mass",
        states=[State("x", "m", role="displacement"), State("v", "m/s", role="velocity")],
        inputs=[Input("u", "N", role="drive")],
        outputs=[Output("x", "m"), Output("v", "m/s")],
        parameters=[
            Parameter("m", "kg", 1.0, role="mass"),
            Parameter("K", "N/m", 40.0, (1.0, 1e4)),
            Parameter("B", "N*s/m", 0.1, (0.0, 1e3), role="damping"),
        ],
        balances=lambda x, u, p: [
            Balance("place", "m/s", 1, "x", rate=x.v),
            Balance("force", "N", p.m, "v", drive=u.u, spring=-p.K * x.x, damping=-p.B * x.v),
        ],
    ) + gb.effect("coulomb_friction")


@pytest.fixture(params=["compiled", "interpreted", "machine"])
def build(request, monkeypatch, tmp_path_factory):
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / f"slopes {request.param}"))
    if request.param == "machine":
        never = GradualPolicy(earned_seconds=np.inf, translated_seconds=np.inf, long_pass_seconds=np.inf)
        return lambda step: GradualKernel(step, None, pytest.fail, never)
    monkeypatch.setenv("GREYBOX_KERNEL", request.param)
    return make_kernel


@pytest.mark.parametrize(
    ("x0", "push"),
    [
        ((0.3, 1.0), 0.0),
        ((0.0, 1.0), 0.0),
        ((0.01, 0.0), 0.0),
        ((0.0, 0.0), 0.0),
        ((0.01, 0.0), 8.0),
        ((-0.3, -2.0), -8.0),
    ],
    ids=["swings", "stops", "is held", "rests", "is held, then leaves", "swings, then is driven"],
)
def test_slopes_along_the_first_state_are_those_of_whole_runs(build, x0, push):
    model = spring_and_mass().start(Fc=2.0)
    kernel = build(rk4(model.system, 2, None))
    p, x0 = np.array(list(model.values.values())), np.array(x0)
    u = np.where(np.arange(ROWS) < ROWS // 3, 0.0, push)[:, None]
    record = Record(u, np.zeros((ROWS, 2)), np.full(ROWS - 1, STEP), np.zeros(ROWS - 1, np.int32), np.array([STEP]))
    q, dq = kernel.coefficients(record, p, np.zeros((len(p), 2)))
    _, jacobian = kernel.residuals(record, KernelPoint(q, dq, p, np.zeros((len(p), 2)), x0, np.eye(2)), np.ones(2))
    for k in range(2):
        move = 1e-6 * np.eye(2)[k]
        ahead, behind = (kernel.simulate(record, q, p, x0 + side * move)[0] for side in (1, -1))
        difference = (ahead - behind) / 2e-6
        # r = y_measured - y. Central differences of runs that are smooth to second order: good to the step beside a size of one.
        np.testing.assert_allclose(-jacobian[:, :, k], difference, atol=1e-5 * max(1.0, np.abs(difference).max()))
