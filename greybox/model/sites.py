"""Sites: the places in a model where an effect may act, found by role and unit and not by name alone.

A *force* is any balance of a velocity: its state has the role ``velocity``, or its unit is a force, a torque or an acceleration and that
of its state a speed. Likewise a state in A whose balance is in V is a current, one in K with a balance in W a temperature, and one in m
with a balance in m^3/s a level. So every body of a drive train may have friction, whatever its balance is called. Seen from a site the
roles ``velocity`` and ``displacement`` mean the body there; a displacement is the state whose rate is that velocity.

Inputs and parameters have a role without being told where a balance tells it: the only one with the unit of a temperature in the balance of
a temperature is that of the surroundings, the only one in ohm in the balance of a current its resistance (`complete_roles`).

A relation (a balance that stores nothing) of forces is a force as well, where its motion is known: the velocity it is solved for; the one
whose rate is the acceleration it is solved for; of one solved for a force the only input with the role ``velocity``; or what
`Balance.moving` says.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import casadi as ca

from greybox.base import MissingNameError, ModelError, nearest, parse_unit
from greybox.model.balance import Balance, stores_nothing
from greybox.model.signals import Input, Output, State

if TYPE_CHECKING:
    from greybox.model.system import ParameterSymbol

MOTION, STORE, PRESSURE, HEAT, VOLTAGE, ANGLE, SHAFT, FIRST_INPUT, DRIVE, VALVE, SENSOR = (
    *("force", "store", "pressure", "heat", "voltage", "angle", "shaft"),
    *("input", "drive", "valve", "sensor"),
)
# Words for balances of a state with a role, beside those of motion.
# Role -> units of a balance and of its state that tell it.
ROLE_OF_WORD = {STORE: "store", PRESSURE: "pressure", HEAT: "temperature", VOLTAGE: "current"}
STORE_ROLES = ("pressure", "level", "upper_head", "lower_head")
# A prefix does not change what a balance is of: kW and kN are W and N.
SPEEDS, FORCES, ACCELERATIONS = (
    tuple(parse_unit(unit).dimensions for unit in units)
    for units in (("m/s", "rad/s"), ("N", "N*m", "m/s^2", "rad/s^2"), ("m/s^2", "rad/s^2"))
)
ROLES_BY_UNITS = {
    role: (parse_unit(balance).dimensions, parse_unit(state).dimensions)
    for role, balance, state in (("current", "V", "A"), ("temperature", "W", "K"), ("level", "m^3/s", "m"))
}
_KIND_OF_BALANCE = re.compile(r"_(torque|force|balance|moment|motion)$")


class PlaceKind(StrEnum):
    """What a site is."""

    BALANCE = "balance"
    INPUT = "input"
    OUTPUT = "output"


@dataclass(frozen=True)
class Site:
    """A place where effects may act.

    Parameters
    ----------
    name
        Of the balance, the input or the output.
    kind
        Which of these it is.
    label
        What the names of effects there end with: ``coulomb_friction_at_load`` of a balance ``load_torque``.
    states
        Role -> state, as an effect there sees them; an empty name where the model has no such state at this site. The motion of a relation
        may be an input.
    inputs
        Role -> input, likewise.
    units
        Word -> unit, for the units of the effect's parameters.
    role
        Of an input, its role.
    """

    name: str
    kind: PlaceKind
    label: str
    states: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    role: str = ""

    @property
    def is_motion(self) -> bool:
        """Whether it is the balance of a velocity."""
        return bool(self.states.get("velocity"))

    @property
    def turns(self) -> bool:
        """Whether that velocity is one of rotation."""
        return self.is_motion and parse_unit(self.units["velocity"]) == parse_unit("rad/s")


# What a place is that a word of the catalogue means, where it is no balance.
KIND_OF_WORD = dict.fromkeys((FIRST_INPUT, DRIVE, VALVE), PlaceKind.INPUT) | {SENSOR: PlaceKind.OUTPUT}
# What a place must be for each word that effects name it by.
NEEDED: Mapping[str, str] = {
    MOTION: "a balance of a velocity, in N, N m or per mass",
    STORE: "a balance of a pressure or a level (role `pressure`, `level`, `upper_head` or `lower_head`)",
    PRESSURE: "a balance of a pressure difference (role `pressure`)",
    HEAT: "a balance of a temperature (role `temperature`)",
    VOLTAGE: "a balance of a current (role `current`)",
    ANGLE: "a balance of a velocity whose angle in rad is a state, too",
    SHAFT: "a balance of a velocity in rad/s whose angle is not a state",
    FIRST_INPUT: "an input",
    DRIVE: "an input with the role `drive`, or with none",
    VALVE: "an input with the role `valve`",
    SENSOR: "an output",
}


def list_sites(
    states: Sequence[State], inputs: Sequence[Input], outputs: Sequence[Output], balances: Sequence[Balance]
) -> tuple[Site, ...]:
    """Every balance, input and output of a model as a site, in this order."""
    names = [b.name for b in balances]
    taken = {i.name for i in inputs} | {o.name for o in outputs}
    short = {name: _KIND_OF_BALANCE.sub("", name) for name in names}
    used = [*short.values(), *taken]
    labels = {name: s if used.count(s) == 1 and (s == name or s not in names) else name for name, s in short.items()}
    by_name = {s.name: s for s in states}
    units_of = {i.name: i.unit for i in inputs} | {s.name: s.unit for s in states}
    motions = _find_motions(states, inputs, balances)
    sites = []
    drives = [i.name for i in inputs if i.role == DRIVE] or [i.name for i in inputs if _takes(DRIVE, i.role)]
    driven = {DRIVE: drives[0]} if drives else {}
    for b in balances:
        state = by_name[b.state]
        motion = motions.get(b.name, {})
        role = state.role or _role_by_units(b, state)
        roles, units = {role: state.name} if role else {}, {MOTION: b.unit}
        if role == ROLE_OF_WORD[VOLTAGE]:
            units |= {VOLTAGE: b.unit, role: state.unit}
        if role == ROLE_OF_WORD[HEAT]:
            units[role] = state.unit
        if role in STORE_ROLES:
            roles[STORE] = state.name
            units[STORE] = units[role] = state.unit
        if motion:
            roles |= motion
            units |= {role: units_of[name] if name else "" for role, name in motion.items()}
        sites.append(Site(b.name, PlaceKind.BALANCE, labels[b.name], roles, driven, units))
    for i in inputs:
        words = (FIRST_INPUT, DRIVE, VALVE)
        named, units = dict.fromkeys(words, i.name), dict.fromkeys(words, i.unit)
        sites.append(Site(i.name, PlaceKind.INPUT, i.name, {}, named, units, i.role))
    sites += [Site(o.name, PlaceKind.OUTPUT, o.name, {}, {}, {SENSOR: o.unit}) for o in outputs]
    return tuple(sites)


def find_sites(word: str, sites: Sequence[Site]) -> tuple[Site, ...]:
    """The sites that ``word`` means, the one first that it means where only one is asked for.

    A balance, an input or an output of that name is meant first, but for words of the catalogue that mean another kind of place: a
    balance called `sensor` is none. An input's role means all inputs that have it.
    """
    kinds = {KIND_OF_WORD.get(word, PlaceKind.BALANCE)} if word in NEEDED else {*PlaceKind}
    places = [s for s in sites if s.kind in kinds]
    named = [s for s in places if s.name == word] or [s for s in places if s.label == word]
    if word == MOTION:
        meant = [s for s in sites if s.kind is PlaceKind.BALANCE and s.is_motion]
    elif word in (ANGLE, SHAFT):
        meant = [s for s in sites if s.is_motion and s.turns and bool(s.states.get("displacement")) == (word == ANGLE)]
    elif word in ROLE_OF_WORD:
        meant = [s for s in sites if s.kind is PlaceKind.BALANCE and s.states.get(ROLE_OF_WORD[word])]
    elif word == SENSOR:
        meant = [s for s in sites if s.kind is PlaceKind.OUTPUT]
    else:
        meant = [s for s in sites if s.kind is PlaceKind.INPUT and _takes(word, s.role)]
    first = named[:1]
    return (*first, *(s for s in meant if s not in first))


def require_site(effect: str, word: str, model: str, sites: Sequence[Site]) -> Site:
    """The site of an effect. Raises ModelError where the model has none, with what it needs."""
    meant = find_sites(word, sites)
    if meant:
        return meant[0]
    remedy = f"it needs {NEEDED[word]}" if word in NEEDED else nearest(word, [s.name for s in sites])
    raise MissingNameError(
        f"effect {effect!r} acts at {word!r}, which model {model!r} does not have; {remedy}", "site", word
    )


def _takes(word: str, role: str) -> bool:
    return word == FIRST_INPUT or role == word or (word == DRIVE and not role)


@dataclass(frozen=True)
class _ToldRole:
    """A role that a balance tells: that of the state it is of, whether it is what is stored there or stands in a term, and units."""

    state: str
    is_stored: bool
    units: tuple[str, ...]


ROLES_BY_BALANCE: Mapping[str, _ToldRole] = {
    "ambient_temperature": _ToldRole("temperature", False, ("K",)),
    "resistance": _ToldRole("current", False, ("ohm",)),
    "inductance": _ToldRole("current", True, ("H",)),
    "force_constant": _ToldRole("velocity", False, ("N/A", "N*m/A")),
    # Where it is not the force constant itself, which has the role already.
    "back_emf_constant": _ToldRole("current", False, ("V*s/m", "V*s/rad")),
}


def complete_roles(
    states: Sequence[State], inputs: Sequence[Input], parameters: Sequence[ParameterSymbol], balances: Sequence[Balance]
) -> tuple[tuple[Input, ...], tuple[ParameterSymbol, ...]]:
    """Inputs and parameters with the roles that a balance tells: of those without a role the only one there with a unit of that role.

    Whoever states a role himself, of whichever signal, is believed.
    """
    inputs, parameters = tuple(inputs), tuple(parameters)
    by_name, motions = {s.name: s for s in states}, _find_motions(states, inputs, balances)
    of_state = {
        b.name: "velocity" if b.name in motions else by_name[b.state].role or _role_by_units(b, by_name[b.state])
        for b in balances
    }
    for role, rule in ROLES_BY_BALANCE.items():
        every: tuple[Input | ParameterSymbol, ...] = (*inputs, *parameters)
        if any(item.role == role for item in every):
            continue
        known = [parse_unit(unit).dimensions for unit in rule.units]
        bare = [item.name for item in every if not item.role and _has_dimensions(item.unit, known)]
        if not bare:
            continue
        lines = [
            ca.SX(b.storage) if rule.is_stored else sum(map(ca.SX, b.terms.values()), ca.SX(0))
            for b in balances
            if of_state[b.name] == rule.state
        ]
        used = {symbol.name() for symbol in ca.symvar(ca.SX(ca.vertcat(*lines)))}
        names = [name for name in bare if name in used]
        if len(names) == 1:
            inputs = tuple(replace(i, role=role) if i.name in names else i for i in inputs)
            parameters = tuple(q._replace(role=role) if q.name in names else q for q in parameters)
    return inputs, parameters


def _role_by_units(balance: Balance, state: State) -> str:
    """The role that units alone tell of a state without one: a current in A whose balance is in V, and the like; else none."""
    try:
        units = parse_unit(balance.unit).dimensions, parse_unit(state.unit).dimensions
    except ModelError:  # the unit check of the model says which one
        return ""
    return next((role for role, known in ROLES_BY_UNITS.items() if known == units), "")


def _find_motions(
    states: Sequence[State], inputs: Sequence[Input], balances: Sequence[Balance]
) -> dict[str, dict[str, str]]:
    """Balance or relation of forces -> the velocity and the displacement of what they act on, an empty name for one that is not there."""
    known = [*(s.name for s in states), *(i.name for i in inputs)]
    rates: dict[str, str] = {}
    for b in (b for b in balances if not stores_nothing(b)):
        total = ca.SX(sum(b.terms.values(), ca.SX(0)) / b.storage)
        if total.is_symbolic() and total.name() != b.state:  # d(state)/dt is another signal
            rates.setdefault(total.name(), b.state)
    signals = {s.name: s for s in states}
    given = [i.name for i in inputs if i.role == "velocity"]
    moving: dict[str, str] = {}
    for b in balances:
        for role, name in b.motion.items():
            if name and name not in known:
                raise MissingNameError(f"balance {b.name!r}: no {role} {name!r}; {nearest(name, known)}", "state", name)
        if b.motion:
            moving[b.name] = b.motion["velocity"]
        elif _is_motion(b, signals[b.state]):
            moving[b.name] = b.state
        elif stores_nothing(b) and _has_dimensions(b.unit, FORCES):
            if _has_dimensions(signals[b.state].unit, ACCELERATIONS):
                solved = rates.get(b.state, "")
            else:  # solved for a force: the motion is given
                solved = given[0] if len(given) == 1 and _has_dimensions(signals[b.state].unit, FORCES) else ""
            if solved:
                moving[b.name] = solved
    # The forces of a body stand in its relation where its balance only says that its rate is the acceleration solved for.
    stated = {b.state: b.name for b in balances}
    for b in balances:
        if stores_nothing(b) and moving.get(b.name, "") in stated and rates.get(b.state) == moving[b.name]:
            moving.pop(stated[moving[b.name]], None)
    motions = {}
    for b in (b for b in balances if b.name in moving):
        # The displacement is the state whose rate is the velocity.
        velocity = moving[b.name]
        displacement = b.motion.get("displacement") or rates.get(velocity, "")
        displacement = displacement or _by_role("displacement", (*states, *inputs), len(moving) == 1)
        motions[b.name] = {"velocity": velocity, "displacement": displacement}
    return motions


def _is_motion(balance: Balance, state: State) -> bool:
    if state.role:
        return state.role == "velocity"
    return _has_dimensions(balance.unit, FORCES) and _has_dimensions(state.unit, SPEEDS)


def _has_dimensions(unit: str, dimensions: Sequence[tuple[tuple[str, float], ...]]) -> bool:
    try:
        return parse_unit(unit).dimensions in dimensions
    except ModelError:  # the unit check of the model says which one
        return False


def _by_role(role: str, signals: Sequence[State | Input], alone: bool) -> str:
    names = [s.name for s in signals if s.role == role]
    return names[0] if alone and names else ""
