"""`greybox check`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import Annotated

import typer

from greybox.cli.inputs import build_model, check_substeps, constrain, fit_options, read_records
from greybox.cli.options import Json, NoReport, check_writable, takes_study
from greybox.cli.reporting import write_report
from greybox.cli.study import CHECK, Study
from greybox.files import write_file


@takes_study(CHECK)
def check(
    study: Study,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for check.json and report.html. [default: results/MODEL-check]"
        ),
    ] = None,
    json: Json = False,
    no_report: NoReport = False,
) -> None:
    """Check MODEL before a fit: equations, units, integration, and which parameters can be determined.

    Prints first which combinations of parameters any record of the measured outputs can determine, which it cannot, and which
    sensor or known parameter would determine them. Then, for the records in DATA, near the start values and if the model is
    right: the expected standard deviation of each parameter, and the excitation of each input. Without DATA, the check
    simulates a record with a random input. Writes DIR/check.json and DIR/report.html.
    """
    from greybox.check import check as check_model
    from greybox.rendering.cli import report_line

    model = constrain(build_model(study), study)
    check_substeps(study, model)
    records, _ = read_records(study, model)
    folder = check_writable(output or Path("results") / f"{model.name}-check")
    result = check_model(
        model,
        records,
        noise=dict(study.noise),
        outputs=list(study.outputs) or None,
        options=fit_options(study),
    )
    text = json_format.dumps(result.as_dict(), indent=2)
    saved = write_file(folder / "check.json", text + "\n")
    report = None if no_report else write_report(result, folder / "report.html")
    typer.echo(text if json else f"{result}\n\nwritten: {saved}")
    if report and not json:
        typer.echo(report_line(report))
