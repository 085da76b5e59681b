"""`greybox init`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.base.errors import ExitCode, GreyboxError
from greybox.base.findings import Finding
from greybox.shell import completion
from greybox.shell.inputs import add_effects
from greybox.shell.options import Figures, Json, NoReport, Texts, check_writable
from greybox.shell.progress import show_search_progress
from greybox.shell.study import FIT, SPECS
from greybox.shell.study_values import parse_names
from greybox.shell.terminal import CommandCode, exit_with_error, print_findings, print_note, write_report

if TYPE_CHECKING:
    from greybox.model.effects.placement import EffectListing
    from greybox.model.model import Model
    from greybox.shell.project import ModelListing


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
    from greybox.shell.template import write_project

    check_writable(directory, "DIR")
    files = write_project(directory, plant=plant, force=force)
    command = "python twin.py && greybox fit study.toml" if plant else "greybox models"
    if json:
        data = {"folder": str(directory), "files": list(map(str, files)), "next": f"cd {directory} && {command}"}
        typer.echo(json_format.dumps(data, indent=2))
        return
    typer.echo(f"{len(files)} files written to {directory}; next: cd {directory} && {command}")


# `greybox demo`.


def demo(
    output: Annotated[Path, typer.Option("--output", metavar="DIR", help="Folder for records and results.")] = Path(
        "results/demo"
    ),
    open_: Annotated[bool, typer.Option("--open", help="Open the report in the browser at the end.")] = False,
    json: Json = False,
    figures: Figures = False,
    no_report: NoReport = False,
) -> None:
    """Run every step on a simulated actuator with an effect that its model lacks.

    Fits the model (its residual is about a hundred times the noise), identifies the missing effect, prints the error on a
    validation record before and after, compares the model with black-box models, and writes the state space for controller
    design. An integrator that the fits do not use simulates the actuator. Takes half a minute; see DIR/report.html.
    """
    from greybox.shell.demonstration import run_demo
    from greybox.show.sentences.shell import demo_answer, report_line

    if open_ and no_report:
        raise GreyboxError("--open and --no-report contradict each other; leave out one of the two")
    folder = check_writable(output)
    with show_search_progress() as (say, report):
        result = run_demo(folder, say=say, report=report, pictures=figures)
    if result.plain.status == "interrupted":
        exit_with_error(f"interrupted; the results so far are in {folder}", ExitCode.INTERRUPTED)
    page = None if no_report else write_report(result, folder / "report.html")
    if json:
        typer.echo((folder / "discovery.json").read_text(encoding="utf-8"), nl=False)
    else:
        typer.echo("\n\n".join([demo_answer(result, folder), *([report_line(page)] if page else [])]))
    if open_ and page:
        typer.launch(page.resolve().as_uri())
    if not result.fit.success:
        raise typer.Exit(ExitCode.UNSUCCESSFUL)


# `greybox models`.


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
    from greybox.shell.project import find_model, list_models

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
    from greybox.base.json_shape import to_json_data
    from greybox.model.equations import equations_text

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


# `greybox effects`.

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
    from greybox.model.effects.catalogue import all_effects
    from greybox.model.effects.placement import EffectListing, find_placements
    from greybox.shell.own_effects import find_own_effects, keep_effect
    from greybox.shell.project import find_model

    if model == KEEP:
        if name is None:
            raise GreyboxError(
                "effects keep: NAME is missing; write greybox effects keep NAME, as in greybox effects keep soft_stop"
            )
        idle = ["--effect"] * bool(effect) + ["--json"] * json
        if idle:
            raise GreyboxError(f"{', '.join(idle)}: no effect with keep, which writes one file; leave it out")
        from greybox.show.sentences.shell import written

        typer.echo(written([keep_effect(name, result)]))
        return
    if name is not None or result is not None:
        given = f"--result {result}" if name is None else name
        raise GreyboxError(f"{given}: no effect without keep; leave it out, or write greybox effects keep NAME")
    if effect and model is None:
        raise GreyboxError(
            f"--effect {effect[0]} has no effect without a model; write greybox effects MODEL --effect {effect[0]}"
        )
    entries = (*all_effects(), *find_own_effects())
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


# `greybox schema`.


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
    from greybox.shell.printed import schema_of_command

    typer.echo(json_format.dumps(schema_of_command(command), indent=1, ensure_ascii=False))


# `greybox extensions`.


def extensions(json: Json = False) -> None:
    """List what this package and others add to the core, and from which distribution each comes.

    An extension that cannot be loaded is listed with its reason; everything else works without it.
    """
    from greybox.base.extensions import ExtensionKind, list_extensions
    from greybox.show.sentences.shell import extensions_text

    entries = [entry for kind in ExtensionKind for entry in list_extensions(kind)]
    if json:
        shown = ("kind", "name", "place", "distribution", "version", "failure")
        rows = [{name: getattr(entry, name) for name in shown} for entry in entries]
        typer.echo(json_format.dumps({"extensions": rows}, indent=2))
        return
    typer.echo(extensions_text(entries))
