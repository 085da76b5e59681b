"""The effects of the benchmark rigs, on records whose answer is known; and the studies on the measured ones."""

import numpy as np
import pytest

from fits import cascaded_tanks_discovery, emps_discovery, silverbox_discovery
from fits.studies.real_page import arguments
from greybox import Experiment, FitOptions, fit, simulate
from greybox.model.effects.catalogue import applicable_effects, effect
from greybox.model.signals import NamedValues
from greybox.simulation.records import to_record
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from models.silverbox import silverbox

NEW = {
    "displacement_damping",
    "cubic_damping",
    "directional_damping",
    "upper_overflow",
    "lower_overflow",
    "reading_curve",
    "sensor_saturation",
    "linear_input",
    "band_limited_input",
}


def rates(model, x, u, **values):
    return np.array(model.system.rhs_function(x, u, list((model.values | values).values()))).ravel()


@pytest.mark.parametrize(
    ("name", "constant", "force"),
    [
        ("displacement_damping", "D2", lambda a, x, v: -a * x**2 * v),
        ("cubic_damping", "B3", lambda a, x, v: -a * v**3),
        ("directional_damping", "Ba", lambda a, x, v: -a * abs(v)),
    ],
)
@pytest.mark.parametrize("point", [(0.7, 1.3), (0.7, -1.3), (-0.4, 0.0)])
def test_damping_is_the_hand_formula(name, constant, force, point):
    model = silverbox + effect(name)
    added = rates(model, point, [0.2], **{constant: 0.37}) - rates(silverbox, point, [0.2])
    np.testing.assert_allclose(
        added, [0.0, force(0.37, *point)], rtol=1e-9, atol=1e-10 * abs(rates(silverbox, point, [0.2])).max()
    )


def test_water_that_runs_over_falls_into_the_lower_tank_by_its_share():
    model = cascaded_tanks + effect("upper_overflow") + effect("lower_overflow")
    own = {"ko": 0.2, "edge": 6.0, "share": 0.25, "lower_overflow.ko": 0.5, "lower_overflow.edge": 9.0}
    over = rates(model, [8.0, 10.0], [1.0], **own) - rates(cascaded_tanks, [8.0, 10.0], [1.0])
    spilt = 0.2 * (8.0 - 6.0)
    # the tanks have the cross-sections that their common pipe shows: what lowers one by k1 raises the other by k2
    k1, k2 = cascaded_tanks.values["k1"], cascaded_tanks.values["k2"]
    np.testing.assert_allclose(over, [-spilt, 0.25 * spilt * k2 / k1 - 0.5 * (10.0 - 9.0)], rtol=1e-12)
    below = rates(model, [5.9, 8.9], [1.0], **own)
    np.testing.assert_allclose(below, rates(cascaded_tanks, [5.9, 8.9], [1.0]), rtol=1e-12)


def test_a_curved_reading_is_anchored_at_both_ends_and_a_sensor_ends():
    curve, end = effect("reading_curve"), effect("sensor_saturation")
    p = NamedValues("parameter", {"y0": 1.5, "bow": 0.4, "full": 10.0, "y_max": 7.0, "side": 1.0})
    assert [curve.on_output(level, None, None, p) for level in (0.0, 10.0)] == [1.5, 10.0]
    assert curve.on_output(5.0, None, None, p) == pytest.approx(5.0 + 0.75 - 0.4 * 2.5)
    assert [float(end.on_output(level, None, None, p)) for level in (5.0, 9.0)] == [5.0, 7.0]
    lower = NamedValues("parameter", {"y_max": 7.0, "side": -1.0})
    assert [float(end.on_output(level, None, None, lower)) for level in (5.0, 9.0)] == [7.0, 9.0]


@pytest.mark.parametrize(("name", "hold"), [("linear_input", "first"), ("band_limited_input", "band-limited")])
def test_an_effect_says_what_the_input_does_between_samples(name, hold):
    t = np.arange(200) * 1e-3
    held = Experiment("held", t, {"u": np.sin(900 * t)}, {})
    seen, expected = to_record(silverbox + effect(name), held), to_record(silverbox, held.with_hold(hold))
    np.testing.assert_array_equal(seen.u, expected.u)
    assert (seen.is_linear.tolist(), seen.rows_per_sample) == (expected.is_linear.tolist(), expected.rows_per_sample)
    moved = simulate(silverbox + effect(name), held).outputs["y"]
    np.testing.assert_array_equal(moved, simulate(silverbox, held.with_hold(hold)).outputs["y"])
    assert np.abs(moved - simulate(silverbox, held).outputs["y"]).max() > 0.1 * np.abs(moved).max()


def test_the_two_rigs_do_not_take_the_effects_of_the_benchmarks():
    for rig in (micro_actuator, pneumatic_cylinder):
        assert not NEW & {e.name for e in applicable_effects(rig)}
    for plant, own in (
        (silverbox, {"displacement_damping", "cubic_damping", "linear_input", "band_limited_input"}),
        (emps, {"directional_damping", "linear_input"}),
        (cascaded_tanks, {"upper_overflow", "lower_overflow", "reading_curve", "sensor_saturation", "linear_input"}),
    ):
        assert NEW & {e.name for e in applicable_effects(plant)} == own


def test_friction_that_differs_by_direction_comes_back_from_arcs():
    """Truth by an independent solver: viscous friction of two values, piece by piece in closed form."""
    from scipy.integrate import solve_ivp

    mass, gain, forward, backward, period = 95.0, 35.15065, 150.0, 230.0, 5e-3
    t = np.arange(1200) * period
    u = 2.5 * np.sign(np.sin(2 * np.pi * t / 1.7))

    def moved(_, x, force):
        return [x[1], (force - (forward if x[1] > 0 else backward) * x[1]) / mass]

    q, x = [0.0], np.array([0.0, 0.02])
    for force in gain * u[:-1]:
        x = solve_ivp(moved, (0.0, period), x, args=(force,), rtol=1e-9, atol=1e-12).y[:, -1]
        q.append(float(x[0]))
    record = Experiment.from_arrays(t, {"u": u}, {"q": np.array(q)})
    found = fit(emps + effect("directional_damping"), record, noise={"q": 1e-6}, options=FitOptions(arc_length=1.5))
    assert found.parameters["M"].value == pytest.approx(mass, rel=1e-4)
    assert found.parameters["Fv"].value == pytest.approx((forward + backward) / 2, rel=1e-4)
    assert found.parameters["Ba"].value == pytest.approx((forward - backward) / 2, rel=1e-3)


def test_the_studies_say_what_they_need(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fits", str(tmp_path)])
    with pytest.raises(SystemExit) as stopped:
        arguments("emps_discovery", *emps_discovery.FILES)
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("usage: python -m fits.emps_discovery [-h] [--output DOCS] FOLDER\n")
    assert "has no train.csv, test.csv; give the folder of these records" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("module", "folder", "told"),
    [
        (silverbox_discovery, "silverbox", "these do not tell the member"),
        (emps_discovery, "emps", "**The classical offset imitated friction that differs by direction.**"),
        (cascaded_tanks_discovery, "cascaded_tanks", "they form an ambiguity set"),
    ],
)
def test_what_is_missing_is_found_on_measured_records(shared_data, module, folder, told):
    done = module.study(shared_data / folder)
    module.verdict(done)
    assert told in "\n".join(module.section(done))
