"""Problems larger than any rig's: an answer or a sentence, in a bounded memory.

Slow; ``RELIABILITY_SIZE=0.1`` makes them a tenth as large, ``RELIABILITY_WRITE=1`` writes the figures to ``docs/reliability.md``.
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


def test_problems_that_are_too_large(tmp_path):
    rows = size_of(5_000_000)
    answers = {task: run_alone(task, size_of(size)) for task, size in PROBLEMS.items()}
    answers |= {"reading": run_alone("read", write_lag_file(tmp_path / "long.csv", rows))}
    answers |= {"fitting": run_alone("rows", tmp_path / "long.csv")}
    data = 3 * NUMBER * rows
    faults = [task for task, answer in answers.items() if answer.get("error", 0.0) > 5 or "Traceback" in str(answer)]
    faults += [task for task in PROBLEMS if answers[task]["memory"] > LARGEST_MEMORY]
    factors = {task: answers[task]["memory"] / data for task in ("reading", "fitting")}
    faults += [task for task, factor in factors.items() if factor > FACTOR]
    most = max(answers[task]["memory"] for task in PROBLEMS)
    figures = (
        f"{sum('error' in answer for answer in answers.values())} right answers; {most / 1e6:.0f} MB at most;"
        f" {rows} rows are read in {factors['reading']:.1f} and fitted in {factors['fitting']:.1f} times their size"
    )
    what = "200 states, 500 constants (50 free), a sum of 5000 terms, 500 records, 5 million rows read, and fitted"
    note_row(what, len(answers), len(faults), figures)
    assert not faults, answers
