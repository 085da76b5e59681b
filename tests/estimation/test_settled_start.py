"""Records that begin where the model has come to rest: against closed forms, and a solver of its own for what follows."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, simulate
from greybox.base.errors import ModelError
from greybox.estimation.transcription.preparation import prepare_problem

POSITIVE = (1e-3, 1e3)
TRUE = {"forth": 0.8, "back": 0.3, "make": 2.0, "lose": 0.15}
STD = {"c": 0.05, "b": 0.01}
TIME = np.linspace(0, 20, 60)
LEVELS = ((0.2, 1.5), (1.0, 0.1))


def receptor(**starts):
    """A switches to B and back, their sum is kept; B in pairs makes C."""
    return Model(
        "receptor",
        [State("a", "1", 1.0), State("b", "1"), State("c", "1")],
        [Input("u", "1")],
        [Output("c", "1"), Output("b", "1")],
        [Parameter(name, "1/s", starts.get(name, 1.0), POSITIVE) for name in TRUE],
        lambda x, u, p: [
            Balance("a", "1/s", 1, "a", forth=-p.forth * u.u * x.a, back=p.back * x.b),
            Balance("b", "1/s", 1, "b", forth=p.forth * u.u * x.a, back=-p.back * x.b),
            Balance("c", "1/s", 1, "c", made=p.make * x.b**2, lost=-p.lose * x.c),
        ],
    )


def resting(u, forth, back, make, lose):
    """``b = forth u / (forth u + back)`` of the sum of one, ``c = make b^2 / lose``."""
    b = forth * u / (forth * u + back)
    return [1 - b, b, make * b**2 / lose]


def run(before, level, constants):
    forth, back, make, lose = constants

    def rates(_, x):
        switched = forth * level * x[0] - back * x[1]
        return [-switched, switched, make * x[1] ** 2 - lose * x[2]]

    x0 = resting(before, *constants)
    x = solve_ivp(rates, (0, TIME[-1]), x0, "LSODA", TIME, rtol=1e-9, atol=1e-11).y
    return {"c": x[2], "b": x[1]}


def records():
    generator = np.random.default_rng(0)
    return [
        Experiment(
            f"from {before}",
            TIME,
            {"u": np.full(60, level)},
            {n: y + STD[n] * generator.normal(size=60) for n, y in run(before, level, TRUE.values()).items()},
            "zero",
            before={"u": np.array([before])},
        )
        for before, level in LEVELS
    ]


def test_constants_are_those_of_least_squares_over_runs_from_rest():
    measured = records()
    noise = {
        name: 1.2 * std for name, std in STD.items()
    }  # above what the residual shows: nothing widens the intervals
    found = fit(receptor(), measured, noise=noise, options=FitOptions(settled=True))

    def errors(z):
        runs = [run(before, level, np.exp(z)) for before, level in LEVELS]
        return np.concatenate(
            [(r.outputs[n] - y[n]) / noise[n] for r, y in zip(measured, runs, strict=True) for n in STD]
        )

    least = least_squares(errors, np.log(list(TRUE.values())), x_scale=0.1)
    assert [found.parameters[n].value for n in TRUE] == pytest.approx(np.exp(least.x), rel=1e-5)
    std = np.exp(least.x) * np.sqrt(np.diag(np.linalg.inv(least.jac.T @ least.jac)))
    assert [found.parameters[n].std for n in TRUE] == pytest.approx(std, rel=1e-3)


def test_slopes_of_the_start_are_those_of_differences():
    problem = prepare_problem(receptor(**TRUE), records(), STD, FitOptions(settled=True))
    variables = problem.variables
    at = variables.here
    for e in range(2):
        x0, slope = variables.compute_initial_state(at, variables.parameters(at, e), e)
        assert x0 == pytest.approx(resting(LEVELS[e][0], *TRUE.values()), rel=1e-6)
        for k, name in enumerate(TRUE):
            pair = [resting(LEVELS[e][0], *(TRUE | {name: TRUE[name] * np.exp(s)}).values()) for s in (1e-5, -1e-5)]
            assert slope[:, k] == pytest.approx((np.array(pair[0]) - pair[1]) / 2e-5, rel=1e-5, abs=1e-7)


def test_a_run_begins_at_rest_under_the_inputs_before_it():
    for record, (before, level) in zip(records(), LEVELS, strict=True):
        ran = simulate(receptor(**TRUE), record, settled=True)
        for name, y in run(before, level, TRUE.values()).items():
            assert ran.outputs[name] == pytest.approx(y, rel=1e-5, abs=1e-7)


def test_what_never_rests_is_refused():
    wheel = Model(
        "wheel",
        [State("angle", "rad"), State("speed", "rad/s")],
        [Input("torque", "1/s**2")],
        [Output("angle", "rad")],
        [Parameter("d", "1/s", 0.5, POSITIVE)],
        lambda x, u, p: [
            Balance("angle", "rad/s", 1, "angle", turn=x.speed),
            Balance("speed", "1/s**2", 1, "speed", drive=u.torque, drag=-p.d * x.speed),
        ],
    )
    turning = Experiment("turning", TIME, {"torque": np.ones(60)}, {"angle": TIME})
    with pytest.raises(ModelError, match="does not come to rest under its first inputs"):
        fit(wheel, turning, options=FitOptions(settled=True))
    with pytest.raises(ModelError, match="does not come to rest"):
        simulate(wheel, turning, settled=True)
    with pytest.raises(ModelError, match="settled: collocation"):
        FitOptions(settled=True, transcription="collocation-radau")


def test_an_input_that_arrives_late_has_arrived_where_a_model_rests():
    """A first-order lag behind a delay, from rest under an input of two: its step in closed form."""
    lag = Model(
        "lag",
        [State("y", "V", role="velocity")],
        [Input("u", "V", role="drive")],
        [Output("y", "V")],
        [Parameter("tau", "s", 2.0, POSITIVE), Parameter("k", "1", 1.0, POSITIVE)],
        lambda x, u, p: [Balance("lag", "V", p.tau, "y", drive=p.k * u.u, decay=-x.y)],
    )
    time = np.arange(200) * 0.05
    u = np.where(time < 1.0, 2.0, -1.0)
    late = np.maximum(time - 1.0 - 0.3, 0.0)
    y = 1.5 * (-1.0 + 3.0 * np.exp(-late / 0.8)) + 1e-3 * np.random.default_rng(3).normal(size=200)
    found = fit(
        lag + effect("transport_delay"),
        Experiment("step", time, {"u": u}, {"y": y}, "zero"),
        noise={"y": 1e-3},
        options=FitOptions(settled=True),
    )
    for name, true in {"tau": 0.8, "k": 1.5, "delay": 0.3}.items():
        assert abs(found.parameters[name].value - true) < 4 * found.parameters[name].std
    with pytest.raises(ModelError, match=r"dry friction .* leave settled out"):
        fit(lag + effect("coulomb_friction"), found.traces[0].experiment, options=FitOptions(settled=True))
