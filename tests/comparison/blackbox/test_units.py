"""No black box depends on the units of its signals, nor on how far from zero they lie."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import greybox as gb
from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.blackbox.prediction_error import PredictionErrorPolicy
from greybox.comparison.result import ComparisonPolicy

ROWS, EXACT = 400, 1e-6
# Factor of the outputs, factor of the inputs, and the shift of both in units of their movement.
UNITS = [(1e6, 1e-6, 0.0), (1e-6, 1e6, 0.0), (1e-6, 1e-6, 3e3), (1e5, 1.0, -1e4)]


def record(seed: int, factors: tuple[float, float, float] = (1.0, 1.0, 0.0)) -> gb.Experiment:
    """Two inputs, of which one passes a curve, and two outputs with noise; both plants are of second order."""
    rng = np.random.default_rng(seed)
    u, v = rng.standard_normal((2, ROWS // 4)).repeat(4, axis=1)
    y = lfilter([0, 0.3, 0.1], [1, -1.4, 0.6], u + 0.3 * u**2) + lfilter([0, 0.2], [1, -1.4, 0.6], v)
    z = lfilter([0, 0.1], [1, -0.9], v)
    outputs = {"y": y + 0.02 * rng.standard_normal(ROWS), "z": z + 0.02 * rng.standard_normal(ROWS)}
    of_outputs, of_inputs, shift = factors
    return gb.Experiment(
        f"record {seed}",
        0.1 * np.arange(ROWS),
        {name: of_inputs * (values + shift) for name, values in {"u": u, "v": v}.items()},
        {name: of_outputs * (values + shift) for name, values in outputs.items()},
    )


METHODS = {
    "arx": lambda r: gb.blackbox.arx(r, na=2, nb=2, output="y", offset=True),
    "arx, simulation": lambda r: gb.blackbox.arx(r, na=2, nb=2, output="y", offset=True, focus="simulation", passes=3),
    "armax": lambda r: gb.blackbox.armax(r, na=2, nb=2, nc=2, output="y", offset=True),
    "output error": lambda r: gb.blackbox.output_error(r, nb=2, nf=2, output="y", offset=True),
    "box-jenkins": lambda r: gb.blackbox.box_jenkins(r, nb=2, nf=2, nc=1, nd=1, output="y", offset=True),
    "hammerstein": lambda r: gb.blackbox.hammerstein(r, nb=2, nf=2, output="y", offset=True, basis_size=2),
    "pieces": lambda r: gb.blackbox.hammerstein(
        r, nb=2, nf=2, output="y", offset=True, shape="piecewise", basis_size=3
    ),
    "cva": lambda r: gb.blackbox.subspace(r).boxes()[0],
    "n4sid": lambda r: gb.blackbox.subspace(r, weight="n4sid").boxes()[0],
    "cva, order 3": lambda r: gb.blackbox.subspace(r, 3).boxes()[0],
}


@pytest.mark.crossed(3)
@pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
def test_a_model_is_the_same_in_any_units_and_anywhere(method):
    def errors(factors):
        model, judge = method(record(1, factors)), record(2, factors)
        free = model.simulate(judge, rows=60)["y"] - judge.outputs["y"]
        ahead = model.predict(judge, 2, rows=60)["y"] - judge.outputs["y"]
        return np.concatenate([free, ahead[2:]]) / factors[0]

    expected = errors((1.0, 1.0, 0.0))
    assert np.std(expected) < 1.0
    for factors in UNITS:
        np.testing.assert_allclose(errors(factors), expected, atol=EXACT * np.std(expected), err_msg=str(factors))


@pytest.mark.slow
def test_the_best_black_boxes_and_their_scores_are_the_same_in_any_units_and_anywhere():
    few = PredictionErrorPolicy(starts=1, first_iterations=3, iterations=30)
    scan = gb.blackbox.StructureScanPolicy(
        search=few,
        final_search=few,
        largest_poles=2,
        largest_searched_poles=1,
        first_delays=(1,),
        nonlinearities={"polynomial": (2,)},
    )

    def scores(factors):
        train, judge = record(1, factors), record(2, factors)
        models, _ = fit_black_boxes([train], ["y"], ["u", "v"], policy=ComparisonPolicy(scan=scan))
        found = gb.compare({m.name: m.model for m in models}, judge, training=train)
        return {
            (e.name, *e.structure.values()): [
                value / factors[0] for s in e.validation.values() for value in (s.rmse, s.one_step_rmse)
            ]
            for e in found.entries
        }

    expected = scores((1.0, 1.0, 0.0))
    assert {name for name, *_ in expected} >= {"arx", "armax", "output_error", "box_jenkins", "hammerstein", "subspace"}
    found = scores((1e-6, 1e6, 3e3))
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name] == pytest.approx(values, rel=EXACT), name


def test_coefficients_far_from_zero_are_those_of_plain_least_squares():
    """The constant and its deviation are those of the signals as they were recorded."""
    far = record(1, (2.0, 3.0, 1e3))
    found = gb.blackbox.arx(far, na=1, nb=1, nk=1, output="y", inputs=["u"], offset=True)
    y, u = far.outputs["y"], far.inputs["u"]
    columns = np.column_stack([-y[:-1], u[:-1], np.ones(ROWS - 1)])
    theta, squares, *_ = np.linalg.lstsq(columns, y[1:], rcond=None)
    assert list(found.coefficients.values()) == pytest.approx(theta, rel=1e-8)
    covariance = squares[0] / (ROWS - 4) * np.linalg.inv(columns.T @ columns)
    assert list(found.std.values()) == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-6)
