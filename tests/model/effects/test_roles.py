"""Roles: every one that an effect asks for is listed, and a model that lacks one is told which."""

import ast
import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import greybox as gb
import greybox.model.effects
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.units import parse_unit
from greybox.estimation.check import check
from greybox.model.effects.catalogue import CATALOGUE, find_placements
from greybox.model.effects.roles import ROLES, RoleOwner
from greybox.model.effects.scales import measure_scales
from greybox.model.sites import NEEDED
from greybox.show import text
from greybox.show.sentences.model import describe_missing

# What an effect sees at its site under these words, whatever the model calls it; and other balances by their names.
OF_THE_SITE = {*NEEDED, "transmitted", "driven"}
OWNERS = {"x": RoleOwner.STATE, "u": RoleOwner.INPUT, "p": RoleOwner.PARAMETER}


def asked_for() -> set[tuple[str, str]]:
    """``(x, u or p; name)`` of everything that functions of effects speak of."""
    folder = Path(greybox.model.effects.__file__).parent
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in folder.glob("*.py") if path.stem != "scales"]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    return {
        (node.value.id, node.attr)
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in OWNERS
    }


def test_every_role_that_an_effect_asks_for_is_listed_with_its_owner() -> None:
    of_effects = {item.name for e in CATALOGUE for item in (*e.parameters, *e.states)}
    # `p.effect`, `p.side` and the like are fields of values in the code that places effects.
    fields = {"effect", "kind", "name", "value", "bounds", "positive", "side", "displacement", "temperature"}
    wanted = {(OWNERS[kind], name) for kind, name in asked_for() if name not in of_effects | OF_THE_SITE | fields}
    listed = {(owner, role.name) for role in ROLES for owner in role.owners}
    assert not wanted - listed
    words = {word for e in CATALOGUE for q in (*e.parameters, *e.states) for word in re.findall(r"{(\w+)}", q.unit)}
    assert not words - {role.name for role in ROLES} - OF_THE_SITE


def test_no_role_is_listed_that_nothing_asks_for() -> None:
    asked = {name for _, name in asked_for()} | set(re.findall(r"role `(\w+)`", " ".join(NEEDED.values())))
    asked |= set(re.findall(r"`(\w+)`", NEEDED["store"]))
    assert {role.name for role in ROLES} <= asked | {"base_acceleration", "level"}


MOTOR = Model(
    "motor",
    states=[State("w", "rad/s"), State("i", "A"), State("q", "1")],
    inputs=[Input("u", "V")],
    outputs=[Output("w", "rad/s")],
    parameters=[Parameter("J", "kg*m^2", 1e-4), Parameter("L", "H", 1e-3), Parameter("k", "N*m/A", 0.04)],
    balances=lambda x, u, p: [
        Balance("torque", "N*m", p.J, "w", motor=p.k * x.i),
        Balance("loop", "V", p.L, "i", source=u.u, emf=-p.k * x.w),
        Balance("counter", "1/s", 1, "q", rate=0 * x.w / 1),
    ],
)


def test_what_would_open_a_place_is_told() -> None:
    placements = {p.name: p for p in find_placements(MOTOR, CATALOGUE)}
    assert placements["coulomb_friction"].missing is None and placements["coulomb_friction"].effect is not None
    assert placements["cubic_stiffness"].missing == ("unit", "displacement")
    assert describe_missing(placements["cubic_stiffness"]) == "a state with the role `displacement`"
    assert describe_missing(placements["radiation_loss"]) == "a balance of a temperature (role `temperature`)"
    assert describe_missing(placements["valve_lag"]) == "an input with the role `valve`"
    assert placements["brush_drop"].site == "loop"  # volts and amperes tell
    assert placements["saturating_inductance"].effect is not None  # the only constant in H in the balance of a current
    assert placements["winding_heating"].missing == ("parameter", "resistance")
    assert describe_missing(placements["winding_heating"]) == "a parameter with the role `resistance`"


def heated(inputs: dict[str, str], temperatures: dict[str, str]) -> Model:
    """A block that exchanges heat with a temperature for each input and each parameter, name -> stated role."""
    return Model(
        "block",
        states=[State("T", "K", 300.0)],
        inputs=[Input("P", "W"), *(Input(name, "K", role=role) for name, role in inputs.items())],
        outputs=[Output("T", "K")],
        parameters=[
            *(Parameter("C", "J/K", 100.0), Parameter("h", "W/K", 0.5)),
            *(Parameter(name, "K", 293.0, role=role) for name, role in temperatures.items()),
        ],
        balances=lambda x, u, p: [
            Balance(
                *("heat", "W", p.C, "T"),
                heater=u.P,
                **{f"to_{name}": p.h * (u[name] - x.T) for name in inputs},
                **{f"to_{name}": p.h * (p[name] - x.T) for name in temperatures},
            )
        ],
    )


