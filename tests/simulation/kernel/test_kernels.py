"""Both kernels against plain numpy: simulation, sums, residuals, gaps, tables of coefficients, overflow, every
operation."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from greybox.base.errors import DataError, GreyboxError
from greybox.simulation.integrators.composition import as_coefficients
from greybox.simulation.integrators.step import Step
from greybox.simulation.kernel.gradual import GradualKernel, GradualPolicy
from greybox.simulation.kernel.interface import KernelPoint, check_sums
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record

KERNELS = ["compiled", "interpreted", "machine"]


@pytest.fixture(params=KERNELS)
def build(request, monkeypatch, tmp_path_factory):
    """Makes a kernel of either kind from a step."""
    if request.param == "machine":
        monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "machine"))
        return make_machine
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    monkeypatch.setenv("GREYBOX_KERNEL", request.param)

    def make(step):
        kernel = make_kernel(step)
        assert kernel.name == request.param
        return kernel

    return make


def make_machine(step):
    """The tape machine, which never earns a library."""
    never = GradualPolicy(earned_seconds=np.inf, translated_seconds=np.inf, long_pass_seconds=np.inf)
    return GradualKernel(step, None, pytest.fail, never)


def oscillator(x, u, p):
    """Mass with friction that changes its law with the direction: stiffness, damping, gain."""
    slow = ca.if_else(x[1] > 0, p[1] * x[1], ca.sqrt(1 + x[1] ** 2) - 1)
    return ca.vertcat(x[1], p[2] * u[0] + u[1] - slow - p[0] * ca.sin(x[0]))


def oscillator_numpy(x, u, p):
    slow = p[1] * x[1] if x[1] > 0 else np.sqrt(1 + x[1] ** 2) - 1
    return np.array([x[1], p[2] * u[0] + u[1] - slow - p[0] * np.sin(x[0])])


def rk4(rate, x, ua, ub, p, h):
    middle = (ua + ub) / 2
    k1 = rate(x, ua, p)
    k2 = rate(x + h / 2 * k1, middle, p)
    k3 = rate(x + h / 2 * k2, middle, p)
    k4 = rate(x + h * k3, ub, p)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def oscillator_step(substeps=2):
    x, ua, ub = ca.SX.sym("x", 2), ca.SX.sym("ua", 2), ca.SX.sym("ub", 2)
    p, h = ca.SX.sym("p", 3), ca.SX.sym("h")
    advance = ca.Function("advance", [x, ua, ub, p, h], [rk4(oscillator, x, ua, ub, p, h)])
    outputs = ca.Function("outputs", [x, ua, p], [ca.vertcat(x[0], p[2] * x[1] ** 2 + ua[1])])
    return Step("RK4", advance, outputs, lambda p, h: (p[None], np.eye(3)[None]), substeps)


P = np.array([4.0, 0.7, 1.5])
X0 = np.array([0.3, -0.2])


def numpy_simulation(record, table, p, x0, substeps=2):
    x, states, outputs = x0, [], []
    for k in range(len(record.y)):
        u0 = record.u[k]
        states.append(x)
        outputs.append([x[0], p[2] * x[1] ** 2 + u0[1]])
        if k < len(record.h):
            q = table[0] if len(table) == 1 else table[record.row[k]]
            slope = (record.u[k + 1] - u0) * record.is_linear
            for j in range(substeps):
                ua, ub = u0 + slope * j / substeps, u0 + slope * (j + 1) / substeps
                x = rk4(oscillator_numpy, x, ua, ub, q, record.h[k] / substeps)
    return np.array(outputs), np.array(states)


def oscillator_record(n=230, first_order=False, rows=1):
    rng = np.random.default_rng(3)
    h = np.array([0.02, 0.05, 0.03])[np.arange(n - 1) % 3]
    lengths = np.array([0.02, 0.05, 0.03])[:rows]
    row = np.arange(n - 1, dtype=np.int32) % rows
    return Record(rng.standard_normal((n, 2)), rng.standard_normal((n, 2)), h, row, lengths, first_order)


def with_gaps(record):
    y = record.y.copy()
    y[5:9, 0] = np.nan
    y[::3, 1] = np.nan
    return Record(record.u, y, record.h, record.row, record.lengths, record.is_linear)


@pytest.mark.parametrize("first_order", [False, True, (1.0, 0.0)], ids=["held", "linear", "the first linear"])
@pytest.mark.parametrize("rows", [1, 3])
def test_simulation_is_that_of_numpy(build, first_order, rows):
    record = oscillator_record(first_order=first_order, rows=rows)
    table = P * np.linspace(1, 1.2, rows)[:, None]
    y, x = build(oscillator_step()).simulate(record, table, P, X0)
    expected_y, expected_x = numpy_simulation(record, table, P, X0)
    np.testing.assert_allclose(x, expected_x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(y, expected_y, rtol=1e-10, atol=1e-12)


WEIGHT, DIFFERENCE = np.array([2.0, 0.5]), 1e-6


@cache
def differentiate_numpy(first_order, rows, directions):
    """A record, the point and the random directions through coefficients, parameters and first state at once; residuals and slopes there.

    The same for every kernel: it takes longer than all of them.
    """
    rng = np.random.default_rng(directions)
    record = with_gaps(oscillator_record(first_order=first_order, rows=rows))
    table = P * np.linspace(1, 1.2, rows)[:, None]
    dq, dp, dx0 = (rng.standard_normal((*shape, directions)) for shape in ((rows, 3), (3,), (2,)))
    y, _ = numpy_simulation(record, table, P, X0)
    slopes = np.empty((*y.shape, directions))
    for k in range(directions):
        ends = [
            numpy_simulation(record, table + e * dq[..., k], P + e * dp[:, k], X0 + e * dx0[:, k])[0]
            for e in (DIFFERENCE, -DIFFERENCE)
        ]
        slopes[:, :, k] = -(ends[0] - ends[1]) / (2 * DIFFERENCE) * WEIGHT
    slopes[np.isnan(record.y)] = np.nan
    return record, KernelPoint(table, dq, P, dp, X0, dx0), (record.y - y) * WEIGHT, slopes


@pytest.mark.parametrize("first_order", [False, True, (1.0, 0.0)], ids=["held", "linear", "the first linear"])
@pytest.mark.parametrize(("rows", "directions"), [(1, 3), (3, 6), (1, 11)])
def test_jacobian_is_that_of_finite_differences(build, first_order, rows, directions):
    record, point, expected, slopes = differentiate_numpy(first_order, rows, directions)
    r, jacobian = build(oscillator_step()).residuals(record, point, WEIGHT)
    np.testing.assert_allclose(r, expected, rtol=1e-9, atol=1e-11)
    for k in range(directions):
        slope = slopes[:, :, k]
        np.testing.assert_allclose(jacobian[:, :, k], slope, rtol=1e-6, atol=1e-7 * np.nanmax(np.abs(slope)))


@pytest.mark.parametrize("rows", [None, 1, 100, 137])
@pytest.mark.parametrize("directions", [1, 4, 7, 9])
def test_sums_are_those_of_the_residuals(build, rows, directions):
    rng = np.random.default_rng(7)
    record, weight = with_gaps(oscillator_record()), np.array([2.0, 0.5])
    dq, dp, dx0 = (rng.standard_normal((*shape, directions)) for shape in ((1, 3), (3,), (2,)))
    arguments = (record, KernelPoint(P[None], dq, P, dp, X0, dx0), weight)
    kernel = build(oscillator_step())
    r, jacobian = (a[:rows] for a in kernel.residuals(*arguments))
    sums = kernel.sums(*arguments, rows=rows)
    there = ~np.isnan(r)
    assert sums.failed_at is None
    np.testing.assert_allclose(sums.cost, np.nansum(r**2), rtol=1e-11)
    np.testing.assert_allclose(sums.squares, np.nansum(r**2, axis=0), rtol=1e-11)
    np.testing.assert_array_equal(sums.counts, there.sum(axis=0))
    gradient, matrix = jacobian[there].T @ r[there], jacobian[there].T @ jacobian[there]
    np.testing.assert_allclose(sums.gradient, gradient, rtol=1e-9, atol=1e-11 * np.abs(gradient).max())
    np.testing.assert_allclose(sums.gauss_newton, matrix, rtol=1e-9, atol=1e-11 * np.abs(matrix).max())


def test_gradient_is_half_the_slope_of_the_cost(build):
    record, weight = oscillator_record(), np.array([2.0, 0.5])
    kernel, none = build(oscillator_step()), np.zeros((2, 3))

    def cost(p):
        return kernel.sums(record, KernelPoint(p[None], np.eye(3)[None], p, np.eye(3), X0, none), weight).cost

    sums = kernel.sums(record, KernelPoint(P[None], np.eye(3)[None], P, np.eye(3), X0, none), weight)
    slope = [(cost(P + e) - cost(P - e)) / 2e-6 for e in 1e-6 * np.eye(3)]
    np.testing.assert_allclose(2 * sums.gradient, slope, rtol=1e-6)


def test_kernels_agree(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    record, weight = (
        with_gaps(oscillator_record(1350)),
        np.array([2.0, 0.5]),
    )  # more than one chunk of the interpreted kernel
    results = []
    for name in KERNELS[:2]:
        monkeypatch.setenv("GREYBOX_KERNEL", name)
        kernel = make_kernel(oscillator_step())
        results.append(
            kernel.sums(record, KernelPoint(P[None], np.eye(3)[None], P, np.eye(3), X0, np.zeros((2, 3))), weight)
        )
    for name in ("cost", "gradient", "gauss_newton", "squares"):
        np.testing.assert_allclose(getattr(results[0], name), getattr(results[1], name), rtol=1e-9)


@pytest.mark.parametrize("moved", [(0,), (0, 2), (1,), (0, 1, 2)])
def test_a_kernel_for_some_free_parameters_gives_what_one_for_all_does(monkeypatch, tmp_path_factory, moved):
    # (0, 2) are announced; other directions are served as well
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
    step = replace(oscillator_step(), coefficients=as_coefficients)
    record, weight = with_gaps(oscillator_record()), np.array([2.0, 0.5])
    dp = np.zeros((3, 5))
    dp[moved, : len(moved)] = np.eye(len(moved)) + 0.1
    dx0 = np.concatenate([np.zeros((2, 3)), np.eye(2)], axis=1)
    arguments = (record, KernelPoint(P[None], dp[None], P, dp, X0, dx0), weight)
    for name in ("sums", "residuals"):
        results = [getattr(make_kernel(step, free), name)(*arguments) for free in (None, (0, 2))]
        values = [(r.gradient, r.gauss_newton) if name == "sums" else r for r in results]
        for whole, some in zip(*values, strict=True):
            np.testing.assert_allclose(some, whole, rtol=1e-11, atol=1e-13 * np.nanmax(np.abs(whole)))


def growing_step():
    """x' = q x: passes 1e308 and overflows."""
    x, u, q, p, h = ca.SX.sym("x"), ca.SX.sym("u", 0), ca.SX.sym("q"), ca.SX.sym("p", 0), ca.SX.sym("h")
    advance = ca.Function("advance", [x, u, u, q, h], [q * x])
    return Step("growth", advance, ca.Function("outputs", [x, u, p], [x]), lambda p, h: (p[None], np.eye(1)[None]))


