"""Whatever fails in a search, the search ends with an answer, and the reason is kept."""

import pytest

import greybox as gb
from greybox.base.errors import FitError
from greybox.discovery.claims import deepest_established
from greybox.discovery.execution import SearchStage
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.pipeline import discover
from greybox.model.effect import Effect
from greybox.model.signals import Parameter
from models.micro_actuator import micro_actuator
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
        pytest.param("conclusion.localise_residual", SearchStage.LOCALISATION, marks=pytest.mark.slow),
        ("conclusion.add_objections", SearchStage.WEIGHING),
        ("conclusion.estimate_effect_signals", SearchStage.EVIDENCE),
        pytest.param("proposers.list_shape_corrections", SearchStage.SHAPE_CORRECTION, marks=pytest.mark.slow),
    ],
)
def test_a_stage_that_fails_does_not_end_the_search(rig, monkeypatch, place, stage):
    monkeypatch.setattr(f"greybox.discovery.{place}", fail)
    found = answer(rig)
    assert [e["name"] for e in found.effects] == ["cubic_stiffness"]
    assert (stage, "on purpose") in {(failure.stage, failure.reason) for failure in found.failures}
    if place == "conclusion.add_objections":
        assert found.verdict == "partly"  # no name is certain that was held against no rival; the place is
        assert not any(e["grade"] == "established" for e in found.effects)
        assert deepest_established(found.claims).name == ""
    is_whole = stage is SearchStage.WEIGHING
    told = [str(f) for f in found.findings if f.code == DiscoveryCode.STAGE_FAILED]
    assert (
        told
        == ["the answer could not be weighed against its rivals, so no name of an effect is certain: on purpose"]
        * is_whole
    )


def test_an_answer_that_could_not_be_weighed_says_so(rig, monkeypatch):
    monkeypatch.setattr("greybox.discovery.conclusion.weigh_claims", fail)
    found = answer(rig)
    assert not found.claims
    assert [f.subject for f in found.findings if f.code == DiscoveryCode.STAGE_FAILED] == [SearchStage.WEIGHING]


def test_what_comes_after_an_unknown_effect_may_fail_as_well(rig, monkeypatch):
    monkeypatch.setattr("greybox.discovery.conclusion.fit_stand_in", fail)
    found = answer(rig, ["input_offset"])
    assert found.verdict == "unknown"
    assert SearchStage.SURROGATE in {failure.stage for failure in found.failures}


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


# A model that holds an effect already: it is its user's, and no search adds, drops or swaps it.


FRICTION = {"coulomb_friction": {"Fc": 0.05}}


@pytest.mark.parametrize(
    ("noise", "more"),
    [
        pytest.param(NOISE, {}, id="nothing else is missing-noise told"),
        pytest.param(None, {}, id="nothing else is missing-noise untold", marks=pytest.mark.slow),
        pytest.param(NOISE, FRICTION, id="another effect is-noise told", marks=pytest.mark.slow),
        pytest.param(None, FRICTION, id="another effect is-noise untold", marks=pytest.mark.slow),
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
