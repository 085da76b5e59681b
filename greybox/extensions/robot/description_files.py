"""Robots read from URDF and MJCF files. Only the file itself is opened: meshes and included files are not."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from greybox.base import DataError, ModelError, nearest
from greybox.extensions.robot.description import (
    GRAVITY,
    INERTIAL_NAMES,
    Body,
    Follows,
    Joint,
    JointKind,
    Robot,
    build_robot,
    move_inertial,
    move_joint,
    rotate_about,
    to_pose,
)

# A description of a robot has less; a larger file is something else.
MOST_BYTES = 64_000_000
# An axis is a direction: what is shorter is a slip.
SHORTEST_AXIS = 1e-6
MOVING = {"revolute": JointKind.REVOLUTE, "continuous": JointKind.REVOLUTE, "prismatic": JointKind.PRISMATIC}


class _Builder(ElementTree.TreeBuilder):
    """Refuses document types, before an entity in one of them could grow or name a file."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ModelError("it declares a document type (DTD), which a robot description needs not: remove it")


def read_robot(path: str | os.PathLike[str]) -> Robot:
    """A robot from a URDF or an MJCF file.

    Parameters
    ----------
    path
        The file; its root element says which kind it is. Nothing beside it is opened.

    Returns
    -------
    Robot
        Fixed links are lumped into what carries them; joints that mimic others are ties.

    Raises
    ------
    DataError
        If the file cannot be read.
    ModelError
        For what is no XML or no robot, and for what is not carried: floating bases, closed chains, ball and planar joints.
    """
    file = Path(path)
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ModelError(f"{file.name}: a robot description of more than {MOST_BYTES // 1_000_000} MB is not read")
        content = file.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: the robot description cannot be read: {error.strerror or error}") from error
    try:
        root = ElementTree.fromstring(content, ElementTree.XMLParser(target=_Builder()))
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ModelError(f"{file.name}: this is no XML: {error}") from error
    except ModelError as error:
        raise ModelError(f"{file.name}: {error}") from error
    readers = {"robot": _read_urdf, "mujoco": _read_mjcf}
    try:
        if root.tag not in readers:
            raise ModelError(
                f"its root is <{root.tag}>; a URDF has <robot>, an MJCF <mujoco> (xacro turns its files into URDF)"
            )
        return readers[root.tag](root, file)
    except ModelError as error:
        raise ModelError(f"{file.name}: {error}") from error


def _numbers(element: Element | None, name: str, default: Sequence[float], owner: str = "") -> np.ndarray:
    """Numbers of an attribute, as many as the default has. Raises ModelError."""
    text = None if element is None else element.get(name)
    if element is None or text is None:
        return np.array(default, float)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != len(default) or not np.isfinite(values).all():
        numbers = "a number" if len(default) == 1 else f"{len(default)} numbers"
        raise ModelError(f"{owner or element.tag}: {name}={text!r} of <{element.tag}> is not {numbers}")
    return values


def _number(element: Element | None, name: str, default: float, owner: str = "") -> float:
    """A number; the default, which may be infinite, where it is not stated."""
    return float(_numbers(element, name, [default], owner)[0])


def _unit(axis: np.ndarray, owner: str) -> np.ndarray:
    length = float(np.linalg.norm(axis))
    if length < SHORTEST_AXIS:
        raise ModelError(f"joint {owner!r}: its axis {axis.tolist()} has no direction")
    return np.asarray(axis / length)


def _at_centre(mass: float, inertia: Iterable[float], owner: str) -> np.ndarray:
    """The ten constants of a body about its centre of mass, of the six of its inertia. Raises ModelError for a negative mass."""
    if mass < 0:
        raise ModelError(f"link {owner!r}: its mass {mass:g} kg is negative")
    return np.array([mass, 0.0, 0.0, 0.0, *inertia])


# URDF (wiki.ros.org/urdf/XML).


