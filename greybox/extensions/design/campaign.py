"""A campaign: design, measure, fit, discover, and the next design, until one explanation is left or the budget is spent.

Everything is kept in one folder, a folder in it for each experiment. What is there is not done again, so that a campaign which was
interrupted anywhere goes on with the same call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, NotRequired, TypedDict

import numpy as np

from greybox.base import DataError, Finding, Printable, Severity, read_json, shorten, write_json
from greybox.base.files import hold_file
from greybox.base.json_shape import FileKind, Unbounded, from_json_data, to_json_data
from greybox.data.experiment import Experiment
from greybox.data.input_course import Hold
from greybox.data.signals import SignalLimit
from greybox.discovery.decision import Verdict
from greybox.discovery.pipeline import discover
from greybox.estimation import Fit, FitOptions
from greybox.estimation.fit import fit
from greybox.extensions.design.next_record import answer, fit_explanation, fit_rival
from greybox.extensions.design.problem import (
    CAMPAIGN_POLICY,
    DESIGN_POLICY,
    CampaignCode,
    CampaignPolicy,
    Design,
    DesignPolicy,
    DesignProblem,
    GoalName,
)
from greybox.extensions.design.rig import find_broken_limits, read_record, run_rig
from greybox.model import Model, equations_text
from greybox.model.effects.catalogue import applicable_effects, effect
from greybox.model.equations import compare_definition, declare
from greybox.simulation.simulate import read_inputs

StepCallback = Callable[[Path, Any], None]
"""``(path of a page, value)``: called with each design, fit and discovery when it is there."""


class CampaignStatus(StrEnum):
    """How a campaign stands."""

    MEASURING = "measuring"
    """A record is to be taken."""
    DONE = "done"
    """One explanation is left, and its constants are as wanted."""
    BUDGET_SPENT = "budget_spent"
    LIMIT_BROKEN = "limit_broken"
    """The rig passed a limit: somebody has to look before it goes on."""


class CampaignQuestion(TypedDict):
    """What a campaign asks, which may not change while it goes on.

    Attributes
    ----------
    equations, declared
        What the model states, as in ``fit.json``.
    fixed
        Its known constants.
    limits
        Of each signal.
    duration, sampling_time
        Of each record, in seconds.
    noise
        Standard deviation of each sensor.
    records
        Fingerprints of the records that were there before.
    effects
        The only candidates, where there are such.
    hold
        How inputs move between samples.
    at_rest
        Whether records begin at rest.
    """

    equations: NotRequired[str]
    declared: NotRequired[dict[str, str]]
    fixed: dict[str, float]
    limits: Mapping[str, Any]
    duration: float
    sampling_time: float
    noise: dict[str, float]
    records: list[str]
    effects: list[str]
    hold: str
    at_rest: bool


@dataclass(frozen=True)
class CampaignPlan:
    """What a campaign is about.

    Parameters
    ----------
    model
        The plain model.
    limits
        Signal -> what the rig allows.
    duration, sampling_time
        Of each record, in seconds.
    noise
        Standard deviation of each sensor, by output.
    records
        Records that were taken before.
    width
        Half width of each 95 % interval, over the value, that is wanted; None: one explanation is enough.
    effects
        Names of the only effects that are tried; all where empty.
    hold, options
        What the generator does between samples, and how records are fitted.
    policy, design_policy
        The decision numbers.
    """

    model: Model
    limits: Mapping[str, SignalLimit]
    duration: float
    sampling_time: float
    noise: Mapping[str, float]
    records: tuple[Experiment, ...] = ()
    width: float | None = None
    effects: tuple[str, ...] = ()
    hold: Hold = "zero"
    options: FitOptions = field(default_factory=FitOptions)
    policy: CampaignPolicy = CAMPAIGN_POLICY
    design_policy: DesignPolicy = DESIGN_POLICY

    @property
    def question(self) -> CampaignQuestion:
        """What may not change while a campaign goes on, as JSON data."""
        data: CampaignQuestion = to_json_data(
            {
                "equations": equations_text(self.model),
                "declared": declare(self.model),
                "fixed": {q.name: q.value for q in self.model.all_parameters if q.fixed},
                "limits": self.limits,
                "duration": self.duration,
                "sampling_time": self.sampling_time,
                "noise": self.noise,
                "records": [record.fingerprint for record in self.records],
                "effects": self.effects,
                "hold": self.hold,
                "at_rest": self.options.at_rest,
            }
        )
        return data


@dataclass(frozen=True)
class CampaignStep:
    """One experiment: its goal and the kind of its input; after its record what is known.

    Parameters
    ----------
    number
        Counted from 1.
    goal, kind
        What its record is to bring, and what its input is called.
    verdict
        Of the discovery after it; empty where there was none yet.
    effects, alternatives
        The best explanation after it, and the others that are left.
    widths
        Half width of each 95 % interval over the value; infinite where a constant is open.
    misfit
        Largest misfit over noise of the best explanation.
    broken
        Signal -> measured value beyond its limit.
    """

    number: int
    goal: str
    kind: str
    verdict: str = ""
    effects: tuple[str, ...] = ()
    alternatives: tuple[tuple[str, ...], ...] = ()
    widths: Mapping[str, Unbounded] = field(default_factory=dict)
    misfit: float = np.nan
    broken: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Campaign(Printable):
    """A campaign so far.

    Parameters
    ----------
    status
        How it stands.
    plan
        What it is about.
    folder
        Where it is kept.
    steps
        The experiments.
    findings
        What is to be done, or why it ended.
    """

    status: CampaignStatus
    plan: CampaignPlan
    folder: Path
    steps: tuple[CampaignStep, ...]
    findings: tuple[Finding, ...]

    FILE: ClassVar[FileKind] = FileKind("a campaign", "campaign.json that greybox campaign has written")
    KEYS: ClassVar[str] = """
        status model!=plan.model.title experiments=plan.policy.experiments width=plan.width question=plan.question effects
        alternatives steps findings notes=str(findings)
        """

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the best explanation."""
        return self.steps[-1].effects if self.steps else ()

    @property
    def alternatives(self) -> tuple[tuple[str, ...], ...]:
        """Other explanations that are left, each a list of effects."""
        return self.steps[-1].alternatives if self.steps else ()


