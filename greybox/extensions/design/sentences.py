"""What is said of a design: the input, what it should bring, its limits, and what would bring more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from greybox.extensions.design.problem import CampaignCode, DesignCode
from greybox.show.sentences.registry import register, renders, sentence
from greybox.show.sentences.wording import (
    change_text,
    count_noun,
    format_number,
    format_table,
    join_names,
    quantity_text,
)

if TYPE_CHECKING:
    from greybox.base.findings import Finding
    from greybox.extensions.design.campaign import Campaign, CampaignStep
    from greybox.extensions.design.result import Alternative, Design, PredictedConstant, PredictedDetection

GOALS = {
    "precision": "narrow intervals",
    "discrimination": "telling explanations apart",
    "detection": "effects that may hide",
}


def _not_determined(finding: Finding) -> str:
    names = finding.values["constants"]
    remedies = finding.values["remedies"]
    rest = f": {'; or '.join(remedies)}" if remedies else ": fix one of them, or add a sensor"
    return f"no input within these limits determines {join_names(names)}{rest}"


def name_explanation(effects: Sequence[str]) -> str:
    """The effects of an explanation, or that it is the plain model."""
    return " + ".join(effects) or "the plain model"


def _one_left(finding: Finding) -> str:
    width = finding.values["width"]
    intervals = f"; its widest 95 % interval is {100 * width:.2g} % to each side" if width is not None else ""
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
        DesignCode.RANGE_FROM_RECORDS: (
            "input {subject} has no limits of its own: it stays between {low:g} and {high:g}, as in the records;"
            " give --limit to change that"
        ),
    }
)


@renders("Design")
def write_design(design: Design) -> str:
    """The record, what it should bring, the limits, the alternatives, the findings."""
    record = design.experiment
    duration = record.rows * (record.sampling_time or 0.0)
    lines = [
        f"{design.model.title}: {design.kind} input for {GOALS[design.goal]}, {format_number(duration)} s,"
        f" {count_noun(record.rows, 'row')}",
        "",
    ]
    if design.detection:
        lines += format_table(["effect", "amount", "seen now from", "seen then from"], detection_rows(design.detection))
        lines.append("")
    if design.separation:
        rows = [[pair, f"{cost:.3g}"] for pair, cost in design.separation.items()]
        lines += [*format_table(["explanations", "cost by which the wrong one loses"], rows), ""]
    lines += format_table(["parameter", "value", "std now", "std then"], constant_rows(design.predicted))
    lines += ["", *format_table(["signal", "limits", "predicted"], limit_rows(design))]
    lines += [
        "",
        *format_table(["instead", "brings"], [[name_alternative(a), gain_text(a)] for a in design.alternatives]),
    ]
    if design.findings:
        lines += ["", *(f"{f.severity}: {sentence(f)}" for f in design.findings)]
    return "\n".join(lines)


def constant_rows(predicted: Mapping[str, PredictedConstant]) -> list[list[str]]:
    """Name, value, standard deviation before and after of each constant."""
    return [
        [
            name,
            f"{format_number(c.value)} {c.unit}".rstrip(),
            *("open" if s is None else f"{s:.2g}" for s in (c.std_before, c.std_after)),
        ]
        for name, c in predicted.items()
    ]


def detection_rows(detection: Mapping[str, PredictedDetection]) -> list[list[str]]:
    """Effect, its amplitude, and the smallest amounts that are seen before and after."""
    return [
        [name, d.parameter, *("nothing" if a is None else f"{a:.2g} {d.unit}".rstrip() for a in (d.before, d.after))]
        for name, d in detection.items()
    ]


def limit_rows(design: Design) -> list[list[str]]:
    """Signal, limits, and the range that is predicted."""
    rows = []
    for name, limit in design.limits.items():
        rows.append(
            [
                name,
                change_text(limit.low, limit.high, limit.unit),
                change_text(limit.predicted_low, limit.predicted_high, limit.unit),
            ]
        )
        if limit.rate < float("inf"):
            rate = f"{limit.unit}/s"
            rows.append([f"rate of {name}", quantity_text(limit.rate, rate), quantity_text(limit.predicted_rate, rate)])
    return rows


def name_alternative(alternative: Alternative) -> str:
    """What the alternative is, in words."""
    return {
        "input": f"{alternative.name} input",
        "repeat": f"this record {alternative.name} times",
        "longer": f"{alternative.name} s instead",
        "sample_faster": f"a row every {alternative.name} s",
        "sensor": f"with a sensor for {alternative.name}",
    }[alternative.kind]


def gain_text(alternative: Alternative) -> str:
    """``1.41 times as much``."""
    return f"{alternative.gain:.3g} times as much"


@renders("Campaign")
def write_campaign(campaign: Campaign) -> str:
    """The experiments, and what is to be done."""
    lines = [f"{campaign.plan.model.title}: campaign in {campaign.folder}, {campaign.status.replace('_', ' ')}", ""]
    lines += format_table(CAMPAIGN_HEAD, [step_row(step) for step in campaign.steps])
    return "\n".join([*lines, "", *map(sentence, campaign.findings)])


CAMPAIGN_HEAD = ["experiment", "for", "input", "verdict", "explanation", "others left", "misfit", "widest interval"]


def step_row(step: CampaignStep) -> list[str]:
    """One experiment as cells below `CAMPAIGN_HEAD`."""
    others = ", ".join(map(name_explanation, step.alternatives))
    known = bool(step.widths)
    width = max(step.widths.values(), default=0.0)
    return [
        str(step.number),
        step.goal,
        step.kind,
        step.verdict or "none",
        name_explanation(step.effects) if known else "not measured",
        others or "none",
        f"{step.misfit:.3g} x noise" if known else "",
        ("open" if width == float("inf") else f"{100 * width:.2g} %") if known else "",
    ]
