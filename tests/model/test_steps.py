"""A sign or a comparison has no slope; a model with one is none of constant coefficients all the same."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Experiment, Input, Model, Output, Parameter, State
from greybox.model.effect import formula_effect


def body() -> Model:
    """A body with viscous friction under a force."""
    return Model(
        "body",
        states=[State("v", "m/s")],
        inputs=[Input("F", "N")],
        outputs=[Output("v", "m/s")],
        parameters=[Parameter("M", "kg", 2.0, fixed=True), Parameter("B", "N*s/m", 1.0, (0.1, 10))],
        balances=lambda x, u, p: [Balance("force", "N", p.M, "v", drive=u.F, friction=-p.B * x.v)],
    )


def test_a_sign_of_a_state_makes_a_model_nonlinear() -> None:
    dry = formula_effect("dry", "force", "k*sign(v)", [Parameter("k", "N", -0.5)])
    assert body().system.linear
    assert not (body() + dry).system.linear


def test_a_step_of_a_constant_does_not() -> None:
    biased = formula_effect("biased", "force", "k*sign(c)", [Parameter("k", "N", -0.5), Parameter("c", "1", 1.0)])
    assert (body() + biased).system.linear


def test_a_sign_acts_in_a_simulation() -> None:
    """Against the closed form: while ``v`` is positive, ``sign(v)`` is a constant force."""
    dry = formula_effect("dry", "force", "k*sign(v)", [Parameter("k", "N", -0.5)])
    time = np.linspace(0, 3, 61)
    expected = 1.5 * (1 - np.exp(-time / 2))
    record = Experiment("push", time, {"F": np.full(61, 2.0)}, {"v": expected + 1e-4})
    fit = gb.fit(body() + dry, record, noise={"v": 1e-4}, options=gb.FitOptions(at_rest=True))
    # B and k are told apart by the curve: 2 - |k| over B in the end, B over M for its rate.
    assert fit.parameters["k"].value == pytest.approx(-0.5, abs=0.02)
