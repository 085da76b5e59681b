"""A disk that is full at any 4 KB of any command: the old result or the new one, and the file is named.

The size of files is limited, which a process meets in the middle of a write as it meets a full disk.
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import signal
import sys
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.child import run_in_child
from tests.support.command import CliRunner
from tests.support.reliability import note_row, size_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX"),
]

EFFECTS = "coulomb_friction,stribeck_friction"
SEARCH = "discover silverbox record.csv --validate other.csv --at-rest --workers 1 --output out"
ASKED = "design silverbox --limit u=-1:1 --duration 0.1 --sampling-time 1.6384e-3 --noise y=1e-4"
COMMANDS = {
    "fit": ["fit", "silverbox", "record.csv", "--at-rest", "--output", "out"],
    "check": ["check", "silverbox", "record.csv", "--output", "out"],
    "simulate": ["simulate", "silverbox", "record.csv", "--output", "out/run.csv"],
    "study": ["fit", "silverbox", "record.csv", "--at-rest", "--write-study", "out/study.toml"],
    "init": ["init", "out", "--force"],
    "starts": [
        "fit",
        "silverbox",
        "record.csv",
        "--at-rest",
        "--starts",
        "3",
        "--workers",
        "1",
        "--no-report",
        "--output",
        "out",
    ],
    "discover": [*SEARCH.split(), "--effects", EFFECTS],
    "compare": ["compare", "silverbox", "record.csv", "--validate", "other.csv", "--at-rest", "--output", "out"],
    "changed": ["changed", "fit.json", "other.csv", "--no-effects", "--no-report", "--output", "out"],
    "design": [*ASKED.split(), "--at-rest", "--no-report", "--output", "out"],
    "campaign": [*ASKED.replace("design", "campaign", 1).split(), "--no-report", "--output", "out"],
    **{
        f"export {kind}": ["export", "fit.json", "--to", kind, "--output", f"out/plant{suffix}"]
        for kind, suffix in {
            "control": ".py",
            "mat": ".mat",
            "json": ".json",
            "numpy": ".npz",
            "c": ".c",
            "modelica": ".mo",
            "python": ".py",
            "fmu": ".fmu",
        }.items()
    },
}
STEP = 4096
BEGUN_ANEW = ("study", "campaign")
"""Commands that refuse a file that is there, or go on from it: they find an empty folder."""
WHILE_AT_WORK = "starts.jsonl"
"""A file that is there until its command has ended."""


@contextlib.contextmanager
def disk_of(size: int | None) -> Iterator[None]:
    """Files of ``size`` bytes at most."""
    if size is not None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    yield


def run_command(command: list[str], size: int | None = None) -> tuple[int, str, str]:
    """Exit code, output, and the traceback's last line if there is one, in a process with such a disk."""

    def work() -> tuple[int, str, str]:
        from greybox.shell.commands import app

        with disk_of(size):
            result = CliRunner().invoke(app, command)
        error = result.exception
        return result.exit_code, result.output, "" if isinstance(error, SystemExit | None) else repr(error)

    return run_in_child(work)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def is_one_of(name: str, data: bytes, old: dict[str, bytes], new: dict[str, bytes]) -> bool:
    """Whether a file is whole: as it was, as it is when all goes well, or as long as that, or with the same end (some hold the time)."""
    if data in (old.get(name), new.get(name)) or (name in new and len(data) == len(new[name])):
        return True
    if name.endswith(".jsonl"):
        return data[-1:] in (b"", b"\n") and all(isinstance(json.loads(line), dict) for line in data.splitlines())
    if name.endswith(".fmu"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return archive.testzip() is None
    ends = {".json": b"}\n", ".html": b"</html>", ".svg": b"</svg>\n", ".png": b"IEND\xaeB`\x82"}
    return data.rstrip(b"\n").endswith(ends.get(Path(name).suffix, b"\0").rstrip(b"\n"))


def test_a_full_disk_leaves_the_old_result_or_the_new_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # The scan over black boxes takes a minute and writes nothing.
    monkeypatch.setattr("greybox.comparison.black_box_candidates.fit_black_boxes", lambda *_, **__: ((), ()))
    period = 1.6384e-3
    record, other = (
        linear_record(silverbox, multisine(np.random.default_rng(k), 300, period, 5, 200, 0.1), period) for k in (1, 2)
    )
    gb.simulation.write_csv(record, silverbox, tmp_path / "record.csv")
    gb.simulation.write_csv(other, silverbox, tmp_path / "other.csv")
    gb.fit(silverbox, record, options=gb.FitOptions(at_rest=True)).save(tmp_path / "fit.json")
    tried, wrong, refused = 0, Counter[str](), 0
    steps = size_of(9)
    for name, command in COMMANDS.items():
        out = tmp_path / "out"
        out.mkdir(exist_ok=True)
        code, output, error = run_command(command)
        assert (code, error) == (0, ""), (name, output)
        new = contents(out)
        largest = max(map(len, new.values()))
        sizes = sorted({STEP * k for k in np.unique(np.linspace(0, largest // STEP, steps).astype(int)).tolist()})
        old = dict.fromkeys(new, b"the old one")
        for size in sizes:
            for path in [p for p in out.rglob("*") if p.is_file()]:
                path.unlink()
            if name not in BEGUN_ANEW:
                for path, data in old.items():
                    if not path.endswith(".jsonl"):  # without it the search begins anew
                        (out / path).write_bytes(data)
            tried += 1
            code, output, error = run_command(command, size)
            after = contents(out)
            broken = [path for path, data in after.items() if not is_one_of(path, data, old, new)]
            enough = size > largest
            if error or broken or code not in ((0,) if enough else (0, 1)):
                wrong[f"{name} at {size} of {largest}: code {code}, {error or broken or output[-300:]}"] += 1
            elif code == 1:
                refused += 1
                if not any(Path(path).name in output for path in (*new, WHILE_AT_WORK)):
                    wrong[f"{name} at {size}: the file is not named: {output[-300:]}"] += 1
        for path in [p for p in out.rglob("*") if p.is_file()]:
            path.unlink()
        done = list(COMMANDS).index(name) + 1
        figures = f"of {done} commands; {refused} ended with exit code 1 and the name of the file, the others had room"
        note_row("full disk at 4 KB steps of every command", tried, sum(wrong.values()), figures)
        print(f"{name}: {len(sizes)} sizes, {len(wrong)} faults so far", flush=True)
    assert not wrong, "\n".join(wrong)
