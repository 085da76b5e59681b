"""How cost grows with states, constants and rows: ``python -m fits.benchmarks.scale``. Writes its part of
docs/studies/speed.md and the figure.

The plants are chains of masses on springs (`fits/benchmarks/chains.py`). Each size is measured in a process of its
own with an empty cache, in
seconds of its processor time (compilers in the background included, apart); a pass is the best of several.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import greybox as gb
from fits.benchmarks.chains import STEP, make_chain, make_trial
from fits.benchmarks.passes import Pass, Sums, measure_programs
from fits.benchmarks.problems import actuator
from fits.benchmarks.report import put_part
from greybox.data.experiment import Experiment
from greybox.estimation.noise_loop import solve
from greybox.estimation.transcription.preparation import prepare_problem
from greybox.model.model import Model
from greybox.simulation.integrators.discretisation import discretise
from greybox.simulation.integrators.runge_kutta import rk4
from greybox.simulation.kernel.interface import KernelPoint
from greybox.simulation.kernel.make_kernel import make_kernel
from greybox.simulation.kernel.record import Record

ROOT = Path(__file__).resolve().parents[2]
BODIES = (1, 2, 4, 7, 8, 12, 25, 50, 100)
PEER_BODIES = (2, 7, 12, 25, 50)
CONSTANTS = (1, 4, 16, 64, 256)
ROWS = (1_000, 10_000, 100_000, 1_000_000)
RECORDS = (1, 10, 100, 1_000, 10_000)
SUBSTEPS = 2  # of RK4 in a sampling interval of a nonlinear chain
LONG_WORK = 100_000  # rows of the records for whose search the step of a pass is chosen
LIMIT = 3600  # s of one size, on a busy machine

Numbers = Mapping[str, Any]


def measure_fit(bodies: int, hardening: bool, rows: int) -> Numbers:
    """A fit from the start of a process to its result, the simulation of its record included."""
    trial = make_trial(bodies, rows, hardening=hardening)
    fit = trial.fit()
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "seconds": time.process_time(),
        "compilers": children.ru_utime + children.ru_stime,
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "error": trial.find_worst_error(fit),
        "status": str(fit.status),
    }


def measure_pass(bodies: int, hardening: bool, directions: int, rows: int = 1000) -> Numbers:
    """Milliseconds of a simulation, and of a pass with gradient and Gauss-Newton matrix along so many directions, in long work."""
    model = make_chain(bodies, hardening=hardening)
    rng, p = np.random.default_rng(0), np.array(list(model.values.values()))
    rest = np.zeros((1, 2 * bodies))
    step = (
        rk4(model.system, SUBSTEPS)
        if hardening
        else discretise(model.system, p, rest, np.array([STEP]), rows=LONG_WORK, directions=directions)
    )
    record = make_record(model, rows, rng).read_by(step)
    # One direction for each constant; more of them than constants are random ones.
    dp = (
        p[:, None] * np.hstack([np.eye(len(p))[:, : bodies + 1], rng.normal(size=(len(p), directions))])[:, :directions]
    )
    kernel = make_kernel(step)
    x0, dx0, weight = np.zeros(2 * bodies), np.zeros((2 * bodies, directions)), np.ones(bodies)

    def simulate() -> None:
        q, _ = kernel.coefficients(record, p, dp[:, :0])
        kernel.simulate(record, q, p, x0)

    def run() -> None:
        q, dq = kernel.coefficients(record, p, dp)
        kernel.sums(record, KernelPoint(q, dq, p, dp, x0, dx0), weight)

    return {"simulation": take_time(simulate), "pass": take_time(run), "kernel": kernel.description}


def make_record(model: Model, rows: int, rng: np.random.Generator) -> Record:
    """A record of noise: what it says does not matter to the time that a pass takes."""
    outputs = len(model.outputs)
    h = np.full(rows - 1, STEP)
    u, y = rng.normal(size=(rows, 1)), 1e-3 * rng.normal(size=(rows, outputs))
    return Record(u, y, h, np.zeros(rows - 1), h[:1])


def take_time(run: Callable[[], None], seconds: float = 1.0) -> float:
    """Milliseconds of processor time of one call, the least of those that fit in ``seconds``, at least five."""
    run()
    times: list[float] = []
    while len(times) < 5 or sum(times) < seconds:
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
        if len(times) >= 5 and len(times) * min(times) > seconds:
            break
    return 1e3 * min(times)


# Seconds of passes that are run before one is timed: what a compiler makes meanwhile counts no more than it does for the others.
WARM_SECONDS = 3.0


def measure_peers(*sizes: int) -> Numbers:
    """A pass over the nonlinear chain here and by other programs, one after the other in one process."""

    def begin(bodies: int) -> Pass:
        rng = np.random.default_rng(0)
        stiffness = np.array([1000.0 + 50 * i for i in range(bodies)])
        return Pass(stiffness, 1.0, rng.normal(0, 10, 1000), 1e-3 * rng.normal(size=(1000, bodies)), SUBSTEPS)

    def prepare(task: Pass) -> Callable[[], Sums]:
        bodies = len(task.stiffness)
        model = make_chain(bodies, hardening=True)
        p = np.array(list(model.values.values()))
        rows = len(task.force)
        h = np.full(rows - 1, STEP)
        record = Record(task.force[:, None], task.measured, h, np.zeros(rows - 1), h[:1])
        dp = np.eye(len(p))[:, : bodies + 1]
        kernel = make_kernel(rk4(model.system, SUBSTEPS))
        x0, dx0, weight = np.zeros(2 * bodies), np.zeros((2 * bodies, bodies + 1)), np.ones(bodies)

        def run() -> Sums:
            q, dq = kernel.coefficients(record, p, dp)
            sums = kernel.sums(record, KernelPoint(q, dq, p, dp, x0, dx0), weight)
            return sums.cost, sums.gradient, sums.gauss_newton

        began = time.process_time()
        while time.process_time() - began < WARM_SECONDS:
            run()
        return run

    return measure_programs(sizes, prepare, begin)


def make_fleet(count: int) -> tuple[Model, list[Experiment], Mapping[str, float]]:
    """A start of the micro actuator, and records of 1,000 rows of machines whose constants differ by some per cent."""
    case, rng = actuator(1000), np.random.default_rng(0)
    records = []
    for k in range(count):
        machine = case.truth.start(**{q.name: q.value * rng.normal(1, 0.03) for q in case.truth.free_parameters})
        records.append(replace(gb.simulate(machine, case.experiment).record(case.noise, rng), name=f"machine {k}"))
    return case.start, records, case.noise


def measure_records(count: int) -> Numbers:
    """A fit to each record by itself, and the bare search from the same start to every tenth of them."""
    model, records, noise = make_fleet(count)
    options = gb.FitOptions(at_rest=True)

    def search(record: Experiment) -> float:
        problem = prepare_problem(model, record, noise, options)
        began = time.process_time()
        solve(problem, options)
        return time.process_time() - began

    search(records[0])  # functions of the virtual machine are built once
    began = time.process_time()
    result = gb.fit_each(model, records, noise=noise, options=options, workers=1)
    seconds = time.process_time() - began
    bare = float(np.mean([search(record) for record in records[:: max(1, count // 100)]]))
    return {"seconds": seconds, "each": 1e3 * seconds / count, "bare": 1e3 * bare, "good": len(result.records)}


# Records of a fleet that two workers share, and how often each number of workers has its turn.
SHARED_RECORDS, TURNS = 2_000, 2


def measure_workers() -> Numbers:
    """Seconds of the clock for the same records on one and on two workers of a local Dask cluster, in turns."""
    from greybox.base.parallel.cluster import open_cluster

    model, records, noise = make_fleet(SHARED_RECORDS)
    spent: dict[int, list[float]] = {1: [], 2: []}
    with open_cluster("local", 1) as one, open_cluster("local", 2) as two:
        for executor in (one, two):
            gb.fit_each(model, records[:20], noise=noise, executor=executor)
        for _ in range(TURNS):
            for workers, executor in ((1, one), (2, two)):
                began = time.perf_counter()
                gb.fit_each(model, records, noise=noise, executor=executor)
                spent[workers].append(time.perf_counter() - began)
    return {str(workers): min(seconds) for workers, seconds in spent.items()}


MEASUREMENTS: Mapping[str, Callable[..., Numbers]] = {
    "fit": measure_fit,
    "pass": measure_pass,
    "peers": measure_peers,
    "records": measure_records,
    "workers": measure_workers,
}


def measure_apart(what: str, *arguments: Any) -> Numbers:
    """A measurement in a process of its own, with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"GREYBOX_CACHE": cache, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "fits.benchmarks.scale", "--one", json.dumps([what, *arguments])]
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    if done.returncode:
        raise RuntimeError(f"{what} {arguments}: {done.stderr[-2000:]}")
    numbers = json.loads(done.stdout.splitlines()[-1])
    print(what, *arguments, numbers, flush=True)
    return numbers


