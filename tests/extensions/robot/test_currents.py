"""Currents in the place of torques: what they tell, what closes the rest, and what is said of either."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base import DataError
from greybox.discovery.decision import Grade
from greybox.extensions.robot import Robot, identify_robot, read_robot
from greybox.extensions.robot.result import RigidVerdict
from tests.support.robots import DOUBLE_PENDULUM, joint_log, swing, write

# What one ampere gives, the second motor with its leads exchanged.
CONSTANTS = np.array([2.5, -0.6])
HIDDEN = {"viscous": (0.8, 0.0), "dry": (0.0, 0.5), "offset": (0.0, 0.2)}


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return read_robot(write(tmp_path_factory.mktemp("robot") / "double_pendulum.urdf", DOUBLE_PENDULUM))


def as_currents(log: gb.Experiment, axes: tuple[int, ...] = (1, 2), name: str = "log") -> gb.Experiment:
    taus = {f"tau{k}": (f"i{k}", CONSTANTS[k - 1]) for k in axes}
    columns = {taus[n][0] if n in taus else n: v / taus[n][1] if n in taus else v for n, v in log.outputs.items()}
    return gb.Experiment(name, log.time, {}, columns)


def assert_hidden(found: gb.robots.RobotIdentification) -> None:
    named = {(e.joint, e.kind): e for e in found.effects}
    truth = {("shoulder", "viscous_friction"): 0.8, ("elbow", "coulomb_friction"): 0.5, ("elbow", "torque_offset"): 0.2}
    assert set(named) == set(truth)
    for key, true in truth.items():
        assert named[key].grade is Grade.ESTABLISHED and abs(named[key].value - true) < 4 * named[key].std < 0.1 * true


def test_free_constants_have_the_level_of_the_description_and_it_is_said(arm: Robot) -> None:
    found = identify_robot(arm, as_currents(joint_log(**HIDDEN)))
    assert found.verdict is RigidVerdict.AS_DESCRIBED
    for constant, true in zip(found.torque_constants, CONSTANTS, strict=True):
        assert constant.unit == "N*m/A" and abs(constant.value - true) < 4 * constant.std < 0.05 * abs(true)
    low, high = found.torque_constants[1].ratio_interval
    assert low < CONSTANTS[1] / CONSTANTS[0] < high
    assert_hidden(found)
    assert "one known constant" in " ".join(map(str, found.findings))


JAW = """<link name="jaw"><inertial><origin xyz="0 -0.03 0"/><mass value="0.02"/>
<inertia ixx="6e-6" iyy="2e-6" izz="5e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="gripper" type="revolute"><parent link="lower"/><child link="jaw"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="9"/></joint></robot>"""


def test_a_drive_that_moves_little_beside_its_friction_keeps_a_constant(tmp_path: Path) -> None:
    """Zero solves ``Y beta + effects = K i`` of such a joint as well: it is taken as those of the others, and nothing is certain."""
    arm = read_robot(write(tmp_path / "arm.urdf", DOUBLE_PENDULUM.replace("</robot>", JAW)))
    log, generator = joint_log(), np.random.default_rng(5)
    q, dq, ddq = (np.column_stack([x, y[:, 0]]) for x, y in zip(swing()[1:], swing(seed=9)[1:], strict=True))
    tau = gb.robots.RigidBody(arm).compute_torques(q, dq, ddq) + [0.8, 0.4, 0.03] * dq + [0.5, 0.3, 0.05] * np.sign(dq)
    current = (tau + [0.05, 0.05, 0.004] * generator.normal(size=tau.shape)) / 1.1
    columns = {f"{s}{k + 1}": x[:, k] for s, x in (("q", q), ("i", current)) for k in range(3)}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, columns))
    assert [c.joint for c in found.torque_constants] == ["shoulder", "elbow"]
    assert [f.values["joints"] for f in found.findings if f.code == "robot_constant_untold"] == [["gripper"]]
    dry = next(e for e in found.effects if (e.joint, e.kind) == ("gripper", "coulomb_friction"))
    assert dry.grade is Grade.PROBABLE and 0.02 < dry.value < 0.1
    assert found.verdict is RigidVerdict.AS_DESCRIBED
    elbow = next(e for e in found.effects if (e.joint, e.kind) == ("elbow", "coulomb_friction"))
    assert elbow.grade is Grade.ESTABLISHED and abs(elbow.value - 0.3) < 4 * elbow.std


