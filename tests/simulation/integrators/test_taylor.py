"""The exact hold by its series: the same as scipy's matrices and as our own, and taken where it costs less."""

import numpy as np
import pytest
from scipy.signal import cont2discrete

import greybox as gb
from fits.benchmarks.chains import STEP, make_chain, make_trial
from greybox.base.errors import ModelError
from greybox.simulation.integrators.discretisation import DEFAULT_POLICY, discretise, follow_step
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.taylor import TAYLOR_REMAINDER, choose_taylor_order, taylor
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record


def values(model):
    return np.array(list(model.values.values()))


def reach_of(model, h):
    jacobian = model.system.jacobian(np.zeros(model.system.x.numel()), np.zeros(1), values(model)).full()
    return h * np.abs(np.linalg.eigvals(jacobian)).max()


def make_record(model, rows, h, *, first_order=False, seed=0):
    rng, outputs = np.random.default_rng(seed), len(model.outputs)
    u, y = rng.normal(size=(rows, 1)), 1e-3 * rng.normal(size=(rows, outputs))
    return Record(u, y, np.full(rows - 1, h), np.zeros(rows - 1), np.array([h]), first_order)


@pytest.mark.parametrize(("hold", "first_order"), [("zoh", False), ("foh", True)])
def test_the_run_is_that_of_scipys_matrices(hold, first_order):
    model, h = make_chain(10), STEP
    n, p = 20, values(model)
    a, record = (
        model.system.jacobian(np.zeros(n), np.zeros(1), p).full(),
        make_record(model, 200, h, first_order=first_order),
    )
    b = np.zeros((n, 1))
    b[-1] = 1 / model.values["m"]
    phi, gamma, c, d, _ = cont2discrete((a, b, np.eye(n), np.zeros((n, 1))), h, method=hold)
    step = taylor(model.system, choose_taylor_order(reach_of(model, h)))
    _, x = make_kernel(step).simulate(record, p[None], p, np.zeros(n))
    # scipy's state of a first-order hold is the plant's less what the input of the row adds.
    state, expected = -d[:, 0] * record.u[0, 0], []
    for u in record.u[:, 0]:
        expected.append(c @ state + d[:, 0] * u)
        state = phi @ state + gamma[:, 0] * u
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.rest
@pytest.mark.parametrize("bodies", [8, 25])
def test_cost_gradient_and_matrix_are_those_of_the_matrices(bodies):
    model = make_chain(bodies)
    p, n, record = values(model), 2 * bodies, make_record(model, 300, STEP)
    dp, dx0 = p[:, None] * np.eye(len(p))[:, : bodies + 1], np.zeros((n, bodies + 1))
    found = []
    for step in (exact_hold(model.system), taylor(model.system, choose_taylor_order(reach_of(model, STEP)))):
        kernel, read = make_kernel(step), record.read_by(step)
        q, dq = kernel.coefficients(read, p, dp)
        found.append(kernel.sums(read, KernelPoint(q, dq, p, dp, np.zeros(n), dx0), np.ones(bodies)))
    exact, series = found
    assert series.cost == pytest.approx(exact.cost, rel=1e-11)
    np.testing.assert_allclose(series.gradient, exact.gradient, rtol=1e-9, atol=1e-11 * np.abs(exact.gradient).max())
    scale = np.sqrt(np.outer(np.diag(exact.gauss_newton), np.diag(exact.gauss_newton)))
    assert np.abs(series.gauss_newton - exact.gauss_newton).max() <= 1e-10 * scale.max()


@pytest.mark.parametrize("reach", [0.1, 0.5, 1.0])
def test_a_mode_twice_as_fast_is_followed_within_the_remainder(reach):
    order, rate = choose_taylor_order(reach), 2 * reach
    powers = np.cumprod(np.concatenate([[1.0], 1j * rate / np.arange(1, order + 1)]))
    assert abs(powers.sum() - np.exp(1j * rate)) <= TAYLOR_REMAINDER
    # One term less would not do.
    assert abs(powers[:-1].sum() - np.exp(1j * rate)) > TAYLOR_REMAINDER


def make_full(states):
    """A plant of which each state acts on every other: its matrices hold no zero."""

    def balances(x, u, p):
        for i in range(states):
            others = sum(x[f"x{j}"] / (1 + abs(i - j)) for j in range(states) if j != i)
            yield gb.Balance(
                f"b{i}", "1/s", 1, f"x{i}", own=-3 * p.a * x[f"x{i}"], others=0.1 * p.a * others, drive=u.u
            )

    return gb.Model(
        "full",
        [gb.State(f"x{i}", "1") for i in range(states)],
        [gb.Input("u", "1/s")],
        [gb.Output("x0", "1")],
        [gb.Parameter("a", "1/s", 1.0, (1e-3, 1e3))],
        lambda x, u, p: list(balances(x, u, p)),
    )


@pytest.mark.parametrize(
    ("model", "rows", "h", "taken"),
    [
        (make_chain(25), 100_000, STEP, "series"),
        (make_chain(25), 300, STEP, "exact hold"),  # laying out the instructions would take longer than the passes
        (make_chain(25), 100_000, 40 * STEP, "exact hold"),  # the fastest mode turns many times between two samples
        (make_chain(7), 100_000, STEP, "exact hold"),  # few states: written out
        (make_full(20), 100_000, 0.1, "exact hold"),  # no entry is zero
    ],
)
def test_the_series_is_taken_where_a_search_takes_less_time(model, rows, h, taken):
    n = model.system.x.numel()
    step = discretise(model.system, values(model), np.zeros((1, n)), np.array([h]), rows=rows, directions=n // 2 + 1)
    assert step.label.startswith(taken)


@pytest.mark.slow
def test_a_fit_ends_at_the_same_constants_with_the_same_intervals():
    trial = make_trial(12, 6000)
    by_series = trial.fit()
    exact = gb.fit(trial.model, trial.record, noise=trial.noise, options=gb.FitOptions(at_rest=True, method="exact"))
    assert by_series.discretisation.label.startswith("series")
    assert by_series.solver.cost == pytest.approx(exact.solver.cost, rel=1e-9)
    for name in by_series.uncertainty.free:
        one, other = by_series.parameters[name], exact.parameters[name]
        assert abs(one.value - other.value) < 1e-3 * other.std
        assert one.std == pytest.approx(other.std, rel=1e-6)
    assert max(by_series.discretisation.shift.values()) < 1e-6


def test_substeps_are_as_long_as_the_series_takes_them():
    model = make_chain(8)
    step = taylor(model.system, choose_taylor_order(0.5))
    # Twice the rate that the order was chosen for.
    assert 1.0 <= follow_step(DEFAULT_POLICY, step).eigenvalue_step < 1.3
    assert follow_step(DEFAULT_POLICY, exact_hold(model.system)) is DEFAULT_POLICY


def test_a_nonlinear_model_has_no_series():
    with pytest.raises(ModelError, match="linear in the states"):
        taylor(make_chain(8, hardening=True).system, 10)
