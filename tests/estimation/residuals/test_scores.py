"""Free run and predictions side by side, for a model of every kind."""

import numpy as np
import pytest

import greybox as gb
from greybox import Experiment, FitOptions, fit
from greybox.comparison.blackbox.arx import arx
from greybox.comparison.blackbox.hammerstein import hammerstein
from greybox.comparison.blackbox.prediction_error_models import armax, box_jenkins, output_error
from greybox.estimation.score import score
from greybox.simulation.simulate import simulate
from tests.support.filters import tank, tank_record
from tests.support.pushed_mass import INTENSITY, LEVEL, MASS, record

# name -> what is fitted to a record that something pushes at random
GREY = {
    "linear": lambda data: fit(MASS, data),
    "not fitted": lambda _: MASS,
    "process noise": lambda data: fit(MASS.with_process_noise("v"), data),
    "dry friction": lambda data: fit(MASS + gb.effect("coulomb_friction"), data),
    "dead time": lambda data: fit(MASS + gb.effect("transport_delay"), data),
    "robust": lambda data: fit(MASS, data, options=FitOptions(loss="huber")),
    "segments": lambda data: fit(MASS, data, options=FitOptions(transcription="multiple")),
}
BLACK = {
    "arx": lambda data: arx(data, na=2, nb=2, output="x"),
    "armax": lambda data: armax(data, na=2, nb=2, nc=2, output="x"),
    "output error": lambda data: output_error(data, nb=2, nf=2, output="x"),
    "box-jenkins": lambda data: box_jenkins(data, nb=2, nf=2, nc=1, nd=1, output="x"),
    "hammerstein": lambda data: hammerstein(data, nb=2, nf=2, basis_size=2, output="x"),
}


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.slow] * (k == "dry friction")) for k in (*GREY, *BLACK)]
)
def test_every_kind_has_both_scores(kind):
    data, other = (record(s, rows=200, intensity=INTENSITY) for s in (1, 2))
    model = (GREY | BLACK)[kind](data)
    table = score(model, other, steps=(1, 10), skip=20)
    assert list(table.outputs) == (["x"] if kind in BLACK else ["x", "v"])
    outcome = table.outputs["x"]
    free, near, far = outcome.rmse, outcome.ahead[1], outcome.ahead[10]
    assert LEVEL["x"] < near < outcome.movement
    assert near <= free * (1 + 1e-12)  # an output-error model predicts as it simulates, but for rounding
    assert near <= far * 1.01
    # What an output error says of the next sample it says of all: only the others learn from the last measurements.
    assert (near < 0.5 * free) == (kind != "output error" and kind != "hammerstein")


def test_a_nonlinear_plant_has_both_scores():
    model, data = tank_record(rows=80)
    table = score(fit(model, data), data, steps=(1, 10))
    assert table.outputs["h"].ahead[1] < table.outputs["h"].rmse
    assert tank().name in str(model)


def test_the_free_run_is_that_of_the_simulation():
    data = record(1, rows=300)
    found = fit(MASS, data, options=FitOptions(at_rest=True), noise=LEVEL)
    run = simulate(found.model, Experiment("again", data.time, data.inputs, {}))
    table = score(found, data, options=FitOptions(at_rest=True))
    for name, outcome in table.outputs.items():
        assert outcome.rmse == pytest.approx(np.sqrt(np.mean((data.outputs[name] - run.outputs[name]) ** 2)), rel=1e-6)
        assert outcome.ahead == pytest.approx({1: outcome.rmse, 10: outcome.rmse}, rel=0.02)


class Told:
    """Predicts what it was given."""

    def __init__(self, values):
        self.values = values

    def simulate(self, experiment):
        return {"x": self.values}

    def predict(self, experiment, steps=1):
        return {"x": self.values}


@pytest.mark.parametrize(
    ("values", "rms"),
    [
        ([0.0, 1e200, -1e200, 1e200], 1e200 * np.sqrt(3 / 4)),  # their squares overflow
        ([0.0, 1.0, np.inf, 1.0], np.inf),
        ([0.0, 1.0, np.nan, 1.0], np.inf),  # a run that went beyond all numbers, and no gap
    ],
)
def test_runs_that_overflow_have_no_score_of_their_first_rows(values, rms):
    other = Experiment("far off", np.arange(4.0), {}, {"x": np.zeros(4)})
    outcome = score(Told(np.array(values)), other, steps=(1,)).outputs["x"]
    assert outcome.rmse == pytest.approx(rms)


@pytest.mark.rest
def test_predictions_keep_the_substeps_of_the_fit():
    """A stiff fit that converged with many substeps is not predicted with a few."""
    data = record(1, rows=100, intensity=INTENSITY)
    result = fit(MASS, data, options=FitOptions(method="rk4", substeps=70))
    assert gb.estimation.predictor(result).options.substeps == 70
