"""Level and colour of the noise, and structure left in a residual, from residuals that are given, but for the last."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.data.noise.noise_model import AutoRegression, BoundDirection, NoiseBound, NoiseModel, NoiseSource
from greybox.discovery import residual_noise
from greybox.discovery.decision import EXCESS_AUTOCORRELATION
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.residual_noise import (
    RESIDUAL_NOISE_LONGEST_CORRELATION,
    estimate_residual_noise,
    excess_autocorrelation,
)
from greybox.estimation.options import EstimationPolicy
from tests.support.stage import STAGE

WHITE = AutoRegression()
RNG = np.random.default_rng(1)


def noise(source=NoiseSource.DIFFERENCES, std=1.0, colour=WHITE):
    return NoiseModel(("x",), np.array([std]), {"x": source}, (colour,), False)


def coloured(rows=4000, correlation=0.8):
    e = RNG.normal(size=rows)
    for k in range(1, rows):
        e[k] = correlation * e[k - 1] + np.sqrt(1 - correlation**2) * e[k]
    return e


@pytest.fixture
def with_residual(monkeypatch):
    def make(series, model=None):
        monkeypatch.setattr(residual_noise, "_normalised_residuals", lambda candidate: [(0, np.asarray(series))])
        outputs = [SimpleNamespace(name="x")]
        problem = SimpleNamespace(
            noise=model or noise(), model=SimpleNamespace(outputs=outputs), policy=EstimationPolicy(), experiments=()
        )
        return SimpleNamespace(problem=problem)

    return make


def test_a_coloured_residual_gives_its_colour_and_never_a_level_above_the_bound(with_residual):
    estimated = estimate_residual_noise(with_residual(3.0 * coloured()))
    assert estimated.std[0] == 1.0
    assert estimated.colour[0].reflection[0] == pytest.approx(0.8, abs=0.05)
    quieter = estimate_residual_noise(with_residual(0.3 * coloured()))
    assert quieter.std[0] == pytest.approx(0.3, rel=0.1)


def test_a_known_level_and_colour_stay(with_residual):
    flat = NoiseBound(1.0, BoundDirection.ABOUT, NoiseSource.FLAT_PIECES, 0.0)
    model = replace(noise(NoiseSource.FLAT_PIECES), bounds={"x": flat})
    estimated = estimate_residual_noise(with_residual(0.3 * coloured(), model))
    assert estimated.std[0] == 1.0 and estimated.colour[0].order == 0


def test_a_residual_remembers_no_longer_than_a_sensor(with_residual):
    estimated = estimate_residual_noise(with_residual(coloured(correlation=0.999)))
    assert estimated.colour[0].reflection[0] == RESIDUAL_NOISE_LONGEST_CORRELATION


def test_a_white_residual_gives_no_colour(with_residual):
    estimated = estimate_residual_noise(with_residual(RNG.normal(size=4000)))
    assert estimated.colour[0].order == 0


def test_a_level_that_was_given_stays(with_residual):
    estimated = estimate_residual_noise(with_residual(3.0 * coloured(), noise(NoiseSource.GIVEN)))
    assert estimated.std[0] == 1.0
    assert estimated.colour[0].order == 1


def test_noise_leaves_no_autocorrelation_and_structure_does(with_residual):
    assert excess_autocorrelation(with_residual(RNG.normal(size=4000)), 30) < 0.02
    sinusoid = RNG.normal(size=4000) + np.sin(0.3 * np.arange(4000))
    assert excess_autocorrelation(with_residual(sinusoid), 30) > 0.5
    assert excess_autocorrelation(with_residual(coloured()), 30) > 0.5


def test_the_colour_of_the_noise_is_no_structure(with_residual):
    model = noise(colour=AutoRegression((0.8,)))
    assert excess_autocorrelation(with_residual(coloured(), model), 30) < 0.02


def test_what_correlates_is_no_structure_where_the_steps_of_the_reading_are_all_that_is_left():
    """The error of an encoder goes on while its reading stays: of a slow motion it is no white noise, and no model does better."""
    step = 0.012
    model = (STAGE + gb.effect("coulomb_friction")).start(Fc=1.0)
    time, rng = 5e-3 * np.arange(600), np.random.default_rng(3)
    force = np.repeat(rng.normal(0, 6, 30), 20)
    motion = gb.simulate(model, {"time": time, "F": force}).outputs["x"]

    def measure(reading):
        record = gb.Experiment("run", time, {"F": force}, {"x": reading})
        problem = DiscoveryProblem(model, (record,), {"x": step / np.sqrt(12)}, (), gb.FitOptions(at_rest=True))
        return excess_autocorrelation(problem.baseline, 30)

    assert measure(step * np.round(motion / step)) == 0.0
    # The same error beside as much again that the steps do not explain is structure.
    slow = 0.6 * step * np.sin(2 * np.pi * time / 0.7)
    assert measure(step * np.round((motion + slow) / step)) > EXCESS_AUTOCORRELATION
