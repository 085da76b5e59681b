"""A step is run before it is handed over: one that overflows where shorter ones go on is refused, another says its deviation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.base.errors import ModelError
from greybox.estimation.linear.exported_model import to_plant
from greybox.extensions.export.discrete_step import make_discrete_step
from tests.estimation.test_prediction_steps import QUENCH, VALVE

pytestmark = pytest.mark.rest


@pytest.mark.crossed(3)
@pytest.mark.parametrize("model", [VALVE, QUENCH, VALVE.start(k=0.3)])
def test_a_step_that_runs_away_is_refused(model, tmp_path):
    with pytest.raises(ModelError, match=r"overflows after 0\.[12] s, where shorter steps go on"):
        gb.export.to_casadi(model.free("fast"), 0.1, substeps=1)
    step = make_discrete_step(to_plant(model), 0.1)
    assert step.step.implicit and 0 < step.deviation < 0.05
    x = step.x0
    for _ in range(300):
        x = step.advance(x, np.empty(0), np.ones(1))
    # At rest in a constant input nothing moves.
    assert np.abs(model.system.rhs_function(x, 1.0, step.p).full()).max() < 0.01


@pytest.mark.parametrize("dt", [0.01, 0.1])
def test_a_model_that_nobody_fitted_is_stepped_as_finely_as_one_that_was(dt):
    """A hardening spring against LSODA: ten steps for the time of its fastest mode at rest were off by a hundredth."""
    spring = gb.Model(
        "spring",
        [gb.State("x", "m"), gb.State("v", "m/s")],
        [gb.Input("f", "N")],
        [gb.Output("x", "m")],
        [
            gb.Parameter("m", "kg", 1.0),
            gb.Parameter("c", "N*s/m", 5.0),
            gb.Parameter("k", "N/m", 4e4),
            gb.Parameter("k3", "N/m^3", 1e9),
        ],
        lambda x, u, p: [
            gb.Balance("place", "m/s", 1, "x", rate=x.v),
            gb.Balance("force", "N", p.m, "v", drive=u.f, drag=-p.c * x.v, spring=-p.k * x.x - p.k3 * x.x**3),
        ],
    )
    step, exact, x = make_discrete_step(to_plant(spring), dt), np.zeros(2), np.zeros(2)
    for k in range(60):
        u = 40.0 if (k // 5) % 2 else -40.0
        x = step.advance(x, np.empty(0), np.array([u]))
        run = solve_ivp(
            lambda t, z, u=u: [z[1], u - 5 * z[1] - 4e4 * z[0] - 1e9 * z[0] ** 3],
            (0, dt),
            exact,
            method="LSODA",
            rtol=1e-10,
            atol=1e-13,
        )
        exact = run.y[:, -1]
        assert x[0] == pytest.approx(exact[0], abs=1e-8)  # of about 1e-3
