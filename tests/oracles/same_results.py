"""The same results as before, to the last bit: store what the command line writes, and compare two stores.

    python -m tests.oracles.same_results store FOLDER [NAMES...] [--checkout DIR] [--shared DIR]
    python -m tests.oracles.same_results compare OLD NEW [NAMES...] [--relative 1e-9]
    python -m tests.oracles.same_results list

`store` runs about thirty-five problems through the command line of a checkout (this one, or another commit's) and keeps
`fit.json`, `discovery.json`, `compare.json`, simulated records and exports. `compare` walks through two stores. A change
of shape or wording leaves every number as it was; a change of an algorithm passes under a tolerance. Both stores come
from the same machine: another compiler or BLAS library moves last digits.

Only the command line and, for what it merely prints, the public verbs are used. Options and JSON keys are contracts, so
that the script works on every commit however the library is cut. Left out are times, versions, paths and sentences:
every string except names of effects, sites and parameters, verdicts and grades of a discovery, and fingerprints of
records. Keys that only one store has are told apart: added ones are told, removed ones fail. Exported code is compared
line by line without its comments; a model file in Python by its numbers, in their order. The code of a functional mock-up
unit is that of the C export; fitted to a record it is compared as a fit.
"""

from __future__ import annotations

import argparse
import bisect
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

CHECKOUT = Path(__file__).resolve().parents[2]
AT_ONCE = 2
LIMIT = 600.0  # seconds of one command, far more than any needs

# Values of these keys are times, versions or sentences, whatever they hold.
LEFT_OUT = frozenset(
    [
        "notes",
        "findings",
        "checks",
        "meaning",
        "story",
        "remarks",
        "next_steps",
        "equations",
        "seconds",
        "versions",
        "policy",
        "strategy",
    ]
)
# Strings are compared under these keys only, and only where they are words without blanks.
NAMES = frozenset(["name", "effects", "alternatives", "site", "free", "verdict", "grade", "fingerprint", "data"])

LEVITATION = '''
"""A ball under a magnet, linear about its gap: unstable."""

from greybox import Balance, Input, Model, Output, Parameter, State

levitation = Model(
    "levitation",
    [State("x", "mm"), State("v", "mm/s")],
    [Input("u", "A")],
    [Output("x", "mm")],
    [Parameter("k", "1/s**2", 900.0, (1.0, 1e5)), Parameter("b", "mm/(s**2*A)", 400.0, (1.0, 1e5))],
    lambda x, u, p: [
        Balance("position", "mm/s", 1, "x", velocity=x.v),
        Balance("force", "mm/s**2", 1, "v", gap=p.k * x.x, current=p.b * u.u),
    ],
)
'''

# What the command line only prints: profiles, bootstraps, predictions and smoothed states, by the public verbs.
VERBS = '''
import dataclasses, json, sys
import greybox as gb
import numpy as np
from greybox.estimation.uncertainty import bootstrap, profile
from models.micro_actuator import micro_actuator
from models.silverbox import silverbox

def numbers(value):
    """All numbers that a result holds, whatever its fields are called."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        shown = [f.name for f in dataclasses.fields(value) if f.name[0] != "_" and f.name != "seconds"]
        return [x for name in shown for x in numbers(getattr(value, name))]
    if isinstance(value, dict):
        return [x for item in value.values() for x in numbers(item)]
    if isinstance(value, (list, tuple)):
        return [x for item in value for x in numbers(item)]
    if isinstance(value, np.ndarray) and value.dtype.kind in "fi":
        return value.ravel().tolist()
    return [value] if isinstance(value, float) else []

def respond():
    """A fit to a frequency response, and the best linear approximation of two periods of a multisine."""
    frequency = np.geomspace(5.0, 200.0, 40)
    s = 2j * np.pi * frequency
    values = 1.1 * 1.9e5 / (s**2 + 45.0 * s + 2e5)
    points = gb.frequency.FrequencyResponse(frequency, values[:, None, None], ("u",), ("y",))
    result = gb.frequency.fit_frequency_response(silverbox, points)
    return {name: estimate.value for name, estimate in result.parameters.items()}

records = sys.argv[1]
chirp = gb.read_csv(f"{records}/silverbox_chirp.csv", silverbox, hold="first")
fitted = gb.fit(silverbox, chirp)
driven = gb.read_csv(f"{records}/actuator.csv", micro_actuator)
filtered = gb.fit(micro_actuator.fix("M", "Ra").with_process_noise("v"), driven)
found = {
    "profile": profile(fitted, "k1"),
    "bootstrap": bootstrap(fitted, np.random.default_rng(0), replicates=100),
    "predict": gb.predict(fitted, chirp, steps=3),
    "smooth": gb.smooth(filtered, driven),
    "predict_filtered": gb.predict(filtered, driven, steps=2),
    "frequency": respond(),
}
print(json.dumps({name: {"numbers": numbers(value)} for name, value in found.items()}))
'''