def _read_urdf(root: Element, file: Path) -> Robot:
    for element in root.iter():
        if "xacro}" in element.tag:
            raise ModelError(f"it still has <xacro:{element.tag.rpartition('}')[2]}>: xacro turns it into a URDF")
    if root.find("loop_joint") is not None:
        raise ModelError("it has a <loop_joint>: a closed chain is not carried, only a tree")
    links = {_name(link): link for link in root.findall("link")}
    if not links:
        raise ModelError("it has no <link>: a xacro file becomes a URDF by xacro")
    if len(links) < len(root.findall("link")):
        raise ModelError("two of its links have the same name")
    children: dict[str, list[Element]] = {}
    moved: dict[str, str] = {}
    for joint in root.findall("joint"):
        name, child = _name(joint), _end(joint, "child", links)
        if child in moved:
            both = f"{moved[child]!r} and {name!r}"
            raise ModelError(f"link {child!r} hangs on two joints, {both}: a closed chain is not carried, only a tree")
        moved[child] = name
        children.setdefault(_end(joint, "parent", links), []).append(joint)
    bases = [name for name in links if name not in moved]
    if len(bases) != 1:
        hang = (
            f"the links {', '.join(map(repr, bases[:5]))} hang on nothing" if bases else "every link hangs on another"
        )
        raise ModelError(f"{hang}; a robot has one base")
    bodies = [Body(bases[0], "", np.eye(3), np.zeros(3), np.zeros(10), None)]
    # Children in the order of the file, each branch to its end.
    open_joints = list(reversed(children.get(bases[0], [])))
    while open_joints:
        element = open_joints.pop()
        bodies.append(_read_urdf_joint(element, links))
        open_joints.extend(reversed(children.get(bodies[-1].name, [])))
    return build_robot(root.get("name") or file.stem, bodies, GRAVITY, file.name)


def _name(element: Element) -> str:
    name = element.get("name")
    if not name:
        raise ModelError(f"a <{element.tag}> has no name")
    return name


def _end(joint: Element, which: str, links: dict[str, Element]) -> str:
    element = joint.find(which)
    name = "" if element is None else element.get("link", "")
    if name not in links:
        raise ModelError(
            f"joint {_name(joint)!r}: its {which} link {name!r} is not in the file; {nearest(name, links)}"
        )
    return name


def _read_urdf_joint(element: Element, links: dict[str, Element]) -> Body:
    """A joint with its child link."""
    name, kind, child = _name(element), element.get("type", ""), _end(element, "child", links)
    rotation, origin = _urdf_pose(element, name)
    parent = _end(element, "parent", links)
    inertial = _urdf_inertial(links[child], child)
    if kind == "fixed":
        return Body(child, parent, rotation, origin, inertial, None)
    if kind not in MOVING:
        floats = (
            "a robot stands on a fixed base" if kind in ("floating", "planar") else nearest(kind, [*MOVING, "fixed"])
        )
        raise ModelError(f"joint {name!r} is {kind or 'of no type'}: only revolute, continuous, prismatic and fixed joints are"
                         f" carried; {floats}")  # fmt: skip
    limit, dynamics, mimic = (element.find(tag) for tag in ("limit", "dynamics", "mimic"))
    tie = None
    if mimic is not None:
        factors = _number(mimic, "multiplier", 1.0, name), _number(mimic, "offset", 0.0, name)
        tie = Follows(mimic.get("joint", ""), *factors)
    lower, upper = _number(limit, "lower", -math.inf, name), _number(limit, "upper", math.inf, name)
    # Zeros stand for "not known" in many files: no joint has a limit of zero.
    is_limited = kind != "continuous" and lower < upper
    joint = Joint(
        *(name, child, MOVING[kind], -1, rotation, origin),
        _unit(_numbers(element.find("axis"), "xyz", (1, 0, 0), name), name),
        np.zeros(10),
        *((lower, upper) if is_limited else (-math.inf, math.inf)),
        _number(limit, "velocity", math.inf, name) or math.inf,
        _number(limit, "effort", math.inf, name) or math.inf,
        _number(dynamics, "damping", 0.0, name),
        _number(dynamics, "friction", 0.0, name),
        tie=tie,
    )
    return Body(child, parent, rotation, origin, inertial, joint)


def _urdf_pose(element: Element | None, owner: str) -> tuple[np.ndarray, np.ndarray]:
    origin = None if element is None else element.find("origin")
    rpy = _numbers(origin, "rpy", (0, 0, 0), owner)
    # Roll, pitch and yaw about the fixed axes x, y, z: R = Rz Ry Rx.
    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix()), _numbers(origin, "xyz", (0, 0, 0), owner)


def _urdf_inertial(link: Element, name: str) -> np.ndarray:
    element = link.find("inertial")
    if element is None:
        return np.zeros(10)
    mass = _number(element.find("mass"), "value", math.nan, name)
    if math.isnan(mass):
        raise ModelError(f"link {name!r}: its <inertial> has no <mass value=...>")
    inertia = (_number(element.find("inertia"), constant.lower(), 0.0, name) for constant in INERTIAL_NAMES[4:])
    return move_inertial(_at_centre(mass, inertia, name), to_pose(*_urdf_pose(element, name)))


# MJCF (mujoco.readthedocs.io/en/stable/XMLreference.html).

