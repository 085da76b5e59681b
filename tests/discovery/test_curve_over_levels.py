"""A curve over a variable of which a few levels were seen has so many heights, and says nothing between them."""

from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.base.figure import Curve
from greybox.discovery.curve_shape import find_levels, find_period_of_curve
from greybox.discovery.disturbance_sites import DisturbanceSite, SiteKind
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.proposers import CURVE_INTERVALS
from greybox.discovery.surrogate_effects import evaluate_curve, make_curve_effect
from greybox.show.figures.discovery import plot_surrogate
from tests.support.first_order import first_order
from tests.support.stand_in import find_stand_in

LEVELS = np.array([-1.0, -0.2, 0.4, 1.0])


@pytest.mark.parametrize(
    ("spread", "count"),
    [
        (0.0, 4),
        (1e-3, 4),  # resolution and noise are no levels
        (0.5, 200),  # it goes everywhere
    ],
)
def test_levels_are_apart_by_more_than_the_resolution(spread, count):
    rng = np.random.default_rng(0)
    levels = find_levels(rng.choice(LEVELS, 5000) + rng.uniform(-spread, spread, 5000))
    assert len(levels) == pytest.approx(count, rel=0.1)
    if count == 4:
        assert levels == pytest.approx(LEVELS, abs=1e-3)


def test_a_few_levels_show_no_period():
    z = np.tile(LEVELS, 50)
    sinusoid, with_line, _ = find_period_of_curve(z, z**2)
    assert sinusoid == with_line == 0.0


@pytest.mark.parametrize(("levels", "heights"), [(3, 3), (CURVE_INTERVALS, CURVE_INTERVALS), (60, 21)])
def test_a_curve_has_no_more_heights_than_levels_were_seen(levels, heights):
    z = np.tile(np.linspace(-1, 1, levels), 20)
    site = DisturbanceSite("u", SiteKind.INPUT, "V", 0)
    dependence = SimpleNamespace(variable="u", unit="V", shape=SimpleNamespace(parity=SimpleNamespace(value="neither")))
    effect = make_curve_effect(site, dependence, z, np.tanh(3 * z), np.full(len(z), 1e-3), CURVE_INTERVALS)
    start = effect.probe(None)
    assert len(start) == heights
    assert sum(not q.fixed for q in effect.parameters) == heights  # each is a constant that is paid for
    values = {q.name: q.value for q in effect.parameters} | start
    assert evaluate_curve(values, z) == pytest.approx(np.tanh(3 * z), abs=2e-3)


def drive(u):
    return 2 * np.tanh(1.5 * u) + 0.4 * u**2


def stepped_record(name, seed, levels):
    """A lag behind a curved drive that is stepped between levels: its exact answer, and sensor noise."""
    rng = np.random.default_rng(seed)
    step, u = 0.1, np.repeat(rng.choice(levels, 40), 15)
    y, pole = np.zeros(len(u)), np.exp(-step / 0.5)
    for k in range(len(u) - 1):
        y[k + 1] = pole * y[k] + (1 - pole) * drive(u[k])
    return gb.Experiment(name, np.arange(len(u)) * step, {"u": u}, {"y": y + 0.01 * rng.normal(size=len(u))})


def surrogate_over(levels):
    train, test = stepped_record("train", 1, levels), stepped_record("test", 2, levels)
    model, noise = first_order().start(gain=1.5, lag=0.7), {"y": 0.01}
    return find_stand_in(DiscoveryProblem(model, (train,), noise, (), gb.FitOptions()), test)


@pytest.mark.rest
def test_the_curve_of_an_input_of_four_levels_is_known_at_these():
    surrogate = surrogate_over(LEVELS)
    assert surrogate.variable == "u" and surrogate.levels == 4
    assert surrogate.values == pytest.approx(LEVELS)
    names = surrogate.fit.model.names_of("fitted_curve").values()
    assert sum(not surrogate.fit.model.parameter(n).fixed for n in names) == 4
    # What is constant or proportional is shared with the gain, which no data decide; the rest is that of the true drive.
    assert surrogate.site == "input u"
    rest = drive(LEVELS) - surrogate.fit.parameters["gain"].value * surrogate.curve
    assert rest == pytest.approx(np.polyval(np.polyfit(LEVELS, rest, 1), LEVELS), abs=0.02)
    assert "a curve of 4 levels over u (too few values to tell its shape)" in str(surrogate)
    (panel,) = plot_surrogate(surrogate).panels
    assert not any(isinstance(series, Curve) for series in panel.series)


@pytest.mark.rest
def test_over_two_levels_there_is_no_curve():
    """Any function of two levels is a straight line, which the gain and an offset are."""
    surrogate = surrogate_over(np.array([-0.5, 1.0]))
    assert surrogate is None or surrogate.variable != "u"
