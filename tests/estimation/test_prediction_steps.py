"""A prediction takes the steps that a fit takes: stiff models against SciPy's Radau, where nothing corrects and where a filter does."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State

pytestmark = pytest.mark.rest

T = np.linspace(0, 8, 81)
FAST = [Parameter("fast", "s", 2e-5, (1e-9, 1), fixed=True)]
DRIVE = np.repeat(np.random.default_rng(4).uniform(0, 2, 9), 9)

VALVE = Model(
    "valve",
    states=[State("s", "1"), State("y", "1")],
    inputs=[Input("u", "1")],
    outputs=[Output("y", "1")],
    parameters=[*FAST, Parameter("k", "s", 1.5, (0.1, 10))],
    balances=lambda x, u, p: [
        Balance("spool", "1", p.fast, "s", drive=u.u, spring=-x.s - x.s**3),
        Balance("load", "1", p.k, "y", flow=x.s, leak=-(x.y**3)),
    ],
)
QUENCH = Model(
    "quench",
    states=[State("y", "1", 2.0)],
    inputs=[Input("u", "1")],
    outputs=[Output("y", "1")],
    parameters=[*FAST, Parameter("k", "1", 1e-5, (1e-9, 1e-1))],
    balances=lambda x, u, p: [
        Balance("heat", "1", p.fast, "y", drive=p.k * u.u, radiated=-p.k * x.y**4 - (x.y - u.u) ** 3)
    ],
)
PAIR = Model(
    "pair",
    states=[State("a", "1", 1.0), State("y", "1", 1.0)],
    inputs=[Input("u", "1")],
    outputs=[Output("y", "1")],
    parameters=[*FAST, Parameter("k", "s", 2.0, (0.1, 10))],
    balances=lambda x, u, p: [
        Balance("binding", "1", p.fast, "a", bound=x.y * (u.u + 1), free=-x.a - x.a**2),
        Balance("pool", "1", p.k, "y", feed=u.u, used=-x.a),
    ],
)
AT_REST = gb.FitOptions(at_rest=True)


@cache
def solve_held(name):
    """The outputs of a model by SciPy's Radau, from row to row with the input held."""
    model = next(m for m in (VALVE, QUENCH, PAIR) if m.name == name)
    f, p = model.system.rhs_function, np.array(list(model.values.values()))
    x = [model.system.constant_start]
    for u, a, b in zip(DRIVE, T, T[1:], strict=False):
        run = solve_ivp(lambda t, x, u=u: f(x, u, p).full().ravel(), (a, b), x[-1], "Radau", rtol=1e-9, atol=1e-11)
        x.append(run.y[:, -1])
    return np.array(x)[:, -1]


@pytest.mark.parametrize(
    "model", [*(pytest.param(m, marks=pytest.mark.slow) for m in (VALVE, QUENCH)), PAIR], ids=lambda m: m.name
)
def test_a_prediction_of_a_stiff_model_is_its_free_run(model):
    exact = solve_held(model.name)
    noisy = exact + np.random.default_rng(1).normal(0, 0.01, len(T))
    record = gb.Experiment("run", T, {"u": DRIVE}, {"y": noisy}, "zero")
    alone = gb.predict(model, record, options=AT_REST, noise={"y": 0.01})["y"]
    # An integration error below a tenth of the noise is what a fit is content with.
    assert np.abs(alone - exact).max() < 1e-3
    fit = gb.fit(model, record, noise={"y": 0.01}, options=AT_REST)
    free = fit.traces[0].simulated["y"]
    assert np.allclose(gb.predict(fit, record)["y"], free, rtol=1e-6)


@pytest.mark.parametrize(
    ("model", "state"),
    [*(pytest.param(*m, marks=pytest.mark.slow) for m in ((VALVE, "s"), (QUENCH, "y"))), (PAIR, "y")],
)
def test_a_filter_takes_steps_that_can_be_written_out(model, state):
    exact = solve_held(model.name)
    record = gb.Experiment("run", T, {"u": DRIVE}, {"y": exact}, "zero")
    filtered = gb.predict(model.with_process_noise(**{state: 1e-6}), record, options=AT_REST, noise={"y": 0.01})["y"]
    assert np.abs(filtered - exact).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("model", [VALVE, QUENCH], ids=lambda m: m.name)
def test_the_filter_of_a_stiff_cubic_finds_no_noise_where_there_is_none(model):
    noisy = solve_held(model.name) + np.random.default_rng(1).normal(0, 0.01, len(T))
    fit = gb.fit(
        model.with_process_noise("y"),
        gb.Experiment("run", T, {"u": DRIVE}, {"y": noisy}),
        noise={"y": 0.01},
        options=AT_REST,
    )
    found, true = fit.parameters["k"], model.values["k"]
    assert fit.success and abs(found.value - true) < 3 * found.std
    assert fit.prediction.one_step["y"].noise_ratio == pytest.approx(1, abs=0.25)
    assert fit.parameters["noise_y"].value == 0
