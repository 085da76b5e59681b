"""Transport delay in fractions of a sample, against scipy's solvers on the shifted input, and its slopes."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from greybox import Effect, Model, Output, Parameter
from greybox.base.errors import ModelError, UnitError
from greybox.model.effects.catalogue import effect
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.integrators.exact_hold import exact_hold
from greybox.simulation.integrators.step import InputHistory
from greybox.simulation.kernel.record import Record
from models.micro_actuator import micro_actuator
from tests.support.stepping import KERNELS, delay, differences, orders, path, record, slopes, stribeck, values

T, ROWS = 2.5e-4, 40
DELAYS = (0.0, 0.3, 1.0, 1.7, 3.25)
LATE = micro_actuator + delay()
CUBIC = (micro_actuator + effect("cubic_stiffness") + delay()).start(K3=5e10)
INPUT = np.random.default_rng(0).normal(0, 3, ROWS)


def at_delay(model, intervals):
    return model.start(delay=intervals * T)


def runs_exactly(model, time, u, delays, first_order):
    """States at the rows of a linear plant, by scipy's matrix exponential from one moment at which something arrives to the next."""
    f, p, n = model.system.rhs_function, values(model), model.system.x.numel()
    rate = lambda x, u: f(x, u, p).full().ravel()  # noqa: E731
    # dx/dt = A x + B (u + s t), with u and s as states of their own
    matrix = np.zeros((n + 2, n + 2))
    matrix[:n, :n] = np.column_stack([rate(e, 0.0) for e in np.eye(n)])
    matrix[:n, n], matrix[n, n + 1] = rate(np.zeros(n), 1.0), 1.0
    x = np.random.default_rng(1).normal(size=n)
    assert np.allclose(rate(x, 2.0), matrix[:n, :n] @ x + 2.0 * matrix[:n, n], rtol=1e-12)

    runs = []
    for seconds in delays:
        cuts, course = arrivals(time, u, seconds, first_order)
        steps = expm(matrix * np.diff(cuts)[:, None, None])
        x, found = np.zeros(n), {cuts[0]: np.zeros(n)}
        for step, a, b in zip(steps, cuts[:-1], cuts[1:], strict=True):
            begin, slope = course(a, (a + b) / 2)
            x = (step @ np.concatenate([x, [begin, slope]]))[:n]
            found[b] = x
        runs.append(np.array([found[t] for t in time]))
    return runs


def arrivals(time, u, seconds, first_order):
    """The moments at which something arrives, and the input at ``t`` with its slope in the piece around ``middle``."""
    # Before the record the input is what it is in its first row.
    edges = np.append(2 * time[0] - time[1], time) + seconds
    known = np.append(u[0], u)
    cuts = np.unique(np.concatenate([time, edges]))
    # Two moments of rounding apart are one.
    cuts = cuts[np.append(True, np.diff(cuts) > 1e-13) | np.isin(cuts, time)]
    cuts = cuts[(cuts >= 0) & (cuts <= time[-1])]

    def course(t, middle):
        k = np.searchsorted(edges, middle) - 1
        if k < 0:
            return u[0], 0.0
        slope = first_order * (known[k + 1] - known[k]) / (edges[k + 1] - edges[k]) if k + 1 < len(edges) else 0.0
        return known[k] + slope * (t - edges[k]), slope

    return cuts, course


@cache
def runs_with_a_cubic_spring():
    """States at the rows for each delay and hold, by scipy's solver; all of them as columns of one problem."""
    model, rows = at_delay(CUBIC, 0.0), np.arange(ROWS) * T
    f, p, cases = model.system.rhs_function, values(model), [(d, h) for d in DELAYS for h in (False, True)]
    of_each = [arrivals(rows, INPUT, d * T, h) for d, h in cases]
    cuts = np.unique(np.round(np.concatenate([c for c, _ in of_each]), 13))
    x = np.zeros((model.system.x.numel(), len(cases)))
    found, size = {cuts[0]: x}, x.shape
    for a, b in pairwise(cuts):
        begin, slope = np.transpose([course(a, (a + b) / 2) for _, course in of_each])
        rate = lambda t, x, a=a, u=begin, s=slope: f(x.reshape(size), (u + s * (t - a))[None], p).full().ravel()  # noqa: E731
        x = solve_ivp(rate, (a, b), x.ravel(), method="DOP853", rtol=1e-9, atol=1e-12).y[:, -1].reshape(size)
        found[b] = x
    at_rows = np.array([found[min(found, key=lambda t, r=r: abs(t - r))] for r in rows])
    return {case: at_rows[:, :, k] for k, case in enumerate(cases)}


