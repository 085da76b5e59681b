"""Steps that follow the error: against SciPy, closed forms and differences; the compiled kernel against NumPy's."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base import ModelError
from greybox.simulation.integrators.discretisation import choose_implicit_method, discretise
from greybox.simulation.integrators.esdirk import LESS, NODES, TABLE, esdirk
from greybox.simulation.kernel.adaptive import AdaptiveKernel, plan_elimination
from greybox.simulation.kernel.c_compiler import CompilerBudgetError
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.record import Record
from models.micro_actuator import micro_actuator


def robertson():
    """Three reactions whose rates differ by nine decades (Robertson 1966)."""
    return Model(
        "robertson",
        [State("a", "1", 1.0), State("b", "1"), State("c", "1")],
        [],
        [Output("a", "1"), Output("b", "1")],
        [Parameter("k1", "1/s", 0.04), Parameter("k2", "1/s", 3e7), Parameter("k3", "1/s", 1e4)],
        lambda x, u, p: [
            Balance("a", "1/s", 1, "a", slow=-p.k1 * x.a, back=p.k3 * x.b * x.c),
            Balance("b", "1/s", 1, "b", slow=p.k1 * x.a, back=-p.k3 * x.b * x.c, fast=-p.k2 * x.b**2),
            Balance("c", "1/s", 1, "c", fast=p.k2 * x.b**2),
        ],
    )


def valve():
    """A spool with a time constant of 0.1 ms before a chamber that fills in a second; it begins at rest, at zero."""
    return Model(
        "valve",
        [State("s", "V"), State("q", "m^3"), State("w", "m^3")],
        [Input("u", "V")],
        [Output("w", "m^3", lambda x, u, p: x.w + p.share * x.q)],
        [
            Parameter("f", "1/s", 1e4),
            Parameter("c", "1/V^2", 0.3),
            Parameter("k", "1/s", 2.0),
            Parameter("g", "m^3/V/s", 1.0),
            Parameter("share", "1", 0.1),
        ],
        lambda x, u, p: [
            Balance("spool", "V/s", 1, "s", command=p.f * u.u, back=-p.f * x.s, harder=-p.f * p.c * x.s**3),
            Balance("chamber", "m^3/s", 1, "q", inflow=p.g * x.s, out=-p.k * x.q),
            Balance("second", "m^3/s", 1, "w", inflow=p.k * x.q, out=-p.k * x.w / 4),
        ],
    )


def wall(layers):
    """Heat through layers whose capacities fall over six decades; linear but for radiation at its end."""

    def balances(x, u, p):
        for k in range(layers):
            before = u.Ta if k == 0 else x[f"T{k - 1}"]
            after = {} if k + 1 == layers else {"on": (x[f"T{k + 1}"] - x[f"T{k}"]) * p.h}
            loss = {"radiation": -p.e * x[f"T{k}"] ** 4} if k + 1 == layers else {}
            capacity = p.C * 10.0 ** (-6 * k / (layers - 1))
            yield Balance(f"layer{k}", "W", capacity, f"T{k}", come=(before - x[f"T{k}"]) * p.h, **after, **loss)

    return Model(
        "wall",
        [State(f"T{k}", "K", 300.0) for k in range(layers)],
        [Input("Ta", "K")],
        [Output("T", "K", lambda x, u, p: x[f"T{layers - 1}"])],
        [Parameter("C", "J/K", 1e4), Parameter("h", "W/K", 5.0), Parameter("e", "W/K^4", 1e-9)],
        lambda x, u, p: list(balances(x, u, p)),
    )


def record_of(model, time, u):
    h = np.diff(time)
    y = np.zeros((len(time), len(model.outputs)))
    return Record(u.reshape(len(time), -1), y, h, np.zeros(len(h)), np.unique(h))


@cache
def case(name):
    rng = np.random.default_rng(1)
    if name == "robertson":
        model, time = robertson(), np.concatenate([[0], np.geomspace(1e-3, 1e5, 40)])
        return model, record_of(model, time, np.zeros((len(time), 0)))
    if name == "valve":
        model, time = valve(), np.cumsum(rng.uniform(0.001, 0.1, 40))
        return model, record_of(model, time, np.concatenate([[0, 0, 0], rng.uniform(-2, 2, 37)]))
    model, time = wall(30), np.cumsum(rng.uniform(1, 600, 40))
    return model, record_of(model, time, 300 + 20 * rng.uniform(-1, 1, 40))


CASES = ("robertson", "valve", "wall")


def reference(model, record):
    """States (N, nx) by SciPy's Radau method, a thousand times as exact."""
    p = np.array(list(model.values.values()))
    s = model.system
    f = ca.Function("f", [s.x, s.u, s.p], [s.rhs, ca.jacobian(s.rhs, s.x)])
    x = [np.asarray(s.start_function(p)[0]).ravel()]
    for k, length in enumerate(record.h):
        run = solve_ivp(
            lambda _, z, k=k: f(z, record.u[k], p)[0].full().ravel(),
            (0, length),
            x[-1],
            method="Radau",
            jac=lambda _, z, k=k: f(z, record.u[k], p)[1].full(),
            rtol=1e-9,
            atol=1e-9 * np.maximum(np.abs(x[-1]), 1e-6),
        )
        x.append(run.y[:, -1])
    return np.array(x)


