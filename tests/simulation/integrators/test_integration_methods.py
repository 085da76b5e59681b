"""Discrete steps against analytic answers, another library and a fine-step independent solver."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from greybox import Balance, DryFriction, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.simulation.integrators import discretisation
from greybox.simulation.integrators.discretisation import choose_substeps, discretise
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.runge_kutta import rk4
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder

LINEAR = [micro_actuator, pneumatic_cylinder]
ALL = np.arange


def values(model):
    return np.array(list(model.values.values()))


def matrices(model):
    """A, B by the model's own jacobian at the origin (the model is linear)."""
    system = model.system
    a = ca.Function("a", [system.p], [ca.jacobian(system.rhs, system.x)])(values(model)).full()
    b = ca.Function("b", [system.p], [ca.jacobian(system.rhs, system.u)])(values(model)).full()
    return a, b


@pytest.mark.parametrize("model", LINEAR, ids=lambda m: m.name)
@pytest.mark.parametrize("period", [2.5e-4, 1e-2])
def test_the_exact_hold_is_scipys_zero_order_hold(model, period):
    a, b = matrices(model)
    nx, nu = b.shape
    step = exact_hold(model.system)
    q, _ = step.coefficients(values(model), np.array([period]), ALL(0))
    phi, gamma, *_ = cont2discrete((a, b, np.eye(nx), np.zeros((nx, nu))), period, "zoh")
    scale = np.maximum(np.abs(phi), 1e-12 * np.abs(phi).max())
    assert np.max(np.abs(q[0, : nx * nx].reshape(nx, nx, order="F") - phi) / scale.max()) < 1e-12
    assert np.allclose(
        q[0, nx * nx : nx * nx + nx * nu], gamma.ravel(order="F"), rtol=1e-12, atol=1e-12 * np.abs(gamma).max()
    )


@pytest.mark.parametrize("model", LINEAR, ids=lambda m: m.name)
def test_the_exact_hold_follows_a_ramp_exactly(model):
    """First-order hold against the ODE solved with the ramp as a further state."""
    a, b = matrices(model)
    nx = len(a)
    h, ua, ub = 1e-3, 0.7, -1.1
    q, _ = (step := exact_hold(model.system)).coefficients(values(model), np.array([h]), ALL(0))
    x0 = np.linspace(0.1, 0.4, nx)
    c = ca.Function(
        "c", [model.system.p], [ca.substitute(model.system.rhs, ca.vertcat(model.system.x, model.system.u), 0)]
    )(values(model))
    slope = (ub - ua) / h
    exact = solve_ivp(
        lambda t, x: a @ x + b[:, 0] * (ua + slope * t) + c.full().ravel(),
        (0, h),
        x0,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    ).y[:, -1]
    mine = step.advance(x0, ua, ub, q[0], h).full().ravel()
    assert np.allclose(mine, exact, rtol=1e-9, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("model", LINEAR, ids=lambda m: m.name)
def test_slopes_of_the_exact_hold_are_those_of_finite_differences(model):
    step, p, h = exact_hold(model.system), values(model), np.array([2.5e-4, 1e-3])
    _, dq = step.coefficients(p, h, ALL(len(p)))
    for k in range(len(p)):
        e = np.zeros(len(p))
        e[k] = 1e-5 * p[k]
        difference = (step.coefficients(p + e, h, ALL(0))[0] - step.coefficients(p - e, h, ALL(0))[0]) / (2 * e[k])
        assert np.allclose(dq[:, :, k], difference, rtol=1e-6, atol=1e-7 * max(np.abs(difference).max(), 1e-300))


def duffing():
    return Model(
        "duffing",
        [State("x", "m"), State("v", "m/s")],
        [Input("u", "N")],
        [Output("x", "m")],
        [
            Parameter("M", "kg", 1.0),
            Parameter("B", "N*s/m", 0.4),
            Parameter("K", "N/m", 4.0),
            Parameter("K3", "N/m**3", 3.0),
        ],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", drive=u.u, damping=-p.B * x.v, spring=-p.K * x.x, cubic=-p.K3 * x.x**3),
        ],
    )


