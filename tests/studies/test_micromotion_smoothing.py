"""Monte-Carlo smoothing against full enumeration, and what follows from equation 17 against python-control and plain least squares."""

from itertools import pairwise, product

import control
import numpy as np
import pytest

import greybox as gb
from fits.papers import micromotion_printed as wang
from fits.papers.micromotion_smoothing import (
    NUMERATOR_STRUCTURES,
    DrawCounts,
    DrawIntervals,
    SmoothingProgress,
    compare_numerators,
    estimate_intervals,
    estimate_spectrum,
    find_resonance,
    monte_carlo_smoothing,
    search_grid,
)
from fits.papers.micromotion_twin import ROWS, in_micrometres, step_record

TS = wang.SAMPLING_TIME
FEW = DrawCounts(amplitude=6, ratio=3, phase=3, frequency=4, decay=3)
TRUE = {"amplitude": 29.54, "ratio": 1.0006, "phase": 1.5375, "frequency": 768.0, "decay": 25.6}


def equation_17(t, amplitude, ratio, phase, frequency, decay):
    return amplitude * (1 - ratio * np.exp(-decay * t) * np.sin(frequency * t + phase))


def step(y, *, edge=0, height=1.0, name="step"):
    rows = len(y) + edge
    u = np.where(np.arange(rows) >= edge, height, 0.0)
    return gb.Experiment(name, TS * np.arange(rows), {"u": u}, {"x": np.concatenate([np.zeros(edge), y])})


@pytest.fixture(scope="module")
def twin():
    return in_micrometres(step_record())


def test_the_grid_is_the_best_of_all_combinations_one_by_one(twin):
    t, y = twin.time[:200], twin.outputs["x"][:200]
    rng = np.random.default_rng(3)
    for _ in range(5):
        values = {
            axis: rng.uniform(*getattr(wang.INTERVALS, axis), size=getattr(FEW, axis))
            for axis in ("amplitude", "ratio", "phase", "frequency", "decay")
        }
        every = [(np.mean((y - equation_17(t, *c)) ** 2), c) for c in product(*values.values())]
        least, chosen = min(every)
        found = search_grid(t, y, values)
        assert found.error == pytest.approx(least, rel=1e-9)
        assert tuple(getattr(found, axis) for axis in values) == pytest.approx(chosen)
    assert len(every) == FEW.combinations


def test_the_papers_numbers_of_draws(twin):
    assert DrawCounts().combinations == 20 * 10 * 10 * 50 * 20
    told = []
    found = monte_carlo_smoothing(twin, seed=1, intervals=wang.INTERVALS, draws=FEW, report=told.append, adjustments=1)
    assert [(p.round, p.evaluation) for p in told] == [(r, k) for r in (1, 2) for k in range(1, 21)]
    assert isinstance(told[0], SmoothingProgress) and told[-1].error == found.error
    assert all(a.error >= b.error for a, b in pairwise(told))  # best so far
    (first, second) = found.rounds
    assert first.intervals == wang.INTERVALS and len(first.candidates) == 20
    # every constant was drawn in its interval, uniformly, independently on each axis
    for axis, (low, high) in vars(wang.INTERVALS).items():
        drawn = [getattr(c, axis) for c in first.candidates]
        assert low <= min(drawn) < max(drawn) <= high
    # figure 1: the intervals are put around the best values
    for axis in TRUE:
        low, high = getattr(second.intervals, axis)
        assert low < getattr(first.best, axis) < high


def test_the_loop_of_figure_1_ends_at_the_specification(twin):
    options = {"seed": 2, "intervals": wang.INTERVALS, "draws": FEW, "evaluations": 5}
    easy = monte_carlo_smoothing(twin, specification=1e3, **options)
    assert easy.met and len(easy.rounds) == 1
    hard = monte_carlo_smoothing(twin, specification=1e-9, adjustments=3, **options)
    assert not hard.met and len(hard.rounds) == 4
    assert hard.error <= easy.error
    same = monte_carlo_smoothing(twin, specification=1e3, **options)
    assert same.coefficients == easy.coefficients  # the seed says it all


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_the_intervals_from_the_data_hold_the_constants(noise):
    t = TS * np.arange(1100)
    y = equation_17(t, **TRUE) + noise * np.random.default_rng(0).standard_normal(1100)
    found = estimate_intervals(t, y, TS, 1024)
    for axis, value in TRUE.items():
        low, high = getattr(found, axis)
        assert low < value < high, axis
    # the frequency's: one bin of 1024 to either side of the spectrum's peak
    bin_width = 2 * np.pi / (1024 * TS)
    peak = find_resonance(*estimate_spectrum(y, TS))
    assert found.frequency == pytest.approx((peak - bin_width, peak + bin_width))
    assert peak / bin_width == pytest.approx(round(peak / bin_width))


