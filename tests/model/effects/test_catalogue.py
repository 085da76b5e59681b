"""The catalogue: what every entry says of itself, its terms by hand, and which plant takes which."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Effect, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError, UnitError
from greybox.data.experiment import Experiment
from greybox.model.effects.catalogue import CATALOGUE, applicable_effects, effect
from greybox.model.effects.scales import measure_scales, tailor_to_record
from greybox.simulation.records import to_record
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator, micro_actuator_no_inductance
from models.pneumatic_cylinder import pneumatic_cylinder
from models.pneumatic_full import pneumatic_full
from models.silverbox import silverbox

NAMES = [entry.name for entry in CATALOGUE]
MECHANICAL = [micro_actuator, micro_actuator_no_inductance, pneumatic_cylinder, emps, silverbox]

# The force that an effect of amplitude a adds at displacement x and velocity v.
FORCES = {
    "return_spring": lambda a, x, v: -a * x,
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
    "return_spring": ("Ks", "N/m", "1/s**2", (0.0, np.inf)),
    "input_offset": ("u0", "V", "V", (-np.inf, np.inf)),
}
STORAGE = {"micro_actuator": "M", "micro_actuator_no_inductance": "M", "pneumatic_cylinder": "M_piston", "emps": "M"}

each_model = pytest.mark.parametrize("model", MECHANICAL, ids=lambda m: m.name)
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
        # where a calibration curve is anchored and where a root is smooth are choices, not constants to be found
        assert q.fixed == (
            (entry.name, q.name)
            in {
                *(("reading_curve", "full"), ("root_leak", "laminar"), ("radiation_loss", "T0")),
                *(
                    ("natural_convection", "least"),
                    ("brush_drop", "ib"),
                    ("end_stop", "side"),
                    ("sensor_saturation", "side"),
                ),
            }
        )
    own = {q.name: q for q in entry.parameters}
    assert set(entry.amplitudes) <= set(own)
    assert set(entry.neutral) <= set(entry.amplitudes)
    assert all(own[name].value == entry.neutral.get(name, 0.0) for name in entry.amplitudes)
    assert all(any(e.name == other for e in CATALOGUE) for other in (*entry.parents, *entry.stands_for))
    assert bool(entry.parents) == (entry.from_parent is not None)
    assert [e.name for e in CATALOGUE].index(entry.name) > max((NAMES.index(n) for n in entry.parents), default=-1)


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
def test_a_reversed_wire_turns_the_sign_wherever_the_signal_goes(model):
    values = list(model.values.values())
    driven, read = model + effect("reversed_input"), model + effect("reversed_reading")
    for x, u in points(model):
        np.testing.assert_allclose(rates(driven, x, u), rates(model, x, -u), rtol=1e-12)
        np.testing.assert_allclose(rates(read, x, u), rates(model, x, u), rtol=1e-12)
        plain = np.array(model.system.output_function(x, u, values)).ravel()
        mirrored = np.array(read.system.output_function(x, u, values)).ravel()
        np.testing.assert_allclose(mirrored, [-plain[0], *plain[1:]], rtol=1e-12)


@pytest.mark.parametrize(("name", "expected"), [("late_row", [2, 3, 4, 4]), ("early_row", [1, 1, 2, 3])])
def test_a_row_late_or_early_is_another_row_of_the_record(name, expected):
    record = Experiment("run", 0.1 * np.arange(4), {"u": np.arange(1.0, 5.0)}, {"x": np.arange(4.0)})
    moved = to_record(micro_actuator + effect(name), record)
    assert moved.u[:, 0].tolist() == expected
    assert moved.y[:, 0].tolist() == [0, 1, 2, 3]
    assert to_record(micro_actuator, record).u[:, 0].tolist() == [1, 2, 3, 4]


@each_model
def test_input_offset_moves_the_input_wherever_it_enters(model):
    changed = model + effect("input_offset")
    values = list((changed.values | {"u0": -0.6}).values())
    for x, u in points(model):
        np.testing.assert_allclose(rates(changed, x, u, u0=-0.6), rates(model, x, u - 0.6), rtol=1e-12)
        seen = changed.system.output_function(x, u, values)
        plain = model.system.output_function(x, u - 0.6, list(model.values.values()))
        np.testing.assert_allclose(np.array(seen), np.array(plain), rtol=1e-12)


@pytest.mark.parametrize("name", AMPLITUDES)
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


ON_ACTUATOR = """
    coulomb_friction stribeck_friction lugre_friction quadratic_damping cubic_stiffness quadratic_stiffness viscoelastic_creep
    bouc_wen_hysteresis constant_load second_mode force_constant_droop winding_heating eddy_current input_saturation soft_saturation
    input_dead_zone transport_delay input_offset gain_by_sign sensor_drift sensor_lag end_stop end_stops cogging
