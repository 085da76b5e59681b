"""A command with less memory than it needs, as under `ulimit -v`: an answer or a sentence, and what was there stays."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.shell.test_workers import COMMAND, ENVIRONMENT, record  # noqa: F401
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux"),
]
LEAST, MOST = 0.4e9, 1.2e9
"""Bytes of address space: as much as the interpreter with its libraries takes, and more than any of the commands. With less the libraries
do not load: CasADi's cannot be mapped, and OpenBLAS asks for memory again and again and never ends, before a line of the program ran."""
SENTENCE = "not enough memory"
PATIENCE, TOO_LATE = 300, 124
"""Seconds for a command, and the exit code that stands for more: the OpenBLAS of CasADi waits for memory without end."""
WORDS = {
    "fit": "fit micro_actuator {record} --fix M --fix Ra --output {out}",
    "discover": "discover micro_actuator {record} --validate {record} --fix M --effects coulomb_friction --workers 1 --output {out}",
    "simulate": "simulate micro_actuator --step 1 --duration 1 --sampling-time 1e-5 --output {out}/run.csv",
}


def run_with(memory: float, words: str) -> subprocess.CompletedProcess[str]:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (int(memory), resource.RLIM_INFINITY))

    environment = ENVIRONMENT | {"OPENBLAS_NUM_THREADS": "1"}
    command = [*COMMAND, *words.split()]
    try:
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PATIENCE, preexec_fn=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, TOO_LATE, "", f"did not end in {PATIENCE} s")


def find_fault(done: subprocess.CompletedProcess[str], out: Path) -> str:
    """What is wrong with a command that had too little memory; "" if it has an answer, or says that memory is short."""
    if "Traceback" in done.stderr or done.returncode not in (0, 1):
        return f"code {done.returncode}: {done.stderr[-300:]}"
    if done.returncode == 1 and SENTENCE not in done.stderr:
        return f"no sentence: {done.stderr[-300:]}"
    return "half a result" if done.returncode == 0 and not any(out.iterdir()) else ""


def test_commands_with_little_memory(record, tmp_path):  # noqa: F811
    faults, tried, answered = [], 0, 0
    steps = size_of(10)
    for name, words in WORDS.items():
        for k in range(steps):
            out = tmp_path / f"{name}-{k}"
            memory = LEAST * (MOST / LEAST) ** (k / max(steps - 1, 1))
            done = run_with(memory, words.format(record=record, out=out))
            fault = find_fault(done, out)
            tried, answered = tried + 1, answered + (done.returncode == 0)
            faults += [f"{name} with {memory / 1e6:.0f} MB: {fault}"] * bool(fault)
            print(f"{name} with {memory / 1e6:.0f} MB: code {done.returncode} {done.stderr[-200:]}", flush=True)
    figures = f"of {len(WORDS)} commands; {answered} had an answer, the others said that memory is short"
    note_row(f"commands with {LEAST / 1e6:.0f} MB to {MOST / 1e9:.1f} GB of memory", tried, len(faults), figures)
    assert not faults
