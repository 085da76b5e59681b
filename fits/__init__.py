"""Fits to copy, a file each: one question, its data, its fit and its verdict. Below: the papers, controllers, studies, benchmarks."""

from __future__ import annotations

import argparse
from pathlib import Path


def data_folder(study: str, *files: str) -> Path:
    """The folder that the command line of a study names; without it, or where it lacks a file, a usage line and exit code 2."""
    return _named(argparse.ArgumentParser(prog=f"python -m fits.{study}"), files).folder


def data_and_docs(study: str, *files: str) -> tuple[Path, Path]:
    """`data_folder`, and the folder that the study writes its page to."""
    parser = argparse.ArgumentParser(prog=f"python -m fits.{study}")
    parser.add_argument(
        "--output", metavar="DOCS", type=Path, default=Path("docs/studies"), help="folder of the page (docs/studies)"
    )
    given = _named(parser, files)
    return given.folder, given.output


def _named(parser: argparse.ArgumentParser, files: tuple[str, ...]) -> argparse.Namespace:
    parser.add_argument("folder", metavar="FOLDER", type=Path, help=f"folder with {', '.join(files)}")
    given = parser.parse_args()
    missing = [name for name in files if not (given.folder / name).is_file()]
    if missing:
        parser.error(f"{given.folder} has no {', '.join(missing)}; give the folder of these records")
    return given
