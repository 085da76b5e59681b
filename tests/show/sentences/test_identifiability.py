"""One golden text for each finding about identifiability, and the texts of its results."""

import pytest

from greybox.base.values import Finding
from greybox.estimation.identifiability.combinations import OpenDirection
from greybox.estimation.identifiability.excitation import Excitation
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode
from greybox.estimation.identifiability.structural import StructuralIdentifiability
from greybox.show.sentences import sentence
from greybox.show.sentences.identifiability import describe_closing

ONE = {"missing": 1, "constants": ["M", "B"], "relations": [{"constants": ["Kf", "Kv"], "equal": True}]}
TWIN = {
    "exchanged": ["ka", "ke"],
    "others": ["V"],
    "values": {"ka": 0.055, "ke": 1.8, "V": 0.0113},
    "units": {"ka": "1/h", "ke": "1/h", "V": "l"},
}
SUM = {"constants": ["tau1", "tau2"], "value": 0.30017, "std": 0.00051, "interval": [0.2992, 0.3012], "unit": "s"}
LAGS = {"exchanged": ["tau1", "tau2"], "others": [], "values": {"tau1": 0.13, "tau2": 0.17}, "sums": [SUM]}
GOLDEN = {
    IdentifiabilityCode.MEASURE_OUTPUT: (
        "",
        {"signals": ["i"], "rank": 6, "count": 7, "then": ONE},
        "measure i as well: 6 of 7 determined; then fix one of M, B; knowing Kf = Kv also suffices",
    ),
    IdentifiabilityCode.ADD_SENSOR: (
        "",
        {"signals": ["x1", "x2"], "rank": 4, "count": 4, "then": {}},
        "add a sensor for x1 or x2: 4 of 4 determined",
    ),
    IdentifiabilityCode.FIX_CONSTANTS: ("", ONE, "fix one of M, B; knowing Kf = Kv also suffices"),
    IdentifiabilityCode.RICHER_RECORD: (
        "",
        {"inputs": ["u"], "outputs": ["x", "i"], "count": 6, "certain": True},
        "a sufficiently rich record from u to x, i determines all 6 free parameters: excite u more strongly and over a wider band",
    ),
    IdentifiabilityCode.NO_INPUT_MOVES: (
        "",
        {},
        "no input moves: only the response to the initial state carries information",
    ),
    IdentifiabilityCode.EXCITATION_ORDER_LOW: (
        "",
        {"inputs": ["u"], "order": 1, "needed": 3},
        "u: persistently exciting of order 1, but the model has 3 coefficients for each output: only transients determine the"
        " rest; use more tones, a sweep or random levels",
    ),
    IdentifiabilityCode.EXCITATION_BAND_NARROW: (
        "",
        {"band": 5.09, "fastest": 80.0},
        "the input excites up to 5.09 rad/s, but the fastest mode of the model is at 80 rad/s; excite up to that frequency",
    ),
    IdentifiabilityCode.RECORDS_SHOW_FEWER: (
        "",
        {"structure": 6, "records": 4, "sensors": ["i", "v"]},
        "any record can determine 6 combinations, these records only 4: use another input, reduce the noise, or measure i or v",
    ),
    IdentifiabilityCode.AVERAGING_ONLY: (
        "",
        {"averaged": 1, "total": 3},
        "1 of 3 combinations are determined only by averaging the noise, which requires white noise and a model error far below"
        " the noise: do not rely on them",
    ),
    IdentifiabilityCode.PRIORS_COUNT: (
        "",
        {"constants": ["K", "M"]},
        "the expected standard deviations count what is known of K, M beforehand; what the records determine without it, the check"
        " without the prior says",
    ),
    IdentifiabilityCode.OTHER_ANSWER: (
        "",
        TWIN | {"told_by": ["depot"], "count": 1},
        "ka and ke may change places (V with them): ka = 0.055 1/h, ke = 1.8 1/h, V = 0.0113 l makes the same run; a bound, a prior or"
        " a sensor for depot decides",
    ),
    IdentifiabilityCode.EXCHANGEABLE: (
        "",
        LAGS | {"equal": True},
        "tau1 and tau2 may change places and are equal within their intervals, which are by profile likelihood; better determined:"
        " tau1 + tau2 = 0.30017 +- 0.00051 s",
    ),
    IdentifiabilityCode.NO_FREE_CONSTANT: ("", {}, "no parameter is free: nothing to determine"),
    IdentifiabilityCode.MODEL_OVERFLOWS: (
        "run",
        {"time": 1.25},
        "at the start values, the model overflows on run after 1.25 s; set other values with --start",
    ),
    IdentifiabilityCode.SIMULATED_RECORD: (
        "",
        {"rows": 1000, "step": 0.01, "inputs": {"u": {"low": -1.0, "high": 1.0, "unit": "V"}}, "noise_share": 0.01},
        "1000 rows every 0.01 s, u random between -1 and 1 V, noise 1 % of each output's movement",
    ),
}


