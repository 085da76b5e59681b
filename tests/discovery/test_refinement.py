"""Small effects beside a large one, and models that fail on other records: a circuit with two hidden effects."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from greybox import Experiment, FitOptions, fit, simulate
from greybox.discovery import refinement
from greybox.discovery.claims import find_winner
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.refinement import refine
from greybox.discovery.table import FitTable
from greybox.model.effects.catalogue import effect
from greybox.shell.commands import app
from greybox.shell.project import find_model
from greybox.simulation.simulate import write_csv
from models.silverbox import silverbox
from tests.support.fake_candidates import candidate, toy_effect

NOISE = 2e-5  # V


def simulate_circuit(model, seed, peak=0.3, rows=300):
    """A record of the circuit under a smooth random input, with noise far below the smallest effect."""
    generator = np.random.default_rng(seed)
    u = np.convolve(generator.standard_normal(rows + 6), np.hanning(7), "valid")
    record = Experiment("shaken", np.arange(rows) * 1e-3, {"u": peak * u / np.abs(u).max()}, {}, hold="first")
    return simulate(model, record).record({"y": NOISE}, generator)


@pytest.fixture(scope="module")
def hardening():
    """The fit of the large effect, two records that hold a small one as well, and the plain model."""
    truth = silverbox + effect("cubic_stiffness") + effect("quadratic_stiffness")
    truth = truth.start(K3=7e5, K2=-2e4)
    records = [simulate_circuit(truth, seed) for seed in (1, 2)]
    few = replace(silverbox, candidates=("cubic_stiffness", "quadratic_stiffness", "constant_load"))
    return fit(few + effect("cubic_stiffness"), records[0], noise={"y": NOISE}), records, few


@pytest.mark.rest
def test_refining_finds_the_small_effect_and_stops(hardening):
    large, (_, test), plain = hardening
    refined = refine(large, test, plain=plain)
    assert [step.name for step in refined.steps] == ["quadratic_stiffness"]
    assert refined.steps[0].validation_share > 0.5
    assert refined.fit.parameters["K2"].value == pytest.approx(-2e4, rel=0.02)
    assert refined.fit.validation.misfit["y"].rmse < 1.2 * NOISE
    passed = {(check.rule, check.subject) for check in refined.checks if check.passed}
    assert (DiscoveryRule.VALIDATION_DECREASE, "quadratic_stiffness") in passed


@pytest.mark.rest
def test_an_effect_that_a_later_one_makes_needless_is_out_again(hardening):
    large, (record, test), plain = hardening
    useless = fit(large.model + effect("constant_load"), record, noise={"y": NOISE})
    refined = refine(useless, test, plain=plain)
    assert [(step.name, step.dropped) for step in refined.steps] == [
        ("quadratic_stiffness", False),
        ("constant_load", True),
    ]
    assert [e.name for e in refined.fit.model.effects] == ["cubic_stiffness", "quadratic_stiffness"]
    assert refined.steps[1].validation_share < 0.05


@pytest.mark.rest
def test_what_is_left_is_searched_for_further_effects_without_being_asked(tmp_path, monkeypatch):
    truth = (silverbox + effect("cubic_stiffness") + effect("quadratic_stiffness")).start(K3=7e5, K2=-4e3)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("greybox.show.figures.pictures.draw_discovery", lambda *_: [])  # they are drawn in another test

    # As if the search had ended with the large effect.
    monkeypatch.setattr("greybox.discovery.selection.StepwiseSelection._has_structure_left", lambda *_: False)
    for seed, name in ((1, "train"), (2, "test")):
        write_csv(simulate_circuit(truth, seed, rows=160), silverbox, Path(f"{name}.csv"))
    command = "discover silverbox train.csv --validate test.csv --hold first --noise y=2e-5 --output out"
    result = CliRunner().invoke(app, [*command.split(), "--effects", "cubic_stiffness,quadratic_stiffness"])
    assert result.exit_code == 0, result.output
    answer = json.loads(Path("out/discovery.json").read_text())
    assert [e["name"] for e in answer["effects"]] == ["cubic_stiffness", "quadratic_stiffness"]
    (step,) = answer["further"]["steps"]
    assert step["name"] == "quadratic_stiffness"
    assert step["fitted"] > 0.9
    assert answer["gap"]["y"]["after"] == answer["further"]["validation"]["y"]["rmse"]
    assert set(step) == {"name", "fitted", "held_out", "alike", "replaced", "dropped"}
    assert answer["further"]["validation"]["y"]["rmse"] < 1.2 * NOISE
    # The extended model that was written has both.
    assert find_model("out/model.py").values["K2"] == pytest.approx(-4e3, rel=0.02)
    assert Path("out/report.html").is_file()


def test_a_rival_that_follows_the_other_records_wins(hardening):
    large, (record, test), plain = hardening
    problem = DiscoveryProblem(plain, (record,), {"y": NOISE}, (), FitOptions())
    right = problem.refit_best(plain + effect("cubic_stiffness"), [large.model.values])
    useless = plain + effect("constant_load")
    # As if it had explained the estimation record better than any other.
    wrong = replace(problem.refit_best(useless, [useless.values]), cost=0.5 * right.cost)
    table = FitTable(HoldoutScores(problem, ValidationSet.of(test)))
    table.add(problem.baseline, wrong, right)
    draws = table.draw(table.leading((problem.baseline, wrong)))
    assert find_winner(draws, wrong) is right
    assert find_winner(draws, right) is right


STEADY, SCATTERED = 0.5 + 0.01 * np.arange(10), np.array([0.3, 1.4] * 5)


@pytest.mark.parametrize(
    ("smaller", "larger", "after", "left", "accepted", "rules"),
    [
        (9000.0, 4000.0, 0.5, STEADY, True, [True, True, True, True]),
        (9000.0, 8990.0, 0.5, STEADY, False, [False, False]),  # the criterion does not pay for the constant
        (9000.0, 8700.0, 0.5, STEADY, False, [True, False]),  # 1.7 % of the rms misfit, two are needed
        (9000.0, 4000.0, 0.96, STEADY, False, [True, True, False]),  # 4 % on the validation records, five are needed
        (9000.0, 4000.0, 0.94, STEADY, True, [True, True, True, True]),
        (9000.0, 4000.0, 0.5, SCATTERED, False, [True, True, True, False]),  # it harms half of the blocks
    ],
)
def test_a_further_effect_must_remove_a_share_on_both_records(smaller, larger, after, left, accepted, rules):
    of = {"": np.ones(10), "a": left}
    scores = SimpleNamespace(
        score=lambda _: after, square_errors=lambda fit, _, adapted: {"y": of["".join(fit.effects)]}
    )
    checks = []
    extension = refinement._judge_extension(
        scores, candidate(smaller), candidate(larger, "a"), 1.0, DiscoveryPolicy(), checks
    )
    assert (extension is not None) is accepted
    assert [check.passed for check in checks] == rules
    assert {check.subject for check in checks} == {"a"}


@pytest.mark.parametrize(("after", "accepted"), [(0.93, False), (0.89, True)])
def test_an_effect_in_the_place_of_another_must_do_more_than_as_well(after, accepted):
    of = {"b": np.ones(10), "a": STEADY}
    scores = SimpleNamespace(score=lambda _: after, square_errors=lambda fit, _, adapted: {"y": of[fit.effects[0]]})
    other = candidate(4000.0, "a")
    assert (
        bool(refinement._judge_extension(scores, candidate(9000.0, "b"), other, 1.0, DiscoveryPolicy(), [])) is accepted
    )


@pytest.mark.parametrize(("of_parent", "chosen"), [(1.08, "coulomb_friction"), (1.2, "stribeck_friction")])
def test_the_simpler_member_of_a_family_stays_where_it_does_nearly_as_well(of_parent, chosen):
    family = [toy_effect("coulomb_friction"), toy_effect("stribeck_friction", "coulomb_friction")]
    near = [
        refinement._Extension(candidate(1, name), name, misfit, 0.5)
        for name, misfit in (("stribeck_friction", 1.0), ("coulomb_friction", of_parent))
    ]
    assert refinement._prefer_simpler(near[0], near, family, 1.1).name == chosen
