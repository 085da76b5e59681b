"""Mutated results, journals and studies: a right answer or one sentence, never a traceback.

Slow; ``RELIABILITY_SIZE=10`` makes ten times as many trials, ``RELIABILITY_WRITE=1`` writes the figures to ``docs/studies/reliability.md``.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import GreyboxError
from greybox.base.values import Finding
from greybox.comparison.result import load_comparison
from greybox.data.signals import SignalLimit
from greybox.discovery.execution import RefitJournal, RefitOutcome
from greybox.discovery.result import load_discovery
from greybox.estimation.result import load_fit
from greybox.estimation.uncertainty import load_bootstrap, load_profile
from greybox.extensions.changes.result import ChangeVerdict, load_changes
from greybox.extensions.design import campaign as campaigns
from greybox.extensions.design.campaign import CampaignPlan
from greybox.extensions.design.problem import CampaignCode, DesignPolicy
from greybox.model.model import Model
from greybox.shell.commands import COMMANDS
from greybox.shell.own_effects import find_own_effects, keep_effect
from greybox.shell.study_file import read_study
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox
from tests.hardening.mutations import mutate_bytes, mutate_json, places_of
from tests.oracles.independent import linear_record, multisine
from tests.support.child import run_in_child
from tests.support.kept_law import LAW
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(sys.platform == "win32", reason="processes that fork"),
]

STUDY = """
model = "micro_actuator"
effects = ["coulomb_friction"]

[records]
estimation = ["train.csv"]
validation = ["test.csv"]
skip = 3
hold = "first"
columns = ["time", "u", "-", "x"]
sampling_time = 0.01

[fixed]
M = 0.01
Ra = "as declared"

[start]
K = 7000.0

[priors]
B = { mean = 0.3, std = 0.01 }

[ties]
Kv = "Kf"

[noise]
x = 2e-7

