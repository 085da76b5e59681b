"""The missing effect is named, and nothing is named that is not missing. The rigs are simulated without greybox."""

import json
from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from greybox.base.errors import DataError
from greybox.base.values import with_code
from greybox.data.experiment import Experiment
from greybox.discovery.claims import ESTABLISHED_FROM, name_claim
from greybox.discovery.decision import Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.pipeline import discover
from greybox.estimation.fit import fit
from greybox.extensions.export.python_model import to_python
from greybox.model.effects.catalogue import effect
from greybox.model.model import Model
from greybox.model.signals import Output
from greybox.shell.project import load_model_file
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records
from tests.support.pushed_mass import MASS


def discover_hidden(rig, effects, noise, noise_given=True, colour=0.0, rows=0, among=()):
    train, test = simulate_records(rig, effects, noise, colour, rows)
    given = dict(zip((o.name for o in rig.outputs), noise, strict=False)) if noise_given else None
    chosen = [effect(name) for name in among] or None
    return discover(plain_model(rig), train, validation=test, noise=given, options=AT_REST, effects=chosen)


WELL, POOR = (2e-7, 5e-3), (2e-7,)
AIR, POSITION = (2e-4, 500.0, 500.0), (2e-4,)


def case(rig, effects, noise, others, rows=250, slow=False):
    """What was hidden, and the other effects it is offered with, the ones that look most like it; None for the whole catalogue."""
    name = f"{rig.name}-{'-'.join(effects) or 'nothing'}"
    return pytest.param(rig, effects, noise, others, rows, id=name, marks=pytest.mark.slow if slow else ())


