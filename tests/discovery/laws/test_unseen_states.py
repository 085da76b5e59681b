"""A state without a sensor: which ones those are, and a law in one."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.discovery.laws.screening import list_law_sites, list_unseen_states

NOISE = 0.007
TIME = np.linspace(0, 14, 201)


def double_well(measured: str, rate: float = 1.0) -> Model:
    """A body between two wells without the spring that hardens; constants a fifth off."""

    def balances(x, u, p):
        return [
            Balance("position", "1/s", 1, "x", velocity=p.rate * x.v),
            Balance("force", "1/s", 1, "v", damping=-p.b * x.v, spring=p.k * x.x),
        ]

    return Model(
        "double_well",
        states=[State("x", "1", 1.7), State("v", "1", 0.2)],
        inputs=[],
        outputs=[Output(measured, "1")],
        parameters=[
            Parameter("b", "1/s", 0.25, (1e-3, 10)),
            Parameter("k", "1/s", 0.8, (1e-3, 10)),
            Parameter("rate", "1/s", rate, fixed=True),
        ],
        balances=balances,
    )


def record(name: str, start: tuple[float, float], seed: int) -> Experiment:
    run = solve_ivp(
        lambda t, z: [z[1], -0.2 * z[1] + z[0] - 0.8 * z[0] ** 3],
        (0, TIME[-1]),
        start,
        method="DOP853",
        t_eval=TIME,
        rtol=1e-9,
        atol=1e-9,
    )
    return Experiment(name, TIME, {}, {"v": run.y[1] + NOISE * np.random.default_rng(seed).normal(size=len(TIME))})


def test_the_rate_of_a_measured_state_is_seen_and_its_integral_is_not():
    assert list_unseen_states(double_well("x")) == []
    assert list_unseen_states(double_well("v")) == ["x"]


def test_nothing_is_looked_for_in_a_definition():
    assert list_law_sites(double_well("x")) == [("force", "1/s")]
    assert ("position", "1/s") in list_law_sites(double_well("x", rate=2.0))


@pytest.mark.slow
def test_a_law_in_a_position_that_no_sensor_reads():
    answer = gb.discover(
        double_well("v"),
        record("one", (1.7, 0.2), 1),
        validation=record("two", (-0.4, 1.1), 2),
        noise={"v": NOISE},
        effects=(),
        laws=True,
        workers=1,
    )
    assert answer.verdict == "named"
    (law,) = answer.effects
    assert law["formula"] == "k*x**3" and law["site"] == "force"
    assert law["parameters"]["k"]["value"] == pytest.approx(-0.8, rel=0.05)
