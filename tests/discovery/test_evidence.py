"""The comparisons behind the evidence of an effect, with errors that are given: nothing is simulated."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.data.noise.noise_model import BoundDirection, NoiseBound, NoiseSource
from greybox.discovery import evidence
from greybox.discovery.certainty import Grade
from greybox.discovery.evidence import EffectEvidence, _measure_change, _represents, _share_of_error, measure_structure
from greybox.discovery.execution import FailureLog
from greybox.discovery.holdout import AdaptedRun, compare_errors
from greybox.discovery.policy import DiscoveryPolicy
from models.micro_actuator import micro_actuator
from tests.support.fake_candidates import candidate, toy_effect

RNG = np.random.default_rng(1)
ERRORS = {"x": 1.0 + 0.1 * RNG.standard_normal(24) ** 2}


def test_a_loss_is_relative_to_what_the_model_leaves():
    loss, deviations = compare_errors(ERRORS, {"x": 4 * ERRORS["x"]})
    assert loss == pytest.approx(3.0)
    assert deviations > 1e6  # the same in every block


def test_chance_differences_are_no_loss():
    others = {"x": ERRORS["x"] * np.exp(0.05 * RNG.standard_normal(24))}
    loss, deviations = compare_errors(ERRORS, others)
    assert abs(loss) < 0.05 and abs(deviations) < 3


def test_rounding_is_no_difference():
    loss, deviations = compare_errors(ERRORS, {"x": ERRORS["x"] * (1 - 1e-15)})
    assert abs(loss) < 1e-12 and abs(deviations) < 1e-3


def test_a_model_that_cannot_be_run_loses_without_limit():
    assert compare_errors(ERRORS, {}) == (pytest.approx(1e300), np.inf)
    assert compare_errors(ERRORS, {"x": np.full(24, np.inf)}) == (pytest.approx(1e300), np.inf)


def test_the_share_of_the_error_has_an_interval_that_holds_it():
    without = 16 * ERRORS["x"] * np.exp(0.1 * RNG.standard_normal(24))
    share, (low, high) = _share_of_error(ERRORS["x"], without)
    assert share == pytest.approx(0.75, abs=0.02)
    assert low < share < high
    assert (low, high) == _share_of_error(ERRORS["x"], without)[1]  # the same each time
    assert _share_of_error(ERRORS["x"], None)[0] == 1.0


@pytest.mark.parametrize(
    ("halves", "is_at_bound", "expected"),
    [
        ([{"a_size": 1.0, "a_edge": 5.0}, {"a_size": 3.0, "a_edge": 5.0}], False, 1.0),
        ([{"a_size": 1.0, "a_edge": 5.0}, {"a_size": 3.0, "a_edge": 5.0}], True, 0.0),
        ([{"a_size": 1.0, "a_edge": 1.0}, {"a_size": 1.0, "a_edge": 3.0}], True, 1.0),
        ([{"a_size": 0.01, "a_cosine": 4.0}, {"a_size": -0.01, "a_cosine": 4.0}], False, 0.0025),
        ([], False, np.nan),
    ],
    ids=[
        "the amplitude counts",
        "one at its bound does not",
        "then the shape does",
        "a part of one size",
        "a half could not be fitted",
    ],
)
def test_a_change_is_that_of_what_the_records_determine(halves, is_at_bound, expected):
    names = {name: name for name in (halves[0] if halves else ("a_size",))}
    effect = SimpleNamespace(
        name="a",
        amplitudes=[name for name in names if name != "a_edge"],
        parameters=[SimpleNamespace(name=name) for name in names],
    )
    model = SimpleNamespace(
        names_of=lambda _: names,
        parameter=lambda name: SimpleNamespace(fixed=False, unit="N"),
    )
    fit = SimpleNamespace(parameters={"a_size": SimpleNamespace(at_bound=is_at_bound)})
    fits = [SimpleNamespace(model=SimpleNamespace(values=values)) for values in halves]
    change = _measure_change(SimpleNamespace(model=model), effect, fits, fit)
    assert change == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(
    ("plain", "output"),
    [
        ({"x": 8.0, "i": 20.0}, "i"),
        ({"x": 8.0, "i": 2.0}, "x"),  # the error in i is larger with the effects than without all of them
        ({"x": 0.5, "i": 0.5}, "i"),  # such an answer is none
    ],
)
def test_the_share_is_that_of_an_output_whose_error_falls(plain, output):
    errors, without = ({"x": np.array([x]), "i": np.array([i])} for x, i in ((1.0, 3.0), (4.0, 60.0)))
    assert evidence._choose_output(errors, without, {o: np.array([e]) for o, e in plain.items()}) == output


@pytest.mark.parametrize(
    ("rival", "deviations", "is_equal"),
    [
        (candidate(995, "rich", free=9), 2.9, True),
        (candidate(995, "rich", free=9), -2.9, True),  # it does a little better, and may by chance
        (candidate(995, "rich", free=9), 3.1, False),  # clearly worse: it is behind
        (candidate(995, "rich", free=9), -3.1, False),  # clearly better: an objection
        (candidate(950, "rich", free=9), 0.0, False),  # where they were fitted its constants have paid
        (candidate(1000, "other", free=6), 1.0, False),  # of as many constants: to be told apart by experiment
    ],
)
def test_an_effect_of_more_constants_that_does_the_same_is_an_equal_and_no_objection(rival, deviations, is_equal):
    inputs = SimpleNamespace(selected=candidate(1000, "simple", free=6))
    assert evidence._is_richer_equal(inputs, rival, (0.05, deviations)) is is_equal


TIME = np.linspace(0, 1, 200)


@pytest.mark.parametrize(
    ("variable", "modelled", "expected"),
    [
        ("v", np.sign(np.sin(30 * TIME)), True),
        ("x", np.sign(np.sin(30 * TIME)), False),
        ("x", np.full(200, 0.3), True),
        ("time", 0.1 * TIME, True),
        ("time", np.sin(30 * TIME), False),
    ],
    ids=["its own variable", "another one", "any, of a constant", "time, of a drift", "time, of no drift"],
)
def test_a_curve_over_some_variables_is_the_effect_itself(variable, modelled, expected):
    signal = SimpleNamespace(effect="a", variable_name="v", time=TIME, modelled=modelled)
    assert _represents(variable, signal) is expected


def compare_with_curves(monkeypatch, *curves, error=1.0, rest=1000.0, is_constant=False):
    """`free_loss` where ``curves`` (variable, cost, criterion) stand in the place of an effect over v; they leave ``error`` elsewhere."""
    signal = SimpleNamespace(effect="a", variable_name="v", time=TIME, modelled=np.sin(30 * TIME))
    fits = [SimpleNamespace(variable=z, candidate=SimpleNamespace(cost=c, criterion=k)) for z, c, k in curves]
    monkeypatch.setattr(evidence, "_refit_free_curves", lambda *_: fits)
    scores = SimpleNamespace(square_errors=lambda fit, blocks, adapted: {"x": error * ERRORS["x"]})
    inputs = SimpleNamespace(
        signals=[signal],
        selected=SimpleNamespace(cost=100.0, criterion=110.0),
        scores=scores,
        policy=DiscoveryPolicy(),
        attempt_check=lambda check: is_constant,
    )
    return evidence._compare_with_free_curves(inputs, "a", ERRORS, SimpleNamespace(cost=rest))


def test_the_best_free_curve_counts_unless_it_is_the_effect_itself(monkeypatch):
    assert compare_with_curves(monkeypatch, ("u", 130.0, 200.0), ("x", 300.0, 400.0)) == pytest.approx(0.3)
    assert np.isnan(compare_with_curves(monkeypatch, ("v", 99.0, 200.0)))  # as good, for many more constants
    assert compare_with_curves(monkeypatch, ("v", 60.0, 100.0)) == pytest.approx(-0.4)
    assert np.isnan(
        compare_with_curves(monkeypatch, ("v", 60.0, 100.0), rest=1e5)
    )  # nothing beside what the effect takes


def test_any_curve_can_be_a_constant(monkeypatch):
    assert compare_with_curves(monkeypatch, ("u", 99.0, 105.0)) == pytest.approx(-0.01)
    assert np.isnan(compare_with_curves(monkeypatch, ("u", 99.9, 105.0), is_constant=True))


def test_a_free_curve_that_fails_elsewhere_does_not_count(monkeypatch):
    assert np.isnan(compare_with_curves(monkeypatch, ("u", 60.0, 100.0), error=3.0))


@pytest.mark.parametrize(
    ("name", "expected"),
    [("lugre_friction", "prepare_curve"), ("stribeck_friction", "prepare_power"), ("coulomb_friction", None)],
)
def test_what_stands_in_the_place_of_an_effect_is_simpler(monkeypatch, name, expected):
    model = micro_actuator + gb.effect(name)
    asked = []
    for prepare in ("prepare_curve", "prepare_power"):
        monkeypatch.setattr(evidence, prepare, lambda *_, prepare=prepare: asked.append(prepare))
    inputs = SimpleNamespace(
        signals=[SimpleNamespace(effect=name)],
        selected=SimpleNamespace(model=model, effects=(name,)),
        policy=DiscoveryPolicy(),
        problem=SimpleNamespace(failures=FailureLog(), refit_all=lambda jobs: ["fit"]),
    )
    evidence._refit_simpler(inputs, gb.effect(name), SimpleNamespace())
    assert asked == ([expected] if expected else [])


@pytest.mark.parametrize(
    ("structure", "shares", "alike", "expected"),
    [
        (0.6, (0.6, 0.5), (), Grade.PROBABLE),
        (0.1, (0.6, 0.5), (), Grade.ESTABLISHED),
        (0.6, (0.6, 0.1), (), Grade.ESTABLISHED),
        (0.6, (0.6, 0.5), ("c",), Grade.ESTABLISHED),
        (0.1, (0.2, 0.3), (), Grade.PROBABLE),
        (0.1, (0.2, 0.3), ("c",), Grade.ESTABLISHED),
    ],
    ids=[
        *("more than noise is left", "noise is left", "it takes little", "it has an equal"),
        *("it takes more than the other", "it takes more and has an equal"),
    ],
)
def test_nothing_is_certain_beside_a_stand_in(monkeypatch, structure, shares, alike, expected):
    grades = {"a": (Grade.ESTABLISHED, shares[0]), "b": (Grade.STAND_IN, shares[1])}

    @dataclass(frozen=True)
    class Weighed:
        effect: str
        grade: Grade
        share: float
        alike: tuple[str, ...]

    for name, value in (
        ("_refit_with_corrections", {}),
        ("_refit_halves", []),
        ("_ends_in_the_same_place", True),
    ):
        monkeypatch.setattr(evidence, name, lambda _, value=value: value)
    monkeypatch.setattr(evidence, "measure_structure", lambda *_, **__: structure)
    monkeypatch.setattr(
        evidence, "_weigh_effect", lambda _, effect, *__: Weighed(effect.name, *grades[effect.name], alike)
    )
    scores = SimpleNamespace(square_errors=lambda fit, blocks: ERRORS)
    model = SimpleNamespace(effects=[toy_effect("a"), toy_effect("b")], outputs=["x"])
    inputs = SimpleNamespace(
        scores=scores, selected=SimpleNamespace(model=model, effects=("a", "b")), policy=DiscoveryPolicy()
    )
    assert [e.grade for e in evidence.gather_evidence(inputs)] == [expected, Grade.STAND_IN]


def test_a_rival_that_is_far_behind_is_not_refitted_to_the_end(monkeypatch):
    monkeypatch.setattr(evidence, "_converge", lambda inputs, fit: candidate(fit.cost - 1, *fit.effects))
    inputs = SimpleNamespace(selected=SimpleNamespace(cost=1.0))
    rivals = [candidate(cost, f"rival_{cost:g}") for cost in (900.0, 20.0, 300.0)]
    assert [fit.cost for fit in evidence._keep_hopeful(inputs, rivals)] == [19.0]
    again = candidate(15.0, "rival_20")  # the same effect, fitted in the search and here: it is told once
    assert [fit.cost for fit in evidence._keep_hopeful(inputs, [*rivals, again])] == [14.0]
    assert [fit.cost for fit in evidence._keep_hopeful(inputs, [rivals[0], rivals[2]])] == [300.0]
    assert evidence._keep_hopeful(inputs, []) == []


@pytest.mark.parametrize(("outputs", "expected"), [(2, Grade.PROBABLE), (3, Grade.ESTABLISHED)])
def test_the_same_effect_at_every_output_may_be_one_of_the_input(outputs, expected):
    weighed = [
        EffectEvidence(
            name, 0.9, Grade.ESTABLISHED, "x", "m", 2.0, 1.0, 0.5, (0.4, 0.6), "", np.nan, (), 0.0, True, True, {}
        )
        for name in ("sensor_lag", "sensor_lag_at_p")
    ]
    graded = evidence._lower_doubtful(tuple(weighed), 0.0, outputs)
    assert {e.grade for e in graded} == {expected}


def structure_of(residual, bound, ratio=1.0, only_visible=True):
    residual = ratio * residual
    run = SimpleNamespace(
        misfit={"x": SimpleNamespace(noise_ratio=ratio, rmse=ratio, samples=len(residual))},
        traces=[SimpleNamespace(measured={"x": residual}, residual=lambda name: residual)],
    )
    scores = SimpleNamespace(
        run=lambda fit: run, adapt=lambda fit: AdaptedRun({"x": [residual]}), charge=lambda run: {"x": 0.0}
    )
    noise = SimpleNamespace(bound=lambda name: bound)
    fit = SimpleNamespace(problem=SimpleNamespace(noise=noise))
    return measure_structure(scores, fit, only_visible)


KNOWN = NoiseBound(1.0, BoundDirection.ABOUT, NoiseSource.GIVEN)
WHITE = RNG.standard_normal(2000)
COLOURED = np.convolve(RNG.standard_normal(2100), 0.8 ** np.arange(60), "full")[60:2060]
SLOW = np.sin(np.arange(2000) / 30) + 0.02 * RNG.standard_normal(2000)


def test_what_exceeds_known_noise_is_structure():
    assert structure_of(WHITE / WHITE.std(), KNOWN, 1.04) == 0.0
    assert structure_of(WHITE, KNOWN, 10.0) == pytest.approx(1.0, abs=0.01)


def test_the_level_of_a_short_record_of_noise_exceeds_its_own_by_chance():
    few = WHITE[:200] / WHITE[:200].std()
    assert structure_of(few, KNOWN, 1.1) == 0.0  # 1.1 is within three standard errors of 5 %
    assert structure_of(few, KNOWN, 1.1, only_visible=False) > 0.3
    assert structure_of(WHITE / WHITE.std(), KNOWN, 1.1) > 0.2


def test_noise_of_one_time_constant_is_no_structure_where_nobody_knows_the_noise():
    assert structure_of(WHITE, None) < 0.1
    assert structure_of(COLOURED, None) < 0.2
    assert structure_of(SLOW, None) > 0.9


def test_without_a_run_on_the_validation_records_there_is_no_evidence():
    scores = SimpleNamespace(square_errors=lambda fit, blocks: {}, run=lambda fit: None, adapt=lambda fit: None)
    inputs = SimpleNamespace(scores=scores, selected=candidate(1.0, "a"))
    assert evidence.gather_evidence(inputs) == ()
    assert measure_structure(scores, None, only_visible=True) == 1.0
