"""Where a model is fitted over arcs or segments, starts of its effects are judged by them: free runs of these plants leave the record."""

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, FitOptions, Input, Model, Output, Parameter, State
from greybox.estimation.noise_loop import StartCost
from greybox.estimation.starts import StartSearch, measure_fresh_effects
from greybox.estimation.transcription.preparation import prepare_problem

PERIOD, NOISE, DAMPING, WEIGHT = 0.02, 1e-3, 0.5, 25.0
FORCE, PHASE, PITCH = 1.5, 0.5, 0.25


def pendulum() -> Model:
    """A pendulum that stands on its tip."""
    return Model(
        "balanced",
        states=[State("q", "rad", role="displacement"), State("w", "rad/s", role="velocity")],
        inputs=[Input("u", "N*m")],
        outputs=[Output("q", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 1.0, fixed=True),
            Parameter("g", "N*m", 20.0, (1.0, 200.0)),
            Parameter("b", "N*m*s/rad", 1.0, (1e-3, 10.0)),
        ],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "q", w=x.w),
            Balance("torque", "N*m", p.J, "w", drive=u.u, weight=p.g * ca.sin(x.q), damping=-p.b * x.w),
        ],
    )


@pytest.fixture(scope="module")
def balanced() -> gb.Experiment:
    """It is held by a controller, and its motor cogs; Runge-Kutta steps of 1 ms."""

    def rate(z: np.ndarray, u: float) -> np.ndarray:
        cogging = FORCE * np.sin(2 * np.pi * z[0] / PITCH + PHASE)
        return np.array([z[1], u + WEIGHT * np.sin(z[0]) - DAMPING * z[1] - cogging])

    time, z, rows, h = PERIOD * np.arange(500), np.zeros(2), [], PERIOD / 20
    for t in time.tolist():
        target = 0.5 * np.sin(1.3 * t) + 0.35 * np.sin(3.1 * t)
        u = -90 * (z[0] - target) - 12 * z[1]
        rows.append((z[0], u))
        for _ in range(20):
            k1 = rate(z, u)
            k2 = rate(z + h / 2 * k1, u)
            k3 = rate(z + h / 2 * k2, u)
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3, u))
    q, u = np.transpose(rows)
    noisy = q + NOISE * np.random.default_rng(1).normal(size=len(q))
    return gb.Experiment("held", time, {"u": u}, {"q": noisy})


def test_effects_are_measured_on_the_run_that_was_fitted(balanced: gb.Experiment) -> None:
    options = FitOptions(arc_length=0.4)
    problem = prepare_problem(pendulum() + gb.effect("cogging"), balanced, {"q": NOISE}, options)
    fresh = measure_fresh_effects(StartSearch(problem, balanced, options))
    assert fresh is not None
    assert fresh.scales.displacement == pytest.approx(np.abs(balanced.outputs["q"]).max(), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(FitOptions(arc_length=0.4), id="arcs"),
        pytest.param(FitOptions(), id="automatic"),
    ],
)
def test_cogging_of_a_pendulum_on_its_tip_is_found(balanced: gb.Experiment, options: FitOptions) -> None:
    found = gb.fit(pendulum() + gb.effect("cogging"), balanced, noise={"q": NOISE}, options=options)
    assert found.solver.statistics["transcription"] == ("arcs" if options.arc_length else "multiple")
    truth = {"g": WEIGHT, "b": DAMPING, "pitch": PITCH, "F": -FORCE * np.cos(PHASE), "Fq": -FORCE * np.sin(PHASE)}
    for name, value in truth.items():
        assert found.parameters[name].value == pytest.approx(value, abs=5 * found.parameters[name].std), name


@pytest.mark.parametrize("known", [False, True], ids=["squares", "prior"])
def test_a_start_costs_what_its_arcs_leave(known: bool) -> None:
    """Of ``x' = a x + b u`` with a held input each arc is a straight line in its first state: numpy solves it."""
    rate, gain, rows, each = 30.0, 10.0, 600, 10
    growth = np.exp(rate * PERIOD)
    rng = np.random.default_rng(3)
    u, x = rng.normal(size=rows), rng.normal(size=rows)
    model = Model(
        "levitated",
        states=[State("x", "m")],
        inputs=[Input("u", "V")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("a", "1/s", rate, (1.0, 100.0)), Parameter("b", "m/(V*s)", gain, (0.1, 100.0))],
        balances=lambda x, u, p: [Balance("motion", "m/s", 1, "x", field=p.a * x.x, coil=p.b * u.u)],
    )
    model = model.prior(a=(20.0, 5.0)).start(a=rate) if known else model
    options = FitOptions(arc_length=each * PERIOD)
    record = gb.Experiment("noise", PERIOD * np.arange(rows), {"u": u}, {"x": x})
    problem = prepare_problem(model, record, {"x": 0.1}, options)
    expected = (20.0 - rate) ** 2 / 5.0**2 if known else 0.0
    for first in range(0, rows, each):
        forced = np.zeros(each)
        for k in range(1, each):
            forced[k] = growth * forced[k - 1] + (growth - 1) / rate * gain * u[first + k - 1]
        errors, free = x[first : first + each] - forced, growth ** np.arange(each)
        expected += np.sum((errors - free * (free @ errors) / (free @ free)) ** 2) / 0.1**2
    starts = StartCost(problem, options)
    away = problem.variables.with_values({"a": 2 * rate, "b": 0.5 * gain})
    # From where another start left the first states it costs the same.
    for variables in (problem.variables, away, problem.variables):
        evaluation, _ = starts.evaluate(variables)
    assert evaluation.cost == pytest.approx(expected, rel=1e-6)
