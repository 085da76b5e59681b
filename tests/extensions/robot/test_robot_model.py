"""A robot as a model: the textbook's double pendulum runs, is fitted in closed loop, linearised and exported as feed-forward."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.estimation import FitOptions
from greybox.extensions.export.c_code import to_c
from greybox.extensions.robot import Robot, identify_robot, read_robot, robot_model
from greybox.model import equations_text
from greybox.simulation.kernel.c_compiler import find_compiler
from tests.support.robots import CART_POLE, DOUBLE_PENDULUM, double_pendulum_torques, joint_log, random_states, write

VISCOUS, DRY, WIDTH = np.array([0.3, 0.2]), np.array([0.8, 0.4]), 0.05


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return read_robot(write(tmp_path_factory.mktemp("robot") / "arm.urdf", DOUBLE_PENDULUM))


def accelerate(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Accelerations (2,) of the textbook's pendulum: its torques are linear in them."""
    rows = np.vstack([np.zeros(2), np.eye(2)])
    bias, *columns = double_pendulum_torques(np.tile(q, (3, 1)), np.tile(dq, (3, 1)), rows)
    return np.linalg.solve(np.transpose(columns) - bias[:, None], tau - bias)


def step(z: np.ndarray, tau: np.ndarray, seconds: float, friction: float = 1.0) -> np.ndarray:
    """Positions and velocities (4,) after some seconds of a torque that is held, by Runge-Kutta steps of 2 ms."""

    def rate(z: np.ndarray) -> np.ndarray:
        rubbing = friction * (VISCOUS * z[2:] + DRY * np.tanh(z[2:] / WIDTH))
        return np.concatenate([z[2:], accelerate(z[:2], z[2:], tau - rubbing)])

    count = round(seconds / 0.002)
    h = seconds / count
    for _ in range(count):
        k1 = rate(z)
        k2 = rate(z + h / 2 * k1)
        k3 = rate(z + h / 2 * k2)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3))
    return z


def test_a_robot_swings_as_the_textbook_says(arm: Robot) -> None:
    time = 0.005 * np.arange(400)
    end = step(np.array([1.0, -0.5, 0.0, 0.0]), np.zeros(2), float(time[-1]), friction=0.0)
    model = robot_model(arm).fix(B1=0.0)
    swing = gb.simulate(model, {"time": time, "tau1": 0 * time, "tau2": 0 * time}, initial={"q1": 1.0, "q2": -0.5})
    assert [y[-1] for y in swing.states.values()] == pytest.approx(end, abs=1e-5)


def test_torques_and_accelerations_are_each_other_s_inverse(arm: Robot, tmp_path: Path) -> None:
    for robot in (arm, read_robot(write(tmp_path / "cart.xml", CART_POLE))):
        forward, inverse = robot_model(robot), robot_model(robot, inverse=True)
        forward, inverse = (m + gb.effect("return_spring_at_joint_2") for m in (forward, inverse))
        forward, inverse = forward.start(Ks=2.0), inverse.start(Ks=2.0)
        assert forward.values == inverse.values
        p = list(forward.values.values())
        for q, dq, ddq in zip(*random_states(robot, 5), strict=True):
            motion = np.column_stack([q, dq, ddq]).T.ravel()
            tau = inverse.system.output_function([], motion, p).full().ravel()
            rates = forward.system.rhs_function(np.concatenate([q, dq]), tau, p).full().ravel()
            assert rates == pytest.approx(np.concatenate([dq, ddq]), rel=1e-9)


def test_what_was_identified_is_taken_over_and_an_axis_that_was_held_is_held(arm: Robot) -> None:
    log = joint_log(viscous=(0.8, 0.0), dry=(0.0, 0.5), payload=0.4)
    columns = {name: values for name, values in {**log.inputs, **log.outputs}.items() if not name.endswith("2")}
    identified = identify_robot(arm, gb.Experiment("one", log.time, {}, columns))
    model = robot_model(arm, identified, inverse=True)
    assert [o.name for o in model.outputs] == ["tau1"] and model.parameter("Iyy1").source == "identified"
    assert model.values["Iyy1"] == identified.base[-1].value
    expected = {e.kind: e.value for e in identified.effects}
    assert model.values["B1"] == expected.get("viscous_friction", 0.0)


def test_equations_name_the_rigid_body(arm: Robot) -> None:
    text = " ".join(equations_text(robot_model(arm)).split())
    assert "0 = tau1 - B1 dq1 - Jm1 ddq1 - rigid body of 2 links" in text
    both = robot_model(arm, inverse=True) + gb.effect("coulomb_friction") + gb.effect("coulomb_friction_at_joint_2")
    assert "- coulomb_friction_at_joint_2.Fc sign(dq2)" in equations_text(both)


