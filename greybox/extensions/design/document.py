"""A design: the input to play, what it should bring, the limits, and what would bring more; and a campaign of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, isinf

from greybox.base import Finding, Severity, read_json
from greybox.base.document import Document, FileLink, Later, Section, TableBlock, Tone
from greybox.estimation.result import Fit
from greybox.extensions.design.campaign import Campaign, CampaignStatus, CampaignStep
from greybox.extensions.design.problem import Alternative, CampaignCode, Design, DesignCode
from greybox.model.effects.catalogue import effect
from greybox.show.documents.simulation import run_figures
from greybox.show.documents.tables import provenance_section, typeset_equations, worst_first
from greybox.show.sentences import register, wording, writes
from greybox.simulation.simulate import simulate

GOALS = {
    "precision": "narrow intervals",
    "discrimination": "telling explanations apart",
    "detection": "effects that may hide",
}


def describe_design(design: Design, *, command: str = "") -> Document:
    """What is said of a design; ``command`` is what was typed."""
    title = design.model.title
    record = design.experiment
    step = record.sampling_time or 0.0
    brings = next(_brings(design), "")
    answer = (
        f"Play the {name_input(design.kind)} of input.csv for {step * record.rows:g} s, a row every {step:g} s{brings}."
    )
    doubtful = any(f.severity is not Severity.NOTE for f in design.findings)
    first, *more = _gains(design)
    return Document(
        f"The next record of {title}",
        answer,
        Tone.CAUTION if doubtful else Tone.GOOD,
        [first],
        [*worst_first(design.findings), "the record begins and ends at rest"],
        Later(lambda: [*more, _limits(design), _alternatives(design)]),
        f"Which record of {title} should be taken next, within what the rig allows?",
        sections=Later(_sections, design, command),
        kind="design",
    )


def _sections(design: Design, command: str) -> Iterator[Section]:
    run = simulate(design.model, design.experiment)
    yield Section("input", "The input", list(run_figures(run, design.model, ("inputs", "outputs", "states"))))
    yield Section("brings", "What it brings", list(_gains(design)))
    yield Section("limits", "Limits", [_limits(design)])
    yield Section("alternatives", "Alternatives", [_alternatives(design)])
    yield Section("model", "The model", [typeset_equations(design.model)])
    yield provenance_section(command)


def _brings(design: Design) -> Iterator[str]:
    """The one number that convinces: how far the explanations come apart, or how narrow the intervals become."""
    pair = min(design.separation, key=design.separation.__getitem__, default="")
    cost = design.separation.get(pair)
    known = {name: c for name, c in design.predicted.items() if c.std_after is not None}
    shares = {name: c.std_after / c.std_before for name, c in known.items() if c.std_after and c.std_before}
    relative = {name: c.std_after / abs(c.value) for name, c in known.items() if c.std_after and c.value}
    if len(relative) < len(design.predicted) and not shares:  # one of them stays open, as a finding says
        relative = {}
    least = max(relative, key=relative.__getitem__, default="")
    if pair:
        yield f": the wrong explanation of the pair hardest to tell apart, {pair}, then loses by {cost:.3g} in the cost"
    elif shares:
        sizes = sorted(shares.values())
        size = f"{sizes[0]:.2g}" if len(sizes) == 1 else f"{sizes[0]:.2g} to {sizes[-1]:.2g}"
        yield f": the intervals of {wording.join_names(list(shares))} shrink to {size} of what they are"
    elif least:
        known_to = f": every constant is then known to {wording.percent_text(relative[least], 2)} or better"
        yield f"{known_to} (standard deviation), {least} least certain"


def _gains(design: Design) -> Iterator[TableBlock]:
    """What the record tells: of effects that may hide, of explanations, of parameters."""
    if design.detection:
        rows = [
            [
                name,
                d.parameter,
                *("nothing" if a is None else wording.value_with_unit(a, d.unit, 2) for a in (d.before, d.after)),
            ]
            for name, d in design.detection.items()
        ]
        caption = "Smallest amount of each effect that is seen now, and with this record"
        yield TableBlock(caption, ["effect", "amount", "seen now from", "seen then from"], rows)
    if design.separation:
        rows = [[pair, f"{cost:.3g}"] for pair, cost in design.separation.items()]
        caption = "Cost by which the wrong explanation of each pair would lose, after a refit"
        yield TableBlock(caption, ["explanations", "cost by which the wrong one loses"], rows)
    rows = [
        [
            name,
            wording.with_unit(wording.format_number(c.value), c.unit).rstrip(" -"),
            *("open" if s is None else wording.make_formatter(c.value, s)(s) for s in (c.std_before, c.std_after)),
        ]
        for name, c in design.predicted.items()
    ]
    caption = "Standard deviation of each parameter now, and with this record"
    yield TableBlock(caption, ["parameter", "value", "std now", "std then"], rows)


def _limits(design: Design) -> TableBlock:
    """Signal, limits, and the range that is predicted."""
    rows = []
    for name, limit in design.limits.items():
        predicted = wording.change_text(limit.predicted_low, limit.predicted_high, limit.unit)
        allowed = wording.limit_text(limit.low, limit.high, limit.unit)
        rows.append([name, allowed, predicted])
        if limit.rate < inf:
            rate = f"{limit.unit}/s"
            rows.append(
                [
                    f"rate of {name}",
                    wording.quantity_text(limit.rate, rate),
                    wording.quantity_text(limit.predicted_rate, rate),
                ]
            )
    caption = "Limits, and what is predicted under every explanation with a margin for what is not known"
    return TableBlock(caption, ["signal", "limits", "predicted"], rows)


def _alternatives(design: Design) -> TableBlock:
    rows = [[name_alternative(a), wording.times_text(a.gain)] for a in design.alternatives]
    note = "Twice as much means intervals half as wide, explanations twice as far apart, or half the amount seen."
    return TableBlock("What could be done instead", ["instead", "brings"], rows, note)


def name_input(kind: str) -> str:
    """``multisine with optimal spectrum`` -> ``multisine input with optimal spectrum``."""
    return "{} input{}{}".format(*kind.partition(" with "))


def name_alternative(alternative: Alternative) -> str:
    """What the alternative is, in words."""
    return {
        "input": name_input(alternative.name),
        "repeat": f"this record {alternative.name} times",
        "longer": f"a record of {alternative.name} s",
        "sample_faster": f"a row every {alternative.name} s",
        "sensor": f"with a sensor for {alternative.name}",
    }[alternative.kind]


# A campaign: how it stands, and its experiments in their order.

FILES = {
    "input": "input.csv",
    "why": "report.html",
    "record": "record.csv",
    "fit": "fit.html",
    "discovery": "discovery.html",
}
"""What a folder of an experiment may hold for a reader, in the order in which it comes there."""
TONES = {
    CampaignStatus.MEASURING: Tone.PLAIN,
    CampaignStatus.DONE: Tone.GOOD,
    CampaignStatus.BUDGET_SPENT: Tone.CAUTION,
    CampaignStatus.LIMIT_BROKEN: Tone.BAD,
}


def describe_campaign(campaign: Campaign, *, command: str = "") -> Document:
    """What is said of a campaign; ``command`` is what was typed."""
    machine = campaign.plan.model.title
    head = f"{machine}, {wording.count_noun(len(campaign.steps), 'experiment')}"
    outcome = "; ".join(map(str, campaign.findings)) or f"{campaign.status.replace('_', ' ')} in {campaign.folder}"
    return Document(
        f"Campaign on {machine}",
        f"{head}: {outcome}.",
        TONES[campaign.status],
        [_experiments(campaign)],
        question=f"Which effects does the rig of {machine} have, and how precisely are its parameters known?",
        sections=Later(_campaign_sections, campaign, command),
        kind="campaign",
    )


def _campaign_sections(campaign: Campaign, command: str) -> Iterator[Section]:
    model = campaign.plan.model
    for name in campaign.steps[-1].effects if campaign.steps else ():
        model = model + effect(name)
    yield Section("steps", "Experiments", [_experiments(campaign), *_widths(campaign), _files(campaign)])
    yield Section("model", "The model", [typeset_equations(model)])
    yield provenance_section(command)


def _experiments(campaign: Campaign) -> TableBlock:
    rows = []
    for step in campaign.steps:
        known, width = bool(step.widths), max(step.widths.values(), default=0.0)
        row = [str(step.number), step.goal, step.kind, step.verdict or "none"]
        row.append(name_explanation(step.effects) if known else "not measured")
        row.append(", ".join(map(name_explanation, step.alternatives)) or "none")
        row.append(f"{step.misfit:.3g} x noise" if known else "")
        row.append(("open" if isinf(width) else wording.percent_text(width, 2)) if known else "")
        rows.append(row)
    head = ["experiment", "for", "input", "verdict", "explanation", "others left", "misfit", "widest interval"]
    return TableBlock("The experiments, in their order", head, rows)


def _widths(campaign: Campaign) -> Iterator[TableBlock]:
    """How the interval of each parameter became narrower; none before the first record."""
    measured = [step for step in campaign.steps if step.widths]
    names = list(dict.fromkeys(name for step in measured for name in step.widths))
    values = _last_values(campaign, measured[-1]) if measured else {}
    rows: list[list[str]] = []
    for name in names:
        widths = [step.widths.get(name) for step in measured]
        shares = ("-" if w is None else "open" if isinf(w) else wording.percent_text(w, 2) for w in widths)
        rows.append([name, *shares, values.get(name, "")])
    head = ["parameter", *(f"experiment {step.number}" for step in measured), "value"]
    caption = (
        "Half width of the 95 % interval of each parameter after each experiment, over its value, and the value now"
    )
    if rows:
        yield TableBlock(caption, head, rows)


def _last_values(campaign: Campaign, step: CampaignStep) -> dict[str, str]:
    """The value of each parameter after ``step``, with its unit: of the explanation that is left, else of the fit."""
    from greybox.discovery.result import Discovery

    kind, name = (Discovery, "discovery.json") if step.effects else (Fit, "fit.json")
    path = campaign.folder / f"{step.number:02d}" / name
    if not path.exists():
        return {}
    parameters = read_json(path, kind)["parameters"]
    return {
        name: wording.with_unit(wording.format_number(entry["value"]), entry.get("unit") or "")
        for name, entry in parameters.items()
        if entry["value"] is not None
    }


def _files(campaign: Campaign) -> TableBlock:
    """What each folder holds."""
    rows = []
    for step in campaign.steps:
        files = [f"{step.number:02d}/{name}" for name in FILES.values()]
        rows.append([str(step.number), *(FileLink(f) if (campaign.folder / f).exists() else "" for f in files)])
    caption = "The files of each experiment: the input and why, the record, what was learnt from it"
    return TableBlock(caption, ["experiment", *FILES], rows)


DOCUMENTS = {"Design": describe_design, "Campaign": describe_campaign}
"""Class of a result -> the function that describes it."""


@writes(DesignCode.CONSTANT_NOT_DETERMINED)
def _not_determined(finding: Finding) -> str:
    names = finding.values["constants"]
    remedies = finding.values["remedies"]
    rest = "; or ".join(remedies) or f"fix {'it' if len(names) == 1 else 'one of them'}, or add a sensor"
    return f"no input within these limits determines {wording.join_names(names)}: {rest}"


def name_explanation(effects: Sequence[str]) -> str:
    """The effects of an explanation, or that it is the plain model."""
    return " + ".join(effects) or "the plain model"


@writes(CampaignCode.ONE_LEFT)
def _one_left(finding: Finding) -> str:
    width = finding.values["width"]
    intervals = (
        f"; its widest 95 % interval is {wording.percent_text(width, 2)} to each side" if width is not None else ""
    )
    return f"one explanation is left: {name_explanation(finding.values['effects'])}{intervals}"


@writes(CampaignCode.BUDGET_SPENT)
def _budget_spent(finding: Finding) -> str:
    best = name_explanation(finding.values["effects"])
    others = [name_explanation(a) for a in finding.values["alternatives"]]
    left = f"{best} or {' or '.join(others)}" if others else f"{best}, verdict {finding.values['verdict'] or 'none'}"
    return (
        f"every experiment is spent; left: {left}. Allow more with --experiments, or widen the limits in another folder"
    )


@writes(CampaignCode.LIMIT_BROKEN)
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
        DesignCode.WOULD_NOT_DECIDE: "{subject}: the wrong one would lose by a cost of {cost:.3g} only, and {limit:g} are needed to"
        " decide; widen the limits, take a longer record, or add a sensor",
        DesignCode.NO_EARLIER_RECORD: "no record was taken yet: each constant is assumed to be known to {spread:percent 2}; keep the"
        " limits on the safe side, and design again after the first record",
        DesignCode.LIMIT_RULES: "the limit of {subject} decides how large the input may be",
        DesignCode.MODEL_FALLS_SHORT: "{fault}. The ranges predicted here are those of this model, not of the rig: find what it lacks"
        " first (greybox discover), or keep the limits well inside what the rig stands",
        DesignCode.RANGE_FROM_RECORDS: "input {subject} has no limits of its own: it stays between {low:g} and {high:g}, as in the"
        " records; give --limit to change that",
    }
)
