"""Folders: the root of a project, and the template that travels with the library."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def project_root(start: Path | None = None) -> Path | None:
    """The nearest folder from ``start`` (None: the working one) upwards with ``models/`` whose files use greybox."""
    first = (start or Path.cwd()).resolve()
    return next((folder for folder in (first, *first.parents) if _is_project(folder)), None)


def template_root() -> Path:
    """The folder with the shipped ``models/`` and ``fits/``: inside the installed package, or the repository itself."""
    installed = PACKAGE / "_template"
    return installed if installed.is_dir() else PACKAGE.parent


def model_files(root: Path) -> list[Path]:
    """Files in ``models/`` of a project, in alphabetical order."""
    return [path for path in sorted((root / "models").glob("*.py")) if path.name != "__init__.py"]


def _is_project(folder: Path) -> bool:
    return any(map(_uses_greybox, model_files(folder)))


def _uses_greybox(path: Path) -> bool:
    try:
        return b"greybox" in path.read_bytes()
    except OSError:  # a file that may not be read makes no project
        return False
