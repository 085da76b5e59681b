"""A step is run before it is handed over: one that overflows where shorter ones go on is refused, another says its deviation."""

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import ModelError
from greybox.estimation.linear.exported_model import to_plant
from greybox.extensions.export.discrete_step import make_discrete_step
from tests.estimation.test_prediction_steps import QUENCH, VALVE

pytestmark = pytest.mark.rest


@pytest.mark.parametrize("model", [VALVE, QUENCH, VALVE.start(k=0.3)])
def test_a_step_that_runs_away_is_refused(model, tmp_path):
    with pytest.raises(ModelError, match=r"overflows after 0\.[12] s, where shorter steps go on"):
        gb.export.to_casadi(model.free("fast"), 0.1, substeps=1)
    step = make_discrete_step(to_plant(model), 0.1)
    assert step.step.implicit and 0 < step.deviation < 0.05
    x = step.x0
    for _ in range(300):
        x = step.advance(x, np.empty(0), np.ones(1))
    # At rest in a constant input nothing moves.
    assert np.abs(model.system.rhs_function(x, 1.0, step.p).full()).max() < 0.01
