"""Tables whose first reading lies after time zero: a start that the model states holds in their first row, and is said to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import curve_fit

import greybox as gb
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.estimation.findings import EstimationCode
from greybox.estimation.validate import validate

AT_REST = gb.FitOptions(at_rest=True)


def decay(start) -> Model:
    return Model(
        "decay",
        states=[State("c", "mol/l", start)],
        inputs=[],
        outputs=[Output("c", "mol/l")],
        parameters=[Parameter("k", "1/s", 0.3, (1e-3, 1e2)), Parameter("c0", "mol/l", 3.0, (1e-3, 1e2))],
        balances=lambda x, u, p: [Balance("amount", "mol/l/s", 1, "c", reaction=-p.k * x.c)],
    )


def table(first: float, with_zero: bool = False, clock: float = 0.0) -> Experiment:
    time = np.arange(first, 12.0)
    c = 5.0 * np.exp(-0.4 * time) * (1 + 0.01 * np.random.default_rng(3).normal(size=len(time)))
    if with_zero:
        time, c = np.append(0.0, time), np.append(np.nan, c)
    return Experiment("table", clock + time, {}, {"c": c})


def find(fit: gb.Fit) -> list:
    return [f for f in fit.findings if f.code is EstimationCode.START_IN_FIRST_ROW]


@pytest.mark.parametrize("first", [0.5, 1.0, 2.0])
def test_a_start_of_a_table_that_begins_later_is_that_of_its_first_row(first: float) -> None:
    late, whole = (gb.fit(decay(lambda p: p.c0), table(first, zero), options=AT_REST) for zero in (False, True))
    (finding,) = find(late)
    assert finding.values["time"] == first and not find(whole)
    # SciPy has the curve from time zero; the fit without a row there has it from the first row.
    record = table(first)
    (c0, k), _ = curve_fit(lambda t, a, b: a * np.exp(-b * t), record.time, record.outputs["c"], (4.0, 0.3))
    assert whole.parameters["c0"].value == pytest.approx(c0, rel=1e-4)
    assert late.parameters["c0"].value == pytest.approx(c0 * np.exp(-k * first), rel=1e-4)


def test_nothing_is_said_where_the_start_is_free_zero_or_the_clock_ran_on() -> None:
    assert not find(gb.fit(decay(5.0).fix("c0"), table(1.0)))
    assert not find(gb.fit(decay(lambda p: p.c0), table(0.0), options=AT_REST))
    assert not find(gb.fit(decay(lambda p: p.c0), table(0.0, clock=300.0), options=AT_REST))


def test_an_unstable_model_runs_freely_over_other_records_where_single_shooting_is_asked_for():
    """x' = a x with a 5 % too large: from its first rows the run is off by a factor of exp(0.05 t); segments meet the whole record."""
    growth = Model(
        "growth",
        [State("x", "m", 1.0)],
        [],
        [Output("x", "m")],
        [Parameter("a", "1/s", 1.05)],
        lambda x, u, p: [Balance("rate", "m/s", 1, "x", growth=p.a * x.x)],
    )
    time = np.linspace(0, 12, 601)
    record = Experiment("truth", time, {}, {"x": np.exp(time)})
    automatic, free = (
        validate(growth, record, noise={"x": 1.0}, initial_rows=50, options=gb.FitOptions(transcription=each))
        for each in ("automatic", "single")
    )
    assert free.traces[0].simulated["x"][-1] / np.exp(12) == pytest.approx(np.exp(0.05 * 12), rel=0.05)
    assert automatic.misfit["x"].rmse < free.misfit["x"].rmse / 2
