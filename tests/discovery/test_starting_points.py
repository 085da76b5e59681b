"""Where refits start: origins, amplitudes, shapes and parents. Nothing is simulated."""

from itertools import pairwise
from types import SimpleNamespace

import pytest

from greybox.discovery.candidates import generate_child_starting_points, generate_starting_points
from greybox.discovery.problem import FittedCandidate
from greybox.model.effect import Effect
from greybox.model.effects.scales import count_shapes
from greybox.model.effects.signal_path import list_lags
from greybox.model.signals import Parameter
from models.micro_actuator import micro_actuator
from tests.support.fake_candidates import toy_effect

PLAIN = micro_actuator.fix("M", "Ra")


def fitted(model, **values):
    return FittedCandidate(model.start(**values), 1.0, 1, 1, None, None, None)


def shaped_effect(grid):
    return Effect(
        "shaped",
        "force",
        [Parameter("size", "N", 0.0, (-0.5, 0.5), source="a test"), Parameter("corner", "", 1.0, source="a test")],
        terms=lambda x, u, p: p.size * p.corner,
        amplitudes=("size",),
        probe=lambda scales: {"size": 0.1},
        grid=lambda scales: {"corner": grid},
        source="a test",
    )


def starting_points(effect, baseline, plain=PLAIN, amplitudes=(1.0, 10.0)):
    model = baseline.model + effect
    return list(generate_starting_points(model, effect, baseline, plain, None, amplitudes))


def test_a_candidate_starts_from_the_fitted_and_from_the_given_values():
    baseline = fitted(PLAIN, B=9.0)  # the plain model has swallowed the effect
    points = starting_points(toy_effect("a"), baseline, amplitudes=(1.0,))
    assert [point["B"] for point in points] == [9.0, PLAIN.values["B"]]
    assert {point["a_size"] for point in points} == {1.0}


def test_equal_origins_are_tried_once():
    assert len(starting_points(toy_effect("a"), fitted(PLAIN), amplitudes=(1.0,))) == 1


def test_every_amplitude_meets_every_shape():
    effect = shaped_effect([1.0, 2.0, 3.0])
    points = starting_points(effect, fitted(PLAIN))
    assert count_shapes(effect, None) == 3
    assert {(p["corner"], p["size"]) for p in points} == {(c, s) for c in (1.0, 2.0, 3.0) for s in (0.1, 0.5)}


@pytest.mark.parametrize(("rows", "expected"), [(500, 3), (6000, 4), (20_000, 5)])
def test_a_lag_is_searched_for_on_all_scales_of_time_of_a_record(rows, expected):
    period = 1e-3
    lags = list_lags(SimpleNamespace(period=period, duration=rows * period))
    assert len(lags) == expected
    assert lags[0] == pytest.approx(0.5 * period) and lags[-1] <= max(15 * period, 0.1 * rows * period)
    assert max(after / before for before, after in pairwise(lags)) <= 10 * (1 + 1e-12)


def test_start_values_stay_within_the_bounds():
    sizes = {p["size"] for p in starting_points(shaped_effect([1.0]), fitted(PLAIN), amplitudes=(100.0,))}
    assert sizes == {0.5}


def test_an_effect_without_a_shape_has_one():
    assert count_shapes(toy_effect("a"), None) == 1


def test_a_child_starts_from_its_fitted_parent():
    parent, child = toy_effect("parent"), toy_effect("child", "parent")
    at_parent = fitted(PLAIN + parent, parent_size=0.3, B=0.7)
    model = PLAIN + child
    (point,) = generate_child_starting_points(model, child, at_parent, parent, None)
    assert point["child_size"] == 1.0
    assert point["B"] == pytest.approx(0.7)
    assert "parent_size" not in point


def test_an_effect_that_knows_no_parent_starts_from_none():
    parent, orphan = toy_effect("parent"), shaped_effect([1.0])
    at_parent = fitted(PLAIN + parent, parent_size=0.3)
    assert list(generate_child_starting_points(PLAIN + orphan, orphan, at_parent, parent, None)) == []