# Standard deviations in half a 95 % interval.
INTERVAL_DEVIATIONS = 1.96


@dataclass(frozen=True)
class Knowledge:
    """What the records so far say: the fit of the plain model, that of the best explanation, and the others that are left."""

    plain: Fit | None = None
    best: Fit | None = None
    effects: tuple[str, ...] = ()
    alternatives: tuple[tuple[str, ...], ...] = ()
    verdict: str = ""

    @property
    def widths(self) -> dict[str, float]:
        """Half width of each interval over the value, infinite where a constant is open."""
        if self.best is None:
            return {}
        deviations = INTERVAL_DEVIATIONS
        return {
            name: deviations * e.std / abs(e.value) if e.std and e.value else np.inf
            for name, e in self.best.parameters.items()
            if not e.fixed
        }

    @property
    def misfit(self) -> float:
        """Largest misfit over noise of the best explanation."""
        return max((m.noise_ratio for m in self.best.misfit.values()), default=np.nan) if self.best else np.nan

    @property
    def unexplained(self) -> float:
        """Largest share of the movement of an output that the best explanation leaves."""
        if self.best is None:
            return 0.0
        shares = []
        for trace in self.best.traces:
            for name, measured in trace.measured.items():
                movement = float(np.nanstd(measured))
                # Noise is no movement left unexplained.
                left = max(float(np.nanstd(trace.residual(name))) - self.best.noise.std.get(name, 0.0), 0.0)
                shares.append(left / movement if movement else 0.0)
        return max(shares, default=0.0)


def run_campaign(
    plan: CampaignPlan,
    folder: str | Path,
    *,
    rig: str = "",
    on_step: StepCallback | None = None,
    on_message: Callable[[str], None] | None = None,
    executor: Executor | None = None,
    workers: int = 0,
) -> Campaign:
    """Carry a campaign on as far as it goes.

    Parameters
    ----------
    plan
        What it is about.
    folder
        Where it is kept; what is there is not done again.
    rig
        A program that plays an input and writes a record, see `greybox.extensions.design.rig.run_rig`; without one the campaign stops at
        each record that is to be taken.
    on_step
        Called with each design, fit and discovery, and where its page belongs.
    on_message
        Called with a line when something begins.
    executor, workers
        Where the refits of a discovery run; without an executor in as many processes here.

    Returns
    -------
    Campaign
        How it stands; it is kept in ``campaign.json`` as well.

    Raises
    ------
    DataError
        For a folder with another campaign or one that is at work, a rig that fails, and a record of another input.
    """
    place = Path(folder)
    # Held by the rig's process as well: a campaign that was killed may have left its rig playing.
    with hold_file(place / "campaign.lock") as held:
        if held is None:
            raise DataError(
                f"{place}: a campaign, or the rig that it started, is at work here; wait until it has ended, or give another folder"
            )
        say, show = on_message or (lambda _: None), on_step or (lambda *_: None)
        return _CampaignRun(plan, place, rig, held, show, say, executor, workers).carry_on()


