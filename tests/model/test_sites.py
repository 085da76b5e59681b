"""Where effects find a place: by role and unit, at every body, input and output; and names that clash."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.model.effects.catalogue import CATALOGUE, applicable_effects, effect, find_placements
from greybox.model.effects.scales import measure_scales


def _two_bodies(x, u, p):
    twist = p.c * (x.a1 - x.a2)
    return [
        Balance("motor_angle", "rad/s", 1, "a1", speed=x.w1),
        Balance("motor_torque", "N*m", p.J1, "w1", drive=u.T, shaft=-twist, bearing=-p.d * x.w1),
        Balance("load_angle", "rad/s", 1, "a2", speed=x.w2),
        Balance("load_torque", "N*m", p.J2, "w2", shaft=twist, brake=-u.L, bearing=-p.d * x.w2),
    ]


TWO_BODIES = Model(
    "two_bodies",
    states=[State("a1", "rad"), State("w1", "rad/s"), State("a2", "rad"), State("w2", "rad/s")],
    inputs=[Input("T", "N*m"), Input("L", "N*m")],
    outputs=[Output("a1", "rad"), Output("a2", "rad")],
    parameters=[
        Parameter("J1", "kg*m^2", 1.0),
        Parameter("J2", "kg*m^2", 2.0),
        Parameter("c", "N*m/rad", 30.0),
        Parameter("d", "N*m*s/rad", 0.1),
    ],
    balances=_two_bodies,
)


def rates(model, x, u, **values):
    return np.array(model.system.rhs_function(x, u, list(model.start(**values).values.values()))).ravel()


def names(model):
    return {e.name for e in applicable_effects(model)}


@pytest.mark.rest
def test_any_balance_of_a_speed_takes_friction_and_each_body_its_own():
    assert {"coulomb_friction", "coulomb_friction_at_load", "cubic_stiffness", "cubic_stiffness_at_load"} <= names(
        TWO_BODIES
    )
    x, u = np.array([0.3, 1.5, 0.2, -0.7]), [0.0, 0.0]
    for name, row, speed, inertia in (
        ("quadratic_damping", 1, 1.5, 1.0),
        ("quadratic_damping_at_load", 3, -0.7, 2.0),
    ):
        model = TWO_BODIES + effect(name)
        expected = np.zeros(4)
        expected[row] = -0.4 * abs(speed) * speed / inertia
        assert rates(model, x, u, B2=0.4) - rates(TWO_BODIES, x, u) == pytest.approx(expected)


def test_a_spring_at_a_body_sees_the_displacement_of_that_body():
    x, u = np.array([0.3, 0.0, -0.2, 0.0]), [0.0, 0.0]
    model = TWO_BODIES + effect("cubic_stiffness_at_load")
    assert (rates(model, x, u, K3=5.0) - rates(TWO_BODIES, x, u))[3] == pytest.approx(5.0 * 0.2**3 / 2.0)
    assert (
        model.bound_effects[0].parameters[0].unit
        == (TWO_BODIES + effect("cubic_stiffness")).bound_effects[0].parameters[0].unit
    )


@pytest.mark.rest
def test_every_input_and_every_output_takes_effects():
    every = {"input_offset", "input_offset_at_L", "gain_by_sign_at_L", "input_dead_zone", "input_dead_zone_at_L"}
    assert every | {"sensor_lag", "sensor_lag_at_a2", "sensor_drift_at_a2", "transport_delay_at_L"} <= names(TWO_BODIES)
    x, u = np.zeros(4), [1.0, 2.0]
    model = TWO_BODIES + effect("input_offset_at_L")
    assert rates(model, x, u, u0=0.5) == pytest.approx(rates(TWO_BODIES, x, [1.0, 2.5]))
    drifting = (TWO_BODIES + effect("sensor_drift_at_a2")).start(rate=1.0)
    y = drifting.system.output_function([*x, 0.25], u, list(drifting.values.values()))
    assert np.array(y).ravel() == pytest.approx([0.0, 0.25])
    play = (TWO_BODIES + effect("input_hysteresis_at_L")).start(h=0.5)
    assert rates(play, [*x, 0.0], u) == pytest.approx([*rates(TWO_BODIES, x, [1.0, 1.5]), 0.0])


def test_two_bodies_of_one_role_have_each_their_own_speed():
    roles = {"w1": "velocity", "w2": "velocity", "a1": "displacement", "a2": "displacement"}
    states = [State(s.name, s.unit, role=roles[s.name]) for s in TWO_BODIES.states]
    model = Model("m", states, TWO_BODIES.inputs, TWO_BODIES.outputs, TWO_BODIES.parameters, _two_bodies)
    x, u = np.array([0.3, 1.5, -0.2, -0.7]), [0.0, 0.0]
    added = rates(model + effect("quadratic_damping"), x, u, B2=0.4) - rates(model, x, u)
    assert added == pytest.approx([0.0, -0.4 * 1.5**2, 0.0, 0.0])


def test_why_an_effect_has_no_place():
    tank = Model(
        "tank",
        states=[State("h", "m", role="level")],
        inputs=[Input("q", "m^3/s")],
        outputs=[Output("h", "m")],
        parameters=[Parameter("A", "m^2", 1.0), Parameter("k", "m^2/s", 1.0)],
        balances=lambda x, u, p: [Balance("volume", "m^3/s", p.A, "h", pump=u.q, outflow=-p.k * x.h)],
    )
    found = {p.name: p for p in find_placements(tank, CATALOGUE)}
    assert found["pump_back_pressure"].site == "volume" and found["pump_back_pressure"].effect is not None
    assert "it needs a balance of a velocity" in found["coulomb_friction"].reason
    assert "role `valve`" in found["valve_lag"].reason
    present = {p.name: p for p in find_placements(tank + effect("input_offset"), CATALOGUE)}
    assert present["input_offset"].reason == "the model contains it already"


def test_the_same_as_two_others_is_no_candidate_beside_them():
    assert "asymmetric_friction" not in names(TWO_BODIES)
    found = {p.name for p in find_placements(TWO_BODIES, CATALOGUE) if p.effect is not None}
    assert "asymmetric_friction" in found


def test_the_names_of_an_effect_hide_nothing_of_the_plant():
    def balances(x, u, p):
        return [
            Balance("position", "m/s", 1, "z", velocity=x.v),
            Balance("force", "N", p.B2, "v", drive=u.F, spring=-p.K1 * x.z),
        ]

    plant = Model(
        "plant",
        states=[State("z", "m", role="displacement"), State("v", "m/s", role="velocity")],
        inputs=[Input("F", "N")],
        outputs=[Output("z", "m")],
        parameters=[Parameter("B2", "kg", 2.0, role="mass"), Parameter("K1", "N/m", 7.0)],
        balances=balances,
    )
    creeping = plant + effect("viscoelastic_creep")
    assert creeping.system.state_names == ("z", "v", "viscoelastic_creep.z")
    p = list((creeping.values | {"viscoelastic_creep.K1": 3.0}).values())
    rate = np.array(creeping.system.rhs_function([0.5, 0.0, 0.2], [0.0], p)).ravel()
    assert rate[1] == pytest.approx((-7.0 * 0.5 - 3.0 * (0.5 - 0.2)) / 2.0)
    damped = plant + effect("quadratic_damping")
    assert list(damped.values)[-1] == "quadratic_damping.B2" and damped.values["B2"] == 2.0


def test_scales_are_those_of_the_site():
    x = np.random.default_rng(1).normal(size=(200, 4)) * [1.0, 2.0, 0.1, 5.0]
    u = np.random.default_rng(2).normal(size=(200, 2)) * [1.0, 30.0]
    scales = measure_scales(TWO_BODIES, x, u, 0.01)
    at_load = scales.at("load")
    assert at_load.displacement == np.abs(x[:, 2]).max() and scales.displacement == np.abs(x[:, 0]).max()
    assert at_load.storage == 2.0 and scales.storage == 1.0
    assert scales.at("L").input == np.abs(u[:, 1]).max()
    # The range of a reading is that of the record, zero within it or not.
    assert scales.readings == (x[:, 0].min(), x[:, 0].max())
    assert scales.at("a2").readings == (x[:, 2].min(), x[:, 2].max())
    assert scales.at("load").readings == scales.readings and scales.at("a2").reading == np.abs(x[:, 2]).max()
    placed = next(e for e in applicable_effects(TWO_BODIES, scales) if e.name == "input_offset_at_L")
    assert placed.probe(scales)["u0"] == pytest.approx(0.01 * np.abs(u[:, 1]).max())


def test_an_effect_of_a_fit_goes_by_the_name_of_its_site():
    rng = np.random.default_rng(5)
    time = 0.02 * np.arange(300)
    inputs = {"T": rng.normal(size=300), "L": np.repeat(rng.normal(size=30), 10)}
    model = TWO_BODIES.fix("c", "J1", "d") + effect("quadratic_damping_at_load")
    run = gb.simulate(model.start(B2=0.5), {"time": time, **inputs})
    record = gb.Experiment("r", time, inputs, {n: y + 1e-5 * rng.normal(size=300) for n, y in run.outputs.items()})
    found = gb.fit(model.start(J2=1.5), record, noise={"a1": 1e-5, "a2": 1e-5}, options=gb.FitOptions(at_rest=True))
    assert found.parameters["B2"].value == pytest.approx(0.5, rel=0.02)


def test_a_site_that_is_not_there_is_refused():
    with pytest.raises(ModelError, match="acts at 'wheel', which model 'two_bodies' does not have"):
        (TWO_BODIES + effect("coulomb_friction_at_wheel")).system  # noqa: B018
    heat = Model(
        "heat",
        [State("T", "K")],
        [Input("P", "W")],
        [Output("T", "K")],
        [Parameter("C", "J/K", 1.0)],
        lambda x, u, p: [Balance("heat", "W", p.C, "T", heater=u.P)],
    )
    drag = Effect("drag", "force", [], terms=lambda x, u, p: -x.velocity)
    with pytest.raises(ModelError, match=r"acts at 'force'.*it needs a balance of a velocity"):
        (heat + drag).system  # noqa: B018


def test_a_role_that_two_states_have_means_the_first_of_them_where_no_site_tells():
    """An effect of the input that speaks of a current: that of the first coil, in values, units and scales alike."""
    droop = Effect("droop", "input", [Parameter("R", "ohm", 0.0)], on_input=lambda v, x, u, p: v - p.R * x.current)
    coils = Model(
        "coils",
        [State("i1", "A", role="current"), State("i2", "A", role="current")],
        [Input("u", "V")],
        [Output("i1", "A"), Output("i2", "A")],
        [Parameter("L", "H", 1.0)],
        lambda x, u, p: [
            Balance("first", "V", p.L, "i1", source=u.u),
            Balance("second", "V", p.L, "i2", source=u.u),
        ],
    )
    assert rates(coils + droop, [2.0, 5.0], [1.0], R=0.1) == pytest.approx([0.8, 0.8])
    x = np.array([[2.0, 5.0], [-1.0, 7.0]])
    assert measure_scales(coils, x, np.ones((2, 1)), 0.1).peaks["current"] == 2.0
