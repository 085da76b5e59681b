"""A robot as a model: a relation for each joint, around the torques of its rigid bodies.

At joint ``k`` torques add up to zero, ``0 = tau - B dq - Jm ddq - (rigid bodies) + effects``. Solved for the accelerations these are the
equations of motion, which run freely, are fitted, linearised and exported; solved for the torques they are the inverse dynamics, whose
exported function is a controller's feed-forward. Both have the same constants and the same places for effects.
"""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Joint, JointKind, Robot
from greybox.extensions.robot.rigid_body import RigidBody
from greybox.model import Balance, Block, Input, Model, Output, Parameter, State
from greybox.model.signals import NamedValues


def robot_model(robot: Robot, *, inverse: bool = False) -> Model:
    """The model of a robot: positions by torques, or torques by the motion.

    Constants are its base parameters, which begin as described, and each joint's viscous friction ``B1`` and motor inertia ``Jm1``, which
    are fixed as described until they are freed. A joint takes effects at ``joint_1``; dry friction in its smoothed form where the arm moves
    freely, as joints push one another through their inertias.

    Parameters
    ----------
    robot
        The robot as described.
    inverse
        Whether it is solved for the torques: inputs are then ``q1``, ``dq1``, ``ddq1`` ..., outputs ``tau1`` ...

    Returns
    -------
    Model
        States ``q1``, ``dq1`` ... in rad or m and rad/s or m/s, inputs ``tau1`` ... in N m or N, outputs ``q1`` ... (or the inverse).

    Examples
    --------
    ``robot_model(arm) + gb.effect("coulomb_friction_at_joint_1").smoothed(0.01)``
    """
    base, links = find_base_parameters(robot), len(robot.joints)
    plant = _JointRelations(base, RigidBody(robot).inverse_dynamics, inverse)
    motion = [(f"{s}{k}", unit) for s in ("q", "dq", "ddq") for k, unit in _numbered(robot, s)]
    torques = [(f"tau{k}", unit) for k, unit in _numbered(robot, "tau")]
    return Model(
        robot.name.replace(" ", "_"),
        states=[State(*signal) for signal in (torques if inverse else motion)],
        inputs=[Input(*signal) for signal in (motion if inverse else torques)],
        outputs=[Output(*signal) for signal in (torques if inverse else motion[: len(torques)])],
        parameters=[*_base_constants(base), *_joint_constants(robot)],
        balances=plant,
        has=("gear", "contact"),
        description=f"{'torques' if inverse else 'motion'} of {links} link{'s' * (links > 1)}",
        source=robot.source,
    )


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
            unit, rates = joint.units[1], _rate_units(joint)
            motor = x[f"tau{k}"] if self.inverse else u[f"tau{k}"]
            others = {"viscous": -p[f"B{k}"] * dq[k - 1], "rotor": -p[f"Jm{k}"] * ddq[k - 1]}
            body = Block(self.label, -rigid[k - 1], unit)
            solved = f"tau{k}" if self.inverse else f"ddq{k}"
            relation = Balance(f"joint_{k}", unit, 0, solved, motor=motor, **others, body=body)
            balances.append(relation.moving(f"dq{k}", f"q{k}"))
            if not self.inverse:
                balances.append(Balance(f"position_{k}", rates[0], 1, f"q{k}", speed=dq[k - 1]))
                balances.append(Balance(f"speed_{k}", rates[1], 1, f"dq{k}", acceleration=ddq[k - 1]))
        return balances

    def _inertial(self, p: NamedValues) -> ca.SX:
        """Constants of all links (10 L,) that have the base parameters; what these leave open is zero, and moves nothing."""
        theta = ca.SX(len(self.base.robot.inertial), 1)
        theta[self.base.columns.tolist()] = ca.vertcat(*[p[name] for name in self.base.names])
        return theta


def _rate_units(joint: Joint) -> tuple[str, str]:
    position = joint.units[0]
    return f"{position}/s", f"{position}/s^2"


def _numbered(robot: Robot, signal: str) -> Iterator[tuple[int, str]]:
    """Numbers of the axes, and the unit of a signal of each."""
    for k, joint in enumerate(robot.axes, 1):
        rate, acceleration = _rate_units(joint)
        yield k, {"q": joint.units[0], "dq": rate, "ddq": acceleration, "tau": joint.units[1]}[signal]


def _base_constants(base: BaseParameters) -> list[Parameter]:
    return [
        Parameter(name, unit.replace(" ", "*"), float(value), description=base.describe(k), source="description")
        for k, (name, unit, value) in enumerate(zip(base.names, base.units, base.values, strict=True))
    ]


def _joint_constants(robot: Robot) -> Iterator[Parameter]:
    """Viscous friction and motor inertia of each joint, as described and fixed."""
    for k, joint in enumerate(robot.axes, 1):
        turns = joint.kind is JointKind.REVOLUTE
        damping, inertia = ("N*m*s/rad", "kg*m^2") if turns else ("N*s/m", "kg")
        known = {"bounds": (0.0, float("inf")), "fixed": True, "source": "description"}
        yield Parameter(f"B{k}", damping, joint.damping, description=f"viscous friction of {joint.name}", **known)
        yield Parameter(f"Jm{k}", inertia, joint.armature, description=f"inertia of the motor of {joint.name}", **known)
