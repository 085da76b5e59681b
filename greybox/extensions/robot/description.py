"""A robot as a value: a tree of joints on a fixed base, each with the inertial constants of what it moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from greybox.base import ModelError, nearest
from greybox.base.values import ReadOnly

# The ten inertial constants of a link in its joint's frame: mass, first moments (mass times centre), inertia about the frame's origin.
INERTIAL_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIAL_UNITS = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
# Standard gravity as robot descriptions assume it, m/s^2.
GRAVITY = (0.0, 0.0, -9.81)
# More moving joints than the largest humanoid with hands: a file that has more is a mistake, or malice.
MOST_JOINTS = 256


class JointKind(StrEnum):
    """How a joint moves."""

    REVOLUTE = "revolute"
    PRISMATIC = "prismatic"


@dataclass(frozen=True)
class Follows:
    """A joint that follows another: ``q = factor * q_leader + offset``."""

    leader: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint(ReadOnly):
    """A joint and the link that it moves.

    Parameters
    ----------
    name, link
        Names of the joint and of the link; other links that are fixed to it are lumped into it.
    kind
        How it moves.
    parent
        Number of the joint that carries it, -1 for the base.
    rotation, origin
        Pose (3, 3), (3,) in m of the joint's frame at ``q = 0`` in the frame of the parent.
    axis
        Unit vector (3,) in the joint's frame.
    inertial
        The ten constants `INERTIAL_NAMES` in the joint's frame, in kg, kg m, kg m^2.
    lower, upper, speed, effort
        Limits in rad or m, rad/s or m/s, N m or N; infinite where none is stated.
    damping, friction, armature
        What the description states of the joint: viscous coefficient, dry friction, inertia of the motor behind the gear.
    tie
        The joint that it follows, if any.
    """

    name: str
    link: str
    kind: JointKind
    parent: int
    rotation: np.ndarray
    origin: np.ndarray
    axis: np.ndarray
    inertial: np.ndarray
    lower: float = -np.inf
    upper: float = np.inf
    speed: float = np.inf
    effort: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    tie: Follows | None = None

    @property
    def units(self) -> dict[str, str]:
        """Units of its position, velocity and acceleration, of its torque or force, and of a current."""
        q, tau = ("rad", "N*m") if self.kind is JointKind.REVOLUTE else ("m", "N")
        return {"q": q, "dq": f"{q}/s", "ddq": f"{q}/s^2", "tau": tau, "i": "A"}


@dataclass(frozen=True, eq=False)
class Robot(ReadOnly):
    """A tree of joints on a fixed base.

    Parameters
    ----------
    name
        Its name.
    joints
        Every moving joint, a parent before its children.
    gravity
        Acceleration of free fall (3,) in the frame of the base, m/s^2.
    source
        Name of the file that it was read from.
    """

    name: str
    joints: tuple[Joint, ...]
    gravity: np.ndarray
    source: str = ""

    @property
    def axes(self) -> tuple[Joint, ...]:
        """The joints that move by themselves: their positions are the coordinates ``q``."""
        return tuple(j for j in self.joints if j.tie is None)

    @property
    def inertial(self) -> np.ndarray:
        """The inertial constants (10 L,) of all links, link by link."""
        return np.concatenate([j.inertial for j in self.joints])

    @property
    def ties(self) -> tuple[np.ndarray, np.ndarray]:
        """``F`` (joints, axes) and ``c`` (joints,): positions of all joints are ``F q + c``."""
        names, column = [j.name for j in self.joints], {j.name: k for k, j in enumerate(self.axes)}
        F, c = np.zeros((len(names), len(column))), np.zeros(len(names))
        for row, joint in enumerate(self.joints):
            factor, offset = 1.0, 0.0
            # A follower of a follower: its factors multiply.
            for _ in names:
                if joint.tie is None:
                    break
                offset += factor * joint.tie.offset
                factor *= joint.tie.factor
                joint = self.joints[names.index(joint.tie.leader)]
            F[row, column[joint.name]], c[row] = factor, offset
        return F, c

    def lock(self, positions: Mapping[str, float]) -> Robot:
        """The robot with axes held still at ``positions`` (rad or m): their links are lumped into what carries them.

        Raises ModelError for a name that is no axis, and where no axis is left.
        """
        names = [j.name for j in self.axes]
        for name in positions:
            if name not in names:
                raise ModelError(f"robot {self.name!r} has no axis {name!r} to hold; {nearest(name, names)}")
        if len(positions) == len(names):
            raise ModelError(f"robot {self.name!r}: all {len(names)} axes would be held, and nothing could move")
        F, c = self.ties
        q = F @ np.array([positions.get(name, 0.0) for name in names]) + c
        held = np.abs(F[:, [n in positions for n in names]]).any(axis=1)
        bodies = []
        for joint, position, is_held in zip(self.joints, q, held, strict=True):
            parent = self.joints[joint.parent].link if joint.parent >= 0 else ""
            pose = move_joint(joint, position) if is_held else (joint.rotation, joint.origin)
            bodies.append(Body(joint.link, parent, *pose, joint.inertial, None if is_held else joint))
        return build_robot(self.name, bodies, self.gravity, self.source)


@dataclass(frozen=True, eq=False)
class Body:
    """A link as a description file states it: pose in its parent (``""``: the base), and its joint, or None if it is fixed."""

    name: str
    parent: str
    rotation: np.ndarray
    origin: np.ndarray
    inertial: np.ndarray
    joint: Joint | None


def build_robot(name: str, bodies: Sequence[Body], gravity: Sequence[float] | np.ndarray, source: str = "") -> Robot:
    """A robot of bodies, a parent before its children: those that are fixed are lumped into the ones that carry them.

    Raises ModelError where nothing moves, or a joint follows one that is not there.
    """
    moving = sum(body.joint is not None for body in bodies)
    if not 0 < moving <= MOST_JOINTS:
        reason = f"{MOST_JOINTS} are read at most" if moving else "all its links are fixed to the base"
        raise ModelError(f"robot {name!r} has {moving or 'no'} moving joints: {reason}")
    for kind, names in (
        ("link", [b.name for b in bodies]),
        ("joint", [b.joint.name for b in bodies if b.joint is not None]),
    ):
        if twice := {name for name in names if names.count(name) > 1}:
            raise ModelError(f"robot {name!r} has more than one {kind} {min(twice)!r}")
    joints: list[Joint] = []
    # Name of a body -> number of the joint that moves it, and its pose in that joint's frame.
    carried: dict[str, tuple[int, np.ndarray]] = {"": (-1, np.eye(4))}
    for body in bodies:
        parent, pose = carried[body.parent]
        pose = pose @ to_pose(body.rotation, body.origin)
        if body.joint is not None:
            placed = {"rotation": pose[:3, :3], "origin": pose[:3, 3], "inertial": np.zeros(10)}
            joints.append(replace(body.joint, parent=parent, **placed))
            parent, pose = len(joints) - 1, np.eye(4)
        carried[body.name] = parent, pose
        # What is fixed to the base never moves, and no record tells of it.
        if parent >= 0:
            lumped = joints[parent].inertial + move_inertial(body.inertial, pose)
            joints[parent] = replace(joints[parent], inertial=lumped)
    for joint in joints:
        _check_tie(joint, {j.name: j for j in joints})
    return Robot(name, tuple(joints), np.array(gravity, float), source)


def _check_tie(joint: Joint, known: Mapping[str, Joint]) -> None:
    """Raise ModelError where a joint follows what is not there, or itself through others."""
    visited, each = {joint.name}, joint
    while each.tie is not None:
        if each.tie.leader not in known:
            raise ModelError(f"joint {each.name!r} follows {each.tie.leader!r}, which is no moving joint of the robot; "
                             f"{nearest(each.tie.leader, known)}")  # fmt: skip
        each = known[each.tie.leader]
        if each.name in visited:
            raise ModelError(f"joint {joint.name!r} follows itself through {each.name!r}: one of them must move freely")
        visited.add(each.name)


def to_pose(rotation: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Homogeneous matrix (4, 4) of a rotation (3, 3) and an origin (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, origin
    return pose


def move_joint(joint: Joint, q: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and origin (3,) of a joint's frame in its parent at position ``q`` in rad or m."""
    if joint.kind is JointKind.PRISMATIC:
        return joint.rotation, joint.origin + joint.rotation @ joint.axis * q
    return joint.rotation @ rotate_about(joint.axis, q), joint.origin


