"""Records that begin in motion, of a plant with dry friction whose first velocity is not measured."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State, effect, fit, simulate
from greybox.estimation.transcription.preparation import prepare_problem

NOISE = 1e-3
TRUTH = {"J": 1.5e-4, "b": 1.5e-4, "Fc": 0.015}


def drive() -> Model:
    """A DC drive of which the angle is measured, begun away from its constants."""
    return Model(
        "drive",
        states=[
            State("th", "rad", role="displacement"),
            State("w", "rad/s", role="velocity"),
            State("i", "A", role="current"),
        ],
        inputs=[Input("u", "V", role="drive")],
        outputs=[Output("th", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 1e-4, (1e-6, 1e-1), role="mass"),
            Parameter("b", "N*m*s", 2e-4, (1e-7, 1.0), role="damping"),
            Parameter("K", "N*m/A", 0.045, fixed=True, role="force_constant"),
            Parameter("R", "ohm", 1.2, fixed=True, role="resistance"),
            Parameter("L", "H", 8e-4, fixed=True, role="inductance"),
        ],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "th", rate=x.w),
            Balance("torque", "N*m", p.J, "w", motor=p.K * x.i, viscous=-p.b * x.w),
            Balance("voltage", "V", p.L, "i", source=u.u, resistance=-p.R * x.i, back_emf=-p.K * x.w),
        ],
    ) + effect("coulomb_friction")


@pytest.fixture(scope="module")
def records() -> list[Experiment]:
    """At rest first, then driven; cut into three, of which the later ones begin in motion."""
    t = np.arange(3000) * 1e-3
    levels = np.repeat(np.random.default_rng(3).choice([-20.0, -12.0, -6.0, 7.0, 13.0, 20.0], 20), 150)
    u = np.where(t < 0.3, 0.0, levels)
    true = drive().start(**TRUTH)
    run = simulate(true, {"time": t, "u": u}, initial={"th": 0.0, "w": 0.0, "i": 0.0})
    th = run.outputs["th"] + NOISE * np.random.default_rng(4).standard_normal(len(t))
    cuts = [slice(0, 1200), slice(1290, 2100), slice(2190, 3000)]
    return [Experiment(f"part {k}", t[c] - t[c][0], {"u": u[c]}, {"th": th[c]}) for k, c in enumerate(cuts)]


def test_a_search_that_stands_at_the_standstill_is_no_success(records):
    found = fit(drive().start(Fc=0.01), records, noise={"th": NOISE}, options=FitOptions(other_starts=0))
    assert not found.success or found.misfit["th"].noise_ratio < 1.1


@pytest.mark.crossed(3)
@pytest.mark.parametrize("start", [{"Fc": 0.01}, {"b": 1e-3, "Fc": 0.02}, {}], ids=["near", "braked", "not begun"])
def test_the_search_finds_the_motion_that_a_record_begins_in(records, start):
    found = fit(drive().start(**start), records, noise={"th": NOISE}, options=FitOptions(other_starts=0))
    assert found.success and found.misfit["th"].noise_ratio < 1.1
    for name, value in TRUTH.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.02)


def test_so_it_does_with_a_plant_that_is_not_linear_without_friction_either(records):
    braked = (drive() + effect("quadratic_damping")).start(Fc=0.01).fix(B2=1e-9)
    found = fit(braked, records, noise={"th": NOISE}, options=FitOptions(other_starts=0))
    assert found.success and found.misfit["th"].noise_ratio < 1.1


def coast(w0: float, b: float, level: float, t: np.ndarray) -> np.ndarray:
    """The angle of a wheel of unit inertia: w' = -b w - level until it stands, in closed form."""
    # w = (w0 + level / b) exp(-b t) - level / b until ts = log(1 + b w0 / level) / b.
    way, speed = np.sign(w0), abs(w0)
    ts = np.minimum(t, np.log1p(b * speed / level) / b)
    return way * ((speed + level / b) * -np.expm1(-b * ts) / b - level / b * ts)


def wheel() -> Model:
    """A wheel of unit inertia, of which the angle is measured."""
    return Model(
        "wheel",
        states=[State("w", "rad/s", role="velocity"), State("th", "rad", role="displacement")],
        inputs=[Input("u", "N*m", role="drive")],
        outputs=[Output("th", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 1.0, fixed=True, role="mass"),
            Parameter("b", "N*m*s", 0.1, (1e-4, 100.0), role="damping"),
        ],
        balances=lambda x, u, p: [
            Balance("torque", "N*m", p.J, "w", drive=u.u, viscous=-p.b * x.w),
            Balance("angle", "rad/s", 1, "th", rate=x.w),
        ],
    ) + effect("coulomb_friction")


COASTING, COASTING_NOISE = np.arange(500) * 0.01, 0.01


def coasts(w0: float) -> Experiment:
    th = coast(w0, 0.1, 1.5, COASTING) + COASTING_NOISE * np.random.default_rng(5).standard_normal(len(COASTING))
    return Experiment("coasts", COASTING, {"u": np.zeros(len(COASTING))}, {"th": th})


@pytest.mark.parametrize("w0", [3.0, -8.0])
def test_the_first_guess_of_a_velocity_that_no_reading_tells_is_that_of_the_motion(w0):
    problem = prepare_problem(wheel().start(b=0.1, Fc=1.5), coasts(w0), {"th": COASTING_NOISE}, FitOptions())
    assert problem.variables.initial.guess[0, 0] == pytest.approx(w0, rel=0.1)


@pytest.mark.crossed(3)
@pytest.mark.parametrize("w0", [3.0, -8.0])
@pytest.mark.parametrize("begin", [{"b": 0.5, "Fc": 0.5}, {"b": 0.5}], ids=["begun", "not begun"])
def test_a_wheel_that_coasts_ends_at_the_optimum_of_its_closed_form(w0, begin):
    t, noise, record = COASTING, COASTING_NOISE, coasts(w0)
    th = record.outputs["th"]
    found = fit(wheel().start(**begin), record, noise={"th": noise})
    oracle = least_squares(
        lambda z: (coast(z[0], z[1], z[2], t) + z[3] - th) / noise, [w0, 0.1, 1.5, 0.0], x_scale="jac"
    )
    assert found.success
    # Steps of the run leave a millionth of the cost.
    assert found.solver.cost == pytest.approx(2 * oracle.cost, rel=1e-5)
    assert found.traces[0].initial_state["w"] == pytest.approx(oracle.x[0], rel=1e-3)
