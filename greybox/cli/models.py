"""`greybox models`."""

from __future__ import annotations

import json as json_format
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.cli import completion
from greybox.cli.exits import print_findings, print_note
from greybox.cli.findings import CommandCode
from greybox.cli.inputs import add_effects
from greybox.cli.options import Json, Texts
from greybox.cli.study import FIT, SPECS
from greybox.findings import Finding

if TYPE_CHECKING:
    from greybox.model import Model
    from greybox.project import ModelListing


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
    json: Json = False,
) -> None:
    """List the models, or print the equations and parameters of one."""
    from greybox.model.system import unused_parameters
    from greybox.project import find_model, list_models

    if model is not None:
        one = add_effects(find_model(model), effect)
        typer.echo(json_format.dumps(_outline(one), indent=2) if json else str(one))
        print_findings(Finding(CommandCode.UNUSED_PARAMETER, subject=name) for name in unused_parameters(one.system))
        return
    listing = list_models()
    typer.echo(json_format.dumps(_list(listing), indent=2) if json else str(listing))
    for problem in listing.problems:
        print_note(f"warning: {problem}")


def _list(listing: ModelListing) -> dict[str, Any]:
    return {
        "models": [
            {"name": e.name, "title": e.model.title, "description": e.model.description, "where": e.where}
            for e in listing.models
        ],
        "problems": list(listing.problems),
    }


def _outline(model: Model) -> dict[str, Any]:
    from greybox.model.equations import equations_text
    from greybox.result import to_json_data

    return dict(
        to_json_data(
            {
                "name": model.name,
                "title": model.title,
                "description": model.description,
                "equations": equations_text(model),
                "states": {s.name: s.unit for s in model.all_states},
                "inputs": {i.name: i.unit for i in model.inputs},
                "outputs": {o.name: o.unit for o in model.outputs},
                "parameters": {
                    q.name: {
                        "value": q.value,
                        "unit": q.unit,
                        "bounds": q.bounds,
                        "fixed": q.fixed,
                        "description": q.description,
                        "source": q.source,
                    }
                    for q in model.all_parameters
                },
            }
        )
    )
