"""A robot as a model: a relation for each joint, around the torques of its rigid bodies.

At joint ``k`` torques add up to zero, ``0 = tau - B dq - Jm ddq - (rigid bodies) + effects``. Solved for the accelerations these are the
equations of motion, which run freely, are fitted, linearised and exported; solved for the torques they are the inverse dynamics, whose
exported function is a controller's feed-forward. Both have the same constants and the same places for effects.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np

from greybox.base import to_identifiers
from greybox.data.experiment import Experiment
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.description_files import read_robot
from greybox.extensions.robot.motion import reconstruct_motion
from greybox.extensions.robot.result import RobotCode, RobotIdentification
from greybox.extensions.robot.rigid_body import RigidBody, evaluate_rows
from greybox.extensions.robot.table import COLUMNS, COULOMB, INERTIA, OFFSET, VISCOUS, effect_columns
from greybox.model import Balance, Block, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import effect as catalogue_effect
from greybox.model.effects.catalogue import place_effect
from greybox.model.signals import NamedValues
from greybox.simulation.plant import PlantModel

# Kinds of `greybox.extensions.robot.table` that are constants of the model; and those that are effects of the catalogue, with their
# constant and its sign: an offset of the torque is a load with the other sign.
CONSTANTS = {VISCOUS.name: "B", INERTIA.name: "Jm"}
EFFECTS = {COULOMB.name: ("coulomb_friction", "Fc", 1), OFFSET.name: ("constant_load", "F0", -1)}
# Speed in rad/s or m/s below which dry friction creeps: slower than arms work, and fast enough for steps of a millisecond.
CREEP = 0.01


def robot_model(
    robot: Robot, identified: RobotIdentification | None = None, *, inverse: bool = False, creep: float = CREEP
) -> Model:
    """The model of a robot: positions by torques, or torques by the motion.

    Constants are its base parameters, which begin as described, and each joint's viscous friction ``B1`` and motor inertia ``Jm1``, which
    are fixed as described until they are freed. A joint takes effects at ``joint_1``; dry friction in its smoothed form where the arm moves
    freely, as joints push one another through their inertias.

    Parameters
    ----------
    robot
        The robot as described.
    identified
        What `identify_robot` says of it: base parameters, viscous and dry friction, offsets and motor inertias are taken over, and axes
        that it held are held. The rest of what it names is left out, and the description of the model says so.
    inverse
        Whether it is solved for the torques: inputs are then ``q1``, ``dq1``, ``ddq1`` ..., outputs ``tau1`` ...
    creep
        Speed in rad/s or m/s below which dry friction is viscous where the arm moves freely.

    Returns
    -------
    Model
        States ``q1``, ``dq1`` ... in rad or m and rad/s or m/s, inputs ``tau1`` ... in N m or N, outputs ``q1`` ... (or the inverse).

    Examples
    --------
    ``robot_model(arm) + gb.effect("coulomb_friction_at_joint_1").smoothed(0.01)``
    """
    if identified is not None:
        held = [f.subject for f in identified.findings if f.code == RobotCode.AXIS_HELD]
        robot = robot.lock(dict.fromkeys(held, 0.0)) if held else robot
    base, links = find_base_parameters(robot), len(robot.joints)
    plant = _JointRelations(base, RigidBody(robot).inverse_dynamics, inverse)
    signals = {s: [(f"{s}{k}", j.units[s]) for k, j in enumerate(robot.axes, 1)] for s in ("q", "dq", "ddq", "tau")}
    motion, torques = [*signals["q"], *signals["dq"], *signals["ddq"]], signals["tau"]
    model = Model(
        to_identifiers([robot.name])[0],
        states=[State(*signal) for signal in (torques if inverse else motion)],
        inputs=[Input(*signal) for signal in (motion if inverse else torques)],
        outputs=[Output(*signal) for signal in signals["tau" if inverse else "q"]],
        parameters=[*base.parameters, *_joint_constants(robot)],
        balances=plant,
        has=("gear", "contact"),
        description=f"{'torques' if inverse else 'motion'} of {links} link{'s' * (links > 1)}",
        source=robot.source,
    )
    return model if identified is None else _take_over(model, robot, identified, inverse, creep)


def _take_over(model: Model, robot: Robot, identified: RobotIdentification, inverse: bool, creep: float) -> Model:
    """The model with the constants and the effects that were identified."""
    numbers = {joint.name: k for k, joint in enumerate(robot.axes, 1)}
    values = {b.name: b.value for b in identified.base}
    parameters = [
        replace(q, value=values[q.name], source="identified") if q.name in values else q for q in model.parameters
    ]
    model = replace(model, parameters=parameters)
    left_out = []
    for each in identified.effects:
        k = numbers[each.joint]
        if each.kind in CONSTANTS:
            model = model.fix(**{f"{CONSTANTS[each.kind]}{k}": max(each.value, 0.0)})
        elif each.kind in EFFECTS:
            name, constant, sign = EFFECTS[each.kind]
            effect = place_effect(catalogue_effect(name), f"joint_{k}")
            model = model + (effect if inverse else effect.smoothed(creep))
            model = model.start(**{model.names_of(effect.name)[constant]: sign * each.value})
        else:
            left_out.append(f"{each.kind} at {each.joint}")
    lacks = f"; without {', '.join(left_out)}" if left_out else ""
    return replace(model, description=model.description + lacks)


class _JointRelations:
    """The balances of a robot's model; two of the same robot are told apart, and each states the same whenever it is asked."""

    def __init__(self, base: BaseParameters, inverse_dynamics: ca.Function, inverse: bool) -> None:
        self.base, self.inverse_dynamics, self.inverse = base, inverse_dynamics, inverse
        count = len(base.robot.joints)
        self.label = f"-rigid body of {count} link{'s' * (count > 1)}"

    def __call__(self, x: NamedValues, u: NamedValues, p: NamedValues) -> list[Balance]:
        axes, z = self.base.robot.axes, u if self.inverse else x
        numbers = range(1, len(axes) + 1)
        q, dq, ddq = (ca.vertcat(*[z[f"{s}{k}"] for k in numbers]) for s in ("q", "dq", "ddq"))
        rigid = self.inverse_dynamics(q, dq, ddq, self._inertial(p))
        balances = []
        for k, joint in zip(numbers, axes, strict=True):
            unit = joint.units["tau"]
            motor = x[f"tau{k}"] if self.inverse else u[f"tau{k}"]
            others = {"viscous": -p[f"B{k}"] * dq[k - 1], "rotor": -p[f"Jm{k}"] * ddq[k - 1]}
            body = Block(self.label, -rigid[k - 1], unit)
            solved = f"tau{k}" if self.inverse else f"ddq{k}"
            relation = Balance(f"joint_{k}", unit, 0, solved, motor=motor, **others, body=body)
            balances.append(relation.moving(f"dq{k}", f"q{k}"))
            if not self.inverse:
                balances.append(Balance(f"position_{k}", joint.units["dq"], 1, f"q{k}", speed=dq[k - 1]))
                balances.append(Balance(f"speed_{k}", joint.units["ddq"], 1, f"dq{k}", acceleration=ddq[k - 1]))
        return balances

    def _inertial(self, p: NamedValues) -> ca.SX:
        """Constants of all links (10 L,) that have the base parameters; what these leave open is zero, and moves nothing."""
        theta = ca.SX(len(self.base.robot.inertial), 1)
        theta[self.base.columns.tolist()] = ca.vertcat(*[p[name] for name in self.base.names])
        return theta


