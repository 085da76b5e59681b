"""What the figures of comparisons, parameters and linear models hold."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.base.figure import Area, Bars, Curve, Points, Role, Scale, Symbol
from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.discovery.curve_shape import rank_dependences
from greybox.discovery.disturbance_sites import SiteKind
from greybox.discovery.effect_signal import EffectSignal
from greybox.discovery.localisation import RankedSite, ResidualLocalisation, ResidualSignal
from greybox.estimation.errors import OutputRun
from greybox.estimation.linear.linearise import linearise
from greybox.estimation.result_parts import StartResult
from greybox.show.figures.comparison import model_roles, plot_model_errors, plot_model_residuals, plot_model_runs
from greybox.show.figures.discovery import plot_effect_signal, plot_unexplained_signal
from greybox.show.figures.fit import misfits_over_best, plot_intervals, plot_starts
from greybox.show.figures.linear import plot_bode, plot_poles, response_frequencies
from greybox.show.figures.pictures import comparison_sheet
from models.micro_actuator import micro_actuator

TIME = np.arange(1000.0)
MEASURED = np.sin(TIME / 50)


def entry(name: str, kind: str, error: float) -> ComparisonEntry:
    """A model that is off by a constant, and one sample ahead by half of that."""
    score = ComparisonScore(error, 99.0, len(TIME), "m", {1: error / 2})
    run = OutputRun("a", "x", TIME, MEASURED, MEASURED - error, ahead={1: MEASURED})
    scores = {"x": score}
    return ComparisonEntry(
        name, kind, {"x": name}, 2, scores, scores, {"a": scores}, 0.0, True, {}, validation_runs=(run,)
    )


@pytest.fixture
def comparison() -> Comparison:
    entries = (entry("arx", "black", 0.2), entry("rig", "grey", 0.1), entry("wrong", "grey", np.inf))
    return Comparison(entries, {"x": "m"}, ("t",), ("a",))


def test_models_are_ranked_best_first_and_one_that_diverges_is_last(comparison: Comparison) -> None:
    bars, marks = plot_model_errors(comparison)["x"].series
    assert isinstance(bars, Bars) and isinstance(marks, Points)
    assert list(bars.places) == list(marks.y) == ["rig", "arx", "wrong"]
    np.testing.assert_allclose(bars.lengths, [100.0, 200.0, np.nan])  # mm
    np.testing.assert_allclose(marks.x, [50.0, 100.0, np.nan])
    assert plot_model_errors(comparison).description[0].endswith("arx 200 mm, wrong diverges")


def test_legends_list_the_models_in_their_order_and_the_first_is_drawn_on_top(comparison: Comparison) -> None:
    runs = plot_model_runs(comparison, "a", "runs")["x"]
    names = [e.name for e in comparison.entries]
    assert list(runs.labels) == ["measured", *names]
    assert [s.label for s in runs.series] == ["measured", *reversed(names)]
    residuals = plot_model_residuals(comparison, "a", "errors")["x"]
    assert list(residuals.labels) == names


def test_grey_boxes_have_the_first_colours(comparison: Comparison) -> None:
    assert model_roles(comparison.entries) == {"rig": Role.MODEL_1, "wrong": Role.MODEL_2, "arx": Role.MODEL_3}


def test_a_run_that_leaves_all_bounds_hides_no_other(comparison: Comparison) -> None:
    run = plot_model_runs(comparison, "a", "runs")["x"]
    by_label = {s.label: s for s in run.series if isinstance(s, Curve)}
    assert np.isnan(by_label["wrong"].y).all()
    np.testing.assert_allclose(by_label["rig"].y, MEASURED - 0.1)  # m: the sine reaches 0.9999996
    residual = plot_model_residuals(comparison, "a", "errors")["x"]
    assert residual.y.limits == pytest.approx((-800.0, 800.0))  # four times the largest typical error, in mm


def test_a_sheet_of_a_comparison_has_runs_errors_and_bars(comparison: Comparison) -> None:
    sheet = comparison_sheet(comparison, "a")
    assert [(c.row, c.column, c.rows) for c in sheet.cells] == [(0, 0, 1), (1, 0, 1), (0, 1, 2)]
    assert sheet.cells[0].window is not None and sheet.cells[1].window is None


def test_intervals_are_ranked_on_a_logarithmic_axis() -> None:
    caption = "Half width of each 95 % interval: smaller is better."
    assert plot_intervals({"K": 1.0}, caption) is None
    panel = plot_intervals({"K": 10.0, "B": 0.1}, caption).panels[0]
    (marks,) = panel.series
    assert list(marks.y) == ["B", "K"] and marks.x.tolist() == [0.1, 10.0]
    assert panel.x.scale is Scale.LOG and panel.x.limits[0] < 0.1 and panel.x.limits[1] > 10.0


def test_gain_and_phase_are_those_of_the_linear_model() -> None:
    linear = linearise(micro_actuator)
    gain, phase = plot_bode(linear, None)
    assert [p.name for p in gain.panels] == [p.name for p in phase.panels] == ["u → x", "u → i"]
    w = response_frequencies(linear)
    response = linear.frequency_response(w)[:, 0, 0]
    curve, angle = gain["u → x"].series[0], phase["u → x"].series[0]
    # In micrometres per volt, as the largest gain is 0.44 mm/V; a resistance is as it stands.
    assert [p.y.unit for p in gain.panels] == ["µm/V", "mA/V"]
    np.testing.assert_allclose(curve.y, 1e6 * np.abs(response))
    np.testing.assert_allclose(curve.x, w / (2 * np.pi))
    np.testing.assert_allclose(angle.y, np.degrees(np.unwrap(np.angle(response))))
    assert not any(isinstance(s, Area) for s in gain["u → x"].series)


def test_poles_of_a_sampled_model_stand_in_the_unit_circle() -> None:
    continuous, sampled = (plot_poles(linearise(micro_actuator, dt=dt), None).panels[0] for dt in (None, 1e-3))
    assert [type(s) for s in continuous.series] == [Points]
    circle, poles = sampled.series
    np.testing.assert_allclose(np.hypot(circle.x, circle.y), 1.0)
    assert sampled.equal_scales and not continuous.equal_scales
    assert (np.hypot(poles.x, poles.y) < 1).all()
    assert plot_poles(replace(linearise(micro_actuator), A=np.zeros((0, 0))), None) is None


def test_a_text_stands_behind_the_outer_of_bar_and_mark() -> None:
    score = ComparisonScore(0.1, 90.0, len(TIME), "m", {1: 0.3})
    worse_ahead = replace(entry("late", "black", 0.1), validation={"x": score})
    bars, marks = plot_model_errors(Comparison((worse_ahead,), {"x": "m"}, ("t",), ("a",)))["x"].series
    assert (bars.texts, marks.texts) == ([""], ["90.0 %"])


def test_models_far_apart_are_points_on_a_logarithmic_axis() -> None:
    entries = (entry("rig", "grey", 0.001), entry("arx", "black", 1.0), entry("wrong", "grey", np.inf))
    panel = plot_model_errors(Comparison(entries, {"x": "m"}, ("t",), ("a",)))["x"]
    ahead, *sizes = panel.series
    assert panel.x.scale is Scale.LOG and not any(isinstance(s, Bars) for s in panel.series)
    assert [(s.y[0], s.symbol) for s in sizes] == [
        ("rig", Symbol.CIRCLE),
        ("arx", Symbol.CIRCLE),
        ("wrong", Symbol.CROSS),
    ]
    assert sizes[2].texts == ["diverges"] and isinstance(ahead, Points)


def test_the_mean_in_bins_lies_among_the_points_that_it_is_the_mean_of() -> None:
    rng = np.random.default_rng(1)
    time, v = 0.01 * np.arange(400), rng.uniform(-1, 1, 400)
    value = 5.0 + 2.0 * np.sign(v)  # a signal with a mean
    dependence = rank_dependences(time, value, {"v": (v, "m/s")})[0]
    signal = EffectSignal(
        "friction", "force", "N", "run", time, value, np.full(400, 0.1), value, "v", "m/s", v, dependence
    )
    *_, bins = plot_effect_signal(signal, "missing").panels[0].series
    np.testing.assert_allclose(bins.y[[0, -1]], [3.0, 7.0], atol=1e-9)


def test_the_unexplained_signal_is_drawn_at_the_site_that_the_text_names() -> None:
    time = np.arange(50.0)
    signal = ResidualSignal(
        "balance torque", "N*m", "run", time, np.sin(time), np.ones(50), {"w": time}, {"w": "rad/s"}
    )
    sites = (RankedSite("torque", SiteKind.BALANCE, 100.0, 1.0, "N*m"), RankedSite("i", SiteKind.INPUT, 10.0, 1.0, "A"))
    localisation = ResidualLocalisation(5.0, 1.1, sites, (("balance torque",), ("input i",)), (), (signal,))
    figure = plot_unexplained_signal(localisation)
    assert "the torque balance" in str(localisation)
    assert figure.panels[0].y.name == "unexplained at the balance torque"
    assert "at the balance torque, against" in figure.caption


def test_a_figure_of_the_missing_signal_tells_of_no_variable_that_explains_nothing():
    x = np.linspace(-1, 1, 400)
    noise = np.random.default_rng(3).standard_normal(400)
    dependences = rank_dependences(x, noise, {"x": (x, "m")})
    assert dependences and not dependences[0].is_relevant
    signal = SimpleNamespace(site="force", unit="N", value=noise, variables={"x": x}, units={"x": "m"})
    figure = plot_unexplained_signal(SimpleNamespace(signal=signal, dependences=dependences))
    assert figure.description == ("The signal is a function of no single variable",)


def test_starts_are_drawn_over_the_best_one() -> None:
    starts = [StartResult({}, {}, ratio, "converged") for ratio in (52.4, 52.4, 131.0)]
    assert misfits_over_best(starts) == pytest.approx([1.0, 1.0, 2.5])
    (panel,) = plot_starts([*starts, StartResult({}, {}, np.inf, "failed")]).panels
    assert list(panel.series[0].y) == pytest.approx([1.0, 1.0, 2.5])
    # No tick stands between two starts, and there is room for the numbers of many.
    assert panel.x.spacing == 1.0 and plot_starts(starts * 10).panels[0].x.spacing == 3.0
