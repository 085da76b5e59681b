"""Parts of a rig: what is said, what follows from a model, and which effects that makes impossible or usual."""

from dataclasses import replace

import pytest

import greybox as gb
from fits.studies.measured_rigs import falling_ball, heaters, rotor
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.model.effects.catalogue import CATALOGUE
from greybox.model.parts import PARTS, TOLD, Occurrence, read_parts
from greybox.shell.project import load_model_file
from models.pneumatic_cylinder import pneumatic_cylinder

NAMES = {part.name for part in PARTS}


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda e: e.name)
def test_every_effect_speaks_of_known_parts(entry):
    assert {*entry.needs, *entry.occurs_with} <= NAMES


def test_every_part_decides_something():
    spoken_of = {name for entry in CATALOGUE for name in (*entry.needs, *entry.occurs_with)}
    assert {name for part in PARTS for name in (*part.implies, *part.replaces)} <= NAMES
    assert {p.name for p in PARTS} == spoken_of


def test_usual_against_exotic_is_about_five_nats():
    probabilities = [kind.probability for kind in Occurrence]
    assert probabilities == sorted(probabilities, reverse=True)
    assert probabilities == [0.5, 0.2, 0.07, 0.02, 0.005]


def test_a_body_that_nothing_drives_or_holds_hangs_on_no_spring():
    parts = read_parts(falling_ball())
    assert "free" in parts.has
    assert parts.missing(gb.effect("cubic_stiffness")) == "spring"
    assert parts.missing(gb.effect("second_mode")) == "elastic"
    assert parts.missing(gb.effect("cogging")) == "magnets"
    assert parts.missing(gb.effect("load_dependent_friction")) == "gear"
    # Whether something rubs on it nobody has said.
    assert parts.is_open("contact") and not parts.missing(gb.effect("coulomb_friction"))


def test_a_spring_holds_a_body():
    pendulum = Model(
        "swing",
        states=[State("q", "rad"), State("w", "rad/s")],
        inputs=[],
        outputs=[Output("q", "rad")],
        parameters=[Parameter("k", "1/s^2", 1.0)],
        balances=lambda x, u, p: [
            Balance("angle", "rad/s", 1, "q", w=x.w),
            Balance("torque", "rad/s^2", 1, "w", weight=-p.k * x.q),
        ],
    )
    assert "free" not in read_parts(pendulum).has
    assert not read_parts(pendulum).missing(gb.effect("cubic_stiffness"))


def test_what_is_said_counts_before_what_follows():
    told = read_parts(falling_ball().with_parts(has=["spring"], lacks=["contact"]))
    assert not told.missing(gb.effect("cubic_stiffness"))
    assert told.missing(gb.effect("coulomb_friction")) == "contact"
    assert told.lacks["contact"] == TOLD
    assert set(told.told.has) == {"spring"}


def test_free_flight_that_is_said_touches_nothing():
    assert read_parts(replace(falling_ball(), has=("free",))).missing(gb.effect("coulomb_friction")) == "contact"


def test_a_gear_touches_and_a_cylinder_has_a_seal():
    assert "contact" in read_parts(rotor().with_parts(has=["gear"])).has
    assert "contact" not in read_parts(rotor().with_parts(has=["gear"], lacks=["contact"])).has
    assert {"valve", "seal", "contact"} <= set(read_parts(pneumatic_cylinder).has)


def test_heat_drives_no_motor_and_a_temperature_is_read_slowly():
    parts = read_parts(heaters())
    assert parts.missing(gb.effect("torque_ripple")) == "" and "motor" in parts.lacks
    assert parts.occurrence(gb.effect("sensor_lag")) is Occurrence.USUAL


def test_drag_is_usual_where_a_fluid_is_and_exotic_on_a_motor():
    drag = gb.effect("quadratic_damping")
    occurrences = [
        read_parts(rotor().with_parts(has=has)).occurrence(drag)
        for has in ([], ["fluid"], ["motor"], ["motor", "fluid"])
    ]
    assert occurrences == [Occurrence.RARE, Occurrence.USUAL, Occurrence.EXOTIC, Occurrence.USUAL]


def test_an_unknown_part_and_a_contradiction_are_refused_together():
    with pytest.raises(ModelError, match=r"no part is called 'bering'.*it has 'gear' and lacks it"):
        replace(rotor(), has=("bering", "gear"), lacks=("gear",))
    with pytest.raises(ModelError, match=r"has='gear'; give names of parts, as in has=\('gear',\)"):
        replace(rotor(), has="gear")


def test_what_is_said_now_counts():
    model = rotor().with_parts(has=["gear"]).with_parts(lacks=["gear"])
    assert (model.has, model.lacks) == ((), ("gear",))


def test_a_model_file_keeps_the_parts(tmp_path):
    model = Model(
        "cart",
        states=[State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("v", "m/s")],
        parameters=[Parameter("m", "kg", 1.0)],
        balances=lambda x, u, p: [Balance("force", "N", p.m, "v", drive=u.F)],
        has=("gear",),
        lacks=("fluid", "stop"),
    )
    gb.export.to_python(model, tmp_path / "cart.py")
    read = next(v for v in vars(load_model_file(tmp_path / "cart.py")).values() if isinstance(v, Model))
    assert (tuple(read.has), tuple(read.lacks)) == (model.has, model.lacks)
