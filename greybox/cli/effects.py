"""`greybox effects`."""

from __future__ import annotations

import json as json_format
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import completion
from greybox.cli.inputs import add_effects
from greybox.cli.options import Json, Texts
from greybox.cli.study import FIT, SPECS

if TYPE_CHECKING:
    from greybox.effects import EffectListing


def effects(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            autocompletion=completion.models,
            help="The model in which they look for a place: its name or its file. Without MODEL, the catalogue is listed.",
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
    """List the effects of the catalogue, or where they find a place in a model.

    Prints name, site, parameters with units, and equation of each, and why an effect has no place.
    """
    from greybox.effects import CATALOGUE, EffectListing, find_placements
    from greybox.project import find_model

    if model is None:
        listing = EffectListing("", CATALOGUE)
    else:
        plant = add_effects(find_model(model), effect)
        listing = EffectListing(plant.title, CATALOGUE, tuple(find_placements(plant, CATALOGUE)))
    typer.echo(json_format.dumps(_to_data(listing), indent=2) if json else str(listing))


def _to_data(listing: EffectListing) -> list[dict[str, object]]:
    if not listing.model:
        return [
            {
                "name": e.name,
                "site": e.site,
                "equation": e.equation,
                "parameters": {q.name: q.unit for q in e.parameters},
            }
            for e in listing.entries
        ]
    return [
        {
            "name": p.name,
            "site": p.site,
            "equation": p.effect.equation if p.effect else "",
            "parameters": {q.name: q.unit for q in p.parameters},
            "reason": p.reason,
        }
        for p in listing.placements
    ]
