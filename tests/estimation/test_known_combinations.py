"""What is determined of constants that are not: against the fit of a model that has the combination as its constant."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, FitOptions, Input, Model, Output, Parameter, State
from greybox.estimation.covariance import find_known_combinations
from greybox.estimation.findings import EstimationCode

TIME = 0.05 * np.arange(150)
DRIVE = np.sign(np.sin(1.3 * TIME))


def lag(names, rate, gain):
    """dx/dt = -rate x + gain u in plain numbers, both made of positive constants of these names."""
    return Model(
        "lag",
        [State("x", "1")],
        [Input("u", "1")],
        [Output("x", "1")],
        [Parameter(n, "1", start, (1e-3, 20)) for n, start in names.items()],
        lambda x, u, p: [Balance("b", "1", 1.0, "x", decay=-rate(p) * x.x, drive=gain(p) * u.u)],
    )


def known(fit):
    found = [f.values for f in fit.findings if f.code == EstimationCode.COMBINATION_DETERMINED]
    return {v["text"]: (v["value"], v["std"], *v["interval"]) for v in found}


@pytest.mark.parametrize(
    ("names", "rate", "gain", "text", "kept"),
    [
        ({"a": 2.0, "b": 0.7, "c": 1.0}, lambda p: p.a - p.b, lambda p: p.c, "a - b", "r"),
        ({"a": 1.0, "b": 0.6, "c": 1.0}, lambda p: p.a + p.b, lambda p: p.c, "a + b", "r"),
        ({"a": 0.9, "b": 1.5, "c": 1.2}, lambda p: p.a, lambda p: p.b * p.c, "b c", "g"),
    ],
)
def test_the_combination_has_the_value_and_the_interval_of_a_constant_in_its_place(names, rate, gain, text, kept):
    run = gb.simulate(lag({"r": 1.3, "g": 1.4}, lambda p: p.r, lambda p: p.g), {"time": TIME, "u": DRIVE})
    noisy = run.outputs["x"] + 0.01 * np.random.default_rng(4).normal(size=len(TIME))
    record = Experiment("r", TIME, {"u": DRIVE}, {"x": noisy})
    given = {"noise": {"x": 0.01}, "options": FitOptions(at_rest=True)}
    whole = gb.fit(lag(names, rate, gain), record, **given)
    plain = gb.fit(lag({"r": 1.0, "g": 1.0}, lambda p: p.r, lambda p: p.g), record, **given)
    (found,) = known(whole).items()
    constant = plain.parameters[kept]
    assert found[0] == text
    assert found[1][0] == pytest.approx(constant.value, rel=1e-6)
    # One unknown more takes one of 148 degrees of freedom from the variance of the residual.
    assert found[1][1] == pytest.approx(constant.std * np.sqrt(148 / 147), rel=1e-5)
    # The interval of a positive constant is by a factor, that of a combination by a difference.
    assert found[1][2:] == pytest.approx(constant.interval, rel=1e-4)


def test_a_chain_of_three_has_one_product_and_equal_constants_are_left_open():
    values = np.array([2.0, 3.0, 0.5])
    relative = np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]).T
    spread = np.outer(values, values) * 1e-4 / 9  # each a third of the error of the product
    (product,) = find_known_combinations(["a", "b", "c"], values, values[:, None] * relative, spread, np.inf)
    assert (product.text, product.value) == ("a b c", pytest.approx(3.0))
    assert product.std == pytest.approx(3.0 * 1e-2)
    # a = b: whether their product or their sum is determined cannot be told from here.
    assert not find_known_combinations(["a", "b"], np.ones(2), np.array([[1.0], [-1.0]]), np.eye(2), np.inf)
    assert not find_known_combinations(["a", "b"], np.ones(2), np.zeros((2, 0)), np.eye(2), np.inf)
