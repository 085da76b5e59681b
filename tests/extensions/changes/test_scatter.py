"""How far constants scatter where nothing has changed, measured over records, paired pieces or pieces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, wishart

import greybox as gb
from fits.studies.change_study import QUICK, coast_down, coasting
from fits.studies.measured_rigs import rotor
from greybox.extensions.changes import constants
from greybox.extensions.changes.constants import (
    SCATTER_PIECES,
    ConstantsEstimate,
    FittedConstants,
    Yardstick,
    compare_constants,
    cut_records,
    join_estimates,
    measure_scatter,
    read_constants,
    read_residual,
)
from greybox.extensions.changes.detect import is_alike, match_repeats
from greybox.extensions.changes.result import ChangeCode, ChangeVerdict
from tests.support.first_order import first_order
from tests.support.linear_regression import LINE, REST


def test_estimates_are_joined_by_their_information() -> None:
    # 1 with a variance of 1 and 2 with one of 1/4: (1 + 4 * 2) / 5, variance 1/5
    joined = join_estimates(
        [ConstantsEstimate.of(np.array([v]), np.array([[c]])) for v, c in ((1.0, 1.0), (2.0, 0.25))]
    )
    assert joined.values == pytest.approx([9 / 5])
    assert joined.covariance[0, 0] == pytest.approx(1 / 5)


def test_an_estimate_that_leaves_a_constant_open_says_nothing_of_it() -> None:
    one = ConstantsEstimate.of(np.array([1.0, 7.0]), np.diag([1.0, np.inf]))
    other = ConstantsEstimate.of(np.array([3.0, 2.0]), np.diag([1.0, 4.0]))
    assert join_estimates([one, other]).values == pytest.approx([2.0, 2.0])
    assert np.isinf(one.covariance[1, 1])


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("degrees", "correlation"), [(4, 0.0), (4, 0.95), (7, 0.7)])
def test_each_constant_is_held_against_its_own_scatter(degrees: int, correlation: float) -> None:
    # Three constants that go together, scattered about as much as ``degrees`` repeats have shown for each: independent draws by SciPy.
    names, together = ("a", "b", "c"), np.full((3, 3), correlation) + (1 - correlation) * np.eye(3)
    drawn = multivariate_normal(cov=together, seed=1).rvs(200_000)
    scatter = np.diagonal(wishart(degrees, together, seed=2).rvs(200_000), axis1=1, axis2=2) / degrees
    limit = float(np.quantile(np.abs(drawn / np.sqrt(scatter)).max(axis=1), 0.99))
    sides = [
        FittedConstants(
            names, ("", "", ""), np.array([v, 0.0, 0.0]), together / 2, np.zeros(3, bool), (), float(degrees)
        )
        for v in (0.0, limit)
    ]
    test = compare_constants(*sides, names, 0.01, 0.95, degrees)
    # 40,000 draws tell a share of 1 % to a tenth of itself (two deviations); one deviation for all gave 1.5 times as many.
    assert test.p[0] == pytest.approx(0.01, rel=0.15)


def test_records_are_cut_into_pieces_and_short_ones_stay_whole() -> None:
    long, short = (gb.Experiment("run", 0.1 * np.arange(n), {}, {"y": np.zeros(n)}) for n in (400, 25))
    assert [p.rows for p in cut_records([long])] == [50] * SCATTER_PIECES
    assert [p.rows for p in cut_records([short])] == [25]


def coast(seed: int, share: float = 1.0, seconds: float = 0.0) -> gb.Experiment:
    return coast_down(np.random.default_rng(seed), 6.0, 0.4 * share, seconds)


def test_runs_that_end_by_themselves_are_repeats_over_what_both_cover() -> None:
    one, other = coast(1), coast(4)
    assert one.rows != other.rows and is_alike(one, other)
    ((before, after),) = match_repeats([one], [other]).pairs
    assert before.rows == after.rows == min(one.rows, other.rows)


def test_all_records_of_the_motion_that_is_repeated_are_compared_over_the_same_rows() -> None:
    ones, other = [coast(k) for k in (1, 4, 5)], coast(6)
    repeats = match_repeats(ones, [other])
    assert len(repeats.before) == 3 and len(repeats.after) == len(repeats.pairs) == 1
    assert {r.rows for r in (*repeats.before, *repeats.after)} == {min(r.rows for r in (*ones, other))}
    assert not match_repeats(ones, [other, day(1, 2.0)]).pairs


def test_records_that_a_third_links_show_one_motion() -> None:
    t = 0.1 * np.arange(60)
    # Beginnings that differ by 8 % are no repeats, those by 4 % are.
    runs = [gb.Experiment(f"{start}", t, {}, {"w": start * np.exp(-0.2 * t)}) for start in (100.0, 108.0, 104.0, 109.0)]
    assert [is_alike(runs[0], other) for other in runs[1:]] == [False, True, False]
    repeats = match_repeats(runs[:3], runs[3:])
    assert len(repeats.before) == 3 and len(repeats.pairs) == 1


def test_a_run_that_covers_less_than_half_of_the_other_is_no_repeat() -> None:
    one = coast(1)
    assert not is_alike(one, one.window(0, one.rows // 2 - 1))


@pytest.mark.rest
def test_a_coast_down_that_ends_earlier_is_compared_and_a_change_is_named() -> None:
    reference = gb.fit(coasting(), coast(1), options=QUICK)
    healthy = gb.detect_changes(reference, coast(2), search_effects=False)
    assert healthy.verdict is ChangeVerdict.UNCHANGED
    change = gb.detect_changes(reference, coast(3, share=1.2), search_effects=False)
    assert change.verdict is ChangeVerdict.CHANGED and change.moved == ("b",)
    low, high = change.constants["b"].interval
    assert 0 < low < high


@pytest.mark.parametrize("beginning", [0, 30])
def test_pieces_say_how_far_constants_scatter_and_the_fits_what_they_are(beginning: int) -> None:
    # From another speed on it is another motion: then the pieces of each by themselves are the yardstick, and not those of pairs.
    one, other = coast(1), coast(2).window(beginning, coast(2).rows)
    change = gb.detect_changes(gb.fit(coasting(), one, options=QUICK), other, search_effects=False)
    (allowed,) = [f for f in change.findings if f.code == ChangeCode.SCATTER_ALLOWED]
    assert allowed.values["over"] == (Yardstick.PIECES if beginning else Yardstick.PAIRED_PIECES)
    sides = match_repeats([one], [other]).pairs[0] if not beginning else (one, other)
    fits = [gb.fit(coasting(), record, options=QUICK).parameters["b"].value for record in sides]
    # The mean of the pieces lay 8 % below the fits where other motion was compared.
    assert (change.constants["b"].before, change.constants["b"].after) == pytest.approx(fits, rel=1e-6)


def test_a_piece_is_fitted_from_the_constants_of_the_whole_alone(monkeypatch) -> None:
    starts = []

    def fit_noted(model, piece, *, noise, options):
        starts.append((model.values["b"], options.other_starts))
        return gb.fit(model, piece, noise=noise, options=options)

    reference = gb.fit(coasting(), coast(1), options=QUICK)
    monkeypatch.setattr(constants, "fit", fit_noted)
    gb.detect_changes(reference, coast(2), search_effects=False)
    assert len(starts) == 2 * SCATTER_PIECES and {count for _, count in starts} == {0}
    assert len({b for b, _ in starts}) == 2


def test_what_it_writes_is_read_back_and_refitted_to_the_same_constants(tmp_path) -> None:
    reference = gb.fit(coasting(), coast(1), options=QUICK)
    changes = gb.detect_changes(reference, coast(3, share=1.2), search_effects=False)
    written = gb.changes.load_changes(changes.save(tmp_path / "changed.json"))
    # Over the rows that both runs have, as they were compared.
    ((before, after),) = match_repeats([coast(1)], [coast(3, share=1.2)]).pairs
    estimates = [gb.fit(coasting(), record, options=QUICK).parameters["b"].value for record in (before, after)]
    low, high = written["constants"]["b"]["interval"]
    assert low < estimates[1] - estimates[0] < high
    again = gb.fit(coasting(), coast(3, share=1.2), options=QUICK)
    assert again.misfit["w"].rmse == pytest.approx(changes.today.misfit["w"].rmse, rel=0.01)


def day(seed: int, gain: float) -> gb.Experiment:
    """A record of an hour of the first-order plant; noise 0.01."""
    generator = np.random.default_rng(seed)
    t, plant = 0.05 * np.arange(400), first_order(gain)
    u = np.repeat(generator.normal(size=40), 10)
    made = gb.simulate(plant, {"time": t, "u": u})
    return gb.Experiment(f"day {seed}", t, {"u": u}, {"y": made.outputs["y"] + 0.01 * generator.normal(size=400)})


def test_a_machine_that_wanders_from_day_to_day_is_no_changed_machine() -> None:
    # One record leaves the gain open by 0.03 %; from day to day it wanders by 2 %.
    gains = [2.0 * (1 + 0.02 * k) for k in (1.0, -1.0, 0.5, -0.5, 0.8)]
    reference = gb.fit(first_order(), [day(k, g) for k, g in enumerate(gains[:4])], noise={"y": 0.01})
    found = gb.detect_changes(reference, day(9, gains[4]), search_effects=False)
    assert not found.constants["gain"].moved
    assert ChangeCode.SCATTER_ALLOWED in [f.code for f in found.findings]


def test_a_machine_that_does_not_wander_is_compared_as_its_intervals_say() -> None:
    reference = gb.fit(first_order(), [day(k, 2.0) for k in range(3)], noise={"y": 0.01})
    found = gb.detect_changes(reference, day(9, 2.01), search_effects=False)
    assert found.verdict is ChangeVerdict.CHANGED and found.moved == ("gain",)
    assert ChangeCode.SCATTER_ALLOWED not in [f.code for f in found.findings]


@pytest.mark.parametrize("noise", [0.01, 0.02])
def test_days_that_differ_are_no_noise_that_has_grown(noise: float) -> None:
    # The gain wanders by a few per cent: three days happened to be near each other, three of today were not.
    before = [day(k, g) for k, g in enumerate((2.0, 2.002, 1.999))]
    today = []
    for k, gain in enumerate((1.96, 2.05, 2.0), start=10):
        record, generator = day(k, gain), np.random.default_rng(k)
        y = record.outputs["y"] + np.sqrt(noise**2 - 0.01**2) * generator.normal(size=record.rows)
        today.append(gb.Experiment(record.name, record.time, dict(record.inputs), {"y": y}))
    change = gb.detect_changes(gb.fit(first_order(), before, noise={"y": 0.01}), today, search_effects=False)
    grown = [f for f in change.conclusion if f.code == ChangeCode.NOISE_GREW]
    assert (change.verdict is ChangeVerdict.CHANGED) == bool(grown) == (noise > 0.01)
    # By what each day leaves alone, and not with what the days differ by: that is about as much again.
    assert [f.values["ratio"] for f in grown] == pytest.approx([2.0] * len(grown), rel=0.1)


def line_fit(curved: float, seed: int) -> tuple[np.ndarray, gb.Fit]:
    """The design of a line that is measured to one side of zero, and its fit; a negative curvature is stopped at zero."""
    u = np.random.default_rng(3).uniform(1.0, 2.0, 60)
    design = np.column_stack([u, u**2, np.ones(60)])
    y = design @ [1.2, curved, 0.7] + 0.01 * np.random.default_rng(seed).normal(size=60)
    record = gb.Experiment(f"line {seed}", 0.1 * np.arange(60), {"u": u}, {"y": y})
    return design, gb.fit(LINE.start(b=0.1).bound(b=(0.0, 10.0)), record, noise={"y": 0.01}, options=REST)


def test_a_constant_is_known_no_better_than_with_others_off_their_bounds() -> None:
    design, found = line_fit(-0.4, 4)
    read = read_constants(found, read_residual(found, 1.1))
    assert read.at_bound == ("b",) and set(read.narrowed) == {"a", "c"}
    # The normal equations with the curvature free; the misfit of the line that has none widens them.
    free = np.diag(np.linalg.inv(design.T @ design))
    held = np.diag(np.linalg.inv(design[:, [0, 2]].T @ design[:, [0, 2]]))
    stds = [found.parameters[name].std for name in "ac"]
    scale = np.where(read.positive, read.values, 1.0)[read.index("ac")]
    expected = np.array(stds) * np.sqrt(free[[0, 2]] / held) / scale
    assert np.sqrt(read.variances[read.index("ac")]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.rest
def test_a_curvature_at_its_bound_in_one_of_two_fits_moves_no_other_constant() -> None:
    # The same line both times: noise alone takes the small curvature to its bound in some records and off it in others.
    fits = [line_fit(0.01, seed)[1] for seed in range(8)]
    held = [f for f in fits if f.parameters["b"].at_bound]
    free = [f for f in fits if not f.parameters["b"].at_bound]
    assert held and free
    for one in held:
        for other in free:
            change = gb.detect_changes(one, [t.experiment for t in other.traces], search_effects=False)
            assert change.verdict is not ChangeVerdict.CHANGED


def test_a_constant_that_the_whole_record_does_not_determine_is_known_no_better_from_its_pieces(monkeypatch) -> None:
    names, units = ("known", "wide", "seldom"), ("", "", "")
    whole = FittedConstants(
        names, units, np.ones(3), np.diag([0.01, 1.0, 0.01]), np.zeros(3, bool), (), np.inf, undetermined=("wide",)
    )
    generator = np.random.default_rng(1)

    def estimate(fit, pieces, of):
        # Pieces that agree far better than the interval of any of them says; of one constant nearly all say nothing.
        each = [np.diag([0.1, 0.1, 0.1 if k < 2 else np.inf]) for k in range(len(pieces))]
        return [ConstantsEstimate.of(1 + 0.01 * generator.standard_normal(3), covariance) for covariance in each]

    monkeypatch.setattr(constants, "_estimate_each", estimate)
    records = coast(1), coast(2)
    fits = [gb.fit(coasting(), record, options=QUICK) for record in records]
    scatter = measure_scatter(*fits, whole, replace(whole), [match_repeats([records[0]], [records[1]]).pairs[0]])
    assert scatter.yardstick is Yardstick.PAIRED_PIECES and scatter.degrees == SCATTER_PIECES - 1
    variance = scatter.before.variances + scatter.after.variances
    assert variance[0] < 1e-3 and variance[1] >= 2.0 and np.isinf(variance[2])


# Cases of a right model, nothing changed and coloured noise that nobody told, of which a constant was called changed. The pieces of the
# first take three times as long to fit as those of the other.
@pytest.mark.parametrize("seed", [pytest.param(3, marks=pytest.mark.slow), 4])
def test_pieces_in_which_a_constant_stands_at_its_bound_do_not_narrow_the_others(seed: int) -> None:
    generator, records = np.random.default_rng(seed), []
    for k in range(2):
        t, u = 0.014 * np.arange(300), 26 + np.repeat(0.6 * generator.normal(size=12), 25)
        run = gb.simulate(rotor().start(kt=15.0, b=0.5, c=375.0), {"time": t, "u": u}, initial={"w": 30.0})
        noise = np.zeros(300)
        for i in range(1, 300):
            noise[i] = 0.9 * noise[i - 1] + 0.3 * generator.normal()
        records.append(gb.Experiment(f"run {k}", t, {"u": u}, {"w": run.outputs["w"] + noise}))
    change = gb.detect_changes(gb.fit(rotor(), records[0]), records[1], search_effects=False)
    assert change.verdict is ChangeVerdict.CANNOT_TELL and not change.moved
    # What is said of the scatter is of a constant that was compared.
    for finding in change.findings:
        assert finding.code != ChangeCode.SCATTER_ALLOWED or change.constants[finding.subject].interval
