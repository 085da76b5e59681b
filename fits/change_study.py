"""Change detection: how often a healthy machine is called changed, and how large a change must be to be named.

    python -m fits.change_study FILE [--part healthy|power|chart|population] [--cases N]

- healthy: machines that are as they were, each fitted and compared anew, in turn on four benches: a linear plant with known noise; the
  same with noise that nobody tells; a nonlinear plant with coloured noise and a quiet record; a fit of three records against two of
  today. 1 % false alarms are wanted.
- power: one constant of the second bench has changed by 3, 4, 5 and 6 standard deviations of the difference between both estimates; and
  by 3 standard deviations of what one record tells, where the fit and today have one, two, four or six records each. How often is it
  named, and how often is another constant named?
- chart: twelve records of a machine that wanders by 1 % from day to day; healthy, and with a jump of 5 % at a random place.
- population: ten machines that differ by 2 %; all of a kind, and with one or two that are off by 15 %.

Every case appends a line to FILE, so that the study goes on where it was stopped; every call prints the table of what is there.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

import greybox as gb
from greybox.extensions.changes.chart import chart_changes
from greybox.extensions.changes.population import survey_population
from models.silverbox import silverbox

PERIOD = 1.6384e-3
LEVEL = 1e-3
QUICK = gb.FitOptions(progressive=False)
REST = gb.FitOptions(progressive=False, at_rest=True)
CUBIC = silverbox + gb.effect("cubic_stiffness")
STIFFENING = next(name for name in CUBIC.values if name not in silverbox.values)
NONLINEAR = CUBIC.start(**{STIFFENING: 4e6})
BENCHES = ("known noise", "untold noise", "nonlinear, coloured", "three and two")
DEVIATIONS = (3.0, 4.0, 5.0, 6.0)
RECORDS = (1, 2, 4, 6)
WANDERING, JUMP = 0.01, 0.05
SPREAD, OFF = 0.02, 0.15


def measure(
    model: gb.Model,
    generator: np.random.Generator,
    rows: int = 250,
    colour: float = 0.0,
    name: str = "",
    size: float = 0.1,
) -> gb.Experiment:
    """A record under a random telegraph signal, with noise of an autoregression of the first order."""
    u = size * generator.choice([-1.0, 1.0], rows // 5).repeat(5)
    run = gb.simulate(model, {"time": PERIOD * np.arange(len(u)), "u": u})
    noise = LEVEL * generator.standard_normal(len(u))
    for k in range(1, len(u)):
        noise[k] = colour * noise[k - 1] + np.sqrt(1 - colour**2) * noise[k]
    return gb.Experiment(name or "record", run.time, {"u": u}, {"y": run.outputs["y"] + noise})


def measure_healthy(seed: int) -> dict[str, Any]:
    """One machine that is as it was, fitted and compared."""
    bench, generator = BENCHES[seed % len(BENCHES)], np.random.default_rng(seed)
    if bench == "nonlinear, coloured":
        model, options, colour = NONLINEAR, REST, 0.6
    else:
        model, options, colour = silverbox, REST if bench == "known noise" else QUICK, 0.0
    counts = (3, 2) if bench == "three and two" else (1, 1)
    before, today = ([measure(model, generator, colour=colour) for _ in range(count)] for count in counts)
    quiet = [measure(model, generator, 500, colour, size=0.0)] if colour else []
    noise = {"y": LEVEL} if bench == "known noise" else None
    reference = gb.fit(model, before, noise=noise, quiet=quiet, options=options)
    change = gb.detect_changes(reference, today, search_effects=False)
    checks = {f"{c.rule} {c.subject}".strip(): c.value for c in change.checks}
    return {"bench": bench, "verdict": change.verdict, "moved": change.moved, "p": checks}


def measure_power(seed: int) -> dict[str, Any]:
    """One constant has changed: by how much it must, and what more records bring."""
    generator, ways = np.random.default_rng([1, seed]), [*DEVIATIONS, *(f"{n} records" for n in RECORDS)]
    way = ways[seed % len(ways)]
    count = int(way.split()[0]) if isinstance(way, str) else 1
    before = [measure(silverbox, generator) for _ in range(count)]
    reference = gb.fit(silverbox, before, options=QUICK)
    name = str(generator.choice(list(silverbox.values)))
    one = reference.parameters[name].std or np.nan
    # What one record tells is known from as many: each tells as much.
    change = 3 * one * np.sqrt(count) if isinstance(way, str) else way * one * np.sqrt(2)
    value = silverbox.values[name] + float(generator.choice([-1.0, 1.0])) * change
    today = [measure(silverbox.start(**{name: value}), generator) for _ in range(count)]
    found = gb.detect_changes(reference, today, search_effects=False)
    return {
        "way": way if isinstance(way, str) else f"{way:g} deviations",
        "verdict": found.verdict,
        "named": name in found.moved,
        "others": [other for other in found.moved if other != name],
    }


def measure_chart(seed: int) -> dict[str, Any]:
    """Twelve records of a machine that wanders, and, every second time, jumps."""
    generator = np.random.default_rng([2, seed])
    jumps, place = bool(seed % 2), int(generator.integers(3, 11))
    reference = gb.fit(silverbox, measure(silverbox, generator), options=QUICK)
    records = []
    for k in range(12):
        share = np.exp(WANDERING * generator.standard_normal()) * (1 + JUMP * (jumps and k >= place))
        model = silverbox.start(d=float(silverbox.values["d"] * share))
        records.append(measure(model, generator, name=f"day {k + 1}"))
    course = chart_changes(reference, records)
    points = [(c.constant, c.number) for c in course.change_points]
    return {
        "jumps": jumps,
        "points": points,
        "right": points == [("d", place + 1)],
        "near": _is_near(points, place + 1),
    }


def _is_near(points: Sequence[tuple[str, int]], place: int) -> bool:
    return len(points) == 1 and points[0][0] == "d" and abs(points[0][1] - place) <= 1


def measure_population(seed: int) -> dict[str, Any]:
    """Ten machines of a kind of which none, one or two are off."""
    generator, off = np.random.default_rng([3, seed]), seed % 3
    reference = gb.fit(silverbox, measure(silverbox, generator), options=QUICK)
    machines = {}
    for k in range(10):
        share = np.exp(SPREAD * generator.standard_normal()) * (1 + OFF * (k < off))
        machines[f"{k}"] = [measure(silverbox.start(d=float(silverbox.values["d"] * share)), generator)]
    survey = survey_population(reference, machines)
    outside = [machine.name for machine in survey.machines if machine.outlying]
    return {"off": off, "outside": outside, "right": outside == [f"{k}" for k in range(off)]}


PARTS = {"healthy": measure_healthy, "power": measure_power, "chart": measure_chart, "population": measure_population}


def run_part(path: Path, part: str, cases: int) -> None:
    """The cases of one part that the file lacks, each a line."""
    done = {line["case"] for line in read_lines(path) if line["part"] == part}
    path.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(cases):
        if seed in done:
            continue
        answer = {"part": part, "case": seed, **PARTS[part](seed)}
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(answer) + "\n")


def read_lines(path: Path) -> list[dict[str, Any]]:
    """What was measured so far; a line that was cut off is left out."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def tabulate(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line of figures for each kind of case, shares with their 95 % intervals."""
    groups: dict[str, list[bool]] = defaultdict(list)
    for line in lines:
        if line["part"] == "healthy":
            for group in ("healthy", f"healthy, {line['bench']}"):
                groups[f"{group}: called changed"].append(line["verdict"] == "changed")
            groups["healthy: cannot tell"].append(line["verdict"] == "cannot tell")
        elif line["part"] == "power":
            groups[f"changed by {line['way']}: called changed"].append(line["verdict"] == "changed")
            groups[f"changed by {line['way']}: named"].append(line["named"])
            groups["changed: another constant named"].append(bool(line["others"]))
        elif line["part"] == "chart":
            if line["jumps"]:
                groups["chart, a jump: found within one record"].append(line["near"])
                groups["chart, a jump: found at its record"].append(line["right"])
            else:
                groups["chart, no jump: one found"].append(bool(line["points"]))
        else:
            groups[f"population, {line['off']} off: right"].append(line["right"])
    return [_describe_share(name, sum(map(bool, group)), len(group)) for name, group in sorted(groups.items())]


def _describe_share(name: str, count: int, of: int) -> str:
    low = float(beta.ppf(0.025, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0
    return f"{name:60s} {count:5d} of {of:5d}  {100 * count / of:6.2f} %  ({100 * low:.2f} to {100 * high:.2f} %)"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--part", choices=[*PARTS], default=None)
    parser.add_argument("--cases", type=int, default=2000)
    asked = parser.parse_args()
    if asked.part:
        run_part(asked.file, asked.part, asked.cases)
    print("\n".join(tabulate(read_lines(asked.file))))
