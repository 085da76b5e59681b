"""Signals without meaning in the place of an effect: how they are drawn, screened and weighed, and what follows."""

from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

import greybox as gb
from greybox.base.errors import FitError
from greybox.discovery import false_names
from greybox.discovery.claims import Depth
from greybox.discovery.execution import SearchStage
from greybox.discovery.false_names import FalseNameRate, list_nonsense_sites
from greybox.discovery.linear import promise_decrease
from greybox.discovery.pipeline import discover
from greybox.discovery.table import RIDGE
from models.micro_actuator import micro_actuator
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records

NOISE = {"x": 2e-7, "i": 5e-3}


def rate_of(established, tried=20):
    return FalseNameRate("cubic_stiffness", Depth.NAME, tried, established, 2)


@pytest.mark.parametrize(("established", "tried"), [(0, 11), (3, 20), (5, 7)])
def test_the_bound_is_the_rate_at_which_so_few_are_still_seen_once_in_twenty(established, tried):
    assert binom.cdf(established, tried, rate_of(established, tried).upper) == pytest.approx(0.05)


def test_where_all_are_established_nothing_bounds_the_rate():
    assert rate_of(20).upper == 1.0 and rate_of(20).rate == 1.0


def test_nonsense_is_common_where_it_is_established_more_often_than_a_claim_may_be_wrong():
    assert [rate_of(k).is_common for k in (0, 5, 6)] == [False, False, True]


def test_nonsense_speaks_against_the_site_where_it_is_common():
    model = plain_model(micro_actuator) + gb.effect("cubic_stiffness")
    assert list_nonsense_sites([rate_of(6)], model) == {"balance force"}
    assert list_nonsense_sites([rate_of(5)], model) == frozenset()


def signal_of(values):
    time = 0.01 * np.arange(len(values))
    return SimpleNamespace(time=time, value=values, modelled=values)


@pytest.fixture
def motion():
    t = np.arange(400)
    values = np.convolve(np.random.default_rng(1).standard_normal(len(t) + 40), np.hanning(40), "valid")[: len(t)]
    return signal_of(5.0 + values)


def test_a_signal_without_meaning_keeps_its_size_and_forgets_its_course(motion):
    drawn = false_names._draw_signals(motion, motion.time, 12, np.random.default_rng(3))
    own = motion.value - motion.value.mean()
    assert drawn.std(axis=0) == pytest.approx(own.std(), rel=0.02)
    assert np.abs(np.corrcoef(own, drawn.T)[0, 1:]).max() < 0.55
    # The whole spectrum, shifted or of random phase; between the samples lines lose a little.
    spectrum = np.abs(np.fft.rfft(own))[:10]
    for k in (0, 1, 2, 3):
        assert np.abs(np.fft.rfft(drawn[:, k]))[:10] == pytest.approx(spectrum, abs=0.05 * spectrum.max())
    again = false_names._draw_signals(motion, motion.time, 12, np.random.default_rng(3))
    assert np.array_equal(drawn, again)


def test_a_constant_has_no_meaning_to_lose(motion):
    assert false_names._varies(motion)
    assert not false_names._varies(signal_of(5.0 + 0.01 * motion.value))


def test_the_promise_of_a_signal_is_that_of_least_squares():
    rng = np.random.default_rng(5)
    jacobian, residual, signals = rng.standard_normal((60, 1, 3)), rng.standard_normal((60, 1)), rng.random((60, 1, 4))
    slopes = SimpleNamespace(
        candidate=SimpleNamespace(variables=SimpleNamespace(size=3)),
        fitted=1,
        columns=lambda e: np.arange(3),
        present=[np.ones((60, 1), bool)],
        jacobians=[jacobian],
        residuals=[residual],
    )

    def least(columns):
        full = np.vstack([columns, np.sqrt(RIDGE) * np.eye(columns.shape[1])])
        wanted = np.append(residual[:, 0], np.zeros(columns.shape[1]))
        return np.sum((wanted - full @ np.linalg.lstsq(full, wanted, rcond=None)[0]) ** 2)

    plain = least(jacobian[:, 0])
    expected = [plain - least(np.column_stack([jacobian[:, 0], signals[:, 0, k]])) for k in range(4)]
    assert promise_decrease(slopes, [signals]).decrease == pytest.approx(expected, rel=1e-9)


