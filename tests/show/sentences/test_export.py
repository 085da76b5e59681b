"""The sentences about exported models, one golden text for each code."""

from __future__ import annotations

import pytest

import greybox as gb
from greybox.base.values import Finding
from greybox.estimation.linear.exported_model import ExportFinding as Code
from greybox.show import text as write
from models.micro_actuator import micro_actuator

FRICTION = {"effects": ["coulomb_friction"], "state": "v", "level": 0.1, "held": 0.0589, "unit": "N"}
KINK = {"effects": ["dead_zone"], "model": "rig", "variable": "u", "value": 0.5, "unit": "V", "side": "above"}
REMOVED = {"states": 3, "of": 5, "unreached": ["p_b"], "unobserved": ["T"]}

SENTENCES = {
    Code.FIT_FAILED: (
        Finding(Code.FIT_FAILED, values={"status": "failed"}),
        "the fit failed (the solver failed): do not use its parameters",
    ),
    Code.NO_EQUILIBRIUM: (
        Finding(
            Code.NO_EQUILIBRIUM,
            values={
                "point": "x = 1e-05 m, u = 0 V",
                "imbalance": [{"balance": "force", "value": -0.05896, "unit": "N"}],
            },
        ),
        "x = 1e-05 m, u = 0 V is not an equilibrium (out of balance: force by -0.05896 N): the linear model holds for deviations"
        " from the motion through this point",
    ),
    Code.STEADY_MOTION: (
        Finding(Code.STEADY_MOTION, subject="s", values={"speed": 0.04727, "unit": "m/s", "others_rest": True}),
        "the operating point is a steady motion, not an equilibrium: s moves at 0.04727 m/s, all other states are at rest",
    ),
    Code.OUTSIDE_RECORDS: (
        Finding(
            Code.OUTSIDE_RECORDS,
            values={"signals": [{"name": "u", "value": 9.0, "unit": "V", "low": -1.0, "high": 1.0}]},
        ),
        "the operating point is far outside the estimation records: u = 9 V (records: -1 to 1 V); the parameters may not be valid"
        " there",
    ),
    Code.FRICTION_LEFT_OUT: (
        Finding(Code.FRICTION_LEFT_OUT, subject="coulomb_friction", values=FRICTION),
        "coulomb_friction cannot be linearised at v = 0, where it holds up to 0.1 N, of which 0.0589 N are used; the matrices"
        " describe the sliding body without friction; treat friction as a disturbance of up to 0.1 N, or compensate it",
    ),
    Code.KINK: (
        Finding(Code.KINK, subject="u", values=KINK),
        "dead_zone cannot be linearised at u = 0.5 V: the derivative is discontinuous there; the derivative above this point is"
        " used",
    ),
    Code.PLAY_CLOSED: (
        Finding(Code.PLAY_CLOSED, subject="backlash", values={"state": "z"}),
        "backlash cannot be linearised: z either stays or moves with the plant; the play is assumed to be closed, as in a large"
        " motion in one direction",
    ),
    Code.INPUT_BETWEEN_ROWS: (
        Finding(Code.INPUT_BETWEEN_ROWS, subject="linear_input"),
        "linear_input says what the input did between the rows of the record; a step from sample to sample holds its input, so its"
        " outputs differ from those of the fit. Step it at a shorter interval, with the input that acts there",
    ),
    Code.ABOUT_THE_MEANS: (
        Finding(Code.ABOUT_THE_MEANS, values={"inputs": {"d": 0.45, "ps": 2e5}}),
        "no operating point was chosen: it is linearised about the means of the inputs in the records, d = 0.45, ps = 2e+05; at= (shell:"
        " --at NAME=VALUE) gives another",
    ),
    Code.ABOUT_THE_BEGINNING: (
        Finding(Code.ABOUT_THE_BEGINNING, values={"inputs": {"valve": 5.0}}),
        "no operating point was chosen: it is linearised about the inputs at which a record begins, valve = 5; at= (shell: --at NAME=VALUE)"
        " gives another",
    ),
    Code.ABOUT_A_RUN: (
        Finding(Code.ABOUT_A_RUN, subject="r1", values={"share": 0.994}),
        "the plant is run from outside: the linear model is its answer to small changes of the inputs along r1, of which it follows 99% at"
        " least",
    ),
    Code.INPUT_WITHOUT_EFFECT: (
        Finding(
            Code.INPUT_WITHOUT_EFFECT, subject="u", values={"value": 0.2, "unit": "V", "effects": ["input_dead_zone"]}
        ),
        "input 'u' has no effect at u = 0.2 V (input_dead_zone), so its gain is zero; choose an operating point with another u",
    ),
    Code.DELAY_APPROXIMATED: (
        Finding(Code.DELAY_APPROXIMATED, subject="u", values={"delay": 5e-4, "order": 4, "limit": 10800.0}),
        "the delay of 0.0005 s of u is a Pade approximation of order 4, accurate up to about 1.08e+04 rad/s; use a sampled model"
        " (dt) for the exact delay",
    ),
    Code.STATES_REMOVED: (
        Finding(Code.STATES_REMOVED, values=REMOVED),
        "the minimal realisation has 3 of 5 states; removed: p_b (not controllable); T (not observable)",
    ),
    Code.MODE_UNDERSAMPLED: (
        Finding(Code.MODE_UNDERSAMPLED, values={"dt": 2e-3, "frequency": 767.9, "samples": 4.09, "proposed": 8.2e-4}),
        "the sampling time 0.002 s is too long for the mode at 767.9 rad/s: one period has only 4.1 samples; use 0.00082 s or"
        " less",
    ),
    Code.DECAY_UNDERSAMPLED: (
        Finding(Code.DECAY_UNDERSAMPLED, values={"dt": 1.0, "time_constant": 0.5, "proposed": 0.1}),
        "the sampling time 1 s is too long: every mode decays within one sample (the slowest in 0.5 s); use 0.1 s or less",
    ),
    Code.TUSTIN_RINGS: (
        Finding(Code.TUSTIN_RINGS, values={"dt": 2.5e-4, "pole": -16000.0, "proposed": 1.25e-4}),
        "Tustin's method at 0.00025 s maps the pole at -1.6e+04 1/s to one that alternates from sample to sample; use zoh, or"
        " 0.00013 s or less",
    ),
    Code.PARAMETERS_NOT_DRAWN: (
        Finding(Code.PARAMETERS_NOT_DRAWN, values={"parameters": ["La", "Kv"]}),
        "La, Kv: no covariance (at a bound, or not determined by the records); kept at the fitted value",
    ),
}


@pytest.mark.parametrize("code", Code)
def test_each_code_has_its_sentence(code: Code) -> None:
    finding, sentence = SENTENCES[code]
    assert str(finding) == sentence


def test_a_linear_model_prints_its_point_matrices_poles_and_channels() -> None:
    model = gb.linearise(micro_actuator, {"u": 1.0})
    text = write(model, details=True)
    assert str(model).splitlines()[0] == "micro_actuator as a linear model, continuous, with 3 states: it is stable."
    for part in (
        "  A = ",
        "natural frequency",
        "u -> x: gain",
        "bandwidth (-3 dB)",
    ):
        assert part in text
