"""Dynamics of trees of rigid bodies: textbook equations, Pinocchio and MuJoCo say the same."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from greybox.extensions.robot import JointKind, RigidBody, Robot, read_robot
from tests.support.robots import (
    CART_POLE,
    DOUBLE_PENDULUM,
    double_pendulum_torques,
    find_description,
    random_states,
    write,
)

# Arms of the collection of descriptions that Pinocchio is tested with, by their files there.
ARMS = (
    *(
        "double_pendulum_description/urdf/double_pendulum.urdf",
        "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
    ),
    *("double_pendulum_description/urdf/double_pendulum_simple.urdf", "asr_twodof_description/urdf/TwoDofs.urdf"),
    *("finger_edu_description/robots/finger_edu.urdf", "kinova_description/robots/kinova.urdf"),
    *(
        "panda_description/urdf/panda.urdf",
        "panda_description/urdf/panda_collision.urdf",
        "so_arm_description/urdf/so100.urdf",
    ),
    *(
        "so_arm_description/urdf/so101.urdf",
        "talos_data/robots/talos_left_arm.urdf",
        "ur_description/urdf/ur3_robot.urdf",
    ),
    *(
        "ur_description/urdf/ur3_gripper.urdf",
        "ur_description/urdf/ur3_joint_limited_robot.urdf",
        "ur_description/urdf/ur5_robot.urdf",
    ),
    *(
        "ur_description/urdf/ur5_gripper.urdf",
        "ur_description/urdf/ur5_joint_limited_robot.urdf",
        "ur_description/urdf/ur10_robot.urdf",
    ),
    *(
        "ur_description/urdf/ur10_joint_limited_robot.urdf",
        "xarm_description/urdf/xarm7.urdf",
        "z1_description/urdf/z1.urdf",
    ),
    *("allegro_hand_description/urdf/allegro_right_hand.urdf", "baxter_description/urdf/baxter.urdf"),
    *("tiago_description/robots/tiago_no_hand.urdf", "tiago_description/robots/tiago.urdf"),
)


def test_the_torques_of_a_double_pendulum_are_those_of_the_textbook(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path / "a.urdf", DOUBLE_PENDULUM))
    states = random_states(robot)
    np.testing.assert_allclose(
        RigidBody(robot).compute_torques(*states), double_pendulum_torques(*states), rtol=0, atol=1e-12
    )


def test_the_regressor_and_the_forward_dynamics_belong_to_the_torques(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path / "a.xml", CART_POLE))
    body, (q, dq, ddq) = RigidBody(robot), random_states(robot)
    tau = body.compute_torques(q, dq, ddq)
    np.testing.assert_allclose(body.compute_regressors(q, dq, ddq) @ robot.inertial, tau, rtol=0, atol=1e-12)
    armature = np.array([0.3, 0.7])
    answered = body.forward_dynamics(q[0], dq[0], tau[0] + armature * ddq[0], robot.inertial, armature)
    np.testing.assert_allclose(answered.full()[:, 0], ddq[0], rtol=0, atol=1e-11)


def test_a_follower_is_carried_by_its_leader(tmp_path: Path) -> None:
    tied = DOUBLE_PENDULUM.replace(
        '<axis xyz="0 1 0"/></joint>', '<axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="-2"/></joint>'
    )
    robot = read_robot(write(tmp_path / "a.urdf", tied))
    (q, dq, ddq), F = random_states(robot), np.array([[1.0, -2.0]])
    assert [j.name for j in robot.axes] == ["shoulder"]
    # By virtual work: the follower's torque counts with its factor.
    expected = double_pendulum_torques(q @ F, dq @ F, ddq @ F) @ F.T
    np.testing.assert_allclose(RigidBody(robot).compute_torques(q, dq, ddq), expected, rtol=0, atol=1e-12)


def test_an_axis_that_is_held_is_a_part_of_what_carries_it(tmp_path: Path) -> None:
    robot = read_robot(write(tmp_path / "a.urdf", DOUBLE_PENDULUM))
    q, dq, ddq = (
        np.column_stack([s[:, :1], np.full((100, 1), still)])
        for s, still in zip(random_states(robot), (0.7, 0, 0), strict=True)
    )
    held = RigidBody(robot.lock({"elbow": 0.7})).compute_torques(q[:, :1], dq[:, :1], ddq[:, :1])
    np.testing.assert_allclose(held[:, 0], double_pendulum_torques(q, dq, ddq)[:, 0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ARMS, ids=lambda name: name.rpartition("/")[2])
def test_torques_are_those_of_pinocchio(name: str) -> None:
    pinocchio = pytest.importorskip("pinocchio", reason="pin is not installed")
    path = find_description(name)
    model = pinocchio.buildModelFromUrdf(str(path), mimic=True)
    data, robot = model.createData(), read_robot(path)
    q, dq, ddq = random_states(robot)
    torques = RigidBody(robot).compute_torques(q, dq, ddq)
    for row, torque in enumerate(torques):
        expected = torques_of_pinocchio(pinocchio, model, data, robot, q[row], dq[row], ddq[row])
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-12 * max(1.0, np.abs(expected).max()))


def torques_of_pinocchio(
    pinocchio: ModuleType, model: object, data: object, robot: Robot, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
) -> np.ndarray:
    """By the names of the joints; one that turns on has the cosine and the sine of its angle as coordinates."""
    full, rates = pinocchio.neutral(model), np.zeros((2, model.nv))
    joints = [model.joints[model.getJointId(axis.name)] for axis in robot.axes]
    for k, joint in enumerate(joints):
        full[joint.idx_q : joint.idx_q + joint.nq] = q[k] if joint.nq == 1 else (np.cos(q[k]), np.sin(q[k]))
        rates[:, joint.idx_v] = dq[k], ddq[k]
    torques = pinocchio.rnea(model, data, full, *rates)
    return torques[[joint.idx_v for joint in joints]]


def test_a_robot_of_mujoco_moves_as_there(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed")
    model, robot = mujoco.MjModel.from_xml_string(CART_POLE), read_robot(write(tmp_path / "a.xml", CART_POLE))
    data, states = mujoco.MjData(model), random_states(robot)
    torques = RigidBody(robot).compute_torques(*states)
    for q, dq, ddq, torque in zip(*states, torques, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        M = np.zeros((2, 2))
        mujoco.mj_fullM(model, data, M)
        # Without what is no rigid body: passive damping, and constraints (friction, limits); the motor's inertia is in both.
        expected = data.qfrc_bias + M @ ddq - np.array([j.armature for j in robot.axes]) * ddq
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-11)


def test_mjcf_states_what_the_joints_have(tmp_path: Path) -> None:
    rail, pivot = read_robot(write(tmp_path / "a.xml", CART_POLE)).axes
    assert (rail.kind, pivot.kind) == (JointKind.PRISMATIC, JointKind.REVOLUTE)
    assert (pivot.damping, pivot.friction, pivot.armature) == (0.3, 0.1, 0.01)
    np.testing.assert_allclose((pivot.lower, pivot.upper), (-np.pi / 2, np.pi))
    # The bob is fixed to the pole.
    assert pivot.inertial[0] == pytest.approx(1.1)
