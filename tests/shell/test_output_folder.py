"""The folder of the results is checked before the computation, and nothing is left of the check."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from greybox.base.errors import GreyboxError
from greybox.shell.inputs import check_writable


def test_a_folder_that_can_be_made_is_not_made(tmp_path: Path):
    wanted = tmp_path / "a" / "b"
    assert check_writable(wanted) == wanted
    assert list(tmp_path.iterdir()) == []


def test_many_checks_of_one_new_folder_do_not_disturb_one_another(tmp_path: Path):
    errors: list[Exception] = []

    def check() -> None:
        for k in range(50):
            try:
                check_writable(tmp_path / f"new {k}")
                (tmp_path / f"new {k}").mkdir(exist_ok=True)
                check_writable(tmp_path / f"new {k}")
            except Exception as error:
                errors.append(error)

    threads = [threading.Thread(target=check) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors


@pytest.mark.parametrize("name", ["file", "file/below", "x" * 300])
def test_what_can_be_no_folder_is_refused(tmp_path: Path, name: str):
    (tmp_path / "file").write_text("")
    with pytest.raises(GreyboxError, match="--output"):
        check_writable(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.skipif(sys.platform != "linux", reason="a folder where nobody can write")
def test_a_folder_where_nothing_can_be_written_is_refused():
    with pytest.raises(GreyboxError, match="cannot be written to"):
        check_writable(Path("/proc/greybox"))