@dataclass(frozen=True)
class Problem:
    """Commands of the program, run one after the other in a folder of their own.

    `{records}` and `{shared}` in a command stand for these folders; `needs` are paths below `shared` without which the
    problem is skipped.
    """

    name: str
    commands: tuple[str, ...]
    needs: tuple[str, ...] = ()


ACTUATOR = "micro_actuator --multisine 2 --band 5:400 --duration {} --sampling-time 5e-4 --noise x=2e-7 --noise i=5e-3"
CYLINDER = (
    "pneumatic_cylinder --multisine 1.5 --band 0.2:4 --duration {} --sampling-time 0.01"
    " --noise s=1e-4 --noise p_a=500 --noise p_b=500"
)
WEIGHED = "--fix M=0.01 --fix Ra=8 --start K=7000 --start B=0.2 --start Kf=1.2"

SIMULATED = {
    "actuator": ACTUATOR.format(0.3) + " --seed 1",
    "actuator_second": ACTUATOR.format(0.25) + " --seed 2",
    "actuator_third": ACTUATOR.format(0.2) + " --seed 3 --set Ra=8.4",
    "actuator_other": ACTUATOR.format(0.2) + " --seed 4",
    "actuator_step": "micro_actuator --step 1 --duration 0.1 --sampling-time 5e-4 --noise x=2e-7 --noise i=5e-3 --seed 5",
    "actuator_friction": ACTUATOR.format(0.3) + " --seed 6 --effect coulomb_friction",
    "cylinder": CYLINDER.format(5) + " --seed 1",
    "cylinder_other": CYLINDER.format(4) + " --seed 2 --set P_S=7e5",
    "silverbox_chirp": "silverbox --chirp 0.05 --band 10:150 --duration 0.4 --sampling-time 1e-3 --noise y=1e-4 --hold first",
    "actuator_worn": ACTUATOR.format(0.3) + " --seed 8 --set B=0.4",
    "actuator_irregular": "micro_actuator irregular_input.csv --noise x=2e-7 --noise i=5e-3 --seed 7",
    "cylinder_nonlinear": "pneumatic_full --multisine 1 --band 0.2:3 --duration 2 --sampling-time 0.01"
    " --noise s=1e-4 --noise p_a=500 --noise p_b=500",
}


def fit(name: str, arguments: str, *further: str, needs: tuple[str, ...] = ()) -> Problem:
    return Problem(name, (f"fit {arguments} --output fit", *further), needs)


def exports(at: str = "") -> tuple[str, ...]:
    linear = [
        f"export fit/fit.json --to {to} --output linear.{end} {at}" for to, end in (("json", "json"), ("mat", "mat"))
    ]
    return (
        *linear,
        f"export fit/fit.json --to numpy --output linear.npz --dt 0.001 --delay 0.0004 --samples 3 --seed 1 {at}",
        f"export fit/fit.json --to control --output linear_control.py {at}",
        "export fit/fit.json --to c --output plant.c",
        "export fit/fit.json --to modelica --output plant.mo",
        "export fit/fit.json --to python --output plant.py",
    )


def discover(case: int, arguments: str = "") -> Problem:
    return Problem(
        f"discover_{case:03d}", (f"blind {case:03d} {arguments} --output discovery",), (f"blind/case-{case:03d}",)
    )


