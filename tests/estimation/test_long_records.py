"""Long records are in memory a few times only: nothing that is computed of them is kept, or padded, or copied without need."""

import tracemalloc

import numpy as np
import pytest

import greybox as gb
from greybox.base.figure import Role, Thinning
from greybox.base.numerics import ROWS_AT_A_TIME
from greybox.estimation.residuals import run_residual_tests
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.show.figures.figure import KEPT_STRETCHES, draw_over_time, scale_to_prefix, value_range
from greybox.show.figures.fit import cross_correlation
from greybox.simulation.records import to_record
from greybox.simulation.simulate import write_csv
from tests.support.large import lag, lag_record

ROWS = 400_000
NUMBER = 8


def measure_peak(run):
    """Bytes at most that ``run`` had beside what there was."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def record():
    return lag_record(ROWS, 1)


def test_residuals_take_no_more_than_themselves_and_their_slopes(record):
    problem = prepare_problem(lag(), record, {"x": 1e-3}, gb.FitOptions())
    shooting = problem.shooting()
    shooting.residuals(problem.variables.here)
    # The kernel may be compiled beside the first of them.
    peak = min(measure_peak(lambda: shooting.residuals(problem.variables.here)) for _ in range(3))
    assert peak < 1.2 * NUMBER * ROWS * (1 + problem.variables.size)


def test_equal_intervals_take_the_memory_of_one_and_signals_are_those_of_the_record(record):
    read = to_record(lag(), record)
    assert read.h.strides == (0,)
    assert read.h.shape == (ROWS - 1,)
    assert np.shares_memory(read.u, record.inputs["u"])
    assert np.shares_memory(read.y, record.outputs["x"])
    assert read.cut(10, 20).h.strides == (0,)


def test_a_fit_keeps_the_signals_of_its_record():
    record = lag_record(500, 1)
    (trace,) = gb.fit(lag(), record, noise={"x": 1e-3}).traces
    assert trace.measured["x"] is record.outputs["x"]
    assert trace.experiment.inputs["u"] is record.inputs["u"]


@pytest.mark.rest
def test_residual_tests_go_over_a_long_record_in_blocks():
    rng = np.random.default_rng(0)
    residual, u = rng.normal(size=ROWS), np.repeat(rng.normal(size=ROWS // 50), 50)
    peak = measure_peak(lambda: run_residual_tests("x", [residual], {"u": [u]}, [np.ones((ROWS, 1))]))
    # The autoregression goes over two copies; 21 delayed inputs of a block are the rest.
    assert peak < 3 * NUMBER * ROWS + 6e7


def test_a_record_is_written_in_blocks(tmp_path, monkeypatch):
    """Rows, blocks and memory are a tenth of those of a long record: the numbers of Python take long to trace."""
    monkeypatch.setitem(write_csv.__globals__, "ROWS_AT_A_TIME", ROWS_AT_A_TIME // 10)
    record, file = lag_record(ROWS // 10, 1), tmp_path / "long.csv"
    assert ROWS_AT_A_TIME <= ROWS // 2
    assert measure_peak(lambda: write_csv(record, lag(), file)) < 4e7 / 10
    with open(file) as lines:
        assert sum(1 for _ in lines) == ROWS // 10 + 1


def test_a_curve_keeps_the_envelope_of_a_long_record(record):
    values = record.outputs["x"].copy()
    values[1234] = np.nan
    curve = draw_over_time(record.time, values, Role.MEASURED, factor=2.0)
    assert curve.thinning is Thinning.ENVELOPE
    assert len(curve.x) == len(curve.y) == 2 * KEPT_STRETCHES
    assert np.nanmin(curve.y) == 2 * np.nanmin(values)
    assert np.nanmax(curve.y) == 2 * np.nanmax(values)


def test_ranges_leave_out_what_is_not_finite():
    values = np.linspace(-3, 2, 250_001)
    values[[0, 5, -1]] = np.nan, np.inf, -np.inf
    assert value_range(values) == (values[1], values[-2])
    assert value_range(np.full(3, np.nan)) == pytest.approx((np.nan, np.nan), nan_ok=True)
    assert scale_to_prefix("m", 1e-6 * values)[0] == pytest.approx(1e6)


def test_correlations_are_those_of_whole_records():
    rng = np.random.default_rng(3)
    first, second = [rng.normal(size=n) for n in (250_000, 30)], [rng.normal(size=n) for n in (250_000, 30)]
    second[0][5:] += 0.4 * first[0][:-5]
    second[0][[7, 150_000]] = np.nan
    found, count = cross_correlation(first, second, 8)
    centred = [[r - np.nanmean(r) for r in each] for each in (first, second)]
    sizes = [np.sqrt(np.nanmean(np.concatenate(each) ** 2)) for each in centred]
    expected = [
        np.nanmean(np.concatenate([a[: len(a) - k] * b[k:] for a, b in zip(*centred, strict=True)])) / np.prod(sizes)
        for k in range(9)
    ]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert count == 250_028


@pytest.mark.rest
@pytest.mark.parametrize(
    "fit_black_box",
    [
        lambda r: gb.blackbox.arx(r, na=3, nb=3, focus="simulation"),
        lambda r: gb.blackbox.output_error(r, nb=1, nf=1),
    ],
    ids=["arx", "output error"],
)
def test_black_boxes_are_fitted_in_blocks(record, fit_black_box):
    # The record's own bytes are three numbers a row; blocks of all coefficients are the rest.
    assert measure_peak(lambda: fit_black_box(record)) < 1.5 * 3 * NUMBER * ROWS + 1e7


@pytest.mark.slow
def test_long_lists_of_a_result_file_are_read_without_their_text(tmp_path):
    rows = ROWS // 2
    path = gb.fit(lag(), lag_record(rows, 1), noise={"x": 1e-3}).save(tmp_path / "fit.json")
    # Time, input, output and run; one of them once more while it grows. The text of the file with its lists would be 40 MB.
    assert measure_peak(lambda: gb.load_fit(path, lag())) < 6 * NUMBER * rows + 1e7
