"""Problems larger than any rig's: an answer or a sentence, in a bounded memory.

Slow; ``RELIABILITY_SIZE=0.1`` makes them a tenth as large, ``RELIABILITY_WRITE=1`` writes the figures to ``docs/studies/reliability.md``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.large import write_lag_file
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(sys.platform != "linux", reason="peak memory of Linux, in kilobytes"),
]
NUMBER = 8
LARGEST_MEMORY = 1e9
FACTOR = 4.0
"""Memory over the data of a long record: what reading and fitting it may take."""

PROBLEMS = {"rod": 200, "curve": 500, "long_sum": 5000, "records": 500}
"""States, constants (a tenth of them free), terms of a sum, records."""

WHAT = "200 states, 500 constants (50 free), a sum of 5000 terms, 500 records, 5 million rows read, and fitted"
SCRIPT = """
import json, resource, sys
import greybox as gb
from tests.support.large import lag, lag_record, solve

def measure():
    return 1024 * max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))

task, size = sys.argv[1], sys.argv[2]
gb.fit(lag(), lag_record(500, 1))  # what every fit loads and compiles
before = measure()
try:
    value, truth, deviation = solve(task, size)
    answer = {"error": abs(value - truth) / deviation}
except gb.GreyboxError as error:
    answer = {"sentence": str(error)}
print(json.dumps({**answer, "memory": measure() - before}))
"""


def run_alone(task: str, size: int | Path) -> dict[str, Any]:
    done = subprocess.run([sys.executable, "-c", SCRIPT, task, str(size)], capture_output=True, text=True, timeout=3600)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def find_faults(task: str, answer: dict[str, Any], data: float) -> list[str]:
    """What is wrong with the answer of one problem; ``data``: bytes of the long record."""
    most = LARGEST_MEMORY if task in PROBLEMS else FACTOR * data
    faults = [f"{task}: {answer}"] if answer.get("error", 0.0) > 5 or "Traceback" in str(answer) else []
    return faults + [f"{task}: {answer['memory'] / 1e6:.0f} MB"] * (answer["memory"] > most)


def describe(answers: dict[str, dict[str, Any]], rows: int, data: float) -> str:
    """The figures of the problems that were solved so far."""
    most = max((answer["memory"] for task, answer in answers.items() if task in PROBLEMS), default=0)
    parts = [f"{sum('error' in answer for answer in answers.values())} right answers; {most / 1e6:.0f} MB at most"]
    for task, verb in (("reading", "read"), ("fitting", "fitted")):
        if task in answers:
            parts.append(f"{rows} rows are {verb} in {answers[task]['memory'] / data:.1f} times their size")
    return "; ".join(parts)


def test_problems_that_are_too_large(tmp_path):
    rows = size_of(5_000_000)
    file, data = write_lag_file(tmp_path / "long.csv", rows), 3.0 * NUMBER * rows
    tasks = {task: (task, size_of(size)) for task, size in PROBLEMS.items()}
    tasks |= {"reading": ("read", file), "fitting": ("rows", file)}
    answers: dict[str, dict[str, Any]] = {}
    faults: list[str] = []
    for task, arguments in tasks.items():
        answers[task] = run_alone(*arguments)
        faults += find_faults(task, answers[task], data)
        note_row(WHAT, len(answers), len(faults), describe(answers, rows, data))
    assert not faults, answers