@pytest.mark.parametrize("rows", [120, 300, 900])
def test_a_record_shorter_than_the_window_shows_its_frequency_too(rows):
    t = TS * np.arange(rows)
    found = monte_carlo_smoothing(step(equation_17(t, **TRUE)), seed=1, draws=FEW)
    assert found.coefficients["w"] == pytest.approx(TRUE["frequency"], rel=0.03)
    with pytest.raises(gb.errors.DataError, match=r"at least 3 show how the oscillation decays: .* use output_error"):
        monte_carlo_smoothing(step(1 - np.exp(-t / t[rows // 8])), seed=1)


def test_a_step_that_comes_late_and_is_not_one_gives_the_same_constants():
    t = TS * np.arange(900)
    y = equation_17(t, **TRUE)
    plain, moved = (
        monte_carlo_smoothing(step(y, edge=edge, height=h), seed=5, draws=FEW, adjustments=0)
        for edge, h in ((0, 1.0), (37, 2.0))
    )
    assert moved.coefficients == pytest.approx(plain.coefficients, rel=1e-9)
    assert moved.transfer_function.gain == pytest.approx(plain.transfer_function.gain / 2)
    run = moved.simulate(step(y, edge=37, height=2.0), initial="zero")["x"]
    assert run[37:] == pytest.approx(moved.response(t), abs=1e-9) and not run[:37].any()


def test_equation_17_is_its_transfer_function_and_its_difference_equation():
    found = wang.smoothing(ROWS)
    system = control.tf(found.transfer_function.numerator, found.transfer_function.denominator)
    t = TS * np.arange(400)
    assert control.step_response(system, t).outputs == pytest.approx(found.response(t), abs=1e-8)
    assert found.transfer_function.numerator == pytest.approx(wang.S_NUMERATOR, rel=3e-3)  # its constants are rounded
    assert found.transfer_function.denominator == pytest.approx(wang.S_DENOMINATOR, rel=1e-4)
    held = control.sample_system(system, TS, "zoh")
    assert found.model.b[0] == pytest.approx(held.num[0][0], rel=1e-6)
    assert found.model.f[0] == pytest.approx(held.den[0][0], rel=1e-9)
    assert (
        found.jump == pytest.approx(found.transfer_function.feedthrough) == pytest.approx(found.model.feedthrough["u"])
    )


def test_direct_and_smoothed_least_squares_are_plain_least_squares(twin):
    found = wang.smoothing(ROWS)
    rows = compare_numerators(twin, found)
    assert [(r.order, r.lags[0], r.lags[-1]) for r in rows] == list(NUMERATOR_STRUCTURES)
    assert [r.label for r in rows][4] == "b0 b1 b2 over a1 a2"
    y, u = twin.outputs["x"], twin.inputs["u"]

    def lagged(x, by):
        return np.concatenate([np.zeros(by), x[: len(x) - by]])

    for r in rows:
        for source, error in ((y, r.direct), (found.response(twin.time), r.smoothed)):
            if error is None:
                continue
            columns = [-lagged(source, i) for i in range(1, r.order + 1)] + [lagged(u, k) for k in r.lags]
            theta = np.linalg.lstsq(np.column_stack(columns), source, rcond=None)[0]
            run = np.zeros(ROWS)
            for k in range(ROWS):  # the free run from rest, by hand
                past = sum(-theta[i - 1] * run[k - i] for i in range(1, r.order + 1) if k >= i)
                run[k] = past + sum(theta[r.order + j] for j, lag in enumerate(r.lags) if k >= lag)
            assert error == pytest.approx(np.mean((y - run) ** 2), rel=1e-5), r.label
    assert [r.smoothed is None for r in rows] == [True, True, True, False, False, False, False]
    assert "collinear" in rows[0].remark and "unstable" in rows[2].remark


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: gb.Experiment("two", r.time, {"u": np.sin(r.time)}, r.outputs), "'u' changes at .* rows.*one step"),
        (lambda r: gb.Experiment("none", r.time, {"u": 0 * r.time}, r.outputs), "'u' never moves"),
        (lambda r: r.window(0, 20), "20 rows after the step; smoothing needs 32"),
        (
            lambda r: r.with_outputs({"x": np.where(r.time > 0.1, np.nan, r.outputs["x"])}),
            "rows after the step lack 'x'",
        ),
        (lambda r: r.with_outputs({"x": 1 - np.exp(-20 * r.time)}), "does not oscillate"),
        (lambda r: r.with_outputs({"x": np.sin(700 * r.time)}), "not distinguishable from zero"),
    ],
)
def test_what_is_no_oscillating_step_response_is_refused(twin, change, message):
    with pytest.raises(gb.errors.DataError, match=message):
        monte_carlo_smoothing(change(twin), seed=1)


def test_intervals_and_counts_that_cannot_be_are_refused(twin):
    with pytest.raises(gb.errors.DataError, match=r"no parameter 'freqency'.*frequency"):
        monte_carlo_smoothing(twin, seed=1, intervals={"freqency": (700, 800)})
    with pytest.raises(
        gb.errors.DataError, match=r"interval of decay: \[36, 12\]; give two finite numbers, the lower one first"
    ):
        DrawIntervals(amplitude=(28, 31), ratio=(0, 1), phase=(0.5, 1.2), frequency=(739, 785), decay=(36, 12))
    with pytest.raises(gb.errors.DataError, match="0 evaluations"):
        monte_carlo_smoothing(twin, seed=1, evaluations=0)
