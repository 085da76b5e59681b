"""How the numbers of a fit are printed: value and interval to the digits of the uncertainty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from greybox import Experiment, FitOptions, fit
from greybox.base.values import Finding, Severity
from greybox.data.noise.noise_model import NoiseSource
from greybox.data.signals import multisine
from greybox.estimation.findings import EstimationCode
from greybox.estimation.result import ResultCode, _finding
from greybox.estimation.result_parts import FitNoise, FitUncertainty
from greybox.show.sentences.wording import format_with_std, make_formatter
from greybox.simulation.simulate import simulate
from models.silverbox import silverbox


@pytest.mark.parametrize(
    ("value", "std", "text", "low", "high"),
    [
        (1.22405, 0.0002, "1.22405 +- 0.00020", "1.22366", "1.22444"),
        (4677.73, 0.63, "4677.73 +- 0.63", "4676.50", "4678.96"),
        (1.2e-5, 3e-8, "1.2000e-05 +- 3.0e-08", "1.1941e-05", "1.2059e-05"),
        (2.5e7, 1e3, "2.50000e+07 +- 1.0e+03", "2.49980e+07", "2.50020e+07"),
        (0.0, 1e-3, "0.0000 +- 0.0010", "-0.0020", "0.0020"),
        (651.0, 584.0, "651 +- 584", "-494", "1796"),
    ],
)
def test_an_interval_has_the_digits_of_the_uncertainty(value, std, text, low, high):
    assert format_with_std(value, std) == text
    write = make_formatter(value, std)
    assert (write(value - 1.96 * std), write(value + 1.96 * std)) == (low, high)
    assert write(math.inf) == "inf"


def test_both_ends_of_a_printed_interval_differ_from_the_value_and_units_are_tidy():
    time = np.arange(400) * 1e-3
    generator = np.random.default_rng(1)
    u = multisine(time, 1, 150, 0.05, generator)
    run = simulate(silverbox, {"time": time, "u": u})
    y = run.outputs["y"]
    record = Experiment("run", time, {"u": u}, {"y": y + 1e-4 * np.std(y) * generator.standard_normal(len(y))})
    found = fit(silverbox, record, options=FitOptions(at_rest=True))
    assert "**" not in str(found)
    lines = {line.split()[0]: line for line in str(found).splitlines() if "+-" in line}
    assert set(lines) == set(found.uncertainty.free)
    for name, line in lines.items():
        value, low, high = (
            float(t) for t in (line.split()[1], *line[line.index("[") + 1 : line.index("]")].split(", "))
        )
        exact = found.parameters[name].interval
        assert low < value < high
        assert (high - low) == pytest.approx(exact[1] - exact[0], rel=0.05)


@pytest.mark.parametrize(
    ("noise", "text"),
    [
        (FitNoise({"x": 0.1}, {"x": NoiseSource.GIVEN}), "given"),
        (
            FitNoise({"x": 0.1, "i": 2.0}, {"x": NoiseSource.GIVEN, "i": NoiseSource.DIFFERENCES}),
            "x: given; i: at most differences of the records, if the noise is white",
        ),
        (
            FitNoise({"x": 0.1}, {"x": NoiseSource.INNOVATIONS}, {}, {"x": 0.05}, {"x": "m"}),
            "x: 0.1 [0.0907, 0.11] m from the innovations",
        ),
        (
            FitNoise({"x": 0.1}, {"x": NoiseSource.INNOVATIONS}, {}, {"x": math.inf}, {"x": "m"}),
            "x: 0.1 (poorly determined) m from the innovations",
        ),
    ],
)
def test_the_noise_of_a_fit_says_where_it_is_known_from(noise, text):
    assert str(noise) == text


def test_a_finding_of_another_version_is_named_by_its_code():
    finding = Finding(ResultCode.FOREIGN_FINDING, Severity.WARNING, "x", {"code": "sensor_upside_down"})
    assert str(finding) == "x: the file holds a finding that this version has no sentence for (sensor_upside_down)"


def test_a_result_says_what_its_model_states_otherwise_now():
    values = {"fitted": "force [N] M dv/dt = F - B v", "now": "force [N] M dv/dt = F - 2 B v"}
    assert str(Finding(ResultCode.OTHER_MODEL, Severity.WARNING, "rig", values)) == (
        "the model rig is not the one that was fitted: force [N] M dv/dt = F - B v (fitted), force [N] M dv/dt = F - 2 B v (now);"
        " its intervals and errors are those of the fitted one"
    )
    assert str(Finding(ResultCode.OTHER_CONSTANT, subject="M", values={"fitted": 1.0, "now": 2.0, "unit": "kg"})) == (
        "M was 1 kg in the fit and is 2 kg in the model now: the result keeps 1 kg; repeat the fit with the new value"
    )


@pytest.mark.parametrize("values", [{}, {"share": "much"}, {"share": None}, {"share": [1]}, {"count": {}, "share": 0}])
@pytest.mark.parametrize("code", EstimationCode)
def test_a_finding_whose_figures_this_version_cannot_say_is_named_by_its_code(code, values):
    data = {"code": str(code), "severity": "warning", "subject": "x", "values": values}
    finding = _finding(data)
    assert str(finding) and (finding.code == code or finding.values == {"code": str(code)})


def test_the_widening_is_that_of_the_constants_that_are_determined():
    """An open constant has no factor, which must not be printed as one."""
    factors = {"a": math.nan, "b": 2.0, "c": math.inf}
    assert FitUncertainty(("a", "b", "c"), np.eye(3), inflation=factors).largest_inflation == 2.0
    assert FitUncertainty(("a",), np.eye(1), inflation={"a": math.nan}).largest_inflation == 1.0
