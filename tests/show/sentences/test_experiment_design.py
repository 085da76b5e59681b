"""Golden texts of a design and a campaign."""

from __future__ import annotations

import pytest

from greybox.base.values import Finding
from greybox.extensions.design.document import name_alternative
from greybox.extensions.design.problem import Alternative, AlternativeKind, CampaignCode, DesignCode
from greybox.show.sentences import sentence

GOLDEN = [
    (
        Finding(
            DesignCode.CONSTANT_NOT_DETERMINED,
            subject="M, K",
            values={"constants": ["M", "K"], "remedies": ["measure i as well: 5 of 5 determined", "fix one of M, K"]},
        ),
        "no input within these limits determines M and K: measure i as well: 5 of 5 determined; or fix one of M, K",
    ),
    (
        Finding(DesignCode.CONSTANT_NOT_DETERMINED, subject="M", values={"constants": ["M"], "remedies": []}),
        "no input within these limits determines M: fix it, or add a sensor",
    ),
    (
        Finding(DesignCode.WOULD_NOT_DECIDE, subject="a | b", values={"cost": 3.21, "limit": 20.0}),
        "a | b: the wrong one would lose by a cost of 3.21 only, and 20 are needed to decide; widen the limits, take a longer record,"
        " or add a sensor",
    ),
    (
        Finding(DesignCode.NO_EARLIER_RECORD, values={"spread": 0.2}),
        "no record was taken yet: each constant is assumed to be known to 20 %; keep the limits on the safe side, and design again"
        " after the first record",
    ),
    (Finding(DesignCode.LIMIT_RULES, subject="x"), "the limit of x decides how large the input may be"),
    (
        Finding(DesignCode.RANGE_FROM_RECORDS, subject="u", values={"low": -1.0, "high": 2.0}),
        "input u has no limits of its own: it stays between -1 and 2, as in the records; give --limit to change that",
    ),
    (
        Finding(DesignCode.MODEL_FALLS_SHORT, values={"fault": "the model follows only 48 % of q"}),
        "the model follows only 48 % of q. The ranges predicted here are those of this model, not of the rig: find what it lacks first"
        " (greybox discover), or keep the limits well inside what the rig stands",
    ),
    (
        Finding(CampaignCode.MEASURE, subject="rig/01/input.csv", values={"record": "rig/01/record.csv"}),
        "play rig/01/input.csv on the rig, write the record to rig/01/record.csv, and run the same command again",
    ),
    (
        Finding(CampaignCode.ONE_LEFT, values={"effects": ["a", "b"], "width": 0.036}),
        "one explanation is left: a + b; its widest 95 % interval is 3.6 % to each side",
    ),
    (
        Finding(CampaignCode.ONE_LEFT, values={"effects": [], "width": None}),
        "one explanation is left: the plain model",
    ),
    (
        Finding(
            CampaignCode.BUDGET_SPENT, values={"effects": ["a"], "alternatives": [["b"], []], "verdict": "ambiguous"}
        ),
        "every experiment is spent; left: a or b or the plain model. Allow more with --experiments, or widen the limits in another"
        " folder",
    ),
    (
        Finding(CampaignCode.BUDGET_SPENT, values={"effects": [], "alternatives": [], "verdict": ""}),
        "every experiment is spent; left: the plain model, verdict none. Allow more with --experiments, or widen the limits in another"
        " folder",
    ),
    (
        Finding(CampaignCode.LIMIT_BROKEN, subject="x", values={"value": 0.31, "low": None, "high": 0.3, "number": 2}),
        "experiment 2: the rig took x to 0.31, beyond its limit of 0.3. The record is kept; look at the rig, then go on with the"
        " same command",
    ),
]


@pytest.mark.parametrize(("finding", "text"), GOLDEN)
def test_a_design_says(finding: Finding, text: str) -> None:
    assert sentence(finding) == text


def test_every_code_is_here() -> None:
    assert {finding.code for finding, _ in GOLDEN} == {*DesignCode, *CampaignCode}


def test_alternatives_are_named() -> None:
    named = {kind: name_alternative(Alternative(kind, "7", 1.234)) for kind in AlternativeKind}
    spectrum = Alternative(AlternativeKind.INPUT, "multisine with optimal spectrum", 0.6)
    assert name_alternative(spectrum) == "multisine input with optimal spectrum"
    assert list(named.values()) == [
        "7 input",
        "this record 7 times",
        "a record of 7 s",
        "a row every 7 s",
        "with a sensor for 7",
    ]
