"""Rows that come only when a reading has changed by a band are told from rows that come irregularly for another reason."""

import numpy as np
import pytest

from greybox.data.experiment import Experiment
from greybox.data.findings import RecordCode
from tests.support.findings import find


def make_record(kind: str) -> Experiment:
    """A lag of 0.5 s behind steps, looked at every 5 ms with a little noise; ``kind`` says which rows there are."""
    rng = np.random.default_rng(2)
    time, drive = 0.005 * np.arange(8000), np.repeat(rng.choice([0.0, 1.0, 3.0, 4.0], 20), 400)
    x, states = 0.0, []
    for u in drive:
        states.append(x)
        x += 0.01 * (u - x)
    readings = np.array(states) + 0.002 * rng.normal(size=len(time))
    kept, last = [], np.inf
    for k, value in enumerate(readings):
        if abs(value - last) > 0.05 if kind == "band" else rng.random() < 0.1 if kind == "random" else k % 20 == 0:
            kept.append(k)
            last = value
    return Experiment.from_arrays(time[kept], {"u": drive[kept]}, {"x": readings[kept]})


@pytest.mark.parametrize(("kind", "is_said"), [("band", True), ("random", False), ("regular", False)])
def test_only_rows_on_a_change_are_said(kind, is_said):
    said = find(make_record(kind).findings, RecordCode.ROWS_ON_CHANGE)
    assert (said is not None) == is_said
    assert said is None or said.values["band"] == pytest.approx(0.05, rel=0.05)
