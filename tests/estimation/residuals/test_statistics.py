"""Statistics that are written out here, against SciPy's."""

import numpy as np
import pytest
from scipy.stats import f_oneway, jarque_bera, levene, probplot

from greybox.estimation.residuals import equal_mean_test, equal_variance_test, normality_test
from greybox.show.figures.fit import expect_normal_order


def blocks(seed: int) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [generator.standard_t(4, size=n) * s + m for n, s, m in ((30, 1, 0), (80, 1.5, 0.3), (12, 0.7, -0.2))]


@pytest.mark.parametrize("seed", range(4))
def test_statistics_are_those_of_scipy(seed):
    parts = blocks(seed)
    for ours, theirs in (
        (equal_mean_test(parts), f_oneway(*parts)),
        (equal_variance_test(parts), levene(*parts, center="median")),
        (normality_test(parts[1]), jarque_bera(parts[1])),
    ):
        np.testing.assert_allclose(ours, (theirs.statistic, theirs.pvalue), rtol=1e-10)


def test_blocks_that_do_not_vary_within_themselves_have_an_answer():
    ones, twos = np.ones(10), np.r_[np.full(9, 2.0), 2.0]
    assert equal_mean_test([np.r_[ones, 3.0], np.r_[ones, 3.0]]) == (0.0, 1.0)
    assert equal_variance_test([ones, twos]) == (0.0, 1.0)


@pytest.mark.parametrize("count", [1, 2, 9, 1000])
def test_the_order_of_a_normal_sample_is_that_of_scipy(count):
    values = np.random.default_rng(0).normal(size=count)
    np.testing.assert_allclose(expect_normal_order(count, np.arange(count)), probplot(values, fit=False)[0], atol=1e-12)