def _joint_constants(robot: Robot) -> Iterator[Parameter]:
    """Viscous friction and motor inertia of each joint, as described and fixed."""
    for k, joint in enumerate(robot.axes, 1):
        for kind, value in ((VISCOUS, joint.damping), (INERTIA, joint.armature)):
            name, words = f"{CONSTANTS[kind.name]}{k}", f"{kind.words} of {joint.name}"
            yield Parameter(name, kind.unit_at(joint), value, (0.0, math.inf), True, "description", "", words)


# The robot as a plant: the torques of its drives from the motion of its axes, linear in all its constants.

# What a joint has from the start; `identify_robot` looks for more.
JOINT_CONSTANTS = (VISCOUS, COULOMB, OFFSET)


@dataclass(frozen=True, eq=False)
class RobotPlant:
    """A robot as a plant (`greybox.simulation.plant.Plant`): torques ``tau1`` ... from positions ``q1`` ..., which are differentiated.

    Its constants are the base parameters, and viscous friction, dry friction and offset of each axis.

    Attributes
    ----------
    robot
        The robot as described.
    """

    robot: Robot
    cheap: bool = True
    _columns: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    def __str__(self) -> str:
        n, rank = len(self.robot.axes), len(self.base.names)
        return f"{self.robot.name}: {n} axes, {rank} base parameters; torques from {', '.join(i.name for i in self.inputs)}"

    @property
    def name(self) -> str:
        """Its name as an identifier."""
        return to_identifiers([self.robot.name])[0]

    @property
    def description(self) -> str:
        """What it is, for people."""
        return f"inverse dynamics of {self.robot.source or self.robot.name}"

    @property
    def identity(self) -> str:
        """What tells it from others, in every process: its links."""
        return f"{self.robot.name} {hashlib.sha256(self.robot.inertial.tobytes()).hexdigest()[:16]}"

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Positions of the axes."""
        return tuple(Input(f"q{k}", j.units["q"]) for k, j in enumerate(self.robot.axes, 1))

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Torques of the axes."""
        return tuple(Output(f"tau{k}", j.units["tau"]) for k, j in enumerate(self.robot.axes, 1))

    @cached_property
    def base(self) -> BaseParameters:
        """Its base parameters."""
        return find_base_parameters(self.robot)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Base parameters as described, then the constants of the joints, at zero."""
        of_joints = [
            Parameter(f"{kind.name}{k}", kind.unit_at(joint), 0.0, description=f"{kind.words} of {joint.name}")
            for k, joint in enumerate(self.robot.axes, 1)
            for kind in JOINT_CONSTANTS
        ]
        return (*self.base.parameters, *of_joints)

    @cached_property
    def model(self) -> PlantModel:
        """The model that states its signals and constants."""
        return PlantModel.of(self)

    @property
    def log_model(self) -> Model:
        """What a log of it may hold, for reading: positions, velocities, torques and currents; none of them must be there."""
        signals = [
            # An encoder counts turns from new, or between -pi and pi.
            Output(
                f"{name}{k}", joint.units[name], wraps=math.tau if (name, joint.units[name]) == ("q", "rad") else 0.0
            )
            for k, joint in enumerate(self.robot.axes, 1)
            for name in ("q", "dq", "tau", "i")
        ]
        return PlantModel.of(SimpleNamespace(name=self.name, inputs=(), outputs=signals, parameters=()))

    def simulate(self, record: Experiment, values: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Torques (N,) by name."""
        constants = np.array([values[p.name] for p in self.parameters])
        return {o.name: self._columns_of(record)[:, k] @ constants for k, o in enumerate(self.outputs)}

    def differentiate(
        self, record: Experiment, values: Mapping[str, float], names: Sequence[str], outputs: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Slopes (N, n, names): the columns themselves."""
        places = {p.name: k for k, p in enumerate(self.parameters)}
        return self._columns_of(record)[:, :, [places[name] for name in names]]

    def _columns_of(self, record: Experiment) -> np.ndarray:
        """What each constant adds to each torque at unit value (N, n, P)."""
        if record.fingerprint not in self._columns:
            n = len(self.robot.axes)
            motion = reconstruct_motion(record, range(1, n + 1), keep_ends=True)
            rigid = evaluate_rows(self.base.regressor, motion.q, motion.dq, motion.ddq)
            joints = np.zeros((len(rigid), n, n, len(JOINT_CONSTANTS)))
            for i in range(n):
                none = np.zeros(len(rigid))
                every = effect_columns(motion.dq[:, i], motion.ddq[:, i], none, none)
                joints[:, i, i] = every[:, [COLUMNS.index(kind) for kind in JOINT_CONSTANTS]]
            self._columns[record.fingerprint] = np.concatenate([rigid, joints.reshape(len(rigid), n, -1)], axis=2)
        return self._columns[record.fingerprint]


def robot(path: str | os.PathLike[str]) -> RobotPlant:
    """A robot from a URDF or an MJCF file as a plant: `greybox.fit` fits its base parameters, `gb.robots.identify_robot` looks further.

    Parameters
    ----------
    path
        The file; nothing beside it is opened.

    Returns
    -------
    RobotPlant
        Its inputs are the positions ``q1`` ... in rad or m, its outputs the torques ``tau1`` ... in N m or N.

    Raises
    ------
    GreyboxError
        For a file that cannot be read or holds no robot that is carried, see `greybox.robots.read_robot`.
    """
    return RobotPlant(read_robot(path))