def public(model: str, train: str, test: str, arguments: str, rows: int) -> Problem:
    """A fit to the first rows of a public record; whole ones take longer and show no more."""
    needs = (f"data/{train}", f"data/{test}")
    cut = tuple(f"cut data/{file} {name}.csv {rows}" for file, name in ((train, "train"), (test, "test")))
    return Problem(f"fit_{model}", (*cut, f"fit {model} train.csv --validate test.csv {arguments} --output fit"), needs)


PROBLEMS = (
    Problem("simulated", tuple(f"simulate {arguments} --output {name}.csv" for name, arguments in SIMULATED.items())),
    fit(
        "fit_actuator",
        f"micro_actuator {{records}}/actuator.csv --validate {{records}}/actuator_other.csv {WEIGHED}",
        *exports(),
    ),
    fit(
        "fit_cylinder",
        "pneumatic_cylinder {records}/cylinder.csv --at-rest --predict 1 --predict 5",
        *exports("--at u=0.5"),
    ),
    fit(
        "fit_nonlinear_cylinder",
        "pneumatic_full {records}/cylinder_nonlinear.csv --at-rest --start f_v=90 --method midpoint",
    ),
    public(
        "silverbox",
        "silverbox/train_multisine.csv",
        "silverbox/test_multisine.csv",
        "--effect cubic_stiffness --hold band-limited --skip 50",
        1500,
    ),
    public(
        "emps", "emps/train.csv", "emps/test.csv", "--effect coulomb_friction --effect constant_load --hold first", 4000
    ),
    public(
        "cascaded_tanks", "cascaded_tanks/train.csv", "cascaded_tanks/test.csv", "--process-noise x1 --skip 10", 600
    ),
    fit(
        "fit_process_noise",
        f"micro_actuator {{records}}/actuator.csv --process-noise v {WEIGHED} --validate {{records}}/actuator_other.csv",
    ),
    fit("fit_unstable", "levitation.py unstable.csv --noise x=0.002"),
    fit("fit_irregular", f"micro_actuator irregular.csv {WEIGHED} --noise x=2e-7 --noise i=5e-3"),
    fit("fit_holes", f"micro_actuator holes.csv --split-holes {WEIGHED}"),
    fit("fit_robust", f"micro_actuator outliers.csv --loss huber:1.5 {WEIGHED} --noise x=2e-7 --noise i=5e-3"),
    fit("fit_student", f"micro_actuator outliers.csv --loss student:4 {WEIGHED}"),
    fit(
        "fit_several",
        "micro_actuator {records}/actuator.csv {records}/actuator_second.csv {records}/actuator_third.csv"
        " --own Ra --tie Kv=Kf --prior M=0.0100+-0.0001 --free M --start K=6500 --validate {records}/actuator_other.csv",
    ),
    fit(
        "fit_conditions",
        "pneumatic_cylinder {records}/cylinder.csv {records}/cylinder_other.csv --condition P_S=8e5,7e5 --at-rest",
    ),
    fit("fit_multiple_shooting", f"micro_actuator {{records}}/actuator.csv --transcription multiple {WEIGHED}"),
    fit("fit_collocation", "silverbox {records}/silverbox_chirp.csv --hold first --transcription collocation-radau"),
    fit("fit_arcs", f"micro_actuator {{records}}/actuator.csv --transcription arcs --arc-length 0.05 {WEIGHED}"),
    fit(
        "fit_multistart",
        "micro_actuator_no_inductance {records}/actuator_step.csv --starts 4 --seed 7 --fix M --fix Ra",
    ),
    fit("fit_friction", f"micro_actuator {{records}}/actuator_friction.csv --effect coulomb_friction {WEIGHED}"),
    Problem(
        "compare_actuator",
        (
            f"compare micro_actuator {{records}}/actuator.csv --validate {{records}}/actuator_other.csv {WEIGHED}"
            " --effects coulomb_friction --output comparison",
        ),
    ),
    Problem(
        "check",
        (
            f"check micro_actuator {{records}}/actuator.csv {WEIGHED} --output actuator",
            "check pneumatic_cylinder --output cylinder",
            "check silverbox --outputs y --output silverbox",
        ),
    ),
    Problem("verbs", ("verbs",)),
    Problem(
        "design",
        (
            "design silverbox --limit u=-1:1 --duration 0.2 --sampling-time 1e-3 --noise y=1e-4 --output precision",
            "design silverbox --limit u=-1:1 --duration 0.1 --sampling-time 1e-3 --noise y=1e-4 --goal detection"
            " --effect cubic_stiffness --output detection",
        ),
    ),
    Problem(
        "changed",
        (
            f"fit micro_actuator {{records}}/actuator.csv {WEIGHED} --noise x=2e-7 --noise i=5e-3 --output fit",
            "changed fit/fit.json {records}/actuator_other.csv --output healthy",
            "changed fit/fit.json {records}/actuator_worn.csv --output worn",
            "changed fit/fit.json {records}/actuator_friction.csv --no-effects --output incomplete",
        ),
    ),
    Problem(
        "campaign",
        (
            "campaign silverbox --limit u=-2:2 --duration 0.2 --sampling-time 1e-3 --noise y=1e-4 --experiments 1"
            " --effect cubic_stiffness --at-rest --output campaign --rig"
            " '{python} -m greybox simulate silverbox {{input}} --noise y=1e-4 --seed 3 --set d=50 --output {{record}} --no-report'",
        ),
    ),
    Problem(
        "laws",
        (
            "simulate silverbox --multisine 2 --band 5:200 --duration 0.5 --sampling-time 1e-3 --noise y=1e-4 --seed 1"
            " --effect cubic_stiffness --set K3=2e4 --output train.csv",
            "simulate silverbox --multisine 2 --band 5:200 --duration 0.5 --sampling-time 1e-3 --noise y=1e-4 --seed 2"
            " --effect cubic_stiffness --set K3=2e4 --output test.csv",
            "discover silverbox train.csv --validate test.csv --noise y=1e-4 --at-rest --effects constant_load --laws"
            " --output laws",
        ),
    ),
    Problem(
        "fmu",
        (
            f"fit micro_actuator {{records}}/actuator.csv {WEIGHED} --output fit",
            "export fit/fit.json --to fmu --output plant.fmu",
            "fit plant.fmu {records}/actuator.csv --free K --free B --start K=6000 --output fmu",
        ),
    ),
    discover(1, "--effects coulomb_friction,cubic_stiffness,transport_delay"),
    discover(6, "--effects coulomb_friction,valve_dead_zone,valve_lag"),
    discover(16, "--effects coulomb_friction,stribeck_friction,quadratic_damping"),
    discover(30, "--effects quadratic_stiffness,cubic_stiffness,viscoelastic_creep --further"),
    discover(42),
    discover(45, "--effects cubic_stiffness,coulomb_friction"),
)