@pytest.mark.parametrize("first_order", [False, True], ids=["held", "linear"])
@pytest.mark.parametrize("intervals", DELAYS)
def test_the_exact_hold_shifts_the_input_exactly(intervals, first_order):
    model = at_delay(LATE, intervals)
    step = discretise(model.system, values(model), np.zeros((1, 3)), np.array([T]))
    assert (step.name, step.past) == ("exact hold", (0, 4, False))
    (exact,) = runs_exactly(model, np.arange(ROWS) * T, INPUT, [intervals * T], first_order)
    for kernel in KERNELS:
        _, found = path(step, record(INPUT, T, 2, first_order), values(model), np.zeros(3), kernel)
        assert np.all(np.abs(found - exact).max(axis=0) < 1e-7 * np.abs(exact).max(axis=0))


@pytest.mark.crossed(3)
@pytest.mark.parametrize("first_order", [False, True], ids=["held", "linear"])
@pytest.mark.parametrize("intervals", DELAYS)
def test_rk4_keeps_its_order_whatever_the_delay(intervals, first_order):
    model = at_delay(CUBIC, intervals)
    p, data = values(model), record(INPUT, T, 2, first_order)
    exact = runs_with_a_cubic_spring()[intervals, first_order]
    errors = []
    for n in (16, 32, 64):
        step = discretise(model.system, p, np.zeros((1, 3)), np.array([T]), substeps=n)
        errors.append(
            (np.abs(path(step, data, p, np.zeros(3))[1] - exact).max(axis=0) / np.abs(exact).max(axis=0)).max()
        )
    assert orders(errors).min() > 3.5, errors
    assert errors[-1] < 1e-6
    odd = discretise(model.system, p, np.zeros((1, 3)), np.array([T]), substeps=65)
    assert np.all(np.abs(path(odd, data, p, np.zeros(3))[1] - exact).max(axis=0) < 1e-6 * np.abs(exact).max(axis=0))


