"""What a designed record is worth: widths that simulated experiments confirm, rivals that are parted, hidden effects that a campaign names.

    python -m fits.studies.design_study FOLDER [--part precision|discrimination|campaign|time] [--cases N] [--first SEED] [--fits 100]

- precision: six plants. The geometric mean of the widths of all intervals under the designed record, over that of the best of chirp,
  PRBS, steps and a multisine at their own largest amplitudes under the same limits; and the spread of the estimates of as many
  simulated and fitted experiments as ``--fits`` says over the predicted width.
- discrimination: pairs of effects on the twin of the actuator that a first, cautious record does not part. How many further records part
  them: designed ones, and PRBS and random levels of the same limits. Pairs are drawn until as many as ``--cases`` says are ambiguous.
- campaign: twins with one hidden effect behind a rig program (this module with ``--rig``), plain model and loose limits.
- time: 10 s at 1 kHz with three explanations.

Each case leaves a file in FOLDER, so that the study goes on where it was stopped; every call prints the table of what is there.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import greybox as gb
from fits.studies.hidden_cases import FAMILY, PERIOD, make
from fits.studies.rig_twins import simulate as simulate_rig
from greybox.base.files import write_file
from greybox.data.signals import SignalLimit
from greybox.extensions.design.campaign import CampaignPlan, run_campaign
from greybox.extensions.design.inputs import LimitKeeper, Prbs, Steps, fit_into_limits
from greybox.extensions.design.next_record import answer as answer_question
from greybox.extensions.design.next_record import fit_rival
from greybox.extensions.design.plant import list_plants
from greybox.extensions.design.problem import DesignProblem, GoalName
from greybox.shell.project import find_model

REST = gb.FitOptions(at_rest=True)
# Model, fixed constants, limits, duration and sampling time in s, noise.
PLANTS: dict[str, tuple[str, tuple[str, ...], dict[str, SignalLimit], float, float, dict[str, float]]] = {
    "actuator": (
        "micro_actuator",
        ("M", "Ra"),
        {"u": SignalLimit(-2, 2), "i": SignalLimit(-0.3, 0.3)},
        0.3,
        2.5e-4,
        {"x": 2e-7, "i": 5e-3},
    ),
    "pneumatic": (
        "pneumatic_cylinder",
        (),
        {"u": SignalLimit(-4, 4), "s": SignalLimit(-0.25, 0.25)},
        6.0,
        0.01,
        {"s": 2e-4, "p_a": 500.0, "p_b": 500.0},
    ),
    "circuit of the silverbox": ("silverbox", (), {"u": SignalLimit(-0.1, 0.1)}, 0.6, 1.5e-3, {"y": 1e-3}),
    "two masses": (
        "plants/two_mass/two_mass.py",
        (),
        {"T": SignalLimit(-0.5, 0.5)},
        1.0,
        1e-3,
        {"a1": 1e-3, "a2": 1e-3},
    ),
    "rotary drive": (
        "plants/rotary_drive/rotary_drive.py",
        (),
        {"u": SignalLimit(-12, 12), "i": SignalLimit(-6, 6)},
        1.0,
        1e-3,
        {"w": 0.2, "i": 0.02},
    ),
    "stage": (
        "plants/stage/stage.py",
        (),
        {"i": SignalLimit(-2, 2), "x": SignalLimit(-0.01, 0.01)},
        2.0,
        2e-3,
        {"x": 1e-5},
    ),
}
PAIRS = (
    "cubic_stiffness",
    "quadratic_stiffness",
    "quadratic_damping",
    "coulomb_friction",
    "input_saturation",
    "force_constant_droop",
)
USUAL = {"chirp", "PRBS", "steps", "multisine"}
WAYS = ("designed", "PRBS", "random")
CAUTIOUS = 0.3  # share of the limits that the first record of a pair uses


def study_precision(name: str, fits: int) -> dict[str, Any]:
    """Designed width over that of the best other kind, and the spread of simulated estimates over the predicted width."""
    title, fixed, limits, duration, step, noise = PLANTS[name]
    model = find_model(title).fix(*fixed)
    began = time.process_time()
    plan = gb.design(model, limits=limits, duration=duration, sampling_time=step, noise=noise, options=REST)
    seconds = time.process_time() - began
    best_other = max(a.gain for a in plan.alternatives if a.kind == "input" and a.name in USUAL)
    run, names, estimates = gb.simulate(model, plan.experiment), list(plan.predicted), []
    for seed in range(fits):
        record = run.record(noise, np.random.default_rng(seed))
        result = gb.fit(model, record, noise=noise, options=REST)
        estimates.append([result.parameters[n].value for n in names])
    predicted = [plan.predicted[n].std_after or np.nan for n in names]
    spread = np.std(estimates, axis=0, ddof=1) if fits > 1 else np.full(len(names), np.nan)
    return {
        "kind": plan.kind,
        "width": best_other,
        "spread": dict(zip(names, (spread / predicted).tolist(), strict=True)),
        "fits": fits,
        "seconds": seconds,
    }


def study_pair(seed: int) -> dict[str, Any]:
    """How many designed records, and how many PRBS records, part two effects that a cautious record did not."""
    rng = np.random.default_rng(seed)
    right, wrong = (str(n) for n in rng.choice(PAIRS, 2, replace=False))
    answer: dict[str, Any] = {"right": right, "wrong": wrong, "alike": False}
    try:
        case = make(seed, "single", 600, effects=(right,), rig="micro_actuator")
    except OverflowError:  # drawn so strong that the twin flies apart: no case
        return answer
    model = find_model(case.model).fix(**case.known).start(**case.start)
    limits = {"u": SignalLimit(-3, 3)}
    noise = {n: case.sigma[n] for n in case.sigma}
    period = PERIOD[case.model]

    def measure(u: np.ndarray, number: int) -> gb.Experiment:
        y = np.array(simulate_rig(case.model, case.base, case.effects, u, period, 20))
        draw = np.random.default_rng([seed, number])
        outputs = {n: y[:, j] + s * draw.standard_normal(len(u)) for j, (n, s) in enumerate(noise.items())}
        return gb.Experiment(f"record {number}", period * np.arange(len(u)), {"u": u}, outputs)

    first = measure(CAUTIOUS * case.estimation.inputs["u"], 0)
    costs = lead(model, [first], noise, right, wrong)
    if costs is None or abs(costs[0]) >= 20:
        return answer
    answer["alike"] = True
    for way in WAYS:
        records, answer[way] = [first], None
        for number in (1, 2):
            plain = gb.fit(model, records, noise=noise, options=REST)
            models = tuple(fit_rival(plain, n) for n in (right, wrong))
            question = DesignProblem(
                models, limits, 0.15, period, noise, tuple(records), GoalName.DISCRIMINATION, options=REST
            )
            if way == "designed":
                u = answer_question(question).experiment.inputs["u"]
            else:
                hold = 0.004 / number
                levels = np.random.default_rng([seed, number]).uniform(-1, 1, round(question.duration / hold))
                shape = Prbs(hold, 12) if way == "PRBS" else Steps(tuple(levels.tolist()), question.duration)
                keeper = LimitKeeper(question, *list_plants(question))
                u = fit_into_limits(keeper, {"u": shape})[1]["u"]
            records.append(measure(u, number))
            costs = lead(model, records, noise, right, wrong)
            if costs is not None and costs[0] >= 20:
                answer[way] = number
                break
    return answer


def lead(
    model: gb.Model, records: list[gb.Experiment], noise: dict[str, float], right: str, wrong: str
) -> tuple[float, float] | None:
    """By how much the right effect's cost is below the wrong one's, and the misfit of the right one; None where a fit fails."""
    try:
        plain = gb.fit(model, records, noise=noise, options=REST)
        ends = [gb.validate(fit_rival(plain, n), records, noise=noise, options=REST) for n in (right, wrong)]
    except gb.GreyboxError:
        return None
    costs = [sum(m.samples * m.noise_ratio**2 for m in end.misfit.values()) for end in ends]
    return costs[1] - costs[0], max(m.noise_ratio for m in ends[0].misfit.values())


def study_campaign(seed: int, folder: Path) -> dict[str, Any]:
    """Whether a campaign names what a twin hides, alone, after how many records; and how far it took the twin's position."""
    case = make(seed, "single", 600, rig="micro_actuator")
    model = find_model(case.model).fix(**case.known).start(**case.start)
    reach = float(np.abs(case.estimation.outputs["x"]).max())
    limits = {"u": SignalLimit(-3, 3), "x": SignalLimit(-2 * reach, 2 * reach)}
    noise = dict(case.sigma)
    plan = CampaignPlan(model, limits, 0.15, PERIOD[case.model], noise, options=REST)
    place = folder / f"campaign-{seed:04d}"
    program = f"'{sys.executable}' -m fits.studies.design_study --rig {seed} {{input}} {{record}} {{number}}"
    result = run_campaign(plan, place, rig=program, workers=1)
    while result.status == "limit_broken":
        result = run_campaign(plan, place, rig=program, workers=1)
    last = result.steps[-1]
    families = [FAMILY.get(n, (n,)) for n in case.effects]
    records = [gb.read_csv(path, model) for path in sorted(place.glob("*/record.csv"))]
    return {
        "truth": list(case.effects),
        "said": list(last.effects),
        "right": len(last.effects) == 1 and any(last.effects[0] in family for family in families),
        "alone": not last.alternatives,
        "records": len(result.steps),
        "status": str(result.status),
        "reach": max(float(np.abs(r.outputs["x"]).max()) for r in records) / (2 * reach),
    }


