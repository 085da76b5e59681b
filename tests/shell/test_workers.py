"""Options that share the work, and signals that end a command."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np
import pytest

import greybox as gb
from greybox.shell.commands import app
from greybox.shell.terminal import exit_on_error
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.command import CliRunner

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, sys.path)])}
COMMAND = [sys.executable, "-m", "greybox"]


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("record") / "record.csv"
    words = "simulate micro_actuator --multisine 2 --band 5:800 --duration 0.25 --sampling-time 2.5e-4 --noise x=2e-7 --noise i=5e-3"
    done = CliRunner().invoke(app, [*words.split(), "--output", str(file), "--no-report"], prog_name="greybox")
    assert done.exit_code == 0
    return file


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    """A saved fit, with its record.csv beside it."""
    folder = tmp_path_factory.mktemp("reference")
    period = 1.6384e-3
    record = linear_record(silverbox, multisine(np.random.default_rng(1), 120, period, 5, 200, 0.1), period)
    gb.simulation.write_csv(record, silverbox, folder / "record.csv")
    return gb.fit(silverbox, record, noise={"y": 1e-4}).save(folder / "fit.json")


@pytest.mark.parametrize("command", ["fit", "compare"])
@pytest.mark.parametrize("option", [("--workers", "2"), ("--cluster", "local")])
def test_workers_without_anything_to_share_are_refused(record, tmp_path, command, option):
    words = [command, "micro_actuator", str(record), "--fix", "M", "--output", str(tmp_path / "out"), *option]
    words += ["--validate", str(record)] if command == "compare" else []
    done = CliRunner().invoke(app, words, prog_name="greybox")
    assert done.exit_code == 2
    assert "no effect" in done.stderr
    assert not (tmp_path / "out").exists()


def test_one_worker_is_what_a_command_has_anyway(record, tmp_path):
    words = f"fit micro_actuator {record} --fix M --fix Ra --no-report -q --workers 1 --output {tmp_path / 'out'}"
    done = CliRunner().invoke(app, words.split(), prog_name="greybox")
    assert done.exit_code == 0, done.stderr


@pytest.mark.parametrize("command", ["fit", "discover"])
def test_a_cluster_that_does_not_answer_is_bad_input(record, tmp_path, command, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = [
        command,
        "micro_actuator",
        str(record),
        "--fix",
        "M",
        "--output",
        str(tmp_path / "out"),
        "--cluster",
        "local",
    ]
    words += ["--starts", "3"] if command == "fit" else ["--validate", str(record)]
    done = CliRunner().invoke(app, words, prog_name="greybox")
    assert done.exit_code == 2
    assert "pip install" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("command", ["campaign", "changed"])
def test_searches_within_other_commands_go_to_the_cluster(command, reference, tmp_path, monkeypatch):
    """It is opened for them: here it cannot be."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = {
        "campaign": "campaign silverbox --limit u=-0.1:0.1 --noise y=1e-4 --duration 0.2 --sampling-time 1.6384e-3",
        "changed": f"changed {reference} {reference.parent / 'record.csv'}",
    }[command]
    words += f" --cluster local --output {tmp_path / 'out'}"
    done = CliRunner().invoke(app, words.split(), prog_name="greybox")
    assert done.exit_code == 2
    assert "pip install" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("option", [("--workers", "2"), ("--cluster", "local")])
@pytest.mark.parametrize("kind", ["--no-effects", "--chart"])
def test_changes_without_a_search_share_nothing(kind, option, reference, tmp_path):
    words = ["changed", str(reference), "record.csv", kind, "--output", str(tmp_path / "out"), *option]
    done = CliRunner().invoke(app, words, prog_name="greybox")
    assert done.exit_code == 2
    assert f"{option[0]}: no effect here, where no effect is looked for" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.rest
def test_workers_give_the_fit_that_one_process_gives(record, tmp_path):
    fits = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        words = (
            f"fit micro_actuator {record} --fix M --fix Ra --starts 3 --no-report -q --workers {workers} --output {out}"
        )
        if workers == "1":
            done = CliRunner().invoke(app, words.split(), prog_name="greybox")
            assert done.exit_code == 0, done.stderr
        else:
            subprocess.run([*COMMAND, *words.split()], env=ENVIRONMENT, check=True, timeout=170)
        data = json.loads((out / "fit.json").read_text())
        fits.append({name: e["value"] for name, e in data["parameters"].items()})
        assert not (out / "starts.jsonl").exists()
    assert fits[0] == fits[1]


