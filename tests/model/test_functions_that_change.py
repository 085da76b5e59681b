"""Functions of a model state one set of equations: those that give another one when asked again are refused."""

import itertools
import time

import casadi as ca
import numpy as np
import pytest

from greybox import Balance, Experiment, Input, Model, Output, Parameter, State, fit
from greybox.base import ModelError


def lag(gain=lambda: 1.0, reading=lambda: 1.0, start=None):
    return Model(
        "lag",
        states=[State("y", "V", start or 0.0)],
        inputs=[Input("u", "V")],
        outputs=[Output("r", "V", lambda x, u, p: reading() * x.y)],
        parameters=[
            Parameter("K", "1", 1.0, (0.1, 10.0)),
            Parameter("tau", "s", 1.0, (0.1, 10.0)),
            Parameter("y0", "V", 0.1, fixed=True),
        ],
        balances=lambda x, u, p: [Balance("l", "V", p.tau, "y", drive=gain() * p.K * u.u, decay=-x.y)],
    )


GENERATOR = np.random.default_rng(0)
CHANGING = {
    "random numbers": (lambda: {"gain": lambda: GENERATOR.uniform(0.5, 1.5)}, "'drive'"),
    "a counter": (lambda: {"gain": itertools.count(1).__next__}, "'drive'"),
    "a counter that turns late": (lambda: {"gain": iter([1.0, 1.0, *[2.0] * 99]).__next__}, "'drive'"),
    "a clock": (lambda: {"reading": lambda: time.perf_counter_ns() % 100_003}, "output 'r'"),
    "a start that is drawn": (lambda: {"start": lambda p: p.y0 * GENERATOR.normal()}, "start of 'y'"),
}


@pytest.mark.parametrize(("functions", "place"), CHANGING.values(), ids=CHANGING)
def test_a_model_whose_functions_change_is_refused_with_the_place(functions, place):
    with pytest.raises(ModelError, match=f"{place}.* states something else each time"):
        lag(**functions())


def test_a_model_that_changes_after_it_was_made_is_refused_by_the_fit():
    turned = []
    model = lag(gain=lambda: 2.0 if turned else 1.0)
    t = 0.05 * np.arange(100)
    record = Experiment("run", t, {"u": np.ones(100)}, {"r": 1 - np.exp(-t)})
    assert fit(model, record).success
    turned.append(1)
    with pytest.raises(ModelError, match="'drive' states something else"):
        fit(model, record)


def test_functions_that_write_the_same_equations_are_taken():
    assert lag(gain=lambda: ca.SX(2.0)).values == lag().values