"""
ON_CYLINDER = """
    coulomb_friction stribeck_friction lugre_friction quadratic_damping constant_load return_spring chamber_leakage choked_flow
    supply_droop position_dependent_volume valve_dead_zone input_saturation soft_saturation valve_lag transport_delay input_offset
    backlash sensor_lag end_stop end_stops cogging gain_by_sign valve_hysteresis
"""


def reversed_signals(model):
    """What a record of any plant may get wrong: the first signal of each kind under the effect's own name."""
    ports = {"reversed_input": model.inputs, "reversed_reading": model.outputs}
    for base, signals in (ports | {"late_row": model.inputs, "early_row": model.inputs}).items():
        yield base
        yield from (f"{base}_at_{signal.name}" for signal in signals[1:])


@pytest.mark.parametrize(("model", "names"), [(micro_actuator, ON_ACTUATOR), (pneumatic_cylinder, ON_CYLINDER)])
def test_each_rig_is_offered_what_it_can_hide(model, names):
    found = [entry.name for entry in applicable_effects(model)]
    assert sorted(found) == sorted([*names.split(), *reversed_signals(model)])
    assert [name for name in found if name in NAMES] == [name for name in NAMES if name in found]


@pytest.mark.rest
def test_all_candidates_of_a_model_fit_it():
    for model in (emps, silverbox, cascaded_tanks):
        expected = sorted([*model.candidates, *reversed_signals(model)])
        assert sorted(entry.name for entry in applicable_effects(model)) == expected
    assert "constant_load" not in {entry.name for entry in applicable_effects(emps + effect("constant_load"))}
    # the coil has no state of its own: neither heat nor eddy currents
    assert "winding_heating" not in {entry.name for entry in applicable_effects(micro_actuator_no_inductance)}


@pytest.mark.rest
def test_without_a_list_sites_roles_and_terms_decide():
    found = {entry.name for entry in applicable_effects(pneumatic_full)}
    assert {"coulomb_friction", "valve_lag", "valve_dead_zone", "chamber_leakage"} <= found
    # it has its own valve law and moving volumes, and its input is no amplifier's
    assert not found & {"choked_flow", "position_dependent_volume", "supply_droop", "input_dead_zone", "eddy_current"}
    on_tanks = {entry.name for entry in applicable_effects(replace(cascaded_tanks, candidates=()))}
    assert "input_offset" in on_tanks
    assert not on_tanks & {*FORCES, "valve_lag", "viscoelastic_creep"}


def test_an_unknown_candidate_lists_the_nearest():
    with pytest.raises(ModelError, match="no effect 'backlush'; did you mean 'backlash'"):
        applicable_effects(replace(emps, candidates=("backlush",)))


def test_applicable_leaves_springs_out_where_nothing_is_a_displacement():
    rotor = Model(
        "rotor",
        states=[State("w", "rad/s", role="velocity")],
        inputs=[Input("u", "N*m", role="drive")],
        outputs=[Output("w", "rad/s")],
        parameters=[Parameter("J", "kg*m**2", 1.0, (0.1, 10.0)), Parameter("B", "N*m*s/rad", 1.0, (0.1, 10.0))],
        balances=lambda x, u, p: [Balance("force", "N*m", p.J, "w", drive=u.u, viscous=-p.B * x.w)],
    )
    found = {entry.name for entry in applicable_effects(rotor)}
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