# Slow are those that have a relative in the run of each change: another friction, stiffness, memory, limit, load or pair.
CASES = [
    case(micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, WELL, None, rows=350, slow=True),
    case(micro_actuator, {"input_offset": {"u0": 0.05}}, WELL, None, slow=True),
    case(pneumatic_cylinder, {"valve_lag": {"tau_v": 0.08}}, AIR, None, slow=True),
    case(
        micro_actuator,
        {"stribeck_friction": {"Fc": 0.04, "Fs": 0.08, "vs": 0.01}},
        WELL,
        ("coulomb_friction", "quadratic_damping"),
        slow=True,
    ),
    # From the position alone it takes more rows to tell that all of the error is its own.
    case(
        micro_actuator,
        {"cubic_stiffness": {"K3": 1e10}},
        POOR,
        ("force_constant_droop", "input_saturation"),
        rows=600,
        slow=True,
    ),
    case(micro_actuator, {"quadratic_stiffness": {"K2": 4e5}}, WELL, ("cubic_stiffness", "constant_load"), slow=True),
    case(
        micro_actuator,
        {"viscoelastic_creep": {"K1": 400.0, "tau1": 0.03}},
        WELL,
        ("bouc_wen_hysteresis", "winding_heating"),
        slow=True,
    ),
    case(
        micro_actuator,
        {"second_mode": {"m2": 4e-4, "k2": 400.0, "c2": 0.02}},
        WELL,
        ("transport_delay",),
        slow=True,
    ),
    case(
        micro_actuator, {"force_constant_droop": {"a": 2e5}}, WELL, ("cubic_stiffness", "input_saturation"), slow=True
    ),
    case(
        micro_actuator,
        {"winding_heating": {"Rth": 1.0, "tau_th": 0.1}},
        WELL,
        ("viscoelastic_creep", "input_saturation"),
        rows=350,
        slow=True,
    ),
    case(micro_actuator, {"eddy_current": {"Re": 30.0}}, WELL, ("transport_delay", "sensor_lag"), slow=True),
    case(micro_actuator, {"constant_load": {"F0": 0.05}}, WELL, ("input_offset", "sensor_drift"), slow=True),
    case(
        micro_actuator,
        {"input_saturation": {"u_max": 2.2}},
        WELL,
        ("cubic_stiffness", "force_constant_droop"),
        slow=True,
    ),
    case(micro_actuator, {"input_dead_zone": {"d": 0.15}}, WELL, ("coulomb_friction", "quadratic_damping"), slow=True),
    case(micro_actuator, {"transport_delay": {"delay": 3.75e-4}}, WELL, ("sensor_lag", "eddy_current"), slow=True),
    case(micro_actuator, {"sensor_drift": {"rate": 1e-4}}, WELL, ("constant_load", "viscoelastic_creep"), slow=True),
    case(
        pneumatic_cylinder,
        {"coulomb_friction": {"Fc": 20.0}},
        POSITION,
        ("quadratic_damping", "valve_dead_zone"),
        rows=350,
        slow=True,
    ),
    case(pneumatic_cylinder, {"chamber_leakage": {"kl": 5.0}}, AIR, ("return_spring", "input_offset")),
    case(
        pneumatic_cylinder,
        {"supply_droop": {"r": 0.06, "tau_d": 0.3}},
        AIR,
        ("input_saturation", "valve_lag"),
        rows=350,
        slow=True,
    ),
    case(pneumatic_cylinder, {"valve_dead_zone": {"d": 0.2}}, AIR, ("coulomb_friction", "input_saturation"), slow=True),
    case(pneumatic_cylinder, {"backlash": {"gap": 2e-3}}, AIR, ("coulomb_friction", "sensor_lag"), slow=True),
    # Between the pitches of the grid each refit is lost: the residual shows the pitch.
    case(
        micro_actuator,
        {"cogging": {"F": 0.05, "pitch": 3.4e-5}},
        WELL,
        ("stribeck_friction",),
        rows=600,
        slow=True,
    ),
    # Refits from afar are lost without damped steps, a weak effect beside a strong one unless it is looked for nearly absent.
    case(
        micro_actuator,
        {"bouc_wen_hysteresis": {"alpha": 60.0, "beta": 8e3, "gamma": -3e3}},
        WELL,
        ("viscoelastic_creep", "second_mode"),
        rows=600,
        slow=True,
    ),
    case(
        micro_actuator,
        {"lugre_friction": {"Fc": 0.04, "Fs": 0.07, "vs": 0.01, "s0": 9000.0, "s1": 2.0}},
        WELL,
        ("bouc_wen_hysteresis",),
        rows=600,
        slow=True,
    ),
    case(
        micro_actuator,
        {"soft_saturation": {"u_max": 5.0}},
        WELL,
        ("input_saturation", "winding_heating"),
        rows=350,
        slow=True,
    ),
    case(
        micro_actuator,
        {"cubic_stiffness": {"K3": 2e10}, "coulomb_friction": {"Fc": 1e-3}},
        WELL,
        ("input_offset", "sensor_lag"),
        rows=600,
        slow=True,
    ),
    case(
        micro_actuator,
        {"quadratic_damping": {"B2": 5.0}, "constant_load": {"F0": 0.01}},
        WELL,
        ("input_offset",),
        slow=True,
    ),
    case(micro_actuator, {}, WELL, ("cubic_stiffness", "coulomb_friction")),
]


def search_rig(rig, effects, noise, others, rows):
    """The records, the noise as it is told, and the answer."""
    train, test = simulate_records(rig, effects, noise, rows=rows)
    given = dict(zip((o.name for o in rig.outputs), noise, strict=False))
    among = None if others is None else [effect(name) for name in (*effects, *others)]
    d = discover(plain_model(rig), train, validation=test, noise=given, options=AT_REST, effects=among)
    return train, test, given, d


