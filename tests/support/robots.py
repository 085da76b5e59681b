"""Small robots whose equations stand in textbooks, as description files."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from greybox.data.experiment import Experiment
from greybox.extensions.robot import Robot

LENGTH, CENTRES, MASSES, INERTIAS = 0.5, (0.2, 0.15), (3.0, 2.0), (0.04, 0.02)
# Place of a payload below the elbow, m.
TIP = 0.3

# Two links that swing about horizontal axes y; q = 0 hangs down.
DOUBLE_PENDULUM = f"""<?xml version="1.0"?>
<robot name="double_pendulum">
  <link name="base"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0 0 {-CENTRES[0]}"/><mass value="{MASSES[0]}"/>
    <inertia ixx="0.05" iyy="{INERTIAS[0]}" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://not/there.stl"/></geometry></visual></link>
  <link name="lower"><inertial><origin xyz="0 0 {-CENTRES[1]}"/><mass value="{MASSES[1]}"/>
    <inertia ixx="0.03" iyy="{INERTIAS[1]}" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="8" effort="60"/><dynamics damping="0.1" friction="0.2"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 {-LENGTH}"/><axis xyz="0 1 0"/></joint>
</robot>
"""


def double_pendulum_torques(
    q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, *, payload: float = 0.0, g: float = 9.81
) -> np.ndarray:
    """Torques (N, 2) of the double pendulum; Spong, Hutchinson, Vidyasagar, Robot Modeling and Control, 2006, section 7.4.

    ``payload``: a point mass in kg at `TIP` below the elbow.
    """
    (m1, m2), (c1, c2), (i1, i2), length = MASSES, CENTRES, INERTIAS, LENGTH
    whole = m2 + payload
    centre = (m2 * c2 + payload * TIP) / whole
    # Steiner: both bodies about their common centre.
    i2 += m2 * (centre - c2) ** 2 + payload * (TIP - centre) ** 2
    m2, c2 = whole, centre
    (q1, q2), (v1, v2), (a1, a2) = q.T, dq.T, ddq.T
    d11 = m1 * c1**2 + m2 * (length**2 + c2**2 + 2 * length * c2 * np.cos(q2)) + i1 + i2
    d12 = m2 * (c2**2 + length * c2 * np.cos(q2)) + i2
    d22 = m2 * c2**2 + i2
    h = -m2 * length * c2 * np.sin(q2)
    # The angles are counted from hanging: weight pulls back with the sine.
    g1 = (m1 * c1 + m2 * length) * g * np.sin(q1) + m2 * c2 * g * np.sin(q1 + q2)
    g2 = m2 * c2 * g * np.sin(q1 + q2)
    tau1 = d11 * a1 + d12 * a2 + h * v2 * v1 + h * (v1 + v2) * v2 + g1
    return np.column_stack([tau1, d12 * a1 + d22 * a2 - h * v1**2 + g2])


# A cart on a rail with a pole, MJCF: angles in degrees, defaults by class, a joint beside the body's origin.
CART_POLE = """<mujoco model="cart_pole">
  <compiler angle="degree"/>
  <default><default class="hinge">
    <joint axis="0 -1 0" damping="0.3" frictionloss="0.1" armature="0.01" range="-90 180"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="cart" pos="0 0 0.4" euler="0 0 30">
      <inertial pos="0 0 0" mass="4" diaginertia="0.1 0.2 0.15" zaxis="0.1 0.2 1"/>
      <joint name="rail" type="slide" axis="1 0 0" ref="0.2"/>
      <body name="pole" childclass="hinge" pos="0.1 0 0.5" quat="0.9238795325112867 0 0.3826834323650898 0">
        <inertial pos="0.02 0 0.1" mass="0.7" fullinertia="0.02 0.021 0.003 0.001 -0.002 0.0005"/>
        <joint name="pivot" pos="0 0 -0.5" ref="10"/>
        <body name="bob" pos="0 0 0.3" xyaxes="0 1 0 -1 0 0">
          <inertial pos="0.01 0.02 0" mass="0.4" diaginertia="0.002 0.001 0.0015" axisangle="0 0 1 20"/>
          <geom type="sphere" size="0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def random_states(robot: Robot, rows: int = 100) -> np.ndarray:
    return np.random.default_rng(1).uniform(-2, 2, (3, rows, len(robot.axes)))


def find_description(name: str) -> Path:
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return next(Path(str(file.locate())) for file in files if str(file).endswith(name))


def swing(rows: int = 8000, step: float = 0.002, seed: int = 0) -> tuple[np.ndarray, ...]:
    """Times (N,) and positions, velocities, accelerations (N, 2) of a motion of five harmonics."""
    generator, time = np.random.default_rng(seed), step * np.arange(rows)
    harmonics = 2 * np.pi * 0.125 * np.arange(1, 6)
    sines, cosines = generator.normal(size=(2, 5, 2)) / np.arange(1, 6)[:, None]
    phase = np.outer(time, harmonics)
    w = harmonics[:, None]
    q = np.sin(phase) @ sines + np.cos(phase) @ cosines
    dq = np.cos(phase) @ (w * sines) - np.sin(phase) @ (w * cosines)
    ddq = -np.sin(phase) @ (w**2 * sines) - np.cos(phase) @ (w**2 * cosines)
    return time, q, dq, ddq


def joint_log(
    seed: int = 0,
    viscous: tuple[float, float] = (0.0, 0.0),
    dry: tuple[float, float] = (0.0, 0.0),
    offset: tuple[float, float] = (0.0, 0.0),
    motor: tuple[float, float] = (0.0, 0.0),
    payload: float = 0.0,
    rows: int = 8000,
) -> Experiment:
    """A log of the double pendulum: encoders of 18 bits, torques with noise of 0.1 and 0.03 N m, a part of it coloured."""
    time, q, dq, ddq = swing(rows, seed=seed)
    generator = np.random.default_rng([seed, 1])
    tau = (
        double_pendulum_torques(q, dq, ddq, payload=payload)
        + np.array(viscous) * dq
        + np.array(dry) * np.sign(dq)
        + offset
    )
    tau += np.array(motor) * ddq
    white, slow = generator.normal(size=(2, *tau.shape))
    tau += [0.1, 0.03] * (white + 0.3 * lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], slow, axis=0))
    resolution = 2 * np.pi / 2**18
    q = np.round(q / resolution) * resolution
    return Experiment("log", time, {}, {"q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]})


def write_log(log: Experiment, path: Path) -> Path:
    """A log as a CSV file with units in its head."""
    units = {"q": "rad", "dq": "rad/s", "tau": "N*m"}
    head = ["time [s]", *(f"{name} [{units[name.rstrip('12')]}]" for name in log.outputs)]
    np.savetxt(
        path,
        np.column_stack([log.time, *log.outputs.values()]),
        delimiter=",",
        header=",".join(head),
        comments="",
        fmt="%.9g",
    )
    return path
