"""What is proposed for an effect that is not established: an experiment only where the records do not separate it from another one."""

import math

import pytest

from greybox.discovery.certainty import Grade
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.policy import CertaintyPolicy
from greybox.discovery.proposals import explain_doubt
from tests.discovery.test_certainty import CLEAR


def evidence(alike=(), rival="quadratic_damping", **measures):
    measures = CLEAR | measures
    return EffectEvidence(
        *("cubic_damping", 0.4, Grade.STAND_IN, "y", "V", 1.0, 0.1, 0.9, (0.8, 0.95), rival, 0.5, tuple(alike)),
        *(measures["change"], True, True, measures),
    )


@pytest.mark.parametrize(
    ("weak", "code", "values"),
    [
        (evidence(alike=["drive_lag", "fitted_curve"]), DiscoveryCode.SEPARATE_FROM_RIVAL, {"rival": "drive_lag"}),
        (evidence(rival_t=2.0), DiscoveryCode.SEPARATE_FROM_RIVAL, {"rival": "quadratic_damping"}),
        (evidence(change=0.6), DiscoveryCode.FIT_HALVES_ALONE, {"change": 0.6}),
        (evidence(structure=0.99), None, None),
        (evidence(change=math.nan), None, None),
        (evidence(rival="", rival_t=-1.0), None, None),
    ],
    ids=[
        "others do the same",
        "a rival within chance",
        "it changes between the halves",
        "much is left, and the rival is far behind",
        "a half could not be fitted",
        "no rival",
    ],
)
def test_an_experiment_is_asked_for_only_where_the_records_do_not_separate(weak, code, values):
    step = explain_doubt(weak, CertaintyPolicy())
    assert (step.code, step.subject, dict(step.values)) == (code, "cubic_damping", values) if code else step is None