@pytest.mark.parametrize("n", [150, 2500])
def test_overflow_is_an_infinite_cost_and_its_place(build, n):
    record = Record(np.zeros((n, 0)), np.zeros((n, 1)), np.ones(n - 1), np.zeros(n - 1, np.int32), np.ones(1))
    q, none = np.array([[1e4]]), np.zeros((0, 1))
    kernel = build(growing_step())
    point = KernelPoint(q, np.ones((1, 1, 1)), np.zeros(0), none, np.ones(1), np.zeros((1, 1)))
    arguments = (record, point, np.array([1e-200]))
    sums = kernel.sums(*arguments)
    assert sums.failed_at == 78  # 1e4**78 = 1e312
    assert sums.cost == np.inf
    for rest in (sums.gradient, sums.gauss_newton, sums.squares, sums.counts):
        assert not rest.any()
    r, jacobian = kernel.residuals(*arguments)
    assert np.isfinite(r[:78]).all()
    assert np.isnan(r[78:]).all()
    assert np.isnan(jacobian[78:]).all()
    y, _ = kernel.simulate(record, q, np.zeros(0), np.ones(1))
    assert y.shape == (n, 1)
    assert y[77, 0] == pytest.approx(1e308)
    assert not np.isfinite(y[78:]).any()
    # before the overflow everything is well, but the square of the residual without the weight is too much
    assert kernel.sums(*arguments, rows=70).failed_at is None
    assert kernel.sums(*arguments[:-1], np.ones(1), rows=60).failed_at == 60


