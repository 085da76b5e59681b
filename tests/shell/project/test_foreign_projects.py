"""Whose files run: those of the user's own project, and those that the user names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from greybox.base.errors import ModelError
from greybox.shell import project as folders
from greybox.shell.project import find_model, list_models, project_root
from tests.shell.project.test_outline import TRAP

SUPERUSER = hasattr(os, "geteuid") and os.geteuid() == 0
needs_superuser = pytest.mark.skipif(not SUPERUSER, reason="only the superuser can give files away")
STRANGER = 12345


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of a stranger with models that leave a file when they run, and below it the user's working folder."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "trap.py").write_text(TRAP)
    (tmp_path / "work" / "below").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "work" / "below")
    yield tmp_path
    assert not list(tmp_path.rglob("ran"))


def give_away(*paths: Path) -> None:
    for path in paths:
        os.chown(path, STRANGER, STRANGER)


@needs_superuser
@pytest.mark.parametrize("given", ["", "models", "models/trap.py"])
def test_a_project_of_another_user_is_not_run_and_that_is_said(place: Path, given: str):
    assert project_root() == place
    give_away(place / given)
    assert project_root() is None
    assert "micro_actuator" in {entry.name for entry in list_models().models}
    (problem,) = list_models().problems
    assert str(place) in problem and "another user" in problem
    with pytest.raises(ModelError, match="belongs to another user"):
        find_model("trap")


@needs_superuser
def test_the_search_ends_at_a_folder_of_another_user(place: Path):
    give_away(place / "work")
    assert project_root() is None


def test_the_search_ends_at_the_home_folder(place: Path, monkeypatch: pytest.MonkeyPatch):
    assert project_root() == place
    monkeypatch.setenv("HOME", str(place / "work"))
    monkeypatch.setenv("USERPROFILE", str(place / "work"))
    assert project_root() is None
    monkeypatch.setenv("HOME", str(place))
    monkeypatch.setenv("USERPROFILE", str(place))
    assert project_root() == place


def test_the_search_ends_at_the_border_of_the_file_system(place: Path, monkeypatch: pytest.MonkeyPatch):
    device = folders._device
    monkeypatch.setattr(folders, "_device", lambda folder: -1 if folder == place else device(folder))
    assert project_root() is None


def test_a_user_without_home_has_projects_too(place: Path, monkeypatch: pytest.MonkeyPatch):
    def unknown(*_):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(folders.Path, "home", unknown)
    assert project_root() == place


@needs_superuser
def test_who_calls_sudo_has_the_projects_of_both(place: Path, monkeypatch: pytest.MonkeyPatch):
    give_away(*place.rglob("*"), place)
    assert project_root() is None
    monkeypatch.setenv("SUDO_UID", str(STRANGER))
    assert project_root() == place
