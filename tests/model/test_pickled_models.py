"""A model travels as bytes, lambdas and effects of one's own included, and copies share its functions."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Effect, Input, Model, Output, Parameter, State

MASS = Model(
    "mass",
    [State("x", "m"), State("v", "m/s")],
    [Input("F", "N")],
    [Output("x", "m")],
    [Parameter("M", "kg", 1.0, (0.01, 10.0)), Parameter("K", "N/m", 200.0, (1.0, 1e5))],
    lambda x, u, p: [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.M, "v", drive=u.F, spring=-p.K * x.x),
    ],
)
BRAKE = Effect(
    "brake",
    "force",
    [Parameter("ce", "{force}/{velocity}", 0.0, (0.0, 100.0))],
    terms=lambda x, u, p: -p.ce * x.velocity,
    equation="-ce v",
)


@pytest.mark.parametrize("model", [MASS, MASS + BRAKE, (MASS + gb.effect("coulomb_friction")).start(M=2.0)])
def test_a_model_is_the_same_after_pickling(model):
    other = pickle.loads(pickle.dumps(model))
    assert type(other) is Model and (other.title, other.values) == (model.title, model.values)
    np.testing.assert_allclose(gb.linearise(other).A, gb.linearise(model).A, rtol=1e-14)


def test_another_process_needs_no_file_of_the_model():
    read = "import pickle, sys; print(pickle.load(sys.stdin.buffer).values)"
    done = subprocess.run(
        [sys.executable, "-c", read], input=pickle.dumps(MASS + BRAKE), capture_output=True, check=True
    )
    assert done.stdout.decode().strip() == str((MASS + BRAKE).values)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy])
def test_a_copy_has_the_same_functions(copied):
    other = copied(MASS + BRAKE)
    assert other.balances is MASS.balances and other.effects == (BRAKE,)
