"""Frequency responses and their fits in words."""

import numpy as np

from greybox.base.values import Check
from greybox.comparison.frequency.best_linear_approximation import BestLinearApproximation, LinearityCheck
from greybox.comparison.frequency.response import FrequencyResponse

GOLDEN = {
    LinearityCheck.REALISATIONS_AGREE: (
        "the spread of the response over realisations is 573 times the noise (limit 1.13): the system is nonlinear"
    ),
    LinearityCheck.EVEN_LINES_ARE_NOISE: "even lines that are not excited hold 573 times the noise (limit 1.13): the system is nonlinear",
    LinearityCheck.ODD_LINES_ARE_NOISE: "odd lines that are not excited hold 573 times the noise (limit 1.13): the system is nonlinear",
}


def test_each_test_of_linearity_says_what_it_found():
    for rule, text in GOLDEN.items():
        assert str(Check(rule, 573.0, 1.13, False)) == text
        assert str(Check(rule, 1.0, 1.13, True)).endswith("noise alone")


def test_a_response_names_its_points_and_signals():
    points = FrequencyResponse([1.0, 20.0], np.ones((2, 1, 1)), ("u",), ("x",), name="sweep")
    assert str(points) == "sweep: 2 points from 1 to 20 Hz, u to x, without variance"


def test_an_approximation_tells_noise_from_distortion():
    unit = np.ones(2)
    check = Check(LinearityCheck.REALISATIONS_AGREE, 100.0, 1.2, False)
    result = BestLinearApproximation(
        "u",
        "y",
        np.array([1.0, 3.0]),
        unit + 0j,
        1e-4 * unit,
        1e-2 * unit,
        4,
        6,
        None,
        None,
        (check,),
    )
    lines = str(result).splitlines()
    assert lines[0] == "best linear approximation, u to y: 2 lines from 1 to 3 Hz, 4 realisations of 6 periods"
    assert lines[1] == "  noise of the response: -40.0 dB of its power"
    assert lines[2] == "  nonlinear distortion of one realisation: -14.0 dB"
    assert lines[3].endswith("the system is nonlinear")
