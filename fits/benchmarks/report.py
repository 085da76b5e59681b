"""The results of the benchmark as a page."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path

from fits.papers.paper_page import write_section
from greybox.simulation.kernel.c_compiler import describe_machine

NAMES = {
    "casadi_single_shooting": "CasADi single shooting, usual way",
    "scipy_numba": "scipy least_squares + numba RK4",
    "lmfit_numba": "lmfit + numba RK4",
    "jax_sysid": "jax-sysid",
    "diffrax_optimistix": "diffrax + optimistix",
    "diffsol": "pydiffsol + scipy least_squares",
}
GOALS = {"casadi_single_shooting": 50, "scipy_numba": 3, "lmfit_numba": 3, "jax_sysid": 30}

HEAD = """# Speed and scale

How long a fit takes beside other programs, how long a first search takes, and how cost grows with states, constants, rows and records.
"""


def put_part(folder: Path, name: str, text: str) -> Path:
    """Put ``text`` as the part ``name`` into ``speed.md`` in ``folder``: 1 is fits, 3 scale; 2, first searches, is written by hand."""
    return write_section(folder, name, text, "speed.md", HEAD)


def page(result: dict) -> str:
    """The part of the page, in Markdown."""
    problems = result["problems"]
    lines = [
        "## How long fits take",
        "",
        "Written by `make bench`. The unit is the simulation equivalent: CPU time of the whole fit over that of one compiled RK4",
        "pass over the same data, in the same process. Imports, compilation and building are not counted (jax-sysid compiles in every",
        "fit). Start values are about 40 % off. `fits/benchmarks/problems.py` states the problems, `fits/benchmarks/peers.py` how the",
        "others are used.",
        "",
        "| | goal | " + " | ".join(problems) + " |",
        "|---|---|" + "---|" * len(problems),
    ]
    rows = [
        ("samples", "", "samples", "{:,}"),
        ("one compiled RK4 pass, ms", "", "unit_ms", "{:.2f}"),
        ("cost, gradient and Gauss-Newton matrix, over one simulation", "1.3", "pass_ratio", "{:.2f}"),
        ("the same, ms", "", "pass_ms", "{:.2f}"),
        ("fit, simulation equivalents", "9 / 6 / 6 / 0.3", "simulation_equivalents", "{:.2f}"),
        ("solver that ran", "", "solver", "{}"),
        ("the whole call of `fit`, with intervals and notes", "20", "whole_call", "{:.1f}"),
        ("without a compiler", "450", "without_compiler", "{:.0f}"),
        ("random starts (factor 3) that reach the optimum, of 20", "20", "starts_won", "{}"),
        ("one `solve_ivp` simulation (200 samples, scaled up)", "", "solve_ivp_simulation", "{:.0f}"),
    ]
    for title, goal, key, form in rows:
        values = [form.format(p[key]) if p.get(key) is not None else "" for p in problems.values()]
        lines.append(f"| {title} | {goal} | " + " | ".join(values) + " |")
    for peer, title in NAMES.items():
        values = [_against(p, peer) for p in problems.values()]
        lines.append(f"| times faster than {title} | {GOALS.get(peer, '')} | " + " | ".join(values) + " |")
    first = result["first_result_seconds"]
    lines += [
        "",
        "In brackets: rounds, and by how much the cost that a peer reached lies above the best RK4 optimum (relative). A fit with",
        "`least_squares` + `solve_ivp` was not run: multiply one simulation by the 30 to 100 that finite differences need. pydiffsol",
        "solves each sample by itself, because the input jumps there. acados was left out.",
        "",
        *_compilation(result["compile_seconds"]),
        f"First result after the imports (pneumatic): {first['cold']:.2f} s with an empty cache (goal 3), {first['warm']:.2f} s"
        " after that (goal 0.5).",
        f"Memory of the linear fit of 400,000 samples above imports and data: {result['memory_above_data_mb']:.0f} MB (goal 20).",
        "",
        f"Machine: {_processor()}, {os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} at the end; {_compiler()};"
        f" Python {platform.python_version()}, " + ", ".join(f"{k} {v}" for k, v in result["versions"].items()) + ".",
        "",
    ]
    return "\n".join(lines)


def _compilation(seconds: dict[str, dict[str, float]]) -> list[str]:
    """How long the peers that compile a whole fit take for their first call."""
    return [
        f"{NAMES[peer]} compiles for each new problem, apart from these figures: "
        + ", ".join(f"{value:.1f} s ({problem})" for problem, value in each.items())
        + ".\n"
        for peer, each in seconds.items()
    ]


def _against(problem: dict, peer: str) -> str:
    times = problem["against"].get(peer)
    if times is None:
        return ""
    return f"{times:.1f} ({problem['rounds'][peer]}; {problem['cost_above_best'][peer]:.0e})"


def _processor() -> str:
    lines = [
        line.partition(":")[2].strip() for line in describe_machine().splitlines() if line.startswith("model name")
    ]
    return lines[0] if lines else platform.processor() or platform.machine()


def _compiler() -> str:
    answer = subprocess.run(["cc", "--version"], capture_output=True, text=True, check=False).stdout
    return answer.splitlines()[0] if answer else "no C compiler"
