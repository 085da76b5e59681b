"""The catalogue: every effect against its equation by hand, on every plant that takes it."""

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, Effect, Input, Model, Output, Parameter, State
from greybox.effects import CATALOGUE, applicable, effect
from greybox.errors import ModelError
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator, micro_actuator_no_inductance
from models.pneumatic_cylinder import pneumatic_cylinder
from models.silverbox import silverbox

NAMES = [entry.name for entry in CATALOGUE]
MECHANICAL = [micro_actuator, micro_actuator_no_inductance, pneumatic_cylinder, emps, silverbox]

# The force that an effect of amplitude a adds at displacement x and velocity v.
FORCES = {
    "coulomb_friction": lambda a, x, v: -a * np.sign(v),
    "quadratic_damping": lambda a, x, v: -a * abs(v) * v,
    "cubic_stiffness": lambda a, x, v: -a * x**3,
    "quadratic_stiffness": lambda a, x, v: -a * x**2,
    "constant_load": lambda a, x, v: a,
}
AMPLITUDES = {
    "coulomb_friction": ("Fc", "N", "V/s**2", (0.0, np.inf)),
    "quadratic_damping": ("B2", "N*s**2/m**2", "1/V", (0.0, np.inf)),
    "cubic_stiffness": ("K3", "N/m**3", "1/(s*V)**2", (-np.inf, np.inf)),
    "quadratic_stiffness": ("K2", "N/m**2", "1/(V*s**2)", (-np.inf, np.inf)),
    "constant_load": ("F0", "N", "V/s**2", (-np.inf, np.inf)),
    "input_offset": ("u0", "V", "V", (-np.inf, np.inf)),
}
STORAGE = {"micro_actuator": "M", "micro_actuator_no_inductance": "M", "pneumatic_cylinder": "M_piston", "emps": "M"}

each_model = pytest.mark.parametrize("model", MECHANICAL, ids=lambda m: m.name)
each_effect = pytest.mark.parametrize("name", NAMES)
each_force = pytest.mark.parametrize("name", FORCES)


def rates(model, x, u, **amplitudes):
    """dx/dt with some constants replaced; the effect's constant is the last of the model's."""
    return np.array(model.system.rhs_function(x, u, list((model.values | amplitudes).values()))).ravel()


def points(model, seed=0):
    """Random states (displacement first, velocity second in every plant here) and inputs, both directions of motion."""
    rng = np.random.default_rng(seed)
    for _ in range(4):
        yield rng.normal(size=len(model.states)), rng.normal(size=1)


def as_number(unit):
    """A unit with a number in place of every base unit: equal numbers, equal units (m, kg, s, A are independent)."""
    m, kg, s, A = 1.7, 2.9, 0.83, 4.1
    words = {"m": m, "kg": kg, "s": s, "A": A, "N": kg * m / s**2, "V": kg * m**2 / (s**3 * A)}
    return eval(unit.replace("^", "**"), {"__builtins__": {}}, words)


def test_names_are_unique_and_every_hand_formula_has_its_effect():
    assert len(set(NAMES)) == len(NAMES)
    assert set(AMPLITUDES) <= set(NAMES)
    assert set(FORCES) == set(AMPLITUDES) - {"input_offset"}


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda e: e.name)
def test_every_effect_says_what_it_is_and_where_it_comes_from(entry):
    assert entry.equation
    assert entry.source
    assert entry.parity in {"even", "odd", "linear", "slow"}
    assert entry.tells_apart.endswith(".")
    for q in entry.parameters:
        assert q.source, q.name
        assert q.description, q.name
        assert not q.fixed, q.name


@pytest.mark.parametrize("name", AMPLITUDES)
def test_amplitudes_have_the_catalogues_names_and_start_absent(name):
    parameter, _, _, bounds = AMPLITUDES[name]
    assert [(q.name, q.value, q.bounds) for q in effect(name).parameters] == [(parameter, 0.0, bounds)]


@each_force
@each_model
def test_force_is_the_hand_formula(model, name):
    changed, amplitude = model + effect(name), 0.37
    own = list(changed.values)[-1]
    storage = model.values[STORAGE[model.name]] if model.name in STORAGE else 1.0
    for x, u in points(model):
        added = rates(changed, x, u, **{own: amplitude}) - rates(model, x, u)
        expected = np.zeros(len(x))
        expected[1] = FORCES[name](amplitude, x[0], x[1]) / storage
        # the plant's own forces cancel in the difference
        np.testing.assert_allclose(added, expected, rtol=1e-9, atol=1e-12 * max(abs(rates(model, x, u))))


@each_model
def test_input_offset_moves_the_input_wherever_it_enters(model):
    changed = model + effect("input_offset")
    values = list((changed.values | {"u0": -0.6}).values())
    for x, u in points(model):
        np.testing.assert_allclose(rates(changed, x, u, u0=-0.6), rates(model, x, u - 0.6), rtol=1e-12)
        seen = changed.system.output_function(x, u, values)
        plain = model.system.output_function(x, u - 0.6, list(model.values.values()))
        np.testing.assert_allclose(np.array(seen), np.array(plain), rtol=1e-12)


