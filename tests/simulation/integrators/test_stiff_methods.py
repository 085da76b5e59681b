"""Stiff and relaxing models: every method against scipy's solvers, its order measured, its slopes by finite differences."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.model.effects.catalogue import effect
from greybox.simulation.integrators.discretisation import choose_substeps, discretise, run_step
from greybox.simulation.integrators.implicit import midpoint, radau
from greybox.simulation.integrators.runge_kutta import find_fast_relaxing_states, mixed, rk4
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.oracles.independent import quick
from tests.support.stepping import (
    KERNELS,
    bouc_wen,
    differences,
    lugre,
    orders,
    oscillator,
    path,
    record,
    slopes,
    stribeck,
    values,
)


def solved(model, u, period, x0, rtol=1e-9, atol=1e-12, slope=None):
    """States at the rows, by scipy's Radau, each held interval on its own; ``slope``: the input is linear instead."""
    s, p, x = model.system, values(model), np.array(x0, float)
    f, j = (quick([s.x, s.u, s.p], e) for e in (s.explicit, ca.jacobian(s.explicit, s.x)))
    found = [x]
    for k in range(len(u) - 1):
        rise = 0.0 if slope is None else (u[k + 1] - u[k]) / period
        x = solve_ivp(
            lambda t, x, k=k, rise=rise: f(x, u[k] + rise * t, p),
            (0, period),
            x,
            method="Radau",
            rtol=rtol,
            atol=atol,
            jac=lambda t, x, k=k: j(x, u[k], p),
        ).y[:, -1]
        found.append(x)
    return np.array(found)


def motion_error(found, exact):
    """Largest error of each state over its range."""
    return np.abs(found - exact).max(axis=0) / np.ptp(exact, axis=0)


def coil(stiffness=1e-4):
    """A nonlinear spring driven through a fast lag: smooth, stiff, three states."""
    return Model(
        "coil",
        [State("x", "m"), State("v", "m/s"), State("i", "A", relaxing=True)],
        [Input("u", "V")],
        [Output("x", "m")],
        [
            Parameter("K3", "1/(m**2*s**2)", 5.0),
            Parameter("T", "s", stiffness, (1e-9, 1.0)),
            Parameter("R", "ohm", 1.0),
            Parameter("k", "m/(A*s**2)", 1.0),
        ],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "m/s**2", 1, "v", coil=p.k * x.i, spring=-p.K3 * x.x**3),
            Balance("voltage", "V", p.R * p.T, "i", supply=u.u, drop=-p.R * x.i),
        ],
    )


@pytest.mark.parametrize(
    ("start", "lowest"), [([-0.3, 1.5, 0.02], 1.9), ([0.3, 0.1, 0.05], 1.7)], ids=["one way", "to and fro"]
)
def test_relaxing_states_converge_with_order_two(start, lowest):
    """Bouc-Wen hysteresis, with and without the kinks of |v| and |z|."""
    model = oscillator() + bouc_wen()
    u, x0 = np.zeros(3), np.array(start)
    exact = solved(model, u, 0.1, x0, 1e-11, 1e-13)
    errors = [
        np.linalg.norm(run_step(rk4(model.system, n), values(model), x0, u[:, None], 0.1)[-1] - exact[-1])
        for n in (2, 4, 8, 16, 32)
    ]
    assert orders(errors).mean() > lowest, orders(errors)
    assert errors[-1] < 5e-5


@pytest.mark.rest
def test_a_fast_lag_is_exact_for_an_input_that_is_linear_between_rows():
    """With T = h / 100 the current is the exact answer to a ramp, and the mechanics keep their accuracy."""
    model = coil(1e-4)
    u = np.sin(np.arange(12.0))
    exact = solved(model, u, 0.01, [0.5, 0.0, 0.0], 1e-10, 1e-12, slope=True)
    _, x = path(rk4(model.system), record(u, 0.01, first_order=True), values(model), [0.5, 0.0, 0.0])
    assert np.abs(x[:, 2] - exact[:, 2]).max() < 1e-9
    assert np.abs(x[:, :2] - exact[:, :2]).max() < 1e-7


@pytest.fixture(scope="module")
def bristles():
    """The cylinder with bristles of 3e5 N/m at 10 ms: 300 intervals by scipy's Radau."""
    model = pneumatic_cylinder + lugre()
    t = np.arange(150) * 0.01
    u = 2 * np.sin(2 * np.pi * 0.7 * t) + np.sin(2 * np.pi * 1.9 * t + 1)
    u[100:] = 0.0  # it comes to rest on its bristles
    x0 = np.asarray(model.system.start_function(values(model))[0]).ravel()
    return u, x0, solved(model, u, 0.01, x0, 1e-8, np.array([1e-11, 1e-9, 1e-5, 1e-5, 1e-13]))


