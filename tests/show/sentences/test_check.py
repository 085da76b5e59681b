"""The text of a check."""

import numpy as np
import pytest

from greybox.data.signals import multisine
from greybox.estimation.check import check
from greybox.estimation.identifiability.combinations import OpenDirection
from greybox.simulation.simulate import simulate
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox

NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.fixture(scope="module")
def lines():
    time = 2.5e-4 * np.arange(2000)
    run = simulate(micro_actuator, {"time": time, "u": multisine(time, 5, 800, 2, np.random.default_rng(0))})
    return str(check(micro_actuator, run.record(NOISE, np.random.default_rng(1)), noise=NOISE)).splitlines()


@pytest.mark.parametrize(
    "line",
    [
        "units           every term has the unit of its balance",
        "noise           x 2e-07 m, i 0.005 A; given",
        "input           u: persistently exciting of order 40 or more, band up to 5.03e+03 rad/s",
        "identifiability from any record: from u to x, i, 6 combinations of the 7 free parameters can be determined, 1 direction"
        " stays open",
        "  not determined: M, B, K, Kf scale together",
        "  remedy: fix one of M, B, K, Kf; knowing Kf = Kv also suffices",
        "expected precision from these records, near the start values:",
        "  parameter  start value  expected std      unit",
    ],
)
def test_a_check_is_printed_line_by_line(lines, line):
    assert line in lines


def test_a_check_fits_a_screen(lines):
    places = lines.index(next(line for line in lines if line.startswith("roles ")))
    assert places < 25 and len(lines) < 65


def test_a_model_without_free_parameters_has_nothing_to_determine():
    text = str(check(silverbox.fix(*silverbox.values)))
    assert text.splitlines()[-1] == "parameters      no parameter is free: nothing to determine"


def test_a_check_without_records_says_what_was_assumed():
    found = check(micro_actuator.fix("M"))
    lines = str(found).splitlines()
    assert "records         none given; simulated at the start values:" in lines
    assert lines[-1] == "every free parameter is determined"
    assert not any(isinstance(d, OpenDirection) for d in found.open_directions)