@dataclass
class _CampaignRun:
    """`run_campaign` in a folder that nobody else works in: the rig holds the file ``held`` as well."""

    plan: CampaignPlan
    place: Path
    rig: str
    held: BinaryIO
    show: StepCallback
    say: Callable[[str], None]
    executor: Executor | None
    workers: int
    steps: list[CampaignStep] = field(default_factory=list)

    def carry_on(self) -> Campaign:
        """Design, measure, learn, until it is done, a record has to be taken, or the budget is spent."""
        plan, before = self.plan, self._read_steps()
        records = list(plan.records)
        knowledge = self._learn(records, self.place / "before") if records else Knowledge()
        for number in range(1, plan.policy.experiments + 1):
            if records and _is_done(plan, knowledge, self.steps):
                return self._end(CampaignStatus.DONE, CampaignCode.ONE_LEFT, knowledge)
            folder = self.place / f"{number:02d}"
            asked_file, record_file = folder / "input.csv", folder / "record.csv"
            self.steps.append(CampaignStep(number, *self._prepare(knowledge, records, folder, number)))
            asked = read_inputs(asked_file, plan.model, hold=plan.hold)
            fresh = not record_file.exists()
            if fresh and not self.rig:
                values = {"record": str(record_file)}
                return self._save(
                    CampaignStatus.MEASURING, Finding(CampaignCode.MEASURE, subject=str(asked_file), values=values)
                )
            if fresh:
                self._save(CampaignStatus.MEASURING)
                self.say(f"experiment {number}: the rig plays {asked_file}")
                run_rig(self.rig, asked_file, record_file, number, plan.duration, plan.policy.rig_timeout, self.held)
            # What was played is compared with what was asked: a record of another input would be fitted as if it were
            # this one.
            record = read_record(record_file, asked, plan.model)
            broken = find_broken_limits(record, plan.limits, plan.noise)
            records.append(record)
            # Once, where it was just taken: the next call goes on with the record, which is a good one.
            if broken and fresh:
                self.steps[-1] = replace(self.steps[-1], broken=broken)
                name, value = next(iter(broken.items()))
                ends = {"low": plan.limits[name].low, "high": plan.limits[name].high}
                values = to_json_data({"value": value, **ends, "number": number})
                finding = Finding(CampaignCode.LIMIT_BROKEN, Severity.WARNING, name, values)
                return self._save(CampaignStatus.LIMIT_BROKEN, finding)
            if number in before and (self.place / f"{number + 1:02d}" / "input.csv").exists():
                self.steps[-1] = before[number]  # the next record is designed: what was learnt from this one is in it
                continue
            self.say(f"experiment {number}: fit and discovery on {len(records)} record{'s' * (len(records) != 1)}")
            knowledge = self._learn(records, folder)
            self.steps[-1] = replace(
                self.steps[-1],
                verdict=knowledge.verdict,
                effects=knowledge.effects,
                alternatives=knowledge.alternatives,
                widths=knowledge.widths,
                misfit=knowledge.misfit,
                broken=broken,
            )
            self._save(CampaignStatus.MEASURING)
        if _is_done(plan, knowledge):
            return self._end(CampaignStatus.DONE, CampaignCode.ONE_LEFT, knowledge)
        return self._end(CampaignStatus.BUDGET_SPENT, CampaignCode.BUDGET_SPENT, knowledge)

    def _save(self, status: CampaignStatus, finding: Finding | None = None) -> Campaign:
        findings = () if finding is None else (finding,)
        campaign = Campaign(status, self.plan, self.place, tuple(self.steps), findings)
        write_json(self.place / "campaign.json", campaign)
        return campaign

    def _end(self, status: CampaignStatus, code: CampaignCode, knowledge: Knowledge) -> Campaign:
        """Save the campaign with what is left."""
        widest = max(knowledge.widths.values(), default=0.0)
        values = {
            "effects": list(knowledge.effects),
            "alternatives": [list(a) for a in knowledge.alternatives],
            "verdict": knowledge.verdict,
            "width": widest if np.isfinite(widest) else None,
        }
        return self._save(status, Finding(code, values=values))

    def _read_steps(self) -> dict[int, CampaignStep]:
        """The finished steps of a campaign that goes on, by number. Refuses one that asked something else."""
        path = self.place / "campaign.json"
        if not path.exists():
            return {}
        data = read_json(path, Campaign)
        before = data.get("question") or {}
        text, declared = before.get("equations", ""), before.get("declared", {})
        if before and (differences := compare_definition(self.plan.model, text, declared, {})):
            raise DataError(
                f"{path}: this campaign was begun with another model; repeat its command with the model as it was, or give another"
                f" folder: {'; '.join(shorten(str(d), 200) for d in differences[:3])}"
            )
        # A folder holds one question; another one would mix its records.
        changed = [name for name, value in self.plan.question.items() if name in before and before[name] != value]
        if changed:
            raise DataError(
                f"{path}: this campaign was begun with another {changed[0].replace('_', ' ')}; repeat its command, or give another folder"
            )
        return {step["number"]: from_json_data(CampaignStep, step) for step in data["steps"] if step.get("widths")}

    def _prepare(
        self, knowledge: Knowledge, records: Sequence[Experiment], folder: Path, number: int
    ) -> tuple[str, str]:
        """Goal and kind of the designed input of one experiment, which is designed where that was not done yet."""
        path = folder / "design.json"
        if path.exists() and (folder / "input.csv").exists():
            data = read_json(path, Design)
            return data["goal"], data.get("kind", "")
        self.say(f"experiment {number}: design")
        result = design_next(self.plan, knowledge, records)
        result.save(folder)
        self.show(folder / "report.html", result)
        return str(result.goal), result.kind

    def _learn(self, records: Sequence[Experiment], folder: Path) -> Knowledge:
        """Fit and discovery on the records so far; the last one judges. Refits of a discovery that was interrupted are kept."""
        plan = self.plan
        plain = fit(plan.model, records, noise=dict(plan.noise), options=plan.options)
        if not plain.success:
            raise DataError(
                f"{plan.model.title}: the fit to {len(records)} record{'s' * (len(records) != 1)} did not end at an optimum; try other"
                " start values"
            )
        if len(records) < 2:
            plain.save(folder / "fit.json")
            self.show(folder / "fit.html", plain)
            return Knowledge(plain, plain)
        discovery = discover(
            plan.model,
            # The last record was chosen to decide: it judges, and has not been fitted.
            records[:-1],
            validation=records[-1],
            noise=dict(plan.noise),
            effects=[effect(name) for name in plan.effects] or None,
            options=plan.options,
            journal=folder / "journal.jsonl",
            executor=self.executor,
            workers=self.workers,
        )
        discovery.save(folder / "discovery.json")
        self.show(folder / "discovery.html", discovery)
        # The effects to go on with: those of the best model, none where no effect is established.
        is_open = discovery.verdict in (Verdict.COMPLETE, Verdict.UNKNOWN)
        names: tuple[str, ...] = () if is_open else tuple(e["name"] for e in discovery.effects)
        best = fit_explanation(plain, "+".join(names)) if names else plain
        best.save(folder / "fit.json")
        self.show(folder / "fit.html", best)
        alternatives = tuple(tuple(a) for a in discovery.alternatives if tuple(a) != names)
        return Knowledge(plain, best, names, alternatives, str(discovery.verdict))