@pytest.mark.rest
def test_lugre_at_its_true_constants_needs_few_substeps(bristles):
    u, x0, exact = bristles
    model = pneumatic_cylinder + lugre()
    p = values(model)
    errors = [motion_error(path(rk4(model.system, n), record(u, 0.01, 3), p, x0)[1], exact) for n in (8, 16, 32, 64)]
    assert np.all(errors[0][:4] < 1e-3), errors[0]
    assert orders([e[:4].max() for e in errors]).mean() > 1.8, errors
    explicit = pneumatic_cylinder + lugre(relaxing=False)
    with np.errstate(all="ignore"):
        overflow = path(rk4(explicit.system, 4), record(u, 0.01, 3), p, x0)[1]
    assert not np.isfinite(overflow).all()
    assert (
        choose_substeps(model.system, p, exact[::10], 0.01) < choose_substeps(explicit.system, p, exact[::10], 0.01) / 2
    )


@pytest.mark.rest
@pytest.mark.parametrize("kernel", KERNELS)
def test_slopes_of_lugre_are_those_of_finite_differences(bristles, kernel):
    u, x0, _ = bristles
    model = pneumatic_cylinder + lugre()
    step, data, p = rk4(model.system, 8), record(u[:40], 0.01, 3), values(model)
    jacobian = slopes(step, data, p, x0, kernel)
    for k in [list(model.values).index(name) for name in ("f_v", "Fc", "Fs", "vs", "s0", "s1")]:
        difference = differences(step, data, p, x0, k)
        assert np.allclose(jacobian[:, :, k], difference, rtol=1e-4, atol=1e-5 * np.abs(difference).max(axis=0))


def test_mixed_follows_the_coil_in_one_substep_where_rk4_explodes():
    model = (micro_actuator + effect("cubic_stiffness")).start(K3=5e10)
    s, p, period = model.system, values(model), 2.5e-4
    t = np.arange(1200) * period
    u = sum(2 * np.sin(2 * np.pi * f * t + f) for f in (30.0, 55.0, 90.0, 180.0))
    data = record(u, period, 2)
    exact = path(rk4(s, 64), data, p, np.zeros(3))[1]
    with np.errstate(all="ignore"):
        assert not np.isfinite(path(rk4(s, 1), data, p, np.zeros(3))[1]).all()
    fast = find_fast_relaxing_states(s, p, exact[::100])
    assert fast == (2,)  # the current, not the velocity
    step = discretise(s, p, exact[::100], data.lengths, method="mixed")
    assert (step.name, step.substeps) == ("RK4 with exponentials", 1)
    errors = [
        np.sqrt(
            np.mean((path(mixed(s, fast, n), data, p, np.zeros(3))[1] - exact) ** 2, axis=0) / np.mean(exact**2, axis=0)
        )
        for n in (1, 2, 4, 8)
    ]
    assert np.all(errors[0] < 1e-3), errors[0]
    assert np.all(orders([e.max() for e in errors]) > 1.8), errors


@pytest.mark.parametrize(("method", "order", "tolerance"), [(midpoint, 2, 1e-4), (radau, 3, 1e-6)])
def test_implicit_methods_have_their_order(method, order, tolerance):
    model = coil(0.3)
    u = np.array([0.3, 1.0, -0.5])
    exact = solved(model, u, 0.5, [1.0, 0.0, 0.0], 1e-12, 1e-13, slope=True)[-1]
    errors = [
        np.linalg.norm(
            path(method(model.system, n), record(u, 0.5, first_order=True), values(model), [1.0, 0.0, 0.0])[1][-1]
            - exact
        )
        for n in (8, 16, 32, 64)
    ]
    assert np.all(np.abs(orders(errors) - order) < 0.3), orders(errors)
    assert errors[-1] < tolerance


def test_implicit_methods_take_a_stiff_mode_of_minus_ten_thousand():
    """``lambda h = -1e4``: scipy's Radau is followed, RK4 overflows at once."""
    model = coil(1e-6)
    u = 0.3 * np.sin(np.arange(30) * 0.3)
    exact = solved(model, u, 0.01, [1.0, 0.0, 0.0], 1e-7, 1e-9)
    for method in (midpoint, radau):
        found = path(method(model.system), record(u, 0.01), values(model), [1.0, 0.0, 0.0])[1]
        assert np.all(motion_error(found, exact)[:2] < 2e-3), method
    states = [replace(s, relaxing=False) for s in model.states]
    explicit = Model(model.name, states, model.inputs, model.outputs, model.parameters, model.balances)
    with np.errstate(all="ignore"):
        assert not np.isfinite(path(rk4(explicit.system), record(u, 0.01), values(model), [1.0, 0.0, 0.0])[1]).all()


