"""Commands that are killed at a random moment: nothing finished is lost, no process is left, the same command goes on."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.shell.test_workers import COMMAND, ENVIRONMENT, record  # noqa: F401
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc"),
]
START = "fit micro_actuator {record} --fix M --fix Ra --starts 40"
SEARCH = "discover micro_actuator {record} --validate {other} --fix M --effects coulomb_friction,cubic_stiffness,stribeck_friction"
COMMANDS = {
    "multi-start": f"{START} --workers 1 --no-report -q",
    "multi-start, 2 workers": f"{START} --workers 2 --no-report -q",
    "search": f"{SEARCH} --workers 1 --no-report",
    "search, 2 workers": f"{SEARCH} --workers 2 --no-report",
    "writing": "fit micro_actuator {record} --fix M --fix Ra",
}
EAGER = """
from greybox.discovery.execution import RefitExecutor
from greybox.shell import main
RefitExecutor.parallel_seconds = property(lambda _: 0.0, lambda *_: None)
main()
"""
"""The command, with processes for a search of any length: those of a trial would be done before processes pay."""
MOMENTS = {
    "multi-start": (0.5, 1.0),
    "multi-start, 2 workers": (0.6, 1.0),
    "search": (0.7, 1.0),
    "search, 2 workers": (0.7, 1.0),
    "writing": (0.8, 1.0),
}
"""When a command is killed, as shares of the CPU time that it takes, which other work on the machine does not change: when its modules and
those of its workers are loaded."""
LOOK_SECONDS = 0.02
USUAL_TRIALS = 52
END_SECONDS = 5.0
MARK = "GREYBOX_TRIAL"


def start(command: str, data: Path, folder: Path, trial: str) -> subprocess.Popen:
    words = [*COMMANDS[command].format(record=data, other=data.with_name("other.csv")).split(), "--output", str(folder)]
    environment = ENVIRONMENT | {MARK: trial}
    program = [sys.executable, "-c", EAGER] if command.startswith("search") else COMMAND
    return subprocess.Popen([*program, *words], env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def living(trial: str) -> list[int]:
    """Processes of a trial that are alive."""
    mark, pids = f"{MARK}={trial}".encode(), []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            inside = mark in (folder / "environ").read_bytes().split(b"\0")
            state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:  # it has ended meanwhile
            continue
        if inside and state != "Z":
            pids.append(int(folder.name))
    return pids


def measure_cpu_seconds(trial: str) -> float:
    """CPU time of the living processes of a trial, and of their children that have ended."""
    ticks = 0
    for pid in living(trial):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def kill_after(seconds: float, process: subprocess.Popen, trial: str) -> bool:
    """Kill a command when it has worked for as many CPU seconds; whether it was still at work."""
    while process.poll() is None and measure_cpu_seconds(trial) < seconds:
        time.sleep(LOOK_SECONDS)
    at_work = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return at_work


def read_answer(folder: Path) -> dict[str, Any]:
    """What a command found, without what a run may differ in."""
    if (folder / "discovery.json").exists():
        data = json.loads((folder / "discovery.json").read_text())
        return {"verdict": data["verdict"], "effects": [e["name"] for e in data["effects"]]}
    data = json.loads((folder / "fit.json").read_text())
    return {name: e["value"] for name, e in data["parameters"].items()}


def read_keys(folder: Path) -> set[str]:
    """The finished refits of a journal; a last line that was cut short is none."""
    keys = set()
    for name in ("journal.jsonl", "starts.jsonl"):
        for line in (folder / name).read_text().split("\n")[:-1] if (folder / name).exists() else []:
            keys.add(json.loads(line)["key"])
    return keys


def run_whole(command: str, data: Path, folder: Path) -> tuple[float, dict[str, Any]]:
    """CPU seconds and answer of a command that nobody disturbs."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = start(command, data, folder, "whole")
    _, said = process.communicate()
    assert process.returncode in (0, 1) and b"Traceback" not in said, said.decode()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    print(f"{command}: {seconds:.1f} CPU s", flush=True)
    return seconds, read_answer(folder)


def find_processes_left(trial: str, command: str) -> list[str]:
    """What is alive of a trial some seconds after its process was killed; it is ended."""
    killed = time.monotonic()
    while living(trial) and time.monotonic() - killed < END_SECONDS:
        time.sleep(0.1)
    left = living(trial)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    return [f"{command}: process {pid} is left" for pid in left]


def go_on(command: str, data: Path, folder: Path, before: set[str], answer: dict[str, Any]) -> list[str]:
    """Faults of the same command after the kill; ``before``: what was finished by then."""
    again = start(command, data, folder, "again")
    _, err = again.communicate()
    if again.returncode not in (0, 1) or b"Traceback" in err:
        return [f"{command}: {err.decode()[-500:]}"]
    lost = command.startswith("search") and not before <= read_keys(folder)
    after = read_answer(folder)
    another = after != pytest.approx(answer, rel=1e-6) if "effects" not in answer else after != answer
    return [f"{command}: finished refits are lost"] * lost + [f"{command}: {after} instead of {answer}"] * another


def test_killed_commands_go_on(record, tmp_path):  # noqa: F811
    generator = np.random.default_rng(0)
    # A record does not validate itself: half of it each.
    head, *rows = record.read_text().splitlines()
    for name, half in (("record", rows[: len(rows) // 2]), ("other", rows[len(rows) // 2 :])):
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *half, ""]))
    record = tmp_path / "record.csv"
    whole = {command: run_whole(command, record, tmp_path / f"whole {command}") for command in COMMANDS}
    faults: list[str] = []
    kept = at_work = 0
    for number in range(size_of(USUAL_TRIALS)):
        command = list(COMMANDS)[number % len(COMMANDS)]
        seconds, answer = whole[command]
        folder, trial = tmp_path / str(number), uuid.uuid4().hex
        process = start(command, record, folder, trial)
        at_work += kill_after(generator.uniform(*MOMENTS[command]) * seconds, process, trial)
        faults += find_processes_left(trial, command)
        before = read_keys(folder)
        for file in folder.glob("*.json"):
            json.loads(file.read_text())  # whole, or not there
        faults += [
            f"{command}: half a page" for file in folder.glob("*.html") if "</html>" not in file.read_text()[-20:]
        ]
        faults += go_on(command, record, folder, before, answer)
        kept += len(before)
        print(f"{number} {command}: {len(before)} finished when it was killed, faults {faults}", flush=True)
        note_row(
            "kill -9 at random points of search, multi-start and write, with and without workers, then the same command",
            number + 1,
            len(faults),
            f"{at_work} killed at work; {kept} refits were finished by then and none was lost; same answers; no process left after 5 s",
        )
    assert not faults
