"""`greybox check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from greybox.cli import options as o


def check(
    model: o.ModelName,
    data: Annotated[
        list[Path] | None, typer.Argument(metavar="DATA", help="Records; without them the model is simulated.")
    ] = None,
    *,
    fix: o.Fix,
    start: o.Start,
    free: o.Free,
    effect: o.Effects,
    noise: o.Noise,
    hold: o.Hold = o.HoldName.zero,
    at_rest: o.AtRest = False,
    column: o.Columns,
    method: o.Method = o.MethodName.automatic,
    substeps: o.Substeps = 0,
) -> None:
    """Check MODEL before a fit: equations, units, integration, and which constants the records can determine.

    Without DATA the model is excited by a random input at its start values. The expected standard deviations hold near
    those values and if the model is right.
    """
    from greybox.check import check as check_model
    from greybox.experiment import read_experiments
    from greybox.fitting import FitOptions
    from greybox.project import resolve

    plant = o.changed(resolve(model), effects=effect, fix=fix, start=start, free=free)
    columns = o.pairs("--column", column) or None
    records = read_experiments(data, plant, columns=columns, hold=hold.value) if data else ()
    choice = FitOptions(at_rest=at_rest, method=method.value, substeps=substeps)
    typer.echo(str(check_model(plant, records, noise=o.numbers("--noise", noise), options=choice)))