def assert_found(rig, effects, train, test, given, d, file):
    """The hidden effects with their constants are the answer, and the model that is written does as well as this."""
    assert d.verdict == ("named" if effects else "complete"), str(d)
    assert sorted(e["name"] for e in d.effects) == sorted(effects)
    for e in d.effects:
        for name, truth in effects[e["name"]].items():
            estimate = e["parameters"][name]
            assert abs(estimate["value"] - truth) < max(5 * estimate["std"], 0.02 * abs(truth))
    worst = max(d.holdout.values(), key=lambda g: g.before / g.floor)
    assert not effects or worst.explained_fraction > 0.9
    # What is written is read back, fitted and judged: the same errors within 1 %, and so for a user who adds the effects by hand.
    to_python(d.extended, file)
    written = next(value for value in vars(load_model_file(file)).values() if isinstance(value, Model))
    by_hand = reduce(Model.__add__, (effect(name) for name in effects), plain_model(rig))
    answer = d.extended if effects else d.base
    for model in (written, by_hand):
        again = fit(model, train, noise=given, validation=test, options=AT_REST)
        for misfits, former in ((again.misfit, answer.misfit), (again.validation.misfit, answer.validation.misfit)):
            for name, misfit in misfits.items():
                assert misfit.rmse == pytest.approx(former[name].rmse, rel=0.01), (model.title, name)


@pytest.mark.rest
@pytest.mark.parametrize(("rig", "effects", "noise", "others", "rows"), CASES)
def test_the_hidden_effect_is_told_from_its_look_alikes(rig, effects, noise, others, rows, tmp_path):
    assert_found(rig, effects, *search_rig(rig, effects, noise, others, rows), tmp_path / "model.py")


WHOLE = [
    (micro_actuator, "cubic_stiffness", {"K3": 1e10}, WELL),
    (micro_actuator, "input_dead_zone", {"d": 0.15}, WELL),
    (micro_actuator, "eddy_current", {"Re": 30.0}, WELL),
    (pneumatic_cylinder, "chamber_leakage", {"kl": 15.0}, AIR),
    (pneumatic_cylinder, "coulomb_friction", {"Fc": 20.0}, POSITION),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "name", "constants", "noise"),
    WHOLE,
    ids=lambda v: getattr(v, "name", v if isinstance(v, str) else ""),
)
def test_a_single_effect_is_named_out_of_the_whole_catalogue(rig, name, constants, noise):
    d = discover_hidden(rig, {name: constants}, noise, rows=700)
    assert d.verdict is Verdict.NAMED, str(d)
    (named,) = d.effects
    assert named["name"] == name
    for parameter, truth in constants.items():
        estimate = named["parameters"][parameter]
        assert abs(estimate["value"] - truth) < max(5 * estimate["std"], 0.02 * abs(truth))
    worst = max(d.holdout.values(), key=lambda g: g.before / g.floor)
    assert worst.explained_fraction > 0.9


def assert_complete(noise_given, colour, rows, among=()):
    d = discover_hidden(micro_actuator, {}, WELL, noise_given, colour, rows, among)
    assert d.verdict is Verdict.COMPLETE, str(d)
    assert d.effects == []
    return d


def test_a_complete_model_lists_what_could_still_be_hidden():
    d = assert_complete(True, 0.0, 700, ("cubic_stiffness", "coulomb_friction"))
    limits = {f.subject: f.values for f in with_code(d.findings, DiscoveryCode.DETECTION_LIMIT)}
    assert limits["cubic_stiffness"]["parameter"] == "K3"
    assert limits["cubic_stiffness"]["limit"] > 0
    assert [f.code for f in d.conclusion] == [DiscoveryCode.NOTHING_MISSING]


@pytest.mark.slow
@pytest.mark.parametrize(("noise_given", "colour"), [(False, 0.0), (True, 0.9), (False, 0.9)])
def test_a_complete_model_is_left_alone_whatever_the_noise(noise_given, colour):
    assert_complete(noise_given, colour, 0)


@pytest.mark.rest
def test_an_offset_and_a_load_without_the_current_are_a_tie():
    d = discover_hidden(
        micro_actuator,
        {"input_offset": {"u0": 0.02}},
        POOR,
        rows=700,
        among=("input_offset", "constant_load", "sensor_lag"),
    )
    assert d.verdict is Verdict.AMBIGUOUS, str(d)
    assert {d.effects[0]["name"], *(n for a in d.alternatives for n in a)} == {"input_offset", "constant_load"}
    (step,) = with_code(d.next_steps, DiscoveryCode.SEPARATE_FROM_RIVAL)
    assert {step.subject, step.values["rival"]} == {"input_offset", "constant_load"}