@each_effect
@each_model
def test_absent_effect_changes_nothing_and_appears_with_a_slope(model, name):
    changed = model + effect(name)
    system = changed.system
    amplitude = system.p[len(model.parameters)]
    slope = ca.Function("slope", [system.x, system.u, system.p], [ca.jacobian(system.explicit, amplitude)])
    for x, u in points(model, seed=1):
        assert (rates(changed, x, u) == rates(model, x, u)).all()
        values = list(changed.values.values())
        plain = model.system.output_function(x, u, list(model.values.values()))
        assert (np.array(system.output_function(x, u, values)) == np.array(plain)).all()
        derivative = np.array(slope(x, u, values)).ravel()
        step = {list(changed.values)[-1]: 1.0}
        np.testing.assert_allclose(
            derivative, rates(changed, x, u, **step) - rates(changed, x, u), rtol=1e-6, atol=1e-9
        )
        assert abs(derivative).max() > 0


@each_model
def test_coulomb_friction_is_dry_and_holds_what_it_slides_with(model):
    system = (model + effect("coulomb_friction")).start(Fc=0.8).system
    (dry,) = system.dry
    assert (dry.balance, system.state_names[dry.state]) == ("force", "v")
    magnitudes = ca.Function("magnitudes", [system.p], [dry.sliding, dry.static])
    values = list((model + effect("coulomb_friction")).start(Fc=0.8).values.values())
    assert [float(m) for m in magnitudes(values)] == [0.8, 0.8]


@pytest.mark.parametrize("name", AMPLITUDES)
@each_model
def test_units_are_those_of_the_model(model, name):
    _, in_newton, in_volt, _ = AMPLITUDES[name]
    (parameter,) = (model + effect(name)).bound_effects[0].parameters
    assert as_number(parameter.unit) == pytest.approx(as_number(in_volt if model is silverbox else in_newton))


def test_a_name_the_model_already_uses_is_qualified():
    model = pneumatic_cylinder + effect("quadratic_stiffness")
    assert list(model.values)[-1] == "quadratic_stiffness.K2"
    assert model.values["K2"] == pneumatic_cylinder.values["K2"]


def test_effects_add_up():
    both = micro_actuator + effect("cubic_stiffness") + effect("constant_load")
    x, u = next(points(micro_actuator))
    added = rates(both, x, u, K3=2.0, F0=-0.4) - rates(micro_actuator, x, u)
    assert added[1] * micro_actuator.values["M"] == pytest.approx(-2.0 * x[0] ** 3 - 0.4, rel=1e-6)


def test_negative_friction_is_refused():
    with pytest.raises(ModelError, match=r"'Fc': -1 .*lies outside its bounds \[0, inf\]"):
        (micro_actuator + effect("coulomb_friction")).start(Fc=-1)


def test_unknown_effect_lists_the_nearest():
    with pytest.raises(ModelError, match="'coulomb'; did you mean 'coulomb_friction'"):
        effect("coulomb")


@each_force
def test_tanks_have_no_force_and_say_so(name):
    with pytest.raises(ModelError, match=f"'{name}' acts at 'force', which model 'cascaded_tanks' does not have"):
        (cascaded_tanks + effect(name)).system  # noqa: B018


def test_applicable_asks_the_model_for_site_and_roles():
    for model in MECHANICAL:
        assert set(AMPLITUDES) <= {entry.name for entry in applicable(model)}
    on_tanks = {entry.name for entry in applicable(cascaded_tanks)}
    assert "input_offset" in on_tanks
    assert not on_tanks & set(FORCES)
    assert "constant_load" not in {entry.name for entry in applicable(emps + effect("constant_load"))}


def test_applicable_leaves_springs_out_where_nothing_is_a_displacement():
    rotor = Model(
        "rotor",
        states=[State("w", "rad/s", role="velocity")],
        inputs=[Input("u", "N*m", role="drive")],
        outputs=[Output("w", "rad/s")],
        parameters=[Parameter("J", "kg*m**2", 1.0, (0.1, 10.0)), Parameter("B", "N*m*s/rad", 1.0, (0.1, 10.0))],
        balances=lambda x, u, p: [Balance("force", "N*m", p.J, "w", drive=u.u, viscous=-p.B * x.w)],
    )
    found = {entry.name for entry in applicable(rotor)}
    assert {"coulomb_friction", "quadratic_damping", "constant_load", "input_offset"} <= found
    assert not found & {"cubic_stiffness", "quadratic_stiffness"}


def test_an_effect_of_the_users_own_is_five_lines():
    drag = Effect(
        "cubic_damping",
        "force",
        [Parameter("B3", "{force}/{velocity}**3", 0.0)],
        terms=lambda x, u, p: -p.B3 * x.velocity**3,
    )
    x, u = next(points(emps))
    assert (rates(emps + drag, x, u, B3=2.0) - rates(emps, x, u))[1] * emps.values["M"] == pytest.approx(-2 * x[1] ** 3)
