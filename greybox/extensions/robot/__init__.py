"""Robots: from a description (URDF, MJCF) and a joint log to base parameters with intervals, and to what each joint lacks."""

from typing import TYPE_CHECKING

from greybox.base.faces import lazy_face

if TYPE_CHECKING:
    from greybox.extensions.robot.base_parameters import BaseParameters, find_base_parameters
    from greybox.extensions.robot.description import Joint, JointKind, Robot
    from greybox.extensions.robot.description_files import read_robot
    from greybox.extensions.robot.design import MotionDesign, design_motion
    from greybox.extensions.robot.identify import identify_robot
    from greybox.extensions.robot.logs import read_joint_logs
    from greybox.extensions.robot.model import RobotPlant, robot, robot_model
    from greybox.extensions.robot.result import RobotIdentification
    from greybox.extensions.robot.rigid_body import RigidBody

__getattr__, __all__, __dir__ = lazy_face(__name__)