def play_rig(seed: int, asked: Path, target: Path, number: int) -> None:
    """The rig program of a campaign: the twin of a case plays an input."""
    case = make(seed, "single", 600, rig="micro_actuator")
    with open(asked, newline="", encoding="utf-8") as file:
        rows = np.array(list(csv.reader(file))[1:], float)
    u = rows[:, 1]
    y = np.array(simulate_rig(case.model, case.base, case.effects, u, PERIOD[case.model], 20))
    rng = np.random.default_rng([seed, number])
    columns = {n: y[:, j] + s * rng.standard_normal(len(u)) for j, (n, s) in enumerate(case.sigma.items())}
    lines = [",".join(["time", "u", *columns])]
    lines += [",".join(repr(float(v)) for v in row) for row in zip(rows[:, 0], u, *columns.values(), strict=True)]
    write_file(target, "\n".join(lines) + "\n")


def study_time() -> dict[str, Any]:
    """Seconds for a record of 10 s at 1 kHz that parts three explanations."""
    model = find_model("plants/stage/stage.py")
    rivals = []
    for name, size in (("cubic_stiffness", 3e6), ("quadratic_damping", 20.0)):
        extended = model + gb.effect(name)
        amplitude = extended.bound_effects[-1].model_names[extended.effects[-1].amplitudes[0]]
        rivals.append(extended.start(**{amplitude: size}))
    began, cpu = time.perf_counter(), time.process_time()
    plan = gb.design(
        model,
        rivals=rivals,
        goal="discrimination",
        limits={"i": SignalLimit(-2, 2), "x": SignalLimit(-0.01, 0.01)},
        duration=10.0,
        sampling_time=1e-3,
        noise={"x": 1e-5},
        options=REST,
    )
    return {
        "wall": time.perf_counter() - began,
        "cpu": time.process_time() - cpu,
        "kind": plan.kind,
        "cost": min(plan.separation.values()),
    }


