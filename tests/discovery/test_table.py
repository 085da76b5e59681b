"""Sets of effects whose records are drawn again: against least squares that are solved anew, and where the right set is known."""

from itertools import zip_longest
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.claims import Weights
from greybox.discovery.holdout import HoldoutScores, ValidationSet
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.table import RIDGE, BlockSums, FitTable, FittedSet, _judge_draws, _keep_whole
from greybox.model.effect import formula_effect
from greybox.model.signals import Parameter
from models.micro_actuator import micro_actuator
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records
from tests.support.stage import STAGE


def sums_of(jacobian, residual, blocks):
    """The sums of a linear model with one output: rows (N, n) and residuals (N,) cut into blocks."""
    rows = np.array_split(np.arange(len(residual)), blocks)
    square = np.array([[residual[r] @ residual[r]] for r in rows])
    gradient = np.array([[jacobian[r].T @ residual[r]] for r in rows])
    curvature = np.array([[jacobian[r].T @ jacobian[r]] for r in rows])
    count = np.array([[len(r)] for r in rows])
    wide = np.full(jacobian.shape[1], np.inf)
    return BlockSums(square, count, gradient, curvature, -wide, wide, len(wide), np.zeros(blocks, bool), np.ones(1))


def test_a_resample_is_refitted_as_least_squares_are():
    rng = np.random.default_rng(3)
    jacobian, residual = rng.standard_normal((120, 3)), rng.standard_normal(120)
    sums = sums_of(jacobian, residual, 6)
    drawn = np.array([[2.0, 0, 1, 0, 3, 0]])
    rows = np.repeat(np.arange(120), np.repeat([2, 0, 1, 0, 3, 0], 20))
    # |r + J s|^2 + |s|^2 by a solver that knows nothing of blocks.
    full = np.vstack([jacobian[rows], np.sqrt(RIDGE) * np.eye(3)])
    expected = np.linalg.lstsq(full, -np.concatenate([residual[rows], np.zeros(3)]), rcond=None)[0]
    (step,) = sums.refit(drawn, np.ones(1))
    assert step == pytest.approx(expected, rel=1e-10)
    left = residual + jacobian @ step
    expected = [np.mean(part**2) for part in np.array_split(left, 6)]
    assert sums.mean_squares(step[None])[0, :, 0] == pytest.approx(expected, rel=1e-10)


def test_a_run_that_nearly_goes_astray_is_refitted_too():
    """Two constants that do the same, with slopes beside which the ridge is lost in rounding: their sum follows the residual."""
    huge = 1e12 * np.ones((40, 2))
    sums = sums_of(huge, -3e12 * np.ones(40), 4)
    (step,) = sums.refit(np.ones((1, 4)), np.ones(1))
    assert step.sum() == pytest.approx(3.0, rel=1e-6)
    assert sums.mean_squares(step[None]) == pytest.approx(0.0, abs=1e-9 * 9e24)


def test_a_step_stays_within_the_bounds():
    sums = sums_of(np.ones((10, 1)), -5 * np.ones(10), 2)
    bounded = BlockSums(**{**vars(sums), "low": np.array([-1.0]), "high": np.array([0.5])})
    assert bounded.refit(np.ones((1, 2)), np.ones(1)) == pytest.approx(0.5)


def judge(squares, free, effects=(), laws=()):
    """Winner and good sets of one resample that left every block out; ``squares`` (S, B)."""
    squares = np.asarray(squares, float)[:, None, :, None]
    count = np.ones((squares.shape[2], 1))
    each = zip_longest(free, effects, laws, fillvalue=())
    sets = tuple(FittedSet(SimpleNamespace(free=n, effects=e, laws=law), None) for n, e, law in each)
    return _judge_draws(sets, squares, np.ones((1, squares.shape[2]), bool), count)


def test_of_equal_sets_the_one_with_fewest_constants_wins():
    rng = np.random.default_rng(1)
    noise = 1 + 0.1 * rng.standard_normal((3, 24))
    draws = judge([noise[0], noise[1], 4 * noise[2]], (7, 5, 4))
    assert draws.winner.tolist() == [1] and draws.good.tolist() == [[True, True, False]]


def test_a_set_that_helps_in_a_few_blocks_is_not_given_up():
    rest = np.ones(24) + 0.01 * np.random.default_rng(2).standard_normal(24)
    stop = rest.copy()
    stop[[3, 9, 10, 15, 20]] = 0.05
    assert judge([rest, stop], (5, 6)).winner.tolist() == [1]


def test_a_set_that_goes_astray_in_one_block_is_not_good_for_its_large_spread():
    rest = np.ones(24) + 0.01 * np.random.default_rng(2).standard_normal(24)
    astray = 3 * rest
    astray[5] = 1000.0
    assert judge([rest, astray], (6, 5)).winner.tolist() == [0]


