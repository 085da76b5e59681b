"""The benchmark compares like with like: the peers' right-hand sides are those of the models."""

import math

import numpy as np
import pytest

from fits.benchmarks import ours, problems
from fits.benchmarks.rates import Mathematics, make_rate, make_rk4

PLAIN = Mathematics(math.tanh, math.sqrt, max, lambda condition, yes, no: yes if condition else no)


@pytest.mark.parametrize("name", problems.CASES)
def test_the_peers_take_the_same_step(name):
    case = problems.CASES[name](400)
    system, p = case.truth.system, np.array(list(case.truth.values.values()))
    advance = make_rk4(make_rate(name, PLAIN), len(system.state_names))
    rng = np.random.default_rng(2)
    scale = np.maximum(np.abs(np.asarray(system.start_function(p)[0]).ravel()), 1e-2)
    h = float(case.experiment.intervals[0]) / case.substeps
    for _ in range(20):
        x, u = scale * rng.uniform(0.5, 1.1, len(scale)), rng.uniform(-5, 5)
        theirs = np.array(advance(tuple(x), u, p, h))
        assert theirs == pytest.approx(case.step.advance(x, u, u, p, h).full().ravel(), rel=1e-12)


@pytest.mark.parametrize("name", problems.CASES)
def test_starts_are_off_and_the_fit_ends_at_the_noise(name):
    case = problems.CASES[name](2000)
    assert all(0.25 <= abs(f - 1) <= 0.5 for f in case.wrong)
    problem = ours.prepared(case)
    solution = ours.solve(problem, ours.options(case))
    assert solution.status.success
    assert 0.9 < math.sqrt(solution.evaluation.cost / solution.evaluation.count) < 1.1
    assert solution.strategy.subject == "single" and solution.strategy.values["shares"][-1] == 1
