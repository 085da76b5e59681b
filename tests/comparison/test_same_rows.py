"""Every model of a comparison is judged on the same rows, whatever history it needs and wherever the record has gaps."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State

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
