"""Records of a few samples: intervals from residuals that the fit itself has shortened, and what is said of them."""

import numpy as np
import pytest
from scipy import stats

from greybox.estimation.fit_issues import EstimationCode
from greybox.estimation.sandwich import estimate_residual_colour, estimate_short_colour, sum_scores
from tests.support.findings import find


class Unknowns:
    """Three unknowns of one record."""

    size = 3

    @staticmethod
    def columns(experiment: int) -> np.ndarray:
        return np.arange(3)


def draw(generator: np.random.Generator, rows: int, rho: float) -> np.ndarray:
    """A stationary autoregression of order one with variance one."""
    noise = generator.normal(size=rows)
    for k in range(1, rows):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise


def coverage(rows: int, rho: float, trials: int = 200) -> tuple[float, float]:
    """How often a 95 % interval of the curvature of a parabola holds it, and how often the residual is called coloured."""
    generator, time = np.random.default_rng(3), np.linspace(0, 1, rows)
    design = np.column_stack([np.ones(rows), time, time**2])
    inverse, held, coloured = np.linalg.inv(design.T @ design), 0, 0
    for _ in range(trials):
        noise = draw(generator, rows, rho)
        estimate = inverse @ design.T @ noise
        pairs = [((noise - design @ estimate)[:, None], design[:, None, :])]
        colour = estimate_residual_colour(pairs, 3, noise_given=False)
        sums = sum_scores(Unknowns, pairs, colour)
        middle, degrees = (sums.coloured, colour.degrees) if colour.coloured else (sums.white, rows - 3)
        reach = stats.t.ppf(0.975, degrees) * np.sqrt((inverse @ middle @ inverse)[2, 2])
        held, coloured = held + (abs(estimate[2]) <= reach), coloured + colour.coloured
    return held / trials, coloured / trials


@pytest.mark.parametrize(("rows", "rho", "least"), [(20, 0.5, 0.82), (20, 0.8, 0.75), (30, 0.8, 0.81), (45, 0.8, 0.84)])
def test_intervals_of_short_records_allow_for_a_correlated_residual(rows: int, rho: float, least: float) -> None:
    """Taken for white they held 0.79, 0.59, 0.49 and 0.48."""
    assert coverage(rows, rho)[0] > least


@pytest.mark.parametrize("rows", [12, 30])
def test_white_noise_of_a_short_record_stays_white(rows: int) -> None:
    held, coloured = coverage(rows, 0.0)
    assert held == pytest.approx(0.95, abs=0.045) and coloured < 0.12


def test_the_correlation_that_a_fit_took_from_its_residual_is_found_again() -> None:
    generator, time = np.random.default_rng(8), np.linspace(0, 1, 40)
    design = np.column_stack([np.ones(40), time, time**2])
    shown, restored = [], []
    for _ in range(200):
        residual = draw(generator, 40, 0.8)
        residual -= design @ np.linalg.lstsq(design, residual, rcond=None)[0]
        shown.append(residual[1:] @ residual[:-1] / (residual @ residual))
        restored.append(estimate_short_colour(residual, design)[0].autocorrelation(2)[1])
    assert np.mean(shown) < 0.65
    assert np.median(restored) == pytest.approx(0.8, abs=0.1)


def test_records_are_not_correlated_across_their_gap() -> None:
    generator = np.random.default_rng(2)
    ends = [draw(generator, 20, 0.9) for _ in range(2)]
    apart = estimate_short_colour(np.concatenate(ends), np.ones((40, 1)), [20])
    assert apart[0].order == 1 and np.isfinite(apart[1])


def test_a_fit_of_a_few_samples_says_what_they_cannot_show() -> None:
    from greybox import fit
    from tests.support.linear_regression import LINE, NOISE, REST, regression

    data, _, _ = regression(louder=0.8)
    for rows, words in (
        (12, "too few to show whether the residual is white"),
        (3, "nothing is left to judge the fit by"),
    ):
        said = find(
            fit(LINE, data.window(0, rows), noise={"y": NOISE}, options=REST).findings, EstimationCode.FEW_SAMPLES
        )
        assert said.values["unknowns"] == 3 and words in str(said)
    whole = fit(LINE, data, noise={"y": NOISE}, options=REST)
    assert EstimationCode.FEW_SAMPLES not in [f.code for f in whole.findings]
