"""A robot as a model: a relation for each joint, around the torques of its rigid bodies.

At joint ``k`` torques add up to zero, ``0 = tau - B dq - Jm ddq - (rigid bodies) + effects``. Solved for the accelerations these are the
equations of motion, which run freely, are fitted, linearised and exported; solved for the torques they are the inverse dynamics, whose
exported function is a controller's feed-forward. Both have the same constants and the same places for effects.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import casadi as ca

from greybox.base import to_identifiers
from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
from greybox.extensions.robot.description import Robot
from greybox.extensions.robot.joint_effects import COULOMB, INERTIA, OFFSET, VISCOUS
from greybox.extensions.robot.result import RobotCode, RobotIdentification
from greybox.extensions.robot.rigid_body import RigidBody
from greybox.model import Balance, Block, Input, Model, Output, Parameter, State
from greybox.model.effects.catalogue import effect as catalogue_effect
from greybox.model.effects.catalogue import place_effect
from greybox.model.signals import NamedValues

# Kinds of `greybox.extensions.robot.joint_effects` that are constants of the model; and those that are effects of the catalogue, with their
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
