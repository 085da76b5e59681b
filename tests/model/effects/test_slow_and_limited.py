"""A limit of the rate, friction that warms and an offset of a sensor, against SciPy and by hand."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State

CART = Model(
    "cart",
    states=[State("v", "m/s")],
    inputs=[Input("F", "N")],
    outputs=[Output("v", "m/s")],
    parameters=[Parameter("m", "kg", 2.0), Parameter("b", "N*s/m", 0.5)],
    balances=lambda x, u, p: [Balance("force", "N", p.m, "v", drive=u.F, damping=-p.b * x.v)],
)
TIME = np.arange(400) * 0.01


def run(model, force):
    """Speed of the cart."""
    return gb.simulate(model, {"time": TIME, "F": force}).outputs["v"]


def integrate(force_at, rates, start):
    """The same by SciPy, to 1e-10."""
    return solve_ivp(
        lambda t, x: rates(t, x, force_at(t)), (0, TIME[-1]), start, t_eval=TIME, rtol=1e-10, atol=1e-12, max_step=0.005
    ).y


def test_a_limited_rate_follows_a_step_by_a_ramp():
    limited = (CART + gb.effect("rate_limit")).start(ts=0.25)
    force = np.where(TIME < 0.5, 0.0, 6.0)
    # After the step of 6 N it takes 1.5 s at 4 N/s.
    expected = integrate(
        lambda t: min(max(4.0 * (t - 0.5), 0.0), 6.0), lambda t, x, f: [(f - 0.5 * x[0]) / 2.0], [0.0]
    )[0]
    np.testing.assert_allclose(run(limited, force), expected, atol=2e-6)


def test_a_rate_that_is_never_reached_changes_nothing():
    force = 3 * np.sin(2 * TIME)
    np.testing.assert_allclose(run(CART + gb.effect("rate_limit"), force), run(CART, force), atol=1e-9)


def test_friction_falls_as_it_warms():
    warm = (CART + gb.effect("warming_friction")).start(Fc=1.5, cw=0.8, tau_w=1.2)
    force = np.full(len(TIME), 5.0)

    def rates(t, x, f):
        v, z = x
        return [(f - 0.5 * v - 1.5 / (1 + z)) / 2.0, (0.8 * 1.5 * abs(v) - z) / 1.2]

    np.testing.assert_allclose(run(warm, force), integrate(lambda t: 5.0, rates, [0.0, 0.0])[0], atol=2e-6)


def test_warm_friction_without_warmth_is_coulomb_friction():
    cold = (CART + gb.effect("warming_friction")).start(Fc=1.5)
    coulomb = (CART + gb.effect("coulomb_friction")).start(Fc=1.5)
    force = 4 * np.sin(3 * TIME)
    np.testing.assert_allclose(run(cold, force), run(coulomb, force), atol=1e-12)


def test_an_offset_is_added_to_the_reading_alone():
    moved = (CART + gb.effect("sensor_offset")).start(y0=-0.25)
    force = np.sin(TIME)
    np.testing.assert_allclose(run(moved, force), run(CART, force) - 0.25, atol=1e-12)


@pytest.mark.parametrize("name", ["rate_limit", "warming_friction", "sensor_offset"])
def test_each_appears_with_a_slope_where_it_is_visible(name):
    """A search begins where the effect is small and seen: there its amplitude must move the run."""
    effect = gb.effect(name)
    starts = {"rate_limit": {"ts": 0.2}, "warming_friction": {"Fc": 0.5, "cw": 0.1}, "sensor_offset": {"y0": 0.01}}[
        name
    ]
    model = (CART + effect).start(**starts)
    force = 3 * np.sin(4 * TIME)
    for key, value in starts.items():
        more = run(model.start(**{key: 1.01 * value}), force)
        assert np.abs(more - run(model, force)).max() > 1e-6