KINDS = {"linear": False, "nonlinear": True}
PARTS: Mapping[str, Callable[[], Numbers]] = {
    "fits": lambda: {k: {n: measure_apart("fit", n, hard, 1000) for n in BODIES} for k, hard in KINDS.items()},
    "passes": lambda: {k: {n: measure_apart("pass", n, hard, n + 1) for n in BODIES} for k, hard in KINDS.items()},
    "constants": lambda: {
        "linear, 50 states": {n: measure_apart("pass", 25, False, n) for n in CONSTANTS},
        "nonlinear, 8 states": {n: measure_apart("pass", 4, True, n) for n in CONSTANTS},
    },
    "rows": lambda: {k: {n: measure_apart("fit", 2, hard, n) for n in ROWS} for k, hard in KINDS.items()},
    "peers": lambda: measure_apart("peers", *PEER_BODIES),
    "records": lambda: {n: measure_apart("records", n) for n in RECORDS},
    "workers": lambda: measure_apart("workers"),
}
"""The curves of the page."""


def draw(found: Mapping[str, Any], path: Path) -> None:
    """The curves side by side."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "scale"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 5, figsize=(16, 3.2), layout="constrained")
    panels = (
        ("fits", "states", "fit from cold, s", lambda n: 2 * n, "seconds"),
        ("passes", "states", "pass, ms", lambda n: 2 * n, "pass"),
        ("constants", "directions", "pass, ms", lambda n: n, "pass"),
        ("rows", "rows", "fit from cold, s", lambda n: n, "seconds"),
    )
    for label, curve in found["peers"]["passes"].items():
        sizes = [2 * int(n) for n in curve]
        axes[4].loglog(sizes, list(curve.values()), "o-", markersize=3, label=label)
    axes[4].set_xlabel("states")
    axes[4].set_ylabel("nonlinear pass, ms")
    axes[4].grid(alpha=0.3)
    axes[4].legend(fontsize=8)
    for axis, (name, x_label, y_label, place, key) in zip(axes, panels, strict=False):
        for label, curve in found[name].items():
            sizes = [place(int(n)) for n in curve]
            axis.loglog(sizes, [v[key] for v in curve.values()], "o-", markersize=3, label=label)
        axis.set_xlabel(x_label)
        axis.set_ylabel(y_label)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def write_page(found: Mapping[str, Any]) -> str:
    """The page, with the numbers in its tables."""
    template = (ROOT / "fits" / "benchmarks" / "scale_page.md").read_text(encoding="utf-8")

    def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
        lines = [heads, ["---"] * len(heads), *rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def by_size(
        name: str, first: str, place: Callable[[int], int], columns: Mapping[str, Callable[[Numbers], str]]
    ) -> str:
        kinds = found[name]
        heads = [first, *(f"{kind}: {head}" for kind in kinds for head in columns)]
        sizes = list(next(iter(kinds.values())))
        rows = [
            [f"{place(int(n)):,}", *(show(kinds[kind][n]) for kind in kinds for show in columns.values())]
            for n in sizes
        ]
        return table(heads, rows)

    fit_columns: Mapping[str, Callable[[Numbers], str]] = {
        "s": lambda v: f"{v['seconds']:.2f}",
        "compilers, s": lambda v: f"{v['compilers']:.1f}",
        "MB": lambda v: f"{v['megabytes']:.0f}",
    }
    tables = {
        "FITS": by_size("fits", "states", lambda n: 2 * n, fit_columns),
        "CONSTANTS": by_size("constants", "directions", lambda n: n, {"pass, ms": lambda v: f"{v['pass']:.2f}"}),
        "ROWS": by_size("rows", "rows", lambda n: n, fit_columns),
        "PEERS": table(
            ["states", *(f"{name}, ms" for name in found["peers"]["passes"])],
            [
                [str(2 * int(n)), *(f"{v[n]:.2f}" if n in v else "" for v in found["peers"]["passes"].values())]
                for n in found["peers"]["passes"]["greybox"]
            ],
        ),
        "VERSIONS": ", ".join(f"{name} {number}" for name, number in found["peers"]["versions"].items()),
        "RECORDS": table(
            ["records", "all of them, s", "each, ms", "a bare search, ms"],
            [
                [f"{int(n):,}", f"{v['seconds']:.2f}", f"{v['each']:.1f}", f"{v['bare']:.1f}"]
                for n, v in found["records"].items()
            ],
        ),
        "WORKERS": f"{found['workers']['1'] / found['workers']['2']:.2f}",
    }
    for name, text in tables.items():
        template = template.replace(f"{{{name}}}", text)
    return template


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure everything, or one size, and write the page."""
    parser = argparse.ArgumentParser(description="How cost grows with states, constants and rows.")
    parser.add_argument("--one", help="one measurement as JSON; prints its numbers")
    parser.add_argument(
        "--numbers", type=Path, help="numbers of an earlier run; only the parts that are named are measured"
    )
    parser.add_argument(
        "--parts", nargs="*", choices=list(PARTS), help="parts to measure (all, or none beside --numbers)"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "studies")
    chosen = parser.parse_args(arguments)
    if chosen.one:
        what, *given = json.loads(chosen.one)
        print(json.dumps(MEASUREMENTS[what](*given)))
        return
    found = json.loads(chosen.numbers.read_text()) if chosen.numbers else {}
    parts = chosen.parts if chosen.parts is not None else [] if chosen.numbers else list(PARTS)
    # Through JSON, whose keys are texts, so that numbers of this and of an earlier run are alike.
    found |= json.loads(json.dumps({part: PARTS[part]() for part in parts}))
    (ROOT / "scale.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    draw(found, chosen.output / "figures" / "scale.svg")
    put_part(chosen.output, "3", write_page(found))


if __name__ == "__main__":
    main()
