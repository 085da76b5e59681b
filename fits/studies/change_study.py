"""Change detection: how often a healthy machine is called changed, and how large a change must be to be named.

    python -m fits.studies.change_study FILE [--part healthy|power|runs|chart|population] [--first K] [--cases N]

- healthy: machines that are as they were, each fitted and compared anew, in turn on four benches: a linear plant with known noise; the
  same with noise that nobody tells; a nonlinear plant with coloured noise and a quiet record; a fit of three records against two of
  today. 1 % false alarms are wanted.
- power: one constant of the second bench has changed by 3, 4, 5 and 6 standard deviations of the difference between both estimates; and
  by 3 standard deviations of what one record tells, where the fit and today have one, two, four or six records each. How often is it
  named, and how often is another constant named?
- runs: coast-downs and strokes, which end by themselves, under a model that lacks their dry friction; nothing has changed, or the
  damping by five standard deviations of the difference.
- chart: twelve records of a machine that wanders by 1 % from day to day; healthy, and with a jump of 5 % at a random place.
- population: ten machines that differ by 2 %; all of a kind, and with one or two that are off by 15 %.

Every case appends a line to FILE, so that the study goes on where it was stopped; every call prints the table of what is there. N cases
from K on: each has seeds of its own.
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
from greybox.extensions.changes.survey import chart_changes, survey_population
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


def coast_down(generator: np.random.Generator, friction: float, viscous: float, seconds: float = 0.0) -> gb.Experiment:
    """A rotor that runs out until it stands, with dry friction: the exact solution, encoder noise; it ends by itself.

    ``w' = -viscous w - friction`` gives ``w = (w0 + friction / viscous) exp(-viscous t) - friction / viscous``.
    """
    start, level = 100.0 * np.exp(0.02 * generator.standard_normal()), friction / viscous
    stop = np.log1p(start / level) / viscous
    t = np.arange(0.0, seconds or stop, 0.02)
    speed = np.maximum((start + level) * np.exp(-viscous * t) - level, 0.0)
    return gb.Experiment("coast", t, {}, {"w": speed + 0.2 * generator.standard_normal(len(t))})


def coasting() -> gb.Model:
    """The same as a model that knows of no dry friction."""
    return gb.Model(
        "coasting",
        states=[gb.State("w", "rad/s", 100.0, role="velocity")],
        inputs=[],
        outputs=[gb.Output("w", "rad/s")],
        parameters=[gb.Parameter("b", "1/s", 0.5, (1e-3, 100.0), role="damping")],
        balances=lambda x, u, p: [gb.Balance("torque", "rad/s^2", 1, "w", damping=-p.b * x.w)],
    )


def stroke(generator: np.random.Generator, mass: float, damping: float, end: float = 0.1) -> gb.Experiment:
    """A slide driven by a held voltage to its stop, friction hidden: fine steps of another integrator; it ends at the stop."""
    step, substeps = 2e-3, 20
    x = v = 0.0
    position = []
    while x < end and len(position) < 2000:
        position.append(x)
        for _ in range(substeps):
            v += step / substeps * (10.0 - damping * v - 2.0 * np.tanh(v / 1e-3)) / mass
            x += step / substeps * v
    t = step * np.arange(len(position))
    noise = 2e-5 * generator.standard_normal(len(t))
    return gb.Experiment("stroke", t, {"u": np.full(len(t), 10.0)}, {"x": np.array(position) + noise})


def sliding() -> gb.Model:
    """The same as a model that knows of no dry friction."""
    return gb.Model(
        "sliding",
        states=[gb.State("x", "m", role="displacement"), gb.State("v", "m/s", role="velocity")],
        inputs=[gb.Input("u", "N", role="drive")],
        outputs=[gb.Output("x", "m")],
        parameters=[
            gb.Parameter("M", "kg", 1.0, (1e-2, 100.0), role="mass"),
            gb.Parameter("B", "N*s/m", 20.0, (1e-2, 1e4), role="damping"),
        ],
        balances=lambda x, u, p: [
            gb.Balance("motion", "m/s", 1, "x", v=x.v),
            gb.Balance("force", "N", p.M, "v", drive=u.u, damping=-p.B * x.v),
        ],
    )


# Runs of one machine differ by so much from day to day (standard deviation of its constants), where nothing has changed. Of one run before
# and one today nobody can tell a day from a change: these are of the same day.
DAY_TO_DAY = 0.005
# Rigs whose runs end by themselves, with a model that lacks their dry friction: the model, the constant that changes, a run of it.
RUNS: dict[str, tuple[Any, str, Any]] = {
    "coast-down": (coasting, "b", lambda g, share: coast_down(g, 6.0, 0.4 * share)),
    "stroke": (sliding, "B", lambda g, share: stroke(g, 1.0, 25.0 * share)),
}


def measure_runs(seed: int) -> dict[str, Any]:
    """Runs that end by themselves, of a machine that is as it was, or whose damping has changed by five standard deviations of a day."""
    rig = list(RUNS)[seed % 2]
    count, changed = ((1, 1), (3, 3), (3, 1))[seed // 2 % 3], seed // 6 % 4 == 0
    make, name, run = RUNS[rig]
    generator = np.random.default_rng([4, seed])

    wander = DAY_TO_DAY if max(count) > 1 else 0.0

    def days(number: int, share: float) -> list[gb.Experiment]:
        each = [run(generator, share * np.exp(wander * generator.standard_normal())) for _ in range(number)]
        return [gb.Experiment(f"{rig} {k}", e.time, dict(e.inputs), dict(e.outputs)) for k, e in enumerate(each)]

    reference = gb.fit(make(), days(count[0], 1.0), options=QUICK)
    share = 1.0
    if changed:
        # Five standard deviations of the difference: of what a day varies by, and of what each estimate leaves open.
        std = np.hypot(wander, (reference.parameters[name].std or np.inf) / abs(reference.parameters[name].value))
        share = float(np.exp(5 * std * np.sqrt(1 / count[0] + 1 / count[1])))
    found = gb.detect_changes(reference, days(count[1], share), search_effects=False)
    return {
        "way": f"{rig}, {count[0]} against {count[1]}, {'changed' if changed else 'healthy'}",
        "verdict": found.verdict,
        "named": name in found.moved,
        "share": share,
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


PARTS = {
    "healthy": measure_healthy,
    "power": measure_power,
    "runs": measure_runs,
    "chart": measure_chart,
    "population": measure_population,
}


def run_part(path: Path, part: str, first: int, cases: int) -> None:
    """The cases of one part that the file lacks, each a line."""
    done = {line["case"] for line in read_lines(path) if line["part"] == part}
    path.parent.mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + cases):
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
        elif line["part"] == "runs":
            groups[f"{line['way']}: called changed"].append(line["verdict"] == "changed")
            groups[f"{line['way']}: cannot tell"].append(line["verdict"] == "cannot tell")
            if "changed" in line["way"]:
                groups[f"{line['way']}: named"].append(line["named"])
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
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cases", type=int, default=2000)
    asked = parser.parse_args()
    if asked.part:
        run_part(asked.file, asked.part, asked.first, asked.cases)
    print("\n".join(tabulate(read_lines(asked.file))))
