"""A fit of a model with an effect just added begins where the effect can show, and is never worse than the fit without it."""

import contextlib
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox import Balance, Model, Output, Parameter, State
from greybox.base.errors import GreyboxError
from greybox.model.effects.catalogue import CATALOGUE
from greybox.model.effects.scales import is_neutral, list_effect_values, measure_scales, within_bounds
from tests.support.first_order import first_order
from tests.support.pushed_mass import MASS

STIFFNESS, DAMPING, FRICTION, NOISE = 25.0, 0.05, 0.6, 2e-3


def swing() -> Model:
    """A pendulum that swings freely."""
    return Model(
        "swing",
        states=[State("q", "rad", 1.0, role="displacement"), State("w", "rad/s", role="velocity")],
        inputs=[],
        outputs=[Output("q", "rad")],
        parameters=[
            Parameter("J", "kg*m^2", 1.0, fixed=True),
            Parameter("k", "N*m", 20.0, (0.1, 1e3)),
            Parameter("b", "N*m*s/rad", 0.1, (1e-6, 10.0), role="damping"),
        ],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "q", w=x.w),
            Balance("torque", "N*m", p.J, "w", weight=-p.k * ca.sin(x.q), damping=-p.b * x.w),
        ],
    )


@pytest.fixture(scope="module")
def record() -> gb.Experiment:
    """A free swing with dry friction, by another integrator with fine steps."""

    def slope(_, y):
        return [y[1], -STIFFNESS * np.sin(y[0]) - DAMPING * y[1] - FRICTION * np.tanh(y[1] / 1e-3)]

    t = np.arange(0, 8, 0.02)
    run = solve_ivp(slope, (0, 8), [1.2, 0.0], "LSODA", t, rtol=1e-8, atol=1e-10, max_step=2e-3)
    return gb.Experiment("swing", t, {}, {"q": run.y[0] + np.random.default_rng(0).normal(0, NOISE, len(t))})


@pytest.fixture(scope="module")
def plain(record) -> gb.Fit:
    """The fit without an effect."""
    return gb.fit(swing(), record)


@pytest.mark.rest
def test_dry_friction_of_a_free_swing_is_found_from_its_neutral_value(record):
    found = gb.fit(swing() + gb.effect("coulomb_friction"), record)
    assert found.success
    for name, truth in {"k": STIFFNESS, "b": DAMPING, "Fc": FRICTION}.items():
        assert found.parameters[name].value == pytest.approx(truth, abs=4 * found.parameters[name].std), name
    assert found.misfit["q"].rmse == pytest.approx(NOISE, rel=0.1)


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    "name",
    [
        *("coulomb_friction", "quadratic_damping", "sensor_lag", "cubic_stiffness"),
        pytest.param("second_mode", marks=pytest.mark.slow),
    ],
)
def test_a_model_with_an_effect_more_is_never_worse(name, record, plain):
    larger = gb.fit(swing() + gb.effect(name), record)
    assert larger.misfit["q"].rmse <= 1.001 * plain.misfit["q"].rmse


@pytest.mark.rest
def test_two_effects_at_once_begin_one_after_the_other(record):
    model = swing() + gb.effect("coulomb_friction") + gb.effect("quadratic_damping")
    found = gb.fit(model, record)
    assert found.parameters["Fc"].value == pytest.approx(FRICTION, abs=4 * found.parameters["Fc"].std)
    assert found.parameters["B2"].value == pytest.approx(0.0, abs=0.02)


def test_a_model_that_begins_at_rest_still_begins_there():
    t = np.arange(0, 6, 0.02)
    plant = first_order()
    u = {plant.inputs[0].name: 0.5 + np.sign(np.sin(2 * t))}
    made = gb.simulate(plant, {"time": t, **u})
    record = gb.Experiment("steps", t, u, dict(made.outputs))
    found = gb.fit(plant + gb.effect("input_offset"), record, options=gb.FitOptions(at_rest=True))
    assert found.success
    assert found.parameters["u0"].value == pytest.approx(0.0, abs=1e-3)


def test_an_effect_with_values_of_its_own_begins_there():
    model = swing() + gb.effect("coulomb_friction")
    (friction,) = model.effects
    assert is_neutral(model, friction)
    assert not is_neutral(model.start(Fc=0.1), friction)
    assert not is_neutral(model.fix(Fc=0.0), friction)