def rotate_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation (3, 3) about a unit axis (3,) by an angle in rad."""
    return np.asarray(Rotation.from_rotvec(angle * axis).as_matrix())


def to_pseudo_inertia(inertial: np.ndarray) -> np.ndarray:
    """Pseudo-inertia (4, 4) of the ten constants: ``[[S, h], [h', m]]`` with the second moments ``S = tr(I) / 2 - I``.

    A body whose mass is nowhere negative has a positive one (Wensing, Kim, Slotine, IEEE Robotics and Automation Letters 3, 2018).
    """
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = inertial
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    P = np.empty((4, 4))
    P[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    P[3, :3] = P[:3, 3] = hx, hy, hz
    P[3, 3] = m
    return P


def from_pseudo_inertia(P: np.ndarray) -> np.ndarray:
    """The ten constants of a pseudo-inertia (4, 4): ``I = tr(S) - S``."""
    inertia = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    xx, xy, xz, yy, yz, zz = inertia[np.triu_indices(3)]
    return np.array([P[3, 3], *P[:3, 3], xx, xy, yy, xz, yz, zz])


def move_inertial(inertial: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The ten constants of a body in another frame, in which its own has a ``pose`` (4, 4): ``P' = T P T'``."""
    return from_pseudo_inertia(pose @ to_pseudo_inertia(inertial) @ pose.T)