def swinging(model, period, rows=400):
    """Scales of a record of ``model`` in which every state moves."""
    rng = np.random.default_rng(5)
    x = np.cumsum(rng.normal(size=(rows, len(model.states))), axis=0)
    x *= 1e-3 / np.abs(x).max(axis=0)
    if "chamber_a" in {state.role for state in model.states}:
        x[:, 2:] = 3.5e5 + 1e7 * x[:, 2:]
    return measure_scales(model, x, rng.uniform(-2, 2, (rows, 1)), period)


def test_scales_are_peaks_terms_and_time_constants():
    x = np.array([[0.0, 0.0, 0.0], [1e-4, -0.02, 0.1], [-5e-5, 0.01, 0.3]])
    s = measure_scales(micro_actuator, x, np.array([0.0, -1.5, 1.0]), 2.5e-4)
    values = micro_actuator.values
    assert (s.displacement, s.velocity, s.current, s.input) == (1e-4, 0.02, 0.3, 1.5)
    assert s.force == pytest.approx(max(values["Kf"] * 0.3, values["K"] * 1e-4))
    assert s.balances["voltage"] == pytest.approx(values["Ra"] * 0.3)
    assert s.storage == values["M"]
    assert (s.period, s.duration) == (2.5e-4, 5e-4)
    assert s.fastest == pytest.approx(values["La"] / values["Ra"], rel=0.05)
    assert s.slowest == 5e-4  # the resonance is slower than this record is long
    # an integrator has no time constant: what is left is the gas spring
    long = swinging(pneumatic_cylinder, 0.01)
    p = pneumatic_cylinder.values
    gas = np.sqrt(2 * p["P_S"] * p["A_piston"] ** 2 / (p["M_piston"] * p["V_total"]))
    assert 0.5 < long.fastest * gas <= long.slowest * gas < 2


@pytest.mark.parametrize(
    "model", [micro_actuator, pneumatic_cylinder, emps, silverbox, cascaded_tanks], ids=lambda m: m.name
)
def test_start_values_for_a_search_are_finite_within_bounds_and_complete(model):
    s = swinging(model, 1e-3)
    for entry in applicable_effects(model, s):
        own = {q.name: q for q in entry.parameters}
        probe, grid = entry.probe(s) if entry.probe else {}, entry.grid(s) if entry.grid else {}
        assert set(probe) | set(grid) >= set(entry.amplitudes)
        assert set(probe) <= set(entry.amplitudes)
        for name, value in [*probe.items(), *((n, v) for n, values in grid.items() for v in values)]:
            low, high = own[name].bounds
            assert np.isfinite(value) and low <= value <= high, (entry.name, name, value)
        assert all(value != 0 for value in probe.values())
        # a resonance is narrow, and so is the pitch of a force that repeats: a coarser grid steps over it
        most = 16 if entry.name in ("second_mode", "cogging") else 8
        assert all(1 <= len(values) <= most and len(set(values)) == len(values) for values in grid.values())
        (model + entry).system  # noqa: B018


def test_children_start_from_every_fitted_parent():
    s = swinging(micro_actuator, 2.5e-4)
    fitted = {"coulomb_friction": {"Fc": 0.3}, "stribeck_friction": {"Fc": 0.3, "Fs": 0.5, "vs": 1e-3}}
    for child in (effect("stribeck_friction"), effect("lugre_friction")):
        own = {q.name for q in tailor_to_record(child, s).parameters}
        for parent in child.parents:
            starts = child.from_parent(fitted[parent], s)
            assert starts
            for start in starts:
                assert set(start) == own
                assert 0 < start["Fc"] <= 0.3 <= start["Fs"]
    assert {start["vs"] for start in effect("lugre_friction").from_parent(fitted["stribeck_friction"], s)} == {1e-3}


@pytest.mark.parametrize("static", [0.0, 0.05])
def test_friction_does_not_rise_with_speed(static):
    """Below Fc the level at standstill counts for nothing: what rises with speed is a drag, and has that name."""
    time = 2.5e-4 * np.arange(400)
    drive = {"time": time, "u": 2 * np.sin(2 * np.pi * 20 * time)}
    falling, coulomb = micro_actuator + effect("stribeck_friction"), micro_actuator + effect("coulomb_friction")
    runs = [gb.simulate(falling.start(Fc=0.05, Fs=static, vs=1e-3), drive), gb.simulate(coulomb.start(Fc=0.05), drive)]
    assert np.array_equal(runs[0].outputs["x"], runs[1].outputs["x"])
    rough = gb.simulate(falling.start(Fc=0.05, Fs=0.1, vs=1e-3), drive)
    assert not np.allclose(rough.outputs["x"], runs[1].outputs["x"], rtol=1e-3)