@pytest.mark.crossed(3)
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("method", "first_order"), [("exact", False), ("exact", True), ("rk4", False)])
@pytest.mark.parametrize("intervals", [0.3, 1.7, 3.25])
def test_the_slope_along_the_delay_is_that_of_finite_differences(intervals, method, first_order, kernel):
    model = at_delay(LATE, intervals)
    p, data = values(model), record(INPUT, T, 2, first_order)
    step = discretise(model.system, p, np.zeros((1, 3)), np.array([T]), method=method)
    jacobian = slopes(step, data, p, np.zeros(3), kernel)
    for k in range(len(p)):
        difference = differences(step, data, p, np.zeros(3), k, relative=1e-5)
        assert np.allclose(jacobian[:, :, k], difference, rtol=1e-4, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_the_answer_is_continuous_where_the_delay_passes_a_whole_sample(method):
    p = values(LATE)
    step = discretise(LATE.system, p, np.zeros((1, 3)), np.array([T]), method=method)
    at = []
    for intervals in (1 - 1e-9, 1.0, 1 + 1e-9):
        p[-1] = intervals * T
        at.append(path(step, record(INPUT, T, 2), p, np.zeros(3))[1])
    for other in (at[0], at[2]):
        assert np.all(np.abs(other - at[1]).max(axis=0) < 1e-6 * np.abs(at[1]).max(axis=0))


def test_an_output_that_shows_the_input_shows_the_delayed_one():
    seen = (
        Model(
            micro_actuator.name,
            micro_actuator.states,
            micro_actuator.inputs,
            [Output("w", "V", lambda x, u, p: u.u)],
            micro_actuator.parameters,
            micro_actuator.balances,
        )
        + delay()
    )
    for method in ("exact", "rk4"):
        for intervals, expected in (
            (0.0, INPUT),
            (1.0, np.r_[INPUT[0], INPUT[:-1]]),
            (1.7, np.r_[INPUT[0], INPUT[0], INPUT[:-2]]),
        ):
            model = at_delay(seen, intervals)
            step = discretise(model.system, values(model), np.zeros((1, 3)), np.array([T]), method=method)
            assert np.array_equal(path(step, record(INPUT, T), values(model), np.zeros(3))[0][:, 0], expected)
    model = at_delay(seen, 1.7)
    line = path(
        exact_hold(model.system, InputHistory(0, 4)), record(INPUT, T, first_order=True), values(model), np.zeros(3)
    )[0][:, 0]
    assert np.allclose(line, np.interp(np.arange(ROWS) - 1.7, np.arange(ROWS), INPUT))


@pytest.mark.rest
def test_a_delay_goes_together_with_dry_friction_and_other_changes_of_the_input():
    """What acts on the input acts on the delayed one; the delayed record given as such is the same thing."""
    plain = micro_actuator + effect("input_offset") + stribeck(0.05, 0.08, 0.02)
    plain = plain.start(u0=0.4)
    late = at_delay(plain + delay(), 2.0)
    step = {m: discretise(m.system, values(m), np.zeros((1, 3)), np.array([T]), substeps=16) for m in (plain, late)}
    expected = path(step[plain], record(np.r_[INPUT[[0, 0]], INPUT[:-2]], T, 2), values(plain), np.zeros(3))[1]
    fine = discretise(plain.system, values(plain), np.zeros((1, 3)), np.array([T]), substeps=8)
    found = path(step[late], record(INPUT, T, 2), values(late), np.zeros(3))[1]
    # with a whole number of intervals all the way lies after the cut: half of the substeps cover the interval
    assert np.allclose(
        found,
        path(fine, record(np.r_[INPUT[[0, 0]], INPUT[:-2]], T, 2), values(plain), np.zeros(3))[1],
        rtol=1e-9,
        atol=1e-15,
    )
    assert np.abs(found - expected).max(axis=0)[0] < 1e-4 * np.abs(expected[:, 0]).max()


def test_a_kernel_repeats_a_delayed_step_with_other_substeps():
    model = at_delay(LATE, 1.7)
    p, data = values(model), record(INPUT, T, 2)
    coarse = discretise(model.system, p, np.zeros((1, 3)), np.array([T]), method="rk4", substeps=16)
    fine = discretise(model.system, p, np.zeros((1, 3)), np.array([T]), method="rk4", substeps=33)
    assert np.array_equal(
        path(replace(coarse, substeps=33), data, p, np.zeros(3))[1], path(fine, data, p, np.zeros(3))[1]
    )
    with pytest.raises(ModelError, match=r"cuts the interval in two; give at least 2 substeps"):
        replace(coarse, substeps=1)


def refused(changed):
    return changed.system


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (
            Effect("late", "input", [Parameter("delay", "s", 0.0)], delay=lambda x, u, p: p.delay),
            "runs from -inf to inf s; bound it",
        ),
        (
            Effect("late", "force", [Parameter("delay", "s", 0.0, (0, 1))], delay=lambda x, u, p: p.delay),
            "acts at inputs, and 'force' is a balance",
        ),
        (
            Effect("late", "input", [Parameter("c", "1/V", 0.0, (0, 1))], delay=lambda x, u, p: p.c * u.u),
            "changes with 'u'",
        ),
    ],
)
def test_delays_that_cannot_be_stepped_are_refused(bad, words):
    with pytest.raises(ModelError, match=words):
        refused(micro_actuator + bad)


