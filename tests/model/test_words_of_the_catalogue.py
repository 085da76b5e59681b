"""Names of a model that are words of the catalogue, and effects at places that cannot have them."""

from dataclasses import replace

import pytest

from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base import ModelError
from greybox.estimation.identifiability.structural import add_sensors, find_unmeasured_states
from greybox.model import equations_text
from greybox.model.effects import effect
from greybox.model.sites import NEEDED


def rig(balance="force", drive="F", force="N", mass="kg", speed="m/s"):
    length = speed.partition("/")[0]
    return Model(
        "rig",
        states=[State("x", length), State("v", speed)],
        inputs=[Input(drive, force)],
        outputs=[Output("pos", length, lambda x, u, p: x.x)],
        parameters=[Parameter("M", mass, 1.0, (0.1, 10.0)), Parameter("K", f"{force}/{length}", 50.0, (1.0, 1e4))],
        balances=lambda x, u, p: [
            Balance("kinematics", speed, 1, "x", velocity=x.v),
            Balance(balance, force, p.M, "v", drive=u[drive], spring=-p.K * x.x),
        ],
    )


@pytest.mark.crossed(3)
@pytest.mark.parametrize("word", sorted(NEEDED))
def test_a_balance_or_an_input_may_be_called_like_a_word_of_the_catalogue(word):
    for model in (rig(balance=word), rig(drive=word)):
        for name in ("coulomb_friction", "sensor_lag", "reading_curve", "input_saturation"):
            usual = (rig() + effect(name)).bound_effects[0]
            placed = (model + effect(name)).bound_effects[0]
            assert placed.placed.place.kind == usual.placed.place.kind
            assert [q.unit for q in placed.parameters] == [q.unit for q in usual.parameters]


@pytest.mark.parametrize(
    ("name", "site", "reason"),
    [
        ("sensor_lag", "force", "acts at outputs, and 'force' is a balance"),
        ("reading_curve", "F", "acts at outputs, and 'F' is an input"),
        ("input_saturation", "pos", "acts at inputs, and 'pos' is an output"),
        ("coulomb_friction", "F", "acts at balances, and 'F' is an input"),
    ],
)
def test_an_effect_at_a_place_of_another_kind_is_refused_in_words(name, site, reason):
    with pytest.raises(ModelError, match=reason):
        rig() + replace(effect(name), site=site)


@pytest.mark.parametrize(("state", "unit", "relation"), [("a1", "m/s", "N"), ("b1", "K", "W"), ("i1", "A", "V")])
def test_friction_at_a_balance_that_stores_nothing_is_refused_in_words(state, unit, relation):
    node = Model(
        "node",
        states=[State("x", "m"), State(state, unit)],
        inputs=[Input("F", relation)],
        outputs=[Output("x", "m")],
        parameters=[Parameter("c", f"{relation}/({unit})", 1.0, (0.1, 10.0)), Parameter("k", f"m/s/({unit})", 1.0)],
        balances=lambda x, u, p: [
            Balance("rate", "m/s", 1, "x", flow=p.k * x[state]),
            Balance("node", relation, 0, state, link=p.c * x[state], drive=-u.F),
        ],
    )
    with pytest.raises(ModelError, match="balance 'node' stores nothing"):
        node + replace(effect("coulomb_friction"), site="node")


@pytest.mark.parametrize(
    ("units", "role"),
    [
        (("kN", "Mg", "m/s"), "velocity"),
        (("mN", "g", "m/s"), "velocity"),
        (("N", "kg", "mm/s"), "velocity"),
    ],
)
def test_a_prefix_does_not_change_what_a_balance_is_of(units, role):
    force, mass, speed = units
    scale = {"mm/s": "N*s^2/mm"}.get(speed, mass)
    (site,) = (s for s in rig(force=force, mass=scale, speed=speed).sites if s.name == "force")
    assert site.states[role] == "v"


@pytest.mark.parametrize(
    ("balance", "capacity", "state", "role"),
    [("kW", "kJ/K", "K", "temperature"), ("mV", "mH", "A", "current"), ("l/min", "m^2", "m", "level")],
)
def test_a_store_in_units_with_a_prefix_has_the_role_of_its_quantity(balance, capacity, state, role):
    store = Model(
        "store",
        states=[State("z", state)],
        inputs=[Input("u", balance)],
        outputs=[Output("z", state)],
        parameters=[
            Parameter("C", capacity, 1.0, (0.1, 10.0)),
            Parameter("g", f"({balance})/{state}", 1.0, (0.1, 9.0)),
        ],
        balances=lambda x, u, p: [Balance("b", balance, p.C, "z", flow=u.u, loss=-p.g * x.z)],
    )
    assert store.sites[0].states.get(role) == "z"


def test_a_clock_called_t_is_a_state_that_no_further_sensor_reads():
    late = Model(
        "late",
        states=[State("t", "h"), State("x", "1", 1.0)],
        inputs=[],
        outputs=[Output("x", "1")],
        parameters=[Parameter("k", "1/h", 0.5, (0.0, 10.0))],
        balances=lambda x, u, p: [
            Balance("clock", "h/h", 1, "t", one=1.0),
            Balance("decay", "1/h", 1, "x", loss=-p.k * x.x),
        ],
    )
    assert add_sensors(late, find_unmeasured_states(late)).outputs == late.outputs


def walk(noise):
    return Model(
        "walk",
        states=[State("d", "%", noise=noise)],
        inputs=[],
        outputs=[Output("d", "%")],
        parameters=[Parameter("q", "%/s^0.5", 1.0, (0.0, 10.0))],
        balances=lambda x, u, p: [Balance("drift", "%/s", 1, "d")],
    )


def test_a_balance_without_terms_is_a_random_walk_and_nothing_else():
    for noise in ("q", 0.5, lambda p: 2 * p.q):
        text = equations_text(walk(noise))
        assert "dd/dt = 0" in text
        assert "dw pushes d" in text
    with pytest.raises(ModelError, match="balance 'drift' has no terms"):
        walk(0.0)


@pytest.mark.parametrize("name", ["self", "model", "values", "bounds", "estimated"])
def test_a_constant_may_have_the_name_of_an_argument(name):
    model = Model(
        "lag",
        [State("x", "m")],
        [Input("u", "m")],
        [Output("x", "m")],
        [Parameter(name, "s", 1.0, (1e-3, 1e3))],
        lambda x, u, p: [Balance("lag", "m", getattr(p, name), "x", drive=u.u, decay=-x.x)],
    )
    assert model.start(**{name: 2.0}).values[name] == 2.0
    assert model.bound(**{name: (0.1, 5.0)}).all_parameters[0].bounds == (0.1, 5.0)
    assert model.fix(**{name: 3.0}).values[name] == 3.0
    assert model.prior(**{name: (1.3, 0.1)}).all_parameters[0].prior is not None
