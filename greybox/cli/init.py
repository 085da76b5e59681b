"""`greybox init`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def init(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder for the project; created if it does not exist.")
    ],
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing files.")] = False,
) -> None:
    """Create a project in DIR with example files: models/, fits/ and a notebook."""
    from greybox.project import write_project

    files = write_project(directory, force=force)
    typer.echo(f"{len(files)} files written to {directory}; next: cd {directory} && greybox models")
