"""Records cut in segments: every row once, and the segments put together again."""

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.data.experiment import Experiment
from greybox.estimation.options import FitOptions
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.estimation.transcription.segments import SegmentedProblem, cut_in_rows, cut_in_seconds, split_into_arcs
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record, multisine


def test_one_arc_with_too_few_rows_among_long_ones_is_refused():
    whole = linear_record(micro_actuator, multisine(np.random.default_rng(1), 90, 2.5e-4, 5, 800, 3.0), 2.5e-4)
    kept = np.r_[0:30, 58:90]
    signals = [{n: v[kept] for n, v in group.items()} for group in (whole.inputs, whole.outputs)]
    torn = Experiment.from_arrays(whole.time[kept], *signals, name="torn")
    with pytest.raises(DataError, match=r"one of 0\.0075 s has 2 rows"):
        split_into_arcs(torn, seconds=30 * 2.5e-4)


def test_arcs_cover_every_row_once_and_refuse_lengths_that_are_none():
    data = linear_record(micro_actuator, multisine(np.random.default_rng(1), 100, 2.5e-4, 5, 800, 3.0), 2.5e-4)
    by_rows = split_into_arcs(data, rows=30)
    assert [a.rows for a in by_rows] == [30, 30, 40]  # ten rows are less than half an arc
    assert [a.rows for a in split_into_arcs(data, seconds=30 * 2.5e-4)] == [30, 30, 40]
    assert [a.rows for a in split_into_arcs(data, rows=40)] == [40, 40, 20]
    np.testing.assert_array_equal(np.concatenate([a.outputs["x"] for a in by_rows]), data.outputs["x"])
    np.testing.assert_array_equal(np.concatenate([a.time for a in by_rows]), data.time)
    assert split_into_arcs([data, data], rows=500) == (data, data)
    for wrong in ({}, {"rows": 30, "seconds": 1.0}):
        with pytest.raises(DataError, match="either in seconds or in rows"):
            split_into_arcs(data, **wrong)
    with pytest.raises(DataError, match="2 rows; an arc needs at least 3"):
        split_into_arcs(data, rows=2)
    with pytest.raises(DataError, match="-1 s is not a length"):
        split_into_arcs(data, seconds=-1)
    with pytest.raises(DataError, match=r"one of 0\.0005 s has 2 rows.*give at least 0\.00075 s"):
        split_into_arcs(data, seconds=5e-4)


@pytest.fixture(scope="module")
def actuator():
    records = [
        linear_record(micro_actuator, multisine(np.random.default_rng(seed), rows, 2.5e-4, 5, 800, 3.0), 2.5e-4)
        for seed, rows in ((1, 100), (2, 70))
    ]
    noise = {"x": 1e-7, "i": 1e-3}
    return prepare_problem(micro_actuator, records, noise, FitOptions())


def test_records_are_cut_in_rows_or_in_seconds(actuator):
    assert cut_in_rows(actuator, 30) == ((0, 30, 60, 100), (0, 30, 70))
    assert cut_in_rows(actuator, [50, 35]) == ((0, 50, 100), (0, 35, 70))
    assert cut_in_seconds(actuator, 30 * 2.5e-4) == cut_in_rows(actuator, 30)


def test_segments_begin_where_the_record_was_measured(actuator):
    segmented = SegmentedProblem.of(actuator, cut_in_rows(actuator, 30))
    assert segmented.starts_record == (True, False, False, True, False)
    x = [record.y[k, 0] for record, places in zip(actuator.records, segmented.cuts, strict=True) for k in places[:-1]]
    states = segmented.pieces.variables.initial.guess
    np.testing.assert_allclose(states[:, micro_actuator.system.state_names.index("x")], x)


def test_segments_that_begin_on_the_free_run_are_the_free_run(actuator):
    free = actuator.shooting().simulate(actuator.variables.here)
    cuts = cut_in_rows(actuator, 30)
    states = np.concatenate([x[list(places[:-1])] for (_, x), places in zip(free, cuts, strict=True)])
    for (y, x), (y_free, x_free) in zip(SegmentedProblem.of(actuator, cuts, states).simulate(), free, strict=True):
        np.testing.assert_allclose(y, y_free, atol=1e-12 * np.abs(y_free).max())
        np.testing.assert_allclose(x, x_free, atol=1e-12 * np.abs(x_free).max())


def test_the_whole_begins_where_its_first_segments_do(actuator):
    segmented = SegmentedProblem.of(actuator, cut_in_rows(actuator, 30))
    moved = segmented.at(segmented.pieces.variables.recentre(np.full(segmented.pieces.variables.size, 0.1)))
    states = moved.pieces.variables.initial.guess
    np.testing.assert_array_equal(moved.whole.variables.initial.guess, states[[0, 3]])
    np.testing.assert_allclose(moved.whole.variables.base, actuator.variables.base * np.exp(0.1))
