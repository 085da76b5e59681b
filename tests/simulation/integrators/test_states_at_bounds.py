"""States that reach their bounds: a tank that runs empty, or over, stays there until the flows turn; slopes are forgotten on the way."""

import math

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.simulation.integrators.esdirk import esdirk
from greybox.simulation.kernel.adaptive import AdaptiveKernel
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.record import Record
from greybox.simulation.records import to_experiments

PERIOD, ROWS = 5.0, 360
TRUE = {"a1": 3.2e-5, "a2": 2.6e-5, "kp": 1.25e-4}


def outflow(p, hole, level):
    return hole * ca.sqrt(2 * p.g * level)


TANKS = Model(
    "tanks",
    [State("h1", "m", 0.05, (0.0, math.inf)), State("h2", "m", 0.05, (0.0, math.inf))],
    [Input("u", "1")],
    [Output("h2", "m")],
    [
        Parameter("A1", "m^2", 0.0120, fixed=True),
        Parameter("A2", "m^2", 0.0165, fixed=True),
        Parameter("a1", "m^2", TRUE["a1"], (1e-7, 1e-2)),
        Parameter("a2", "m^2", TRUE["a2"], (1e-7, 1e-2)),
        Parameter("kp", "m^3/s", TRUE["kp"], (1e-8, 1e-1)),
        Parameter("g", "m/s^2", 9.81, fixed=True),
    ],
    lambda x, u, p: [
        Balance("upper", "m^3/s", p.A1, "h1", pump=p.kp * u.u, outflow=-outflow(p, p.a1, x.h1)),
        Balance("lower", "m^3/s", p.A2, "h2", inflow=outflow(p, p.a1, x.h1), outflow=-outflow(p, p.a2, x.h2)),
    ],
)


def pump():
    """A schedule under which both tanks run empty and fill again."""
    return np.repeat([0.3, 0.0, 0.0, 0.4, 0.2, 0.0, 0.0, 0.15, 0.3], ROWS // 9)


def levels(u, a1, a2, kp, substeps=400):
    """Both levels by small explicit steps that stop at the bottom (ROWS, 2)."""
    h, rows, length = np.array([0.05, 0.05]), [], PERIOD / substeps
    for drive in u:
        rows.append(h)
        for _ in range(substeps):
            first, second = a1 * math.sqrt(2 * 9.81 * h[0]), a2 * math.sqrt(2 * 9.81 * h[1])
            h = np.maximum(h + length * np.array([(kp * drive - first) / 0.0120, (first - second) / 0.0165]), 0.0)
    return np.array(rows)


@pytest.fixture(scope="module")
def run_dry():
    u = pump()
    return u, levels(u, **TRUE)


def test_a_tank_that_has_run_empty_stays_empty_and_fills_at_once(run_dry):
    u, true = run_dry
    run = gb.simulate(TANKS, {"time": PERIOD * np.arange(ROWS), "u": u})
    for k, name in enumerate(("h1", "h2")):
        assert 0.0 <= run.states[name].min() < 1e-6
        assert run.states[name] == pytest.approx(true[:, k], abs=2e-4)


def test_slopes_along_constants_go_through_an_empty_tank(run_dry):
    """The slope of a root is infinite where the tank is empty: carried on it overflowed, and constants counted as not determined."""
    u, true = run_dry
    record = Experiment.from_arrays(PERIOD * np.arange(ROWS), {"u": u}, {"h2": true[:, 1]}, name="dry")
    problem = prepare_problem(TANKS, to_experiments((record,)), {"h2": 1.0}, FitOptions(at_rest=True, substeps=16))
    ((_, slopes),) = problem.shooting().residuals(problem.variables.here)
    later = true[:, 1] > 0.01
    for k, name in enumerate(TRUE):
        step = 1e-3 * TRUE[name]
        ends = [levels(u, **{**TRUE, name: TRUE[name] + way * step}, substeps=150)[:, 1] for way in (1, -1)]
        # Unknowns are counted in their own spans: what is compared is the shape of the slope and its size.
        expected = (ends[0] - ends[1]) / (2 * step) * problem.variables.spans[k]
        seen = slopes[:, 0, k]
        scale = float(seen[later] @ expected[later]) / float(expected[later] @ expected[later])
        assert abs(abs(scale) - 1) < 0.05, (name, scale)
        assert np.linalg.norm(seen[later] - scale * expected[later]) < 0.1 * np.linalg.norm(seen[later])


def test_a_fit_to_a_tank_that_ran_empty_finds_its_constants(run_dry):
    u, true = run_dry
    read = true[:, 1] + 1e-3 * np.random.default_rng(1).normal(size=ROWS)
    record = Experiment.from_arrays(PERIOD * np.arange(ROWS), {"u": u}, {"h2": read}, name="dry")
    fit = gb.fit(TANKS.start(a1=4e-5, a2=2e-5, kp=1e-4), record, noise={"h2": 1e-3})
    for name, value in TRUE.items():
        estimate = fit.parameters[name]
        assert abs(estimate.value - value) < 4 * estimate.std < 0.2 * value, name


def test_a_vessel_with_a_full_wall_and_a_constant_draw_keeps_between_both():
    """Level between 0 and 0.2 m under a flow that turns: straight lines with corners, by hand."""
    vessel = Model(
        "vessel",
        [State("h", "m", 0.1, (0.0, 0.2))],
        [Input("q", "m^3/s")],
        [Output("h", "m")],
        [Parameter("A", "m^2", 1.0, (0.1, 10.0))],
        lambda x, u, p: [Balance("level", "m^3/s", p.A, "h", flow=u.q)],
    )
    flow = np.repeat([0.05, -0.05, 0.05], 8)
    run = gb.simulate(vessel, {"time": np.arange(24.0), "q": flow})
    expected = [0.1]
    for q in flow[:-1]:
        expected.append(min(max(expected[-1] + q, 0.0), 0.2))
    assert run.states["h"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.rest  # compiles a kernel of its own
def test_steps_that_follow_the_error_stop_at_bounds_too_compiled_or_not(run_dry):
    u, true = (each[20:140] for each in run_dry)
    steps = np.full(len(u) - 1, PERIOD)
    record = Record(u[:, None], true[:, 1:], steps, np.zeros(len(steps)), np.unique(steps))
    p, x0 = np.array(list(TANKS.values.values())), true[0]
    point = KernelPoint(p[None], np.diag(p)[None], p, np.diag(p), x0, np.zeros((2, len(p))))
    seen = []
    for is_compiled in (True, False):
        kernel = AdaptiveKernel(esdirk(TANKS.system))
        kernel.is_compiled = is_compiled
        seen.append([*kernel.simulate(record, p[None], p, x0), *kernel.residuals(record, point, np.ones(1))])
    for compiled, by_numpy in zip(*seen, strict=True):
        assert compiled == pytest.approx(by_numpy, rel=1e-6, abs=1e-8 * np.abs(by_numpy).max())
    levels_, slopes = seen[0][1], seen[0][3]
    assert 0 <= levels_.min() < 1e-6 and levels_ == pytest.approx(true, abs=2e-4)
    assert np.isfinite(slopes).all()
