"""From 'unknown' to a law: a plant without roles gets the term that it lacks, and a complete one none."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import greybox as gb
from fits.studies.law_study import run_case
from fits.studies.law_systems import SYSTEMS
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.discovery import conclusion
from greybox.discovery.claims import Depth
from greybox.discovery.result import load_discovery

pytestmark = pytest.mark.rest

NOISE = 0.01


def hunters(with_hunting: bool) -> Model:
    """Lotka and Volterra's equations, the prey with or without being eaten; constants a third off."""

    def balances(x, u, p):
        hunted = {"hunted": -p.h * x.a * x.b} if with_hunting else {}
        return [
            Balance("prey", "1/s", 1, "a", growth=p.r * x.a, **hunted),
            Balance("predators", "1/s", 1, "b", death=-p.d * x.b, eating=p.e * x.a * x.b),
        ]

    parameters = [Parameter(n, "1/s", v, (0, 10)) for n, v in (("r", 1.3), ("d", 0.8), ("e", 0.3), ("h", 0.8))]
    return Model(
        "hunters",
        states=[State("a", "1", 3.0), State("b", "1", 1.0)],
        inputs=[],
        outputs=[Output("a", "1"), Output("b", "1")],
        parameters=parameters if with_hunting else parameters[:3],
        balances=balances,
    )


def record(name: str, start: tuple[float, float], seed: int) -> Experiment:
    time = np.linspace(0, 10, 81)
    run = solve_ivp(
        lambda t, x: [x[0] - 0.6 * x[0] * x[1], -x[1] + 0.4 * x[0] * x[1]],
        (0, 10),
        start,
        method="DOP853",
        t_eval=time,
        rtol=1e-9,
        atol=1e-9,
    )
    y = run.y + NOISE * np.random.default_rng(seed).normal(size=run.y.shape)
    return Experiment(name, time, {}, {"a": y[0], "b": y[1]})


def search_for_the_hunt():
    """A search for the equation that hunters without their hunt lack."""
    return gb.discover(
        hunters(False),
        record("one", (3.0, 1.0), 1),
        validation=record("two", (1.5, 2.0), 2),
        noise={"a": NOISE, "b": NOISE},
        effects=(),
        laws=True,
    )


@pytest.fixture(scope="module")
def searched():
    """The answer, and what was asked for curves in its place on the way."""
    asked = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conclusion, "add_curves_in_place", lambda *given: asked.append(given))
        answer = search_for_the_hunt()
    return answer, asked


@pytest.fixture(scope="module")
def found(searched):
    return searched[0]


def test_the_missing_term_is_named_as_an_equation(found):
    assert found.verdict == "named" and found.alternatives == []
    (law,) = found.effects
    assert law["name"] == "law" and law["site"] == "prey" and law["grade"] == "established"
    a, b = sympy.symbols("a b")
    ratio = sympy.sympify(law["equation"], locals={"a": a, "b": b}) / (a * b)
    assert ratio.is_number and float(ratio) == pytest.approx(-0.6, rel=0.02)
    assert found.best.parameters["r"].value == pytest.approx(1.0, rel=0.02)


def test_the_file_holds_equation_and_range(found, tmp_path):
    data = load_discovery(found.save(tmp_path / "discovery.json"))
    law = data["effects"][0]
    assert law["formula"] == "k*a*b" and set(law["range"]) == {"a", "b"}
    assert json.dumps(data)


def test_nothing_is_claimed_of_a_complete_model():
    answer = gb.discover(
        hunters(True),
        record("one", (3.0, 1.0), 3),
        validation=record("two", (1.5, 2.0), 4),
        noise={"a": NOISE, "b": NOISE},
        effects=(),
        laws=True,
    )
    assert answer.verdict == "complete" and answer.effects == [] and answer.laws == ()


@pytest.mark.slow
def test_a_law_that_takes_nothing_of_the_error_is_none(found, monkeypatch):
    """What counts is the error of the free run that is told."""
    finish = conclusion.finish_fit

    def go_astray(*given):
        finished = finish(*given)
        return replace(finished, fit=replace(finished.fit, validation=found.base.validation))

    monkeypatch.setattr(conclusion, "finish_fit", go_astray)
    # What stands in for it would be looked for as long as for the law.
    monkeypatch.setattr(conclusion, "fit_stand_in", lambda *given: None)
    answer = search_for_the_hunt()
    assert answer.verdict == "unknown" and answer.laws == ()
    assert answer.holdout["a"].after == answer.holdout["a"].before


@pytest.mark.slow
def test_a_law_takes_the_error_of_a_plain_model_whose_run_goes_astray():
    """The brusselator without the reaction that ends it: its concentrations grow without end, and the law is the answer."""
    brusselator = next(system for system in SYSTEMS if system.name == "brusselator")
    case = run_case(brusselator, "dropped", "1")
    assert case["right"] and case["grade"] == "established"
    # What the law leaves of an error of many times the noise is the noise.
    assert case["misfit"] > 50 and case["misfit"] * (1 - case["share"]) == pytest.approx(1.0, abs=0.1)


def test_the_equation_is_claimed_at_every_depth(found):
    (name,) = [c for c in found.claims if c.depth is Depth.NAME]
    assert (name.name, name.sites, name.variables) == ("k*a*b", ("balance prey",), ("a", "b")) and name.is_established
    (law,) = found.effects
    assert law["probability"] == name.probability and law["share"] > 0.9


def test_no_curve_takes_the_place_of_an_established_law(searched):
    answer, asked = searched
    assert [law.formula for law in answer.laws] == ["k*a*b"] and not asked


@pytest.mark.parametrize("name", ["spruce_budworm", "chemostat"])
def test_constants_that_the_first_record_leaves_open_are_no_missing_law(name):
    """Two resting places, or slopes that multiply: a little in the constants is much on the other record."""
    case = run_case(next(s for s in SYSTEMS if s.name == name), "complete", "1")
    assert (case["verdict"], case["laws"]) == ("complete", [])
