"""Many small programs that fit and end, at any moment of compiling: ``python -m fits.benchmarks.ends [--programs 1000]``.

Each fits a chain of 1 to 50 bodies (2 to 100 states) with an empty cache, or with what the ones before have left in it, and then ends by
itself, by `sys.exit`, by an exception, in a process that it forked or in a worker, or is interrupted or killed at a random moment. It must
end in time and with the right status, lose nothing of its output, and leave no process behind.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
MARK = "GREYBOX_ENDS"  # names a program and all that it starts, in their environment
LONGEST = 120.0  # s of one program on a busy machine
LATEST = 6.0  # s after which a program is interrupted or killed, at the latest
LINES = 200  # printed at the end: more than a pipe takes at once if the reader is slow

PROGRAM = f"""
import os, sys
from fits.benchmarks.chains import make_trial
bodies, hardening, end = int(sys.argv[1]), sys.argv[2] == "True", sys.argv[3]
print("begun")
trial = make_trial(bodies, 300, hardening=hardening)

def fit():
    print("fitted", trial.fit().status)

if end == "fork":
    # Copied while code is made in the background.
    fit()
    child = os.fork()
    if not child:
        fit()
        print("child")
        sys.exit(4)
    print("child ended with", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
elif end == "worker":
    from concurrent.futures import ProcessPoolExecutor
    fit()
    with ProcessPoolExecutor(1) as pool:
        pool.submit(fit).result()
else:
    for _ in range(2):
        fit()
for k in range({LINES}):
    print("line", k)
if end == "exit":
    sys.exit(3)
if end == "exception":
    raise ValueError("on purpose")
"""

STATUS = {"itself": 0, "exit": 3, "exception": 1, "fork": 0, "worker": 0}
SIGNALS = {"SIGINT": signal.SIGINT, "SIGTERM": signal.SIGTERM, "SIGKILL": signal.SIGKILL}


class Case(NamedTuple):
    """A program, how it ends, and when it is ended where it does not end by itself (s)."""

    bodies: int
    hardening: bool
    end: str
    after: float


def draw_case(rng: random.Random, largest: int = 50) -> Case:
    """Small models more often than large ones, and every way to end."""
    bodies = round(largest ** rng.random())
    return Case(bodies, rng.random() < 0.5, rng.choice([*STATUS, *SIGNALS]), rng.uniform(0.2, LATEST))


def run_case(case: Case, cache: Path, limit: float = LONGEST) -> str:
    """What was wrong with the end of a program, which may take ``limit`` seconds; an empty text where nothing was."""
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "GREYBOX_CACHE": str(cache),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONFAULTHANDLER": "1",
        MARK: mark,
    }
    environment.pop("PYTHONUNBUFFERED", None)
    command = [sys.executable, "-c", PROGRAM, str(case.bodies), str(case.hardening), case.end]
    with tempfile.TemporaryFile("w+") as errors:
        program = subprocess.Popen(
            command,
            cwd=cache,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
        )
        if case.end in SIGNALS:
            time.sleep(case.after)
            program.send_signal(SIGNALS[case.end])
        try:
            output, _ = program.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            program.kill()
            program.communicate()
            return f"it did not end in {limit:g} s"
        errors.seek(0)
        said = errors.read()
    return _find_fault(case, program.returncode, output.splitlines(), said) or _find_survivors(mark)


def _find_fault(case: Case, status: int, lines: list[str], errors: str) -> str:
    if "Fatal Python error" in errors or status in (-signal.SIGSEGV, -signal.SIGABRT, -signal.SIGBUS, 139, 134):
        return f"it crashed with status {status}: {errors[:300]}"
    is_whole = f"line {LINES - 1}" in lines
    if case.end in SIGNALS:
        # It may have been done before the signal came; Ctrl-C raises KeyboardInterrupt, or ends a fit that then returns what it has.
        allowed = {-SIGNALS[case.end], 0} | ({130, 1} if case.end == "SIGINT" else set())
        return "" if status in allowed and (is_whole or status) else f"it ended with status {status}: {errors[-300:]}"
    if status != STATUS[case.end]:
        return f"it ended with status {status}: {errors[-300:]}"
    if not is_whole or sum(line.startswith("fitted") for line in lines) != 2 + (case.end == "fork"):
        return f"it lost output: {lines[:5]} ... {lines[-1:]}"
    if case.end == "fork" and "child ended with 4" not in lines:
        return f"its copy did not end as it should: {lines[:6]}"
    return ""


# Seconds that what a program has started may take to notice that it has ended.
GRACE = 5.0


def _find_survivors(mark: str) -> str:
    """Processes that a program has left behind, on systems that tell the environment of a process."""
    deadline, left = time.monotonic() + GRACE, list[str]()
    while time.monotonic() < deadline:
        left = [path.parent.name for path in Path("/proc").glob("[0-9]*/environ") if _has(path, mark)]
        if not left:
            return ""
        time.sleep(0.1)
    return f"it left processes behind: {', '.join(left)}"


def _has(path: Path, mark: str) -> bool:
    try:
        return f"{MARK}={mark}".encode() in path.read_bytes()
    except OSError:  # it has ended, or is not ours
        return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Run so many programs; the number of faulty ones."""
    parser = argparse.ArgumentParser(description="Programs that fit and end at any moment of compiling.")
    parser.add_argument("--programs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--largest", type=int, default=50, help="bodies of the largest chain")
    parser.add_argument("--limit", type=float, default=LONGEST, help="s that a program may take")
    chosen = parser.parse_args(arguments)
    rng, faults, ends = random.Random(chosen.seed), 0, Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        shared = Path(folder, "shared")
        shared.mkdir(mode=0o700)
        for k in range(chosen.programs):
            case = draw_case(rng, chosen.largest)
            cache = shared
            if rng.random() < 0.5:
                cache = Path(folder, f"cache{k}")
                cache.mkdir(mode=0o700)
            fault = run_case(case, cache, chosen.limit)
            ends[case.end] += 1
            faults += bool(fault)
            if fault:
                print(f"{case}: {fault}", flush=True)
            elif (k + 1) % 10 == 0:
                print(f"{k + 1} programs, {faults} with a fault", flush=True)
    print(
        f"{chosen.programs} programs, {faults} with a fault; "
        + ", ".join(f"{n} {end}" for end, n in sorted(ends.items()))
    )
    return faults


if __name__ == "__main__":
    sys.exit(min(main(), 1))
