"""Eight processes in one folder, eight threads, processes that fork: the same answers, and nothing lost.

Slow; ``RELIABILITY_WRITE=1`` writes the figures to ``docs/studies/reliability.md``.
"""

from __future__ import annotations

import json
import multiprocessing
import shutil
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import greybox as gb
from greybox.base.files import PART
from greybox.discovery.execution import RefitJournal, RefitOutcome
from greybox.shell.commands import app
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.child import run_in_child
from tests.support.command import CliRunner
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(sys.platform == "win32", reason="processes that fork"),
]
AT_ONCE = 8
USUAL_ROUNDS = 20
PERIOD = 1.6384e-3
RECORD = linear_record(silverbox, multisine(np.random.default_rng(1), 300, PERIOD, 5, 200, 0.1), PERIOD)
START = silverbox.start(**{q.name: 1.2 * silverbox.values[q.name] for q in silverbox.free_parameters})


def estimate(_: int = 0) -> dict[str, float]:
    return dict(gb.fit(START, RECORD, noise={"y": 1e-4}).model.values)


def work_in_folder(folder: Path, number: int, gate: Any) -> None:
    """A fit by the command, and ten lines of a journal, when all others are as far."""
    gate.wait(60)
    words = [
        "fit",
        "silverbox",
        "record.csv",
        "--noise",
        "y=1e-4",
        "--at-rest",
        "--no-report",
        "-q",
        "--output",
        str(folder),
    ]
    done = CliRunner().invoke(app, words)
    journal = RefitJournal(folder / "lines.jsonl")
    for k in range(10):
        journal.add(f"{number}-{k}", RefitOutcome({"a": float(k)}, ((0.0,),), 0))
    sys.exit(done.exit_code)


def test_eight_processes_in_one_new_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GREYBOX_CACHE", str(tmp_path / "cache"))
    gb.simulation.write_csv(RECORD, silverbox, tmp_path / "record.csv")
    context, faults, answers = multiprocessing.get_context("fork"), [], []
    rounds = size_of(USUAL_ROUNDS)
    for number in range(rounds):
        if number % 5 == 0:
            shutil.rmtree(tmp_path / "cache", ignore_errors=True)  # all compile the same kernels
        folder, gate = tmp_path / f"out{number}", context.Barrier(AT_ONCE)
        crowd = [context.Process(target=work_in_folder, args=(folder, k, gate)) for k in range(AT_ONCE)]
        for process in crowd:
            process.start()
        for process in crowd:
            process.join(300)
        codes = [process.exitcode for process in crowd]
        if any(codes):
            faults.append(f"round {number}: exit codes {codes}")
            continue
        answers.append(
            {name: e["value"] for name, e in json.loads((folder / "fit.json").read_text())["parameters"].items()}
        )
        keys = [json.loads(line)["key"] for line in (folder / "lines.jsonl").read_text().splitlines()]
        if sorted(keys) != sorted(f"{k}-{j}" for k in range(AT_ONCE) for j in range(10)):
            faults.append(f"round {number}: {len(keys)} lines of {10 * AT_ONCE}")
        if left := [*folder.glob(PART.format("*")), *(tmp_path / "cache").rglob(PART.format("*"))]:
            faults.append(f"round {number}: {left} left")
    faults += [f"another answer: {answer}" for answer in answers if answer != answers[0]]
    lines = rounds * AT_ONCE * 10
    figures = f"{AT_ONCE} fits at a time, every fifth round with an empty cache; no line of {lines} in their journals lost; same answer"
    note_row("eight processes that begin in one new folder", rounds, len(faults), figures)
    assert not faults


def test_eight_threads_give_the_same_answers():
    alone, faults = estimate(), 0
    rounds = size_of(USUAL_ROUNDS)
    with ThreadPoolExecutor(AT_ONCE) as threads:
        for _ in range(rounds):
            faults += sum(answer != alone for answer in threads.map(estimate, range(AT_ONCE)))
    note_row(
        "eight threads that fit at a time",
        rounds,
        faults,
        f"{rounds * AT_ONCE} fits, each with the answer of one thread alone",
    )
    assert not faults


def test_forked_processes_give_the_same_answers():
    alone, faults = estimate(), []
    rounds = size_of(USUAL_ROUNDS)
    for number in range(rounds):
        busy = (
            threading.Thread(target=estimate) if number % 2 else None
        )  # half of them fork in the middle of another fit
        if busy:
            busy.start()
        answer = run_in_child(estimate)
        if busy:
            busy.join()
        if answer != alone:
            faults.append(answer)
    note_row(
        "processes that fork after a fit, or during one",
        rounds,
        len(faults),
        "each child fits and gives the answer of its parent",
    )
    assert not faults
