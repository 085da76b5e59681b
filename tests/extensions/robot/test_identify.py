"""Base parameters with honest intervals, effects of joints by name, payloads: against textbook equations."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.base import DataError
from greybox.base.json_shape import to_json_data
from greybox.discovery.decision import Grade
from greybox.extensions.robot import RobotIdentification, find_base_parameters, identify_robot, read_robot
from greybox.extensions.robot.base_parameters import find_physical_constants
from greybox.extensions.robot.description import to_pseudo_inertia
from greybox.extensions.robot.motion import reconstruct_motion
from greybox.extensions.robot.regression import BlockProducts, promise
from greybox.extensions.robot.result import RigidVerdict
from greybox.extensions.robot.table import make_log
from tests.support.result_schema import strict_offences
from tests.support.robots import CENTRES, DOUBLE_PENDULUM, INERTIAS, LENGTH, MASSES, TIP, joint_log, swing, write

HIDDEN = {"viscous": (0.8, 0.0), "dry": (0.0, 0.5), "offset": (0.0, 0.2), "payload": 0.4}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> gb.robots.Robot:
    return read_robot(write(tmp_path_factory.mktemp("robot") / "double_pendulum.urdf", DOUBLE_PENDULUM))


@pytest.fixture(scope="module")
def hidden(arm: gb.robots.Robot) -> RobotIdentification:
    return identify_robot(arm, joint_log(**HIDDEN))


def base_of_textbook(payload: float) -> dict[str, float]:
    (m1, m2), (c1, c2), (i1, i2) = MASSES, CENTRES, INERTIAS
    return {
        **{"mx1": 0.0, "mx2": 0.0, "mz1": -m1 * c1 - (m2 + payload) * LENGTH, "mz2": -m2 * c2 - payload * TIP},
        **{"Iyy1": i1 + m1 * c1**2 + (m2 + payload) * LENGTH**2, "Iyy2": i2 + m2 * c2**2 + payload * TIP**2},
    }


def test_what_each_joint_has_is_named_and_nothing_else(hidden: RobotIdentification) -> None:
    named = {(e.joint, e.kind): e for e in hidden.effects}
    assert set(named) == {("shoulder", "viscous_friction"), ("elbow", "coulomb_friction"), ("elbow", "torque_offset")}
    for effect, true in zip(hidden.effects, (0.8, 0.5, 0.2), strict=True):
        assert effect.grade is Grade.ESTABLISHED
        assert abs(effect.value - true) < 4 * effect.std < 0.05 * true


def test_a_payload_is_weighed_and_placed(hidden: RobotIdentification) -> None:
    assert hidden.verdict is RigidVerdict.PAYLOAD
    assert hidden.payload.mass == pytest.approx(0.4, rel=0.02)
    assert hidden.payload.mass_interval[0] < 0.4 < hidden.payload.mass_interval[1]
    assert hidden.payload.centre[2] == pytest.approx(-TIP, abs=0.01)


def test_nothing_is_said_of_a_complete_description(arm: gb.robots.Robot) -> None:
    for seed in range(3):
        complete = identify_robot(arm, joint_log(seed))
        assert complete.effects == () and complete.payload is None and complete.verdict is RigidVerdict.AS_DESCRIBED


@pytest.mark.slow
def test_intervals_hold_the_constants_of_the_textbook(arm: gb.robots.Robot) -> None:
    inside = []
    for seed in range(12):
        found, truth = identify_robot(arm, joint_log(seed, **HIDDEN)), base_of_textbook(0.4)
        inside += [b.interval[0] < truth[b.name] < b.interval[1] for b in found.base]
    # 72 intervals, six of a record: the standard error of their share is 3 to 4 %.
    assert 0.86 < np.mean(inside) <= 1.0


def test_the_torques_are_followed_to_their_noise(hidden: RobotIdentification) -> None:
    for joint, noise in zip(hidden.joints, (0.1, 0.03), strict=True):
        assert joint.final == pytest.approx(noise * np.sqrt(1 + 0.3**2), rel=0.05) and joint.rigid > 3 * joint.final


def test_torques_that_read_too_large_are_told_from_other_links(arm: gb.robots.Robot) -> None:
    log = joint_log()
    outputs = {name: values * (1.15 if name.startswith("tau") else 1) for name, values in log.outputs.items()}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, outputs))
    assert found.verdict is RigidVerdict.SCALED
    (scaled,) = [f for f in found.findings if f.code == "robot_scaled"]
    assert scaled.values["factor"] == pytest.approx(1.15, abs=0.005)


@pytest.mark.parametrize(
    "wrong",
    [{"tau1": "tau2", "tau2": "tau1"}, {"q1": "-q1"}, {"q2": "q2+90"}],
    ids=["torques in another order", "a position of the other sign", "another zero"],
)
def test_columns_that_are_not_what_they_are_called_give_no_certainty(
    arm: gb.robots.Robot, wrong: dict[str, str]
) -> None:
    """No body is the difference: -45 kg in the place of a link of 2 kg, or a mass of nothing whose centre is 964 m away."""
    log = joint_log()
    values = {**log.outputs, "-q1": -log.outputs["q1"], "q2+90": log.outputs["q2"] + np.pi / 2}
    columns = {name: values[wrong.get(name, name)] for name in log.outputs}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, columns))
    assert found.verdict == "other than described" and found.payload is None
    assert all(e.grade is Grade.PROBABLE for e in found.effects)


def test_a_torque_that_is_noise_makes_no_other_robot(arm: gb.robots.Robot) -> None:
    log = joint_log()
    noise = 3.0 * np.random.default_rng(8).normal(size=log.rows)
    found = identify_robot(
        arm, gb.Experiment("log", log.time, {}, {**log.outputs, "tau2": log.outputs["tau2"] + noise})
    )
    assert found.joints[1].final > 0.5 * found.joints[1].torque
    assert found.verdict == "as described" and not found.effects


def test_a_torque_of_noise_alone_is_no_factor_of_the_description(arm: gb.robots.Robot) -> None:
    log, generator = joint_log(), np.random.default_rng(8)
    noise = {f"tau{k}": generator.normal(size=log.rows) for k in (1, 2)}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, {**log.outputs, **noise}))
    assert found.verdict == "other than described"
    codes = [f.code for f in found.findings]
    assert "robot_not_followed" in codes and "robot_scaled" not in codes


def test_a_torque_of_one_number_was_not_measured(arm: gb.robots.Robot, hidden: RobotIdentification) -> None:
    log = joint_log(**HIDDEN)
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, {**log.outputs, "tau2": np.zeros(log.rows)}))
    assert [f.subject for f in found.findings if f.code == "robot_axis_without_rows"] == ["elbow"]
    (viscous,) = found.effects
    assert viscous.value == pytest.approx(hidden.effects[0].value, rel=0.01)
    assert found.payload.mass == pytest.approx(0.4, rel=0.02)


def test_positions_that_are_written_more_often_than_read_are_taken_when_they_are_new(arm: gb.robots.Robot) -> None:
    log, order = joint_log(**HIDDEN), np.arange(8000)
    # One encoder is read every fourth row, the other every fifth.
    held = {f"q{k}": log.outputs[f"q{k}"][order - (order + k) % (3 + k)] for k in (1, 2)}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, {**log.outputs, **held}))
    assert [f.values["step"] for f in found.findings if f.code == "robot_read_seldom"] == [pytest.approx(0.01)]
    for effect, true in zip(found.effects, (0.8, 0.5, 0.2), strict=True):
        assert effect.grade is Grade.ESTABLISHED and abs(effect.value - true) < 4 * effect.std < 0.1 * true
    # An encoder of few counts that moves slowly stands still between them, and is read in every row.
    coarse = {n: np.round(v / 0.02) * 0.02 if n.startswith("q") else v for n, v in log.outputs.items()}
    motion = reconstruct_motion(gb.Experiment("log", log.time, {}, coarse), [1, 2])
    assert motion.step == pytest.approx(0.002)


LIFT = """<robot name="lift"><link name="base"/><link name="cage"><inertial><mass value="4"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="lift" type="prismatic"><parent link="base"/>
<child link="cage"/><axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="300" velocity="9"/></joint></robot>"""


def test_what_another_effect_does_as_well_is_not_certain(tmp_path: Path) -> None:
    """(m + Jm) a + m g: a motor of 0.5 kg, or a cage that is 0.5 kg heavier with an offset of -0.5 kg g."""
    time, q, dq, ddq = (x if x.ndim == 1 else x[:, 0] for x in swing())
    tau = 4.5 * ddq + 4 * 9.81 + 8 * dq + 0.1 * np.random.default_rng(0).normal(size=len(time))
    lift = read_robot(write(tmp_path / "lift.urdf", LIFT))
    found = identify_robot(lift, gb.Experiment("log", time, {}, {"q1": q, "tau1": tau}))
    grades = {e.kind: (e.value, e.grade, e.rival) for e in found.effects}
    assert grades["viscous_friction"][1] is Grade.ESTABLISHED
    offset, grade, rival = grades["torque_offset"]
    assert offset == pytest.approx(-0.5 * 9.81, rel=0.02) and grade is Grade.PROBABLE and rival == "motor_inertia"


def test_a_delay_of_the_torque_is_told_from_friction(arm: gb.robots.Robot) -> None:
    log = joint_log()
    late = {n: np.interp(log.time - 0.006, log.time, v) if n.startswith("tau") else v for n, v in log.outputs.items()}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, late))
    assert {e.kind for e in found.effects} == {"torque_lag"}
    assert all(e.value == pytest.approx(0.006, rel=0.2) for e in found.effects)


def test_a_velocity_that_a_filter_delays_is_brought_forward(arm: gb.robots.Robot) -> None:
    log = joint_log(**HIDDEN)
    # Encoders of 0.3 degrees, and velocities behind a filter of 20 Hz with its 8 ms.
    coarse = {n: np.round(log.outputs[n] / 0.005) * 0.005 for n in ("q1", "q2")}
    share = 1 - np.exp(-2 * np.pi * 20 * (log.time[1] - log.time[0]))
    slow = {f"d{n}": lfilter([share], [1, share - 1], np.gradient(log.outputs[n], log.time)) for n in ("q1", "q2")}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, {**log.outputs, **coarse, **slow}))
    (late,) = [f.values for f in found.findings if f.code == "robot_velocity_late"]
    # The last of the step's rows is let through at once.
    delay = (1 - share) / share * (log.time[1] - log.time[0])
    assert late["joints"] == ["shoulder", "elbow"] and late["low"] > 0.9 * delay and late["high"] < 1.1 * delay
    assert {(e.joint, e.kind) for e in found.effects} == {
        ("shoulder", "viscous_friction"), ("elbow", "coulomb_friction"), ("elbow", "torque_offset")
    }  # fmt: skip


def test_what_repeats_with_the_motion_is_one_block(arm: gb.robots.Robot) -> None:
    # Twice eight seconds of one motion, less what the filter needs at both ends.
    motion = reconstruct_motion(joint_log(), [1, 2])
    log = make_log(find_base_parameters(arm), [motion], [False], 200)
    assert log.cycle == pytest.approx(4000, abs=2) and log.blocks == 16
    # Rows a cycle apart have the same block.
    np.testing.assert_array_equal(log.labels[: len(log.labels) - log.cycle], log.labels[log.cycle :])


def test_a_description_without_inertia_is_enough(tmp_path: Path) -> None:
    bare = re.sub(r"<inertial>.*?</inertial>", "", DOUBLE_PENDULUM, flags=re.DOTALL)
    identified = identify_robot(read_robot(write(tmp_path / "bare.urdf", bare)), joint_log(**HIDDEN), physical=True)
    assert identified.verdict is RigidVerdict.OTHER and not any(b.is_open for b in identified.base)
    truth = base_of_textbook(0.4)
    assert all(abs(b.value - truth[b.name]) < 4 * b.std for b in identified.base)
    assert {e.kind for e in identified.effects} == {"viscous_friction", "coulomb_friction", "torque_offset"}


def test_the_inertia_of_motors_is_told_from_that_of_links(arm: gb.robots.Robot) -> None:
    identified = identify_robot(arm, joint_log(motor=(0.1, 0.02)))
    assert identified.verdict is RigidVerdict.AS_DESCRIBED
    shoulder, elbow = identified.effects
    assert (shoulder.joint, shoulder.kind, elbow.joint, elbow.kind) == (
        "shoulder",
        "motor_inertia",
        "elbow",
        "motor_inertia",
    )
    for effect, true in ((shoulder, 0.1), (elbow, 0.02)):
        assert effect.value == pytest.approx(true, rel=0.1)
    # The first joint's is told by the description alone: its link could have it as well.
    assert shoulder.grade is Grade.PROBABLE


def test_a_joint_that_hardly_moves_leaves_its_constants_open(arm: gb.robots.Robot) -> None:
    time, q, *_ = swing()
    still = np.column_stack([q[:, 0], 0.3 + 0 * time])
    log = joint_log()
    outputs = {**log.outputs, "q2": still[:, 1]}
    found = identify_robot(arm, gb.Experiment("log", time, {}, outputs))
    assert [j.joint for j in found.joints] == ["shoulder"]
    assert {"mz2", "Iyy2"} <= {b.name for b in found.base if b.is_open}
    assert "bring link" in " ".join(map(str, found.findings))


def test_an_axis_that_is_not_logged_is_held(arm: gb.robots.Robot) -> None:
    log = joint_log()
    only = {name: log.outputs[name] for name in ("q1", "tau1")}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, only))
    assert [f.subject for f in found.findings if f.code == "robot_axis_held"] == ["elbow"]
    with pytest.raises(DataError, match="no axis with both position and torque"):
        identify_robot(arm, gb.Experiment("log", log.time, {}, {"x": log.outputs["q1"]}))


def test_the_plant_is_fitted_as_any_other(arm: gb.robots.Robot, tmp_path: Path) -> None:
    plant = gb.robot(write(tmp_path / "a.urdf", DOUBLE_PENDULUM))
    log = joint_log(**HIDDEN)
    record = gb.Experiment(
        "log", log.time, {n: log.outputs[n] for n in ("q1", "q2")}, {n: log.outputs[n] for n in ("tau1", "tau2")}
    )
    fit = gb.fit(plant, record)
    truth = base_of_textbook(0.4)
    # At both ends of a record, where the filter swings in, its torques are less exact.
    for name, true in truth.items():
        assert fit.parameters[name].value == pytest.approx(true, abs=0.05)
    assert fit.parameters["coulomb_friction2"].value == pytest.approx(0.5, abs=0.05)
    assert len(plant.parameters) == len(find_base_parameters(arm).names) + 6


def test_links_that_a_body_can_have_are_found_and_their_cost_is_said(arm: gb.robots.Robot) -> None:
    (said,) = [
        f for f in identify_robot(arm, joint_log(**HIDDEN), physical=True).findings if f.code == "robot_physical"
    ]
    for constants in said.values["links"].values():
        assert np.linalg.eigvalsh(to_pseudo_inertia(np.array(constants))).min() >= 0
    # The truth is such a pair of links: it costs hardly anything.
    assert 0 <= said.values["increase"] < 0.01


def test_constants_that_no_body_has_are_refused_at_a_cost(arm: gb.robots.Robot) -> None:
    base = find_base_parameters(arm)
    beta = base.values.copy()
    # An inertia of the second link that is smaller than its first moment allows: m2 c2 = 0.3 at m2 >= 0 has no such body.
    beta[base.names.index("Iyy2")] = -0.05
    theta, growth = find_physical_constants(base, beta, np.eye(len(beta)) / 0.01**2)
    assert growth > 25.0
    assert all(np.linalg.eigvalsh(to_pseudo_inertia(link)).min() >= -1e-12 for link in theta.reshape(-1, 10))


def test_a_prior_holds_what_the_record_leaves_open(arm: gb.robots.Robot) -> None:
    log = joint_log(rows=1500)
    free, held = (identify_robot(arm, log, prior=prior) for prior in (np.inf, 0.001))
    assert all(h.std <= 1.05 * f.std for f, h in zip(free.base, held.base, strict=True))
    assert min(h.std / f.std for f, h in zip(free.base, held.base, strict=True)) < 0.5
    truth = base_of_textbook(0.0)
    assert all(abs(b.value - truth[b.name]) < 4 * b.std for b in held.base)


def test_what_a_column_would_do_is_what_it_does() -> None:
    generator = np.random.default_rng(0)
    Z = generator.normal(size=(10, 50, 5))
    Z[:, :, -1] += 2 * Z[:, :, 2] + Z[:, :, 0]
    sums = BlockProducts(np.einsum("kri,krj->kij", Z, Z), np.full(10, 50.0))
    promised = promise(sums, [0, 1], [2, 3])
    rows, torque = Z.reshape(500, 5)[:, :4], Z.reshape(500, 5)[:, 4]
    for k, column in enumerate((2, 3)):
        left = [np.linalg.lstsq(rows[:, c], torque, rcond=None)[1][0] for c in ([0, 1], [0, 1, column])]
        assert promised.decrease[k] == pytest.approx(left[0] - left[1])
        assert promised.value[k] == pytest.approx(np.linalg.lstsq(rows[:, [0, 1, column]], torque, rcond=None)[0][2])
    fit = sums.take([0, 1, 2]).fit()
    without_first = np.linalg.lstsq(rows[50:, :3], torque[50:], rcond=None)[0]
    np.testing.assert_allclose(fit.without[0], without_first, rtol=1e-7)


def test_intervals_widen_where_few_blocks_hold_what_is_known() -> None:
    generator = np.random.default_rng(3)
    sizes = np.array([4.0, 3.0, 3.0, *[0.3] * 13])
    inside, quantiles = [], []
    for _ in range(400):
        x = sizes[:, None] * generator.normal(size=(16, 30))
        Z = np.stack([x, 2 * x + generator.normal(size=x.shape)], axis=2)
        fit = BlockProducts(np.einsum("kri,krj->kij", Z, Z), np.full(16, 30.0)).fit()
        inside.append(abs(fit.x[0] - 2) < fit.quantile[0] * fit.std[0])
        quantiles.append(fit.quantile[0])
    # Three blocks hold what there is: some two degrees of freedom, and not fifteen, whose quantile is 2.13.
    assert 3.2 < np.median(quantiles) < 5.5
    assert 0.92 < np.mean(inside) < 0.985
    even = np.tile(np.array([[1.0, 0.5], [0.5, 2.0]]), (16, 1, 1))
    assert BlockProducts(even, np.full(16, 30.0)).fit().quantile[0] == pytest.approx(2.131, abs=1e-3)


def test_its_file_is_as_the_schema_says(hidden: RobotIdentification) -> None:
    assert strict_offences(to_json_data(hidden), RobotIdentification) == []


def test_a_weighed_pendulum_has_dry_friction_and_torques_that_read_too_large(shared_data: Path, tmp_path: Path) -> None:
    """T-Motor AK80-6 with 0.676 kg at 0.45 m, weighed: m c = 0.304 kg m; the torque reads 1.1 to 1.2 too large."""
    text = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 -0.45"/><mass value="0.676"/>
      <inertia ixx="0.0101" iyy="0.0101" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="pivot" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"""
    logs = []
    for name in ("ddp", "direct_collocation"):
        time, q, dq, tau = np.genfromtxt(
            shared_data / f"known/ak80_pendulum/{name}.csv", delimiter=",", skip_header=1
        ).T
        logs.append(gb.Experiment(name, time, {}, {"q1": q, "dq1": dq, "tau1": tau}))
    found = identify_robot(read_robot(write(tmp_path / "pendulum.urdf", text)), logs)
    (dry,) = [e for e in found.effects if e.kind == "coulomb_friction"]
    assert dry.grade is Grade.ESTABLISHED and 0.1 < dry.value < 0.3
    moment = next(b for b in found.base if b.name == "mz1")
    assert 1.0 < moment.value / -0.3042 < 1.25
