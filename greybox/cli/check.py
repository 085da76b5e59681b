"""`greybox check`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from greybox.cli import constraints as c
from greybox.cli import options as o
from greybox.cli.records import SplitHoles
from greybox.cli.reporting import NoReport, report_line, write_report


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
    tie: c.Tie,
    condition: c.Condition,
    noise: o.Noise,
    outputs: Annotated[
        list[str],
        typer.Option(
            "--outputs",
            metavar="NAME",
            default_factory=list,
            help="What if only this output is measured; may be repeated.",
        ),
    ],
    hold: o.Hold = o.HoldName.zero,
    at_rest: o.AtRest = False,
    free_decay: o.FreeDecay = False,
    split_holes: SplitHoles = False,
    column: o.Columns,
    method: o.Method = o.MethodName.automatic,
    substeps: o.Substeps = 0,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for check.json and report.html. [default: results/MODEL-check]"
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON instead of text.")] = False,
    no_report: NoReport = False,
) -> None:
    """Check MODEL before a fit: equations, units, integration, and which constants can be determined.

    Says first what the measured outputs can tell at best: the combinations of constants that are determined, what stays
    open, and which sensor or known constant would close it. Then what the records in DATA tell, near the start values
    and if the model is right: the standard deviation to expect of each constant, and what the input excites. Without
    DATA the model is driven by a random input. Writes DIR/check.json and DIR/report.html.
    """
    from greybox.check import check as check_model
    from greybox.estimation import FitOptions
    from greybox.project import find_model

    plant = c.apply_priors_and_ties(
        o.change_model(find_model(model), effects=effect, fix=fix, start=start, free=free), (), tie
    )
    columns = o.parse_pairs("--column", column) or None
    o.check_substeps(plant, method, substeps)
    records, _ = c.read_records(
        condition, plant, data or (), split=split_holes, at_rest=at_rest, columns=columns, hold=hold.value,
        allow_constant_input=free_decay,
    )  # fmt: skip
    choice = FitOptions(at_rest=at_rest, method=method.value, substeps=substeps)
    folder = o.check_writable(output or Path("results") / f"{plant.name}-check")
    only = [name for text in outputs for name in text.replace(",", " ").split()] or None
    found = check_model(plant, records, noise=o.parse_numbers("--noise", noise), outputs=only, options=choice)
    text = json_format.dumps(found.as_dict(), indent=2)
    folder.mkdir(parents=True, exist_ok=True)
    saved = folder / "check.json"
    saved.write_text(text + "\n", encoding="utf-8")
    report = None if no_report else write_report(found, folder / "report.html")
    typer.echo(text if json else f"{found}\n\nwritten: {saved}")
    if report and not json:
        typer.echo(report_line(report))
