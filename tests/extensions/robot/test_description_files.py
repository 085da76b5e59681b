"""What is no robot that is carried is refused, each with one message; nothing beside the file is opened."""

from __future__ import annotations

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
    "an included file": ('<mujoco><include file="other.xml"/><worldbody/></mujoco>', "other files, which are not opened"),
    "a free joint": (MJCF.format("<freejoint/>", ""), "floats"),
    "a ball": (MJCF.format('<joint type="ball"/>', ""), "type ball"),
    "a loop of MuJoCo": (MJCF.format("", '<equality><connect body1="a"/></equality>'), "closed chain"),
    "mass of shapes": (MJCF.format('<joint/><geom size="1"/>', ""), "no <inertial>"),
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
