"""`greybox effects`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import completion
from greybox.cli.inputs import add_effects
from greybox.cli.options import Json, Texts
from greybox.cli.study import FIT, SPECS
from greybox.cli.study_values import parse_names
from greybox.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.effects import EffectListing

KEEP = "keep"


def effects(
    model: Annotated[
        str | None,
        typer.Argument(
            metavar="MODEL",
            autocompletion=completion.models,
            help="The model in which they look for a place: its name or its file. Without MODEL, the catalogue is listed. The word"
            " keep: the law of a discovery becomes an effect of the project.",
        ),
    ] = None,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="With keep: what the effect is called.")] = None,
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
    result: Annotated[
        Path | None,
        typer.Option(
            "--result", metavar="FILE", help="With keep: the discovery.json. [default: the newest in results/]"
        ),
    ] = None,
    json: Json = False,
) -> None:
    """List the effects of the catalogue, or where they find a place in a model.

    greybox effects keep NAME writes the law of a discovery to effects/NAME.py of the project: from then on it is a candidate
    beside those of the catalogue. Any effect of your own in effects/ is.

    Prints name, site, parameters with units, and equation of each, and why an effect has no place.
    """
    from greybox.effects import CATALOGUE, EffectListing, find_placements
    from greybox.project import find_model
    from greybox.project.effects import find_own_effects, keep_effect

    if model == KEEP:
        if name is None:
            raise GreyboxError(
                "effects keep: NAME is missing; write greybox effects keep NAME, as in greybox effects keep soft_stop"
            )
        idle = ["--effect"] * bool(effect) + ["--json"] * json
        if idle:
            raise GreyboxError(f"{', '.join(idle)}: no effect with keep, which writes one file; leave it out")
        from greybox.rendering.cli import written

        typer.echo(written([keep_effect(name, result)]))
        return
    if name is not None or result is not None:
        given = f"--result {result}" if name is None else name
        raise GreyboxError(f"{given}: no effect without keep; leave it out, or write greybox effects keep NAME")
    if effect and model is None:
        raise GreyboxError(
            f"--effect {effect[0]} has no effect without a model; write greybox effects MODEL --effect {effect[0]}"
        )
    entries = (*CATALOGUE, *find_own_effects())
    if model is None:
        listing = EffectListing("", entries)
    else:
        plant = add_effects(find_model(model), parse_names(effect))
        listing = EffectListing(plant.title, entries, tuple(find_placements(plant, entries)))
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