@pytest.mark.parametrize("level", [3.0, 10.0])
def test_an_effect_that_begins_far_off_is_never_worse_than_none(level, record, plain):
    found = gb.fit((swing() + gb.effect("coulomb_friction")).start(Fc=level), record)
    assert found.misfit["q"].rmse <= (1 + 1e-9) * plain.misfit["q"].rmse
    assert found.parameters["Fc"].value == pytest.approx(FRICTION, abs=4 * found.parameters["Fc"].std)


def _list_absent_effects() -> list[str]:
    """The effects that act on the swing and are exactly absent at amplitudes of zero."""
    names = []
    for each in CATALOGUE:
        with contextlib.suppress(GreyboxError):
            if is_neutral(swing() + gb.effect(each.name), each) and not each.neutral:
                names.append(each.name)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 30.0])
@pytest.mark.parametrize("name", _list_absent_effects())
def test_no_effect_of_the_catalogue_makes_a_model_worse_wherever_it_begins(name, factor, record):
    # One rule of integration for both, or the cost would differ by its error.
    options = gb.FitOptions(method="rk4", substeps=4)
    known = {"q": NOISE}
    plain = gb.fit(swing(), record, noise=known, options=options)
    larger = swing() + gb.effect(name)
    states = np.column_stack([plain.traces[0].simulated["q"], np.gradient(plain.traces[0].simulated["q"], 0.02)])
    scales = measure_scales(plain.model, states, np.zeros((len(states), 0)), 0.02)
    (each,) = larger.effects
    for values in list(list_effect_values(larger, each, scales))[:2]:
        begun = larger.start(**{n: within_bounds(larger, n, factor * v) for n, v in values.items()})
        assert gb.fit(begun, record, noise=known, options=options).solver.cost <= (1 + 1e-9) * plain.solver.cost


def test_where_no_other_start_is_allowed_the_search_begins_at_the_neutral_value():
    t = np.arange(0, 4, 0.02)
    u = np.sign(np.sin(2 * t))
    plant = first_order()
    made = gb.simulate(plant, {"time": t, plant.inputs[0].name: u})
    record = gb.Experiment("steps", t, {plant.inputs[0].name: u}, dict(made.outputs))
    delayed = plant + gb.effect("input_offset")
    alone = gb.fit(delayed, record, options=gb.FitOptions(other_starts=0))
    found = gb.fit(delayed, record)
    for name, e in found.parameters.items():
        assert e.value == pytest.approx(alone.parameters[name].value, abs=1e-4), name


def test_an_effect_whose_own_values_are_a_fit_s_begins_there():
    """A search hands its effects over with fitted values as those of the effect itself."""
    fitted = swing() + replace(
        gb.effect("coulomb_friction"),
        parameters=tuple(replace(q, value=0.6) for q in gb.effect("coulomb_friction").parameters),
    )
    (friction,) = fitted.effects
    assert fitted.values["Fc"] == 0.6 and not is_neutral(fitted, friction)


@pytest.mark.slow
def test_a_sharp_resonance_is_found_from_all_of_its_starts():
    dt, rows = 2e-3, 2000
    time = dt * np.arange(rows)
    force = gb.signals.multisine(time, 0.5, 60, 4.0, np.random.default_rng(1))

    def slope(t, x):  # 0.08 kg on a spring, 22 Hz, on a body of 0.62 kg
        spring = 1500 * (x[2] - x[0]) + 0.8 * (x[3] - x[1])
        push = force[min(int(t / dt), rows - 1)] - 5.5 * x[1] - 2600 * x[0] + spring
        return [x[1], push / 0.62, x[3], -spring / 0.08]

    run = solve_ivp(slope, (0, time[-1]), [0.0] * 4, "LSODA", time, max_step=dt, rtol=1e-8, atol=1e-10).y[0]
    record = gb.Experiment.from_arrays(
        time, {"u": force}, {"x": run + 2e-6 * np.random.default_rng(2).normal(size=rows)}, name="stage"
    )
    stage = replace(MASS, outputs=(Output("x", "m"),)).bound(K=(1.0, 1e5)).start(M=0.7, B=4.0, K=2500.0).free("M")
    found = gb.fit(stage + gb.effect("second_mode"), record, noise={"x": 2e-6}, options=gb.FitOptions(at_rest=True))
    assert found.misfit["x"].noise_ratio == pytest.approx(1.0, abs=0.05)
    for name, truth in {"M": 0.62, "m2": 0.08, "k2": 1500.0, "c2": 0.8}.items():
        assert found.parameters[name].value == pytest.approx(truth, rel=0.02), name


