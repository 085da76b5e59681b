"""Subspace identification: orders and poles of plants with several inputs and outputs, and what `compare` asks of a black box."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

import greybox as gb
from greybox.base.errors import DataError
from greybox.comparison.blackbox.subspace import subspace
from greybox.data.experiment import Experiment


def two_mass_drive():
    """Two inertias on a shaft, driven and braked; both speeds and the torque are measured."""
    J1, J2, k, d = 1.0, 3.0, 900.0, 1.5
    A = np.array([[-d / J1, d / J1, -k / J1], [d / J2, -(d + 0.8) / J2, k / J2], [1.0, -1.0, 0.0]])
    return A, np.array([[1 / J1, 0], [0, -1 / J2], [0, 0]]), np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, k / 50]]), 5e-3


def quadruple_tank():
    """Johansson's process about its operating point, in minutes; two levels are measured."""
    T = np.array([62.0, 90.0, 23.0, 30.0]) / 60
    A = np.array([[-1 / T[0], 0, 1 / T[2], 0], [0, -1 / T[1], 0, 1 / T[3]], [0, 0, -1 / T[2], 0], [0, 0, 0, -1 / T[3]]])
    return A, np.array([[5.0, 0], [0, 3.8], [0, 2.9], [1.9, 0]]), np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0]]), 0.1


def heated_rod():
    """Five cells of a rod, heated at both ends, measured at three places: real poles of many speeds."""
    A = -2 * np.eye(5) + np.eye(5, k=1) + np.eye(5, k=-1)
    B, C = np.zeros((5, 2)), np.zeros((3, 5))
    B[0, 0] = B[4, 1] = C[0, 0] = C[1, 2] = C[2, 4] = 1.0
    return 0.5 * A - 0.05 * np.eye(5), B, C, 0.5


PLANTS = {"two-mass": two_mass_drive, "tanks": quadruple_tank, "rod": heated_rod}


def make_record(name, rows=3000, noise=0.0, seed=0, offset=0.0):
    A, B, C, dt = PLANTS[name]()
    Ad, Bd, *_ = cont2discrete((A, B, C, np.zeros((len(C), B.shape[1]))), dt)
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal((rows // 3 + 1, B.shape[1]))).repeat(3, axis=0)[:rows]
    x, y = rng.standard_normal(len(A)), np.empty((rows, len(C)))
    for k in range(rows):
        y[k] = C @ x
        x = Ad @ x + Bd @ u[k]
    y = y + offset + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    signals = {f"u{j}": u[:, j] for j in range(u.shape[1])}, {f"y{j}": y[:, j] for j in range(y.shape[1])}
    return Experiment(name, dt * np.arange(rows), *signals), np.linalg.eigvals(Ad)


@pytest.mark.parametrize("weight", ["cva", "n4sid"])
@pytest.mark.parametrize("name", PLANTS)
def test_order_and_poles_of_exact_records(name, weight):
    record, poles = make_record(name, offset=3.0)
    model = subspace(record, weight=weight)
    assert model.order == len(poles)
    np.testing.assert_allclose(np.sort_complex(model.poles), np.sort_complex(poles), atol=1e-6)
    # At rest under inputs of zero every output is at its offset.
    at_zero = np.real(model.response(np.zeros(1))[0]) @ model.origin
    np.testing.assert_allclose(model.offset - at_zero, 3.0, atol=1e-6)


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("name", PLANTS)
def test_noisy_records_give_a_model_that_predicts_and_runs(name):
    record, _ = make_record(name, rows=9000, noise=0.05)
    other, _ = make_record(name, noise=0.05, seed=7)
    model = subspace(record)
    clean, _ = make_record(name, seed=7)
    assert abs(model.order - len(PLANTS[name]()[0])) <= 1 and model.stable
    for box in model.boxes():
        noise = 0.05 * np.std(clean.outputs[box.output])
        free = box.simulate(other, rows=100)[box.output]
        assert np.std(free - clean.outputs[box.output]) < noise
        one = box.predict(other, rows=100)[box.output]
        assert np.std(one - other.outputs[box.output]) < 1.1 * noise


@pytest.mark.rest
def test_process_noise_makes_a_predictor_with_the_gain_of_the_kalman_filter():
    from scipy.linalg import solve_discrete_are

    A, C, rng = np.array([[0.9, 0.2], [-0.2, 0.8]]), np.array([[1.0, 0.0], [0.0, 1.0]]), np.random.default_rng(3)
    x, rows = np.zeros(2), []
    u = rng.standard_normal((20000, 1))
    for value in u[:, 0]:
        rows.append(C @ x + 0.2 * rng.standard_normal(2))
        x = A @ x + np.array([0.5, 1.0]) * value + 0.3 * rng.standard_normal(2)
    y = np.array(rows)
    record = Experiment("r", np.arange(20000.0), {"u": u[:, 0]}, {"a": y[:, 0], "b": y[:, 1]})
    model = subspace(record, 2)
    P = solve_discrete_are(A.T, C.T, 0.09 * np.eye(2), 0.04 * np.eye(2))
    innovation = C @ P @ C.T + 0.04 * np.eye(2)
    box = model.boxes()[0]
    error = box.predict(record)["a"] - y[:, 0]
    assert np.std(error) == pytest.approx(np.sqrt(innovation[0, 0]), rel=0.02)


@pytest.mark.rest
def test_it_is_compared_with_other_models_and_starts_a_physical_one():
    record, _ = make_record("rod", noise=0.02)
    other, _ = make_record("rod", noise=0.02, seed=5)
    model = subspace(record)
    comparison = gb.compare({"subspace": model.boxes()}, other, training=record)
    assert set(comparison["subspace"].validation) == {"y0", "y1", "y2"}
    assert comparison["subspace"].validation["y0"].best_fit_percent > 95
    frequency = np.geomspace(1e-3, 0.8, 20)
    points = gb.frequency.FrequencyResponse(
        frequency, model.response(frequency), model.inputs, model.outputs, sampling_time=0.5
    )
    assert points.points == 20 * 6


def test_gaps_are_left_out():
    record, poles = make_record("tanks")
    y = np.array(record.outputs["y0"])
    y[700:720] = np.nan
    model = subspace(record.with_outputs({**record.outputs, "y0": y}))
    np.testing.assert_allclose(np.sort_complex(model.poles), np.sort_complex(poles), atol=1e-6)


def test_what_cannot_be_is_refused():
    record, _ = make_record("tanks")
    for how, message in (
        ({"weight": "moesp"}, "unknown weight"),
        ({"order": 500}, "order 500"),
        ({"outputs": ["z"]}, "no output 'z'"),
    ):
        with pytest.raises(DataError, match=message):
            subspace(record, **how)
    with pytest.raises(DataError, match="too few"):
        subspace(record.window(0, 30))
