"""A rig of several inputs and outputs has a state-space model among its black boxes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.signal import cont2discrete

import greybox as gb
from greybox.comparison.black_box_candidates import fit_black_boxes
from greybox.comparison.blackbox.prediction_error import PredictionErrorPolicy
from greybox.comparison.result import Comparison, ComparisonFinding, ComparisonPolicy, save_comparison
from greybox.data.experiment import Experiment
from tests.support.result_schema import strict_offences

pytestmark = pytest.mark.rest

# What the rivals of one output reach matters little here: few poles, one start, few steps.
FEW = PredictionErrorPolicy(starts=1, first_iterations=2, iterations=5)
SMALL = ComparisonPolicy(
    scan=gb.blackbox.StructureScanPolicy(
        search=FEW,
        final_search=FEW,
        largest_poles=1,
        largest_searched_poles=1,
        first_delays=(1,),
        nonlinearities={"polynomial": (2,)},
    )
)
NOISE = 0.02


def coupled_masses(seed, rows=1500, noise=NOISE):
    """Two masses on springs with a force on each, at 20 ms; positions measured."""
    A = np.array([[0, 0, 1.0, 0], [0, 0, 0, 1.0], [-9, 4, -0.6, 0.1], [4, -12, 0.1, -0.8]])
    B = np.array([[0, 0], [0, 0], [1.0, 0], [0, 1.5]])
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), 0.02)
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((rows // 10 + 1, 2)).repeat(10, axis=0)[:rows]
    x, y = np.zeros(4), np.empty((rows, 2))
    for k in range(rows):
        y[k] = x[:2]
        x = Ad @ x + Bd @ u[k]
    spread = y.std(axis=0)
    y = y + noise * spread * rng.standard_normal(y.shape)
    signals = {"F1": u[:, 0], "F2": u[:, 1]}, {"y1": y[:, 0], "y2": y[:, 1]}
    return Experiment(f"r{seed}", 0.02 * np.arange(rows), *signals), spread


@pytest.fixture(scope="module")
def compared():
    record, _ = coupled_masses(0)
    other, spread = coupled_masses(1)
    models, findings = fit_black_boxes([record], ["y1", "y2"], ["F1", "F2"], policy=SMALL)
    rival = next(m for m in models if m.name == "subspace")
    return gb.compare({m.name: m.model for m in models}, other, training=record), rival, findings, spread


@pytest.mark.slow
def test_a_state_space_model_of_all_outputs_is_a_rival_with_the_order_of_the_plant(compared):
    comparison, rival, findings, spread = compared
    assert [box.output for box in rival.model] == ["y1", "y2"]
    # Four states, and some for the noise: the order is that whose free run follows held-out rows best.
    assert 4 <= rival.model[0].model.order <= 8 and rival.model[0].stable
    assert not findings
    for name, movement in zip(("y1", "y2"), spread, strict=True):
        assert comparison["subspace"].validation[name].rmse < 1.1 * NOISE * movement
        # Models of one pole an output cannot follow two coupled masses.
        assert comparison["subspace"].validation[name].rmse < 0.5 * comparison["arx"].validation[name].rmse


@pytest.mark.slow
def test_its_entry_is_in_the_file(compared, tmp_path):
    data = json.loads(save_comparison(compared[0], tmp_path / "compare.json").read_text())
    assert strict_offences(data, Comparison) == []
    assert "subspace" in data["models"]


@pytest.mark.slow
def test_one_input_and_output_have_none():
    record, _ = coupled_masses(0, rows=300)
    models, _ = fit_black_boxes([record], ["y1"], ["F1"], policy=SMALL)
    assert "subspace" not in {m.name for m in models}


@pytest.mark.slow
def test_a_record_too_short_for_it_is_a_note():
    record, _ = coupled_masses(0, rows=60)
    models, findings = fit_black_boxes([record], ["y1", "y2"], ["F1", "F2"], policy=SMALL)
    assert [f.code for f in findings if f.code == ComparisonFinding.NO_STATE_SPACE]
    assert "subspace" not in {m.name for m in models}