def test_rk4_converges_with_order_four():
    model = duffing()
    exact = solve_ivp(
        lambda t, x: [x[1], 1.5 * t - 0.4 * x[1] - 4 * x[0] - 3 * x[0] ** 3],
        (0, 1),
        [1.0, 0.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    ).y[:, -1]
    errors = []
    for n in (10, 20, 40, 80):
        step, x = rk4(model.system), np.array([1.0, 0.0])
        for k in range(n):
            x = step.advance(x, 1.5 * k / n, 1.5 * (k + 1) / n, values(model), 1 / n).full().ravel()
        errors.append(np.linalg.norm(x - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 3.8) & (orders < 4.3)), orders


def test_substeps_are_tied_to_the_fastest_eigenvalue():
    system, p = micro_actuator.system, values(micro_actuator)
    fastest = np.abs(np.linalg.eigvals(matrices(micro_actuator)[0])).max()
    n = choose_substeps(system, p, np.zeros((1, 3)), 2.5e-4)
    assert 2.5e-4 * fastest / n <= 0.5 < 2.5e-4 * fastest / (n - 1)


def rubbing(level, static=None):
    """A mass on a spring with dry friction."""
    friction = Effect(
        "rubbing",
        "force",
        [Parameter("Fc", "N", level, (0, 1e6)), Parameter("Fs", "N", static or level, (0, 1e6))],
        dry=lambda x, u, p: DryFriction(p.Fc, p.Fs),
    )
    spring = Model(
        "spring",
        [State("x", "m"), State("v", "m/s")],
        [Input("u", "N")],
        [Output("x", "m")],
        [Parameter("M", "kg", 2.0), Parameter("K", "N/m", 50.0)],
        lambda x, u, p: [
            Balance("position", "m/s", 1, "x", velocity=x.v),
            Balance("force", "N", p.M, "v", drive=u.u, spring=-p.K * x.x),
        ],
    )
    return spring + friction


def run(model, x0, u, h, substeps=1):
    step, p, x, path = rk4(model.system), values(model), np.array(x0, float), []
    for k in range(len(u) - 1):
        for _ in range(substeps):
            x = step.advance(x, u[k], u[k], p, h / substeps).full().ravel()
        path.append(x)
    return np.array(path)


def test_an_error_is_held_against_the_movement_from_the_first_row(monkeypatch):
    """All of it lies in the first interval: an error of 1e-4 of it is allowed, and one of 1e-2 is not before it is a sixteenth."""

    def settle(error):
        def run(step, *_):
            return np.where(np.arange(2000) > 0, 1.0 + error / step.substeps**4, 0.0)[:, None]

        monkeypatch.setattr(discretisation, "run_step", run)
        make = lambda substeps: SimpleNamespace(substeps=substeps)  # noqa: E731
        return discretisation.refine_substeps(1e-3, make, 1, None, None, None, 1.0).substeps

    assert [settle(error) for error in (1e-4, 1e-2)] == [1, 2]


def test_a_block_slides_to_a_stop_where_theory_says_and_stays():
    """Coulomb 1785: with no spring force a block stops after v0^2 M / (2 Fc) and does not creep."""
    model = rubbing(3.0).start(K=1e-12)
    path = run(model, [0.0, 1.0], np.zeros(101), 0.01)
    assert path[-1, 0] == pytest.approx(2.0 / (2 * 3.0), rel=1e-12)
    assert np.all(path[70:, 1] == 0.0)
    assert np.ptp(path[70:, 0]) == 0.0


def test_amplitude_of_a_rubbing_oscillator_falls_by_four_fc_over_k_each_period():
    model = rubbing(1.0)
    period = 2 * np.pi * np.sqrt(2.0 / 50.0)
    path = run(model, [0.5, 0.0], np.zeros(401), period / 100)
    peaks = [path[100 * k - 1, 0] for k in (1, 2, 3)]
    assert np.allclose(peaks, 0.5 - 4 * 1.0 / 50.0 * np.array([1, 2, 3]), atol=2e-5)


def test_a_held_block_leaves_when_the_push_exceeds_the_static_level():
    model = rubbing(3.0, static=5.0).start(K=1e-12)
    held = run(model, [0.0, 0.0], np.full(50, 4.99), 0.01)
    assert np.all(held == 0.0)
    moving = run(model, [0.0, 0.0], np.full(51, 5.01), 0.01)
    assert moving[-1, 1] == pytest.approx((5.01 - 3.0) / 2.0 * 0.5, rel=1e-9)


def moreau(model_values, x0, u, h, fine):
    """Independent solver: time stepping by Moreau (1988), friction as a bound on the impulse, tiny steps."""
    m, k, fc = model_values
    x, v = x0
    path = []
    for push in u[:-1]:
        dt = h / fine
        for _ in range(fine):
            free = v + dt * (push - k * x) / m
            v_new = np.sign(free) * max(abs(free) - dt * fc / m, 0.0)
            x += dt * (v + v_new) / 2
            v = v_new
        path.append((x, v))
    return np.array(path)


@pytest.mark.rest
def test_sticking_and_sliding_agree_with_moreaus_time_stepping():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.normal(0, 8, 40), 10)
    mine = run(rubbing(3.0), [0.0, 0.0], u, 0.01, substeps=4)
    fine = moreau((2.0, 50.0, 3.0), (0.0, 0.0), u, 0.01, 2000)
    assert np.abs(mine[:, 0] - fine[:, 0]).max() < 1e-4 * np.abs(fine[:, 0]).max()
    assert np.mean(mine[:, 1] == 0.0) > 0.02  # it does stick now and then