@pytest.mark.parametrize(
    ("inputs", "temperatures", "ambient"),
    [
        ({}, {"Ta": ""}, ["Ta"]),
        ({"outside": ""}, {}, ["outside"]),
        ({}, {"Ta": "", "Tw": ""}, []),  # which of the two is open
        ({"inlet": ""}, {"Ta": ""}, []),
        ({"inlet": ""}, {"Ta": "ambient_temperature"}, ["Ta"]),  # who states it is believed
        ({}, {}, []),
    ],
)
def test_the_only_temperature_in_a_heat_balance_is_the_ambient_one(inputs, temperatures, ambient) -> None:
    model = heated(inputs, temperatures)
    assert [name for name, role in model.roles.items() if role == "ambient_temperature"] == ambient
    (placed,) = find_placements(model, [gb.effect("radiation_loss")])
    assert (placed.effect is not None) is bool(ambient)
    # The loss by radiation is that to this temperature: kr (T^4 - Ta^4).
    if ambient:
        system = (model + gb.effect("radiation_loss")).system
        assert ambient[0] in {s.name() for s in ca.symvar(ca.SX(system.balances[0].terms["radiation_loss"]))}


def test_an_input_that_is_the_ambient_temperature_is_no_drive() -> None:
    placed = find_placements(heated({"outside": ""}, {}), [gb.effect("drive_lag")])
    assert [p.site for p in placed if p.effect] == ["P"]


def test_constants_of_a_winding_are_told_by_their_units() -> None:
    assert MOTOR.roles == {"w": "velocity", "i": "current", "L": "inductance", "k": "force_constant"}


def test_a_check_tells_roles_places_and_what_lacks() -> None:
    found = check(MOTOR.fix("J", "L", "k"))
    data = found.as_dict()
    assert data["roles"] == {
        "states": {"w": "velocity", "i": "current"},
        "inputs": {},
        "parameters": {"L": "inductance", "k": "force_constant"},
    }
    assert {"name": "coulomb_friction", "site": "torque"} in data["effects"]
    lacking = {entry["name"]: entry["missing"] for entry in data["without_place"]}
    assert lacking["valve_lag"] == {"kind": "site", "name": "valve"}
    said = text(found, 200, details=True)
    assert "roles           w velocity, i current" in said and "without one: q" in said
    assert "  an input with the role `valve`: valve_dead_zone, valve_hysteresis, valve_lag" in said


def test_units_tell_a_temperature_and_its_scales() -> None:
    heat = Model(
        "heat",
        states=[State("T", "K", 20.0), State("h", "m", 0.1)],
        inputs=[Input("P", "W"), Input("Ta", "K", role="ambient_temperature"), Input("q", "m^3/s")],
        outputs=[Output("T", "K"), Output("h", "m")],
        parameters=[Parameter("C", "J/K", 50.0), Parameter("A", "m^2", 0.1)],
        balances=lambda x, u, p: [
            Balance("heat", "W", p.C, "T", heater=u.P),
            Balance("volume", "m^3/s", p.A, "h", pump=u.q),
        ],
    )
    placements = {p.name: p for p in find_placements(heat, CATALOGUE)}
    assert [placements[name].site for name in ("radiation_loss", "overflow")] == ["heat", "volume"]
    x, u = np.array([[20.0, 0.1], [35.0, 0.3]]), np.array([[10.0, 20.0, 1e-4]] * 2)
    scales = measure_scales(heat, x, u, 1.0)
    assert scales.peaks == {"temperature": 35.0, "level": 0.3, "store": 0.3}
    radiation = placements["radiation_loss"].effect
    assert radiation is not None and radiation.probe is not None and radiation.grid is not None
    assert radiation.probe(scales)["kr"] > 0 and radiation.grid(scales)["T0"] == [273.15]


@pytest.mark.parametrize("name", ["pressure", "store", "chamber"])
def test_a_balance_called_like_a_role_does_not_take_its_unit(name: str) -> None:
    vessel = Model(
        "vessel",
        states=[State("p", "Pa", 1e5, role="pressure")],
        inputs=[Input("m", "kg/s")],
        outputs=[Output("p", "Pa")],
        parameters=[Parameter("C", "kg/Pa", 1e-9)],
        balances=lambda x, u, p: [Balance(name, "kg/s", p.C, "p", feed=u.m)],
    )
    units = {q.name: q.unit for q in (vessel + gb.effect("root_leak")).bound_effects[-1].parameters}
    assert units["laminar"] == "Pa"
    assert parse_unit(units["c"]) == parse_unit("kg/s/Pa^0.5")