@pytest.mark.parametrize(
    ("laws", "more", "winner"),
    [
        ([], 9.0, 1),
        ([("k*v**3",), ("k*v",)], 9.0, 0),
        ([("k*v**3",), ("k*v",)], 0.09, 1),
        ([("k*v",), ("k*v",)], 9.0, 1),
    ],
    ids=["effects", "formulas", "formulas that hardly differ", "one formula"],
)
def test_an_effect_is_not_as_exact_as_its_name_but_a_formula_is(laws, more, winner):
    """The simpler one leaves more than the noise of 1 in every block: 9 is (3 %)^2 of what both take, 0.09 cannot be seen."""
    noise = np.ones(24) + 0.01 * np.random.default_rng(5).standard_normal(24)
    draws = judge([noise, noise + more, noise + 1e4], (7, 6, 5), [("one",), ("other",)], laws)
    assert draws.winner.tolist() == [winner]


def test_a_set_whose_run_breaks_off_takes_no_part():
    rng = np.random.default_rng(4)
    whole = FittedSet(SimpleNamespace(free=2, effects=()), sums_of(rng.standard_normal((40, 2)), np.ones(40), 4))
    broken = sums_of(rng.standard_normal((40, 2)), np.ones(40), 4)
    # Its last block was not reached: no error there, which is no good error.
    broken.square[3], broken.count[3] = 0.0, 0
    assert _keep_whole([whole, FittedSet(whole.candidate, broken)]) == [whole]
    assert _keep_whole([]) == []


@pytest.fixture(scope="module")
def table():
    """Fits of a rig with dry friction: the plain model, the friction, quadratic damping."""
    first, second = simulate_records(micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, (2e-7, 5e-3), rows=800)
    problem = DiscoveryProblem(plain_model(micro_actuator), (first,), {"x": 2e-7, "i": 5e-3}, (), AT_REST)
    table = FitTable(HoldoutScores(problem, ValidationSet((second,))))
    plain = problem.baseline.model
    table.add(problem.baseline)
    for name, start in (("coulomb_friction", {"Fc": 0.02}), ("quadratic_damping", {"B2": 1.0})):
        table.add(problem.refit_best(plain + gb.effect(name), [{**plain.values, **start}]))
    return table


def test_the_effect_that_is_there_wins_when_records_are_drawn_again(table):
    draws = table.draw(table.leading(()))
    assert draws.sets[Weights.of(draws).leading].candidate.effects == ("coulomb_friction",)
    assert np.mean(draws.winner == Weights.of(draws).leading) > 0.95
    assert np.array_equal(draws.winner, table.draw(table.leading(())).winner)  # the same each time


def test_of_two_fits_of_a_set_the_better_one_stays(table):
    best = table.get(["coulomb_friction"])
    worse = table.scores.problem.refit_best(best.model, [{**best.model.values, "Fc": 0.2}], 1, 1)
    assert worse.cost > best.cost
    table.add(worse)
    assert table.get(["coulomb_friction"]) is best


def test_sums_are_those_of_a_run_of_the_kernel(table):
    fit = table.get(["coulomb_friction"])
    sums = table.sums(fit)
    run = table.scores.run(fit)
    for k, output in enumerate(("x", "i")):
        of_run = np.nansum((run.traces[0].residual(output) / table.scores.problem.noise_std[output]) ** 2)
        assert sums.square[sums.is_judging, k].sum() == pytest.approx(of_run, rel=1e-6)


def test_of_two_laws_each_is_what_is_left_without_the_other():
    """Both effects are called a law; what they say is another thing."""

    def law(name, formula):
        return formula_effect(name, "force", formula, [Parameter("k", "N*s/m" if formula == "k*v" else "N/m", -1.0)])

    def fitted(*laws):
        model = STAGE
        for k, formula in enumerate(laws):
            model = model + law("law" if not k else "law_2", formula)
        problem = SimpleNamespace(experiments=())
        names = tuple(f"law_{k}" for k in range(len(laws)))
        return SimpleNamespace(model=model, given=(), cost=1.0, noise_ratio=1.0, problem=problem, effects=names)

    table = FitTable(SimpleNamespace(problem=SimpleNamespace(experiments=())))
    both, of_speed, of_place = fitted("k*v", "k*x"), fitted("k*v"), fitted("k*x")
    table.add(of_speed, of_place, both)
    assert table.without(both, "law_2") is of_speed
    assert table.without(both, "law") is of_place
    assert table.without(of_place, "law") is None  # the plain model is not there
