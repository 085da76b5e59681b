"""Every model of a comparison is judged on the same rows, whatever history it needs and wherever the record has gaps."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.estimation.score import score

LAG = Model(
    "lag",
    states=[State("x", "1")],
    inputs=[Input("u", "1")],
    outputs=[Output("x", "1")],
    parameters=[Parameter("tau", "s", 0.5, (0.01, 10.0))],
    balances=lambda x, u, p: [Balance("lag", "1", p.tau, "x", drive=u.u, decay=-x.x)],
)


def record(seed: int) -> Experiment:
    rng = np.random.default_rng(seed)
    time, u = 0.02 * np.arange(300), np.repeat(rng.uniform(-1, 1, 15), 20)
    x = gb.simulate(LAG, {"time": time, "u": u}).outputs["x"] + 0.01 * rng.standard_normal(300)
    x[100:110] = np.nan
    return Experiment(f"run{seed}", time, {"u": u}, {"x": x})


@pytest.mark.parametrize(("skip", "beginning", "judged"), [(0, 0, 290), (30, 0, 260), (0, 20, 270)])
def test_all_models_are_judged_on_the_same_rows(skip: int, beginning: int, judged: int) -> None:
    train, test = record(1), record(2)
    arx = gb.blackbox.arx(train, na=4, nb=4, output="x")
    error = gb.blackbox.output_error(train, nb=1, nf=1, output="x")
    models = [gb.fit(LAG, train, noise={"x": 0.01}), arx, error]
    comparison = gb.compare(models, test, training=train, skip=skip, beginning=beginning)
    assert {e.validation["x"].samples for e in comparison.entries} == {judged}
    assert {e.training["x"].samples for e in comparison.entries} == {290}


@pytest.mark.parametrize("steps", [1, 7])
def test_a_prediction_counts_the_rows_that_have_a_measurement_to_go_by(steps: int) -> None:
    """`compare` and `score` have one error for the same prediction: that of the rows behind the first ``steps``."""
    train, test = record(1), record(2)
    result = gb.fit(LAG, train, noise={"x": 0.01}, options=gb.FitOptions(at_rest=True))
    arx = gb.blackbox.arx(train, na=4, nb=4, output="x")
    comparison = gb.compare({"lag": result, "arx": arx}, test, training=train, steps=[steps])
    scored = score(result, test, steps=[steps]).outputs["x"].ahead[steps]
    assert comparison["lag"].validation["x"].ahead[steps] == pytest.approx(scored, rel=1e-9)
    ahead = comparison["arx"].validation_runs[0].ahead[steps]
    assert np.isnan(ahead[:steps]).all() and np.isfinite(ahead[steps:]).all()
    error = (ahead - test.outputs["x"])[steps:]
    expected = np.sqrt(np.nanmean(error**2))
    assert comparison["arx"].validation["x"].ahead[steps] == pytest.approx(expected, rel=1e-12)
