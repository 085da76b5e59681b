"""The text of a check."""

import numpy as np
import pytest

from greybox.data.signals import multisine
from greybox.estimation.check import check
from greybox.estimation.identifiability.combinations import OpenDirection
from greybox.show import text
from greybox.simulation.simulate import simulate
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox

NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.fixture(scope="module")
def lines():
    time = 2.5e-4 * np.arange(2000)
    run = simulate(micro_actuator, {"time": time, "u": multisine(time, 5, 800, 2, np.random.default_rng(0))})
    found = check(micro_actuator, run.record(NOISE, np.random.default_rng(1)), noise=NOISE)
    return text(found, 200, details=True).splitlines()


@pytest.mark.parametrize(
    "line",
    [
        "units           every term has the unit of its balance",
        "noise           x 200 nm, i 5 mA; given",
        "input           u: persistently exciting of order 40 or more, band up to 5.03e+03 rad/s",
        "identifiability from any record: from u to x, i, 6 combinations of the 7 free parameters can be determined, 1 direction"
        " stays open",
        "  not determined: M, B, K, Kf scale together",
        "  remedy: fix one of M, B, K, Kf; knowing Kf = Kv also suffices",
        "  parameter  start value  expected std      unit",
    ],
)
def test_a_check_is_printed_line_by_line(lines, line):
    assert line in lines


def test_a_check_answers_first_and_fits_a_screen(lines):
    assert lines[0] == (
        "These records determine 3 of the 7 free parameters of micro_actuator to 0.78 % or better (Kv); M, B, K and Kf stay open."
    )
    short = str(check(micro_actuator)).splitlines()
    assert len(short) <= 22 and max(map(len, short)) <= 80


def test_a_model_without_free_parameters_has_nothing_to_determine():
    found = check(silverbox.fix(*silverbox.values))
    assert str(found).splitlines()[0] == "silverbox: no parameter is free: nothing to determine."


def test_a_check_without_records_says_what_was_assumed():
    found = check(micro_actuator.fix("M"))
    lines = text(found, details=True).splitlines()
    assert "records         none given; simulated at the start values:" in lines
    assert lines[0].startswith("A record such as this one determines every free parameter of micro_actuator")
    assert not any(isinstance(d, OpenDirection) for d in found.open_directions)
