"""Folders: the root of a project, and the template that travels with the library."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

EFFECTS = "effects"
"""The folder of a project with effects of its own."""
PACKAGE = Path(__file__).resolve().parents[1]


def project_root(start: Path | None = None, *, named: bool = False) -> Path | None:
    """The project around a folder: the nearest folder upwards with ``models/`` whose files use greybox.

    The files of a project are run, and whoever works below a folder did not choose them. The search therefore ends at the user's
    home, at the border of the file system and at a folder of another user, and a project with files of another user is none.

    Parameters
    ----------
    start
        Where the search begins; None for the working folder.
    named
        The user named a file there, so that its project may belong to somebody else.

    Returns
    -------
    Path or None
        The root of the project; None where there is none.
    """
    for folder in _searched_folders((start or Path.cwd()).resolve(), named):
        if _is_project(folder):
            return folder if named or _belongs_to_user(folder) else None
    return None


def find_foreign_project(start: Path | None = None) -> Path | None:
    """The project around a folder (None: the working one) that is not used because of its owner; None where there is none."""
    root = project_root(start, named=True)
    return root if root is not None and root != project_root(start) else None


def template_root() -> Path:
    """The folder with the shipped ``models/`` and ``fits/``: inside the installed package, or the repository itself."""
    installed = PACKAGE / "_template"
    return installed if installed.is_dir() else PACKAGE.parent


def model_files(root: Path) -> list[Path]:
    """Files in ``models/`` of a project, in alphabetical order."""
    return [path for path in sorted((root / "models").glob("*.py")) if path.name != "__init__.py"]


def _searched_folders(first: Path, named: bool) -> Iterator[Path]:
    """``first`` and the folders above it, up to the user's home, another file system or another user's folder."""
    device, home = _device(first), _home()
    for folder in (first, *first.parents):
        if _device(folder) != device or not (named or _is_users_own(folder)):
            return
        yield folder
        if folder == home:
            return


def _belongs_to_user(root: Path) -> bool:
    """Whether everything that would be run in a project is the user's own."""
    folders = [root / "models", *(folder for folder in (root / EFFECTS,) if folder.is_dir())]
    return all(map(_is_users_own, (root, *folders, *(file for folder in folders for file in folder.glob("**/*.py")))))


def _is_users_own(path: Path) -> bool:
    """Whether a file or folder belongs to the user; with ``sudo`` also to who called it. Windows has no such owner."""
    if not hasattr(os, "geteuid"):
        return True
    users = {os.geteuid()}
    if os.geteuid() == 0 and os.environ.get("SUDO_UID", "").isdecimal():
        users.add(int(os.environ["SUDO_UID"]))
    try:
        return path.stat().st_uid in users
    except OSError:
        return False


def _device(folder: Path) -> int | None:
    try:
        return folder.stat().st_dev
    except OSError:  # a folder that is not there has nothing above it to be searched either
        return None


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except (RuntimeError, OSError):  # no HOME, and a user whom the machine does not know
        return None


def _is_project(folder: Path) -> bool:
    return any(map(_uses_greybox, model_files(folder)))


def _uses_greybox(path: Path) -> bool:
    try:
        return b"greybox" in path.read_bytes()
    except OSError:  # a file that may not be read makes no project
        return False
