"""What is usual orders sets that do equally well, and the part on which the name hangs is asked; on tables made by hand."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

import greybox as gb
from fits.studies.measured_rigs import falling_ball, rotor
from greybox.discovery import plausibility
from greybox.discovery.decision import Grade
from greybox.discovery.findings import DiscoveryCode as Code
from greybox.discovery.plausibility import ENOUGH, prefer_usual, weigh_set
from greybox.discovery.table import Draws
from greybox.model.parts import read_parts

ROUNDS = 50


@dataclass(frozen=True)
class Candidate:
    """A fitted set as far as its order needs it."""

    model: gb.Model
    free: int
    given: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()

    @property
    def effects(self):
        return self.model.effect_names

    names = effects


@dataclass(frozen=True)
class Row:
    """A set on the table."""

    candidate: Candidate


def table(plain, **shares):
    """Draws in which each set, ``a__b`` for two effects, takes that share of the error of the plain model; only the best is good."""
    models = [plain]
    for names in shares:
        model = plain
        for name in names.split("__"):
            model = model + gb.effect(name)
        models.append(model)
    rows = tuple(Row(Candidate(m, 3 + len(m.effects))) for m in models)
    errors = np.tile(np.log([1.0, *(1 - share for share in shares.values())]), (ROUNDS, 1))
    best = errors[0].argmin()
    good = np.zeros(errors.shape, bool)
    good[:, best] = True
    return Draws(rows, errors, good, np.full(ROUNDS, best))


@pytest.fixture(autouse=True)
def least_error_wins(monkeypatch):
    """Among sets that are as usual the one with the least error: what `draw_sets` does with blocks is tested beside the table."""

    def draw(sets):
        order = [len(s.candidate.effects) for s in sets]
        first = min(order)
        winner = order.index(first)
        errors = np.zeros((ROUNDS, len(sets)))
        good = np.zeros(errors.shape, bool)
        good[:, winner] = True
        return Draws(tuple(sets), errors, good, np.full(ROUNDS, winner))

    monkeypatch.setattr(plausibility, "draw_sets", draw)


def prefer(plain, draws, answer, is_open=True, **grades):
    chosen = next(s.candidate for s in draws.sets if s.candidate.effects == tuple(answer.split("__")))
    return prefer_usual(draws, chosen, plain, {name: Grade(grade) for name, grade in grades.items()}, is_open)


def test_an_effect_that_rigs_have_costs_nothing_and_an_exotic_one_five_nats():
    told = read_parts(rotor().with_parts(has=["contact"]))
    dry = weigh_set(rotor() + gb.effect("coulomb_friction"), (), told)
    strange = weigh_set(rotor() + gb.effect("soft_saturation"), (), told)
    # Soft saturation is a relative of the hard one: of that family it is the rarer by far.
    assert -0.5 < dry <= 0
    assert strange < dry - 4
    assert weigh_set(rotor(), (), told) == 0
    assert weigh_set(rotor() + gb.effect("coulomb_friction"), ("coulomb_friction",), told) == 0


def test_what_the_rig_lacks_weighs_nothing():
    lacking = read_parts(rotor().with_parts(lacks=["contact"]))
    assert math.isinf(weigh_set(rotor() + gb.effect("coulomb_friction"), (), lacking))


def test_the_family_counts_before_its_member():
    """Friction of some kind is at least as likely as the likeliest kind, and each kind is less likely than the family."""
    parts = read_parts(rotor().with_parts(has=["contact"]))
    kinds = [weigh_set(rotor() + gb.effect(name), (), parts) for name in ("coulomb_friction", "stribeck_friction")]
    odds = [
        k.probability / (1 - k.probability)
        for k in map(parts.occurrence, map(gb.effect, ("coulomb_friction", "stribeck_friction")))
    ]
    assert kinds[0] > kinds[1]
    # Given the family, the members share it as their own probabilities do.
    assert math.exp(kinds[0] - kinds[1]) == pytest.approx(0.5 / 0.07)
    assert odds[0] == 1.0


def test_the_usual_set_comes_first_where_it_takes_nearly_as_much():
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, reading_curve__soft_saturation=0.90, coulomb_friction=0.80)
    found = prefer(plain, draws, "reading_curve__soft_saturation")
    assert found.candidate.effects == ("coulomb_friction",)
    assert found.finding.code == Code.USUAL_FIRST and found.finding.subject == "coulomb_friction"
    values = found.finding.values
    assert values["by_records"] == ["reading_curve + soft_saturation"]
    assert values["share"] == pytest.approx(0.80) and values["best_share"] == pytest.approx(0.90)
    assert values["odds"] == pytest.approx(100.0)


def test_a_set_that_takes_too_little_is_no_equal():
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, reading_curve=0.90, coulomb_friction=0.9 * ENOUGH - 0.01)
    assert prefer(plain, draws, "reading_curve").finding is None


def test_a_set_that_leaves_more_than_twice_as_much_is_no_equal_however_much_it_takes():
    plain = rotor().with_parts(has=["contact"])
    assert prefer(plain, table(plain, reading_curve=0.98, coulomb_friction=0.95), "reading_curve").finding is None
    assert prefer(plain, table(plain, reading_curve=0.98, coulomb_friction=0.97), "reading_curve").finding is not None


def test_a_set_that_takes_hardly_anything_answers_nothing():
    plain = rotor().with_parts(has=["contact"])
    assert prefer(plain, table(plain, coulomb_friction=0.03), "coulomb_friction") is None


def test_where_only_noise_is_left_two_standard_errors_decide():
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, reading_curve=0.90, coulomb_friction=0.89)
    assert prefer(plain, draws, "reading_curve", is_open=False).finding is None
    good = draws.good.copy()
    good[:, 2] = True
    equal = Draws(draws.sets, draws.errors, good, draws.winner)
    assert prefer(plain, equal, "reading_curve", is_open=False).candidate.effects == ("coulomb_friction",)


def test_what_the_records_have_established_stays():
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, reading_curve=0.90, coulomb_friction=0.88, reading_curve__coulomb_friction=0.91)
    found = prefer(plain, draws, "reading_curve__coulomb_friction", reading_curve="established")
    assert "reading_curve" in found.candidate.effects


def test_what_is_probable_gives_no_place_to_what_is_more_usual():
    """Drag that won in every resample beside slow noise of unknown level was taken out for dry friction."""
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, quadratic_damping=0.90, coulomb_friction=0.85)
    for grade, expected in (("probable", "quadratic_damping"), ("stand_in", "coulomb_friction")):
        found = prefer(plain, draws, "quadratic_damping", quadratic_damping=grade)
        assert found.candidate.effects == (expected,)


@pytest.mark.parametrize(
    ("has", "grade", "expected"),
    [
        (("free", "fluid"), "probable", "quadratic_damping"),
        (("free", "fluid"), "established", "viscous_damping"),
        # That nothing holds the body follows from the model; nobody has said it.
        (("fluid",), "probable", "viscous_damping"),
    ],
)
def test_what_is_only_probable_gives_way_where_somebody_told_of_a_part_that_makes_it_rare(has, grade, expected):
    plain = falling_ball().with_parts(has=has)
    draws = table(plain, viscous_damping=0.90, quadratic_damping=0.89)
    assert prefer(plain, draws, "viscous_damping", viscous_damping=grade).candidate.effects == (expected,)


def test_what_is_probable_is_not_left_out_for_taking_little():
    plain = rotor().with_parts(has=["contact"])
    draws = table(plain, coulomb_friction__reading_curve=0.91, coulomb_friction=0.88)
    whole, alone = ("coulomb_friction", "reading_curve"), ("coulomb_friction",)
    for grade, expected in (("probable", whole), ("stand_in", alone)):
        assert (
            prefer(plain, draws, "coulomb_friction__reading_curve", reading_curve=grade).candidate.effects == expected
        )


def test_the_part_on_which_the_name_hangs_is_asked():
    plain = falling_ball()
    draws = table(plain, reading_curve=0.95, quadratic_damping=0.90, coulomb_friction=0.91)
    found = prefer(plain, draws, "reading_curve")
    assert found.candidate.effects == ("quadratic_damping",)
    assert found.question.code == Code.ASK_PART
    assert found.question.subject == "contact"
    assert found.question.values == {"yes": "coulomb_friction", "no": "quadratic_damping"}


def test_a_part_that_only_makes_a_name_likelier_is_asked_where_no_other_decides():
    plain = rotor()
    draws = table(plain, input_offset=0.92, drive_lag=0.90)
    question = prefer(plain, draws, "input_offset").question
    assert (question.code, question.subject) == (Code.ASK_PART, "actuator")
    assert question.values == {"yes": "drive_lag", "no": "input_offset"}


def test_what_is_told_is_not_asked():
    plain = falling_ball().with_parts(has=["fluid"], lacks=["contact", "analogue"])
    draws = table(plain, quadratic_damping=0.90)
    assert prefer(plain, draws, "quadratic_damping").question is None


def test_a_usual_set_of_more_constants_that_takes_less_does_not_do_equally_well():
    plain = rotor()
    draws = table(plain, backlash=0.9, coulomb_friction__constant_load=0.8)
    assert prefer(plain, draws, "backlash").candidate.effects == ("backlash",)
    draws = table(plain, backlash=0.9, coulomb_friction=0.8)
    assert prefer(plain, draws, "backlash").candidate.effects == ("coulomb_friction",)
