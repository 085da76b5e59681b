"""What is no robot that is carried is refused, each with one message; nothing beside the file is opened."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from greybox.base import DataError, GreyboxError
from greybox.extensions.robot import read_robot
from tests.support.robots import CART_POLE, DOUBLE_PENDULUM, write

MJCF = '<mujoco><worldbody><body name="a">{}</body></worldbody>{}</mujoco>'
REFUSED = {
    "no XML": ("<robot", "this is no XML"),
    "another root": ("<svg/>", "its root is <svg>"),
    "a bomb": ('<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>', "document type"),
    "a file of somebody": ('<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>', "document type"),
    "a floating base": (DOUBLE_PENDULUM.replace('"continuous"', '"floating"'), "'elbow' is floating"),
    "a planar joint": (DOUBLE_PENDULUM.replace('"continuous"', '"planar"'), "'elbow' is planar"),
    "a slip": (DOUBLE_PENDULUM.replace('"continuous"', '"revolut"'), "did you mean 'revolute'"),
    "a link that is not there": (DOUBLE_PENDULUM.replace('child link="lower"', 'child link="lowr"'), "did you mean 'lower'"),
    "a closed chain": (
        DOUBLE_PENDULUM.replace("</robot>", '<joint name="c" type="fixed"><parent link="base"/><child link="lower"/></joint></robot>'),
        "closed chain",
    ),
    "two bases": (DOUBLE_PENDULUM.replace("</robot>", '<link name="alone"/></robot>'), "'base', 'alone' hang on nothing"),
    "no base": (
        DOUBLE_PENDULUM.replace("</robot>", '<joint name="c" type="fixed"><parent link="lower"/><child link="base"/></joint></robot>'),
        "every link hangs on another",
    ),
    "no axis": (DOUBLE_PENDULUM.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>'), "has no direction"),
    "no number": (DOUBLE_PENDULUM.replace('mass value="2.0"', 'mass value="two"'), "value='two' of <mass> is not a number"),
    "a negative mass": (DOUBLE_PENDULUM.replace('mass value="2.0"', 'mass value="-2"'), "mass -2 kg is negative"),
    "a leader that is not there": (
        DOUBLE_PENDULUM.replace('<limit lower="-3"', '<mimic joint="elbo"/><limit lower="-3"'),
        "follows 'elbo', which is no moving joint",
    ),
    "a circle of followers": (
        DOUBLE_PENDULUM.replace('<limit lower="-3"', '<mimic joint="shoulder"/><limit lower="-3"'),
        "follows itself",
    ),
    "nothing that moves": (
        DOUBLE_PENDULUM.replace('"continuous"', '"fixed"').replace('"revolute"', '"fixed"'),
        "has no moving joint",
    ),
    "an included file": ('<mujoco><include file="other.xml"/><worldbody/></mujoco>', "it has <include>, and its bodies are not read"),
    "a free joint": (MJCF.format("<freejoint/>", ""), "floats"),
    "a ball": (MJCF.format('<joint type="ball"/>', ""), "type ball"),
    "a loop of MuJoCo": (MJCF.format("", '<equality><connect body1="a"/></equality>'), "closed chain"),
    "mass of shapes": (MJCF.format('<joint/><geom size="1"/>', ""), "no <inertial>"),
    "bodies in a frame": (
        MJCF.format('<joint/><frame pos="1 0 0"><body name="b"><joint/></body></frame>', ""),
        "it has <frame>, and its bodies are not read",
    ),
    "a spring": (CART_POLE.replace('damping="0.3"', 'damping="0.3" stiffness="5"'), "<joint> has stiffness='5', which is not carried"),
    "weight taken off": (CART_POLE.replace('name="bob"', 'name="bob" gravcomp="1"'), "<body> has gravcomp='1', which is not carried"),
    "masses of shapes": (
        CART_POLE.replace('angle="degree"', 'angle="degree" inertiafromgeom="true"'),
        "<compiler> has inertiafromgeom='true', which is not carried; mj_saveLastXML",
    ),
    "no weight": (
        CART_POLE.replace("<worldbody>", '<option><flag gravity="disable"/></option><worldbody>'),
        "<flag> has gravity='disable', which is not carried",
    ),
    "two joints of one name": (DOUBLE_PENDULUM.replace('"elbow"', '"shoulder"'), "more than one joint 'shoulder'"),
    "two links of one name": (DOUBLE_PENDULUM.replace("</robot>", '<link name="lower"/></robot>'), "two of its links have the same name"),
    "a mass that is no attribute": (
        DOUBLE_PENDULUM.replace('<mass value="2.0"/>', "<mass>2.0</mass>"),
        "link 'lower': its <inertial> has no <mass value=...>",
    ),
    "a macro that is left": (
        DOUBLE_PENDULUM.replace("</robot>", '<xacro:hand xmlns:xacro="http://www.ros.org/wiki/xacro"/></robot>'),
        "it still has <xacro:hand>",
    ),
    "an unknown class": (CART_POLE.replace('childclass="hinge"', 'childclass="hing"'), "did you mean 'hinge'"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_it_is_refused(case: str, tmp_path: Path) -> None:
    text, reason = REFUSED[case]
    with pytest.raises(GreyboxError) as refusal:
        read_robot(write(tmp_path / "strange.urdf", text))
    message = str(refusal.value)
    assert message.startswith("strange.urdf: ") and reason in message and "\n" not in message


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.urdf: the robot description cannot be read"):
        read_robot(tmp_path / "none.urdf")


def test_a_description_of_deep_nesting_ends_in_a_sentence(tmp_path: Path) -> None:
    deep = "".join(f'<body name="b{k}"><joint name="j{k}"/>' for k in range(3000)) + "</body>" * 3000
    with pytest.raises(GreyboxError, match="3000 moving joints: 256 are read at most"):
        read_robot(write(tmp_path / "deep.xml", f"<mujoco><worldbody>{deep}</worldbody></mujoco>"))


def test_limits_that_are_both_zero_are_none(tmp_path: Path) -> None:
    text = DOUBLE_PENDULUM.replace('lower="-3" upper="3"', 'lower="0" upper="0"')
    shoulder, _ = read_robot(write(tmp_path / "arm.urdf", text)).axes
    assert (shoulder.lower, shoulder.upper, shoulder.effort) == (-math.inf, math.inf, 60.0)


def test_sections_of_mujoco_add_up(tmp_path: Path) -> None:
    """Several of one name are one; the outermost class is called main; an equality that is switched off ties nothing."""
    text = CART_POLE.replace("<default><default", '<default class="main"><joint damping="0.7"/><default')
    text = text.replace('name="rail"', 'name="rail" class="main"')
    more = """<option timestep="0.001"/><option gravity="0 0 -1.6"/>
      <worldbody><body name="z"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="last"/></body></worldbody>
      <equality><joint joint1="pivot" joint2="rail" active="false"/></equality></mujoco>"""
    robot = read_robot(write(tmp_path / "a.xml", text.replace("</mujoco>", more)))
    assert [(j.name, j.damping) for j in robot.axes] == [("rail", 0.7), ("pivot", 0.3), ("last", 0.7)]
    assert robot.gravity.tolist() == [0, 0, -1.6]
