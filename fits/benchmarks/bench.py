"""`make bench`: how long the same fit takes here and elsewhere. Writes bench.json and its part of docs/studies/speed.md.

The unit is the simulation equivalent: CPU time of a fit over the CPU time of one compiled RK4 pass over the same data,
measured in the same process just before and after. Imports, just-in-time compilation and building are not counted, here or
elsewhere (except jax-sysid, which compiles anew in each fit). Every program starts at the same values; the order changes from
round to round; medians of five rounds, of fewer for the slow ones (told in the table).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from fits.benchmarks import ours, peers
from fits.benchmarks.problems import CASES, Case, actuator
from fits.benchmarks.report import page, put_part

ROUNDS = 5
SLOT = 0.3  # CPU seconds of one timing, at least
LONG = "actuator_long"
SLOW, FEWER = 3.0, 2  # a fit of so many CPU seconds gets fewer rounds
VERY_SLOW = 20.0  # ... and one of so many a single one
ROOT = Path(__file__).resolve().parents[2]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run everything, or a part, and write the results."""
    chosen = _parse(arguments)
    began = time.perf_counter()
    os.environ["GREYBOX_KERNEL"] = (
        "compiled"  # the steady speed: nothing is interpreted until it has earned its compilation
    )
    problems = {name: compare(CASES[name](), chosen.peers, chosen.rounds) for name in chosen.problems if name in CASES}
    if LONG in chosen.problems:
        problems[LONG] = long_record(chosen.rounds)
    result = {
        "problems": problems,
        "first_result_seconds": ours.first_results(),
        "memory_above_data_mb": ours.memory(),
        "minutes": (time.perf_counter() - began) / 60,
        "compile_seconds": _compile_seconds(),
        "versions": {
            name: _version(name)
            for name in (
                "casadi",
                "numpy",
                "scipy",
                "numba",
                "lmfit",
                "jax",
                "jax-sysid",
                "diffrax",
                "optimistix",
                "pydiffsol",
            )
        },
    }
    (chosen.output / "docs" / "studies").mkdir(parents=True, exist_ok=True)
    (chosen.output / "bench.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    put_part(chosen.output / "docs" / "studies", "1", page(result))
    say(page(result))


def compare(case: Case, chosen_peers: Sequence[str] = tuple(peers.PEERS), most_rounds: int = ROUNDS) -> dict:
    """One problem: greybox and every peer that is installed, in interleaved order."""
    say(f"{case.name}: building")
    unit = ours.simulation(case)
    runs = {"greybox": ours.fitter(case)}
    runs["greybox"]()  # the others have compiled what they need as well
    for name in chosen_peers:
        try:
            runs[name] = peers.PEERS[name](case)
        except ImportError as missing:
            say(f"{case.name}: {name} left out ({missing}); pip install -e '.[bench]'")
    spent: dict[str, list[float]] = {name: [] for name in runs}
    ends: dict[str, np.ndarray] = {}
    for k in range(most_rounds):
        for name in _order(list(runs), k):
            if len(spent[name]) < min(_rounds(spent[name]), most_rounds):
                before = unit()
                ends[name] = runs[name] and _result(runs[name], spent[name])
                spent[name][-1] = 2 * spent[name][-1] / (before + unit())
                say(f"{case.name} round {k + 1}: {name} {spent[name][-1]:.1f} simulations")
    medians = {name: float(np.median(values)) for name, values in spent.items()}
    best = ours.cost(case, ours.fitter(case, "rk4")(), "rk4")
    costs = {name: ours.cost(case, z, "rk4") / best - 1 for name, z in ends.items() if name != "greybox"}
    simulations = peers.solve_ivp_seconds(case) / unit()
    return {
        **_measure_passes(case, unit),
        "simulation_equivalents": medians["greybox"],
        "solver": ours.solver(case),
        "whole_call": _median(ours.whole_call(case), unit, most_rounds),
        "without_compiler": ours.without_compiler(case, unit()),
        "starts_won": ours.starts_won(case),
        "against": {name: medians[name] / medians["greybox"] for name in medians if name != "greybox"},
        "cost_above_best": costs,
        "rounds": {name: len(values) for name, values in spent.items()},
        "solve_ivp_simulation": simulations,
    }


def long_record(rounds: int = ROUNDS) -> dict:
    """The actuator with 400,000 samples: greybox alone (the peers take the RK4 route, hundreds of passes)."""
    case = actuator(400_000)
    unit = ours.simulation(case)
    run = ours.fitter(case)
    run()
    return {
        **_measure_passes(case, unit),
        "simulation_equivalents": _median(run, unit, rounds),
        "solver": ours.solver(case),
        "whole_call": _median(ours.whole_call(case), unit, rounds),
        "against": {},
    }


def _measure_passes(case: Case, unit: Callable[[], float]) -> dict:
    """A simulation in milliseconds, and a pass with gradient and Gauss-Newton matrix over it and in milliseconds."""
    unit_ms, ratio = 1e3 * unit(), ours.pass_ratio(case)
    return {"samples": case.experiment.rows, "unit_ms": unit_ms, "pass_ratio": ratio, "pass_ms": ratio * unit_ms}


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Time fits here and elsewhere.")
    names = [*CASES, LONG]
    parser.add_argument("problems", nargs="*", help=f"of {', '.join(names)}; all if left out")
    parser.add_argument(
        "--peers", nargs="*", choices=list(peers.PEERS), default=list(peers.PEERS), help="none: --peers"
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="most rounds (%(default)s)")
    parser.add_argument(
        "--output", type=Path, default=ROOT, help="folder of bench.json and docs/studies/speed.md (this one)"
    )
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.problems) - set(names):
        parser.error(f"no such problem: {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    chosen.problems = chosen.problems or names
    return chosen


def _compile_seconds() -> dict[str, dict[str, float]]:
    """Peer -> problem -> seconds of its first call."""
    seconds: dict[str, dict[str, float]] = {}
    for (peer, problem), value in peers.COMPILE_SECONDS.items():
        seconds.setdefault(peer, {})[problem] = value
    return seconds


def _median(run, unit, rounds: int = ROUNDS) -> float:
    """Simulation equivalents of a call."""
    run()
    ratios = []
    for _ in range(rounds):
        before = unit()
        spent = ours.cpu(run)
        ratios.append(2 * spent / (before + unit()))
    return float(np.median(ratios))


def _result(run, spent: list[float]) -> np.ndarray:
    """What ``run`` returns; CPU seconds of a call go to ``spent``: the mean of as many calls as `SLOT` holds, one at least.

    A call of milliseconds right after another program's minutes would be timed with that program's data in every cache.
    """
    ends: list[np.ndarray] = []
    seconds = 0.0
    while seconds < SLOT:
        seconds += ours.cpu(lambda: ends.append(run()))
    spent.append(seconds / len(ends))
    _seconds[id(spent)] = spent[-1]
    return ends[-1]


_seconds: dict[int, float] = {}


def _rounds(spent: list[float]) -> int:
    seconds = _seconds.get(id(spent), 0.0)
    return 1 if seconds > VERY_SLOW else FEWER if seconds > SLOW else ROUNDS


def _order(names: list[str], k: int) -> list[str]:
    """Every program comes after every other one in turn."""
    return names[k % len(names) :] + names[: k % len(names)]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def say(text: str) -> None:
    """To the terminal at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
