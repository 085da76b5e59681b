"""A new project: the shipped models, studies and notebook, written out as files of one's own."""

from __future__ import annotations

from pathlib import Path

from greybox.base import GreyboxError, nearest, write_file
from greybox.shell.project import template_root

# Folder of a project -> where it lies beside the library.
FOLDERS = {"models": "models", "fits": "fits", "notebooks": "docs/notebooks"}
PLANTS = "plants"
# Of the studies those that show how one is written; the others are about this library, and no user's rig needs them.
STUDIES = ("__init__.py", "cascaded_tanks_base.py", "emps_dry_friction.py", "silverbox_hardening.py")


def plant_names() -> list[str]:
    """Names of the plants that a project can start from, in alphabetical order."""
    folders = (template_root() / PLANTS).iterdir()
    return sorted(folder.name.replace("_", "-") for folder in folders if (folder / "study.toml").is_file())


def write_project(directory: str | Path, *, plant: str = "", force: bool = False) -> list[Path]:
    """Write a project to start from: ``models/``, ``fits/``, ``notebooks/`` and a README, or one plant with a twin and a study file.

    Parameters
    ----------
    directory
        Folder for the project; made if it does not exist.
    plant
        One of `plant_names`: the project holds this plant alone.
    force
        Overwrite files of the template that exist already.

    Returns
    -------
    list of Path
        The files that were written.

    Raises
    ------
    GreyboxError
        For an unknown plant, or if one of the files exists and ``force`` is not given. Nothing is written then.
    """
    target = Path(directory)
    if target.exists() and not target.is_dir():
        raise GreyboxError(f"{target} is a file; give a folder for the project")
    sources = _plant_files(plant) if plant else _template_files()
    readme = (template_root() / PLANTS / f"{'plant' if plant else 'project'}_readme.md").read_text(encoding="utf-8")
    written = [target / name for name in (*sources, Path("README.md"))]
    present = [path for path in written if path.exists()]
    if present and not force:
        listed = ", ".join(str(path.relative_to(target)) for path in present[:5])
        more = f" and {len(present) - 5} more" if len(present) > 5 else ""
        raise GreyboxError(
            f"{target} already holds {listed}{more}; give another folder, or --force to overwrite these files"
        )
    for name, source in sources.items():
        write_file(target / name, source.read_bytes())
    write_file(target / "README.md", readme.format(name=target.resolve().name, model=plant.replace("-", "_")))
    return written


def _plant_files(plant: str) -> dict[Path, Path]:
    """Path inside a project -> file of the template for one plant."""
    if plant not in plant_names():
        raise GreyboxError(f"unknown plant {plant!r}; {nearest(plant, plant_names())}")
    name, root = plant.replace("-", "_"), template_root() / PLANTS
    folder = root / name
    return {
        Path("models") / f"{name}.py": folder / f"{name}.py",
        Path("twin.py"): folder / "twin.py",
        Path("rk4.py"): root / "rk4.py",
        Path("study.toml"): folder / "study.toml",
    }


def _template_files() -> dict[Path, Path]:
    """Path inside a project -> file of the template; what a run left behind does not count."""
    root = template_root()
    inside = {
        Path(name) / path.relative_to(root / folder): path
        for name, folder in FOLDERS.items()
        for path in sorted((root / folder).rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".pyc"
    }
    chosen = [Path("fits", study) for study in STUDIES]
    return {name: path for name, path in inside.items() if name.parts[0] != "fits" or name in chosen}
