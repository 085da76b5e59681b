"""`greybox schema`."""

from __future__ import annotations

import json as json_format
from typing import Annotated

import typer

from greybox.cli import completion
from greybox.cli.options import Json


def schema(
    command: Annotated[
        str,
        typer.Argument(
            metavar="COMMAND", autocompletion=completion.commands, help="The command: fit, discover, changed, check ..."
        ),
    ],
    json: Json = False,
) -> None:
    """Print the JSON Schema of what COMMAND prints with --json.

    For scripts and agents: what a key means, its unit, and what may be null. What a command writes to its folder (fit.json, discovery.json,
    changed.json ...) has the same content. Draft 2020-12, whole in itself. With or without --json the output is the same.
    """
    from greybox.schemas import schema_of_command

    typer.echo(json_format.dumps(schema_of_command(command), indent=1, ensure_ascii=False))
