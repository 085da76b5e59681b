"""A file is whole or it is the old one: full disks, killed processes, read-only files, several writers at once."""

from __future__ import annotations

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from greybox.base import files
from greybox.base.errors import GreyboxError, OutputError
from greybox.base.files import append_line, is_output_of, list_foreign, watch_replaced, write_file

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="limits and signals of POSIX")


def run_python(text: str, *arguments: object, **options: object) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-c", textwrap.dedent(text), *map(str, arguments)], text=True, **options)


def parts(folder: Path) -> list[Path]:
    return [file for file in folder.iterdir() if file.name.endswith(".part")]


def test_text_bytes_and_functions_are_written_and_folders_made(tmp_path):
    target = tmp_path / "a" / "b" / "c.bin"
    for content in ("text", b"bytes", lambda file: file.write(b"written")):
        assert write_file(target, content) == target
    assert target.read_bytes() == b"written"
    assert os.listdir(target.parent) == ["c.bin"]


@needs_posix
def test_permissions_of_the_old_file_stay_and_those_of_a_new_one_are_usual(tmp_path):
    new, usual = write_file(tmp_path / "new", "x"), tmp_path / "usual"
    usual.touch()
    assert new.stat().st_mode == usual.stat().st_mode
    new.chmod(0o640)
    write_file(new, "y")
    assert stat.S_IMODE(new.stat().st_mode) == 0o640


@needs_posix
def test_a_link_stays_a_link_and_a_device_is_written_to(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_file(tmp_path / "link", "through")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "through"
    write_file("/dev/null", "nothing")
    assert Path("/dev/null").is_char_device()


def test_a_failed_write_names_the_file_and_keeps_the_old_one(tmp_path, monkeypatch):
    target = write_file(tmp_path / "fit.json", "old")

    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OutputError, match=r"fit\.json: cannot be written \(No space left") as error:
        write_file(target, "new")
    assert isinstance(error.value, GreyboxError) and error.value.errno == errno.ENOSPC
    assert target.read_text() == "old"
    assert not parts(tmp_path)


def test_a_writer_that_fails_half_way_keeps_the_old_file(tmp_path):
    target = write_file(tmp_path / "figure.png", "old")

    def draw(file):
        file.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_file(target, draw)
    assert target.read_text() == "old" and not parts(tmp_path)


def test_text_that_is_no_unicode_and_a_folder_in_the_way_are_named(tmp_path):
    with pytest.raises(OutputError, match=r"rig\.py"):
        write_file(tmp_path / "rig.py", "name = '\udc80'")
    with pytest.raises(OutputError, match=tmp_path.name):
        write_file(tmp_path, "x")
    write_file(tmp_path / "file", "x")
    with pytest.raises(OutputError, match="inside"):
        write_file(tmp_path / "file" / "inside", "x")
    assert not parts(tmp_path)


LIMITED = """
    import resource, signal, sys
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    from greybox.base.errors import OutputError
    from greybox.base.files import append_line, write_file
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
    try:
        (append_line if sys.argv[3] == "line" else write_file)(sys.argv[1], "n" * 20_000)
    except OutputError as error:
        sys.exit(1)
"""


@needs_posix
@pytest.mark.parametrize("kind", ["file", "line"])
def test_on_a_disk_with_little_room_the_file_is_old_or_new(tmp_path, kind):
    """The size of a file is limited, which a process meets as it meets a full disk: in the middle of a write."""
    target = tmp_path / "journal.jsonl"
    for size in range(0, 28_000, 4096):
        write_file(target, "old\n")
        code = run_python(LIMITED, target, size, kind).wait()
        fits = size >= 20_000 + (5 if kind == "line" else 0)
        assert code == (0 if fits else 1)
        assert target.read_text() == (
            ("old\n" if kind == "line" else "") + "n" * 20_000 + "\n" * (kind == "line")
        ) * fits + ("old\n" * (not fits))
    assert not parts(tmp_path)


KILLED = """
    import sys
    from greybox.base.files import write_file
    print("go", flush=True)
    k = 0
    while True:
        k += 1
        write_file(sys.argv[1], (b"%09d\\n" % k) * 50_000)
"""


