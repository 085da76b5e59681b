"""A program that ends while code is made in the background ends as it would without: its status, and all that it has printed."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from fits.benchmarks.ends import Case, run_case
from greybox.simulation.kernel import llvm_routine
from greybox.simulation.kernel.tape import read_tape

ROOT = Path(__file__).resolve().parents[3]
CHAIN = """
import sys
import numpy as np
import greybox as gb

def chain(n):
    states = [s for i in range(n) for s in (gb.State(f"x{i}", "m"), gb.State(f"v{i}", "m/s"))]
    def balances(x, u, p):
        rows = []
        for i in range(n):
            here, left = getattr(x, f"x{i}"), getattr(x, f"x{i - 1}") if i else 0
            terms = {"spring": -getattr(p, f"k{i}") * (here - left), "damping": -p.c * getattr(x, f"v{i}")}
            if i + 1 < n:
                terms["next"] = getattr(p, f"k{i + 1}") * (getattr(x, f"x{i + 1}") - here)
            else:
                terms["drive"] = u.F
            rows.append(gb.Balance(f"position{i}", "m/s", 1, f"x{i}", velocity=getattr(x, f"v{i}")))
            rows.append(gb.Balance(f"force{i}", "N", p.m, f"v{i}", **terms))
        return rows
    constants = [gb.Parameter(f"k{i}", "N/m", 1000.0 + 50 * i, (1, 1e6)) for i in range(n)]
    constants += [gb.Parameter("c", "N*s/m", 1.0, (1e-3, 1e3)), gb.Parameter("m", "kg", 1.0, (1e-3, 1e3))]
    outputs = [gb.Output(f"x{i}", "m") for i in range(n)]
    return gb.Model(f"chain{n}", states, [gb.Input("F", "N")], outputs, constants, balances).fix("m")

model, rng = chain(10), np.random.default_rng(0)
noise = {output.name: 1e-5 for output in model.outputs}
run = gb.simulate(model, {"time": 0.005 * np.arange(1000), "F": np.repeat(rng.normal(0, 10, 100), 10)})
record = run.record(noise, rng)
for k in range(2):
    fit = gb.fit(model.start(k0=1100.0, k9=1300.0), record, noise=noise, options=gb.FitOptions(at_rest=True))
    print("fitted", k, fit.status)
"""


def run_program(end: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """The chain of ten bodies, fitted twice with no library kept from before, then ``end``; its output goes into a pipe."""
    environment = {
        "PYTHONPATH": str(ROOT),
        "XDG_CACHE_HOME": str(folder),
        "OMP_NUM_THREADS": "1",
        "PATH": "/usr/bin:/bin",
    }
    command = [sys.executable, "-c", CHAIN + end]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=150)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("end", "status", "last"),
    [
        pytest.param("print('end')", 0, "end", marks=pytest.mark.slow),
        ("print('end')\nsys.exit(3)", 3, "end"),
        ("raise SystemError('on purpose')", 1, "fitted 1 converged"),
    ],
    ids=["it ends", "it exits", "it fails"],
)
def test_a_larger_model_ends_with_its_status_and_all_its_output(
    end: str, status: int, last: str, tmp_path: Path
) -> None:
    done = run_program(textwrap.dedent(end), tmp_path)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (status, last), done.stderr
    assert done.stdout.startswith("fitted 0 converged\n")


@pytest.mark.rest
@pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork")
@pytest.mark.parametrize(
    "case",
    [
        Case(6, True, "fork", 0),
        Case(3, False, "worker", 0),
        Case(4, True, "SIGINT", 2.5),
        Case(10, True, "SIGKILL", 3.0),
    ],
    ids=lambda case: case.end,
)
def test_a_program_that_is_copied_interrupted_or_killed_leaves_nothing_behind(case: Case, tmp_path: Path) -> None:
    assert run_case(case, tmp_path) == ""


@pytest.mark.skipif(not llvm_routine.has_llvm(), reason="llvmlite is not installed")
def test_a_long_routine_comes_from_a_process_of_its_own_with_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    import ctypes

    import casadi as ca

    x = ca.SX.sym("x", 3)
    tape = read_tape(ca.Function("f", [x], [ca.vertcat(ca.sin(x[0]) * x[1], ca.exp(x[2]) / (1 + x[0] ** 2))]))

    def compute() -> list[float]:
        code = llvm_routine.generate(tape, 4, 0)
        given, result = np.array([0.3, -1.2, 0.7]), np.zeros(2)
        registers, tangents = np.zeros(code.values), np.zeros(max(1, code.tangents))
        pointers = (ctypes.c_void_p * 1)(given.ctypes.data)
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 6)
        for address in (code.once, code.each):
            call(address)(registers.ctypes.data, tangents.ctypes.data, pointers, pointers, result.ctypes.data, 0)
        return list(result)

    here = compute()
    monkeypatch.setattr(llvm_routine, "LONG_ROUTINE", 0)
    assert compute() == here
    assert here == pytest.approx([np.sin(0.3) * -1.2, np.exp(0.7) / 1.09], rel=1e-15)
