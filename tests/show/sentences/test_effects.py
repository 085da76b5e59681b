"""Golden texts of the catalogue's listing and of its page."""

from greybox.model.effects.catalogue import CATALOGUE, EffectListing, Placement, effect, place_effect
from greybox.model.signals import Parameter
from greybox.show import text
from greybox.show.sentences.model import write_places

FRICTION = effect("coulomb_friction")


def test_one_effect_is_a_table():
    assert str(EffectListing("", (FRICTION,))) == (
        "coulomb_friction acts at force.\n\n"
        "  effect            at     parameters    equation\n  coulomb_friction  force  Fc [{force}]  -Fc sign(v)"
    )


def test_the_catalogue_is_listed_by_site():
    lines = str(EffectListing("", CATALOGUE)).splitlines()
    assert lines[0] == f"{len(CATALOGUE)} effects can be added to a model." and max(map(len, lines)) <= 80
    listed = text(EffectListing("", CATALOGUE), 400, details=True).replace(",", " ").split()
    assert all(e.name in listed for e in CATALOGUE)
    whole = text(EffectListing("", CATALOGUE), details=True)
    assert "-Fc sign(v)" in whole and "two bodies that touch while they move" in whole


def test_places_and_why_there_is_none():
    at_load = place_effect(FRICTION, "load")
    placements = (
        Placement(at_load.name, "load_torque", at_load, "", (Parameter("Fc", "N*m", 0.0),)),
        Placement(
            "valve_lag",
            "",
            None,
            "effect 'valve_lag' acts at 'valve', which model 'm' does not have; it needs an input with the role `valve`",
        ),
        Placement(
            "eddy_current",
            "",
            None,
            "effect 'eddy_current' acts at 'voltage', which model 'm' does not have; known: force",
        ),
        Placement("input_offset", "u", None, "the model contains it already"),
    )
    assert str(EffectListing("m", CATALOGUE, placements)) == (
        "coulomb_friction_at_load acts at load_torque.\n"
        "\n"
        "  effect                    at           parameters  equation\n"
        "  coulomb_friction_at_load  load_torque  Fc [N*m]    -Fc sign(v)\n"
        "\n"
        "  effect        why it has no place\n"
        "  valve_lag     it needs an input with the role `valve`\n"
        "  eddy_current  it needs a balance 'voltage'\n"
        "  input_offset  the model contains it already"
    )


def test_an_effect_that_finds_one_place_is_not_said_to_need_another():
    at_load = place_effect(FRICTION, "load")
    lines = write_places(
        (
            Placement(FRICTION.name, "lag", None, "no velocity", missing=("role", "velocity")),
            Placement(at_load.name, "load", at_load, ""),
        )
    )
    assert lines == ["1 find a place", "  at load: coulomb_friction"]


def test_an_effect_with_several_places_counts_once():
    at_load = place_effect(FRICTION, "load")
    placements = (Placement(at_load.name, "load", at_load), Placement(FRICTION.name, "force", FRICTION))
    first = str(EffectListing("m", (FRICTION, effect("backlash")), placements)).splitlines()[0]
    assert first == "m takes 1 effect of 2 that are known, at 2 places."


def test_a_listing_says_which_effects_a_search_tries():
    at_load = place_effect(FRICTION, "load")
    placements = (Placement(at_load.name, "load", at_load), Placement(FRICTION.name, "force", FRICTION))
    listing = EffectListing("m", (FRICTION,), placements, ("coulomb_friction",))
    assert "wrong: coulomb_friction; --effects names others." in " ".join(str(listing).split())
    assert "discover" not in str(EffectListing("m", (FRICTION,), placements))