def test_where_the_larger_text_does_not_compile_numpy_goes_on(monkeypatch):
    kernel, record, p, x0 = run(CASES[0])
    expected = kernel.residuals(record.first(4), point_of(p, x0), np.ones(len(case(CASES[0])[0].outputs)))

    def give_up(*_, **__):
        raise CompilerBudgetError("C compiler took more than 60 s")

    other, record, p, x0 = run(CASES[0])
    monkeypatch.setattr("greybox.simulation.kernel.adaptive.load_library", give_up)
    for found, known in zip(
        other.residuals(record.first(4), point_of(p, x0), np.ones(len(case(CASES[0])[0].outputs))),
        expected,
        strict=True,
    ):
        assert found == pytest.approx(known, rel=1e-6, abs=1e-8 * np.abs(known).max())
    assert not other.is_compiled and "more than 60 s" in other.reason


def point_of(p, x0):
    return KernelPoint(p[None], np.diag(p)[None], p, np.diag(p), x0, np.zeros((len(x0), len(p))))


def run(name, refinement=1, compiled=True):
    model, record = case(name)
    kernel = AdaptiveKernel(esdirk(model.system, refinement))
    kernel.is_compiled = compiled
    p = np.array(list(model.values.values()))
    x0 = np.asarray(model.system.start_function(p)[0]).ravel()
    return kernel, record, p, x0


def test_the_method_has_order_four_and_its_companion_order_three():
    c, a, weights = NODES, TABLE, TABLE[-1]
    others = weights - LESS
    conditions = [(np.ones(6), 1), (c, 1 / 2), (c**2, 1 / 3), (a @ c, 1 / 6)]
    assert all(others @ left == pytest.approx(right, abs=1e-14) for left, right in conditions)
    conditions += [(c**3, 1 / 4), (c * (a @ c), 1 / 8), (a @ c**2, 1 / 12), (a @ a @ c, 1 / 24)]
    assert all(weights @ left == pytest.approx(right, abs=1e-14) for left, right in conditions)
    # R(z) -> 0 for z -> -inf: the last stage is the end of the step, and the implicit part can be inverted.
    growth = [abs(1 + z * weights @ np.linalg.solve(np.eye(6) - z * a, np.ones(6))) for z in (-1e3, -1e5, -1e7)]
    assert growth[1] < 0.02 * growth[0] < 1e-3 and growth[2] < 0.02 * growth[1]


@pytest.mark.rest
@pytest.mark.parametrize("name", ["robertson", *(pytest.param(n, marks=pytest.mark.slow) for n in ("valve", "wall"))])
def test_states_are_those_of_scipy(name):
    kernel, record, p, x0 = run(name)
    _, x = kernel.simulate(record, p[None], p, x0)
    expected = reference(case(name)[0], record)
    assert np.abs(x - expected).max(axis=0) == pytest.approx(0, abs=1e-5 * np.abs(expected).max())
    assert (np.abs(x - expected).max(axis=0) < 2e-5 * np.abs(expected).max(axis=0)).all()