@pytest.mark.slow
def test_a_robot_in_closed_loop_is_fitted_by_short_free_runs(arm: Robot) -> None:
    """A controller follows a motion; 20 short runs find friction joint by joint and the base parameters, inside their intervals."""
    time, rng = 0.01 * np.arange(600), np.random.default_rng(4)

    def command(t, z):
        target = np.array([1.2 * np.sin(1.7 * t) + 0.5 * np.sin(4 * t), np.sin(2.6 * t) - 0.6 * np.cos(3.3 * t)])
        return np.array([60.0, 20.0]) * (target - z[:2]) - np.array([4.0, 1.0]) * z[2:]

    # Held between samples, as a controller's torque is.
    z, rows, torques = np.zeros(4), [], []
    for t in time.tolist():
        held = command(t, z)
        rows.append(z)
        torques.append(held)
        z = step(z, held, 0.01)
    states, tau = np.array(rows), np.array(torques)
    noise = {"q1": 5e-4, "q2": 5e-4}
    measured = {name: states[:, k] + noise[name] * rng.normal(size=len(time)) for k, name in enumerate(noise)}
    record = gb.Experiment("loop", time, {"tau1": tau[:, 0], "tau2": tau[:, 1]}, measured)
    model = robot_model(arm).free("B1", "B2").start(B1=0.1, B2=0.1)
    for name in ("coulomb_friction", "coulomb_friction_at_joint_2"):
        model = model + gb.effect(name).smoothed(WIDTH)
    fit = gb.fit(model, record, noise=noise, options=FitOptions(arc_length=0.3))
    truth = robot_model(arm).values | {"B1": 0.3, "B2": 0.2, "Fc": 0.8, "coulomb_friction_at_joint_2.Fc": 0.4}
    off = {n: (e.value - truth[n]) / e.std for n, e in fit.parameters.items() if not e.fixed}
    assert len(off) == 10 and max(map(abs, off.values())) < 4
    assert fit.parameters["coulomb_friction_at_joint_2.Fc"].std < 0.05


def test_a_state_space_about_a_pose_has_the_textbook_s_stiffness(arm: Robot) -> None:
    pose = np.array([0.6, -0.9])
    hold = double_pendulum_torques(pose[None], np.zeros((1, 2)), np.zeros((1, 2)))[0]
    at = gb.linearise(robot_model(arm).fix(B1=0.0), {"q1": 0.6, "q2": -0.9, "dq1": 0.0, "dq2": 0.0})
    assert at.u0 == pytest.approx(hold)
    slopes = np.empty((2, 4))
    for k in range(4):
        beside = 1e-6 * np.eye(4)[k]
        ends = [accelerate(pose + s * beside[:2], s * beside[2:], hold) for s in (1, -1)]
        slopes[:, k] = (ends[0] - ends[1]) / 2e-6
    assert at.A[2:] == pytest.approx(slopes, abs=1e-6)
    assert at.B[2:, 0] == pytest.approx(accelerate(pose, np.zeros(2), hold + np.eye(2)[0]))


@pytest.mark.skipif(not find_compiler(), reason="there is no C compiler on the path")
def test_feed_forward_torques_are_a_c_function(arm: Robot, tmp_path: Path) -> None:
    model = (robot_model(arm, inverse=True).fix(B1=0.0) + gb.effect("coulomb_friction_at_joint_2")).start(Fc=0.4)
    source, _ = to_c(model, tmp_path / f"{model.name}.c", dt=0.001)
    (tmp_path / "main.c").write_text(
        "#include <stdio.h>\n"
        f'#include "{model.name}.h"\nint main(void) {{\n'
        f"struct {source.stem}_state s; struct {source.stem}_output y;\n"
        f"struct {source.stem}_input u = {{.q1 = 0.3, .q2 = -0.4, .dq1 = 1.1, .dq2 = 0.6, .ddq1 = 2.0, .ddq2 = -3.0}};\n"
        f"{source.stem}_start(&s); {source.stem}_outputs(&s, &u, &y);\n"
        'printf("%.17g %.17g\\n", y.tau1, y.tau2); return 0; }\n'
    )
    program = tmp_path / "program"
    subprocess.run(
        [*find_compiler().command, str(tmp_path / "main.c"), str(source), "-lm", "-o", str(program)], check=True
    )
    tau = np.array(subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.split(), float)
    rigid = double_pendulum_torques(*(np.array([row]) for row in ([0.3, -0.4], [1.1, 0.6], [2.0, -3.0])))[0]
    assert tau == pytest.approx(rigid + np.array([0.0, 0.4]), rel=1e-12)
