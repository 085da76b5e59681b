"""The controller studies: their parts against analytic answers, and (slow) that knowing the friction does help on both rigs."""

import importlib

import control
import numpy as np
import pytest

import greybox as gb
from fits.control import micro_actuator, page, pneumatic
from fits.control.design import channel, closest, design, margins
from fits.control.loop import Hand, Moves, closed_loop, judged, overshoot, settled
from fits.control.study import BLACK, COMPENSATED, KNOWING, PLAIN, designs_of, effects_of, grey_plant
from fits.studies.rig_twins import Actuator

ACTUATOR, CYLINDER = micro_actuator.SETTING, pneumatic.SETTING
KNOWN = (ACTUATOR.model + gb.effect("coulomb_friction")).start(Fc=0.05)


def hidden(setting):
    """The rig's model with the effects that are hidden in it."""
    model = setting.model
    for name, values in setting.hidden.items():
        model = (model + gb.effect(name)).start(**values)
    return model


@pytest.fixture(scope="module")
def designs():
    """As the study makes them, from the true constants: nothing is fitted."""
    black = gb.linearise(ACTUATOR.model, dt=ACTUATOR.sampling_time)
    stand_in = type("Black", (), {"to_control": lambda self: gb.export.to_transfer_function(channel(black, "x"))})()
    return designs_of(ACTUATOR, ACTUATOR.model, KNOWN, stand_in)


def test_what_holds_the_actuator_and_meets_its_friction(designs):
    p, found = ACTUATOR.truth, designs[COMPENSATED]
    np.testing.assert_allclose(found.x1, [1, 0, p["K"] / p["Kf"]], rtol=1e-8, atol=1e-6)
    assert found.u1 == pytest.approx(p["Ra"] * p["K"] / p["Kf"], rel=1e-9)
    np.testing.assert_allclose(found.xf, [0, 0, 1 / p["Kf"]], rtol=1e-8, atol=1e-10)  # a newton more is so much current
    assert found.uf == pytest.approx(p["Ra"] / p["Kf"], rel=1e-8)
    assert found.compensation.level(0.01) == 0.05


def test_the_cylinder_meets_friction_by_pressure_alone():
    plant, friction = grey_plant(CYLINDER, hidden(CYLINDER))
    found = design("", plant, CYLINDER.weights, CYLINDER.limit, friction)
    assert plant.nstates == 3  # the sum of the pressures is taken out
    np.testing.assert_allclose(found.xf, [0, 0, 0.5 / CYLINDER.truth["A_piston"]], rtol=1e-8, atol=1e-9)
    assert found.uf == pytest.approx(0, abs=1e-9)
    assert [friction.level(v) for v in (0.0, 10.0)] == [35.0, 25.0]


@pytest.mark.parametrize("name", [BLACK, PLAIN, COMPENSATED])
def test_the_controller_whose_margins_are_read_is_the_one_that_runs(designs, name):
    made = designs[name]
    still = made if made.compensation is None else designs[KNOWING]  # the compensation is outside the linear loop
    hand, readings = Hand(still, 0.0), 1e-8 * np.random.default_rng(0).standard_normal(60)
    ran = [hand.voltage(float(y), 0.0) for y in readings]
    linear = control.forced_response(made.controller(), U=readings).outputs
    np.testing.assert_allclose(ran, linear, atol=1e-9 * np.abs(linear).max())


def test_margins_are_where_the_loop_is_nearest_to_minus_one(designs):
    plant = channel(gb.linearise(ACTUATOR.model, dt=ACTUATOR.sampling_time), "x")
    found = margins(designs[KNOWING], gb.export.to_state_space(plant))
    loop = designs[KNOWING].loop(gb.export.to_state_space(plant))
    w = np.geomspace(10, np.pi / ACTUATOR.sampling_time, 20_000)
    curve = loop(np.exp(1j * w * ACTUATOR.sampling_time))
    assert found.stable and found.distance == pytest.approx(np.abs(1 + curve).min(), rel=1e-3)
    assert closest(designs[KNOWING], "x", ACTUATOR.sampling_time)(plant) == pytest.approx(found.distance, rel=1e-2)
    for factor, stable in ((0.98, True), (1.02, False)):  # the gain margin is where it becomes unstable
        poles = control.feedback(found.gain * factor * loop, 1).poles()
        assert bool(np.all(np.abs(poles) < 1)) is stable


def test_settling_and_overshoot_of_a_second_order_step():
    damping, t = 0.4, np.linspace(0, 30, 30_001)
    w = np.sqrt(1 - damping**2)
    error = -np.exp(-damping * t) * (np.cos(w * t) + damping / w * np.sin(w * t))
    assert overshoot(error, 1.0) == pytest.approx(np.exp(-damping * np.pi / w), rel=1e-6)
    outside = t[np.abs(error) > 0.05][-1]
    assert settled(error, 0.05, t[1]) == pytest.approx(outside + t[1])
    assert settled(error + 1, 0.05, t[1]) == np.inf and settled(0 * error, 0.05, t[1]) == 0.0
    assert overshoot(-error, -2.0) == pytest.approx(np.exp(-damping * np.pi / w) / 2, rel=1e-6)


def test_with_the_true_constants_friction_is_what_keeps_from_the_target_and_compensation_what_gets_there(designs):
    moves = Moves((20e-6, 0.0), hold=0.03, rise=0.006, band=0.5e-6)

    def run(name, effects):
        return judged(closed_loop(Actuator(ACTUATOR.truth, effects), designs[name], moves, 0.0), moves)

    smooth, stuck = run(KNOWING, {}), run(KNOWING, ACTUATOR.hidden)
    met = run(COMPENSATED, ACTUATOR.hidden)
    assert smooth.slowest < 0.01 and smooth.steady < 1e-8
    assert stuck.slowest > 0.018
    assert met.slowest < 0.0115 and met.steady < 0.25 * stuck.steady


def test_a_rig_of_the_family_has_the_effects_of_the_fit():
    best = type("Best", (), {"model": hidden(CYLINDER)})
    assert effects_of(best, best.model.values) == CYLINDER.hidden
    rig = CYLINDER.rig(best.model.values | {"f_v": 50.0}, effects_of(best, best.model.values))
    assert rig.base["f_v"] == 50.0 and rig.levels(0.0, 1.0) == (35.0, 35.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["micro_actuator", "pneumatic"])
def test_knowing_the_friction_helps(name, tmp_path):
    module = importlib.import_module(f"fits.control.{name}")
    found = module.study(module.SETTING)
    module.verdict(found)
    text = page.section("Rig", name, module.WORDS, found, tmp_path)
    assert text.count("| grey-box with it, compensated |") == 2  # at the head of one table, before a row of the other
    assert (tmp_path / "figures" / f"{name}.png").stat().st_size > 10_000