def test_a_signal_that_would_leave_too_much_is_not_refitted(monkeypatch):
    """Of a cost of 1000 with an answer of 10: less than 5 times the rms error of that, where three quarters are taken."""
    asked = []
    starts = [false_names._Start([], share) for share in (0.04, 0.7, 0.76, 0.9)]
    monkeypatch.setattr(false_names, "_screen", lambda *_: starts)
    monkeypatch.setattr(
        false_names, "_refit", lambda scores, rest, site, hopeful: asked.extend(hopeful) or (None, None)
    )
    table = SimpleNamespace(slopes=lambda rest: (), scores=None)
    signal = SimpleNamespace(site="balance force", effect="cubic_stiffness")
    for cost, expected in ((10.0, starts[2:]), (100.0, starts[1:])):
        named = SimpleNamespace(cost=cost, model=micro_actuator + gb.effect("cubic_stiffness"))
        contests = SimpleNamespace(table=table, tried=3, answer=named, candidates=())
        rest = SimpleNamespace(model=micro_actuator, cost=1000.0)
        assert false_names._hold_contests(contests, rest, signal, Depth.NAME, 0) is None
        assert asked == expected
        asked.clear()


@pytest.fixture(scope="module")
def rig():
    return simulate_records(micro_actuator, {"cubic_stiffness": {"K3": 1e10}}, tuple(NOISE.values()), rows=300)


def answer(rig):
    among = [gb.effect(name) for name in ("cubic_stiffness", "input_offset", "quadratic_damping")]
    plain = plain_model(micro_actuator)
    return discover(plain, rig[0], validation=rig[1], noise=NOISE, options=AT_REST, effects=among, workers=1)


@pytest.mark.rest
def test_nonsense_is_not_established_where_a_spring_hardens(rig):
    found = answer(rig)
    (rate,) = found.false_names
    assert (rate.effect, rate.tried, rate.among, rate.established) == ("cubic_stiffness", 11, 3, 0)
    assert [e["grade"] for e in found.effects] == ["established"]


@pytest.mark.slow
def test_one_win_leaves_the_rate_open_and_more_contests_are_held(rig, monkeypatch):
    held = iter([0.5 * (f + np.append(f[1:], f[-1])) for f in (1e10 * record.outputs["x"] ** 3 for record in rig)])
    draw_signals = false_names._draw_signals

    def draw(*given):
        drawn = draw_signals(*given)
        # In the first contest one of the signals is the effect itself.
        drawn[:, 0] = next(held, drawn[:, 0])
        return drawn

    monkeypatch.setattr(false_names, "_draw_signals", draw)
    (rate,) = answer(rig).false_names
    assert (rate.tried, rate.established, rate.is_common) == (20, 1, False)


@pytest.mark.rest
def test_the_signal_of_the_effect_itself_is_established_and_takes_its_name_the_certainty(rig, monkeypatch):
    """The control: what adds x^3 to the force does what the spring does, under a name of no meaning."""
    cubes = [1e10 * record.outputs["x"] ** 3 for record in rig]
    # An input is held between samples: the mean of both ends is as late as the force itself.
    held = cycle([(0.5 * (f + np.append(f[1:], f[-1])))[:, None] for f in cubes])
    monkeypatch.setattr(false_names, "_draw_signals", lambda *_: next(held))
    found = answer(rig)
    (rate,) = found.false_names
    assert rate.established == rate.tried
    assert [e["grade"] for e in found.effects] == ["probable"]
    assert found.verdict != "named"


@pytest.mark.slow
def test_contests_that_fail_leave_the_answer_as_it_is(rig, monkeypatch):
    def fail(*_):
        raise FitError("on purpose")

    monkeypatch.setattr(false_names, "linearise_run", fail)
    found = answer(rig)
    assert not found.false_names and found.verdict == "named"
    assert (SearchStage.FALSE_NAMES, "on purpose") in {(f.stage, f.reason) for f in found.failures}


@pytest.mark.parametrize(("slope", "expected"), [(1e20, 2.0), (np.inf, 0.0)], ids=["steep", "astray"])
def test_a_steep_run_promises_what_its_other_unknowns_leave(slope, expected):
    """Two unknowns that do the same, however steep; by hand: (g'r)^2 / (g'g + 1) with g = (0, 1) and r = (0, 2)."""
    slopes = SimpleNamespace(
        candidate=SimpleNamespace(variables=SimpleNamespace(size=2)),
        fitted=1,
        columns=lambda record: np.arange(2),
        present=[np.ones((2, 1), bool)],
        jacobians=[np.array([[[slope, slope]], [[0.0, 0.0]]])],
        residuals=[np.array([[0.0], [2.0]])],
    )
    with np.errstate(invalid="ignore", over="ignore"):
        (found,) = promise_decrease(slopes, [np.array([[[0.0]], [[1.0]]])]).decrease
    assert found == pytest.approx(expected)
