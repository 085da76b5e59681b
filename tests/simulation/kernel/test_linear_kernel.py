"""Large linear models by products of matrices: the same as the other kernels, finite differences and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, expm_frechet
from scipy.optimize import least_squares
from scipy.signal import cont2discrete

import greybox as gb
from fits.benchmarks.chains import NOISE, STEP, make_chain, make_trial
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.input_delay import require_history
from greybox.simulation.integrators.step import MANY_STATES
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.interpreted import InterpretedKernel
from greybox.simulation.kernel.linear import LinearKernel
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record


def values(model):
    return np.array(list(model.values.values()))


def matrices(k, c, m):
    """``A`` and ``B`` of the chain by hand."""
    n = len(k)
    a, b = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    for i in range(n):
        x, v = 2 * i, 2 * i + 1
        a[x, v] = 1
        a[v, v] = -c / m
        a[v, x] -= k[i] / m
        if i:
            a[v, x - 2] += k[i] / m
        if i + 1 < n:
            a[v, x] -= k[i + 1] / m
            a[v, x + 2] += k[i + 1] / m
    b[-1] = 1 / m
    return a, b


@pytest.mark.parametrize(("bodies", "h"), [(4, 0.005), (10, 0.005), (10, 0.05), (30, 0.2)])
def test_coefficients_and_slopes_are_scipys(bodies, h):
    model = make_chain(bodies)
    step, p, nx = exact_hold(model.system), values(model), 2 * bodies
    which = np.array([0, bodies // 2, bodies])  # two springs, and the damping of all bodies
    q, dq = step.coefficients(p, np.array([h]), which)

    def augmented(a, b, ramp):
        m = np.zeros((nx + 4, nx + 4))
        m[:nx, :nx], m[:nx, nx] = a * h, b * h
        m[nx : nx + 2, nx + 2 :] = np.eye(2) * ramp
        return m

    k, c, m = p[:bodies], p[bodies], p[bodies + 1]
    whole = augmented(*matrices(k, c, m), 1)
    # In units in which positions and speeds are of like size scipy keeps all digits.
    unit = np.concatenate([np.tile([1.0, np.sqrt(k.max())], bodies), np.ones(4)])
    whole = whole / unit[:, None] * unit
    ours = q[0].reshape(-1, nx).T / unit[:nx, None] * unit[: nx + 3]
    np.testing.assert_allclose(ours, expm(whole)[:nx, : nx + 3], rtol=0, atol=1e-13)
    for j, parameter in enumerate(which):
        ends = []
        for sign in (1, -1):  # the generator is linear in stiffness and damping
            changed = p.copy()
            changed[parameter] += sign
            ends.append(augmented(*matrices(changed[:bodies], changed[bodies], m), 1))
        along = (ends[0] - ends[1]) / 2 / unit[:, None] * unit
        slope = expm_frechet(whole, along, compute_expm=False)[:nx, : nx + 3]
        ours = dq[0, :, j].reshape(-1, nx).T / unit[:nx, None] * unit[: nx + 3]
        np.testing.assert_allclose(ours, slope, rtol=0, atol=1e-12 * np.abs(slope).max())


def lengthy_record(model, rng, rows=300, first_order=True):
    """Uneven intervals of three lengths, gaps, and an input that is linear between samples or held."""
    lengths = np.array([0.003, 0.005, 0.02])
    row = rng.integers(0, 3, rows - 1)
    y = rng.normal(0, 1e-3, (rows, len(model.outputs)))
    y[rng.random(y.shape) < 0.2] = np.nan
    return Record(rng.normal(0, 10, (rows, 1)), y, lengths[row], row, lengths, first_order)


@pytest.mark.parametrize("first_order", [True, False])
def test_it_agrees_with_the_virtual_machine_on_uneven_records_with_gaps(first_order):
    rng, model = np.random.default_rng(3), make_chain(9)
    step, p, record = exact_hold(model.system), values(model), lengthy_record(model, rng, first_order=first_order)
    directions = 5
    dp = rng.normal(0, 1, (len(p), directions)) * p[:, None]
    dp[:, 3] = 0  # only the first state moves
    x0, dx0 = rng.normal(0, 1e-3, 18), rng.normal(0, 1e-3, (18, directions))
    weight = rng.uniform(1e3, 1e5, 9)
    results = []
    for kernel in (LinearKernel(step), InterpretedKernel(step)):
        q, dq = kernel.coefficients(record, p, dp)
        sums = kernel.sums(record, KernelPoint(q, dq, p, dp, x0, dx0), weight, 250)
        residuals = kernel.residuals(record, KernelPoint(q, dq, p, dp, x0, dx0), weight)
        results.append((sums, residuals, kernel.simulate(record, q, p, x0)))
    (sums, (r, j), (y, x)), (sums2, (r2, j2), (y2, x2)) = results
    assert sums.cost == pytest.approx(sums2.cost, rel=1e-11)
    assert np.array_equal(sums.counts, sums2.counts)
    np.testing.assert_allclose(sums.gradient, sums2.gradient, rtol=1e-9)
    np.testing.assert_allclose(sums.gauss_newton, sums2.gauss_newton, rtol=1e-9, atol=1e-11 * sums2.gauss_newton.max())
    for ours, theirs in ((r, r2), (j, j2), (y, y2), (x, x2)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * np.nanmax(np.abs(theirs)))


def test_outputs_that_depend_on_constants_and_inputs_have_their_slopes():
    chain = make_chain(8)
    # A sensor with a gain of its own beside the input, and a reading that sums the bodies.
    outputs = [
        gb.Output("seen", "m", lambda x, u, p: p.gain * x.x7 + u.F / p.k7),
        gb.Output("mean", "m", lambda x, u, p: sum(x[f"x{i}"] for i in range(8)) / 8),
    ]
    model = replace(chain, outputs=outputs, parameters=[*chain.parameters, gb.Parameter("gain", "", 1.1)])
    step, p, rng = exact_hold(model.system), values(model), np.random.default_rng(5)
    record = lengthy_record(model, rng)
    kernel, dp = LinearKernel(step), np.diag(p)
    x0, dx0 = rng.normal(0, 1e-3, 16), np.zeros((16, len(p)))
    q, dq = kernel.coefficients(record, p, dp)
    _, jacobian = kernel.residuals(record, KernelPoint(q, dq, p, dp, x0, dx0), np.ones(2))

    def run(p):
        return kernel.simulate(record, step.coefficients(p, record.lengths, np.empty(0, int))[0], p, x0)[0]

    for k in range(len(p)):
        move = 1e-6 * dp[:, k]
        difference = -(run(p + move) - run(p - move)) / 2e-6
        seen = np.isfinite(jacobian[:, :, k])
        assert np.array_equal(seen, np.isfinite(record.y))
        scale = np.abs(difference).max()
        assert np.abs(jacobian[:, :, k] - difference)[seen].max() <= 2e-7 * scale


def test_a_delayed_input_is_stepped_alike():
    model = make_chain(8) + gb.effect("transport_delay")
    lengths = np.array([STEP])
    step, p = exact_hold(model.system, require_history(model.system, lengths)), values(model)
    rng = np.random.default_rng(7)
    given = Record(rng.normal(0, 10, (200, 1)), np.zeros((200, 8)), np.full(199, STEP), np.zeros(199), lengths)
    record, dp = given.read_by(step), np.diag(p)
    found = []
    for kernel in (LinearKernel(step), InterpretedKernel(step)):
        q, dq = kernel.coefficients(record, p, dp)
        found.append(kernel.sums(record, KernelPoint(q, dq, p, dp, np.zeros(16), np.zeros((16, len(p)))), np.ones(8)))
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-11)
    np.testing.assert_allclose(found[0].gradient, found[1].gradient, rtol=1e-8, atol=1e-12 * found[1].cost)


def test_a_run_that_overflows_says_where():
    model = make_chain(8)
    step, p = exact_hold(model.system), values(model)
    p[8] = -1e7  # damping that drives
    record = Record(np.ones((50, 1)), np.zeros((50, 8)), np.full(49, STEP), np.zeros(49), np.array([STEP]))
    found = []
    for kernel in (LinearKernel(step), InterpretedKernel(step)):
        with np.errstate(all="ignore"):
            q, dq = kernel.coefficients(record, p, np.diag(p))
        found.append(
            kernel.sums(record, KernelPoint(q, dq, p, np.diag(p), np.ones(16), np.zeros((16, len(p)))), np.ones(8))
        )
    assert found[0].cost == found[1].cost == np.inf
    assert found[0].failed_at == found[1].failed_at


def test_the_kernel_is_chosen_by_the_number_of_states():
    few, many = (exact_hold(make_chain(n).system) for n in (MANY_STATES // 2 - 1, MANY_STATES // 2))
    assert not isinstance(make_kernel(few), LinearKernel)
    assert isinstance(make_kernel(many), LinearKernel)


def test_the_fit_is_that_of_an_independent_program():
    """Zero-order hold by `scipy.signal`, finite differences and `least_squares`."""
    bodies = 8
    trial = make_trial(bodies, rows=400)
    fit = trial.fit()
    names = [p.name for p in trial.truth.all_parameters if not p.fixed]
    y = np.column_stack([trial.record.outputs[f"x{i}"] for i in range(bodies)])
    force = trial.record.inputs["F"]

    def residuals(logs):
        z = np.exp(logs)
        a, b = matrices(z[:bodies], z[bodies], 1.0)
        phi, gamma, *_ = cont2discrete((a, b[:, None], np.eye(len(a)), np.zeros((len(a), 1))), STEP)
        x, found = np.zeros(len(a)), np.empty_like(y)
        for k in range(len(y)):
            found[k] = x[::2]
            x = phi @ x + gamma[:, 0] * force[k]
        return ((y - found) / NOISE).ravel()

    start = np.log([trial.truth.values[name] for name in names])
    theirs = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac)
    for name, log, deviation in zip(names, theirs.x, np.sqrt(np.diag(covariance)), strict=True):
        assert np.log(fit.parameters[name].value) == pytest.approx(log, abs=0.01 * deviation)