# --- store ---------------------------------------------------------------------------------------------------------------


def store(folder: Path, names: list[str], checkout: Path, shared: Path) -> int:
    """Run the problems (all, or those named) into `folder`; returns the number of failed ones."""
    wanted = [p for p in PROBLEMS if (not names or p.name in names) and p.name != "simulated"]
    folder = folder.resolve()
    records = folder / "simulated"
    print(f"simulated: {run(PROBLEMS[0], folder, records, checkout, shared)}", flush=True)

    def one(problem: Problem) -> str:
        outcome = run(problem, folder, records, checkout, shared)
        print(f"{problem.name}: {outcome}", flush=True)
        return outcome

    with ThreadPoolExecutor(AT_ONCE) as pool:
        outcomes = list(pool.map(one, wanted))
    return sum("failed" in outcome for outcome in outcomes)


def run(problem: Problem, folder: Path, records: Path, checkout: Path, shared: Path) -> str:
    missing = [need for need in problem.needs if not (shared / need).exists()]
    if missing:
        return f"skipped, {', '.join(missing)} is missing"
    place = folder / problem.name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    prepare(problem.name, place, records)
    began = time.monotonic()
    for command in problem.commands:
        words = shlex.split(command.format(records=records, shared=shared, python=sys.executable))
        if words[0] == "cut":
            cut(shared / words[1], place / words[2], int(words[3]))
            continue
        if words[0] == "blind":
            words = ["discover", *blind(shared / "blind" / f"case-{words[1]}"), *words[2:]]
        program = ["-c", VERBS, str(records)] if words[0] == "verbs" else ["-m", "greybox", *words, "--no-report"]
        done = subprocess.run(
            [sys.executable, *program],
            cwd=place,
            env=environment(checkout),
            capture_output=True,
            text=True,
            timeout=LIMIT,
            check=False,
        )
        if words[0] == "verbs" and not done.returncode:
            (place / "verbs.json").write_text(done.stdout)
        with (place / "log.txt").open("a") as log:
            printed = "" if words[0] == "verbs" else done.stdout
            log.write(f"$ {command}\n{printed}{done.stderr}exit code {done.returncode}\n")
        if done.returncode not in (0, 1):
            return f"failed: {command}: {(done.stderr.strip().splitlines() or ['no word'])[-1]}"
    for picture in (*place.rglob("*.png"), *place.rglob("*.svg")):
        picture.unlink()
    return f"{time.monotonic() - began:.1f} s"


