"""A free run that drifts because a constant is uncertain is no model error; one that another term would need is."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.holdout import HoldoutScores, ValidationSet, _hold_constants
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation.optim.quadratic_model import QuadraticModel

PERIOD, NOISE = 0.01, 0.01
AT_REST = gb.FitOptions(at_rest=True)


def integrator() -> gb.Model:
    """``dx/dt = k u``: an error of ``k`` grows with the record."""
    return gb.Model(
        "integrator",
        states=[gb.State("x", "m")],
        inputs=[gb.Input("u", "V")],
        outputs=[gb.Output("x", "m")],
        parameters=[gb.Parameter("k", "m/(s*V)", 1.0)],
        balances=lambda x, u, p: [gb.Balance("x", "m/s", 1, "x", drive=p.k * u.u)],
    )


def make_record(rows: int, seed: int, quadratic: float = 0.0) -> gb.Experiment:
    """The exact response to an input that is held and mostly positive, with white noise."""
    rng = np.random.default_rng(seed)
    u = 1 + 0.3 * rng.standard_normal(rows)
    x = np.concatenate([[0.0], np.cumsum((u + quadratic * u**2)[:-1])]) * PERIOD
    return gb.Experiment(
        f"record {seed}", np.arange(rows) * PERIOD, {"u": u}, {"x": x + NOISE * rng.standard_normal(rows)}
    )


def scores_of(estimation: gb.Experiment, validation: gb.Experiment) -> HoldoutScores:
    problem = DiscoveryProblem(integrator(), (estimation,), {"x": NOISE}, (), AT_REST)
    return HoldoutScores(problem, ValidationSet((validation,)))


def adapted_square(scores: HoldoutScores) -> float:
    """Mean square error of the plain model's adapted run, what the adaptation costs included."""
    run = scores.adapt(scores.problem.baseline)
    return float(np.mean(np.concatenate(run.residuals["x"]) ** 2)) + scores.charge(run)["x"]


def test_the_drift_of_an_uncertain_constant_goes():
    scores = scores_of(make_record(40, 1), make_record(4000, 2))
    baseline = scores.problem.baseline
    free_run = scores.run(baseline).misfit["x"].rmse
    assert free_run > 3 * NOISE  # the standard deviation of k is about one per cent: 0.4 m at the end
    adapted = scores.adapt(baseline)
    assert np.std(np.concatenate(adapted.residuals["x"])) == pytest.approx(NOISE, rel=0.05)
    assert 0 < adapted.rise < 10  # a few standard deviations of one constant
    left = free_run**2 - scores.measure_drift(baseline)["x"]
    assert left == pytest.approx(NOISE**2, rel=0.1)


def test_what_no_constant_explains_stays():
    scores = scores_of(make_record(2000, 3), make_record(2000, 4, quadratic=0.05))
    baseline = scores.problem.baseline
    free_run = scores.run(baseline).misfit["x"].rmse
    assert free_run > 10 * NOISE
    assert scores.measure_drift(baseline)["x"] < 0.5 * free_run**2
    assert np.sqrt(adapted_square(scores)) > 5 * NOISE


def test_adapting_never_makes_a_run_worse():
    scores = scores_of(make_record(400, 5), make_record(400, 6))
    baseline = scores.problem.baseline
    assert adapted_square(scores) <= scores.run(baseline).misfit["x"].rmse ** 2 * (1 + 1e-9)


def test_a_step_after_which_the_model_fails_is_not_taken(monkeypatch):
    """Its residuals are no numbers, like those of samples that nobody measured: they must not count as such."""
    monkeypatch.setattr(QuadraticModel, "bounded_step", lambda self, *_: np.full(len(self.gradient), np.nan))
    scores = scores_of(make_record(400, 5), make_record(400, 6))
    baseline = scores.problem.baseline
    (adapted,), (trace,) = scores.adapt(baseline).residuals["x"], scores.run(baseline).traces
    assert np.array_equal(adapted, trace.residual("x")[scores.validation.uncounted :]) and len(adapted)


def test_a_constant_that_the_estimation_records_leave_open_is_held_to_its_own_size():
    """A second input that stood still: nothing is known of its gain, and a linear step is worth nothing beyond its own size."""
    model = gb.Model(
        "two_inputs",
        states=[gb.State("x", "m")],
        inputs=[gb.Input("u", "V"), gb.Input("v", "V")],
        outputs=[gb.Output("x", "m")],
        parameters=[gb.Parameter("k", "m/(s*V)", 1.0), gb.Parameter("c", "m/(s*V)", 1e-3, (1e-9, 1e9))],
        balances=lambda x, u, p: [gb.Balance("x", "m/s", 1, "x", drive=p.k * u.u, other=p.c * u.v)],
    )
    run = make_record(400, 7)
    record = gb.Experiment("a", run.time, {"u": run.inputs["u"], "v": np.zeros(400)}, run.outputs)
    candidate = DiscoveryProblem(model, (record,), {"x": NOISE}, (), AT_REST).baseline
    held = _hold_constants(candidate, candidate.variables)
    assert held[1, 1] == pytest.approx(1.0) and held[0, 0] > 1e3
