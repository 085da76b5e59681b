"""The verdict and the answer: what the checks of the selection and the evidence for each effect allow to be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from greybox.discovery.certainty import Grade
from greybox.discovery.decision import Conclusion, Verdict, make_check
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.policy import CertaintyPolicy


def weigh_evidence(conclusion: Conclusion, evidence: Sequence[EffectEvidence], policy: CertaintyPolicy) -> Conclusion:
    """The verdict once the form of each effect was tested: a name is certain only where it is established.

    A model whose residual is noise is ``named`` only if every effect is established. Where some are, and the residual is not noise or
    other effects are doubtful, the verdict is ``partly``; where none is, ``unknown``. Sets that the records cannot tell apart stay
    ``ambiguous``.
    """
    if conclusion.verdict is Verdict.COMPLETE or not evidence:
        return conclusion if conclusion.verdict is not Verdict.NAMED else replace(conclusion, verdict=Verdict.UNKNOWN)
    checks = tuple(
        make_check(DiscoveryRule.ESTABLISHED, e.probability, policy.established, e.grade is Grade.ESTABLISHED, e.effect)
        for e in evidence
    )
    established = [check.passed for check in checks]
    verdict = conclusion.verdict
    if verdict is Verdict.NAMED and not all(established):
        verdict = Verdict.UNKNOWN
    if verdict is Verdict.UNKNOWN and any(established):
        verdict = Verdict.PARTLY
    return Conclusion(verdict, (*conclusion.checks, *checks))
