"""`greybox init`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from greybox.cli.options import Json, check_writable


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
    json: Json = False,
) -> None:
    """Create a project in DIR with example files: models/, fits/ and a notebook, or one plant to start from."""
    from greybox.project import write_project

    check_writable(directory, "DIR")
    files = write_project(directory, plant=plant, force=force)
    command = "python twin.py && greybox fit study.toml" if plant else "greybox models"
    if json:
        data = {"folder": str(directory), "files": list(map(str, files)), "next": f"cd {directory} && {command}"}
        typer.echo(json_format.dumps(data, indent=2))
        return
    typer.echo(f"{len(files)} files written to {directory}; next: cd {directory} && {command}")