def environment(checkout: Path) -> dict[str, str]:
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **one_thread, "PYTHONPATH": str(checkout), "PYTHONHASHSEED": "0", "COLUMNS": "120"}


def blind(case: Path) -> list[str]:
    """Arguments of `discover` for a prepared case, as whoever meets it would give them."""
    given = json.loads((case / "case.json").read_text())
    words = [given["model"], str(case / "estimation.csv"), "--validate", str(case / "validation.csv")]
    for option, values in (
        ("--fix", given["known"]),
        ("--start", given["start"]),
        ("--noise", given.get("noise") or {}),
    ):
        words += [word for name, value in values.items() for word in (option, f"{name}={value:.8g}")]
    words += ["--at-rest"] if given.get("at_rest") else []
    return words + (["--quiet", str(case / given["quiet"])] if given.get("quiet") else [])


def cut(source: Path, target: Path, rows: int) -> None:
    target.write_text("".join(source.read_text().splitlines(keepends=True)[: rows + 1]))


def prepare(name: str, place: Path, records: Path) -> None:
    """Records and model files that `greybox simulate` does not make."""
    if name == "simulated":
        (place / "irregular_input.csv").write_text(irregular_input())
    if name == "fit_unstable":
        (place / "levitation.py").write_text(LEVITATION)
        (place / "unstable.csv").write_text(unstable_record())
    if name in ("fit_irregular", "fit_holes", "fit_robust", "fit_student"):
        source = "actuator_irregular" if name == "fit_irregular" else "actuator"
        head, *rows = (records / f"{source}.csv").read_text().splitlines()
        draw = np.random.default_rng(1)
        if name == "fit_irregular":
            rows = [gap(row) if k % 41 == 7 else row for k, row in enumerate(rows)]
            (place / "irregular.csv").write_text("\n".join([head, *rows, ""]))
        elif name == "fit_holes":
            rows = rows[:200] + rows[260:420] + rows[440:]
            (place / "holes.csv").write_text("\n".join([head, *rows, ""]))
        else:
            rows = [outlier(row, float(draw.normal())) if k % 29 == 3 else row for k, row in enumerate(rows)]
            (place / "outliers.csv").write_text("\n".join([head, *rows, ""]))


def irregular_input() -> str:
    """A held input that changes at irregular times, as an event recorder keeps it."""
    draw = np.random.default_rng(2)
    time_ = np.cumsum(draw.uniform(2e-4, 9e-4, 500))
    levels = np.repeat(draw.normal(size=100), 5)
    return "\n".join(["time [s],u [V]", *(f"{t:.9g},{u:.9g}" for t, u in zip(time_, levels, strict=True)), ""])


def gap(row: str) -> str:
    return row.rpartition(",")[0] + ","


def outlier(row: str, size: float) -> str:
    head, value = row.rpartition(",")[::2]
    return f"{head},{float(value) + 0.2 * size!r}"


def unstable_record() -> str:
    """The levitated ball, held up by a controller: an exact step of x'' = 900 x + 400 u for a held input."""
    rate, gain, period, rows = 30.0, 400.0, 0.005, 400
    draw = np.random.default_rng(1)
    time_ = np.arange(rows) * period
    frequencies, phases = np.linspace(1.0, 15.0, 12), draw.uniform(0, 2 * np.pi, 12)
    push = 0.15 * np.sin(2 * np.pi * np.outer(time_, frequencies) + phases).sum(axis=1)
    noise = 0.002 * draw.normal(size=rows)
    c, s = math.cosh(rate * period), math.sinh(rate * period)
    x, v, lines = 0.1, 0.0, ["time [s],u [A],x [mm]"]
    for k in range(rows):
        u = push[k] - 8.0 * x - 0.2 * v
        lines.append(f"{time_[k]:.6g},{u:.12g},{x + noise[k]:.12g}")
        shift = gain * u / rate**2
        x, v = c * (x + shift) + s * v / rate - shift, rate * s * (x + shift) + c * v
    return "\n".join([*lines, ""])