@pytest.mark.rest
def test_damping_is_told_from_its_look_alikes_and_saved_as_the_schema_says(tmp_path):
    hidden = {"quadratic_damping": {"B2": 5.0}}
    *given, d = search_rig(micro_actuator, hidden, WELL, ("coulomb_friction", "cubic_stiffness"), 250)
    assert_found(micro_actuator, hidden, *given, d, tmp_path / "model.py")
    data = json.loads(d.save(tmp_path / "discovery.json").read_text())
    assert data["effects"][0]["name"] == "quadratic_damping"
    assert set(data["effects"][0]["parameters"]["B2"]) >= {"value", "std", "unit"}
    assert set(data["gap"]["x"]) == {"before", "after", "floor", "unit", "share"}
    gap, named = data["gap"]["x"], data["effects"][0]
    assert gap["share"] == pytest.approx(1 - gap["after"] / gap["before"])
    assert named["grade"] == "established" and named["probability"] >= ESTABLISHED_FROM
    assert named["share"] == pytest.approx(gap["share"], rel=1e-3)  # everything that the only effect takes
    assert set(data["left"]["x"]) >= {"rmse", "unit", "where", "as"}
    assert data["left"]["x"]["rmse"] == gap["after"]
    assert {"verdict", "effects", "alternatives", "sites", "parameters", "gap", "story", "notes", "next_steps"} <= set(
        data
    )
    assert data["verdict"] == "named"
    assert data["policy"]["selection"]["criterion_gain"] == d.policy.selection.criterion_gain
    assert data["options"] == d.options.to_data()
    assert d.options.progressive  # as it was asked for, and not as the quick fits beside the search are
    rules = {check["rule"]: check["passed"] for check in data["checks"]}
    assert rules["clean_residual"] and rules["holdout_explained"] and rules["white_residual"]
    first = data["path"][0]
    assert (first["kind"], first["effects"], first["accepted"]) == ("add", ["quadratic_damping"], True)
    assert {finding["code"] for finding in data["findings"]} >= {"effect_named"}


def test_nothing_to_judge_by_is_refused():
    train, _ = simulate_records(micro_actuator, {}, WELL, rows=100)
    with pytest.raises(DataError, match="no validation record"):
        discover(plain_model(micro_actuator), train, validation=[])


def duffing_record(name, seed):
    """A mass on a spring that hardens, under a held random force; integrated by scipy."""
    rng = np.random.default_rng(seed)
    step, force, x = 0.1, np.repeat(rng.normal(size=60), 5), np.zeros((300, 2))
    for k in range(299):
        run = solve_ivp(
            lambda _, z, u: [z[1], u - 0.4 * z[1] - 4 * z[0] - z[0] ** 3],
            (0, step),
            x[k],
            args=(force[k],),
            rtol=1e-9,
            atol=1e-12,
        )
        x[k + 1] = run.y[:, -1]
    return Experiment(name, np.arange(300) * step, {"u": force}, {"x": x[:, 0] + 0.005 * rng.normal(size=300)})


@pytest.mark.slow
def test_of_what_does_the_same_the_simplest_is_the_answer():
    """At such small motion a hysteresis of three constants follows a cubic spring: that is no reason to say nothing."""
    mass = replace(MASS, outputs=(Output("x", "m"),)).start(B=0.6, K=3.0)
    names = ("bouc_wen_hysteresis", "cubic_stiffness", "quadratic_stiffness")
    found = discover(
        mass,
        duffing_record("one", 1),
        validation=duffing_record("two", 2),
        noise={"x": 0.005},
        effects=[effect(name) for name in names],
    )
    assert found.verdict is Verdict.NAMED
    assert [e["name"] for e in found.effects] == ["cubic_stiffness"]
    assert found.effects[0]["parameters"]["K3"]["value"] == pytest.approx(1.0, rel=0.1)
    assert name_claim(found.claims, "cubic_stiffness").equals == ("bouc_wen_hysteresis",)
