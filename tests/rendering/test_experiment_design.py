"""Golden texts of a design."""

from __future__ import annotations

import pytest

from greybox.experiment_design.findings import DesignCode
from greybox.experiment_design.result import Alternative, AlternativeKind
from greybox.findings import Finding
from greybox.rendering import sentence
from greybox.rendering.experiment_design import gain_text, name_alternative

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
        "no input within these limits determines M: fix one of them, or add a sensor",
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
]


@pytest.mark.parametrize(("finding", "text"), GOLDEN)
def test_a_design_says(finding: Finding, text: str) -> None:
    assert sentence(finding) == text


def test_every_code_is_here() -> None:
    assert {finding.code for finding, _ in GOLDEN} == set(DesignCode)


def test_alternatives_are_named() -> None:
    named = {kind: name_alternative(Alternative(kind, "7", 1.234)) for kind in AlternativeKind}
    assert list(named.values()) == [
        "7 input",
        "this record 7 times",
        "7 s instead",
        "a row every 7 s",
        "with a sensor for 7",
    ]
    assert gain_text(Alternative(AlternativeKind.REPEAT, "2", 1.234)) == "1.23 times as much"