ZERO_CELSIUS = 273.15
COOL, RADIATION, CONVECTION = 0.3, 8e-9, 0.02


def oven() -> Model:
    """A heated body, whose temperature a record may state in kelvin or, without saying so, in degrees Celsius."""
    return Model(
        "oven",
        states=[State("T", "K", 293.15)],
        inputs=[gb.Input("P", "W"), gb.Input("Ta", "K")],
        outputs=[Output("T", "K")],
        parameters=[Parameter("C", "J/K", 500.0, (1, 1e6)), Parameter("h", "W/K", 0.5, (1e-3, 1e3))],
        balances=lambda x, u, p: [Balance("heat", "W", p.C, "T", heater=u.P, loss=-p.h * (x.T - u.Ta))],
    )


def heated(zero: float, power: float = 150.0) -> gb.Experiment:
    """Measured on a scale that begins at ``zero`` (K), by SciPy."""
    time = 10.0 * np.arange(400)
    drive = np.where(time // 600 % 2 == 0, power, 0.0)

    def rate(t, T):
        return (drive[int(t // 10)] - COOL * (T - 293.15) - RADIATION * (T**4 - 293.15**4)) / 400.0

    T = [293.15]
    for k in range(len(time) - 1):
        step = solve_ivp(rate, (time[k], time[k] + 10 - 1e-9), [T[-1]], rtol=1e-9, atol=1e-9)
        T.append(step.y[0, -1])
    reading = np.array(T) - zero + np.random.default_rng(1).normal(0, 0.05, len(T))
    inputs = {"P": drive, "Ta": np.full(len(T), 293.15 - zero)}
    return gb.Experiment.from_arrays(time, inputs, {"T": reading}, name="oven", hold="zero")


@pytest.mark.crossed(3)
@pytest.mark.parametrize(
    ("effect", "known"),
    [
        ("radiation_loss", {"T0": 0.0}),
        ("radiation_loss", {"T0": 100.0}),
        ("heat_storage", {"tau_g": 123.0}),
        ("natural_convection", {"least": 7.0}),
        ("radiation_loss", {"kr": 2e-9}),
    ],
)
def test_a_constant_that_somebody_fixed_stays_where_no_record_would_put_it(effect, known):
    record = heated(ZERO_CELSIUS)
    fitted = gb.fit((oven() + gb.effect(effect)).fix(**known), record)
    assert {name: fitted.model.values[name] for name in known} == known
    assert not [f for f in fitted.findings if f.code == "constant_by_record"]


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("zero", "power"), [(0.0, 150.0), (ZERO_CELSIUS, 150.0), (ZERO_CELSIUS, 1200.0)])
def test_the_zero_of_a_temperature_scale_is_told_by_its_coldest_readings_and_said(zero, power):
    fitted = gb.fit(oven() + gb.effect("radiation_loss"), heated(zero, power))
    assert fitted.model.values["T0"] == zero
    assert fitted.parameters["kr"].value == pytest.approx(RADIATION, rel=0.01)
    said = [str(f) for f in fitted.findings if f.code == "constant_by_record"]
    assert said == (
        []
        if not zero
        else ["T0 is taken as 273.15 K by what the record shows; fix it (--fix T0=VALUE) where you know it"]
    )
    # What a fit has found is the model's own: another record moves it no more.
    again = gb.fit(fitted.model, heated(zero, 80.0))
    assert again.model.values["T0"] == zero and not [f for f in again.findings if f.code == "constant_by_record"]


def test_a_model_in_kelvin_whose_radiation_is_known_is_simulated_in_kelvin():
    record = heated(0.0)
    known = (oven() + gb.effect("radiation_loss")).start(C=400.0, h=COOL, kr=RADIATION)
    run = gb.simulate(known, {"time": record.time, **record.inputs})
    assert np.abs(run.outputs["T"] - record.outputs["T"]).max() < 0.3


@pytest.mark.parametrize("noise", [None, {"T": 0.05}])
def test_a_residual_that_was_taken_for_the_noise_is_the_noise_that_constants_are_held_against(noise):
    fitted = gb.fit(oven(), heated(0.0, 800.0), colour="residual", noise=noise)
    assert fitted.noise.colour["T"] and not fitted.explains_records
    for shift in (s for f in fitted.findings if f.code == "parameter_not_constant" for s in f.values["shifts"]):
        std = fitted.parameters[shift["name"]].std
        assert shift["before"] is None or shift["deviations"] < 3 * abs(shift["after"] - shift["before"]) / std