def test_a_delay_is_in_seconds():
    with pytest.raises(UnitError, match=r"delay of input 'u': has unit m, expected s"):
        refused(micro_actuator + Effect("late", "input", [Parameter("d", "m", 0.0, (0, 1))], delay=lambda x, u, p: p.d))


def test_the_longest_delay_decides_how_much_of_the_past_is_kept():
    model = micro_actuator + delay(longest=250 * T)
    with pytest.raises(
        ModelError, match=r"250 intervals of 0.00025 s, more than 200; give its parameter an upper bound of 0.05 s"
    ):
        discretise(model.system, values(model), np.zeros((1, 3)), np.array([T]))
    short = model.fix(delay=2.5 * T)
    assert discretise(short.system, values(short), np.zeros((1, 3)), np.array([T])).past == (0, 3, False)


def uneven_record(jitter, hold, first_order=False, rows=300):
    """Stamps off an even grid by up to ``jitter`` of a step, and an input that moves every ``hold`` rows."""
    rng = np.random.default_rng(5)
    time = T * (np.arange(rows) + jitter * rng.uniform(-1, 1, rows))
    u = np.repeat(rng.normal(0, 3, rows // hold + 1), hold)[:rows, None]
    h = np.diff(time)
    lengths, row = np.unique(h, return_inverse=True)
    return time - time[0], Record(u, np.full((rows, 2), np.nan), h, row, lengths, first_order)


@pytest.mark.parametrize("first_order", [False, True], ids=["held", "linear"])
@pytest.mark.parametrize("intervals", [0.0, 0.3, 1.7, 3.25])
def test_an_input_arrives_late_at_uneven_stamps_too(intervals, first_order):
    model = at_delay(LATE, intervals)
    time, data = uneven_record(0.1, 7, first_order)
    exact, late = runs_exactly(model, time, data.u[:, 0], [intervals * T, (intervals + 0.01) * T], first_order)
    step = discretise(model.system, values(model), np.zeros((1, 3)), data.lengths, substeps=32)
    error, hundredth = (
        np.sqrt(np.mean((x - exact) ** 2, axis=0)) for x in (path(step, data, values(model), np.zeros(3))[1], late)
    )
    # Only an interval in which two rows arrive is not exact.
    assert np.all(error < hundredth)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("first_order", [False, True], ids=["held", "linear"])
def test_the_slope_along_the_delay_at_uneven_stamps_is_that_of_finite_differences(first_order, kernel):
    model = at_delay(LATE, 1.7)
    p, (_, data) = values(model), uneven_record(0.1, 1, first_order, rows=60)
    step = discretise(model.system, p, np.zeros((1, 3)), data.lengths)
    jacobian = slopes(step, data, p, np.zeros(3), kernel)
    difference = differences(step, data, p, np.zeros(3), len(p) - 1, relative=1e-6)
    assert np.allclose(jacobian[:, :, -1], difference, rtol=1e-3, atol=1e-5 * np.abs(difference).max())


def test_missing_rows_are_uneven_too():
    """An interval of two, in which two rows arrive: the plant takes in the mean of what comes after the first."""
    model = at_delay(LATE, 1.0)
    u = np.array([1.0, 2.0, 4.0, 8.0, 8.0])[:, None]
    uneven = Record(u, np.zeros((5, 2)), np.array([1, 1, 2, 1]) * T, np.array([0, 0, 1, 0]), np.array([1, 2]) * T)
    step = discretise(model.system, values(model), np.zeros((1, 3)), uneven.lengths)
    assert step.past == (0, 4, True)
    table = uneven.read_by(step).u
    assert np.allclose(table[3, 1:5], [4, 2, 1, 1]) and np.allclose(table[3, 5:9], [2, 3, 4, 5])
    assert np.allclose(table[2, 5:9], [0.5, 1.0, 1.5, 2.0])
    with pytest.raises(ModelError, match="the exact hold with a delayed input needs one sampling time"):
        discretise(model.system, values(model), np.zeros((1, 3)), uneven.lengths, method="exact")


def test_the_equations_show_the_delay():
    assert "u [V] delayed by delay" in str(LATE)