def test_the_step_with_friction_is_differentiable_across_a_stop():
    model = rubbing(3.0)
    step, p = rk4(model.system), values(model)
    x, u = np.array([0.1, 0.012]), 0.4
    slope = ca.Function("s", (a := step.advance).sx_in(), [ca.jacobian(a(*a.sx_in()), a.sx_in()[3])])(
        x, u, u, p, 0.02
    ).full()
    for k in range(len(p)):
        e = np.zeros(len(p))
        e[k] = 1e-6 * p[k]
        difference = (step.advance(x, u, u, p + e, 0.02) - step.advance(x, u, u, p - e, 0.02)).full().ravel() / (
            2 * e[k]
        )
        assert np.allclose(slope[:, k], difference, rtol=1e-5, atol=1e-9)


def two_rubbing(levels):
    """Two masses joined by a spring, the first pushed and the second on a spring to the ground, each with dry friction."""
    model = Model(
        "two",
        [State("x1", "m"), State("v1", "m/s"), State("x2", "m"), State("v2", "m/s")],
        [Input("u", "N")],
        [Output("x1", "m")],
        [Parameter("M1", "kg", 2.0), Parameter("M2", "kg", 1.0), Parameter("K", "N/m", 80.0)],
        lambda x, u, p: [
            Balance("position1", "m/s", 1, "x1", velocity=x.v1),
            Balance("force", "N", p.M1, "v1", drive=u.u, spring=-p.K * (x.x1 - x.x2)),
            Balance("position2", "m/s", 1, "x2", velocity=x.v2),
            Balance("second_force", "N", p.M2, "v2", spring=p.K * (x.x1 - x.x2), ground=-0.5 * p.K * x.x2),
        ],
    )
    sites = ("force", "second_force")
    for k, (site, level) in enumerate(zip(sites, levels, strict=True), 1):
        name = f"F{k}"
        friction = Parameter(name, "N", level, (0, 1e6))
        model = model + Effect(
            f"rubbing{k}", site, [friction], dry=lambda x, u, p, name=name: DryFriction(p[name], p[name])
        )
    return model


