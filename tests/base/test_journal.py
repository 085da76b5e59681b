"""A journal survives what a killed process, a full disk or a stranger leaves in it."""

from __future__ import annotations

import json
import os
import sys

import pytest

from greybox.base.errors import DataError
from greybox.base.files import JournalCode, read_journal
from greybox.base.parallel.jobs import run_jobs
from greybox.discovery.execution import FailureLog, RefitExecutor, RefitJob, RefitJournal, RefitOutcome
from models.micro_actuator import micro_actuator

ENTRIES = {f"k{n}": RefitOutcome({"M": 0.01 * n, "K": 5000.0}, ((0.0, 1e-6),)) for n in range(4)}


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = RefitJournal(path)
    for key, outcome in ENTRIES.items():
        journal.add(key, outcome)
    journal.add("none", None)
    return path


def test_what_was_added_is_known_again(written):
    journal = RefitJournal(written)
    assert journal.known == {**ENTRIES, "none": None}
    assert journal.findings == ()


def test_a_last_line_cut_anywhere_loses_itself_alone(written):
    """Cut at every byte of the last line, two more refits, and a new start."""
    whole = written.read_bytes()
    start = whole[:-1].rfind(b"\n") + 1
    for size in range(start, len(whole) + 1):
        written.write_bytes(whole[:size])
        journal = RefitJournal(written)
        lost = start < size < len(whole) - 1
        assert [f.code for f in journal.findings] == [JournalCode.LAST_LINE_CUT] * lost
        journal.add("new", ENTRIES["k1"])
        journal.add("newer", None)
        again = RefitJournal(written)
        kept = {**ENTRIES, "new": ENTRIES["k1"], "newer": None} | ({"none": None} if size >= len(whole) - 1 else {})
        assert again.known == kept and again.findings == ()


BROKEN = {
    "another encoding": '{"key": "k9", "outcome": null}'.encode("utf-16"),
    "no bytes of a text": bytes(range(128, 256)),
    "values are a text": b'{"key": "k9", "outcome": {"values": "ab", "initial": []}}',
    "a value is a text": b'{"key": "k9", "outcome": {"values": {"M": "x"}, "initial": []}}',
    "initial is a number": b'{"key": "k9", "outcome": {"values": {}, "initial": 3}}',
    "a number of 5000 digits": b'{"key": "k9", "outcome": {"values": {"M": ' + b"9" * 5000 + b'}, "initial": []}}',
    "a number of 400 digits": b'{"key": "k9", "outcome": {"values": {"M": ' + b"9" * 400 + b'}, "initial": []}}',
    "deeply nested": b"[" * 100_000,
    "no object": b"5",
    "no key": b'{"outcome": null}',
    "two lines in one": b'{"key": "k9", "outc{"key": "k8", "outcome": null}',
}


@pytest.mark.parametrize("line", BROKEN.values(), ids=BROKEN)
def test_a_broken_line_inside_is_skipped_and_said(written, line):
    first, *rest = written.read_bytes().split(b"\n")
    written.write_bytes(b"\n".join([first, line.replace(b"\n", b" "), *rest]))
    journal = RefitJournal(written)
    assert journal.known == {**ENTRIES, "none": None}
    (finding,) = journal.findings
    assert finding.code == JournalCode.LINES_SKIPPED and finding.values["lines"] == [2]


@pytest.mark.parametrize("content", [b"time,x\n1,2\n", b"precious text without an end", b"\0\0\0\0"])
def test_a_file_that_is_no_journal_is_refused_and_left_alone(tmp_path, content):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(content)
    with pytest.raises(DataError, match="line 1 is not a journal entry"):
        RefitJournal(path)
    assert path.read_bytes() == content


def test_a_bug_in_the_reading_is_no_damaged_file(written):
    """Who is told to delete a journal loses all its results: what is no fault of the file must not say so."""

    def parse(data):
        return missing_name  # noqa: F821

    with pytest.raises(NameError):
        read_journal(written, parse)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes with a name")
def test_a_pipe_in_the_place_of_a_journal_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "journal.jsonl")
    with pytest.raises(DataError, match="not a file"):
        RefitJournal(tmp_path / "journal.jsonl")


class Doubling:
    """A problem whose refits are arithmetic; the last one sees how many lines the journal has by then."""

    def __init__(self, journal):
        self.journal, self.failures = journal, FailureLog()

    def to_portable(self):
        return self

    def job_key(self, job):
        return str(job.keep)

    def refit(self, job):
        import time

        patience = time.monotonic() + 100  # the other worker may still be starting, for long on a busy machine
        while job.keep == 3 and time.monotonic() < patience:
            if self.journal.exists() and self.journal.read_text().count("\n") >= 3:
                return RefitOutcome({"lines": 3.0}, ())
            time.sleep(0.05)
        return RefitOutcome({"lines": 0.0}, ())

    def to_outcome(self, outcome):
        return outcome

    def restore(self, model, outcome):
        return outcome


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_results_of_workers_are_noted_as_they_come(tmp_path):
    path = tmp_path / "journal.jsonl"
    executor = RefitExecutor(workers=2, journal=RefitJournal(path), parallel_seconds=0.0)
    with executor.open():
        results = executor.run(Doubling(path), [RefitJob(micro_actuator, (), keep, 1) for keep in range(4)])
    assert results[3].values["lines"] == 3.0
    assert len(RefitJournal(path).known) == 4
    assert [json.loads(line)["key"] for line in path.read_text().splitlines()][-1] == "3"


def test_an_error_while_a_result_is_received_is_not_taken_for_a_dead_worker():
    def receive(k, result):
        raise DataError("the disk is full")

    with pytest.raises(DataError, match="the disk is full"):
        run_jobs(lambda common, item: item, None, [1, 2, 3], workers=2, receive=receive)
