"""A record without its glitches: the first row among them, beside gaps, and nothing else is touched."""

import numpy as np
import pytest

from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode
from tests.support.findings import codes, find

ROWS = 400


def make_record(glitches: tuple[int, ...], gaps: tuple[int, ...] = ()) -> Experiment:
    rng, time = np.random.default_rng(1), 0.01 * np.arange(ROWS)
    y = np.sin(time) + 0.01 * rng.normal(size=ROWS)
    y[list(glitches)] += 50.0
    y[list(gaps)] = np.nan
    return Experiment.from_arrays(time, {"u": np.cos(time)}, {"y": y})


@pytest.mark.parametrize("glitches", [(), (40, 200), (0, 40), (0,)])
@pytest.mark.parametrize("gaps", [(), (41, 120)])
def test_the_glitches_are_out_and_are_said(glitches, gaps):
    record = make_record(glitches, gaps)
    cleaned = record.without_spikes()
    assert set(np.flatnonzero(np.isnan(cleaned.outputs["y"]))) == {*glitches, *gaps}
    kept = np.isfinite(cleaned.outputs["y"])
    np.testing.assert_array_equal(cleaned.outputs["y"][kept], record.outputs["y"][kept])
    assert cleaned.sampling_time == record.sampling_time and RecordCode.SENSOR_SPIKES not in codes(cleaned.findings)
    said = find(cleaned.findings, RecordCode.SPIKES_LEFT_OUT)
    assert said.values["count"] == len(glitches) if glitches else said is None


def test_glitches_side_by_side_are_out_as_well():
    record = make_record(())
    y = record.outputs["y"].copy()
    y[40], y[41] = y[40] + 50.0, y[41] + 25.0
    cleaned = record.with_outputs({"y": y}).without_spikes()
    assert list(np.flatnonzero(np.isnan(cleaned.outputs["y"]))) == [40, 41]


def test_glitches_of_a_coarse_sensor_that_rests_often():
    # An encoder turns at a steady speed for half of the record: there no reading lies beside its neighbours.
    rng, time = np.random.default_rng(2), 0.002 * np.arange(2000)
    steps = np.round(np.cumsum(np.where((time % 1.0) < 0.5, 40.0, 40.0 + 5.0 * rng.normal(size=2000))))
    glitches = 20 + 62 * np.arange(31)
    y = steps.copy()
    y[glitches] += rng.choice([-2048.0, 2048.0], 31)
    cleaned = Experiment.from_arrays(time, {"u": np.cos(time)}, {"y": y}).without_spikes()
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(cleaned.outputs["y"])), glitches)
