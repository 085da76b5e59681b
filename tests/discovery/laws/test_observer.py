"""The observer's slopes are those of its innovations, and its first state is the one that all rows show."""

from dataclasses import replace

import numpy as np
import pytest

from greybox import Balance, Experiment, FitOptions, Model, Output, Parameter, State
from greybox.discovery.laws.observer import StateObserver, observe_records
from greybox.discovery.problem import DiscoveryProblem

NOISE = np.array([0.05])


def tank() -> Model:
    def balances(x, u, p):
        return [Balance("store", "1/s", 1, "x", leak=-p.a * x.x)]

    return Model(
        "tank",
        states=[State("x", "1", 2.0)],
        inputs=[],
        outputs=[Output("x", "1")],
        parameters=[Parameter("a", "1/s", 0.7, (0, 10))],
        balances=balances,
    )


@pytest.fixture(scope="module")
def watched():
    time = np.linspace(0, 4, 30)
    y = 2 * np.exp(-0.5 * time) + NOISE * np.random.default_rng(1).normal(size=len(time))
    problem = DiscoveryProblem(tank(), (Experiment("run", time, {}, {"x": y}),), {"x": NOISE[0]}, (), FitOptions())
    (record,) = observe_records(problem.prepare(problem.model), {}, ["x"], {}, 600)
    return StateObserver(problem.model, ["a"], [("store", "1/s")], 1), record


def test_slopes_along_the_first_state_are_those_of_the_innovations(watched):
    observer, record = watched
    run = observer.run(record, np.array([0.7]), NOISE, 0.3)
    moved = observer.run(replace(record, start=record.start + 0.1), np.array([0.7]), NOISE, 0.3)
    np.testing.assert_allclose(run.slopes[:, 0, 0], (moved.e - run.e)[:, 0] / 0.1, rtol=1e-9, atol=1e-12)


def test_a_signal_is_worth_what_it_adds_to_the_state(watched):
    """A signal of e^(-a t) adds t e^(-a t) to the state; without a correction the innovations fall by that over their deviation."""
    observer, record = watched
    free = replace(record, y=np.where(np.arange(len(record.y)) < len(record.y) - 1, np.nan, record.y.T).T)
    run = observer.run(free, np.array([0.7]), NOISE, 0.0)
    time = np.append(0, np.cumsum(record.h))
    slopes = run.slopes_of_signals(np.exp(-0.7 * time)[:, None], 0)
    # The deviation of the last innovation: that of the first state as it decays, and of the noise.
    deviation = np.hypot(record.spread[0] * np.exp(-0.7 * time[-1]), NOISE[0])
    assert slopes[-1, 0, 0] == pytest.approx(-time[-1] * np.exp(-0.7 * time[-1]) / deviation, rel=2e-3)
    assert not slopes[:-1].any()


def test_the_first_state_is_the_least_squares_estimate_without_process_noise(watched):
    observer, record = watched
    run = observer.run(record, np.array([0.7]), NOISE, 0.0)
    decay = np.exp(-0.7 * np.append(0, np.cumsum(record.h)))
    weight = np.append(decay / NOISE, 1 / record.spread)
    target = np.append(record.y[:, 0] / NOISE, record.start / record.spread)
    expected = (weight @ target) / (weight @ weight)
    assert run.smooth_start(record)[0] == pytest.approx(expected, rel=1e-4)