# --- compare -------------------------------------------------------------------------------------------------------------


@dataclass
class Difference:
    """What two stores of one problem hold that is not the same."""

    compared: int = 0
    changed: list[str] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    added: list[str] = field(default_factory=list)


def compare(old: Path, new: Path, names: list[str], relative: float, quiet: bool = False) -> int:
    """Print a line for each problem and the first differences; returns 1 if any number changed or a key is gone."""
    bad = 0
    problems = [p.name for p in PROBLEMS if not names or p.name in names]
    for name in problems:
        if not (old / name).is_dir():
            print(f"{name:24} not in {old}")
            continue
        seen = compare_folders(old / name, new / name, relative)
        fails = bool(seen.changed or seen.removed or not seen.compared)
        bad += fails
        added = f", {len(seen.added)} keys added" if seen.added else ""
        if quiet and not fails and not seen.added:
            continue
        print(f"{name:24} {'DIFFERS' if fails else 'same':8} {seen.compared:7} values{added}")
        for title, lines in (("changed", seen.changed), ("removed", seen.removed), ("added", seen.added)):
            for line in lines[:6]:
                print(f"    {title}: {line}")
            if len(lines) > 6:
                print(f"    {title}: and {len(lines) - 6} more")
    print(
        f"{len(problems) - bad} of {len(problems)} the same"
        + (f" within {relative:g} relative" if relative else ", to the bit")
    )
    return int(bad > 0)


def compare_folders(old: Path, new: Path, relative: float) -> Difference:
    seen = Difference()
    for file in sorted(old.rglob("*")):
        read = READERS.get(file.suffix)
        if read is None or file.name == "log.txt" or file.name == "journal.jsonl":
            continue
        other = new / file.relative_to(old)
        if not other.is_file():
            seen.removed.append(str(file.relative_to(old)))
            continue
        compare_values(read(file), read(other), str(file.relative_to(old)), "", seen, relative)
    return seen


