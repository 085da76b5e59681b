"""The sentences about black-box models, one golden text for each code."""

from __future__ import annotations

import pytest

import greybox as gb
from greybox.base.values import Finding
from greybox.comparison.blackbox.polynomial import BlackBoxFinding as Code

SENTENCES = {
    Code.WEAK_EXCITATION: (
        Finding(Code.WEAK_EXCITATION, subject="u", values={"order": 6, "required": 8}),
        "input 'u' is persistently exciting of order 6 (as 3 sines are), but the structure needs order 8: only transients and"
        " noise determine the remaining coefficients; use a smaller structure or a richer input",
    ),
    Code.UNSTABLE: (
        Finding(Code.UNSTABLE, subject="y", values={"pole": 1.02, "growth_samples": 50.498, "equation_error": True}),
        "the model is unstable: its outermost pole lies at |z| = 1.02, and a free run grows by a factor of e every 50.5 samples;"
        " likely causes: more noise on the output than the structure allows for (use an output-error or ARMAX model, or"
        " focus='simulation'), or an integrating plant, whose pole lies at 1",
    ),
    Code.SEARCH_UNFINISHED: (
        Finding(Code.SEARCH_UNFINISHED, values={"iterations": 100}),
        "the search stopped after 100 iterations without convergence",
    ),
}


@pytest.mark.parametrize("code", Code)
def test_each_code_has_its_sentence(code: Code) -> None:
    finding, sentence = SENTENCES[code]
    assert str(finding) == sentence


def test_a_linear_model_prints_equation_coefficients_and_poles() -> None:
    model = gb.blackbox.PolynomialModel(
        "armax",
        "y",
        ("u", "v"),
        0.1,
        (1, 0),
        ([0, 1.0], [0.5]),
        a=[1, -0.5],
        c=[1, 0.2],
        samples=100,
        units={"y": "mm"},
    )
    text = str(model)
    assert text.splitlines()[:2] == [
        "armax(1, [1 1], 1, [1 0]) of y from u, v, every 0.1 s",
        "A(q) y(k) = B1(q) u(k) + B2(q) v(k) + C(q) e(k)",
    ]
    assert "poles: 0.5" in text
    assert "noise: 0 mm one step ahead, over 100 equations" in text


def test_a_transfer_function_prints_as_a_fraction() -> None:
    function = gb.blackbox.ContinuousTransferFunction([2.0], [1.0, -3.0, 4.0], 0.5)
    assert str(function) == "(2) / (1 s^2 - 3 s + 4) e^(-0.5 s)"