def test_only_radau_forgets_a_stiff_start():
    """L-stability: a current that starts off its balance dies out; the midpoint rule lets it ring on."""
    model = coil(1e-6)
    u = np.zeros(20)
    current = {
        m: path(m(model.system), record(u, 0.01), values(model), [0.0, 0.0, 1.0])[1][:, 2] for m in (midpoint, radau)
    }
    assert np.abs(current[radau][2:]).max() < 1e-6
    assert np.abs(current[midpoint][-1]) > 0.9


@pytest.mark.parametrize("method", [midpoint, radau])
@pytest.mark.parametrize("kernel", KERNELS)
def test_slopes_of_implicit_methods_are_those_of_finite_differences(method, kernel):
    model = coil(1e-3)
    u = np.random.default_rng(0).normal(size=30)
    step, p, x0 = method(model.system, 2), values(model), [0.5, 0.0, 0.1]
    jacobian = slopes(step, record(u, 0.01), p, x0, kernel)
    for k in range(len(p)):
        difference = differences(step, record(u, 0.01), p, x0, k, relative=1e-4)
        assert np.allclose(jacobian[:, :, k], difference, rtol=1e-5, atol=1e-6 * max(np.abs(difference).max(), 1e-3))


def test_implicit_methods_refuse_large_models():
    states = [State(f"x{k}", "m") for k in range(9)]
    chain = Model(
        "chain",
        states,
        [],
        [Output("x0", "m")],
        [Parameter("T", "s", 1.0)],
        lambda x, u, p: [Balance(s.name, "m/s", 1, s.name, decay=-x[s.name] / p.T) for s in states],
    )
    with pytest.raises(ModelError, match=r"implicit methods take up to 8 states, this model has 9"):
        radau(chain.system)


def test_the_number_of_substeps_meets_an_error_target():
    model = oscillator() + bouc_wen()
    p, x0 = values(model), np.array([0.3, 0.0, 0.0])
    u = 5 * np.sin(np.arange(60.0))[:, None]
    steps = [
        discretise(model.system, p, x0[None], np.array([0.1]), target=target, inputs=u) for target in (1e-2, 1e-3, 1e-4)
    ]
    exact = run_step(rk4(model.system, 512), p, x0, u, 0.1)
    assert steps[0].substeps < steps[1].substeps < steps[2].substeps
    for step, target in zip(steps, (1e-2, 1e-3, 1e-4), strict=True):
        error = np.sqrt(
            np.mean((run_step(step, p, x0, u, 0.1) - exact) ** 2, axis=0) / np.mean((exact - x0) ** 2, axis=0)
        )
        assert error.max() < 1.5 * target
    with pytest.raises(ModelError, match=r"the error target 0.001 needs inputs"):
        discretise(model.system, p, x0[None], np.array([0.1]), target=1e-3)


def test_a_relaxing_state_must_be_linear_in_itself():
    bent = Effect(
        "bent",
        "force",
        [Parameter("c", "1/({displacement}*s)", 1.0)],
        states=[State("z", "{displacement}", relaxing=True)],
        balances=lambda x, u, p: [Balance("loop", "{velocity}", 1, "z", decay=-p.c * x.z**2)],
    )
    with pytest.raises(
        ModelError, match=r"rate of the relaxing state 'z' is not linear in it; write it as alpha - beta z"
    ):
        (oscillator() + bent).system  # noqa: B018
    with pytest.raises(ModelError, match=r"'mixed' needs a fast state"):
        mixed(oscillator().system, ())


def event_solved(model, push, duration, rows):
    """Stribeck by events: scipy solves each phase, stopped by the zero of v or by the push passing Fs."""
    q = model.values
    x, t, phase, found = np.zeros(2), 0.0, 0, [np.zeros(2)]
    grid = np.linspace(0, duration, rows + 1)

    def slide(way):
        return lambda t, x: [
            x[1],
            (
                push(t)
                - q["K"] * x[0]
                - q["B"] * x[1]
                - way * (q["Fc"] + (q["Fs"] - q["Fc"]) * np.exp(-((x[1] / q["vs"]) ** 2)))
            )
            / q["M"],
        ]

    for end in grid[1:]:
        while t < end:
            if phase:
                halt = lambda t, x, phase=phase: phase * x[1] + 1e-14  # noqa: E731
                halt.terminal, halt.direction = True, -1
                part = solve_ivp(slide(phase), (t, end), x, method="DOP853", rtol=1e-11, atol=1e-13, events=halt)
                t, x = part.t[-1], part.y[:, -1]
                if part.status == 1:
                    x, rest = np.array([x[0], 0.0]), push(t) - q["K"] * x[0]
                    phase = 0 if abs(rest) <= q["Fs"] else int(np.sign(rest))
            else:
                over = lambda t, x: abs(push(t) - q["K"] * x[0]) - q["Fs"]  # noqa: E731
                over.terminal, over.direction = True, 1
                part = solve_ivp(
                    lambda t, x: [0.0, 0.0], (t, end), x, max_step=1e-3, rtol=1e-11, atol=1e-13, events=over
                )
                t = part.t[-1]
                phase = int(np.sign(push(t) - q["K"] * x[0])) if part.status == 1 else 0
        found.append(x.copy())
    return np.array(found)


