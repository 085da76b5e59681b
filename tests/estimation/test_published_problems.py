"""Fits of published problems reach the published optimum and the standard errors that the data give."""

import numpy as np
import pytest

from greybox import Balance, Experiment, FitOptions, Model, Output, Parameter, State, fit
from greybox.data.findings import RecordCode

# y = a (1 - exp(-b t)), oxygen demand over time (Bates and Watts; Rooney and Biegler 2001). The row at t = 0 is not measured.
TIME = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0])
DEMAND = np.array([np.nan, 8.3, 10.3, 19.0, 16.0, 15.6, 19.8])
OXYGEN_DEMAND = Model(
    "oxygen_demand",
    states=[State("y", "g", 0.0)],
    inputs=[],
    outputs=[Output("y", "g", lambda x, u, p: x.y)],
    parameters=[Parameter("a", "g", 20.0, (1.0, 100.0)), Parameter("b", "1/s", 0.5, (0.01, 10.0))],
    balances=lambda x, u, p: [Balance("demand", "g/s", 1, "y", growth=p.b * (p.a - x.y))],
)


def test_seven_rows_give_the_published_constants_and_standard_errors():
    record = Experiment.from_arrays(TIME, {}, {"y": DEMAND})
    found = fit(OXYGEN_DEMAND, record, options=FitOptions(at_rest=True))
    assert found.success
    assert RecordCode.FEW_ROWS in [f.code for f in record.findings]
    # Published: a = 19.1426, b = 0.5311, sum of squares over n = 4.33171.
    values = [found.parameters[name].value for name in ("a", "b")]
    np.testing.assert_allclose(values, [19.1426, 0.5311], rtol=1e-4)
    a, b = values
    measured = TIME[1:]
    residual = DEMAND[1:] - a * (1 - np.exp(-b * measured))
    assert residual @ residual / 6 == pytest.approx(4.33171, rel=1e-5)
    # Linear regression at the optimum, with the variance over n - 2 degrees of freedom.
    J = np.column_stack([1 - np.exp(-b * measured), a * measured * np.exp(-b * measured)])
    errors = np.sqrt(np.diag(np.linalg.inv(J.T @ J)) * (residual @ residual) / 4)
    np.testing.assert_allclose([found.parameters[name].std for name in ("a", "b")], errors, rtol=5e-3)
