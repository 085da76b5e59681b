"""Which effects are tried, which are left out and why."""

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from fits.studies.measured_rigs import falling_ball, pendulum, rotor
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.discovery.candidates import failed_candidates, family_of, list_candidates
from greybox.discovery.execution import NOT_SIMULATED, FailureLog, SearchStage
from greybox.discovery.findings import DiscoveryCode as Code
from greybox.discovery.problem import MAX_SUBSTEPS, UNSTABLE_FACTOR, DiscoveryProblem
from greybox.estimation.check import check
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox
from tests.support.fake_candidates import toy_effect
from tests.support.hidden_rigs import AT_REST, simulate_records
from tests.support.pushed_mass import MASS


@pytest.fixture(scope="module")
def scales():
    record = {"time": [k * 1e-3 for k in range(50)], "u": [0.1] * 50}
    run = gb.simulate(silverbox, record)
    states = [[run.states[s.name][k] for s in silverbox.all_states] for k in range(50)]
    return gb.effects.measure_scales(silverbox, np.array(states), np.full((50, 1), 0.1), 1e-3)


def test_each_effect_that_is_not_tried_has_its_reason(scales):
    listed = list_candidates(silverbox + gb.effect("cubic_stiffness"), scales, FailureLog(), without=["input_offset"])
    names = {e.name for e in listed.effects}
    assert "quadratic_stiffness" in names
    assert not names & set(listed.not_tried)
    codes = {name: finding.code for name, finding in listed.not_tried.items()}
    assert codes["input_offset"] == Code.EFFECT_LEFT_OUT
    assert codes["cubic_stiffness"] == Code.EFFECT_PRESENT
    assert codes["winding_heating"] == Code.NO_PLACE
    assert "voltage" in listed.not_tried["winding_heating"].values["reason"]
    bases = {name.partition("_at_")[0] for name in names}
    assert {e.name for e in gb.effects.CATALOGUE} <= bases | set(codes)


@pytest.mark.parametrize("is_uniform", [True, False])
def test_what_needs_uniform_sampling_is_not_tried_on_records_without_it(scales, is_uniform):
    listed = list_candidates(replace(silverbox, candidates=()), scales, FailureLog(), is_uniform=is_uniform)
    uneven = {name for name, finding in listed.not_tried.items() if finding.code == Code.NEEDS_UNIFORM_SAMPLING}
    assert uneven == (set() if is_uniform else {"band_limited_input"})
    assert ("band_limited_input" in {e.name for e in listed.effects}) is is_uniform


def test_a_model_may_name_its_candidates(scales):
    few = replace(silverbox, candidates=("cubic_stiffness",))
    listed = list_candidates(few, scales, FailureLog())
    # Beside what the plant may lack, the record may have a sign or a row wrong.
    assert [e.name for e in listed.effects] == [
        "cubic_stiffness",
        "reversed_input",
        "late_row",
        "early_row",
        "reversed_reading",
    ]
    assert listed.not_tried["quadratic_stiffness"].code == Code.NOT_A_CANDIDATE


def test_what_the_rig_cannot_have_is_not_tried(scales):
    free = replace(silverbox, candidates=(), lacks=("spring", "rubber"))
    listed = list_candidates(free, scales, FailureLog())
    out = {name: finding.values for name, finding in listed.not_tried.items() if finding.code == Code.PART_MISSING}
    assert {"cubic_stiffness", "quadratic_stiffness", "viscoelastic_creep"} <= set(out)
    assert out["viscoelastic_creep"] == {"part": "rubber", "reason": "told"}
    assert not {e.name for e in listed.effects} & set(out)
    # Who gives effects expects them.
    given = list_candidates(free, scales, FailureLog(), effects=[gb.effect("cubic_stiffness")])
    assert [e.name for e in given.effects] == ["cubic_stiffness"]


def test_effects_of_ones_own_are_tried_beside_what_is_possible(scales):
    rig = replace(silverbox, candidates=(), lacks=("spring", "rubber"))
    own = [replace(gb.effect("constant_load"), name="leaning"), replace(gb.effect("input_offset"), source="mine")]
    listed = list_candidates(rig, scales, FailureLog(), beside=own)
    assert {"leaning", "input_offset"} <= {e.name for e in listed.effects}
    assert [e.source for e in listed.effects if e.name == "input_offset"] == ["mine"]
    assert listed.not_tried["cubic_stiffness"].code == Code.PART_MISSING


def test_beside_a_list_of_the_model_only_what_is_said_rules_out(scales):
    few = replace(silverbox, candidates=("cubic_stiffness", "coulomb_friction"), lacks=("contact",))
    names = [e.name for e in list_candidates(few, scales, FailureLog()).effects]
    assert "cubic_stiffness" in names and "coulomb_friction" not in names


