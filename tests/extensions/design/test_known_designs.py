"""Optimal experiments that are known from textbooks, or by trying everything."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.data.signals import SignalLimit
from greybox.extensions.design.inputs import compress_multisine
from greybox.extensions.design.plant import make_plant
from greybox.extensions.design.problem import DesignPolicy, DesignProblem
from greybox.extensions.design.search import choose_sampling_times, weigh_optimally
from tests.support.first_order import box_lucas, first_order, rooney_biegler

REST = gb.FitOptions(at_rest=True)
POLICY = DesignPolicy()


def question(model, duration, step, **more) -> DesignProblem:
    output = model.outputs[0].name
    return DesignProblem((model,), {"u": SignalLimit(-1, 1)}, duration, step, {output: 0.01}, options=REST, **more)


def test_the_sampling_times_of_box_and_lucas() -> None:
    """``t = 1.23, 6.86`` for ``k = 0.7, 0.2`` (Box and Lucas 1959; Atkinson, Donev and Tobias 2007, section 17.2)."""
    asked = question(box_lucas(), 20.0, 0.02)
    chosen = choose_sampling_times(asked, {"u": np.zeros(asked.rows)})
    assert chosen.times == pytest.approx((1.23, 6.86), rel=0.02)
    assert chosen.weights == pytest.approx((0.5, 0.5), rel=0.02)


def test_the_sampling_times_of_rooney_and_biegler() -> None:
    """Against the best pair of times, from the slopes of ``asymptote (1 - exp(-rate t))`` written out."""
    asymptote, rate, end = 15.0, 0.5, 10.0
    asked = question(rooney_biegler(asymptote, rate), end + 0.02, 0.02)
    chosen = choose_sampling_times(asked, {"u": np.zeros(asked.rows)})
    time = asked.time
    slopes = np.stack([1 - np.exp(-rate * time), asymptote * time * np.exp(-rate * time)])
    volume = np.abs(np.outer(slopes[0], slopes[1]) - np.outer(slopes[1], slopes[0]))
    early, late = sorted(np.unravel_index(volume.argmax(), volume.shape))
    assert chosen.times == pytest.approx((time[early], time[late]), rel=0.02)


@pytest.mark.rest
def test_a_quadratic_is_sampled_at_its_ends_and_its_middle() -> None:
    """Fedorov's first example: D-optimal weights of a polynomial of second degree on [-1, 1]."""
    x = np.linspace(-1, 1, 201)
    rows = np.stack([np.ones_like(x), x, x**2], axis=1)
    weights = weigh_optimally(np.einsum("ki,kj->kij", rows, rows), iterations=20_000)
    for at in (-1.0, 0.0, 1.0):
        assert weights[np.abs(x - at) < 0.03].sum() == pytest.approx(1 / 3, rel=0.02)


def test_weights_of_pieces_that_leave_a_constant_open_are_refused() -> None:
    with pytest.raises(DataError, match="do not determine every constant"):
        weigh_optimally(np.array([np.diag([1.0, 0.0]), np.diag([2.0, 0.0])]))


def test_the_best_power_spectrum_of_a_first_order_lag_is_one_line() -> None:
    """Of all spectra of one power that at ``1 / (sqrt(3) lag)`` determines gain and lag best (Goodwin and Payne 1977, section 6.4)."""
    lag = 0.5
    asked = question(first_order(lag=lag), 400.0, 0.1)
    plant = make_plant(asked, asked.model)
    frequencies = np.geomspace(0.2, 2.0, 23) / (np.sqrt(3) * lag)
    lines = [plant.run({"u": np.sin(w * asked.time)}).information for w in frequencies]
    weights = weigh_optimally(np.array(lines))
    centre = np.exp(np.sum(weights * np.log(frequencies)))
    assert centre * np.sqrt(3) * lag == pytest.approx(1.0, rel=0.02)
    best = np.linalg.det(np.tensordot(weights, np.array(lines), 1))
    # det = (rows / 2 / noise^2)^2 gain^4 x / (1 + x)^4 at x = 1/3, along the logarithms of both
    known = (asked.rows / 2 / 0.01**2) ** 2 * 2.0**4 * (1 / 3) / (4 / 3) ** 4
    assert best == pytest.approx(known, rel=0.02)


def test_a_refined_input_of_a_first_order_lag_is_as_good_as_the_best_of_all_binary_ones() -> None:
    """The determinant within 2 % of the best of 2^14 inputs that are tried one by one."""
    rows, step, gain, lag = 14, 0.2, 2.0, 0.5
    policy = replace(POLICY, soft_start=0.0, rest_share=0.0, starts=4, refined_scenarios=0, least_rows=8, scenarios=0)
    asked = {"limits": {"u": (-1, 1)}, "duration": rows * step, "sampling_time": step, "noise": {"y": 0.01}}
    design = gb.design(first_order(gain, lag), **asked, options=REST, policy=policy)

    u = np.array(list(itertools.product([-1.0, 1.0], repeat=rows)))
    fade, late = np.exp(-step / lag), step / lag**2 * np.exp(-step / lag)
    y, slope = np.zeros((2, len(u)))
    total = np.zeros((len(u), 2, 2))
    played = np.zeros((2, 2)), 0.0, 0.0
    mine = design.experiment.inputs["u"]
    for k in range(rows):
        along = np.stack([y, lag * slope], axis=1)
        total += along[:, :, None] * along[:, None, :]
        m, a, b = played
        played = (
            m + np.outer([a, lag * b], [a, lag * b]),
            fade * a + gain * (1 - fade) * mine[k],
            (fade * b + late * a - gain * late * mine[k]),
        )
        y, slope = fade * y + gain * (1 - fade) * u[:, k], fade * slope + late * y - gain * late * u[:, k]
    best = np.sqrt(np.linalg.det(total).max())
    assert np.sqrt(np.linalg.det(played[0])) >= 0.98 * best


@pytest.mark.parametrize("lines", [10, 15, 31])
def test_the_crest_factor_of_a_flat_multisine_is_that_of_one_sine(lines: int) -> None:
    """The infinity-norm search of Guillaume et al. (1991) comes to about 1.4; Schroeder's phases (1970) give 1.6 and more."""
    harmonics = np.arange(1, lines + 1)
    phases = compress_multisine(harmonics, np.ones(lines), 800)
    time = np.arange(64 * lines) / (64 * lines)

    def crest(phase):
        signal = np.cos(2 * np.pi * np.outer(time, harmonics) + phase).sum(axis=1)
        return float(np.abs(signal).max() / np.sqrt(np.mean(signal**2)))

    assert crest(phases) <= 1.42
    assert crest(phases) < 0.9 * crest(-np.pi * harmonics * (harmonics - 1) / lines)
