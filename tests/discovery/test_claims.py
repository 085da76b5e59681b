"""From the winners of resampled records to claims, grades and a verdict. Nothing is simulated."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.claims import (
    ESTABLISHED_FROM,
    WITH_MEMORY,
    Claim,
    Depth,
    EffectForm,
    Grounds,
    Weights,
    _are_related,
    deepest_established,
    describe_effect,
    grade_claims,
    list_tied_sets,
    name_claim,
    place_within_sensor_class,
    read_certainty,
    read_verdict,
    split_names,
    to_features,
    to_grade,
    to_probability,
    weigh_claims,
)
from greybox.discovery.decision import Decision, Grade, Verdict
from greybox.discovery.search import find_named_winner
from greybox.discovery.surrogate_effects import CURVE, LINEAR_DYNAMICS, make_linear_path
from greybox.discovery.table import BlockSums, Draws, FittedSet
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder

RESAMPLES = 10


@pytest.mark.parametrize(
    ("rig", "name", "site", "variables", "expected"),
    [
        (micro_actuator, "coulomb_friction", "balance force", {"v"}, "static"),
        (micro_actuator, "cubic_stiffness", "balance force", {"x"}, "static"),
        (micro_actuator, "viscoelastic_creep", "balance force", {"x"}, "with memory"),
        (micro_actuator, "lugre_friction", "balance force", {"v"}, "with memory"),
        (micro_actuator, "input_saturation", "input u", {"u"}, "static"),
        (micro_actuator, "transport_delay", "input u", {"u"}, "timing"),
        (micro_actuator, "sensor_drift", "sensor of x", set(), "with memory"),
        (pneumatic_cylinder, "chamber_leakage", "balance pressure_a", {"p_a", "p_b"}, "static"),
    ],
)
def test_an_effect_says_where_it_acts_and_of_what(rig, name, site, variables, expected):
    model = rig + gb.effect(name)
    form = describe_effect(model, model.bound_effects[-1])
    assert (form.site, set(form.variables), form.name) == (site, variables, name)
    assert form.form == expected
    assert name in form.family


@pytest.mark.parametrize(
    ("first", "second", "variables"),
    [("drive_lag", "input_saturation", ("u",)), ("sensor_lag", "reading_curve", ("x",))],
)
def test_a_signal_that_comes_through_another_effect_is_of_what_drives_that(first, second, variables):
    """Nobody knows the state of a lag by its name."""
    model = micro_actuator + gb.effect(first) + gb.effect(second)
    assert describe_effect(model, model.bound_effects[-1]).variables == variables


def test_lags_and_delays_are_one_family():
    model = micro_actuator + gb.effect("transport_delay")
    assert {"transport_delay", "drive_lag", "sensor_lag", "valve_lag"} <= set(
        describe_effect(model, model.bound_effects[-1]).family
    )


def fitted(*names, left=1.0, free=5, curve=False, reach=100.0):
    """A set on a table: the actuator with these effects, whose run leaves ``left`` times the noise on the records that judge.

    The range of the readings is ``reach`` times the noise.
    """
    model = micro_actuator
    for name in names:
        model = model + gb.effect(name)
    if curve:
        model = model + CURVE_EFFECT
    candidate = SimpleNamespace(model=model, free=free, effects=tuple(e.name for e in model.effects), laws=(), given=())
    square = np.full((2, 2), left**2)
    none = np.zeros(0)
    slopes, curvature = np.zeros((2, 2, 0)), np.zeros((2, 2, 0, 0))
    judging, ranges = np.array([False, True]), np.full(2, reach)
    sums = BlockSums(square, np.ones((2, 2)), slopes, curvature, none, none, 0, judging, ranges)
    return FittedSet(candidate, sums)


CURVE_EFFECT = gb.Effect(
    CURVE,
    "force",
    [gb.Parameter("c0", "{force}/{velocity}**2", 0.0)],
    terms=lambda x, u, p: p.c0 * x.velocity**2,
    amplitudes=("c0",),
)


PLAIN = fitted(left=20.0), 0


def draws(*won):
    """Resamples of which each set won so many: ``(set, times)``."""
    sets = tuple(each for each, _ in won)
    winner = np.repeat(np.arange(len(won)), [times for _, times in won])
    errors = np.ones((len(winner), len(sets)))
    errors[np.arange(len(winner)), winner] = 0.0
    return Draws(sets, errors, errors == 0, winner)


def claims_of(*won, alike=(), left=0.0):
    return weigh_claims(draws(*won, PLAIN), alike, (), left)


def frequencies(claims, depth):
    return {(c.sites, c.variables, c.family[:1], c.name): c.frequency for c in claims if c.depth is depth}


def test_what_always_wins_is_claimed_to_its_name():
    claims = claims_of((fitted("coulomb_friction", left=1.0), 10))
    assert [c.depth for c in claims] == list(Depth)
    assert all(c.frequency == 1.0 and c.rival == "" for c in claims)
    assert claims[-1].share == pytest.approx(0.95)
    assert deepest_established(claims).name == "coulomb_friction"


def test_an_effect_takes_all_of_the_error_where_the_run_without_it_goes_astray():
    """The plain model has no place on the table then."""
    name = weigh_claims(draws((fitted("coulomb_friction"), 10)), (), (), 0.0)[-1]
    assert (name.name, name.share, name.size, name.is_established) == ("coulomb_friction", 1.0, 1.0, True)


def test_names_that_take_turns_share_their_place_and_variable():
    claims = claims_of((fitted("coulomb_friction"), 6), (fitted("quadratic_damping"), 4))
    assert frequencies(claims, Depth.VARIABLES) == {(("balance force",), ("v",), (), ""): 1.0}
    assert {c.name: c.frequency for c in claims if c.depth is Depth.NAME} == {
        "coulomb_friction": 0.6,
        "quadratic_damping": pytest.approx(0.4),
    }
    assert name_claim(claims, "coulomb_friction").rival == "quadratic_damping"


def test_of_laws_that_do_the_same_the_shortest_wins_whatever_the_last_digits_say():
    laws = ["k*v*abs(v)", "k*v**2", "k*v**3"]
    sets = tuple(FittedSet(SimpleNamespace(free=5, laws=(law,)), None) for law in laws)
    errors = np.array([[0.0, 1e-9, 0.5]] * 3 + [[0.5, 0.5, 0.0]])
    weights = Weights.of(Draws(sets, errors, errors < 0.1, errors.argmin(axis=1)))
    assert weights.totals.tolist() == [0.0, 0.75, 0.25]


def test_rivals_are_not_both_certain_and_nothing_is_likelier_than_what_it_implies():
    claims = claims_of((fitted("coulomb_friction"), 5), (fitted("cubic_stiffness"), 4), (fitted("input_saturation"), 1))
    assert all(c.probability <= c.frequency for c in claims)
    by_depth = [max(c.probability for c in claims if c.depth is depth) for depth in Depth]
    assert by_depth == sorted(by_depth, reverse=True)
    assert all(c.grade is not Grade.ESTABLISHED for c in claims if c.depth >= Depth.VARIABLES)


def test_sites_that_the_sensors_cannot_tell_apart_are_one_place():
    alike = (("balance force", "input u"),)
    claims = claims_of((fitted("constant_load"), 5), (fitted("input_offset"), 5), alike=alike)
    assert frequencies(claims, Depth.PLACE) == {(("balance force", "input u"), (), (), ""): 1.0}


def test_a_place_that_may_be_a_sensor_is_not_established_by_what_a_sensor_may_be_off_by():
    alike = (("balance force", "sensor of x"),)

    def claims_at(reach, *names, alike=alike):
        plain = fitted(left=20.0, reach=reach), 0
        won = [(fitted(name, reach=reach), 5) for name in names]
        return weigh_claims(draws(*won, plain), alike, (), 0.0)

    def place(claims):
        (made,) = [c for c in claims if c.depth is Depth.PLACE]
        return made

    # The error of the plain model is 20 times the noise: 20 % of the range of the readings, or 0.2 %.
    large, small = (claims_at(reach, "coulomb_friction", "sensor_lag") for reach in (100.0, 10_000.0))
    assert place(large).is_established and place(small).grade is Grade.PROBABLE
    assert place(large).probability == place(small).probability
    assert place(large).size == pytest.approx(np.sqrt(20.0**2 - 1) / 100) == 100 * place(small).size
    assert place_within_sensor_class(small) == place(small) and place_within_sensor_class(large) is None
    # A name that always wins has beaten what sensors do.
    assert place(claims_at(10_000.0, "coulomb_friction")).is_established
    # A place in the plant is no sensor: neither doubted for one nor said to be one, whatever else made it no more than probable.
    in_plant = claims_at(10_000.0, "coulomb_friction", "quadratic_damping", alike=())
    assert place(in_plant).is_established
    assert place_within_sensor_class(grade_claims(in_plant, Grounds(is_cut=True))) is None


def test_the_set_that_wins_most_often_is_the_answer_unless_a_curve_wins():
    friction, damping, curve = fitted("coulomb_friction"), fitted("quadratic_damping"), fitted(curve=True)
    plain = PLAIN[0].candidate
    assert find_named_winner(draws((friction, 3), (damping, 5), (curve, 2), PLAIN), plain) is damping.candidate
    # The plain model is a set like any other.
    assert find_named_winner(draws((friction, 1), (PLAIN[0], 9)), plain) is plain
    # A curve takes no place, nor leaves any to the plain model that it beats: what has a name is drawn again without it.
    assert find_named_winner(draws((friction, 0), (curve, 9), PLAIN), plain) is friction.candidate
    assert find_named_winner(draws((curve, 10)), plain) is plain


def test_the_plain_model_is_no_answer_that_most_resamples_refuse_however_they_share_the_names():
    friction, damping, stiffness = fitted("coulomb_friction"), fitted("quadratic_damping"), fitted("cubic_stiffness")
    plain = PLAIN[0].candidate
    shared = draws((friction, 3), (damping, 2), (stiffness, 1), (PLAIN[0], 4))
    assert find_named_winner(shared, plain) is friction.candidate
    assert find_named_winner(draws((friction, 3), (damping, 2), (PLAIN[0], 5)), plain) is plain


def test_each_name_of_the_answer_is_weighed_however_seldom_it_wins():
    seldom, often = fitted("coulomb_friction", left=2.0), fitted("cubic_stiffness")
    won = draws((seldom, 1), (often, 9), PLAIN)
    assert name_claim(weigh_claims(won, (), (), 0.0), "coulomb_friction") is None
    claim = name_claim(weigh_claims(won, (), (), 0.0, {"coulomb_friction"}), "coulomb_friction")
    assert (claim.grade, claim.frequency, claim.share) == (Grade.STAND_IN, 0.1, pytest.approx(0.9))
    assert name_claim(weigh_claims(draws((often, 10)), (), (), 0.0, {"coulomb_friction"}), "coulomb_friction") is None


def test_a_curve_beside_an_effect_supports_its_place_and_denies_its_name():
    claims = claims_of((fitted("coulomb_friction", curve=True), 9), (fitted("coulomb_friction"), 1))
    assert next(c for c in claims if c.depth is Depth.PLACE).frequency == 1.0
    assert name_claim(claims, "coulomb_friction") is None  # a tenth of the resamples is too little to be listed


def test_a_linear_path_beside_the_plant_denies_every_place_but_not_that_something_is_missing():
    path = make_linear_path(micro_actuator.outputs[0], micro_actuator.inputs)
    model = micro_actuator + path
    assert describe_effect(model, model.bound_effects[-1]) == EffectForm("", "", ("u",), WITH_MEMORY, ())
    linear = replace(fitted(), candidate=SimpleNamespace(model=model, free=8, effects=(path.name,), laws=()))
    claims = claims_of((linear, 7), (fitted("coulomb_friction"), 3))
    assert frequencies(claims, Depth.MISSING) == {((), (), (), ""): 1.0}
    assert {c.sites: c.frequency for c in claims if c.depth is Depth.PLACE} == {("balance force",): 0.3}
    assert name_claim(claims, "coulomb_friction").rival == LINEAR_DYNAMICS


def test_the_effects_of_the_user_are_claimed_by_nobody():
    one = fitted("coulomb_friction", "cubic_stiffness")
    claims = weigh_claims(draws((one, 10), PLAIN), (), ("cubic_stiffness",), 0.0)
    assert {c.name for c in claims if c.name} == {"coulomb_friction"}


def test_sets_that_differ_by_nothing_win_together():
    both = draws((fitted("constant_load"), 10), (fitted("input_offset"), 0), PLAIN)
    errors = np.where([True, True, False], 0.0, np.ones_like(both.errors))
    claims = weigh_claims(Draws(both.sets, errors, errors == 0, both.winner), (), (), 0.0)
    assert {c.name: c.frequency for c in claims if c.name} == {"constant_load": 0.5, "input_offset": 0.5}


@pytest.mark.parametrize("depth", list(Depth))
def test_a_probability_rises_with_the_weight_and_falls_with_what_is_left(depth):
    assert set(read_certainty()) == {int(d) for d in Depth}

    def probability(frequency=0.9, left=0.0, sites=("balance force",)):
        made = Claim(depth, "x", sites, frequency=frequency, left=left)
        return to_probability(depth, to_features(made))

    weights = [probability(frequency=f) for f in (0.2, 0.5, 0.9, 1.0)]
    assert weights == sorted(weights)
    assert probability(left=0.8) <= probability()
    # A sensor is doubted for what is left; a place in the plant that is one of several keeps its odds.
    sensors = ("sensor of x", "sensor of i")
    assert probability(left=0.8, sites=sensors) <= probability(left=0.8)
    assert probability(sites=sensors) == probability()
    assert probability(left=0.8, sites=("balance force", "sensor of x")) == probability(left=0.8)


def test_grades_follow_the_probability():
    assert to_grade(ESTABLISHED_FROM) is Grade.ESTABLISHED
    assert to_grade(0.6) is Grade.PROBABLE and to_grade(0.4) is Grade.STAND_IN


def claim(name="coulomb_friction", depth=Depth.NAME):
    return Claim(
        depth,
        "x",
        ("balance force",),
        ("v",),
        name=name,
        probability=0.95,
        grade=Grade.ESTABLISHED,
        share=0.9,
        size=1.0,
    )


def test_what_does_the_same_in_the_place_of_an_effect_is_its_equal():
    both = draws(
        (fitted("coulomb_friction"), 10), (fitted("quadratic_damping"), 0), (fitted("cubic_stiffness"), 0), PLAIN
    )
    good = np.zeros_like(both.good)
    good[:, 0], good[:6, 1], good[:4, 2] = True, True, True
    claims = weigh_claims(Draws(both.sets, both.errors, good, both.winner), (), (), 0.0)
    assert name_claim(claims, "coulomb_friction").equals == ("quadratic_damping",)
    assert list_tied_sets(claims, ["coulomb_friction"]) == [("quadratic_damping",)]
    # With as many constants it is as good a name; with more it would be no objection.
    assert not name_claim(claims, "coulomb_friction").is_established
    both.sets[1].candidate.free += 1
    richer = weigh_claims(Draws(both.sets, both.errors, good, both.winner), (), (), 0.0)
    assert name_claim(richer, "coulomb_friction").is_established
    assert name_claim(richer, "coulomb_friction").equals == ("quadratic_damping",)


def test_one_effect_that_is_the_equation_of_two_is_told_beside_them():
    """-Fp for v > 0 and +Fm for v < 0 is (Fp + Fm)/2 sign(v) and a load of (Fp - Fm)/2, as many constants."""
    claims = claims_of((fitted("coulomb_friction", "constant_load"), 10))
    load, friction = (name_claim(claims, name) for name in ("constant_load", "coulomb_friction"))
    assert load.equals == ("asymmetric_friction",) and load.grade is Grade.PROBABLE
    # That a constant acts is not true of the one effect, that friction does is true of both.
    graded = {(c.depth, c.variables): c.grade for c in claims if c.depth in (Depth.VARIABLES, Depth.FAMILY)}
    assert {graded[depth, ()] for depth in (Depth.VARIABLES, Depth.FAMILY)} == {Grade.PROBABLE}
    assert {graded[depth, ("v",)] for depth in (Depth.VARIABLES, Depth.FAMILY)} == {Grade.ESTABLISHED}
    # Friction is in both of them.
    assert friction.equals == () and friction.is_established
    assert list_tied_sets(claims, ["coulomb_friction", "constant_load"]) == [("asymmetric_friction",)]
    # A load beside something else is a load.
    alone = name_claim(claims_of((fitted("cubic_stiffness", "constant_load"), 10)), "constant_load")
    assert alone.equals == () and alone.is_established


@pytest.mark.parametrize(("other", "are"), [("stribeck_friction_at_q2", True), ("stribeck_friction_at_q1", False)])
def test_effects_are_related_at_one_place(other, are):
    assert _are_related("coulomb_friction_at_q2", other) is _are_related(other, "coulomb_friction_at_q2") is are


ONLY_NOISE, MORE = Decision(True, ()), Decision(False, ())


@pytest.mark.parametrize(
    ("rest", "rivals", "first", "second", "expected"),
    [
        (ONLY_NOISE, (), {}, {}, Verdict.NAMED),
        (ONLY_NOISE, (), {}, {"probability": 0.6}, Verdict.PARTLY),
        (ONLY_NOISE, (), {"probability": 0.6}, {"probability": 0.6}, Verdict.UNKNOWN),
        (ONLY_NOISE, (), {}, {"probability": 0.6, "equals": ("other",), "joint": 0.9}, Verdict.AMBIGUOUS),
        (MORE, (), {}, {}, Verdict.PARTLY),
        (MORE, (), {}, {"probability": 0.1}, Verdict.PARTLY),
        (ONLY_NOISE, [["c"]], {}, {"joint": 0.2}, Verdict.PARTLY),
        (ONLY_NOISE, [["c"]], {"probability": 0.6}, {"joint": 0.2, "probability": 0.2}, Verdict.UNKNOWN),
        (ONLY_NOISE, [["c"]], {"probability": 0.6}, {"probability": 0.6}, Verdict.AMBIGUOUS),
    ],
)
def test_the_verdict_is_read_off_the_claims(rest, rivals, first, second, expected):
    claims = []
    for name, changes in (("a", first), ("b", second)):
        claims.append(replace(claim(name), **{"probability": 0.95, "joint": 0.95, **changes}))
    assert read_verdict(rest, grade_claims(claims), ["a", "b"], rivals).verdict is expected


def test_without_an_effect_the_verdict_says_how_deep_the_claims_go():
    assert read_verdict(ONLY_NOISE, (), ()).verdict is Verdict.COMPLETE
    assert read_verdict(MORE, (), ()).verdict is Verdict.UNKNOWN
    for depth, expected in ((Depth.MISSING, Verdict.UNKNOWN), (Depth.PLACE, Verdict.PARTLY)):
        assert read_verdict(MORE, [claim("", depth)], ()).verdict is expected


def test_a_name_that_nobody_claims_is_not_certain():
    read = read_verdict(ONLY_NOISE, [claim("a")], ["a", "b"])
    assert read.verdict is Verdict.PARTLY
    assert [(c.subject, c.passed) for c in read.checks] == [("a", True), ("b", False)]
    assert read_verdict(ONLY_NOISE, [], ["a"]).verdict is Verdict.UNKNOWN


def test_of_rivals_that_the_records_cannot_separate_the_probabilities_add_up():
    claims = [replace(claim(name), probability=p, joint=p) for name, p in (("a", 0.4), ("b", 0.3))]
    graded = grade_claims(claims)
    assert read_verdict(ONLY_NOISE, graded, ["a"], [["b"]]).verdict is Verdict.AMBIGUOUS
    assert read_verdict(ONLY_NOISE, graded, ["a"], [["c"]]).verdict is Verdict.UNKNOWN


MISSING, PLACE, VARIABLES, NAME, OTHER = (
    claim("", Depth.MISSING),
    claim("", Depth.PLACE),
    claim("", Depth.VARIABLES),
    claim("a"),
    claim("b"),
)


@pytest.mark.parametrize(
    ("grounds", "established"),
    [
        (Grounds(), [MISSING, PLACE, VARIABLES, NAME, OTHER]),
        (Grounds(names=("a",)), [MISSING, PLACE, VARIABLES, NAME]),  # the model that is handed over has no b
        (Grounds(has_rivals=False), [MISSING, PLACE, VARIABLES]),
        (Grounds(nonsense={"balance force"}), [MISSING, PLACE]),
        (Grounds(nonsense={"input u"}), [MISSING, PLACE, VARIABLES, NAME, OTHER]),
        (Grounds(is_contradicted=True), [MISSING]),
        (Grounds(is_cut=True), []),
        (Grounds(is_settled=False), []),
        (Grounds(laws={"a", "b"}), [MISSING, PLACE, VARIABLES, NAME, OTHER]),
        (
            Grounds(names=("a",), laws={"a", "b"}),
            [MISSING, PLACE, VARIABLES],
        ),  # one term of a law is open, and so is the other
    ],
)
def test_a_grade_rests_on_more_than_a_probability(grounds, established):
    """One claim of each depth at the same place, each of the same probability."""
    graded = grade_claims((MISSING, PLACE, VARIABLES, NAME, OTHER), grounds)
    assert [c for c in graded if c.is_established] == established
    assert all(c.grade in (Grade.ESTABLISHED, Grade.PROBABLE) for c in graded)
    doubtful = replace(NAME, probability=0.1)
    assert grade_claims([doubtful], grounds)[0].grade is Grade.STAND_IN


@pytest.mark.parametrize(
    ("share", "left", "is_established"), [(0.4, 0.6, False), (0.6, 0.9, True), (0.4, 0.4, True), (0.1, 0.0, True)]
)
def test_where_more_is_left_than_an_effect_takes_only_that_something_is_missing_is_certain(share, left, is_established):
    graded = grade_claims([replace(c, share=share, left=left) for c in (MISSING, PLACE, VARIABLES, NAME)])
    assert [c.is_established for c in graded] == [True, *[is_established] * 3]


def test_the_sum_within_a_formula_is_no_second_name_of_a_rival():
    assert split_names("coulomb_friction + k*(v/(c + abs(v))) + cogging") == [
        "coulomb_friction",
        "k*(v/(c + abs(v)))",
        "cogging",
    ]
    assert split_names("") == [""] and split_names("plain_model") == ["plain_model"]


@pytest.mark.parametrize(
    ("rival", "times", "open_to"),
    [
        # Two others do as well in six of ten resamples, and lose each for one effect more: another place, and another name.
        (("sensor_gain", "cubic_stiffness"), 6, (Depth.VARIABLES, Depth.FAMILY, Depth.NAME)),
        (("sensor_gain", "sensor_lag"), 6, (Depth.PLACE, Depth.VARIABLES, Depth.FAMILY, Depth.NAME)),
        (("sensor_gain", "sensor_lag"), 4, ()),
        # A set that has it as well says the same.
        (("sensor_gain", "coulomb_friction"), 6, ()),
    ],
)
def test_nothing_is_established_that_sets_without_it_do_as_well_where_more_than_noise_may_be_left(
    rival, times, open_to
):
    both = draws((fitted("coulomb_friction"), 10), (fitted(*rival, free=7), 0), PLAIN)
    good = np.zeros_like(both.good)
    good[:, 0], good[:times, 1] = True, True
    won = Draws(both.sets, both.errors, good, both.winner)
    for is_open in (False, True):
        claims = weigh_claims(won, (), (), 0.0, (), is_open)
        expected = {depth for depth in Depth if not (is_open and depth in open_to)}
        assert {c.depth for c in claims if c.is_established} == expected


def test_a_curve_that_does_as_well_denies_a_place_and_no_name():
    both = draws((fitted("sensor_gain"), 10), (fitted(curve=True), 0), PLAIN)
    good = np.zeros_like(both.good)
    good[:, :2] = True
    claims = weigh_claims(Draws(both.sets, both.errors, good, both.winner), (), (), 0.0, (), True)
    assert {c.depth for c in claims if c.is_matched} == {Depth.PLACE, Depth.VARIABLES}