@pytest.mark.rest
def test_without_a_list_of_its_own_nothing_is_left_out_by_one():
    """`check` shows a place for friction that differs by direction; two candidates together are exactly that."""
    record = {"time": [k * 1e-1 for k in range(50)], "u": [0.1] * 50}
    run = gb.simulate(MASS, record)
    states = [[run.states[s.name][k] for s in MASS.all_states] for k in range(50)]
    scales = gb.effects.measure_scales(MASS, np.array(states), np.full((50, 1), 0.1), 0.1)
    assert not MASS.candidates
    listed = list_candidates(MASS, scales, FailureLog())
    placed = {p.name.partition("_at_")[0] for p in check(MASS).placements if p.effect is not None}
    tried = {e.name.partition("_at_")[0] for e in listed.effects}
    assert "asymmetric_friction" in placed and "asymmetric_friction" not in tried
    assert Code.NOT_A_CANDIDATE not in {finding.code for finding in listed.not_tried.values()}
    assert set(listed.not_tried["viscous_damping"].values["constants"]) == {"B"}
    for name in placed - tried - {"viscous_damping"}:  # each of the others is told with what is tried in its stead
        assert listed.not_tried[name].code == Code.TRIED_AS_OTHERS
        assert set(listed.not_tried[name].values["others"]) <= tried


def list_for(model):
    """What is tried on a model, in ten rows at rest."""
    states = np.ones((10, 1)) * [s.start if isinstance(s.start, float) else 0.0 for s in model.all_states]
    scales = gb.effects.measure_scales(model, states, np.ones((10, len(model.inputs))), 0.01)
    listed = list_candidates(model, scales, FailureLog())
    return {e.name for e in listed.effects}, listed.not_tried


def rooms(count):
    """Rooms in a row: the first is heated, the last loses heat to the outside."""
    rooms = range(1, count + 1)

    def balances(x, u, p):
        walls = {k: p[f"h_{k}"] * (x[f"T{k}"] - (x[f"T{k + 1}"] if k < count else p.Ta)) for k in rooms}
        return [
            Balance(
                *(f"room_{k}", "W", p[f"C_{k}"], f"T{k}"),
                **({"heater": u.P} if k == 1 else {"wall": walls[k - 1]}),
                out=-walls[k],
            )
            for k in rooms
        ]

    return Model(
        "rooms",
        states=[State(f"T{k}", "K", 293.0) for k in rooms],
        inputs=[Input("P", "W")],
        outputs=[Output(f"T{k}", "K") for k in rooms],
        parameters=[
            *(Parameter(f"C_{k}", "J/K", 5e4, (1e3, 1e6)) for k in rooms),
            *(Parameter(f"h_{k}", "W/K", 20.0, (1.0, 1e3)) for k in rooms),
            Parameter("Ta", "K", 283.0, fixed=True),
        ],
        balances=balances,
    )


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    ("model", "tried", "taken", "as_others"),
    [
        # Written by hand: w' = kt (1 + g) u - b w - c is the same with kt (1 + g) in the place of kt.
        (
            rotor(),
            set(),
            {
                "input_gain": {"kt"},
                "sensor_gain": {"kt", "c"},
                "clock_skew": {"kt", "b", "c"},
                "viscous_damping": {"b"},
            },
            {},
        ),
        # J w' = (1 + g) tau - m g l sin(q): all of J, m g l and b over 1 + g. The sine is the scale of the sensor.
        (
            pendulum(),
            {"sensor_gain"},
            {"input_gain": {"J", "mgl", "b"}, "clock_skew": {"J", "b"}, "viscous_damping": {"b"}},
            {},
        ),
        # With J and m g l known the torque has a scale, and so has time: sqrt(m g l / J).
        (pendulum().fix("J", "mgl"), {"input_gain", "sensor_gain", "clock_skew"}, {}, {}),
        (pendulum().prior(J=(0.147, 0.003), mgl=(2.98, 0.03)), {"input_gain", "sensor_gain", "clock_skew"}, {}, {}),
        # h'' = -g: (1 + e)^2 on g is what a scale of the height does.
        (falling_ball(), {"sensor_gain", "viscous_damping"}, {}, {"clock_skew": {"sensor_gain"}}),
        # One heated room: what it loses has a constant already, and an offset of the heater is a gain from elsewhere.
        (rooms(1), set(), {"heat_loss": {"h_1"}}, {"heat_gain": {"input_offset"}}),
        # The second one is heated through the wall alone, and the first loses nothing to the outside.
        (
            rooms(2),
            {"heat_loss", "heat_gain_at_room_2"},
            {"heat_loss_at_room_2": {"h_2"}},
            {"heat_gain": {"input_offset"}},
        ),
    ],
    ids=["rotor", "pendulum", "known pendulum", "weighed pendulum", "falling ball", "room", "rooms"],
)
def test_a_scale_that_the_constants_can_take_is_not_tried(model, tried, taken, as_others):
    names, not_tried = list_for(model)
    assert tried <= names and not names & {*taken, *as_others}
    for name, constants in taken.items():
        assert not_tried[name].code == Code.TAKEN_BY_CONSTANTS and set(not_tried[name].values["constants"]) == constants
    for name, others in as_others.items():
        assert not_tried[name].code == Code.TRIED_AS_OTHERS and set(not_tried[name].values["others"]) == others