# Explanations, beside the best one, between which a record is to decide.
CAMPAIGN_RIVALS = 3


def design_next(plan: CampaignPlan, knowledge: Knowledge, records: Sequence[Experiment]) -> Design:
    """The next record of a campaign.

    It is to tell explanations apart while several are left; to show what may hide while no effect is established, though something is
    missing or nothing seems to be; else to narrow intervals. Every explanation that is left keeps the limits.
    """
    models: list[Model] = [plan.model]
    if knowledge.best is not None:
        # A constant that a missing effect drove to its bound is where the user has it: at a bound it says nothing of the rig, and may make
        # every prediction stiff (an inductance of next to nothing).
        begun, best = plan.model.values, knowledge.best
        stated = {n: begun[n] for n, e in best.parameters.items() if e.at_bound and n in begun}
        models = [best.model.start(**stated)]
    if knowledge.plain is not None:
        for names in knowledge.alternatives[:CAMPAIGN_RIVALS]:
            models.append(fit_rival(knowledge.plain, "+".join(names) or "none"))
    hidden = _hidden_effects(plan) if knowledge.verdict in (Verdict.COMPLETE, Verdict.UNKNOWN) else ()
    # Which explanation first: intervals of a wrong one are worth nothing, and what hides would change them.
    goal = GoalName.DISCRIMINATION if len(models) > 1 else GoalName.DETECTION if hidden else GoalName.PRECISION
    question = DesignProblem(
        tuple(models),
        dict(plan.limits),
        plan.duration,
        plan.sampling_time,
        dict(plan.noise),
        tuple(records),
        goal,
        effects=hidden if goal is GoalName.DETECTION else (),
        shares=choose_shares(plan, knowledge, records),
        hold=plan.hold,
        options=plan.options,
        policy=plan.design_policy,
    )
    return answer(question)


