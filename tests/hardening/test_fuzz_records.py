"""Odd files through the command, and mutations of valid files through the readers: only answers and clear sentences come out.

Slow; ``RELIABILITY_SIZE=10`` makes ten times as many trials, ``RELIABILITY_WRITE=1`` writes the figures to ``docs/studies/reliability.md``.
"""

from __future__ import annotations

import resource
import signal
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.data.read import read_csv
from models.silverbox import silverbox
from tests.hardening.mutations import mutate_bytes, mutate_text
from tests.hardening.record_files import odd_files, packed_lies, valid_files
from tests.support.child import run_in_child
from tests.support.command import CliRunner
from tests.support.reliability import note_row, size_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]
LONGEST_MESSAGE = 3000
LONGEST_READ = 5.0
"""CPU seconds of one read of a damaged file; the valid ones take a few hundredths."""


@contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    """Ends what hangs with a TimeoutError."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def judge_read(path: Path, how: dict[str, object]) -> str:
    """What one read comes to: "read", "refused", or what is wrong with it."""
    try:
        with time_limit(30):
            read_csv(path, silverbox, **how)
    except DataError as error:
        text = str(error)
        if path.name not in text:
            return f"the file is not named: {text[:100]}"
        return "refused" if len(text) < LONGEST_MESSAGE else f"a message of {len(text)} characters"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
    return "read"


def damage_repeatedly(
    path: Path, how: dict[str, object], times: int, seed: int
) -> tuple[Counter[str], tuple[float, str], float]:
    """How often each outcome came, the longest CPU time in s with its trial, and by how much memory grew in MB."""
    rng, outcomes, slowest = np.random.default_rng(seed), Counter[str](), (0.0, "")
    target, content = path.parent / "damaged" / path.name, path.read_bytes()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for trial in range(times):
        is_text = path.suffix in (".csv", ".tsv", ".dat", ".txt") and rng.random() < 0.7
        target.write_bytes((mutate_text if is_text else mutate_bytes)(content, rng))
        began = time.process_time()
        outcome = judge_read(target, how)
        outcomes[outcome] += 1
        slowest = max(slowest, (time.process_time() - began, f"trial {trial} of {path.name}, {outcome}"))
    return outcomes, slowest, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3


@pytest.mark.skipif(sys.platform != "linux", reason="alarms and peak memory of Linux")
def test_mutations_of_valid_files_of_every_format(tmp_path):
    files, rng = valid_files(tmp_path), np.random.default_rng(2)
    assert len(files) == 25
    for name, (path, how) in files.items():
        assert judge_read(path, how) == "read", name
    each, outcomes, wrong, slowest, grown = size_of(800), Counter[str](), Counter[str](), (0.0, ""), 0.0
    tried = each * len(files)
    (tmp_path / "damaged").mkdir()
    for path, how in files.values():
        seed = int(rng.integers(2**31))

        def damage_and_read(path: Path = path, how: dict[str, object] = how, seed: int = seed) -> object:
            return damage_repeatedly(path, how, each, seed)

        result = run_in_child(damage_and_read)
        if isinstance(result, int):
            wrong[f"{path.name}: the process ended by signal {result}"] += 1
            continue
        results, seconds, memory = result
        slowest, grown = max(slowest, seconds), max(grown, memory)
        print(f"{path.name}: {dict(results)}, {seconds}, {memory:.0f} MB", flush=True)
        for outcome, count in results.items():
            outcomes[outcome] += count
            if outcome not in ("read", "refused"):
                wrong[f"{path.name}: {outcome}"] += count
    memory = f"memory grew by {grown:.0f} MB at most, the slowest took {slowest[0]:.1f} CPU s"
    figures = f"{outcomes['read']} read, {outcomes['refused']} refused; {memory}"
    note_row("mutations of 25 valid files of every format, in process", tried, sum(wrong.values()), figures)
    assert not wrong, wrong.most_common(20)
    assert grown < 1000
    assert slowest[0] < LONGEST_READ, slowest


def judge_command(folder: Path, command: list[str], file: str) -> str:
    """What a command comes to on one file: "done", "refused", or what is wrong with it."""
    from greybox.shell.commands import app

    before = {path.relative_to(folder) for path in folder.rglob("*")}
    with time_limit(120):
        result = CliRunner().invoke(app, command)
    written = {path.relative_to(folder) for path in folder.rglob("*")} - before
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        place = traceback.extract_tb(result.exception.__traceback__)[-1]
        return f"{type(result.exception).__name__} in {Path(place.filename).name}:{place.lineno}: {result.exception}"[
            :200
        ]
    if result.exit_code == 0 or (result.exit_code == 1 and "error: no success" in result.output):
        return "done"
    if result.exit_code == 1 and (
        "the simulation overflows" in result.output or "worse than a constant" in result.output
    ):
        return "done"
    if result.exit_code != 2:
        return f"exit code {result.exit_code}: {result.output[-200:]}"
    if written:
        return f"exit code 2, and written: {sorted(map(str, written))[:3]}"
    if "Traceback" in result.output or "error: " not in result.output or Path(file).name not in result.output:
        return f"no sentence with the file: {result.output[-300:]}"
    return "refused"


@pytest.mark.skipif(sys.platform != "linux", reason="alarms of POSIX")
def test_odd_files_through_the_command(tmp_path, monkeypatch):
    """Every file through one of the commands that read records, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    files = [*odd_files(), *packed_lies()]
    rng = np.random.default_rng(3)
    tried = min(len(files), size_of(700))
    chosen = sorted(rng.choice(len(files), tried, replace=False))
    wrong, outcomes = Counter[str](), Counter[str]()
    for number, k in enumerate(chosen):
        name, content = files[k]
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / name).write_bytes(content)
        monkeypatch.chdir(folder)
        command = [
            ["check", "silverbox", name, "--output", "out", "--no-report"],
            ["fit", "silverbox", name, "--output", "out", "--no-report", "-q"],
            ["simulate", "silverbox", name, "--output", "out.csv", "--no-report"],
        ][number % 3]
        outcome = judge_command(folder, command, name)
        outcomes[outcome if outcome in ("done", "refused") else "wrong"] += 1
        if outcome not in ("done", "refused"):
            wrong[f"{command[0]} {name}: {outcome}"] += 1
        if (number + 1) % 50 == 0 or number + 1 == tried:
            refused = f"{outcomes['refused']} refused with exit code 2 and nothing written"
            figures = f"of {len(files)} files; {outcomes['done']} answered, {refused}"
            note_row("odd and malformed files, through the command", number + 1, sum(wrong.values()), figures)
            print(number + 1, dict(outcomes), flush=True)
    assert not wrong, wrong.most_common(20)