def cases(part: str, count: int, first: int, fits: int, folder: Path) -> Iterator[tuple[str, Any]]:
    """Name of each case, and what answers it."""
    if part == "precision":
        for name in list(PLANTS)[: count or None]:
            yield f"precision-{name.replace(' ', '_')}", lambda name=name: study_precision(name, fits)
    elif part == "time":
        yield "time", study_time
    elif part == "campaign":
        for seed in range(first, first + (count or 30)):
            yield f"campaign-{seed:04d}", lambda seed=seed: study_campaign(seed, folder)
    else:
        for seed in itertools.count(first):
            if sum(row["alike"] for _, row in rows_of(folder, "discrimination")) >= (count or 40):
                return
            yield f"discrimination-{seed:04d}", lambda seed=seed: study_pair(seed)


def rows_of(folder: Path, part: str) -> list[tuple[str, dict[str, Any]]]:
    """What is there of a part: the name of each case, and its row."""
    return [(p.stem, json.loads(p.read_text(encoding="utf-8"))) for p in sorted(folder.glob(f"{part}*.json"))]


def table(folder: Path) -> Iterator[str]:
    """What the folder holds, part by part."""
    for name, row in rows_of(folder, "precision"):
        spread = np.array(list(row["spread"].values()), float)
        confirmed = f"spread over predicted {np.sqrt(np.nanmean(spread**2)):.3f} ({row['fits']} fits)"
        yield f"{name}: width {row['width']:.2f} of the best other kind; {confirmed}; {row['seconds']:.0f} s"
    pairs = [row for _, row in rows_of(folder, "discrimination") if row["alike"]]
    for way in WAYS:
        parted = sum(r[way] is not None for r in pairs)
        if pairs:
            yield f"discrimination, {way}: {parted} of {len(pairs)} pairs parted by at most 2 further records"
    campaigns = [row for _, row in rows_of(folder, "campaign")]
    if campaigns:
        right = sum(r["right"] and r["alone"] for r in campaigns)
        reach = max(r["reach"] for r in campaigns)
        yield f"campaign: {right} of {len(campaigns)} right and alone; position at most {reach:.3f} of its limit"
    for _, row in rows_of(folder, "time"):
        yield f"time: {row['wall']:.0f} s, {row['cpu']:.0f} s of one core"


def main() -> None:
    if sys.argv[1:2] == ["--rig"]:
        seed, asked, target, number = sys.argv[2:6]
        play_rig(int(seed), Path(asked), Path(target), int(number))
        return
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("folder", type=Path)
    arguments.add_argument("--part", choices=("precision", "discrimination", "campaign", "time"), default="precision")
    arguments.add_argument("--cases", type=int, default=0, help="how many; 0: all plants, or 40 pairs or twins")
    arguments.add_argument("--first", type=int, default=1, help="first seed")
    arguments.add_argument("--fits", type=int, default=100, help="simulated experiments of each plant")
    chosen = arguments.parse_args()
    for name, answer in cases(chosen.part, chosen.cases, chosen.first, chosen.fits, chosen.folder):
        path = chosen.folder / f"{name}.json"
        if not path.exists():
            write_file(path, json.dumps(answer(), indent=1) + "\n")
    print("\n".join(table(chosen.folder)))


if __name__ == "__main__":
    main()