def test_a_linear_run_is_that_of_the_matrix_exponential():
    matrix = np.array([[-1e5, 3.0], [2.0, -1.0]])
    model = Model(
        "linear",
        [State("x", "1", 1.0), State("y", "1", -2.0)],
        [],
        [Output("y", "1")],
        [Parameter("a", "1/s", 1e5)],
        lambda x, u, p: [
            Balance("x", "1/s", 1, "x", own=-p.a * x.x, other=3.0 * x.y * p.a / 1e5),
            Balance("y", "1/s", 1, "y", own=-x.y * p.a / 1e5, other=2.0 * x.x * p.a / 1e5),
        ],
    )
    record = record_of(model, np.array([0.0, 1e-6, 1e-3, 2.0]), np.zeros((4, 0)))
    _, x = AdaptiveKernel(esdirk(model.system)).simulate(
        record, np.array([[1e5]]), np.array([1e5]), np.array([1.0, -2.0])
    )
    expected = [expm(matrix * t) @ [1.0, -2.0] for t in (0.0, 1e-6, 1e-3, 2.0)]
    assert x == pytest.approx(np.array(expected), rel=2e-5, abs=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_shorter_steps_are_nearer(name):
    kernel, record, p, x0 = run(name)
    runs = [k.simulate(record, p[None], p, x0)[1] for k in (kernel, kernel.with_substeps(3), kernel.with_substeps(9))]
    coarse, fine = (np.abs(x - runs[-1]).max(axis=0) for x in runs[:2])
    assert (fine <= 0.3 * coarse + 1e-12 * np.abs(runs[-1]).max()).all()


@pytest.mark.parametrize("name", CASES)
def test_tangents_are_the_slopes_of_the_run(name):
    kernel, record, p, x0 = run(name)
    dp, dx0 = np.hstack([np.diag(p), np.zeros((len(p), 1))]), np.zeros((len(x0), len(p) + 1))
    dx0[0, -1] = 1.0
    point = KernelPoint(p[None], dp[None], p, dp, x0, dx0)
    fine, size, weight = kernel.with_substeps(8), 1e-3, np.ones(len(case(name)[0].outputs))
    (_, usual), (_, jacobian) = (k.residuals(record, point, weight) for k in (kernel, fine))
    for k in range(len(p) + 1):
        ends = [
            fine.simulate(record, (p + s * dp[:, k])[None], p + s * dp[:, k], x0 + s * dx0[:, k])[0]
            for s in (size, -size)
        ]
        slope = (ends[1] - ends[0]) / (2 * size)
        assert jacobian[:, :, k] == pytest.approx(slope, abs=2e-5 * np.abs(slope).max())
        # The error of the usual steps is that of the states, whose slopes follow.
        assert usual[:, :, k] == pytest.approx(slope, abs=5e-4 * np.abs(slope).max())


@pytest.mark.parametrize("name", [CASES[0], *(pytest.param(name, marks=pytest.mark.rest) for name in CASES[1:])])
def test_without_a_compiler_the_numbers_are_the_same(name):
    model = case(name)[0]
    results = []
    for compiled in (True, False):
        kernel, record, p, x0 = run(name, compiled=compiled)
        part = record.first(8)
        point = point_of(p, x0)
        results.append(kernel.residuals(part, point, np.ones(len(model.outputs))))
        assert kernel.sums(part, point, np.ones(len(model.outputs))).cost == pytest.approx(
            np.nansum(results[-1][0] ** 2)
        )
    (r, jacobian), (other_r, other_jacobian) = results
    assert other_r == pytest.approx(r, rel=1e-8, abs=1e-10 * np.abs(r).max())
    assert other_jacobian == pytest.approx(jacobian, rel=1e-6, abs=1e-8 * np.abs(jacobian).max())


def test_parts_of_a_record_join():
    kernel, record, p, x0 = run("valve")
    whole = kernel.simulate(record, p[None], p, x0)[1]
    from greybox.simulation.kernel import adaptive

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptive, "NUMBERS_AT_A_TIME", 60)
        parts = kernel.simulate(record, p[None], p, x0)[1]
    assert parts == pytest.approx(whole, rel=1e-4, abs=1e-6)


