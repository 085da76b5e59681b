"""Pictures: axes that people read, and envelopes that lose no peak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from greybox.plots import fit_figure, misfits_of
from greybox.plots.thinning import min_max_envelope
from greybox.plots.units import axis_label, scale_to_prefix, typeset_unit
from greybox.result import Fit, FitNoise, Misfit, Trace, Validation
from models.micro_actuator import micro_actuator


def test_an_envelope_keeps_every_peak() -> None:
    time = np.linspace(0, 1, 100_003)
    values = np.sin(40 * time)
    values[[777, 50_000]] = [9.0, -7.0]
    t, v = min_max_envelope(time, values, most=500)
    assert len(t) == len(v) == 1000
    assert (v.max(), v.min()) == (9.0, -7.0)
    assert np.all(np.diff(t) >= 0)
    assert abs(t[np.argmax(v)] - time[777]) < 1 / 500
    low, high = v[0::2], v[1::2]
    assert np.all(low <= high)


def test_short_records_stay_as_they_are_and_gaps_stay_gaps() -> None:
    time = np.arange(100.0)
    t, v = min_max_envelope(time, time, most=50)
    assert t is time
    assert v is time
    values = np.ones(10_000)
    values[2000:4000] = np.nan
    t, v = min_max_envelope(np.arange(10_000.0), values, most=100)
    inside = (t >= 2000) & (t < 4000)
    assert np.isnan(v[inside]).all()
    assert (v[~inside] == 1).all()


@pytest.mark.parametrize(
    ("unit", "largest", "text", "factor"),
    [
        ("m", 4e-4, "µm", 1e6),
        ("A", 0.25, "mA", 1e3),
        ("V", 2.0, "V", 1.0),
        ("Pa", 8e5, "kPa", 1e-3),
        ("m", 1e-12, "nm", 1e9),
        ("m/s**2", 1e-5, "m/s²", 1.0),
        ("", 1e-5, "", 1.0),
        ("m", 0.0, "m", 1.0),
    ],
)
def test_units_get_the_prefix_that_suits_them(unit: str, largest: float, text: str, factor: float) -> None:
    found, shown = scale_to_prefix(unit, np.array([0.0, -largest, np.nan]))
    assert (found, shown) == (pytest.approx(factor), text)


def test_labels_are_written_as_in_print() -> None:
    assert axis_label("x", "µm") == "x [µm]"
    assert axis_label("x", "") == "x"
    assert typeset_unit("kg*m**2/s**3") == typeset_unit("kg*m^2/s^3") == "kg m²/s³"


def judged(validation: list[Trace], pooled: dict[str, Misfit]) -> Fit:
    """A fit of the displacement alone, with records for validation that have the current too."""
    fields = dict.fromkeys(Fit.__dataclass_fields__, None)
    known = {"model": micro_actuator, "traces": [trace("train", x=1e-7)], "noise": FitNoise({"x": 1e-7})}
    return Fit(**(fields | known | {"validation": Validation(pooled, validation)}))


def trace(name: str, **errors: float) -> Trace:
    """100 rows, each output off by a constant."""
    time = np.linspace(0, 1, 100)
    measured = {output: np.sin(7 * time) for output in errors}
    simulated = {output: measured[output] - error for output, error in errors.items()}
    return Trace(name, "", time, measured, simulated, {})


def test_each_record_has_its_own_misfit() -> None:
    pooled = {"x": Misfit(3e-7, "m", 99.0, 3.0, 200), "i": Misfit(0.01, "A", 99.0, 2.0, 200)}
    good, bad = trace("good", x=1e-7, i=0.005), trace("bad", x=5e-7, i=0.02)
    spoiled = bad.measured["x"] + (np.arange(len(bad.time)) < 20)
    bad = replace(bad, measured={**bad.measured, "x": spoiled})
    fit = judged([good, bad], pooled)
    assert misfits_of(fit, good)["x"].noise_ratio == pytest.approx(1)
    assert misfits_of(fit, bad)["x"].noise_ratio > 1e6
    assert misfits_of(fit, bad, skip=20)["x"].noise_ratio == pytest.approx(5)
    # The fitted record lacks the current: its noise is the one by which the validation judged it, 0.01 A / 2.
    assert misfits_of(fit, good)["i"].noise_ratio == pytest.approx(1)
    assert misfits_of(fit, bad)["i"].noise_ratio == pytest.approx(4)


def test_titles_carry_the_records_own_misfit_and_no_band_is_drawn_without_noise(monkeypatch, tmp_path) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: None if self in drawn else drawn.append(self))
    pooled = {"x": Misfit(3e-7, "m", 99.0, 3.0, 200)}
    files = fit_figure(judged([trace("good", x=1e-7, i=0.005), trace("bad", x=5e-7)], pooled), tmp_path)
    assert [f.name for f in files] == ["fit-train.png", "validation-good.png", "validation-bad.png"]
    titles = [[a.get_title(loc="left") for a in figure.axes if a.get_title(loc="left")] for figure in drawn]
    assert [t[0].split(",")[0] for t in titles] == [
        "x: misfit 1 x noise",
        "x: misfit 1 x noise",
        "x: misfit 5 x noise",
    ]
    assert titles[1][1].startswith("i: best fit")
    bands = [[len(a.patches) for a in figure.axes if a.get_ylabel().startswith("residual")] for figure in drawn]
    assert bands == [[1], [1, 0], [1]]
