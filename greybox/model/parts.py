"""What a rig is made of, and how often a rig with such parts lacks an effect in its plain model.

Records alone cannot refuse an effect with memory: it follows whatever is left. Knowledge of the rig can. A rig has a part, lacks it, or
nobody has said; what an effect needs and how usual it is stands beside its definition (`Effect.needs`, `occurs`, `occurs_with`).
The classes are a judgement on counts of what 109 published, shipped or fitted models of rigs have beyond inertia, viscous damping, a
linear spring, weight and linear circuits; they are good to a factor of two.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

import casadi as ca

from greybox.base import ModelError, nearest, parse_unit

if TYPE_CHECKING:
    from greybox.model.effect import Effect
    from greybox.model.model import Model


class Occurrence(StrEnum):
    """How often a rig with the part that an effect needs lacks this effect in its plain model, at one place."""

    USUAL = "usual"
    COMMON = "common"
    OCCASIONAL = "occasional"
    RARE = "rare"
    EXOTIC = "exotic"

    @property
    def probability(self) -> float:
        """Of the effect at a place, given the part."""
        return PROBABILITIES[self]


# Share of the rigs with the part that have the effect. Usual against exotic is 5.3 nats in log odds: it decides near ties, and no clear
# record, in which one needless constant costs 3.5 nats at a thousand samples.
PROBABILITIES: Mapping[Occurrence, float] = {
    Occurrence.USUAL: 0.5,
    Occurrence.COMMON: 0.2,
    Occurrence.OCCASIONAL: 0.07,
    Occurrence.RARE: 0.02,
    Occurrence.EXOTIC: 0.005,
}


@dataclass(frozen=True)
class Part:
    """A part that a rig may have.

    Parameters
    ----------
    name
        What ``has=`` and ``lacks=`` of a model call it.
    meaning
        What it is, with examples.
    question
        How somebody who knows the rig is asked for it.
    implies
        Parts that it brings with it.
    replaces
        Parts that a rig with this one lacks, unless it is said to have them.
    """

    name: str
    meaning: str
    question: str
    implies: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()


# Every part, those of mechanics first, then drives, process and sensors.
PARTS: tuple[Part, ...] = (
    Part(
        "contact",
        "two bodies that touch while they move: bearing, guide, seal, gear, tyre, brush",
        "does anything rub or roll on what moves (bearing, guide, seal, gear, tyre)?",
    ),
    Part(
        "gear",
        "gear, screw, worm or belt between the drive and what moves",
        "is there a gear, a screw or a belt between the drive and what moves?",
        implies=("contact",),
    ),
    Part(
        "fluid",
        "air or water around a body so fast that its drag counts",
        "is the body so fast in air or water that its drag counts?",
    ),
    Part("hull", "hull of a vessel, or an aerofoil", "is it a vessel or an aircraft?", implies=("fluid",)),
    Part(
        "free",
        "free flight: nothing drives, guides or holds the body",
        "is the body in free flight, with nothing that drives, guides or holds it?",
        replaces=(
            "contact",
            "gear",
            "spring",
            "rubber",
            "hysteretic",
            "elastic",
            "motor",
            "magnets",
            "voice_coil",
            "weight",
        ),
    ),
    Part(
        "spring",
        "spring, flexure, cable or membrane that is strained far",
        "is there a spring, a flexure, a cable or a membrane that is strained far?",
    ),
    Part(
        "rubber", "rubber, polymer, glue or a soft actuator", "does rubber, polymer or glue carry a part of the force?"
    ),
    Part(
        "hysteretic",
        "piezo, shape memory, magneto-rheological or wire-rope damper, pneumatic muscle, leaf spring, bolted joint",
        "is there a piezo, a shape memory alloy, a magneto-rheological or wire-rope damper, a muscle, a leaf spring or a bolted joint?",
    ),
    Part(
        "elastic",
        "second mass on something elastic: belt, long shaft, elastic joint, arm, frame, slosh",
        "is there a second mass on something elastic (belt, long shaft, elastic joint, frame)?",
    ),
    Part("stop", "mechanical stop within the travel", "is there a stop within the travel?"),
    Part(
        "weight",
        "weight that the drive carries: vertical axis, arm about a horizontal axis, an axis that leans",
        "does the drive carry a weight (vertical axis, arm about a horizontal axis)?",
    ),
    Part("motor", "electric motor", "does an electric motor drive it?", implies=("contact",)),
    Part(
        "magnets",
        "magnets beside iron teeth, in direct drive: iron-core linear motor, stepper, gimbal",
        "do magnets pass iron teeth in direct drive (iron-core linear motor, stepper)?",
        implies=("motor",),
    ),
    Part("voice_coil", "voice coil or solenoid with travel", "does a voice coil or a solenoid drive it?"),
    Part(
        "actuator",
        "propeller, rudder, fan, heater or pump behind the command",
        "does a propeller, a rudder, a fan, a heater or a pump stand behind the command?",
    ),
    Part(
        "link",
        "computer, bus, radio, camera or pipe between the command and what it does",
        "is there a computer, a bus, a radio or a pipe between the recorded command and what it does?",
    ),
    Part("valve", "spool or diaphragm valve", "does a valve drive it?"),
    Part(
        "seal",
        "sliding seal, ball guide or precision stage",
        "is there a sliding seal or a ball guide?",
        implies=("contact",),
    ),
    Part(
        "single_rod",
        "cylinder with unequal areas, or a valve with unequal edges",
        "is it a cylinder with a rod on one side only?",
    ),
    Part(
        "second_body",
        "second thermal body: wall, mass, block of the sensor",
        "is there a second body that takes up heat (wall, block, water)?",
    ),
    Part(
        "slow_sensor",
        "sensor with mass, a protective tube or a filter: of temperature, gas, humidity",
        "has the sensor a mass, a protective tube or a filter?",
    ),
    Part(
        "analogue",
        "analogue sensor: infrared, Hall, potentiometer, ultrasonic, strain gauge, level by pressure",
        "is the sensor analogue (infrared, Hall, potentiometer, ultrasonic, strain gauge)?",
    ),
    Part(
        "encoder",
        "encoder, tacho or timer: a reading that counts",
        "does the sensor count (encoder, timer)?",
        replaces=("analogue", "slow_sensor"),
    ),
    Part(
        "video",
        "video or a clock of its own: scale and time are not those of the rig",
        "does a video, or a recorder with a clock of its own, measure it?",
        replaces=("slow_sensor",),
    ),
)
_PARTS = {part.name: part for part in PARTS}


def part(name: str) -> Part:
    """The part of this name. Raises ModelError for an unknown one, with the nearest names."""
    if name not in _PARTS:
        raise ModelError(f"no part is called {name!r}; {nearest(name, list(_PARTS))}")
    return _PARTS[name]


def check_parts(subject: str, has: Sequence[str], lacks: Sequence[str]) -> None:
    """Refuse unknown parts, and parts that a rig is said to have and to lack.

    Raises ModelError with all offenders; ``subject`` begins the message.
    """
    for key, names in (("has", has), ("lacks", lacks)):
        if isinstance(names, str):
            raise ModelError(f"{subject}: {key}={names!r}; give names of parts, as in {key}=({names!r},)")
    unknown = [name for name in (*has, *lacks) if name not in _PARTS]
    problems = [f"no part is called {name!r}; {nearest(name, list(_PARTS))}" for name in dict.fromkeys(unknown)]
    problems += [f"it has {name!r} and lacks it; say one of them" for name in dict.fromkeys(has) if name in lacks]
    if problems:
        raise ModelError(f"{subject}: {'; '.join(problems)}")


# How a part is known that somebody said.
TOLD = "told"


@dataclass(frozen=True)
class RigParts:
    """What is known of the parts of a rig; of those in neither nobody has said anything.

    Parameters
    ----------
    has, lacks
        Part -> how that is known: ``told``, or what it follows from.
    """

    has: Mapping[str, str] = field(default_factory=dict)
    lacks: Mapping[str, str] = field(default_factory=dict)

    @property
    def told(self) -> RigParts:
        """What somebody has said, without what follows."""
        has, lacks = ({n: how for n, how in known.items() if how == TOLD} for known in (self.has, self.lacks))
        return RigParts(has, lacks)

    def is_open(self, name: str) -> bool:
        """Whether nothing is known of a part."""
        return name not in self.has and name not in self.lacks

    def missing(self, effect: Effect) -> str:
        """The part that makes an effect impossible here; "" where it is possible: it has one of those that it needs, or may have."""
        needs = effect.needs
        return needs[0] if needs and all(name in self.lacks for name in needs) else ""

    def occurrence(self, effect: Effect) -> Occurrence:
        """The class of an effect on this rig: that of the first of its parts that is there, else its own."""
        return next((kind for name, kind in effect.occurs_with.items() if name in self.has), effect.occurs)

    def speak_against(self, effect: Effect) -> bool:
        """Whether an effect is rare or exotic for a part that the rig has."""
        named = any(name in self.has for name in effect.occurs_with)
        return named and self.occurrence(effect) in (Occurrence.RARE, Occurrence.EXOTIC)


def read_parts(model: Model) -> RigParts:
    """What a model says of its rig's parts, and what follows from its inputs, roles, units and equations.

    What is said stands before what follows.
    """
    has, lacks = dict.fromkeys(model.has, TOLD), dict.fromkeys(model.lacks, TOLD)
    for name, reason in _find_present(model):
        if name not in lacks:
            has.setdefault(name, reason)
    for name in list(has):
        for implied in _implied(name):
            if implied not in lacks:
                has.setdefault(implied, f"it has {name}")
    for name, reason in _find_absent(model, has):
        if name not in has:
            lacks.setdefault(name, reason)
    return RigParts(has, lacks)


def _implied(name: str) -> Iterable[str]:
    for other in _PARTS[name].implies:
        yield other
        yield from _implied(other)


def _find_present(model: Model) -> Iterable[tuple[str, str]]:
    """Parts that a model shows, with the reason."""
    yield from (("valve", f"input {i.name} is a valve") for i in model.inputs if i.role == "valve")
    roles = {role for site in model.sites for role in site.states}
    if "chamber_a" in roles:
        yield "seal", "a piston parts two chambers"
    if "current" in roles and any(site.turns for site in model.sites):
        yield "motor", "a current makes it turn"
    if "temperature" in roles and all(_has_unit(o.unit, "K") for o in model.outputs):
        yield "slow_sensor", "a temperature is measured"
    if _is_free(model):
        yield "free", FREE


# Why a body counts as free, and what its drive is not.
FREE = "nothing in the model drives or holds it"
# Units of an input that an electric motor or a coil may stand behind.
ELECTRIC = ("V", "A", "N", "N*m", "1", "m/s^2", "rad/s^2")


def _find_absent(model: Model, has: Mapping[str, str]) -> Iterable[tuple[str, str]]:
    """Parts that a model rules out, with the reason."""
    for name, known in has.items():
        # That nothing in the model holds a body is no word on what rubs on it.
        replaced = [other for other in _PARTS[name].replaces if known != FREE or other != "contact"]
        yield from ((other, f"it has {name}" if known == TOLD else known) for other in replaced)
    if not model.inputs:
        undriven = ("motor", "magnets", "voice_coil", "actuator", "link", "valve", "single_rod")
        yield from ((name, "the model has no input") for name in undriven)
    elif not any(_has_unit(i.unit, unit) for i in model.inputs for unit in ELECTRIC) and not any(
        "current" in site.states for site in model.sites
    ):
        units = ", ".join(dict.fromkeys(i.unit for i in model.inputs))
        yield from ((name, f"no motor is driven in {units}") for name in ("motor", "magnets", "voice_coil"))


def _has_unit(unit: str, wanted: str) -> bool:
    try:
        return parse_unit(unit).dimensions == parse_unit(wanted).dimensions
    except ModelError:  # the unit check of the model says which one
        return False


def _is_free(model: Model) -> bool:
    """Whether a body moves, nothing drives it, and no force on it depends on where it is."""
    motions = [site for site in model.sites if site.is_motion]
    if model.inputs or not motions or not model.has_equations:
        return False
    system = model.system
    index = {name: k for k, name in enumerate(system.state_names)}
    velocities = [index[site.states["velocity"]] for site in motions if site.states["velocity"] in index]
    places = [k for k in index.values() if k not in velocities]
    return bool(ca.jacobian(system.rhs[velocities], system.x)[:, places].nnz() == 0) if places else True
