"""The rows that tell the initial state of a validation record are the same for a fit, a comparison and a discovery, and do not count."""

from __future__ import annotations

import numpy as np
import pytest

import greybox as gb
from tests.discovery.test_adaptation import integrator, make_record

ROWS, BEGINNING = 400, 120


def shifted(seed: int) -> gb.Experiment:
    record = make_record(ROWS, seed)
    return gb.Experiment(record.name, record.time, record.inputs, {"x": record.outputs["x"] + 3.0})


@pytest.fixture(scope="module")
def records() -> tuple[gb.Experiment, gb.Experiment]:
    return shifted(1), shifted(2)


def test_a_fit_counts_the_rows_after_the_beginning(records):
    fit = gb.fit(integrator(), records[0], validation=records[1], beginning=BEGINNING)
    trace = fit.validation.traces[0]
    counted = trace.residual("x")[BEGINNING:]
    assert fit.validation.misfit["x"].samples == ROWS - BEGINNING
    assert fit.validation.misfit["x"].rmse == pytest.approx(np.sqrt(np.mean(counted**2)))
    # The start of the integrator is the mean of what the first rows say, given its gain.
    first = trace.residual("x")[:BEGINNING]
    assert np.mean(first) == pytest.approx(0.0, abs=1e-6)


def test_a_comparison_and_a_fit_have_the_same_error(records):
    fit = gb.fit(integrator(), records[0], validation=records[1], beginning=BEGINNING)
    comparison = gb.compare({"physics": fit}, records[1], training=records[0], beginning=BEGINNING)
    assert comparison["physics"].validation["x"].rmse == pytest.approx(fit.validation.misfit["x"].rmse, rel=1e-9)


def test_more_rows_than_there_are_is_one_sentence(records):
    with pytest.raises(gb.errors.DataError, match="leave out fewer rows"):
        gb.compare([integrator()], records[1], beginning=ROWS)