def moreau_of_two(masses, k, levels, u, h, fine):
    """As `moreau`, for the two bodies: the spring's force from the state at the beginning of each tiny step."""
    m, f = np.array(masses), np.array(levels)
    x, v, dt, path = np.zeros(2), np.zeros(2), h / fine, []
    for push in u[:-1]:
        for _ in range(fine):
            shaft = k * (x[0] - x[1])
            free = v + dt * np.array([push - shaft, shaft - 0.5 * k * x[1]]) / m
            v = np.sign(free) * np.maximum(np.abs(free) - dt * f / m, 0.0)
            x = x + dt * v
        path.append((x[0], v[0], x[1], v[1]))
    return np.array(path)


@pytest.mark.rest
def test_two_bodies_stick_and_slide_each_for_itself():
    rng = np.random.default_rng(2)
    u = np.repeat(rng.normal(0, 9, 16), 10)
    levels = (3.0, 2.0)
    step_error = []
    fine = moreau_of_two((2.0, 1.0), 80.0, levels, u, 0.01, 400)
    finer = moreau_of_two((2.0, 1.0), 80.0, levels, u, 0.01, 800)
    exact = 2 * finer - fine  # its error is of first order
    for substeps in (2, 8):
        mine = run(two_rubbing(levels), [0.0] * 4, u, 0.01, substeps=substeps)
        at_rest = mine[:, [1, 3]] == 0.0
        step_error.append(np.abs(mine[:, [0, 2]] - exact[:, [0, 2]]).max() / np.ptp(exact[:, 0]))
    assert step_error[1] < 3e-4
    assert step_error[0] < 3e-3
    # Alone and together.
    assert at_rest.all(axis=1).mean() > 0.02
    assert (at_rest[:, 0] & ~at_rest[:, 1]).mean() > 0.02
    assert (at_rest[:, 1] & ~at_rest[:, 0]).mean() > 0.02


def test_a_step_in_which_both_bodies_stop_is_exact_and_has_slopes():
    """Without springs each stops at ``v0 M / F``: one after 0.2 s, the other after 0.35 s of a step of 0.5 s."""
    model = two_rubbing((4.0, 2.0)).start(K=1e-12)
    step, p, x = rk4(model.system), values(model), np.array([0.0, 0.4, 0.0, 0.7])
    end = step.advance(x, 0.0, 0.0, p, 0.5).full().ravel()
    assert end == pytest.approx([0.4**2 * 2.0 / (2 * 4.0), 0.0, 0.7**2 * 1.0 / (2 * 2.0), 0.0], abs=1e-12)
    slope = ca.Function("s", (a := step.advance).sx_in(), [ca.jacobian(a(*a.sx_in()), a.sx_in()[3])])(
        x, 0.0, 0.0, p, 0.5
    ).full()
    k1, k2 = (list(model.values).index(name) for name in ("F1", "F2"))
    assert slope[[0, 2], [k1, k2]] == pytest.approx([-(0.4**2) * 2.0 / (2 * 16.0), -(0.7**2) / (2 * 4.0)])


def test_unknown_and_unsuitable_methods_are_refused():
    p, x, h = values(duffing()), np.zeros((1, 2)), np.array([0.01])
    with pytest.raises(ModelError, match=r"unknown discretisation 'rk5'; did you mean 'rk4'"):
        discretise(duffing().system, p, x, h, method="rk5")
    with pytest.raises(ModelError, match=r"exact hold needs equations that are linear"):
        discretise(duffing().system, p, x, h, method="exact")


def test_irregular_time_does_not_need_a_matrix_exponential_for_every_interval():
    few = discretise(micro_actuator.system, values(micro_actuator), np.zeros((1, 3)), np.array([1e-4, 2e-4]))
    many = discretise(micro_actuator.system, values(micro_actuator), np.zeros((1, 3)), np.linspace(1e-4, 2e-4, 500))
    assert (few.name, many.name) == ("exact hold", "RK4")