@pytest.mark.parametrize("code", IdentifiabilityCode)
def test_each_code_has_its_sentence(code):
    subject, values, text = GOLDEN[code]
    assert sentence(Finding(code, subject=subject, values=values)) == text


def test_other_answers_without_an_exchange_and_several_of_them():
    square = {"exchanged": [], "others": ["q"], "values": {"q": 0.2}, "units": {"q": "1"}, "told_by": [], "count": 3}
    text = sentence(Finding(IdentifiabilityCode.OTHER_ANSWER, values=square))
    assert text == (
        "there is another answer for q: q = 0.2 makes the same run (3 such answers); a bound, a prior or another sensor decides"
    )
    text = sentence(Finding(IdentifiabilityCode.EXCHANGEABLE, values=LAGS | {"equal": False, "sums": []}))
    assert (
        text
        == "tau1 and tau2 may change places and are near one another, so that their intervals are by profile likelihood"
    )


def test_a_model_without_an_input_is_not_told_to_use_another_one():
    values = {"structure": 2, "records": 1, "driven": False, "sensors": []}
    text = sentence(Finding(IdentifiabilityCode.RECORDS_SHOW_FEWER, values=values))
    assert "use another initial state, reduce the noise" in text and "input" not in text


@pytest.mark.parametrize(
    ("closing", "text"),
    [
        ({}, ""),
        ({"missing": 1, "constants": ["M"], "relations": []}, "fix M"),
        ({"missing": 2, "constants": ["M", "Ra"], "relations": []}, "fix 2 parameters, such as M and Ra"),
        (
            {"missing": 2, "constants": [], "relations": [{"constants": ["a", "b"], "equal": False}]},
            "fix 2 parameters; knowing the ratio a/b replaces one of them",
        ),
    ],
)
def test_closing_parameters_are_listed(closing, text):
    assert describe_closing(closing) == text


@pytest.mark.parametrize(
    ("weights", "scaling", "text"),
    [
        ({"T": 1.0}, True, "T has no influence on the measured outputs"),
        ({"B": 1.0, "Kv": -0.5}, False, "B, Kv compensate for one another"),
        ({"Kf": 1.0, "Ra": 1.0}, True, "Kf, Ra scale together"),
        (
            {"m": 2.0, "l": -1.0, "g": -1.0},
            True,
            "multiplying m by c^2 and dividing l by c and g by c leaves the outputs unchanged, for any c",
        ),
    ],
)
def test_open_directions_are_described(weights, scaling, text):
    assert str(OpenDirection(weights, scaling)) == text


def test_a_structural_result_names_what_is_determined_open_and_missing():
    remedy = Finding(IdentifiabilityCode.FIX_CONSTANTS, values=ONE)
    direction = OpenDirection({"Kf": 1.0, "Ra": 1.0}, True, ("i",))
    names = ("M", "Kf", "Ra")
    result = StructuralIdentifiability(
        "m", ("u",), ("x",), names, False, 2, 3, (direction,), ("M",), (remedy,), 1e9, False, ""
    )
    assert str(result).splitlines() == [
        "from u to x, 2 combinations of the 3 free parameters can be determined, 1 direction stays open; the singular values show no clear"
        " gap, so this is uncertain",
        "  determined  M, 1 more without a simple formula",
        "  open        Kf, Ra scale together: fix one of them, or measure i",
        "  remedy      fix one of M, B; knowing Kf = Kv also suffices",
    ]


def test_excitation_names_order_and_band_of_each_input():
    finding = Finding(IdentifiabilityCode.NO_INPUT_MOVES)
    lines = str(Excitation({"u": 40, "w": 2}, {"u": 100.0, "w": 3.0}, 40, findings=(finding,))).splitlines()
    assert lines == [
        "u: persistently exciting of order 40 or more, band up to 100 rad/s",
        "w: persistently exciting of order 2, band up to 3 rad/s",
        sentence(finding),
    ]