[fit]
profile = ["K"]
bootstrap = 100
"""


def make_fits(folder: Path) -> dict[Path, Model]:
    """Saved fits of several kinds, with the model each was made with."""
    period = 1.6384e-3
    record = linear_record(silverbox, multisine(np.random.default_rng(1), 120, period, 5, 200, 0.1), period)
    start = silverbox.start(**{q.name: 1.2 * silverbox.values[q.name] for q in silverbox.free_parameters})
    rest = gb.FitOptions(at_rest=True)
    fits = {"plain": gb.fit(start, record, noise={"y": 1e-4}, validation=record)}
    drive = multisine(np.random.default_rng(2), 200, 2.5e-4, 5, 800, 3.0)
    records = [linear_record(micro_actuator, scale * drive, 2.5e-4) for scale in (1.0, 0.6)]
    known = micro_actuator.fix("M", "Ra").tie(Kv="Kf").prior(K=(5900.0, 50.0))
    fits["tied"] = gb.fit(known, records, noise={"x": 2e-7, "i": 5e-3}, options=rest)
    fits["robust"] = gb.fit(known, records, options=gb.FitOptions(at_rest=True, loss="huber", per_experiment=("B",)))
    fits["starts"] = gb.multistart(start, record, starts=3, workers=1).best
    fits["noisy"] = gb.fit(start.with_process_noise("v"), record)
    models = {"plain": silverbox, "starts": silverbox, "noisy": silverbox}
    return {fit.save(folder / f"{name}.json"): models.get(name, micro_actuator) for name, fit in fits.items()}


def use_fit(path: Path, model: Model) -> None:
    """What people do with a saved fit."""
    fit = load_fit(path, model)
    str(fit), fit.notes, fit.noise.source, repr(fit.provenance)
    assert all(trace.experiment.rows > 1 for trace in fit.traces)
    gb.export.to_python(fit, path.with_suffix(".py"))
    fit.save(path.with_name("again.json"))


def use_journal(path: Path, _: object) -> None:
    journal = RefitJournal(path)
    journal.add("new", None)
    list(map(str, journal.findings))
    assert "new" in RefitJournal(path).known


def use_profile(path: Path, _: object) -> None:
    profile = load_profile(path)
    str(profile), profile.open_sides
    profile.save(path.with_name("again.json"))


def use_bootstrap(path: Path, _: object) -> None:
    load_bootstrap(path).save(path.with_name("again.json"))


def use_discovery(path: Path, _: object) -> None:
    assert isinstance(load_discovery(path)["verdict"], str)


def use_comparison(path: Path, _: object) -> None:
    assert all(entry["parameters"] >= 0 for entry in load_comparison(path)["models"].values())


def use_law(path: Path, _: object) -> None:
    """Keep the law of a discovery in a project; what was written states effects and nothing else."""
    project = path.parent / "project"
    (project / "models").mkdir(parents=True, exist_ok=True)
    (project / "models" / "rig.py").write_text("import greybox\n")
    source = path.resolve()
    with contextlib.chdir(project):
        kept = keep_effect("kept", source)
        found = find_own_effects()
    kinds = {type(statement).__name__ for statement in ast.parse(kept.read_bytes()).body}
    try:
        assert kinds == {"Expr", "ImportFrom", "Assign"}
        assert found[0].name == "kept"
    finally:
        kept.unlink()


def use_change(path: Path, _: object) -> None:
    change = load_changes(path)
    assert ChangeVerdict(change["verdict"]) and all(c["unit"] is not None for c in change["constants"].values())


def begin_campaign(plan: object, folder: Path) -> campaigns._CampaignRun:
    assert isinstance(plan, CampaignPlan)
    return campaigns._CampaignRun(plan, folder, "", io.BytesIO(), lambda *_: None, print, None, 0)


def use_campaign(path: Path, plan: object) -> None:
    steps = tuple(begin_campaign(plan, path.parent)._read_steps().values())
    str(campaigns.Campaign(campaigns.CampaignStatus.MEASURING, plan, path.parent, steps, ()))


def use_design(path: Path, plan: object) -> None:
    """What a campaign that goes on reads of the design it has made."""
    (path.parent / "input.csv").touch()
    goal, kind = begin_campaign(plan, path.parent)._prepare(campaigns.Knowledge(), (), path.parent, 1)
    str(campaigns.CampaignStep(1, goal, kind))


SHORT = DesignPolicy(
    bands=2,
    iterations=3,
    rounds=1,
    starts=1,
    refined_scenarios=1,
    crest_iterations=20,
    scenarios=2,
)


def make_later_ones(folder: Path, search: Path) -> dict[Path, tuple[object, Callable[[Path, object], None]]]:
    """Results of laws, design, campaign, change detection and FMUs, with what each is used with."""
    period = 1.6384e-3
    records = [
        linear_record(silverbox, multisine(np.random.default_rng(k), 300, period, 5, 200, 0.1), period) for k in (1, 2)
    ]
    fit = gb.fit(silverbox, records[0], noise={"y": 1e-4})
    law = folder / "law.json"
    law.write_text(json.dumps(json.loads(search.read_text()) | {"effects": [LAW]}))
    plan = CampaignPlan(
        silverbox, {"u": SignalLimit(-0.1, 0.1)}, 0.1, period, {"y": 1e-4}, tuple(records), design_policy=SHORT
    )
    design = gb.design(fit, limits=plan.limits, duration=0.1, sampling_time=period, policy=SHORT)
    step = campaigns.CampaignStep(
        1, "precision", "multisine", "named", ("cubic_stiffness",), (("play",),), {"d": 0.01}, 1.0, {"y": 2.0}
    )
    todo = Finding(CampaignCode.MEASURE, subject="02/input.csv", values={"record": "02/record.csv"})
    run = begin_campaign(plan, folder)
    run.steps += [step, replace(step, number=2)]
    run._save(campaigns.CampaignStatus.MEASURING, todo)
    return {
        law: (None, use_law),
        gb.detect_changes(fit, records[1], search_effects=False).save(folder / "changed.json"): (None, use_change),
        design.save(folder): (plan, use_design),
        folder / "campaign.json": (plan, use_campaign),
    }


def make_others(folder: Path) -> dict[Path, Callable[[Path, object], None]]:
    """Saved results that are no fits, and what people do with each."""
    period = 1.6384e-3
    records = [
        linear_record(silverbox, multisine(np.random.default_rng(k), 120, period, 5, 200, 0.1), period) for k in (1, 2)
    ]
    fit = gb.fit(silverbox, records[0], noise={"y": 1e-4})
    name = silverbox.free_parameters[0].name
    draws = gb.uncertainty.bootstrap(fit, np.random.default_rng(3), replicates=5)
    comparison = gb.compare([fit], records[1], training=records[0])
    search = gb.discover(
        silverbox, records[0], validation=records[1], noise={"y": 1e-4}, effects=[gb.effect("coulomb_friction")]
    )
    return {
        gb.uncertainty.profile(fit, name).save(folder / "profile.json"): use_profile,
        draws.save(folder / "bootstrap.json"): use_bootstrap,
        gb.comparison.save_comparison(comparison, folder / "compare.json"): use_comparison,
        search.save(folder / "discovery.json"): use_discovery,
    }


def judge(use: Callable[[Path, object], None], path: Path, value: object) -> str:
    """ "used", "refused", or what is wrong."""
    try:
        use(path, value)
    except GreyboxError as error:
        return "refused" if path.name in str(error) and len(str(error)) < 3000 else f"poor sentence: {str(error)[:200]}"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
    return "used"


def damage_and_use(
    path: Path, value: object, use: Callable[[Path, object], None], lines: bool, times: int, seed: int
) -> Mapping[str, int]:
    rng, outcomes, content = np.random.default_rng(seed), Counter[str](), path.read_bytes()
    target = path.parent / "damaged" / path.name
    documents = (
        [json.loads(line) for line in (content.splitlines() if lines else [content])] if path.suffix != ".toml" else []
    )
    places = [list(places_of(document)) for document in documents]
    for _ in range(times):
        if documents and rng.random() < 0.7:
            k = int(rng.integers(len(documents)))
            damaged = [*documents]
            damaged[k] = mutate_json(documents[k], places[k], rng)
            text = "\n".join(map(json.dumps, damaged)).encode()
        else:
            text = mutate_bytes(content, rng)
        target.write_bytes(text)
        outcomes[judge(use, target, value)] += 1
    return outcomes


def attack(
    files: Mapping[Path, tuple[object, Callable[[Path, object], None], bool]], each: int
) -> tuple[Counter[str], Counter[str]]:
    """Outcomes of all files, and what went wrong with which."""
    outcomes, wrong = Counter[str](), Counter[str]()
    for number, (path, (value, use, lines)) in enumerate(files.items()):
        (path.parent / "damaged").mkdir(exist_ok=True)

        def work(path=path, value=value, use=use, lines=lines, number=number):
            return damage_and_use(path, value, use, lines, each, number)

        result = run_in_child(work)
        if isinstance(result, int):
            wrong[f"{path.name}: the process ended by signal {result}"] += 1
            continue
        for outcome, count in result.items():
            outcomes[outcome] += count
            if outcome not in ("used", "refused"):
                wrong[f"{path.name}: {outcome}"] += count
    return outcomes, wrong


def test_mutated_results_journals_and_studies(tmp_path):
    files: dict[Path, tuple[object, Callable, bool]] = {}
    for path, model in make_fits(tmp_path).items():
        load_fit(path, model)
        files[path] = (model, use_fit, False)
    for path, use in make_others(tmp_path).items():
        use(path, None)
        files[path] = (None, use, False)
    for path, (value, use) in make_later_ones(tmp_path, tmp_path / "discovery.json").items():
        use(path, value)
        files[path] = (value, use, False)
    journal = RefitJournal(tmp_path / "journal.jsonl")
    for k in range(12):
        outcome = RefitOutcome({"M": 0.01 + k, "K": 5000.0}, ((0.0, 1e-6), (1.0, 2.0)), k % 3)
        journal.add(f"k{k}", outcome if k % 4 else None)
    files[journal.path] = (None, use_journal, True)
    (tmp_path / "study.toml").write_text(STUDY)
    files[tmp_path / "study.toml"] = (None, lambda path, _: read_study(path, "fit", COMMANDS), False)
    read_study(tmp_path / "study.toml", "fit", COMMANDS)
    each = size_of(5000 // len(files) + 1)
    outcomes, wrong = attack(files, each)
    figures = f"of {len(files)} files; {outcomes['used']} used, {outcomes['refused']} refused"
    note_row("mutated results, journals and studies", each * len(files), sum(wrong.values()), figures)
    assert not wrong, "\n".join(f"{count} x {what}" for what, count in wrong.most_common(60))
