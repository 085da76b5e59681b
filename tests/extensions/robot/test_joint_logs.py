"""Logs whose columns are called by joints: as ROS and its tools write them, in any order, with units in words or brackets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base import DataError
from greybox.extensions.robot import identify_robot, read_joint_logs, read_robot
from tests.support.robots import DOUBLE_PENDULUM, joint_log, write

JOINTS = ("shoulder", "elbow")


def limited() -> str:
    return DOUBLE_PENDULUM.replace('type="continuous"', 'type="revolute"').replace(
        '<axis xyz="0 1 0"/></joint>\n</robot>',
        '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="3"/></joint>\n</robot>',
    )


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> gb.robots.RobotPlant:
    return gb.robot(write(tmp_path_factory.mktemp("robot") / "arm.urdf", limited()))


def write_columns(path: Path, columns: dict[str, np.ndarray]) -> Path:
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.17g"
    )
    return path


def columns_of(log: gb.Experiment, spelling: str, order: tuple[int, ...] = (2, 1)) -> dict[str, np.ndarray]:
    words = {"q": "position", "tau": "effort"}
    return {
        spelling.format(joint=JOINTS[k - 1], what=words[s]): log.outputs[f"{s}{k}"] for s in ("q", "tau") for k in order
    }


@pytest.mark.parametrize(
    "spelling",
    [
        "{joint}.{what}",
        "/joint_states/{joint}/{what}",
        "{what}_{joint}",
        "arm_{joint}_joint_{what}",
        "{joint}Joint_{what}",
    ],
)
def test_joints_are_found_by_name_in_any_order(plant: gb.robots.RobotPlant, tmp_path: Path, spelling: str) -> None:
    log = joint_log(rows=800)
    path = write_columns(
        tmp_path / "log.csv", {"stamp": 1.7e9 + log.time, **columns_of(log, spelling), "gripper.position": log.time}
    )
    (read,) = read_joint_logs(plant, [path])
    for name in ("q1", "q2", "tau1", "tau2"):
        np.testing.assert_allclose(read.outputs[name], log.outputs[name], rtol=1e-12)
    said = " ".join(map(str, read.findings))
    assert "names of the joints shoulder and elbow" in said and "states no unit and is taken as a torque" in said


def test_units_stand_in_words_or_brackets(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    columns = {
        **{
            "time": log.time,
            "shoulder_pos_deg": np.degrees(log.outputs["q1"]),
            "elbow [deg]": np.degrees(log.outputs["q2"]),
        },
        **{"shoulder_torque_Nm": log.outputs["tau1"], "elbow_effort [A]": log.outputs["tau2"]},
        **{"elbow_desired_position": log.time, "elbow_temperature": log.time},
    }
    (read,) = read_joint_logs(plant, [write_columns(tmp_path / "log.csv", columns)])
    for name, source in (("q1", "q1"), ("q2", "q2"), ("tau1", "tau1"), ("i2", "tau2")):
        np.testing.assert_allclose(read.outputs[name], log.outputs[source], rtol=1e-12, atol=1e-12)


def test_columns_are_named_by_joints_as_well(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    names = {"a": log.outputs["q1"], "b": log.outputs["q2"], "c": log.outputs["tau1"], "d": log.outputs["tau2"]}
    path = write_columns(tmp_path / "log.csv", {"time": log.time, **names})
    told = {"shoulder": "a", "elbow_position [rad]": "b", "shoulder_effort [N*m]": "c", "tau2": "d"}
    (read,) = read_joint_logs(plant, [path], columns=told)
    (same,) = read_joint_logs(plant, [path], columns=["time", "shoulder", "elbow", "shoulder_effort", "tau2"])
    for name in ("q1", "q2", "tau1", "tau2"):
        np.testing.assert_array_equal(read.outputs[name], log.outputs[name])
        np.testing.assert_array_equal(same.outputs[name], log.outputs[name])


def test_what_is_ambiguous_or_missing_is_refused(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    columns = {"time": log.time, **columns_of(log, "{joint}.{what}")}
    with pytest.raises(DataError, match=r"both 'elbow.position' and 'left_elbow.position' may be q2"):
        read_joint_logs(plant, [write_columns(tmp_path / "two.csv", {**columns, "left_elbow.position": log.time})])
    with pytest.raises(DataError, match=r"no column is called q1, tau1 \.\.\. or by a joint"):
        read_joint_logs(plant, [write_columns(tmp_path / "none.csv", {"time": log.time, "actual_q_0": log.time})])
    degrees = {n: np.degrees(v) if "position" in n else v for n, v in columns.items()}
    (read,) = read_joint_logs(plant, [write_columns(tmp_path / "deg.csv", degrees)])
    with pytest.raises(DataError, match=r"shoulder of the robot from -3 to 3 rad; .* --column 'q1 \[deg\]=HEADER'"):
        identify_robot(read_robot(write(tmp_path / "arm.urdf", limited())), read)


def test_an_encoder_that_wraps_is_read_on(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    columns = {"time": log.time, **log.outputs}
    turned = columns["q2"] + 3.0 - columns["q2"].mean()
    assert turned.max() > np.pi
    columns["q2"] = (turned + np.pi) % (2 * np.pi) - np.pi
    (read,) = read_joint_logs(plant, [write_columns(tmp_path / "log.csv", columns)])
    np.testing.assert_allclose(np.diff(read.outputs["q2"]), np.diff(turned), atol=1e-12)


def test_axes_that_are_counted_from_zero_are_not_taken_for_others(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    columns = {f"{s}{k - 1}": log.outputs[f"{s}{k}"] for s in ("q", "tau") for k in (1, 2)}
    path = write_columns(tmp_path / "log.csv", {"time": log.time, **columns})
    with pytest.raises(
        DataError, match=r"log\.csv: there is a column 'q0', and the axes of a robot are counted from 1"
    ):
        read_joint_logs(plant, [path])
    named = {"q1": "q0", "tau1": "tau0", "q2": "q1", "tau2": "tau1"}
    (read,) = read_joint_logs(plant, [path], columns=named)
    np.testing.assert_allclose(read.outputs["tau2"], log.outputs["tau2"], rtol=1e-12)


@pytest.mark.parametrize(("factor", "said"), [(180 / np.pi, "57.3 times"), (-1.0, "-1 times"), (0.0, "0 times")])
def test_a_velocity_that_contradicts_its_position_is_refused(
    plant: gb.robots.RobotPlant, factor: float, said: str
) -> None:
    log = joint_log(rows=800)
    slope = {f"dq{k}": np.gradient(log.outputs[f"q{k}"], log.time) for k in (1, 2)}
    slope["dq2"] = factor * slope["dq2"]
    both = gb.Experiment("log", log.time, {}, {**log.outputs, **slope})
    with pytest.raises(DataError, match=f"dq2 is {said} the slope of q2; state the unit"):
        identify_robot(plant.robot, both)


def test_a_velocity_of_a_joint_that_stands_is_no_contradiction(plant: gb.robots.RobotPlant) -> None:
    log, generator = joint_log(rows=2000), np.random.default_rng(3)
    still = {"q2": 1e-4 * log.outputs["q2"] + 1e-4 * generator.normal(size=2000)}
    slope = {f"dq{k}": np.gradient(log.outputs[f"q{k}"], log.time) for k in (1, 2)}
    slope["dq2"] = 1e-4 * slope["dq2"] + 0.02 * generator.normal(size=2000)
    found = identify_robot(plant.robot, gb.Experiment("log", log.time, {}, {**log.outputs, **still, **slope}))
    assert {e.joint for e in found.effects} <= {"shoulder"}


def test_a_joint_that_follows_is_not_its_leader(tmp_path: Path) -> None:
    mirror = (
        '<link name="jaw"/><joint name="elbow_mirror" type="continuous"><parent link="upper"/><child link="jaw"/><axis xyz="0 1 0"/>'
        '<mimic joint="elbow" multiplier="-1"/></joint></robot>'
    )
    tied = gb.robot(write(tmp_path / "arm.urdf", limited().replace("</robot>", mirror)))
    log = joint_log(rows=800)
    columns = {"time": log.time, **columns_of(log, "{joint}.{what}"), "elbow_mirror.position": -log.outputs["q2"]}
    (read,) = read_joint_logs(tied, [write_columns(tmp_path / "log.csv", columns)])
    np.testing.assert_allclose(read.outputs["q2"], log.outputs["q2"], rtol=1e-12)
    del columns["elbow.position"]
    (read,) = read_joint_logs(tied, [write_columns(tmp_path / "log.csv", columns)])
    assert not np.isfinite(read.outputs.get("q2", np.nan)).any()


def test_a_load_in_per_cent_is_no_position(plant: gb.robots.RobotPlant, tmp_path: Path) -> None:
    log = joint_log(rows=800)
    columns = {"time": log.time, **columns_of(log, "{joint}.{what}"), "elbow.load": log.outputs["tau2"]}
    (read,) = read_joint_logs(plant, [write_columns(tmp_path / "log.csv", columns)])
    np.testing.assert_allclose(read.outputs["q2"], log.outputs["q2"], rtol=1e-12)