def _hidden_effects(plan: CampaignPlan) -> tuple[str, ...]:
    """The effects that may hide: those that are tried and have a place in the model."""
    possible = [e.name for e in applicable_effects(plan.model)]
    return tuple(name for name in possible if not plan.effects or name in plan.effects)


# Share of the way to each limit that the first record may use: nothing is known yet.
CAMPAIGN_FIRST_SHARE = 0.5
# Share that later records may use as long as no discovery has named what is missing, or found nothing: an effect that a small motion
# hides grows with the amplitude.
UNPROVEN_SHARE = 0.85
# How far the next record may then go, over how far the rig has been, input by input and signal by signal; the share that is left
# unexplained comes off. What is missing shows already, and a contradicted model does not foresee a jump.
CAMPAIGN_GROWTH = 1.0
# By how many times the share of the movement that a model leaves unexplained its predictions are widened: an effect that is missing grows
# with the amplitude.
MODEL_ERROR = 3.0


def choose_shares(plan: CampaignPlan, knowledge: Knowledge, records: Sequence[Experiment]) -> dict[str, float]:
    """Share of the way to each limit that the next record may use.

    Before the first record only a part; afterwards less, the more of the movement the best explanation leaves unexplained; and while it
    is contradicted (its misfit is above chance) not far beyond where the rig has been.
    """
    policy = plan.policy
    settled = knowledge.verdict in (Verdict.COMPLETE, Verdict.NAMED)
    share = CAMPAIGN_FIRST_SHARE if not records else 1.0 if settled else UNPROVEN_SHARE
    caution = 1 + MODEL_ERROR * knowledge.unexplained
    share /= caution
    shares = dict.fromkeys(plan.limits, share)
    if not knowledge.misfit > policy.contradiction:
        return shares
    for name, limit in plan.limits.items():
        reached = [_reached_share(r.inputs[name], limit, 0.0) for r in records if name in r.inputs]
        reached += [
            _reached_share(r.outputs[name], limit, plan.noise.get(name, 0.0)) for r in records if name in r.outputs
        ]
        if reached:
            # Not beyond where the rig has been: a contradicted model says little about what is far away.
            shares[name] = min(share, CAMPAIGN_GROWTH * max(reached) / caution)
    return shares


def _reached_share(values: np.ndarray, limit: SignalLimit, noise: float) -> float:
    """Share of the way from where it began to its limits that a measured signal went, its noise left out."""
    known = values[np.isfinite(values)]
    # Every designed input begins at rest.
    rest = float(known[0])
    excursions = ((float(known.max()) - rest, limit.high - rest), (rest - float(known.min()), rest - limit.low))
    return max(
        (max(moved - noise, 0.0) / room for moved, room in excursions if np.isfinite(room) and room > 0), default=1.0
    )


def _is_done(plan: CampaignPlan, knowledge: Knowledge, steps: Sequence[CampaignStep] | None = None) -> bool:
    """Whether one explanation is left, and its constants are as wanted.

    The plain model is left when one of the ``steps`` looked for what may hide, too; None: no more records can be taken.
    """
    looked = steps is None or any(step.goal == GoalName.DETECTION for step in steps)
    if knowledge.verdict == Verdict.COMPLETE and not looked and _hidden_effects(plan):
        return False
    settled = knowledge.verdict in (Verdict.COMPLETE, Verdict.NAMED) and not knowledge.alternatives
    return settled and (plan.width is None or all(w <= plan.width for w in knowledge.widths.values()))
