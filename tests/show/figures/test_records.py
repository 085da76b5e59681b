"""What the figures of one record hold: scaled curves, the band of the noise, its misfit."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.signal import periodogram

from greybox.base.figure import Band, Curve, Role, Scale, Thinning
from greybox.estimation.errors import compute_record_misfits
from greybox.estimation.result import Fit
from greybox.estimation.result_parts import FitNoise, Misfit, Provenance, Trace, Validation
from greybox.show.figures.pictures import fit_sheets
from greybox.show.figures.plotly_backend import to_plotly
from greybox.show.figures.records import (
    amplitude_density,
    liveliest_window,
    plot_inputs,
    plot_residual,
    plot_run,
    plot_signals,
    plot_spectrum,
    uniform_sampling_time,
)
from models.micro_actuator import micro_actuator

UNITS = {"x": "m", "i": "A", "u": "V"}


def trace(name: str = "test", rows: int = 100, **errors: float) -> Trace:
    """So many rows, each output off by a constant."""
    time = np.linspace(0, 1, rows)
    measured = {output: np.sin(7 * time) for output in errors}
    simulated = {output: measured[output] - error for output, error in errors.items()}
    return Trace(name, "", time, measured, simulated, {}, {"u": np.cos(time)})


def test_a_run_holds_both_curves_in_the_unit_of_its_axis() -> None:
    record = trace(x=0.01)
    small = replace(record, measured={"x": 1e-7 * record.measured["x"]}, simulated={"x": 1e-7 * record.simulated["x"]})
    panel = plot_run(small, UNITS, "run")["x"]
    assert (panel.x.label, panel.y.label) == ("time [s]", "x [nm]")
    assert [(s.role, s.label) for s in panel.series] == [(Role.MEASURED, "measured"), (Role.SIMULATED, "simulated")]
    assert [s.thinning for s in panel.series] == [Thinning.ENVELOPE] * 2
    np.testing.assert_allclose(panel.series[0].y, 1e2 * record.measured["x"])
    assert len(panel.series[0].x) == len(record.time)


def test_a_residual_has_a_band_of_two_standard_deviations_where_the_noise_is_known() -> None:
    record = trace(x=0.003, i=0.1)
    figure = plot_residual(record, UNITS, {"x": 0.001}, "residual")
    band, curve = figure["x"].series
    assert isinstance(band, Band) and (band.low, band.high) == pytest.approx((-2.0, 2.0))  # mm
    np.testing.assert_allclose(curve.y, 3.0)
    assert [type(s) for s in figure["i"].series] == [Curve]
    assert "0 % of it within two standard deviations of the noise" in figure.description[0]
    assert "within" not in figure.description[1]
    assert [type(s) for s in plot_residual(record, UNITS, {"x": np.nan}, "r")["x"].series] == [Curve]


def test_an_outlier_does_not_flatten_the_residual_of_a_picture_and_stays_on_a_page() -> None:
    record = trace(rows=5000, x=1.0)
    measured = record.measured["x"].copy()
    measured[77] += 1000.0
    axis = plot_residual(replace(record, measured={"x": measured}), UNITS, {}, "residual")["x"].y
    assert axis.limits is None
    assert axis.still_limits == pytest.approx((-1.1e-3, 1.1e-3))  # km


def test_a_spectrum_carries_the_residual_that_it_is_taken_from_anew() -> None:
    figure = plot_spectrum(trace(x=0.1), UNITS, {"x": 0.1}, "spectrum", follows="residual")
    curve, floor = figure["x"].series
    assert curve.signal.figure == "residual"
    np.testing.assert_allclose(curve.signal.values, 100.0)  # mm
    assert curve.signal.step == pytest.approx(1 / 99)
    np.testing.assert_allclose(floor.y, 100.0 * np.sqrt(2 / 99))
    assert figure["x"].x.scale is figure["x"].y.scale is Scale.LOG
    assert plot_spectrum(trace(x=0.1), UNITS, {}, "spectrum")["x"].series[0].signal is None


def test_an_uneven_record_has_no_spectrum_that_follows() -> None:
    record = trace(x=0.1)
    uneven = replace(record, time=record.time**1.2)
    assert uniform_sampling_time(uneven.time) is None
    assert plot_spectrum(uneven, UNITS, {}, "s", follows="r")["x"].series[0].signal is None


def test_signals_have_a_panel_each_and_say_what_is_missing() -> None:
    values = np.array([1.0, np.nan, 3.0])
    figure = plot_signals("in", np.arange(3.0), {"u": values}, {"u": "V"}, Role.INPUT, "Inputs of record a.")
    assert [p.name for p in figure.panels] == ["u"]
    assert figure.description == ("u ranges from 1 to 3 V; 1 values are missing",)
    assert plot_inputs(replace(trace(x=0.1), inputs={}), UNITS, "in") is None


@pytest.mark.parametrize(("hold", "shape"), [("zero", "hv"), ("first", None)])
def test_an_input_that_is_held_between_samples_is_drawn_as_steps(hold: str, shape: str | None) -> None:
    figure = plot_inputs(replace(trace(x=0.1), hold=hold), {**UNITS, "u": "V"}, "in")
    assert figure["u"].series[0].held is (hold == "zero")
    assert to_plotly(figure, 100).traces[0]["line"].get("shape") == shape


def test_the_closer_look_is_where_the_record_varies_most() -> None:
    time = np.arange(1000.0)
    values = np.zeros(1000)
    values[700] = -9.0
    assert liveliest_window(time, values) == (600.0, 799.0)
    values[5] = 20.0
    assert liveliest_window(time, values) == (2.0, 201.0)
    # A step, and not the stretch at rest that lies further from the mean.
    step = np.where(time < 300, 0.0, 1.0)
    assert liveliest_window(time, step) == (200.0, 399.0)
    assert liveliest_window(time[:400], values[:400]) is None


def judged(validation: list[Trace], pooled: dict[str, Misfit]) -> Fit:
    """A fit of the displacement alone, with records for validation that have the current too."""
    empty = dict.fromkeys((f.name for f in fields(Fit)), None)
    known = {
        "model": micro_actuator,
        "parameters": {},
        "provenance": Provenance(),
        "traces": [trace("train", x=1e-7)],
        "noise": FitNoise({"x": 1e-7}),
    }
    return Fit(**(empty | known | {"validation": Validation(pooled, validation)}))


def test_each_record_has_its_own_misfit() -> None:
    pooled = {"x": Misfit(3e-7, "m", 99.0, 3.0, 200, 1e-7), "i": Misfit(0.01, "A", 99.0, 2.0, 200, 0.005)}
    good, bad = trace("good", x=1e-7, i=0.005), trace("bad", x=5e-7, i=0.02)
    spoiled = bad.measured["x"] + (np.arange(len(bad.time)) < 20)
    bad = replace(bad, measured={**bad.measured, "x": spoiled})
    fit = judged([good, bad], pooled)
    assert compute_record_misfits(fit, good)["x"].noise_ratio == pytest.approx(1)
    assert compute_record_misfits(fit, bad)["x"].noise_ratio > 1e6
    assert compute_record_misfits(fit, bad, skip=20)["x"].noise_ratio == pytest.approx(5)
    # The fitted record lacks the current: its noise is the one by which the validation judged it, 0.01 A / 2.
    assert compute_record_misfits(fit, good)["i"].noise_ratio == pytest.approx(1)
    assert compute_record_misfits(fit, bad)["i"].noise_ratio == pytest.approx(4)


def test_a_sheet_for_each_record_has_its_misfit_above() -> None:
    pooled = {"x": Misfit(3e-7, "m", 99.0, 3.0, 200, 1e-7)}
    sheets = fit_sheets(judged([trace("good", x=1e-7, i=0.005), trace("bad", rows=900, x=5e-7)], pooled))
    assert [s.name for s in sheets] == ["fit-train", "validation-good", "validation-bad"]
    titles = [cell.titles[0] for sheet in sheets for cell in sheet.cells if cell.titles]
    misfits = [title.partition("best fit")[0] for title in titles if "best fit" in title]
    assert misfits == ["x: misfit 1.00 × noise, ", "x: misfit 1.00 × noise, ", "i: ", "x: misfit 5.00 × noise, "]
    assert [len(sheet.cells) for sheet in sheets] == [2, 4, 4]
    assert [c.window is not None for c in sheets[2].cells] == [False, False, True, True]


def test_the_spectrum_is_that_of_scipy() -> None:
    values = np.random.default_rng(1).normal(size=1000)
    f, amplitude = amplitude_density(values, 1e-3)
    reference, power = periodogram(values, 1e3, window="hann", detrend="constant")
    np.testing.assert_allclose(f, reference[1:])
    np.testing.assert_allclose(amplitude[:-1], np.sqrt(power[1:-1]), rtol=1e-6)


def test_a_gap_does_not_lower_the_spectrum() -> None:
    values = 3.0 * np.random.default_rng(2).normal(size=4000)
    values[1500:2500] = np.nan  # where the window weighs most
    _, amplitude = amplitude_density(values, 1e-3)
    assert np.sqrt(np.mean(amplitude**2)) == pytest.approx(3.0 * np.sqrt(2e-3), rel=0.05)