def test_a_record_bounds_the_delay_and_the_shapes():
    s = swinging(micro_actuator, 2.5e-4)
    (delay,) = tailor_to_record(effect("transport_delay"), s).parameters
    assert delay.bounds == (0.0, pytest.approx(16 * 2.5e-4))
    levels = {q.name: q for q in tailor_to_record(effect("stribeck_friction"), s).parameters}
    assert levels["Fc"].bounds == (0.0, np.inf) and levels["Fc"].value == 0.0
    speeds = effect("stribeck_friction").grid(s)["vs"]
    # Beyond the speeds of the record a fall of the friction is a level and a drag with the square of the speed.
    assert levels["vs"].bounds == (pytest.approx(min(speeds) / 1000), pytest.approx(s.velocity))
    assert max(speeds) < s.velocity
    assert levels["vs"].value in speeds


def test_hooks_that_name_what_is_not_there_list_the_nearest():
    with pytest.raises(
        ModelError, match="balance 'voltage' has no term 'resistence' to replace; did you mean 'resistance'"
    ):
        micro_actuator + Effect("e", "voltage", [], on_term=lambda x, u, p: {"voltage": {"resistence": -p.Ra * x.i}})
    with pytest.raises(ModelError, match=r"adds to a balance 'forse'; did you mean 'force'"):
        micro_actuator + Effect("e", "force", [], on_storage=lambda x, u, p: {"forse": 2})
    with pytest.raises(
        UnitError, match=r"no state 'curent' to change; did you mean 'current'|no state 'curent' to change"
    ):
        micro_actuator + Effect("e", "voltage", [], on_state=lambda x, u, p: {"curent": x.i})
    with pytest.raises(UnitError, match=r"on state 'i': has unit V, expected A"):
        micro_actuator + Effect("e", "voltage", [], on_state=lambda x, u, p: {"current": u.u})


def test_a_changed_state_is_seen_by_the_model_and_by_other_effects_but_not_by_its_own_balance():
    doubled = Effect("doubled", "voltage", [], on_state=lambda x, u, p: {"current": 2 * x.current})
    added = Effect("added", "force", [], terms=lambda x, u, p: p.force_constant * x.current)
    x, u = next(points(micro_actuator))
    twice = np.array([*x[:2], 2 * x[2]])
    expected = rates(micro_actuator, twice, u)
    expected[1] += micro_actuator.values["Kf"] * twice[2] / micro_actuator.values["M"]
    for model in (micro_actuator + doubled + added, micro_actuator + added + doubled):
        np.testing.assert_allclose(rates(model, x, u), expected)
        seen = model.system.output_function(x, u, list(model.values.values()))
        np.testing.assert_allclose(np.array(seen).ravel(), [x[0], twice[2]])


def test_storage_is_scaled_under_every_term():
    heavy = Effect("heavy", "force", [], on_storage=lambda x, u, p: {"force": 1.25})
    x, u = next(points(micro_actuator))
    expected = rates(micro_actuator, x, u)
    expected[1] /= 1.25
    np.testing.assert_allclose(rates(micro_actuator + heavy, x, u), expected)


def iso6358(upstream, downstream, b):
    """Flow of ISO 6358-1 over conductance and density, written out for flow in both directions."""
    if downstream > upstream:
        return -iso6358(downstream, upstream, b)
    ratio = downstream / upstream
    return upstream if ratio <= b else upstream * np.sqrt(1 - ((ratio - b) / (1 - b)) ** 2)


def filling_and_venting(pressure, b=0.3, ce=1.4):
    """Rates of the pressures of both chambers at ``pressure``, by flow alone, for the valve open one way and the other."""
    model = pneumatic_cylinder + effect("choked_flow")
    x = (0.0, 0.0, pressure, pressure)
    return np.array([rates(model, x, [u], b=b, ce=ce)[2:] for u in (2.0, -2.0)])


