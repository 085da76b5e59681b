"""`greybox models`."""

from __future__ import annotations

from typing import Annotated

import typer

from greybox.cli import completion
from greybox.cli.exits import print_findings, print_note
from greybox.cli.findings import CommandCode
from greybox.cli.inputs import add_effects
from greybox.cli.options import Texts
from greybox.cli.study import FIT, SPECS
from greybox.findings import Finding


def models(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            autocompletion=completion.models,
            help="The model to print: its name or its file. Without MODEL, all are listed.",
        ),
    ] = None,
    *,
    effect: Annotated[
        Texts,
        typer.Option(
            "--effect",
            metavar="NAME",
            default_factory=list,
            autocompletion=completion.effects,
            help=SPECS["effects"].help_for(FIT),
        ),
    ],
) -> None:
    """List the models, or print the equations and parameters of one."""
    from greybox.model.system import unused_parameters
    from greybox.project import find_model, list_models

    if model is not None:
        one = add_effects(find_model(model), effect)
        typer.echo(str(one))
        print_findings(Finding(CommandCode.UNUSED_PARAMETER, subject=name) for name in unused_parameters(one.system))
        return
    listing = list_models()
    typer.echo(str(listing))
    for problem in listing.problems:
        print_note(f"warning: {problem}")
