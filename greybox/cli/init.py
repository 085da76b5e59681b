"""`greybox init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def init(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the project; created if it does not exist.")
    ],
    plant: Annotated[
        str,
        typer.Option(
            "--plant",
            metavar="NAME",
            help="Start from one plant with a simulated twin and a study file: circuit, cylinder, rotary-drive, stage, tanks, "
            "thermal or two-mass.",
        ),
    ] = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Create a project in DIR with example files: models/, fits/ and a notebook, or one plant to start from."""
    from greybox.project import write_project

    files = write_project(directory, plant=plant, force=force)
    command = "python twin.py && greybox fit study.toml" if plant else "greybox models"
    typer.echo(f"{len(files)} files written to {directory}; next: cd {directory} && {command}")
