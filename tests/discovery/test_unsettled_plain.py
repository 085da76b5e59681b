"""A plain model whose fit has not settled is not called complete; one whose fit had ended in a worse optimum is said to have."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.discovery import conclusion, discover
from greybox.discovery.decision import Verdict
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import RefitComparison
from greybox.discovery.pipeline import find_stuck_start
from greybox.simulation.simulate import simulate_twin
from tests.support.first_order import first_order

NOISE = {"y": 0.01}


def make_record(seed):
    rng = np.random.default_rng(seed)
    model = first_order()
    drive = np.repeat(rng.choice([0.0, 1.0, 2.0], 20), 20)
    return simulate_twin(model, {model.inputs[0].name: drive}, 0.05, NOISE, seed, name=f"record {seed}")


@pytest.mark.rest
@pytest.mark.parametrize("settled", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_fit_that_has_not_settled_is_not_complete(settled, monkeypatch):
    moved = [{"output": "y", "records": "estimation", "before": 0.01, "after": 0.02, "unit": ""}]
    if not settled:
        monkeypatch.setattr(
            conclusion, "finish_fit", lambda _, fit, *__: RefitComparison(fit, is_settled=False, errors=moved)
        )
    found = discover(first_order(), make_record(1), validation=make_record(2), noise=NOISE, effects=())
    assert found.verdict is (Verdict.COMPLETE if settled else Verdict.UNKNOWN)
    said = [f.code for f in found.conclusion]
    assert said == [DiscoveryCode.NOTHING_MISSING if settled else DiscoveryCode.PLAIN_UNSETTLED]
    assert any(c.rule == DiscoveryRule.SETTLED and not c.passed for c in found.checks) == (not settled)


@pytest.mark.parametrize(("before", "after", "stuck"), [(12.0, 1.0, True), (1.02, 1.0, False), (math.inf, 1.0, False)])
def test_a_worse_optimum_is_said(before, after, stuck):
    begun = SimpleNamespace(noise_ratio=before, is_noise_bounded=False)
    plain = SimpleNamespace(misfit={"y": SimpleNamespace(noise_ratio=after)}, model=SimpleNamespace(title="rig"))
    finding = find_stuck_start(begun, plain)
    assert (finding is not None) == stuck
    assert finding is None or finding.values == {"before": before, "after": after, "bounded": False}
