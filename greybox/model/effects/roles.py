"""Roles: what the effects of the catalogue ask for, each with the units that it may have."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class RoleOwner(StrEnum):
    """What may have a role."""

    STATE = "state"
    INPUT = "input"
    PARAMETER = "parameter"


@dataclass(frozen=True)
class SignalRole:
    """A role that effects ask for.

    Parameters
    ----------
    name
        What is written as ``role=``.
    owners
        What may have it.
    units
        Usual units, as examples.
    meaning
        What the signal is, and from where it counts if that matters.
    needed_for
        What it opens.
    """

    name: str
    owners: tuple[RoleOwner, ...]
    units: tuple[str, ...]
    meaning: str
    needed_for: str


_STATE, _INPUT, _PARAMETER = (RoleOwner.STATE,), (RoleOwner.INPUT,), (RoleOwner.PARAMETER,)

# Every role that an effect of the catalogue asks for. Others say in a model what a signal is, and nothing asks for them.
ROLES: tuple[SignalRole, ...] = (
    SignalRole(
        "velocity",
        _STATE,
        ("m/s", "rad/s"),
        "velocity of a body. A state in m/s or rad/s whose balance is in N, N m, m/s^2 or rad/s^2 has it without being told",
        "friction, damping, loads, and with an angle cogging and gravity",
    ),
    SignalRole(
        "displacement",
        _STATE,
        ("m", "rad"),
        "position of a body. The state whose rate is the velocity has it without being told",
        "springs, stops, creep, hysteresis, second mode",
    ),
    SignalRole(
        "current",
        _STATE,
        ("A",),
        "current of a winding. A state in A whose balance is in V has it without being told",
        "effects of windings and contacts",
    ),
    SignalRole(
        "temperature",
        _STATE,
        ("K",),
        "temperature of a body, in degrees Celsius as well as in kelvin. A state in K whose balance is in W has it without being told",
        "radiation, convection, heat storage",
    ),
    SignalRole(
        "pressure",
        _STATE,
        ("Pa",),
        "difference of pressure across an actuator, or pressure of a vessel against what it leaks to",
        "leaks, relief valve, back pressure of a pump",
    ),
    SignalRole(
        "level",
        _STATE,
        ("m",),
        "level of a tank above its outlet. A state in m whose balance is in m^3/s has it without being told",
        "leak, overflow, back pressure of a pump",
    ),
    SignalRole(
        "upper_head", _STATE, ("m", "V"), "level of the upper of two tanks", "overflow that reaches the lower tank"
    ),
    SignalRole("lower_head", _STATE, ("m", "V"), "level of the lower of two tanks", "its overflow"),
    SignalRole(
        "chamber_a",
        _STATE,
        ("1", "Pa"),
        "pressure on one side of a piston; its balance is named `pressure_a`",
        "valves",
    ),
    SignalRole(
        "chamber_b", _STATE, ("1", "Pa"), "pressure on the other side; its balance is named `pressure_b`", "valves"
    ),
    SignalRole(
        "drive",
        _INPUT,
        ("V", "N", "W", "m^3/s"),
        "what is commanded. An input without a role counts as one",
        "dead zone, hysteresis and lag of the drive",
    ),
    SignalRole(
        "valve", _INPUT, ("V", "1"), "command of a valve: its spool follows", "overlap, hysteresis and lag of the spool"
    ),
    SignalRole(
        "ambient_temperature",
        (RoleOwner.INPUT, RoleOwner.PARAMETER),
        ("K",),
        "temperature to which heat is lost, on the scale of the state. The only one in K in a heat balance has it without being told",
        "radiation, convection",
    ),
    SignalRole(
        "base_acceleration",
        _INPUT,
        ("m/s^2", "rad/s^2"),
        "acceleration of the frame from which the displacement counts",
        "second mode on a shaker",
    ),
    SignalRole(
        "resistance",
        _PARAMETER,
        ("ohm",),
        "resistance of a winding. The only one in ohm in the balance of a current has it without being told, as inductance and constants of"
        " force and back EMF have theirs",
        "winding that warms, eddy currents",
    ),
    SignalRole("inductance", _PARAMETER, ("H",), "inductance of a winding", "saturating inductance"),
    SignalRole("force_constant", _PARAMETER, ("N/A", "N*m/A"), "force or torque per ampere", "droop, eddy currents"),
    SignalRole(
        "back_emf_constant",
        _PARAMETER,
        ("V*s/m", "V*s/rad"),
        "voltage per velocity, where it is not the force constant itself",
        "droop, eddy currents",
    ),
    SignalRole("piston_area", _PARAMETER, ("m^2",), "area of a piston", "volume that changes with the position"),
    SignalRole("total_volume", _PARAMETER, ("m^3",), "volume of both chambers", "choked flow, volume that changes"),
    SignalRole(
        "valve_gain", _PARAMETER, ("kg/(s*V)",), "flow per opening of a valve", "choked flow, supply that droops"
    ),
    SignalRole("supply_pressure", _PARAMETER, ("Pa",), "absolute pressure of the supply", "choked flow"),
    SignalRole("ambient_pressure", _PARAMETER, ("Pa",), "absolute pressure of the surroundings", "choked flow"),
    SignalRole("ambient_density", _PARAMETER, ("kg/m^3",), "density of the gas there", "choked flow"),
    SignalRole(
        "upper_outlet", _PARAMETER, ("m^0.5/s",), "what leaves the upper tank, per root of its level", "its overflow"
    ),
    SignalRole(
        "lower_inlet", _PARAMETER, ("m^0.5/s",), "what of it enters the lower tank", "overflow of the upper tank"
    ),
)
