"""What is said of a design: the input, what it should bring, its limits, and what would bring more."""

from __future__ import annotations

from collections.abc import Sequence

from greybox.base import Finding
from greybox.extensions.design.problem import CampaignCode, DesignCode
from greybox.show.sentences.registry import register
from greybox.show.sentences.wording import join_names, percent_text


def _not_determined(finding: Finding) -> str:
    names = finding.values["constants"]
    remedies = finding.values["remedies"]
    rest = "; or ".join(remedies) or f"fix {'it' if len(names) == 1 else 'one of them'}, or add a sensor"
    return f"no input within these limits determines {join_names(names)}: {rest}"


def name_explanation(effects: Sequence[str]) -> str:
    """The effects of an explanation, or that it is the plain model."""
    return " + ".join(effects) or "the plain model"


def _one_left(finding: Finding) -> str:
    width = finding.values["width"]
    intervals = f"; its widest 95 % interval is {percent_text(width, 2)} to each side" if width is not None else ""
    return f"one explanation is left: {name_explanation(finding.values['effects'])}{intervals}"


def _budget_spent(finding: Finding) -> str:
    best = name_explanation(finding.values["effects"])
    others = [name_explanation(a) for a in finding.values["alternatives"]]
    left = f"{best} or {' or '.join(others)}" if others else f"{best}, verdict {finding.values['verdict'] or 'none'}"
    return (
        f"every experiment is spent; left: {left}. Allow more with --experiments, or widen the limits in another folder"
    )


def _limit_broken(finding: Finding) -> str:
    v = finding.values
    ends = " to ".join(f"{e:g}" for e in (v["low"], v["high"]) if e is not None)
    return (
        f"experiment {v['number']}: the rig took {finding.subject} to {v['value']:.4g}, beyond its limit of {ends}. The record is kept;"
        " look at the rig, then go on with the same command"
    )


register(
    {
        CampaignCode.MEASURE: "play {subject} on the rig, write the record to {record}, and run the same command again",
        CampaignCode.ONE_LEFT: _one_left,
        CampaignCode.BUDGET_SPENT: _budget_spent,
        CampaignCode.LIMIT_BROKEN: _limit_broken,
        DesignCode.CONSTANT_NOT_DETERMINED: _not_determined,
        DesignCode.WOULD_NOT_DECIDE: (
            "{subject}: the wrong one would lose by a cost of {cost:.3g} only, and {limit:g} are needed to decide; widen the limits, take"
            " a longer record, or add a sensor"
        ),
        DesignCode.NO_EARLIER_RECORD: lambda f: (
            f"no record was taken yet: each constant is assumed to be known to {100 * f.values['spread']:.0f} %; keep the limits"
            " on the safe side, and design again after the first record"
        ),
        DesignCode.LIMIT_RULES: "the limit of {subject} decides how large the input may be",
        DesignCode.MODEL_FALLS_SHORT: (
            "{fault}. The ranges predicted here are those of this model, not of the rig: find what it lacks first (greybox discover),"
            " or keep the limits well inside what the rig stands"
        ),
        DesignCode.RANGE_FROM_RECORDS: (
            "input {subject} has no limits of its own: it stays between {low:g} and {high:g}, as in the records;"
            " give --limit to change that"
        ),
    }
)