def test_nan_in_the_first_state_fails_at_once(build):
    record = oscillator_record(20)
    x0 = np.array([0.0, np.nan])
    sums = build(oscillator_step()).sums(
        record, KernelPoint(P[None], np.eye(3)[None], P, np.eye(3), x0, np.zeros((2, 3))), np.ones(2)
    )
    assert sums.failed_at == 0
    assert sums.cost == np.inf


def test_one_sample_and_no_direction(build):
    record = oscillator_record(1)
    empty = KernelPoint(P[None], np.zeros((1, 3, 0)), P, np.zeros((3, 0)), X0, np.zeros((2, 0)))
    sums = build(oscillator_step()).sums(record, empty, np.ones(2))
    expected = record.y[0] - [X0[0], P[2] * X0[1] ** 2 + record.u[0, 1]]
    assert sums.cost == pytest.approx(expected @ expected)
    assert sums.gradient.shape == (0,)
    assert sums.gauss_newton.shape == (0, 0)


def test_states_that_change_places(build):
    """An advance without arithmetic, and an output that is a plain number."""
    x, u, q, p, h = ca.SX.sym("x", 2), ca.SX.sym("u", 0), ca.SX.sym("q", 0), ca.SX.sym("p", 0), ca.SX.sym("h")
    advance = ca.Function("advance", [x, u, u, q, h], [ca.vertcat(x[1], x[0])])
    step = Step(
        "swap",
        advance,
        ca.Function("outputs", [x, u, p], [ca.vertcat(x[0], 3)]),
        lambda p, h: (p[None], np.eye(0)[None]),
        3,
    )
    record = Record(np.zeros((5, 0)), np.zeros((5, 2)), np.ones(4), np.zeros(4, np.int32), np.ones(1))
    kernel = build(step)
    y, _ = kernel.simulate(record, np.zeros((1, 0)), np.zeros(0), np.array([1.0, 2.0]))
    np.testing.assert_array_equal(y, [[1, 3], [2, 3], [1, 3], [2, 3], [1, 3]])
    rest = np.zeros((1, 0, 2)), np.zeros(0), np.zeros((0, 2)), np.array([1.0, 2.0]), np.eye(2)
    sums = kernel.sums(record, KernelPoint(np.zeros((1, 0)), *rest), np.ones(2))
    np.testing.assert_array_equal(sums.gauss_newton, [[3, 0], [0, 2]])
    np.testing.assert_array_equal(sums.gradient, [3, 4])


