"""Whatever fails in a search, the search ends with an answer, and the reason is kept."""

import pytest

import greybox as gb
from greybox.base.errors import FitError
from greybox.discovery.claims import deepest_established
from greybox.discovery.execution import RefitJob, SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.pipeline import discover
from greybox.discovery.selection import StepwiseSelection
from greybox.model.effect import Effect
from greybox.model.signals import Parameter
from models.micro_actuator import micro_actuator
from tests.discovery.test_selection import select
from tests.support.fake_candidates import FakeProblem, costs, toy_effect
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records

pytestmark = pytest.mark.rest

NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.fixture(scope="module")
def rig():
    return simulate_records(micro_actuator, {"cubic_stiffness": {"K3": 1e10}}, tuple(NOISE.values()), rows=200)


def answer(rig, effects=("cubic_stiffness", "quadratic_stiffness"), **more):
    among = [gb.effect(e) if isinstance(e, str) else e for e in effects]
    return discover(
        plain_model(micro_actuator),
        rig[0],
        validation=rig[1],
        noise=NOISE,
        options=AT_REST,
        effects=among,
        workers=1,
        **more,
    )


def fail(*_, **__):
    raise FitError("on purpose")


@pytest.mark.parametrize(
    ("place", "stage"),
    [
        ("conclusion.localise_residual", SearchStage.LOCALISATION),
        ("conclusion.refit_rivals", SearchStage.EVIDENCE),
        ("conclusion.estimate_effect_signals", SearchStage.EVIDENCE),
        ("rivals.list_shape_corrections", SearchStage.SHAPE_CORRECTION),
    ],
)
def test_a_stage_that_fails_does_not_end_the_search(rig, monkeypatch, place, stage):
    monkeypatch.setattr(f"greybox.discovery.{place}", fail)
    found = answer(rig)
    assert [e["name"] for e in found.effects] == ["cubic_stiffness"]
    assert (stage, "on purpose") in {(failure.stage, failure.reason) for failure in found.failures}
    if place == "conclusion.refit_rivals":
        assert found.verdict == "partly"  # no name is certain that was held against no rival; the place is
        assert not any(e["grade"] == "established" for e in found.effects)
        assert deepest_established(found.claims).name == ""


def test_what_comes_after_an_unknown_effect_may_fail_as_well(rig, monkeypatch):
    """The search for further effects fails, and the curve after it, which is tried nevertheless."""
    for place in ("refine_candidate", "fit_surrogate"):
        monkeypatch.setattr(f"greybox.discovery.conclusion.{place}", fail)
    found = answer(rig, ["input_offset"])
    assert found.verdict == "unknown"
    assert {failure.stage for failure in found.failures} >= {SearchStage.REFINEMENT, SearchStage.SURROGATE}


def test_an_effect_that_cannot_be_written_out_is_out_with_its_reason(rig):
    broken = Effect(
        "broken",
        "force",
        [Parameter("size", "N", 0.0, source="a test")],
        terms=lambda x, u, p: p.size,
        amplitudes=("size",),
        probe=fail,
        source="a test",
    )
    found = answer(rig, ["cubic_stiffness", broken])
    assert [e["name"] for e in found.effects] == ["cubic_stiffness"]
    assert found.not_tried["broken"].code == DiscoveryCode.CANDIDATE_FAILED
    assert "on purpose" in found.not_tried["broken"].values["reason"]


# The selection alone, with a fake estimator.


def test_an_effect_whose_refit_cannot_begin_is_out():
    effects = [toy_effect("a"), toy_effect("b")]

    class Failing(StepwiseSelection):
        def _screening_job(self, fit, effect) -> RefitJob:
            if effect.name == "a":
                fail()
            return super()._screening_job(fit, effect)

    problem = FakeProblem(costs(9000, a=1000, b=1500))
    selection = Failing(problem, effects, None, gb.discovery.DiscoveryPolicy(), lambda text: None)
    selection.measure_autocorrelation = lambda fit, lags: 0.0
    selection.correct_shape = lambda *_: None
    assert selection.select().effects == ("b",)
    assert ("a",) in {f.effects for f in problem.failures.entries.values()}


def test_a_further_effect_whose_cost_cannot_be_predicted_is_out(monkeypatch):
    def predict(self, model, starts, like=None):
        if {e.name for e in model.effects} == {"a", "b"}:
            fail()
        return self._cost(model)

    monkeypatch.setattr(FakeProblem, "predict_cost", predict)
    table = costs(9000, a=3000, b=4000, c=5000, a__b=1000, a__c=1000)
    selection, best = select(table, [toy_effect("a"), toy_effect("b"), toy_effect("c")])
    assert set(best.effects) == {"a", "c"}
    assert SearchStage.SCREENING in {f.stage for f in selection.problem.failures.entries.values()}


def test_a_shape_that_cannot_be_corrected_stands_in_nobodys_way():
    table = costs(9000, a=2000, b=3000, a__b=1000)
    selection, best = select(table, [toy_effect("a"), toy_effect("b")], correct_shape=fail)
    assert set(best.effects) == {"a", "b"}
    assert SearchStage.SHAPE_CORRECTION in {f.stage for f in selection.problem.failures.entries.values()}


# A model that holds an effect already: it is its user's, and no search adds, drops or swaps it.


FRICTION = {"coulomb_friction": {"Fc": 0.05}}


@pytest.mark.parametrize(
    ("noise", "more"),
    [
        pytest.param(NOISE, {}, id="nothing else is missing-noise told"),
        pytest.param(None, {}, id="nothing else is missing-noise untold"),
        pytest.param(NOISE, FRICTION, id="another effect is-noise told", marks=pytest.mark.slow),
        pytest.param(None, FRICTION, id="another effect is-noise untold"),
    ],
)
def test_an_effect_that_the_model_holds_already_is_no_find_of_the_search(noise, more):
    hidden, expected = {"cubic_stiffness": {"K3": 1e10}, **more}, list(more)
    train, test = simulate_records(micro_actuator, hidden, tuple(NOISE.values()), rows=150)
    among = [gb.effect(name) for name in ("coulomb_friction", "input_offset")]
    own = plain_model(micro_actuator) + gb.effect("cubic_stiffness")
    found = discover(own, train, validation=test, noise=noise, options=AT_REST, effects=among, workers=1)
    assert [e["name"] for e in found.effects] == expected
    assert "cubic_stiffness" in {e.name for e in found.best.model.effects}
    assert found.verdict == ("named" if expected else "complete")
