"""Published problems with known optima: fits from the published starts end there, with the standard errors of least squares."""

import pytest

from fits.studies.published_problems import PROBLEMS, fit_from

pytestmark = pytest.mark.rest

# A narrow valley into which no damped step leads from so far: a fit says that it has not explained the data.
FAR = {("MGH17", 0)}
# These take seconds, and the other start of each is searched from with every change.
LONG = {("MGH10", 0), ("Rat42", 0)}
CASES = [(name, k) for name, problem in PROBLEMS.items() for k in range(len(problem.starts)) if (name, k) not in FAR]


@pytest.mark.parametrize(
    ("name", "start"), [pytest.param(*case, marks=pytest.mark.slow if case in LONG else ()) for case in CASES]
)
def test_the_published_optimum_is_reached_from_the_published_start(name, start):
    ended = fit_from(name, PROBLEMS[name].starts[start])
    assert ended.reached, (ended.status, ended.ratio)
    # three digits; there is none for data without noise
    assert not ended.standard_error > 1e-3


@pytest.mark.parametrize(("name", "start"), sorted(FAR))
def test_a_fit_that_ends_elsewhere_says_so(name, start):
    ended = fit_from(name, PROBLEMS[name].starts[start])
    assert ended.reached or ended.warned
