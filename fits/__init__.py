"""Studies: one question, its data, its fit and its verdict per file."""

from __future__ import annotations

import argparse
from pathlib import Path


def data_folder(study: str, *files: str) -> Path:
    """The folder that the command line of a study names; without it, or where it lacks a file, a usage line and exit code 2."""
    parser = argparse.ArgumentParser(prog=f"python -m fits.{study}")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help=f"folder with {', '.join(files)}")
    folder: Path = parser.parse_args().folder
    missing = [name for name in files if not (folder / name).is_file()]
    if missing:
        parser.error(f"{folder} has no {', '.join(missing)}; give the folder of these records")
    return folder