# What would drive or close a chain: none of it is a tree of joints any more.
CLOSING = ("connect", "weld", "tendon", "flex", "flexvert", "flexstrain")
# What changes masses, bodies or torques and is not read: element -> attributes, where they state something else than these.
NOT_READ: dict[str, tuple[str, ...]] = {
    "compiler": ("inertiafromgeom", "settotalmass", "boundmass", "boundinertia", "balanceinertia", "coordinate"),
    **{
        "option": ("density", "viscosity"),
        "flag": ("gravity",),
        "body": ("gravcomp",),
        "joint": ("stiffness", "springdamper"),
    },
    **dict.fromkeys(("fixed", "spatial"), ("stiffness", "damping", "frictionloss")),
}
# What is stated where there is none of it.
NOTHING = ("false", "auto", "local", "enable", "-1")
# What stands for bodies that it does not spell out, wherever it holds some.
MACROS = ("include", "attach", "frame", "replicate", "composite", "flexcomp")
# What makes one file of them all.
WRITTEN_OUT = "mj_saveLastXML of MuJoCo writes it out as one file"
MJCF_MOVING = {"hinge": JointKind.REVOLUTE, "slide": JointKind.PRISMATIC}


def _read_mjcf(root: Element, file: Path) -> Robot:
    for element in root.iter():
        if element.tag in MACROS and (element.tag not in ("frame", "replicate") or element.find(".//body") is not None):
            raise ModelError(f"it has <{element.tag}>, and its bodies are not read; {WRITTEN_OUT}")
        for name in NOT_READ.get(element.tag, ()):
            if (value := element.get(name, "0")) not in NOTHING and value.strip("0. "):
                remedy = WRITTEN_OUT if element.tag == "compiler" else "remove it where the robot is to be without it"
                raise ModelError(f"<{element.tag}> has {name}={value!r}, which is not carried; {remedy}")
    if root.find("worldbody") is None:
        raise ModelError("it has no <worldbody>")
    for element in (e for equality in root.findall("equality") for e in equality):
        if element.tag in CLOSING:
            raise ModelError(f"<equality> has a <{element.tag}>: a closed chain is not carried, only a tree")
    bodies = list(_MjcfReader(root).read_bodies(root.findall("worldbody/body")))
    # Of several sections the last that states it counts.
    gravity = _numbers(([None, *root.findall("option[@gravity]")])[-1], "gravity", GRAVITY)
    return build_robot(root.get("model") or file.stem, bodies, gravity, file.name)