def test_currents_without_a_sign_give_no_certainty(arm: Robot) -> None:
    log = as_currents(joint_log(**HIDDEN))
    unsigned = {n: np.abs(v) if n.startswith("i") else v for n, v in log.outputs.items()}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, unsigned))
    assert found.verdict is RigidVerdict.OTHER and not [e for e in found.effects if e.grade is Grade.ESTABLISHED]
    assert "robot_not_followed" in [f.code for f in found.findings]


def test_one_known_constant_or_one_torque_closes_the_level(arm: Robot) -> None:
    log = joint_log(payload=0.4, **HIDDEN)
    known = identify_robot(arm, as_currents(log), torque_constants={"shoulder": 2.5})
    torque = identify_robot(arm, as_currents(log, axes=(2,)))
    for found in (known, torque):
        (elbow,) = found.torque_constants
        assert abs(elbow.value + 0.6) < 4 * elbow.std < 0.03
        low, high = found.payload.mass_interval
        assert low < 0.4 < high and high - low < 0.1
        assert "robot_torque_level" not in [f.code for f in found.findings]
        assert_hidden(found)


def test_a_payload_that_was_weighed_closes_the_level(arm: Robot) -> None:
    logs = [as_currents(joint_log(**HIDDEN)), as_currents(joint_log(1, payload=0.4, **HIDDEN), name="loaded")]
    found = identify_robot(arm, logs, payloads={"loaded": 0.4})
    for constant, true in zip(found.torque_constants, CONSTANTS, strict=True):
        assert constant.interval[0] < true < constant.interval[1]
        # The level carries this error alone: ratios are ten times as sharp.
        assert 0.001 * abs(true) < constant.std < 0.02 * abs(true)
    assert np.diff(found.torque_constants[1].ratio_interval)[0] < 0.01 * 0.24
    # Weighed as twice what it is, everything is twice as heavy.
    double = identify_robot(arm, logs, payloads={"loaded": 0.8})
    assert double.torque_constants[0].value == pytest.approx(2 * found.torque_constants[0].value, rel=1e-3)
    assert double.verdict is RigidVerdict.SCALED


def test_a_payload_that_nobody_weighed_is_not_told_from_the_level(arm: Robot) -> None:
    found = identify_robot(arm, as_currents(joint_log(payload=0.4, **HIDDEN)))
    assert found.payload is None and found.verdict is RigidVerdict.OTHER
    # The ratio holds all the same.
    low, high = found.torque_constants[1].ratio_interval
    assert low < CONSTANTS[1] / CONSTANTS[0] < high


def test_what_cannot_be_is_refused(arm: Robot, tmp_path: Path) -> None:
    log = joint_log()
    with pytest.raises(DataError, match="'wrist' has a torque constant and no current"):
        identify_robot(arm, as_currents(log), torque_constants={"wrist": 1.0})
    with pytest.raises(DataError, match="no record 'loaded'"):
        identify_robot(arm, as_currents(log), payloads={"loaded": 1.0})
    with pytest.raises(DataError, match="carries -1 kg"):
        identify_robot(arm, as_currents(log), payloads={"log": -1.0})
    with pytest.raises(DataError, match="'shoulder' has its torque in one record and its current in another"):
        identify_robot(arm, [log, as_currents(log, axes=(1,), name="other")])
    bare = re.sub(r"<inertial>.*?</inertial>", "", DOUBLE_PENDULUM, flags=re.DOTALL)
    with pytest.raises(DataError, match="has no masses, and all torque constants are free"):
        identify_robot(read_robot(write(tmp_path / "bare.urdf", bare)), as_currents(log))


def test_a_gain_of_one_drive_is_told_beside_the_others(arm: Robot) -> None:
    log = joint_log(**HIDDEN)
    wrong = {n: 1.12 * v if n == "tau2" else v for n, v in log.outputs.items()}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, wrong))
    (gain,) = [e for e in found.effects if e.kind == "drive_gain"]
    low, high = (1 + end for end in gain.interval)
    said = " ".join(map(str, found.findings))
    # That the elbow reads too much and that the shoulder reads too little are the same log.
    assert (
        (gain.joint == "elbow" and low < 1.12 < high) or (gain.joint == "shoulder" and low < 1 / 1.12 < high)
    ) and "look the same" in said


def test_what_is_wrong_with_the_columns_is_asked(arm: Robot) -> None:
    log = joint_log()
    swapped = {n.translate(str.maketrans("12", "21")): v for n, v in log.outputs.items()}
    found = identify_robot(arm, gb.Experiment("log", log.time, {}, swapped))
    assert "in the order of the axes?" in " ".join(map(str, found.findings))
