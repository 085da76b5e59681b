"""Candidates on the validation records, with errors that are given: nothing is simulated."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.discovery import holdout
from greybox.discovery.holdout import HoldoutError, reject_on_validation, worst_output
from greybox.discovery.policy import SearchBudget, SelectionPolicy
from tests.support.fake_candidates import candidate


@pytest.mark.parametrize(
    ("before", "after", "floor", "fraction"),
    [(10.0, 1.0, 1.0, 1.0), (10.0, 5.5, 1.0, 0.5), (10.0, 10.9, 1.0, -0.1), (10.0, 0.1, 1.0, 1.1)],
)
def test_the_explained_fraction_counts_from_the_noise(before, after, floor, fraction):
    assert HoldoutError(before, after, floor, "m").explained_fraction == pytest.approx(fraction)


def test_the_worst_output_is_so_in_units_of_its_noise():
    errors = {"x": HoldoutError(10.0, 1.0, 5.0, "m"), "i": HoldoutError(1.0, 1.0, 0.1, "A")}
    assert worst_output(errors) == "i"


SELECTED, GOOD, BETTER, POOR = (candidate(cost, name) for cost, name in ((10, "s"), (30, "g"), (20, "b"), (15, "p")))


@pytest.mark.parametrize(
    ("errors", "kept"),
    [
        ({"s": 3.0}, "s"),  # explains 7 of 9: more than half
        ({"s": 9.0, "g": 1.5}, "g"),  # another one explains most of it
        ({"s": 9.0, "g": 1.5, "b": 1.2}, "b"),  # the likeliest of those, not the best
        ({"s": 9.0, "p": 3.0}, "s"),  # more than half is not enough to replace it
        ({"s": np.inf, "g": 1.5}, "g"),  # it runs away
        ({"s": 9.0}, "s"),  # none is better: it stays, and will be unknown
    ],
)
def test_a_model_that_explains_less_than_half_gives_way(monkeypatch, errors, kept):
    def score(problem, fit, validation, skip=0):
        return 10.0 if not fit.effects else errors.get(fit.effects[0], 8.0)

    monkeypatch.setattr(holdout, "score_holdout", score)
    problem = SimpleNamespace(budget=SearchBudget(), refit_best=lambda *_, **__: None)
    best, checks = reject_on_validation(
        problem, candidate(100.0), SELECTED, [SELECTED, GOOD, BETTER, POOR], ["a record"], SelectionPolicy()
    )
    assert best.effects == (kept,)
    assert checks[0].subject == "s"
    assert [check.subject for check in checks if check.passed] == (
        [kept] if best is not SELECTED or errors["s"] < 5 else []
    )


def test_without_a_gap_nothing_is_rejected(monkeypatch):
    monkeypatch.setattr(holdout, "score_holdout", lambda *_: 1.04)
    kept, checks = reject_on_validation(None, candidate(100.0), SELECTED, [GOOD], ["a record"], SelectionPolicy())
    assert kept is SELECTED
    assert checks == ()


def test_only_the_leading_candidates_are_scored(monkeypatch):
    scored = []

    def score(problem, fit, validation, skip=0):
        scored.append(fit.effects)
        return 10.0

    monkeypatch.setattr(holdout, "score_holdout", score)
    problem = SimpleNamespace(budget=SearchBudget(holdout_candidates=2), refit_best=lambda *_, **__: None)
    many = [candidate(20.0 + k, f"other_{k}") for k in range(5)]
    reject_on_validation(problem, candidate(100.0), SELECTED, many, ["a record"], SelectionPolicy())
    assert scored == [(), ("s",), ("other_0",), ("other_1",)]