@pytest.mark.rest
@needs_posix
def test_a_killed_process_leaves_a_whole_file(tmp_path):
    target, rng = tmp_path / "result", np.random.default_rng(5)
    for _ in range(6):
        process = run_python(KILLED, target, stdout=subprocess.PIPE)
        assert process.stdout.readline() == "go\n"
        while not target.exists():
            time.sleep(0.01)
        time.sleep(0.2 * rng.random())
        process.send_signal(signal.SIGKILL)
        process.communicate()
        lines = target.read_text().splitlines()
        assert len(lines) == 50_000 and len(set(lines)) == 1


def test_what_a_killed_process_left_is_removed_later(tmp_path):
    old, new = tmp_path / files.PART.format("a"), tmp_path / files.PART.format("b")
    old.touch()
    new.touch()
    os.utime(old, (0, 0))
    write_file(tmp_path / "x", "x")
    assert not old.exists() and new.exists()


APPENDING = """
    import json, sys
    from greybox.base.files import append_line
    for k in range(200):
        append_line(sys.argv[1], json.dumps({"who": sys.argv[2], "k": k, "text": "x" * 5000}))
"""


def test_lines_of_several_processes_stay_whole(tmp_path):
    journal = tmp_path / "journal.jsonl"
    processes = [run_python(APPENDING, journal, who) for who in "abc"]
    assert [process.wait() for process in processes] == [0, 0, 0]
    entries = [json.loads(line) for line in journal.read_text().splitlines()]
    assert len(entries) == 600
    for who in "abc":
        assert [entry["k"] for entry in entries if entry["who"] == who] == list(range(200))


def test_a_line_after_one_that_was_cut_short_stands_alone(tmp_path):
    journal = tmp_path / "journal.jsonl"
    journal.write_bytes(b'{"key": 1}\n{"key": "cut sho')
    append_line(journal, '{"key": 2}')
    assert journal.read_text().splitlines() == ['{"key": 1}', '{"key": "cut sho', '{"key": 2}']


def test_what_held_something_else_before_is_known(tmp_path: Path) -> None:
    for name, text in {"same": "1", "other": "1", "longer": "1"}.items():
        (tmp_path / name).write_text(text)
    with watch_replaced() as written:
        for name, text in {"same": "1", "other": "2", "longer": "11", "new": "1"}.items():
            write_file(tmp_path / name, text)
        # A result that is completed replaces no older one.
        write_file(tmp_path / "new", "2")
    write_file(tmp_path / "same", "2")
    assert [path.name for path, before in written.items() if before] == ["other", "longer"]


def test_an_earlier_output_of_the_same_command_is_no_foreign_content(tmp_path: Path) -> None:
    target, memory = tmp_path / "fit.json", tmp_path / "memory"

    def run(text: str, command: str) -> list[Path]:
        with watch_replaced() as written:
            write_file(target, text)
        return list_foreign(written, command, memory)

    assert not run("1", "fit a")
    assert not run("2", "fit a") and not run("3", "fit a")
    assert run("4", "fit b") == [target]
    target.write_text("notes of my own")
    assert run("5", "fit b") == [target]
    for text in ("damaged", "", "7 7 7"):
        (entry,) = memory.iterdir()
        entry.write_text(text)
        assert run(f"after {text}", "fit b") == [target]
        assert not run("7", "fit b")


def test_commands_that_run_at_the_same_time_forget_nothing_of_each_other(tmp_path: Path) -> None:
    memory, places = tmp_path / "memory", [tmp_path / f"{k}.json" for k in range(40)]
    for place in places:
        place.write_text(place.name)
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda place: list_foreign({place: ""}, "fit a", memory), places))
    assert all(is_output_of(place, "fit a", memory) for place in places)


def test_the_files_that_were_written_last_are_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "MOST_REMEMBERED", 3)
    memory, places = tmp_path / "memory", [tmp_path / f"{k}.json" for k in range(5)]
    for place in places:
        place.write_text(place.name)
        list_foreign({place: ""}, "fit a", memory)
        for entry in memory.iterdir():  # as if a second had gone by
            os.utime(entry, ns=(entry.stat().st_atime_ns, entry.stat().st_mtime_ns - 10**9))
    assert [is_output_of(place, "fit a", memory) for place in places] == [False, False, True, True, True]
