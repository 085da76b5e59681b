"""Does `greybox robot` find what hides in the joints of simulated arms, with intervals that hold?

Arms: a double pendulum of its own, UR5 and Panda of the distribution example-robot-data (``pip install 'greybox-sysid[robots]'``), run by
MuJoCo under a controller: an independent engine, by Runge-Kutta at 4 kHz, logged at 1 kHz for 20 s. Each run has a motion, hidden constants
and noise of its own seed: viscous friction at seven joints of ten, dry friction at seven of ten, offsets at three of ten, a payload of
0.5 to 2 kg; encoders of 18 bits, torques with white noise of 1 % and coloured noise (0.1 s) of 0.5 % of their rms, written to a quarter of
it. Half of the runs hide nothing. ``python -m fits.studies.robot_arms 100 150`` runs these seeds; the thresholds
of the search were set on others.
`study` with ``rare`` makes every joint dry, gives half of them a Stribeck rise or friction that grows with the load, and one joint a wrong
gain in half of the runs. Of two joints nothing tells which one reads wrong.
`study_currents` logs currents instead, without and with a payload that was weighed: do the intervals of torque constants hold?

What to expect: all effects have their names, none is wrong as certain, 93 to 97 % of the 95 % intervals hold, the payload is within 1 %.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import lfilter

import greybox as gb
from greybox.discovery.decision import Grade
from greybox.extensions.robot.description import Robot, from_pseudo_inertia, move_inertial, to_pose

ARMS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
}
HELD = {"panda": {"panda_finger_joint1": 0.0}}
DOUBLE_PENDULUM = """<robot name="double_pendulum"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.2"/><mass value="3"/>
<inertia ixx="0.05" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.15"/><mass value="2"/>
<inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit effort="60"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -0.5"/><axis xyz="0 1 0"/></joint>
</robot>"""
STEP, EVERY, SECONDS = 2.5e-4, 4, 20.0
KINDS = ("viscous_friction", "coulomb_friction", "torque_offset")
# What few joints have: a rise of dry friction near rest, friction that grows with the load, a torque that reads wrong.
RARE = ("stribeck_friction", "load_dependent_friction", "drive_gain")


@dataclass(frozen=True)
class Hidden:
    """What hides in a run: constants (3, n) in the order of `KINDS`, ten constants of a payload on the last link, and rare effects (3, n).

    The rare ones stand in the order of `RARE`; ``width`` (n,) in rad/s is the speed up to which dry friction is raised.
    """

    constants: np.ndarray
    payload: np.ndarray
    rare: np.ndarray
    width: np.ndarray


def read_arm(name: str, folder: Path) -> Robot:
    if name in ARMS:
        files = metadata.files("example-robot-data") or []
        path = next(Path(str(f.locate())) for f in files if str(f).endswith(ARMS[name]))
    else:
        path = folder / "double_pendulum.urdf"
        path.write_text(DOUBLE_PENDULUM, encoding="utf-8")
    arm = gb.robots.read_robot(path)
    return arm.lock(HELD[name]) if name in HELD else arm


def draw_hidden(arm: Robot, generator: np.random.Generator, *, rare: bool = False) -> Hidden:
    """Sizes in proportion to what each drive can give; with ``rare`` effects every joint is dry, and half of them have one."""
    n = len(arm.axes)
    efforts = np.array([j.effort if np.isfinite(j.effort) else 60.0 for j in arm.axes])
    sizes = np.clip(efforts / 87, 0.1, 1.5)
    viscous = generator.uniform(1, 4, n) * (generator.random(n) < 0.7)
    dry = generator.uniform(2, 6, n) * (generator.random(n) < 0.7)
    offset = generator.uniform(1, 2, n) * generator.choice([-1, 1], n) * (generator.random(n) < 0.3)
    mass, centre, radius = generator.uniform(0.5, 2), generator.uniform(-0.1, 0.1, 3), 0.05
    P = np.zeros((4, 4))
    P[:3, :3] = mass * np.outer(centre, centre) + np.eye(3) * mass * radius**2 / 5
    P[3, :3] = P[:3, 3] = mass * centre
    P[3, 3] = mass
    unusual = np.zeros((3, n))
    if rare:
        dry = generator.uniform(2, 6, n)
        which = generator.choice(3, n, p=[0.25, 0.25, 0.5])
        unusual[0] = sizes * generator.uniform(1, 3, n) * (which == 0)
        unusual[1] = generator.uniform(0.04, 0.12, n) * (which == 1)
        # One joint of an arm reads wrong in half of the runs.
        joint, error = generator.integers(n), generator.uniform(0.05, 0.15) * generator.choice([-1, 1])
        unusual[2, joint] = error * (generator.random() < 0.5)
    width = generator.uniform(0.05, 0.35, n)
    return Hidden(sizes * np.array([viscous, dry, offset]), from_pseudo_inertia(P), unusual, width)


def with_payload(arm: Robot, payload: np.ndarray) -> Robot:
    last = arm.joints[-1]
    return replace(arm, joints=(*arm.joints[:-1], replace(last, inertial=last.inertial + payload)))


def write_mjcf(arm: Robot, hidden: Hidden) -> str:
    """The arm with what hides in it for MuJoCo; its dry friction creeps below 0.01 rad/s."""

    def numbers(values: np.ndarray) -> str:
        return " ".join(f"{v:.17g}" for v in np.ravel(values))

    def body(k: int) -> str:
        joint = arm.joints[k]
        centre = joint.inertial[1:4] / joint.inertial[0]
        xx, xy, yy, xz, yz, zz = move_inertial(joint.inertial, to_pose(np.eye(3), -centre))[4:]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(joint.rotation).ravel())
        viscous, dry, _ = hidden.constants[:, k]
        inner = "".join(body(i) for i, child in enumerate(arm.joints) if child.parent == k)
        return (
            f'<body pos="{numbers(joint.origin)}" quat="{numbers(quaternion)}"><inertial pos="{numbers(centre)}"'
            f' mass="{joint.inertial[0]:.17g}" fullinertia="{numbers(np.array([xx, yy, zz, xy, xz, yz]))}"/>'
            f'<joint axis="{numbers(joint.axis)}" damping="{viscous:.17g}" frictionloss="{dry:.17g}"'
            f' solreffriction="0.0006 1" solimpfriction="0.99 0.999 0.001"/>{inner}</body>'
        )

    bodies = "".join(body(k) for k, joint in enumerate(arm.joints) if joint.parent < 0)
    return (
        '<mujoco><compiler angle="radian" balanceinertia="false" boundinertia="0"/>'
        f'<option timestep="{STEP}" integrator="RK4" gravity="{numbers(arm.gravity)}"/><worldbody>{bodies}</worldbody></mujoco>'
    )


def run_arm(arm: Robot, hidden: Hidden, generator: np.random.Generator) -> gb.Experiment:
    """A log of the arm under a controller that follows a Fourier series."""
    model = mujoco.MjModel.from_xml_string(write_mjcf(arm, hidden))
    data, n, count = mujoco.MjData(model), len(arm.axes), int(SECONDS / STEP)
    w = 2 * np.pi * 0.1 * np.arange(1, 6)
    a, b = generator.normal(size=(2, n, 5)) / np.arange(1, 6)
    phase = np.outer(w, STEP * np.arange(count))
    q, dq = a @ np.sin(phase) + b @ np.cos(phase), (a * w) @ np.cos(phase) - (b * w) @ np.sin(phase)
    ddq = -(a * w**2) @ np.sin(phase) - (b * w**2) @ np.cos(phase)
    q -= q.mean(axis=1, keepdims=True)
    # Within 1.3 rad of a pose, and at 1.8 rad/s at most.
    scale = np.minimum(1.3 / np.abs(q).max(axis=1), 1.8 / np.abs(dq).max(axis=1))[:, None]
    q, dq, ddq = q * scale + generator.uniform(-0.5, 0.5, (n, 1)), dq * scale, ddq * scale
    data.qpos[:], data.qvel[:] = q[:, 0], dq[:, 0]
    M, stiffness = np.zeros((n, n)), 25.0
    positions, torques = np.empty((2, count // EVERY, n))
    for k in range(count):
        if k % 8 == 0:
            mujoco.mj_forward(model, data)
            mujoco.mj_fullM(model, data, M)
            bias, inertia = data.qfrc_bias.copy(), M.diagonal().copy()
        errors = 2 * stiffness * (dq[:, k] - data.qvel) + stiffness**2 * (q[:, k] - data.qpos)
        torque = bias + inertia * (ddq[:, k] + errors)
        if k % EVERY == 0:
            positions[k // EVERY], torques[k // EVERY] = data.qpos, torque
        # What reads the torque is off: the arm gets less than it says.
        given = torque / (1 + hidden.rare[2]) - hidden.constants[2]
        data.qfrc_applied[:] = given
        # Dry friction is Fc + Fs exp(-(v / vs)^2) + mu |load|, the load what the drive gave last less friction.
        load = np.abs(given + data.qfrc_constraint + data.qfrc_passive)
        raised = hidden.rare[0] * np.exp(-((data.qvel / hidden.width) ** 2))
        model.dof_frictionloss[:] = hidden.constants[1] + raised + hidden.rare[1] * load
        mujoco.mj_step(model, data)
    return make_log(positions, torques, generator)


def make_log(positions: np.ndarray, torques: np.ndarray, generator: np.random.Generator) -> gb.Experiment:
    """What sensors make of a run."""
    rms = np.sqrt(np.mean(torques**2, axis=0))
    noise = 0.01 * rms.clip(0.05 * rms.max())
    white, slow = generator.normal(size=(2, *torques.shape))
    torques = torques + noise * (white + 0.5 * lfilter([np.sqrt(1 - 0.99**2)], [1, -0.99], slow, axis=0))
    resolution, code = 2 * np.pi / 2**18, 2.0 ** np.round(np.log2(noise / 4))
    positions, torques = np.round(positions / resolution) * resolution, np.round(torques / code) * code
    columns = {f"{name}{i + 1}": c for name, m in (("q", positions), ("tau", torques)) for i, c in enumerate(m.T)}
    return gb.Experiment("log", STEP * EVERY * np.arange(len(positions)), {}, columns)


@dataclass
class Tally:
    """What came of the runs of one arm."""

    inside: list[bool]
    named: int = 0
    hidden: int = 0
    wrong: int = 0
    wrong_as_certain: int = 0
    payload: float = 0.0
    payloads_inside: int = 0

    def __str__(self) -> str:
        return (
            f"{np.mean(self.inside):.1%} of {len(self.inside)} intervals hold, {self.named} of {self.hidden} effects named,"
            f" {self.wrong} wrong, {self.wrong_as_certain} of them as certain, payload within {self.payload:.2%},"
            f" {self.payloads_inside} times inside its interval"
        )


def study(name: str, seeds: Sequence[int], folder: Path, *, hides: bool, rare: bool = False) -> Tally:
    """Runs of one arm that hide something, or nothing; with ``rare`` effects as well."""
    arm, tally = read_arm(name, folder), Tally([])
    nothing = Hidden(np.zeros((3, len(arm.axes))), np.zeros(10), np.zeros((3, len(arm.axes))), np.ones(len(arm.axes)))
    for seed in seeds:
        generator = np.random.default_rng([seed, len(arm.axes), 2 if rare else hides])
        hidden = draw_hidden(arm, generator, rare=rare) if hides else nothing
        true_arm = with_payload(arm, hidden.payload)
        identified = gb.robots.identify_robot(arm, run_arm(true_arm, hidden, generator))
        truth = gb.robots.find_base_parameters(arm).mixing @ true_arm.inertial
        pairs = [(b.interval, true) for b, true in zip(identified.base, truth, strict=True)]
        named = {(e.joint, e.kind): e for e in identified.effects}
        for joint, constants in zip(arm.axes, np.vstack([hidden.constants, hidden.rare]).T, strict=True):
            for kind, constant in zip(KINDS + RARE, constants, strict=True):
                effect = named.pop((joint.name, kind), None) if constant else None
                tally.hidden += bool(constant)
                tally.named += effect is not None
                pairs += [(effect.interval, constant)] if effect else []
        tally.inside += [low <= true <= high for (low, high), true in pairs]
        tally.wrong += len(named) + (identified.payload is not None and not hides)
        tally.wrong_as_certain += sum(e.grade is Grade.ESTABLISHED for e in named.values())
        if hides:
            weighed = identified.payload.mass if identified.payload else 0.0
            tally.payload = max(tally.payload, abs(weighed / hidden.payload[0] - 1))
            low, high = identified.payload.mass_interval if identified.payload else (0.0, 0.0)
            tally.payloads_inside += low <= hidden.payload[0] <= high
    return tally


def study_currents(name: str, seeds: Sequence[int], folder: Path) -> tuple[list[bool], list[bool]]:
    """Which intervals hold: of torque constants, and of their ratios to that of the first joint.

    Two logs of currents of each arm, the second with a payload of known mass, which tells their level.
    """
    arm = read_arm(name, folder)
    constants_inside, ratios_inside = [], []
    for seed in seeds:
        generator = np.random.default_rng([seed, len(arm.axes), 3])
        hidden, constants = draw_hidden(arm, generator), generator.uniform(0.5, 5, len(arm.axes))
        logs = []
        for title, each in (("bare", arm), ("loaded", with_payload(arm, hidden.payload))):
            log = run_arm(each, hidden, generator)
            columns = {f"i{k}": log.outputs[f"tau{k}"] / constant for k, constant in enumerate(constants, 1)}
            positions = {n: v for n, v in log.outputs.items() if n.startswith("q")}
            logs.append(gb.Experiment(title, log.time, {}, {**positions, **columns}))
        identified = gb.robots.identify_robot(arm, logs, payloads={"loaded": float(hidden.payload[0])})
        for found, constant in zip(identified.torque_constants, constants, strict=True):
            constants_inside.append(found.interval[0] <= constant <= found.interval[1])
            ratios_inside.append(found.ratio_interval[0] <= constant / constants[0] <= found.ratio_interval[1])
    return constants_inside, ratios_inside


def verdict(tally: Tally) -> None:
    """The goals of the search on cases that set nothing."""
    assert 0.92 <= np.mean(tally.inside) <= 0.98
    assert tally.named >= 0.9 * tally.hidden
    assert tally.wrong_as_certain <= 0.01 * max(tally.hidden, 1)
    assert tally.payload <= 0.02


if __name__ == "__main__":
    first, last = map(int, sys.argv[1:3])
    for each in ("double_pendulum", *ARMS):
        for hides in (True, False):
            tally = study(each, range(first, last), Path(sys.argv[3] if len(sys.argv) > 3 else "."), hides=hides)
            sys.stdout.write(f"{each}, {'something' if hides else 'nothing'} hidden: {tally}\n")
            verdict(tally)
