"""Poles of known plants from their frequency responses, alone and together with a record, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.comparison.frequency.fit_response import fit_frequency_response
from greybox.comparison.frequency.response import FrequencyResponse
from greybox.data.experiment import Experiment

J1, J2, DAMPING, SHAFT, SLIP = 0.02, 0.05, 0.01, 40.0, 0.03
R1, R2, C1, C2 = 1e3, 4.7e3, 1e-6, 2.2e-6


def drive(x, u, p):
    twist, slip = x.q1 - x.q2, x.w1 - x.w2
    return [
        Balance("motor_angle", "rad/s", 1, "q1", speed=x.w1),
        Balance("motor", "N*m", p.J1, "w1", drive=u.T, shaft=-p.k * twist - p.c * slip, friction=-p.b * x.w1),
        Balance("load_angle", "rad/s", 1, "q2", speed=x.w2),
        Balance("load", "N*m", p.J2, "w2", shaft=p.k * twist + p.c * slip, friction=-p.b * x.w2),
    ]


TWO_MASSES = Model(
    "two_masses",
    states=[State("q1", "rad"), State("w1", "rad/s"), State("q2", "rad"), State("w2", "rad/s")],
    inputs=[Input("T", "N*m")],
    outputs=[Output("w1", "rad/s"), Output("w2", "rad/s")],
    parameters=[
        Parameter("J1", "kg*m^2/rad", J1, (1e-4, 1), fixed=True),
        Parameter("J2", "kg*m^2/rad", J2, (1e-4, 1)),
        Parameter("k", "N*m/rad", SHAFT, (1, 1e3)),
        Parameter("c", "N*m*s/rad", SLIP, (1e-4, 1)),
        Parameter("b", "N*m*s/rad", DAMPING, (1e-4, 1)),
    ],
    balances=drive,
)
LADDER = Model(
    "ladder",
    states=[State("v1", "V"), State("v2", "V")],
    inputs=[Input("u", "V")],
    outputs=[Output("v1", "V"), Output("v2", "V")],
    parameters=[
        Parameter("R1", "ohm", R1, (1, 1e6), fixed=True),
        Parameter("R2", "ohm", R2, (1, 1e6)),
        Parameter("C1", "F", C1, (1e-9, 1e-3)),
        Parameter("C2", "F", C2, (1e-9, 1e-3)),
    ],
    balances=lambda x, u, p: [
        Balance("node1", "A", p.C1, "v1", source=(u.u - x.v1) / p.R1, onward=-(x.v1 - x.v2) / p.R2),
        Balance("node2", "A", p.C2, "v2", onward=(x.v1 - x.v2) / p.R2),
    ],
)


def by_hand(name):
    """State space written out for scipy, and the band of interest in Hz."""
    if name == "two masses":
        k, c, b = SHAFT, SLIP, DAMPING
        A = [
            [0, 1, 0, 0],
            [-k / J1, -(c + b) / J1, k / J1, c / J1],
            [0, 0, 0, 1],
            [k / J2, c / J2, -k / J2, -(c + b) / J2],
        ]
        return np.array(A), np.array([[0], [1 / J1], [0], [0]]), np.eye(4)[[1, 3]], np.geomspace(0.5, 40, 40)
    A = np.array([[-1 / (R1 * C1) - 1 / (R2 * C1), 1 / (R2 * C1)], [1 / (R2 * C2), -1 / (R2 * C2)]])
    return A, np.array([[1 / (R1 * C1)], [0]]), np.eye(2), np.geomspace(1, 2e3, 40)


PLANTS = {
    "two masses": (TWO_MASSES, {"J2": 0.09, "k": 22.0, "c": 0.08, "b": 0.03}, "T"),
    "ladder": (LADDER, {"R2": 9e3, "C1": 3e-6, "C2": 1e-6}, "u"),
}


@pytest.mark.parametrize("together", [False, True], ids=["alone", "with a record"])
@pytest.mark.parametrize("name", PLANTS)
def test_poles_are_those_of_scipy(name, together):
    model, start, drive_name = PLANTS[name]
    A, B, C, frequency = by_hand(name)
    system = A, B, C, np.zeros((len(C), 1))
    numerators, denominator = signal.ss2tf(*system)
    exact = np.stack([signal.freqs(row, denominator, 2 * np.pi * frequency)[1] for row in numerators], axis=1)
    outputs = tuple(o.name for o in model.outputs)
    points = FrequencyResponse(frequency, exact[:, :, None], (drive_name,), outputs)
    records, noise = (), {}
    if together:
        step = 0.1 / frequency[-1]
        time = step * np.arange(400)
        u = np.sign(np.random.default_rng(2).standard_normal(40)).repeat(10)
        y = signal.lsim(system, u, time, interp=False)[1]
        records = Experiment("r", time, {drive_name: u}, {n: y[:, j] for j, n in enumerate(outputs)})
        noise = {n: 1e-3 * float(np.std(y[:, j])) for j, n in enumerate(outputs)}
    result = fit_frequency_response(model.start(**start), points, records, noise=noise)
    assert result.success
    fitted = gb.linearise(result.model).poles
    np.testing.assert_allclose(np.sort_complex(fitted), np.sort_complex(np.linalg.eigvals(A)), rtol=1e-6, atol=1e-6)


def test_the_operating_point_is_solved_once_where_nothing_that_moves_it_changed(monkeypatch):
    """A hardening spring under a load rests where K and the load say: mass and damper move nothing, and nothing moves a mass at rest."""
    from greybox.estimation.linear import operating_point

    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "x", speed=x.v),
            Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * (x.x + p.h * x.x**3), damper=-p.B * x.v),
        ]

    model = Model(
        "hardening",
        [State("x", "m"), State("v", "m/s")],
        [Input("F", "N")],
        [Output("x", "m")],
        [
            Parameter("M", "kg", 1.0, (0.1, 10)),
            Parameter("K", "N/m", 30.0, (1, 100)),
            Parameter("B", "N*s/m", 1.5, (0.1, 10)),
            Parameter("h", "1/m^2", 2.0, (0.1, 10)),
        ],
        balances,
    )
    solved = []
    original = operating_point.solve_operating_point
    monkeypatch.setattr(operating_point, "solve_operating_point", lambda *a: solved.append(a) or original(*a))
    frequency = np.geomspace(0.2, 4, 20)
    points = FrequencyResponse(frequency, np.ones((20, 1, 1), complex), ("F",), ("x",), name="r")
    for at, solutions in ((None, 1), ({"F": 12.0}, 3)):
        plant = gb.frequency.ResponsePlant.of(model, points, at)
        solved.clear()
        for changed in ({}, {"M": 1.1}, {"B": 1.6, "M": 1.2}, {"K": 31.0}, {"h": 2.1, "B": 1.4}):
            response = plant.respond(points, {**model.values, **changed})
            exact = gb.linearise(model.start(**changed), at).frequency_response(2 * np.pi * frequency)
            np.testing.assert_allclose(response, exact, rtol=1e-12)
        assert len(solved) == solutions
