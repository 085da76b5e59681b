"""The sentences of a comparison, one golden text for each code."""

from __future__ import annotations

import numpy as np
import pytest

from greybox.base.values import Finding
from greybox.comparison.result import ComparisonFinding as Code

PHYSICS = {"name": "mass", "kind": "grey", "parameters": 2}
ARX = {"name": "arx", "kind": "black", "parameters": 5}
BEST = {
    "measure": "free_run",
    "records": "validation",
    "unit": "m",
    "model": PHYSICS,
    "error": 0.002,
    "other_kind": "black",
}
RIVAL = {"rival": ARX, "rival_error": 0.005, "equally_good": False, "tolerance": 0.02}
HEAD = "y, free run on the validation records: mass (grey box, 2 parameters) is best, 2 mm."

SENTENCES = {
    Code.BEST_MODEL: (
        Finding(Code.BEST_MODEL, subject="y", values=BEST | RIVAL),
        f"{HEAD} The best black box, arx (black box, 5 parameters), has 2.5 times the error.",
    ),
    Code.UNSTABLE_MODELS: (Finding(Code.UNSTABLE_MODELS, values={"models": ["arx", "oe"]}), "Unstable: arx, oe."),
    Code.FEEDTHROUGH_MODELS: (
        Finding(Code.FEEDTHROUGH_MODELS, values={"models": ["arx"]}),
        "Direct feed-through within one sample: arx. A plant with inertia has none; it represents a delay or the input between"
        " the samples.",
    ),
    Code.BIC_OF_DIFFERENT_OUTPUTS: (
        Finding(Code.BIC_OF_DIFFERENT_OUTPUTS, values={"outputs": {"a": ["y"], "b": ["y", "z"]}}),
        "BIC is summed over the outputs of each model (a: y; b: y, z). Compare it only between models of the same outputs.",
    ),
    Code.FAILED_FITS: (
        Finding(Code.FAILED_FITS, values={"models": ["mass"]}),
        "The fit failed: mass. Do not judge the model by these errors.",
    ),
    Code.FAILED_MODELS: (
        Finding(Code.FAILED_MODELS, values={"models": ["arx", "armax"]}),
        "Failed, and no part of this comparison: arx, armax. Each follows an output worse than a constant does.",
    ),
    Code.WORSE_THAN_CONSTANT: (
        Finding(Code.WORSE_THAN_CONSTANT, subject="p", values={"error": 2.1e5, "movement": 1.5e5, "unit": "Pa"}),
        "failed: its free run of p over the records that it was fitted to errs by 210 kPa, where a constant errs by 150 kPa",
    ),
    Code.DIVERGED: (
        Finding(Code.DIVERGED, subject="p", values={"error": np.inf, "movement": 1.5e5, "unit": "Pa"}),
        "failed: its free run of p over the validation records leaves all bounds, where a constant errs by 150 kPa",
    ),
    Code.FIT_FAILED: (
        Finding(Code.FIT_FAILED, subject="mass", values={"status": "interrupted"}),
        "the fit failed: interrupted: the result is the best point so far",
    ),
    Code.PREDICTION_FILTER: (
        Finding(Code.PREDICTION_FILTER, subject="mass", values={"filter": "process noise on v"}),
        "predictions are corrected by process noise on v",
    ),
    Code.NO_BLACK_BOX: (Finding(Code.NO_BLACK_BOX, subject="y", values={"reason": "too few rows"}), "too few rows"),
    Code.RECORD_RESAMPLED: (
        Finding(Code.RECORD_RESAMPLED, subject="bench", values={"sampling_time": 0.05}),
        "bench: resampled to 0.05 s for the black boxes, which need a uniform sampling time",
    ),
    Code.MEASURED_ROWS_ONLY: (
        Finding(Code.MEASURED_ROWS_ONLY, subject="T", values={"sampling_time": 1.0}),
        "T: the black boxes use only the measured rows, every 1 s",
    ),
    Code.NO_STATE_SPACE: (
        Finding(Code.NO_STATE_SPACE, values={"reason": "60 rows are too few"}),
        "no state-space model of all inputs and outputs (60 rows are too few)",
    ),
}


@pytest.mark.parametrize("code", Code)
def test_each_code_has_its_sentence(code: Code) -> None:
    finding, sentence = SENTENCES[code]
    assert str(finding) == sentence


@pytest.mark.parametrize(
    ("values", "end"),
    [
        ({}, " There is no black box to compare with."),
        (RIVAL | {"equally_good": True}, " arx (black box, 5 parameters) is equally good within 2 %."),
    ],
)
def test_a_best_model_without_a_worse_rival(values: dict[str, object], end: str) -> None:
    assert str(Finding(Code.BEST_MODEL, subject="y", values=BEST | values)) == HEAD + end