def compare_values(old: object, new: object, where: str, key: str, seen: Difference, relative: float) -> None:
    """Walk through two values; `key` is the last name on the way."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in old:
            if name in LEFT_OUT:
                continue
            if name not in new:
                seen.removed.append(f"{where}.{name}")
            else:
                compare_values(old[name], new[name], f"{where}.{name}", name, seen, relative)
        seen.added += [f"{where}.{name}" for name in new if name not in old and name not in LEFT_OUT]
    elif key == "numbers" and isinstance(old, list) and isinstance(new, list):
        compare_sorted(old, new, where, seen, relative)
    elif isinstance(old, list) and isinstance(new, list):
        if all(isinstance(item, str) and " " in item for item in [*old, *new]):
            return
        if len(old) != len(new):
            seen.changed.append(f"{where}: {len(old)} entries, now {len(new)}")
            return
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            compare_values(a, b, f"{where}[{k}]", key, seen, relative)
    elif isinstance(old, str):
        if key == "code" or (key in NAMES and " " not in old and "/" not in old):
            seen.compared += 1
            if old != new:
                seen.changed.append(f"{where}: {old!r}, now {new!r}")
    else:
        seen.compared += 1
        if not equal(old, new, relative):
            seen.changed.append(f"{where}: {old!r}, now {new!r}{apart(old, new)}")


def compare_sorted(old: list[float], new: list[float], where: str, seen: Difference, relative: float) -> None:
    """Every old number is still there, in whatever field and order; new ones may have come."""
    left = sorted(new)
    for number in sorted(old):
        seen.compared += 1
        k = min(bisect.bisect_left(left, number), len(left) - 1)
        near = [j for j in (k, k - 1) if j >= 0 and equal(number, left[j], relative)]
        if near:
            left.pop(near[0])
        else:
            seen.changed.append(f"{where}: {number!r} is gone")
    seen.added += [f"{where}: {number!r}" for number in left]


def equal(old: object, new: object, relative: float) -> bool:
    if isinstance(old, int | float) and isinstance(new, int | float) and not isinstance(old, bool):
        if math.isnan(old) or math.isnan(new):
            return math.isnan(old) and math.isnan(new)
        return old == new or (relative > 0 and math.isclose(old, new, rel_tol=relative, abs_tol=0.0))
    return type(old) is type(new) and old == new


def apart(old: object, new: object) -> str:
    if isinstance(old, float) and isinstance(new, float) and old:
        return f" ({abs(new - old) / abs(old):.1e} relative)"
    return ""


# --- files as values -------------------------------------------------------------------------------------------------------


def read_mat(file: Path) -> object:
    from scipy.io import loadmat

    return plain({k: v for k, v in loadmat(file).items() if not k.startswith("__")})


def read_npz(file: Path) -> object:
    with np.load(file, allow_pickle=False) as data:
        return {name: plain(data[name]) for name in data.files}


def plain(value: object) -> object:
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        if value.dtype.names:
            return [{name: plain(item[name]) for name in value.dtype.names} for item in value.ravel()]
        if value.dtype.kind == "O":
            return [plain(item) for item in value.ravel()]
        if value.dtype.kind == "c":
            return [[value.real.tolist(), value.imag.tolist()]]
        return value.tolist()
    return value


def read_table(file: Path) -> object:
    rows = [line for line in file.read_text().splitlines() if line and not line.startswith("#")]
    return {"head": rows[0].split(","), "rows": [[float(cell or "nan") for cell in row.split(",")] for row in rows[1:]]}


def read_code(file: Path) -> object:
    """Lines of C or Modelica without comments, strings and blanks at their ends."""
    text = re.sub(r"/\*.*?\*/", "", file.read_text(), flags=re.DOTALL)
    text = re.sub(r"//[^\n]*", "", re.sub(r'"[^"\n]*"', '""', text))
    return {"code": [re.sub(r"\s+", "", line) for line in text.splitlines() if line.strip()]}


NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")


def read_python(file: Path) -> object:
    """The numbers of a Python file, without those in strings and comments."""
    text = re.sub(r'""".*?"""|"[^"\n]*"|\'[^\'\n]*\'', "", file.read_text(), flags=re.DOTALL)
    return [float(number) for line in text.splitlines() for number in NUMBER.findall(line.partition("#")[0])]


READERS: dict[str, Callable[[Path], object]] = {
    ".json": lambda file: json.loads(file.read_text()),
    ".mat": read_mat,
    ".npz": read_npz,
    ".csv": read_table,
    ".c": read_code,
    ".h": read_code,
    ".mo": read_code,
    ".py": read_python,
}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Store results of the command line, and compare two stores.")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verb = verbs.add_parser("store")
    verb.add_argument("folder", type=Path)
    verb.add_argument("names", nargs="*")
    verb.add_argument("--checkout", type=Path, default=CHECKOUT, help="the tree that holds greybox/ and models/")
    verb.add_argument(
        "--shared", type=Path, default=CHECKOUT.parent / "shared", help="the folder with data/ and blind/"
    )
    verb = verbs.add_parser("compare")
    verb.add_argument("old", type=Path)
    verb.add_argument("new", type=Path)
    verb.add_argument("names", nargs="*")
    verb.add_argument("--relative", type=float, default=0.0, help="relative change that passes (0: to the bit)")
    verb.add_argument("--quiet", action="store_true", help="leave out problems with the same results")
    verbs.add_parser("list")
    given = parser.parse_args(arguments)
    if given.verb == "list":
        print("\n".join(problem.name for problem in PROBLEMS))
        return 0
    unknown = sorted(set(given.names) - {problem.name for problem in PROBLEMS})
    if unknown:
        parser.error(f"unknown problems {', '.join(unknown)}; see list")
    if given.verb == "store":
        return int(store(given.folder, given.names, given.checkout.resolve(), given.shared.resolve()) > 0)
    return compare(given.old, given.new, given.names, given.relative, given.quiet)


if __name__ == "__main__":
    sys.exit(main())
