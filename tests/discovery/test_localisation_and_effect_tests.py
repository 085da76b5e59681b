"""The steps of a discovery by hand: look, try an effect, keep or drop it. The rig is simulated without greybox."""

import re

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.curve_shape import classify_shape
from greybox.discovery.dependence import rank_dependences
from greybox.discovery.effect_test import finish_and_validate
from greybox.discovery.execution import RefitOutcome
from greybox.discovery.misfit_windows import divide_misfit
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation import FitOptions
from models.micro_actuator import micro_actuator
from tests.discovery.test_discover import off, records
from tests.estimation.test_fit import SQUARED, decaying

NOISE = (2e-7, 5e-3)
GIVEN = {"x": 2e-7, "i": 5e-3}


def fitted(effects):
    train, test = records(micro_actuator, effects, NOISE, rows=1200)
    return gb.fit(off(micro_actuator), train, noise=GIVEN, options=FitOptions(at_rest=True)), test


@pytest.fixture(scope="module")
def friction():
    return fitted({"coulomb_friction": {"Fc": 0.05}})


def test_the_look_says_where_when_and_as_a_function_of_what(friction):
    fit, _ = friction
    look = gb.discovery.localise_residual(fit)
    assert look.missing
    assert look.where[0] == "balance force"
    assert look.dependences[0].variable == "v"
    assert look.dependences[0].parity == "odd"
    assert sum(w.share for w in look.windows) == pytest.approx(1)
    # the dry friction that was put in has 0.05 N throughout; what a viscous damper could do of it is fitted already
    assert 0.01 < look.sites[0].size < 0.05
    assert "balance force" in str(look)
    # the drive and the voltage balance are one way in: no sensor can ever tell them apart
    gains = {str(s): s.gain for s in look.sites}
    assert gains["input u"] == pytest.approx(gains["balance voltage"])


def test_an_effect_is_tried_kept_and_missed_when_dropped(friction):
    fit, test = friction
    attempt = gb.discovery.try_effect(fit, "coulomb_friction", validation=test, nominal=off(micro_actuator))
    assert attempt.is_needed
    assert attempt.larger.parameters["Fc"].value == pytest.approx(0.05, rel=0.02)
    assert attempt.gap["x"].explained_fraction > 0.95
    assert not gb.discovery.localise_residual(attempt.larger).missing
    assert attempt.model is attempt.larger.model
    again = gb.discovery.drop_effect(attempt.larger, "coulomb_friction")
    assert again.is_needed
    assert again.smaller.misfit["x"].rmse == pytest.approx(fit.misfit["x"].rmse, rel=0.05)


def test_an_effect_that_is_not_there_is_not_kept():
    fit, test = fitted({})
    look = gb.discovery.localise_residual(fit)
    assert not look.missing and "nothing is missing" in str(look)
    attempt = gb.discovery.try_effect(fit, "cubic_stiffness", validation=test)
    assert not attempt.is_needed
    assert attempt.model is fit.model or attempt.model.effects == ()
    assert "leave it out" in str(attempt)


@pytest.mark.parametrize(
    ("curve", "parity", "words"),
    [
        (lambda z: np.sign(z), "odd", "step"),
        (lambda z: 3 * z**2, "even", "square"),
        (lambda z: 5 * z**3, "odd", "faster"),
        (lambda z: 4 * np.sign(z) * np.maximum(np.abs(z) - 0.6, 0), "odd", "flat middle (to about 0.6 m)"),
        (lambda z: 3 * np.maximum(z - 0.5, 0), "neither", "a bend at 0.5 m"),
        (lambda z: -np.sqrt(np.abs(z)), "even", "kink at zero"),
        (lambda z: np.cos(2 * np.pi * z / 0.31), "neither", "periodic, every 0.31 m"),
    ],
)
def test_a_shape_is_told_by_its_variable(curve, parity, words):
    rng = np.random.default_rng(1)
    t = np.arange(1500) * 2e-3
    z = np.cumsum(rng.normal(size=t.size))
    z = z - np.linspace(z[0], z[-1], t.size)
    z = np.sin(37 * t) * (1 + 0.3 * np.sin(5 * t)) + 0.05 * z / np.abs(z).max()
    w = curve(z) + 0.1 * rng.normal(size=t.size)
    best = rank_dependences(t, w, {"other": (rng.normal(size=t.size), "V"), "z": (z, "m")})[0]
    assert (best.variable, best.parity) == ("z", parity)
    told, wanted = (re.split(r"([\d.]+)", text) for text in (best.shape, words))
    assert "".join(wanted[::2]) in "".join(told[::2])
    assert [float(v) for v in told[1::2]] == pytest.approx([float(v) for v in wanted[1::2]], rel=0.05)
    assert (best.period is not None) == ("periodic" in words)


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (lambda z: z**2, "curving upwards"),
        (lambda z: -(z**2), "curving downwards"),
        (lambda z: np.maximum(z - 4, 0), "a bend at 4.1"),
    ],
)
def test_a_curve_on_one_side_of_zero_is_told_by_its_bend(curve, words):
    z = np.linspace(0, 10, 30)
    assert words in classify_shape(z, curve(z), np.ones(30), "V")[1]


def test_a_tone_that_the_input_does_not_have_is_told_by_its_frequency():
    rng = np.random.default_rng(2)
    t = np.arange(4000) * 2.5e-4
    w = np.sin(2 * np.pi * 50 * t) + 0.3 * rng.normal(size=t.size)
    best = rank_dependences(t, w, {"x": (rng.normal(size=t.size), "m")})[0]
    assert best.tone == pytest.approx(50, abs=0.5)


def test_windows_share_out_the_misfit():
    r = np.ones((1000, 1))
    r[200:300] = 10.0
    found = divide_misfit(["a"], [np.arange(1000) * 0.01], [r])
    assert sum(w.share for w in found if 1.99 < w.start < 3) == pytest.approx(1, abs=0.01)


def test_a_trial_is_judged_from_the_initial_states_it_ended_with():
    """A sign that the record cannot show: the fit stays on the side that the trial is on, and the declared start is not."""
    records = decaying(2.0)
    bench = DiscoveryProblem(SQUARED, tuple(records), {"y": 1e-3}, (), FitOptions())
    trial = bench.placed(SQUARED, RefitOutcome({"k": 2.9}, ((-1.9,),)))
    found = finish_and_validate(trial, bench, ())
    assert found.traces[0].initial_state["x"] == pytest.approx(-2.0, rel=1e-6)
    assert found.parameters["k"].value == pytest.approx(3.0, rel=1e-6)
    assert finish_and_validate(bench.base, bench, ()).traces[0].initial_state["x"] == pytest.approx(2.0, rel=1e-6)
