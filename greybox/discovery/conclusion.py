"""The verdict and the answer: what the checks of the selection and the evidence for each effect allow to be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from greybox.discovery.certainty import CERTAINTY_ESTABLISHED, Grade, grade_effect, to_features
from greybox.discovery.decision import Conclusion, Verdict, make_check
from greybox.discovery.evidence import EffectEvidence
from greybox.discovery.findings import DiscoveryRule
from greybox.discovery.surrogate_effects import CURVE


def weigh_evidence(conclusion: Conclusion, evidence: Sequence[EffectEvidence]) -> Conclusion:
    """The verdict once the form of each effect was tested: a name is certain only where it is established.

    A model whose residual is noise is ``named`` only if every effect is established. Where some are, and the residual is not noise or
    other effects are doubtful, the verdict is ``partly``; where none is, ``unknown``. Sets that the records cannot tell apart stay
    ``ambiguous``, and so is a model whose effects fall short of certainty by nothing but an equal of the catalogue.
    """
    if conclusion.verdict is Verdict.COMPLETE or not evidence:
        return conclusion if conclusion.verdict is not Verdict.NAMED else replace(conclusion, verdict=Verdict.UNKNOWN)
    checks = tuple(
        make_check(
            DiscoveryRule.ESTABLISHED, e.probability, CERTAINTY_ESTABLISHED, e.grade is Grade.ESTABLISHED, e.effect
        )
        for e in evidence
    )
    established = [check.passed for check in checks]
    verdict = conclusion.verdict
    if verdict is Verdict.NAMED and not all(established):
        certain = [sure or _is_tied(e) for e, sure in zip(evidence, established, strict=True)]
        verdict = Verdict.AMBIGUOUS if all(certain) else Verdict.UNKNOWN
    if verdict is Verdict.AMBIGUOUS and any(e.grade is Grade.STAND_IN for e in evidence):
        verdict = Verdict.UNKNOWN
    if verdict is Verdict.UNKNOWN and any(established):
        verdict = Verdict.PARTLY
    return Conclusion(verdict, (*conclusion.checks, *checks))


def list_tied_sets(evidence: Sequence[EffectEvidence]) -> list[tuple[str, ...]]:
    """The sets of effects that would do the same as those of the model, with one of them replaced by its equal."""
    names = [e.effect for e in evidence]
    return [
        tuple(other if name == e.effect else name for name in names)
        for e in evidence
        for other in e.alike
        if other != CURVE
    ]


def _is_tied(evidence: EffectEvidence) -> bool:
    """Whether the effect would be established if no other effect of the catalogue did the same."""
    if not evidence.alike or CURVE in evidence.alike:
        return False
    return grade_effect(evidence.probability, to_features(evidence.measures), False) is Grade.ESTABLISHED
