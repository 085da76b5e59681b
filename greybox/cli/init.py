"""`greybox init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def init(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the project; made if it is not there.")],
    force: Annotated[
        bool, typer.Option("--force", help="Overwrite files of the template that are there already.")
    ] = False,
) -> None:
    """Write a project into DIR: models/, fits/ and a notebook to start from, as files of your own."""
    from greybox.project import write_project

    files = write_project(directory, force=force)
    typer.echo(f"{len(files)} files written to {directory}; next: cd {directory} && greybox models")