SECONDS = re.compile(r"\d m?s\b")
"""A line that says how long something took."""
SHARED = {
    "starts": "fit micro_actuator {record} --fix M --fix Ra --starts 3 -q",
    "bootstrap": "fit micro_actuator {record} --fix M --fix Ra --bootstrap 100 --profile K",
    "compare": "compare silverbox {short} --validate {again} --starts 3 -q",  # the black boxes of two outputs take minutes
    "discover": "discover micro_actuator {record} --validate {other} --fix M --effects coulomb_friction,cubic_stiffness",
}


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.skipif(find_spec("distributed") is None, reason="the extra 'dask' is not installed")
@pytest.mark.parametrize("work", SHARED)
def test_a_cluster_gives_what_one_process_gives(record, reference, tmp_path, work):
    files = {"record": record, "short": reference.parent / "record.csv"}
    for whole, part in (("record", "other"), ("short", "again")):  # a record does not validate itself: half of it each
        (head, *rows), half = files[whole].read_text().splitlines(keepends=True), tmp_path / f"{whole}.csv"
        files[part] = tmp_path / f"{part}.csv"
        half.write_text("".join([head, *rows[: len(rows) // 2]]))
        files[part].write_text("".join([head, *rows[len(rows) // 2 :]]))
        files[whole] = half
    answers = []
    for number, place in enumerate(("--workers 1", "--workers 2 --cluster local")):
        out = tmp_path / str(number)
        words = f"{SHARED[work].format(**files)} --no-report {place} --output {out}"
        done = subprocess.run([*COMMAND, *words.split()], env=ENVIRONMENT, capture_output=True, text=True, timeout=500)
        assert done.returncode == 0, done.stderr
        (file,) = (f for f in out.glob("*.json"))
        printed = [line for line in done.stdout.splitlines() if not (str(out) in line or SECONDS.search(line))]
        assert printed or "-q" in SHARED[work]
        answers.append((without_times(json.loads(file.read_text())), printed))
    assert answers[0] == answers[1]


def without_times(data):
    """What a file says, but for how long it took and when."""
    if isinstance(data, dict):
        return {k: without_times(v) for k, v in data.items() if not {"seconds", "time", "date"} & set(k.split("_"))}
    if isinstance(data, float):  # refits of workers are run again from their constants: the last digits may differ
        return float(f"{data:.9g}")
    return [without_times(v) for v in data] if isinstance(data, list) else data


@pytest.mark.rest
@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGTERM, marks=pytest.mark.slow),
        signal.SIGINT,
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_a_request_to_end_keeps_what_is_finished_and_the_same_command_goes_on(record, tmp_path, number):
    out = tmp_path / "out"
    # Far more starts than are searched from before the signal comes.
    words = f"fit micro_actuator {record} --fix M --fix Ra --starts 300 --workers 1 --no-report -q --output {out}"
    # Under nohup, or behind a shell's &, the tests themselves may have been told to ignore a signal, and a child would be told the same.
    process = subprocess.Popen(
        [*COMMAND, *words.split()],
        env=ENVIRONMENT,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    journal = out / "starts.jsonl"
    deadline = time.monotonic() + 120
    while not journal.exists() or journal.read_text().count("\n") < 3:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted" in err and "Traceback" not in err
    assert journal.read_text().endswith("\n")
    assert len(json.loads((out / "fit.json").read_text())["ends"]) >= 3


def test_too_little_memory_is_told(capsys):
    def starve() -> None:
        np.empty(2**55)

    with pytest.raises(click.exceptions.Exit) as ended:
        exit_on_error(starve)()
    assert ended.value.exit_code == 1
    assert capsys.readouterr().err.startswith("error: not enough memory")


@pytest.mark.rest
@pytest.mark.parametrize(
    "encoding", ["ascii", *(pytest.param(e, marks=pytest.mark.slow) for e in ("cp1252", "latin-1", "utf-8"))]
)
def test_names_that_the_terminal_does_not_know_are_no_traceback(record, tmp_path, encoding):
    folder = tmp_path / "ünï名"
    words = [
        "simulate",
        "micro_actuator",
        "--step",
        "1",
        "--duration",
        "0.01",
        "--sampling-time",
        "1e-3",
        "--no-report",
    ]
    environment = ENVIRONMENT | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [*COMMAND, *words, "--output", str(folder / "a.csv")],
        env=environment,
        capture_output=True,
        timeout=120,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert (folder / "a.csv").exists()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names of any bytes")
def test_a_file_name_that_is_no_text_is_no_traceback(tmp_path):
    name = os.fsdecode(os.fsencode(tmp_path) + b"/odd\xff\xfe")
    words = ["simulate", "micro_actuator", "--step", "1", "--duration", "0.01", "--sampling-time", "1e-3"]
    command = [*COMMAND, *words, "--output", f"{name}.csv"]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, timeout=120, check=False)
    assert b"Traceback" not in done.stderr
    assert done.returncode in (0, 1, 2)
    again = [*COMMAND, "fit", "micro_actuator", f"{name}.csv", "--fix", "M", "--output", f"{name}-out"]
    done = subprocess.run(again, env=ENVIRONMENT, capture_output=True, timeout=120, check=False)
    assert b"Traceback" not in done.stderr, done.stderr.decode()


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.skipif(sys.platform == "win32", reason="closed streams as POSIX has them")
@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-", ">/dev/full", "2>/dev/full"])
def test_closed_or_full_streams_are_no_traceback(closed):
    line = f"'{sys.executable}' -m greybox models micro_actuator {closed}"
    done = subprocess.run(["bash", "-c", line], env=ENVIRONMENT, capture_output=True, timeout=120, check=False)
    assert b"Traceback" not in done.stderr, done.stderr.decode()