class _MjcfReader:
    """What the whole file says: units of angles, order of Euler angles, defaults by class, joints that follow others."""

    def __init__(self, root: Element) -> None:
        stated = {name: value for compiler in root.findall("compiler") for name, value in compiler.attrib.items()}
        self.angle = 1.0 if stated.get("angle", "degree") == "radian" else math.pi / 180
        self.euler = stated.get("eulerseq", "xyz")
        # Attributes of joints by class: a class has those of the one around it, and its own.
        self.defaults: dict[str, dict[str, str]] = {"": {}, "main": {}}
        waiting: list[tuple[Element, str, dict[str, str]]] = [(default, "", {}) for default in root.findall("default")]
        while waiting:
            element, name, above = waiting.pop()
            joint = element.find("joint")
            self.defaults[name] = {**self.defaults.get(name, {}), **above, **({} if joint is None else joint.attrib)}
            if not name:
                # The outermost class is called main where it has no name of its own.
                self.defaults[element.get("class", "main")] = self.defaults[""]
            waiting += [(e, e.get("class", ""), self.defaults[name]) for e in element.findall("default")]
        self.ties: dict[str, Follows] = {}
        for joint in root.findall("equality/joint"):
            if joint.get("active") == "false":
                continue
            offset, factor, *higher = (joint.get("polycoef") or "0 1").split()
            if any(float(c) for c in higher) or "joint2" not in joint.attrib:
                raise ModelError(
                    f"joint {joint.get('joint1')!r} follows no other one on a straight line: such an <equality> is not carried"
                )
            self.ties[joint.get("joint1", "")] = Follows(joint.attrib["joint2"], float(factor), float(offset))

    def read_bodies(self, world: Sequence[Element]) -> Iterator[Body]:
        """Every body with its joints, a parent before its children: each joint has a frame of its own, the last carries the body."""
        waiting = [(element, "", "", False) for element in reversed(world)]
        count = 0
        while waiting:
            element, parent, class_name, is_moved = waiting.pop()
            # A body without a name gets one that no file gives.
            name, count = element.get("name") or f"body #{count}", count + 1
            class_name = element.get("childclass", class_name)
            rotation, origin, carrier = self._rotation(element, name), _numbers(element, "pos", (0, 0, 0), name), parent
            if element.find("freejoint") is not None:
                raise ModelError(f"body {name!r} floats (<freejoint>): a robot stands on a fixed base")
            for number, stated in enumerate(element.findall("joint")):
                joint, at, zero = self._read_joint(stated, name, f"{name}.{number}", class_name)
                # The joint turns the body about a point of it: a frame there, and back to the body's own.
                turned, shifted = move_joint(joint, -zero)
                place = origin + rotation @ (at + shifted)
                yield Body(joint.link, carrier, rotation @ turned, place, np.zeros(10), joint)
                carrier, rotation, origin, is_moved = joint.link, np.eye(3), -at, True
            inertial = self._inertial(element, name) if is_moved else np.zeros(10)
            yield Body(name, carrier, rotation, origin, inertial, None)
            waiting += [(child, name, class_name, is_moved) for child in reversed(element.findall("body"))]

    def _read_joint(self, element: Element, body: str, link: str, class_name: str) -> tuple[Joint, np.ndarray, float]:
        """A joint, its place (3,) in the body, and its position where the body stands as the file draws it."""
        class_name = element.get("class", class_name)
        if class_name not in self.defaults:
            near = nearest(class_name, self.defaults)
            raise ModelError(f"body {body!r}: there is no default class {class_name!r}; {near}")
        element = Element("joint", {**self.defaults[class_name], **element.attrib})
        name, kind = element.get("name") or link, element.get("type", "hinge")
        if kind not in MJCF_MOVING:
            raise ModelError(f"joint {name!r} is of type {kind}: only hinge and slide are carried, on a fixed base")
        is_hinge = kind == "hinge"
        angle = self.angle if is_hinge else 1.0
        lower, upper = _numbers(element, "range", (-math.inf, math.inf), name) * angle
        is_limited = element.get("limited", "auto") != "false" and lower < upper
        joint = Joint(
            *(name, link, MJCF_MOVING[kind], -1, np.eye(3), np.zeros(3)),
            _unit(_numbers(element, "axis", (0, 0, 1), name), name),
            np.zeros(10),
            *((float(lower), float(upper)) if is_limited else (-math.inf, math.inf)),
            effort=float(_numbers(element, "actuatorfrcrange", (-math.inf, math.inf), name)[1]),
            damping=_number(element, "damping", 0.0, name),
            friction=_number(element, "frictionloss", 0.0, name),
            armature=_number(element, "armature", 0.0, name),
            tie=self.ties.get(name),
        )
        return joint, _numbers(element, "pos", (0, 0, 0), name), _number(element, "ref", 0.0, name) * angle

    def _inertial(self, element: Element, name: str) -> np.ndarray:
        stated = element.find("inertial")
        if stated is None:
            if element.find("geom") is not None:
                raise ModelError(
                    f"body {name!r} has geoms and no <inertial>: its mass would come from their shapes, which are not read;"
                    f" {WRITTEN_OUT}"
                )
            return np.zeros(10)
        if stated.get("fullinertia") is not None:
            xx, yy, zz, xy, xz, yz = _numbers(stated, "fullinertia", (0, 0, 0, 0, 0, 0), name)
        else:
            (xx, yy, zz), (xy, xz, yz) = _numbers(stated, "diaginertia", (0, 0, 0), name), (0.0, 0.0, 0.0)
        centre = _at_centre(_number(stated, "mass", 0.0, name), (xx, xy, yy, xz, yz, zz), name)
        return move_inertial(centre, to_pose(self._rotation(stated, name), _numbers(stated, "pos", (0, 0, 0), name)))

    def _rotation(self, element: Element, owner: str) -> np.ndarray:
        """Rotation (3, 3) of an element, whichever of the five ways states it."""
        if element.get("quat") is not None:
            # The scalar stands first here, and last there.
            scalar_last = np.roll(_numbers(element, "quat", (1, 0, 0, 0), owner), -1)
            return np.asarray(Rotation.from_quat(scalar_last).as_matrix())
        if element.get("axisangle") is not None:
            stated = _numbers(element, "axisangle", (0, 0, 1, 0), owner)
            return rotate_about(_unit(stated[:3], owner), stated[3] * self.angle)
        if element.get("xyaxes") is not None:
            axes = _numbers(element, "xyaxes", (1, 0, 0, 0, 1, 0), owner)
            x = _unit(axes[:3], owner)
            # Only what is normal to x counts.
            y = _unit(axes[3:] - (axes[3:] @ x) * x, owner)
            return np.column_stack([x, y, np.cross(x, y)])
        if element.get("zaxis") is not None:
            # The least turn that takes the vertical there.
            turn, _ = Rotation.align_vectors([_numbers(element, "zaxis", (0, 0, 1), owner)], [[0, 0, 1]])
            return np.asarray(turn.as_matrix())
        # Small letters are axes that turn along, capital ones those that stand still: the other way round there.
        angles = _numbers(element, "euler", (0, 0, 0), owner) * self.angle
        return np.asarray(Rotation.from_euler(self.euler.swapcase(), angles).as_matrix())