OPERATIONS = {
    "arithmetic": lambda a, b: a + b - a * b + a / b - (-a) + 2 * a + 1 / b + a / 3 + 4 / a,
    "powers": lambda a, b: a**b + a**2.5 + a**0.5 + a**3 + a**-1.5 + 2**a,
    "squares": lambda a, b: ca.sqrt(a) + b**2 + a * a,
    "exponentials": lambda a, b: ca.exp(a) + ca.log(b) + ca.expm1(a) + ca.log1p(b) + ca.log10(a),
    "circular": lambda a, b: ca.sin(a) + ca.cos(b) + ca.tan(a) + ca.atan(b),
    "inverse circular": lambda a, b: ca.asin(a / 9) + ca.acos(b / 9) + ca.atan2(a, b) + ca.atan2(-a, -b),
    "hyperbolic": lambda a, b: ca.sinh(a) + ca.cosh(b) + ca.tanh(a),
    "inverse hyperbolic": lambda a, b: ca.asinh(a) + ca.acosh(1 + b) + ca.atanh(a / 9),
    "error function": lambda a, b: ca.erf(a / b),
    "hypot": lambda a, b: ca.hypot(a, b),
    "kinks": lambda a, b: (
        ca.fabs(a - b) + ca.fmin(a, b) * 3 + ca.fmax(a, b) * 5 + ca.sign(a - b) * a + ca.copysign(a, b - a)
    ),
    "rounding": lambda a, b: ca.floor(a) * b + ca.ceil(b) * a + ca.fmod(a * 5, b) + ca.remainder(a * 5, b),
    "logic": lambda a, b: (
        ca.if_else(ca.logic_and(a < b, a <= b), a, b) + ca.if_else(ca.logic_or(a > b, a >= 1), a * b, a)
    ),
    "equality": lambda a, b: (
        ca.if_else(a == b, b, a * 3) + ca.if_else(a != b, b * a, a) + ca.if_else(ca.logic_not(a < b), a, b)
    ),
    "comparison as number": lambda a, b: (a < b) * a + ((a > b) + 2) * b,
}


