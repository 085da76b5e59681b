"""What the identification of a robot gives back, as a value and as ``robot.json``."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np

from greybox.base.json_file import StoredResult
from greybox.base.json_shape import FileKind, Interval
from greybox.base.values import Finding, Printable
from greybox.discovery.decision import Grade


class RobotCode(StrEnum):
    """Codes of the findings."""

    AXIS_HELD = "robot_axis_held"
    AXIS_WITHOUT_ROWS = "robot_axis_without_rows"
    VELOCITY_LATE = "robot_velocity_late"
    READ_SELDOM = "robot_read_seldom"
    LONG_MEMORY = "robot_long_memory"
    OPEN_CONSTANTS = "robot_open_constants"
    RIVAL = "robot_rival"
    SCALED = "robot_scaled"
    PHYSICAL = "robot_physical"
    JOINTS_BY_NAME = "robot_joints_by_name"
    NOT_FOLLOWED = "robot_not_followed"
    GAIN = "robot_gain"
    TORQUE_LEVEL = "robot_torque_level"
    CONSTANT_UNTOLD = "robot_constant_untold"


class RigidVerdict(StrEnum):
    """How the rigid bodies of the record compare with those of the description."""

    AS_DESCRIBED = "as described"
    PAYLOAD = "as described, with a payload"
    SCALED = "as described, times a factor"
    OTHER = "other than described"


@dataclass(frozen=True)
class BaseEstimate:
    """One base parameter.

    Parameters
    ----------
    name, formula, unit
        Its leading constant, the sum of constants that it is, and the unit.
    value, std, interval
        The estimate, its standard error and its 95 % interval.
    described
        What the description says.
    is_open
        Whether the record hardly tells it.
    """

    name: str
    formula: str
    unit: str
    value: float
    std: float
    interval: Interval
    described: float
    is_open: bool


@dataclass(frozen=True)
class JointEffect:
    """One effect of a joint beside the rigid bodies.

    Parameters
    ----------
    joint, kind
        Where, and which kind of `greybox.extensions.robot.table`.
    value, std, interval, unit
        Its constant.
    grade
        What may be said of it.
    share
        Share of the rms error of the joint's torque that it takes.
    rival
        The effect that would do nearly as well in its place, "" where none does.
    """

    joint: str
    kind: str
    value: float
    std: float
    interval: Interval
    unit: str
    grade: Grade
    share: float
    rival: str = ""


@dataclass(frozen=True)
class Payload:
    """What is fixed to the last link beside the description.

    Parameters
    ----------
    link
        Its link.
    mass, mass_std, mass_interval
        In kg.
    centre
        Place of its centre of mass in the frame of the last joint, in m.
    """

    link: str
    mass: float
    mass_std: float
    mass_interval: Interval
    centre: tuple[float, float, float]


@dataclass(frozen=True)
class JointMisfit:
    """How well the torque of a joint is followed, rms in its unit.

    Parameters
    ----------
    joint, unit
        The joint and its unit.
    rows
        Rows that count: the joint moves, and its torque is measured.
    torque, rigid, final
        Of the torque itself; of what rigid bodies alone leave; of what is left with all effects.
    """

    joint: str
    unit: str
    rows: int
    torque: float
    rigid: float
    final: float


@dataclass(frozen=True)
class TorqueConstant:
    """What one ampere gives at a joint, gear included.

    Parameters
    ----------
    joint
        The joint.
    value, std, interval, unit
        The constant, N m/A or N/A; of its level a finding says what it rests on.
    ratio, ratio_interval
        To that of the first joint whose constant was fitted: this the currents tell by themselves.
    """

    joint: str
    value: float
    std: float
    interval: Interval
    unit: str
    ratio: float
    ratio_interval: Interval


@dataclass(frozen=True, eq=False)
class RobotIdentification(StoredResult, Printable):
    """What logs say of a robot.

    Parameters
    ----------
    robot, source
        Its name, and the file of the description.
    records
        Names of the logs.
    rows, blocks
        Rows that were used, and the blocks of them that the errors are known from.
    base
        The base parameters.
    effects
        What the joints have beside rigid bodies.
    joints
        How well each torque is followed.
    torque_constants
        Those that were fitted.
    verdict, payload
        How the rigid bodies compare with the description, and the payload, where one explains the difference.
    findings
        What a reader should know.
    time, torques
        Times (N,) in s, and torques (3, N, n) of the axes that count: measured, of the rigid bodies, with all effects; NaN elsewhere.
    """

    robot: str
    source: str
    records: tuple[str, ...]
    rows: int
    blocks: int
    base: tuple[BaseEstimate, ...]
    effects: tuple[JointEffect, ...]
    joints: tuple[JointMisfit, ...]
    torque_constants: tuple[TorqueConstant, ...]
    verdict: RigidVerdict
    payload: Payload | None
    findings: tuple[Finding, ...]
    time: np.ndarray
    torques: np.ndarray

    FILE: ClassVar[FileKind] = FileKind("an identification of a robot", "robot.json that greybox robot has written")
    KEYS: ClassVar[str] = (
        "robot source records rows blocks verdict payload base effects joints torque_constants notes=str(findings) findings"
    )