def test_stribeck_friction_breaks_away_slides_and_sticks_with_order_two():
    """A level that falls with speed: errors against a solver with events, fall with the square of the step or faster."""
    model = oscillator() + stribeck()
    push = lambda t: 45 * np.sin(2.5 * t) + 10 * np.sin(7 * t)  # noqa: E731
    exact = event_solved(model, push, 4.0, 40)
    errors = []
    for n in (100, 200, 400, 800, 1600):
        u = push(np.arange(40 * n // 10 + 1) * 4.0 / (4 * n))
        found = path(rk4(model.system, 1), record(u, 4.0 / (4 * n), first_order=True), values(model), [0.0, 0.0])[1]
        errors.append(np.abs(found[:: n // 10, 0] - exact[:, 0]).max() / np.ptp(exact[:, 0]))
    assert np.log2(errors[0] / errors[-1]) / 4 > 1.7, errors
    assert errors[-1] < 1e-5
    assert np.mean(exact[:, 1] == 0) > 0.1  # it does stick now and then


def test_static_friction_above_sliding_breaks_away_within_a_step():
    """A ramp passes Fs between two rows: with the level falling at once the start of motion is where the ramp passes."""
    stiction = Effect(
        "stiction",
        "force",
        [Parameter("Fc", "{force}", 20.0, (0.0, 1e4)), Parameter("Fs", "{force}", 30.0, (0.0, 1e4))],
        dry=lambda x, u, p: DryFriction(p.Fc, p.Fs),
    )
    model = oscillator(K=1e-9, B=1e-9) + stiction
    u = 29.0 + 4.0 * np.arange(6) / 5  # passes 30 N after 1.25 rows
    for substeps in (1, 4):
        found = path(rk4(model.system, substeps), record(u, 0.1, first_order=True), values(model), [0.0, 0.0])[1]
        t = 0.1 * np.arange(6) - 0.125
        expected = np.where(t > 0, (10 * t + 8 * t**2 / 2) / 2, 0)
        assert np.all(found[:2] == 0.0)  # not a trace of creep
        assert np.allclose(found[2:, 1], expected[2:], rtol=1e-7)


@pytest.mark.rest
@pytest.mark.parametrize("method", [rk4, midpoint, radau])
def test_bristles_and_dry_friction_together_stay_finite(method):
    """A dry guide beside a bristle seal: the exponential runs inside each piece of the cut step."""
    model = oscillator(K=200.0) + lugre(s0=2e4, s1=20.0) + effect("coulomb_friction")
    model = model.start(**{"coulomb_friction.Fc": 5.0})
    u = 60 * np.sin(0.1 * np.arange(200))
    coarse = path(method(model.system, 8), record(u, 0.02), values(model), np.zeros(3))[1]
    fine = path(method(model.system, 64), record(u, 0.02), values(model), np.zeros(3))[1]
    assert np.abs(coarse - fine)[:, 0].max() < 5e-3 * np.abs(fine[:, 0]).max()
    assert np.abs(fine[:, 0]).max() > 0.05


def test_a_relaxing_rate_of_zero_is_an_integral():
    """``beta h -> 0``: the exponential's series takes over without a jump."""
    model = coil(1.0)
    step, p = rk4(model.system), values(model)
    p[list(model.values).index("T")], p[list(model.values).index("R")] = 1e9, 1e-9
    x = step.advance([0.0, 0.0, 0.0], 1.0, 1.0, p, 0.1).full().ravel()
    assert x[2] == pytest.approx(0.1, rel=1e-9)
    near = [
        float(step.advance([0.0, 0.0, 1.0], 0.0, 0.0, [5.0, 0.1 / w, 1.0, 1.0], 0.1)[2]) - np.exp(-w)
        for w in (0.499999, 0.500001, 1e-9, 40.0)
    ]
    assert np.abs(near).max() < 1e-14