def test_choked_flow_is_iso_6358_in_both_directions():
    c, b, ce = pneumatic_cylinder.values, 0.3, 1.4
    gain = c["P_a"] * c["K2"] * c["P_S"] / (c["rho_a"] * c["V_total"])
    # below the atmosphere, between it and the supply, beyond the supply (a load pushes the piston)
    for pressure in (0.2e5, 0.9e5, 1.1e5, 3e5, 6.9e5, 7.1e5, 9e5, 30e5):
        fill, vent = iso6358(c["P_S"], pressure, b), ce * iso6358(pressure, c["P_a"], b)
        expected = 2 * gain / c["P_S"] * np.array([[fill, -vent], [-vent, fill]])
        np.testing.assert_allclose(filling_and_venting(pressure, b, ce), expected, rtol=1e-12)


@pytest.mark.parametrize("equal", ["P_S", "P_a"])
def test_choked_flow_turns_round_smoothly_where_the_pressures_are_equal(equal):
    at = pneumatic_cylinder.values[equal]
    column = 0 if equal == "P_S" else 1
    near = {step: filling_and_venting(at + step)[0, column] for step in (-2.0, -1.0, 0.0, 1.0, 2.0)}
    assert near[0.0] == 0
    assert near[1.0] < 0 < near[-1.0]
    assert near[1.0] == pytest.approx(-near[-1.0], rel=1e-4)
    slopes = [(near[k + 1.0] - near[k]) for k in (-2.0, -1.0, 0.0, 1.0)]
    assert slopes == pytest.approx([slopes[0]] * 4, rel=1e-4)


def test_choked_flow_is_near_that_of_an_ideal_nozzle():
    """St. Venant and Wantzel: isentropic flow of air chokes at a ratio of 0.528; the ellipse of ISO 6358 is within 2 % of it."""
    k, supply = 1.4, pneumatic_cylinder.values["P_S"]
    choked = (2 / (k + 1)) ** (k / (k - 1))

    def nozzle(ratio):
        return np.sqrt(ratio ** (2 / k) - ratio ** ((k + 1) / k))

    full = filling_and_venting(0.3 * supply, choked)[0, 0]
    for ratio in (0.55, 0.7, 0.9, 0.98):
        assert filling_and_venting(ratio * supply, choked)[0, 0] / full == pytest.approx(
            nozzle(ratio) / nozzle(choked), rel=0.02
        )


def test_effects_at_the_sensor_start_where_it_is_and_see_one_another_in_the_order_they_were_added():
    lagging = cascaded_tanks + effect("sensor_lag")
    start, _ = lagging.system.start_function(list(lagging.values.values()))
    assert [float(v) for v in np.array(start).ravel()] == [15.0, 5.0, 5.0]
    both = (emps + effect("backlash") + effect("sensor_lag")).start(tau_s=0.5)
    names = list(both.system.state_names)
    x = np.array([3.0, 0.0, 1.0, 0.25])  # body, its velocity, play, lag
    rate = np.array(both.system.rhs_function(x, [0.0], list(both.values.values()))).ravel()
    assert rate[names.index("y")] == pytest.approx((1.0 - 0.25) / 0.5)
    assert float(both.system.output_function(x, [0.0], list(both.values.values()))) == 0.25


def test_a_period_that_the_residual_shows_is_where_a_periodic_force_starts():
    s = swinging(micro_actuator, 2.5e-4)
    periods = {"x": s.displacement / 3.3}
    seen = s.with_periods(micro_actuator, periods)
    assert seen.at("force").pitch == seen.pitch == periods["x"]
    assert effect("cogging").grid(seen)["pitch"][0] == periods["x"]
    assert effect("cogging").grid(s)["pitch"] == effect("cogging").grid(seen)["pitch"][5:]
    low, high = effect("cogging").limits(seen)["pitch"]
    assert all(low <= pitch <= high for pitch in effect("cogging").grid(seen)["pitch"])
    assert s.with_periods(micro_actuator, {"i": 1.0}) == s  # a current is no displacement
