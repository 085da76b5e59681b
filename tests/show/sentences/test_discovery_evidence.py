"""A rival that leaves as much in one output: the sentence must not compare two equal figures."""

from types import SimpleNamespace

import pytest

from greybox.discovery.certainty import Grade
from greybox.show.sentences.discovery import _evidence


@pytest.mark.parametrize(
    ("rival_error", "expected"),
    [
        (2.012e-7, "sensor lag in its place leaves as much in x; all outputs together tell the two apart"),
        (9e-7, "sensor lag in its place leaves 0.9 µm instead of 0.201 µm"),
    ],
)
def test_two_equal_figures_are_not_compared(rival_error, expected):
    evidence = SimpleNamespace(
        grade=Grade.ESTABLISHED,
        probability=0.99,
        share=0.99,
        share_interval=(0.98, 1.0),
        output="x",
        unit="m",
        alike=(),
        rival="sensor_lag",
        rival_error=rival_error,
        error=2.009e-7,
        without=2e-5,
        survives_start=True,
        survives_records=True,
        change=0.0,
    )
    assert _evidence(evidence).endswith(expected)
