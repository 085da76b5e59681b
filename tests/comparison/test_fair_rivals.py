"""Black boxes are those that an expert would get: against plain least squares written here, far from zero, and behind an integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

import greybox as gb
from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.blackbox.prediction_error import PredictionErrorPolicy
from greybox.comparison.result import ComparisonFinding, ComparisonPolicy
from models.emps import emps

pytestmark = pytest.mark.rest

ATMOSPHERE, STEP, NOISE = 101325.0, 0.02, 150.0
FEW = PredictionErrorPolicy(starts=2, first_iterations=3, iterations=20)
SMALL = ComparisonPolicy(
    scan=gb.blackbox.StructureScanPolicy(
        search=FEW,
        final_search=FEW,
        largest_poles=2,
        largest_searched_poles=1,
        first_delays=(1,),
        nonlinearities={"polynomial": (2,)},
    )
)


def chamber(seed: int, rows: int = 500) -> gb.Experiment:
    """A chamber that is filled from 500 kPa and leaks to the air, from rest at 101 kPa, by small steps of Euler's."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0, 1, rows // 25), 25)
    u[:25] = 0.0
    pressure, p = ATMOSPHERE, np.empty(rows)
    for k in range(rows):
        p[k] = pressure
        for _ in range(20):
            flow = 1100 * u[k] * np.sqrt(max(5e5 - pressure, 0.0)) - 3.0 * (pressure - ATMOSPHERE)
            pressure += STEP / 20 * flow
    readings = p + NOISE * rng.standard_normal(rows)
    return gb.Experiment(f"chamber {seed}", STEP * np.arange(rows), {"u": u}, {"p": readings})


def plain_arx(train: gb.Experiment, test: gb.Experiment, n: int) -> float:
    """Rms error of the free run of an ARX model with an offset from the first readings: NumPy alone."""

    def lagged(record: gb.Experiment) -> tuple[np.ndarray, np.ndarray]:
        y, u = record.outputs["p"], record.inputs["u"]
        columns = [x[n - k : len(y) - k] for x in (y, u) for k in range(1, n + 1)]
        return np.column_stack([*columns, np.ones(len(y) - n)]), y[n:]

    theta = np.linalg.lstsq(*lagged(train), rcond=None)[0]
    y, u = test.outputs["p"], test.inputs["u"]
    run = y.copy()
    for k in range(n, len(y)):
        run[k] = theta @ [*run[k - n : k][::-1], *u[k - n : k][::-1], 1.0]
    return float(np.sqrt(np.mean((run - y) ** 2)))


@pytest.mark.parametrize("at_rest", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_records_that_begin_at_101_kpa_have_black_boxes_at_least_as_good_as_plain_least_squares(at_rest):
    train, test = chamber(1), chamber(2)
    models, findings = fit_black_boxes([train], ["p"], ["u"], at_rest=at_rest, policy=SMALL)
    assert not findings
    found = gb.compare({m.name: m.model for m in models}, test, training=train)
    errors = {e.name: e.validation["p"].rmse for e in found.entries}
    plain = min(plain_arx(train, test, n) for n in (1, 2))
    assert min(errors.values()) < 1.01 * plain
    assert all(error < 1.1 * plain for error in errors.values()), errors
    assert not any(e.failed for e in found.entries)


def test_a_constant_input_is_no_input():
    """A supply pressure that never moves tells nothing, and takes nothing away."""
    train = chamber(1)
    supplied = gb.Experiment(train.name, train.time, {**train.inputs, "p_s": np.full(train.rows, 5e5)}, train.outputs)
    scans = gb.blackbox.best_black_boxes(supplied, kinds=("arx",), policy=SMALL.scan)
    assert scans["arx"].best.inputs == ("u",)


def integrating(rows: int = 3000) -> gb.Experiment:
    """A drive with viscous friction whose input has an offset: its position drifts."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1, 1, rows // 50), 50)
    y = 0.7 + lfilter([0, 1e-3], np.convolve([1, -1], [1, -0.97]), u - 0.05)
    return gb.Experiment("drive", 1e-2 * np.arange(rows), {"u": u}, {"y": y + 1e-3 * rng.standard_normal(rows)})


def test_an_output_error_behind_an_integrator_is_that_of_a_plain_search():
    """SciPy over the lag alone, all that is linear by least squares: numerator, drift and first state."""
    record = integrating()
    y, u = record.outputs["y"], record.inputs["u"]
    pulse = np.eye(1, len(y))[0]

    def misfit(lag: np.ndarray) -> np.ndarray:
        f = np.convolve([1, -1], [1, -lag[0]])
        columns = [lfilter([0, 1], f, u), lfilter([0, 1], f, np.ones(len(y))), lfilter([1], f, pulse)]
        matrix = np.column_stack([*columns, lfilter([0, 1], f, pulse)])
        matrix = matrix / np.linalg.norm(matrix, axis=0)
        return y - matrix @ np.linalg.lstsq(matrix, y, rcond=None)[0]

    expected = least_squares(misfit, [0.9], bounds=(0.5, 0.999))
    found = gb.blackbox.output_error(record, nb=1, nf=2, offset=True)
    assert found.loss == pytest.approx(2 * expected.cost / len(y), rel=1e-4)
    assert found.poles.real == pytest.approx([1.0, expected.x[0]], abs=1e-4) and found.stable


def test_the_servo_drive_is_at_the_published_linear_error(shared_data):
    train, test = (gb.read_csv(shared_data / "emps" / name, emps) for name in ("train.csv", "test.csv"))
    model = gb.blackbox.output_error(train, nb=2, nf=2, offset=True)
    error = (test.outputs["q"] - model.simulate(test, rows=20)["q"])[20:]
    assert np.sqrt(np.mean(error**2)) < 1.03 * 5.53e-3


def test_what_a_constant_beats_takes_no_part():
    train, test = chamber(1), chamber(2)
    wrong = gb.blackbox.PolynomialModel("arx", "p", ("u",), STEP, (1,), ([0, 1e4],), a=[1, -0.5])
    right = gb.blackbox.arx(train, na=1, nb=1, output="p", offset=True)
    found = gb.compare({"wrong": wrong, "right": right}, test, training=train)
    assert found["wrong"].failed and not found["right"].failed
    assert next(f.code for f in found["wrong"].findings) == ComparisonFinding.WORSE_THAN_CONSTANT
    assert "wrong" not in str(found).split("note:")[0].split("warning:")[0]