def test_a_run_that_grows_beyond_bounds_ends_where_it_does():
    model = Model(
        "blast",
        [State("x", "1", 1.0)],
        [],
        [Output("x", "1")],
        [Parameter("a", "1/s", 1.0)],
        lambda x, u, p: [Balance("x", "1/s", 1, "x", growth=p.a * x.x**2)],
    )
    # x = 1 / (1 - t) has no value from t = 1 on.
    record = record_of(model, np.array([0.0, 0.5, 0.9, 1.1, 1.2]), np.zeros((5, 0)))
    one = np.array([1.0])
    y, _ = AdaptiveKernel(esdirk(model.system)).simulate(record, one[None], one, one)
    assert y[:3, 0] == pytest.approx([1.0, 2.0, 10.0], rel=3e-4)
    assert np.isnan(y[3:]).all()


def test_the_method_is_chosen_for_stiff_models_by_their_states_and_use():
    assert choose_implicit_method(valve().system) == "esdirk"
    assert choose_implicit_method(valve().system, written_out=True) == "radau"
    assert choose_implicit_method(wall(30).system) == "esdirk"
    assert choose_implicit_method(wall(30).system, written_out=True) == ""
    p, x = np.array(list(wall(30).values.values())), np.full((1, 30), 300.0)
    assert discretise(wall(30).system, p, x, np.array([1e5])).label.startswith("ESDIRK")


def test_few_products_are_planned_for_a_sparse_matrix():
    n = 40
    chain = np.arange(n - 1)
    plan = plan_elimination(n, np.r_[chain, chain + 1], np.r_[chain + 1, chain])
    # Of a chain each unknown has one neighbour left at most.
    assert sorted(plan.order) == list(range(n))
    assert max(map(len, plan.below + plan.right)) == 1
    # A hub that all others depend on comes last.
    hub = plan_elimination(n, np.r_[chain + 1, np.zeros(n - 1, int)], np.r_[np.zeros(n - 1, int), chain + 1])
    assert 0 in hub.order[-2:]
    everything = np.divmod(np.arange(n * n), n)
    assert plan_elimination(n, *everything) is None


def test_a_diagonal_that_is_small_beside_its_row_is_exchanged():
    """Filters ten thousand times faster than a step: the place of each follows its speed alone, whose row is eliminated first."""

    def balances(x, u, p):
        for k in range(2):
            before = x.x0 if k else u.u - p.c * u.u**3
            yield Balance(f"place{k}", "1/s", 1, f"x{k}", speed=p.w * x[f"v{k}"])
            yield Balance(f"speed{k}", "1/s", 1, f"v{k}", pull=p.w * (before - x[f"x{k}"]), drag=-2 * p.w * x[f"v{k}"])

    model = Model(
        "followers",
        [State(f"{name}{k}", "1") for k in range(2) for name in "xv"],
        [Input("u", "1")],
        [Output("x1", "1")],
        [Parameter("w", "1/s", 1e5), Parameter("c", "1", 0.1)],
        lambda x, u, p: list(balances(x, u, p)),
    )
    kernel, p = AdaptiveKernel(esdirk(model.system)), np.array([1e5, 0.1])
    assert plan_elimination(4, *kernel._places) is not None
    record = record_of(model, np.array([0.0, 1.0, 2.0]), np.array([1.0, -0.5, 0.0]))
    r, jacobian = kernel.residuals(record, point_of(p, np.zeros(4)), np.ones(1))
    # It follows within 1 s: x1 = u - c u^3, with the slope -u^3 along c; point_of goes along c itself times its value.
    held = np.array([1.0, -0.5])
    assert -r[1:, 0] == pytest.approx(held - 0.1 * held**3, rel=1e-6)
    assert -jacobian[1:, 0, 1] == pytest.approx(-0.1 * held**3, rel=1e-6)
    assert jacobian[1:, 0, 0] == pytest.approx(0, abs=1e-6)


def test_what_is_not_smooth_is_refused_in_words():
    from greybox.model.effects.catalogue import effect

    with pytest.raises(ModelError, match="dry friction"):
        esdirk((micro_actuator + effect("coulomb_friction")).system)
