"""`greybox models`."""

from __future__ import annotations

from typing import Annotated

import typer

from greybox.cli import options as o
from greybox.cli.exits import print_note


def models(
    model: Annotated[
        str | None,
        typer.Argument(metavar="MODEL", help="A model to print: its name, or a file. Without it, all are listed."),
    ] = None,
    *,
    effect: o.Effects,
) -> None:
    """List the models there are, or print the equations and constants of one."""
    from greybox.model.system import unused_parameters
    from greybox.project import find_model, list_models

    if model is not None:
        one = o.change_model(find_model(model), effects=effect)
        typer.echo(str(one))
        for name in unused_parameters(one.system):
            print_note(
                f"note: parameter {name!r} is in no equation: a term is missing, or the parameter is one too many"
            )
        return
    found = list_models()
    for item in found.models:
        m = item.model
        signals = {
            "states": ", ".join(s.name for s in m.all_states),
            "inputs": ", ".join(i.name for i in m.inputs) or "none",
            "outputs": ", ".join(y.name for y in m.outputs),
        }
        typer.echo(f"{item.name}: {m.description}" if m.description else item.name)
        typer.echo("    " + "; ".join(f"{kind} {names}" for kind, names in signals.items()))
        typer.echo(f"    {item.where}")
    for problem in found.problems:
        print_note(f"warning: {problem}")