def operation_step(operation):
    x, u, q, p, h = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("q"), ca.SX.sym("p"), ca.SX.sym("h")
    advance = ca.Function(
        "advance", [x, u, ca.SX.sym("ub"), q, h], [ca.vertcat(operation(x[0], x[1]), operation(x[0], q))]
    )
    return Step("operation", advance, ca.Function("outputs", [x, u, p], [x]), lambda p, h: (p[None], np.eye(1)[None]))


@pytest.mark.parametrize("point", [(0.6, 1.7), (1.3, 0.8)])
@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_and_its_slope(build, name, point):
    """Value by CasADi; slopes by finite differences of CasADi's values."""
    record = Record(np.zeros((2, 1)), np.zeros((2, 2)), np.ones(1), np.zeros(1, np.int32), np.ones(1))
    step = operation_step(OPERATIONS[name])
    x0, q = np.array(point), 1.1

    def value(x, q):
        return step.advance(x, 0, 0, q, 1).full().ravel()

    dx0, dq = np.array([[1.0, 0, 0], [0, 1, 0]]), np.array([[[0.0, 0, 1]]])
    dp = np.zeros((1, 3))
    r, jacobian = build(step).residuals(record, KernelPoint(np.array([[q]]), dq, np.zeros(1), dp, x0, dx0), np.ones(2))
    np.testing.assert_allclose(-r[1], value(x0, q), rtol=1e-13)
    e = 1e-6
    slopes = [
        (value(x0 + e * dx0[:, k], q + e * dq[0, 0, k]) - value(x0 - e * dx0[:, k], q - e * dq[0, 0, k])) / (2 * e)
        for k in range(3)
    ]
    np.testing.assert_allclose(-jacobian[1], np.transpose(slopes), rtol=2e-8, atol=1e-8)


