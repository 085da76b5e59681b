"""Effects stated as one line of text."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Model, Output, Parameter, State
from greybox.base.errors import ModelError, UnitError
from greybox.model.effect import formula_effect


def decay() -> Model:
    return Model(
        "decay",
        states=[State("x", "m", 1.0)],
        inputs=[],
        outputs=[Output("x", "m")],
        parameters=[Parameter("a", "1/s", 0.5)],
        balances=lambda x, u, p: [Balance("level", "m/s", 1, "x", leaving=-p.a * x.x)],
    )


def final(model: Model) -> float:
    time = np.linspace(0, 1, 101)
    return float(gb.simulate(model, Experiment("run", time, {}, {})).outputs["x"][-1])


def test_a_formula_acts_as_it_reads():
    model = decay() + formula_effect("crowding", "level", "k*x**2", [Parameter("k", "1/(m*s)", -0.8)])
    # dx/dt = -a x - b x^2 has the solution a x0 e / (a + b x0 (1 - e)), e = exp(-a t).
    e = np.exp(-0.5)
    assert final(model) == pytest.approx(0.5 * e / (0.5 + 0.8 * (1 - e)), rel=1e-6)


def test_a_formula_with_memory_passes_through_a_lag():
    constants = [Parameter("k", "1/s", -1.0), Parameter("T", "s", 1e-3, (1e-5, 1))]
    fast = decay() + formula_effect("late", "level", "k*x", constants, lag_unit="m")
    assert final(fast) == pytest.approx(np.exp(-1.5), rel=5e-3)
    slow = decay() + formula_effect("late", "level", "k*x", [constants[0], Parameter("T", "s", 1.0)], lag_unit="m")
    assert final(slow) > 1.2 * final(fast)


def test_units_and_names_are_checked():
    with pytest.raises(UnitError):
        decay() + formula_effect("crowding", "level", "k*x**2", [Parameter("k", "1/s", -0.8)])
    with pytest.raises(ModelError, match="multiply"):
        formula_effect("crowding", "level", "q*x", [Parameter("q", "1/s", -0.8)])
    with pytest.raises(ModelError, match="not a formula"):
        formula_effect("crowding", "level", "k*x*", [Parameter("k", "1/s", -0.8)])
