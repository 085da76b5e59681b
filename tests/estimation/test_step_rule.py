"""A fit that has ended well never stands on steps that move its constants without a word: plants, ways of solving, methods and substeps."""

from dataclasses import replace

import numpy as np
import pytest

from greybox import FitOptions, fit
from greybox.estimation.findings import STEP_SHIFT, EstimationCode
from tests.estimation.test_never_worse import METHODS, NOISE, driven, stiff

SAID = {EstimationCode.INTEGRATION_TOO_COARSE, EstimationCode.STEP_MOVES_PARAMETERS}
PLANTS = {
    "hardening": lambda: driven(0.3, 4.0, 6.0, 2.0),
    "hardening, few rows": lambda: driven(0.3, 4.0, 6.0, 2.0, period=0.2),
    "two wells": lambda: driven(0.3, -4.0, 6.0, 2.0, rows=120, period=0.05),
    "two wells, few rows": lambda: driven(0.3, -4.0, 6.0, 2.0, rows=120, period=0.15),
    "falling, few rows": lambda: driven(0.3, -4.0, 0.01, 2.0, rows=60, period=0.1),
    "Robertson": lambda: stiff("Robertson"),
    "HIRES": lambda: stiff("HIRES"),
}
STIFF = ("Robertson", "HIRES")
EVERYDAY = ("hardening, few rows", "two wells, few rows")
# At night each plant meets each method, and each of both meets every pair of a transcription and a number of substeps. More of them
# prove nothing new: the rule looks at the constants and the step with which a search has ended.
# Segments of these take longest.
AT_NIGHT = (("hardening", "multiple"), ("Robertson", "multiple"))
WAYS = [("single", 0), ("multiple", 1), ("single", 1), ("multiple", 0)]
CASES = [
    pytest.param(
        *(name, way, method, substeps),
        marks=()
        if name in EVERYDAY and way == "single"
        else pytest.mark.slow
        if name == "HIRES" or (name, way) in AT_NIGHT
        else pytest.mark.rest,
    )
    for i, name in enumerate(PLANTS)
    for j, method in enumerate(METHODS)
    for way, substeps in [WAYS[(i + j) % len(WAYS)]]
]


@pytest.mark.crossed(3)
@pytest.mark.parametrize(("name", "transcription", "method", "substeps"), CASES)
def test_steps_that_move_the_constants_are_said(name, transcription, method, substeps):
    """The oracle is a second fit, from the end of the first one, with half its steps."""
    model, record = PLANTS[name]()
    noise = None if name in STIFF else {"x": NOISE}
    options = FitOptions(at_rest=True, other_starts=0, transcription=transcription, method=method, substeps=substeps)
    found = fit(model, record, noise=noise, options=options)
    if not found.success or SAID & {f.code for f in found.solver.details}:
        return
    used = found.solver.statistics
    finer = replace(options, method=used["method"], substeps=2 * used["substeps"], progressive=False)
    again = fit(found.model, record, noise=found.noise.std, options=finer)
    for name, before in found.parameters.items():
        if before.std and np.isfinite(before.std):
            # A hundredth for what the searches themselves leave.
            assert abs(again.parameters[name].value - before.value) < (STEP_SHIFT + 0.01) * before.std, name