HYGIENE = {
    "square root at zero": (lambda a, b: ca.sqrt(a) + b, 0.0, [0, 1]),
    "power below one at zero": (lambda a, b: a**0.3 + b, 0.0, [0, 1]),
    "power one half above at zero": (lambda a, b: a**1.5 + 2 * b, 0.0, [0, 2]),
    "absolute value at zero": (lambda a, b: ca.fabs(a) + b, 0.0, [0, 1]),
    "hypot at the origin": (lambda a, b: ca.hypot(a, a) + b, 0.0, [0, 1]),
    "branch not taken is infinite": (lambda a, b: ca.if_else(a > 0, ca.log(a), b), 0.0, [0, 1]),
    "branch not taken is not a number": (lambda a, b: ca.if_else(a > 0, ca.sqrt(a), 3 * b), -1.0, [0, 3]),
    "larger of a number and not a number": (lambda a, b: ca.fmax(ca.sqrt(a), b) + ca.fmax(b, ca.sqrt(a)), -1.0, [0, 2]),
    "negative base, whole exponent": (lambda a, b: a ** (b - b + 2), -3.0, [-6, 0]),
}


@pytest.mark.parametrize("name", HYGIENE)
def test_a_kink_or_a_branch_not_taken_spoils_nothing(build, name):
    operation, a, slope = HYGIENE[name]
    record = Record(np.zeros((2, 1)), np.zeros((2, 2)), np.ones(1), np.zeros(1, np.int32), np.ones(1))
    rest = np.zeros((1, 1, 2)), np.zeros(1), np.zeros((1, 2)), np.array([a, 0.5]), np.eye(2)
    step = operation_step(operation)
    inputs = step.advance.sx_in()
    first = ca.Function("advance", inputs, [step.advance.call(inputs)[0][[0, 0]]])
    single = Step("first", first, step.outputs, step.coefficients)
    r, jacobian = build(single).residuals(record, KernelPoint(np.ones((1, 1)), *rest), np.ones(2))
    assert np.isfinite(r).all()
    np.testing.assert_allclose(-jacobian[1, 0], slope, atol=1e-14)


def test_arrays_that_do_not_fit_are_refused(build):
    kernel, record = build(oscillator_step()), oscillator_record(rows=3)
    with pytest.raises(DataError, match=r"q has 2 rows for 3 interval lengths"):
        kernel.simulate(record, np.zeros((2, 3)), P, X0)
    with pytest.raises(DataError, match=r"x0 has shape \(3,\), the step needs \(2,\)"):
        kernel.simulate(record, P[None], P, np.zeros(3))
    with pytest.raises(DataError, match=r"2 inputs and 2 outputs, the step 0 and 1"):
        build(growing_step()).simulate(record, np.ones((1, 1)), np.zeros(0), np.ones(1))


def test_record_refuses_lengths_that_disagree():
    good = oscillator_record(6)
    with pytest.raises(DataError, match="one less than samples"):
        Record(good.u, good.y, good.h[1:], good.row, good.lengths)
    with pytest.raises(DataError, match="one row for each sample"):
        Record(good.u[1:], good.y, good.h, good.row, good.lengths)
    with pytest.raises(DataError, match="row runs from 0 to 7"):
        Record(good.u, good.y, good.h, good.row + np.array([0, 0, 0, 0, 7], np.int32), good.lengths)
    assert good.first(3).h.shape == (2,)


def test_unknown_kernel_is_refused(monkeypatch):
    monkeypatch.setenv("GREYBOX_KERNEL", "quantum")
    with pytest.raises(GreyboxError, match="GREYBOX_KERNEL=quantum"):
        make_kernel(oscillator_step())


def test_sums_that_overflow_only_together_are_no_warning_but_a_failure():
    for large in (np.full(2, 1e308), np.array([1e308, 0.0])):  # a cost and its slopes are twice the sums
        found = check_sums(large, np.ones(2, int), np.zeros(2), np.diag(large), None, 7)
        assert found.cost == np.inf and found.failed_at == 7
