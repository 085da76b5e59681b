"""Experiments on their way into a fit: what does not go with the model is refused by name."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from greybox import Experiment, fit, simulate
from greybox.base.errors import DataError
from greybox.simulation.records import to_experiments, to_record
from models.emps import emps
from models.silverbox import silverbox

TIME = np.arange(50) * 0.01
U = np.sin(TIME)


def record(**outputs: np.ndarray) -> Experiment:
    return Experiment("run", TIME, {"u": U}, outputs)


def test_a_record_with_none_of_the_models_outputs_is_refused() -> None:
    message = "experiment 'run' has none of the outputs of model 'emps': it has 'qq', 'i'; did you mean 'q'?"
    with pytest.raises(DataError, match=re.escape(message)):
        to_record(emps, record(qq=U, i=U))
    with pytest.raises(DataError, match="has none of the outputs of model 'emps': it has 'y'; known: q"):
        fit(emps, record(y=U))


def test_one_of_several_outputs_is_enough_and_a_run_needs_none() -> None:
    assert np.isfinite(to_record(emps, record(q=U, other=U)).y).all()
    assert np.isnan(to_record(emps, record()).y).all()
    assert np.array_equal(simulate(emps, record(y=U)).outputs["q"], simulate(emps, {"time": TIME, "u": U}).outputs["q"])


def test_a_simulated_part_of_a_record_keeps_the_step_of_the_whole() -> None:
    time = np.array([float(f"{t:.4f}") for t in np.arange(400) * 2.5e-4])
    whole = Experiment("run", time, {"u": np.sin(time)}, {"y": np.sin(time)})
    part = whole.window(3, 14)
    assert simulate(silverbox, part).record().sampling_time == whole.sampling_time


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("file.csv", "'file.csv' is not an experiment; read a file with read_csv(path, model)"),
        (Path("file.csv"), "is not an experiment; read a file with read_csv"),
        ([record(q=U), "file.csv"], "'file.csv' is not an experiment"),
        ([], "no experiment to fit; give at least one"),
        (record(), "experiment 'run' has no measured output"),
    ],
)
def test_what_is_no_measured_experiment_is_refused(given: object, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        to_experiments(given)


def test_one_experiment_or_several_are_a_tuple() -> None:
    one = record(q=U)
    assert to_experiments(one) == (one,)
    assert to_experiments(iter([one, one])) == (one, one)