def test_a_scale_that_was_asked_for_and_cannot_be_told_is_refused_with_the_constants_that_take_it(scales):
    with pytest.raises(ModelError, match="no record tells it from other values of kt"):
        list_candidates(rotor(), scales, FailureLog(), [gb.effect("input_gain")])


def test_an_effect_that_cannot_be_made_ready_is_out(scales):
    def probe(scales):
        raise ZeroDivisionError("no motion")

    broken = replace(toy_effect("broken"), grid=probe)
    failures = FailureLog()
    listed = list_candidates(micro_actuator, scales, failures, [broken, toy_effect("whole")])
    assert [e.name for e in listed.effects] == ["whole"]
    finding = failed_candidates([broken], failures, ())["broken"]
    assert finding.code == Code.CANDIDATE_FAILED
    assert "no motion" in finding.values["reason"]


def test_an_unknown_name_to_leave_out_is_refused(scales):
    with pytest.raises(ModelError, match="coulomb_friction"):
        list_candidates(micro_actuator, scales, FailureLog(), without=["coulomb_frction"])


def test_a_family_is_all_that_contain_one_another():
    effects = [toy_effect("a"), toy_effect("b", "a"), toy_effect("c", "b"), toy_effect("other")]
    assert family_of("b", effects) == ("a", "b", "c")
    assert family_of("other", effects) == ("other",)
    assert {"stribeck_friction", "lugre_friction"} <= set(family_of("coulomb_friction"))


def test_the_reason_of_a_failure_tells_an_overflow_from_an_error():
    failures = FailureLog()
    failures.add(SearchStage.REFIT, ("a",), NOT_SIMULATED)
    failures.add(SearchStage.REFIT, ("b",), "the delay needs equal intervals")
    failures.add(SearchStage.REFIT, ("c", "d"), "beside another effect")
    failures.add(SearchStage.HOLDOUT, ("e",), "not on other records")
    effects = [toy_effect(name) for name in "abcde"]
    codes = {name: finding.code for name, finding in failed_candidates(effects, failures, ()).items()}
    assert codes == {"a": Code.CANDIDATE_NOT_SIMULATED, "b": Code.CANDIDATE_FAILED}
    assert failed_candidates(effects, failures, {"b"}).keys() == {"a"}


def test_a_stiff_candidate_is_tried_with_a_bounded_number_of_steps(monkeypatch):
    train, _ = simulate_records(micro_actuator, {}, (2e-7, 5e-3), rows=100)
    problem = DiscoveryProblem(micro_actuator, (train,), {"x": 2e-7, "i": 5e-3}, (), AT_REST)
    stiff = (micro_actuator + gb.effect("cubic_damping")).bound(B=(0.0, 1e10)).start(B=1e9)
    tried = []
    monkeypatch.setattr(gb.discovery.problem, "_rank_starts", lambda p, *_: tried.append(p.step.substeps) or [])
    assert problem.refit_best(stiff, [stiff.values]) is None
    assert tried[:2] == [MAX_SUBSTEPS, UNSTABLE_FACTOR * MAX_SUBSTEPS]


def test_a_candidate_that_does_not_run_says_where_why_and_from_which_start():
    train, _ = simulate_records(micro_actuator, {}, (2e-7, 5e-3), rows=100)
    problem = DiscoveryProblem(micro_actuator, (train,), {"x": 2e-7, "i": 5e-3}, (), AT_REST)
    wild = micro_actuator + gb.effect("cubic_stiffness")
    name = next(n for n in wild.values if n not in micro_actuator.values)
    model = wild.bound(**{name: (-1e30, 1e30)}).start(**{name: -1e25})
    assert problem.refit_best(model, [model.values]) is None
    (reason,) = (problem.failures.of_single_effects()[e.name] for e in model.effects)
    assert f"from {name} = -1e+25" in reason and "experiment 1 fails at t = " in reason and "--without" in reason
