"""A robot as a plant: the torques of its drives from the motion of its axes, linear in all its constants."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from greybox.base import to_identifiers
from greybox.data.experiment import Experiment
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.description_files import read_robot
from greybox.extensions.robot.joint_effects import COLUMNS, COULOMB, OFFSET, VISCOUS, effect_columns
from greybox.extensions.robot.motion import reconstruct_motion
from greybox.extensions.robot.rigid_body import evaluate_rows
from greybox.model import Input, Model, Output, Parameter
from greybox.simulation.plant import PlantModel

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
            Output(f"{name}{k}", joint.units[name])
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
