"""`greybox demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from greybox.cli.exit_codes import ExitCode
from greybox.cli.exits import exit_with_error
from greybox.cli.options import Figures, Json, NoReport, check_writable
from greybox.cli.progress import show_search_progress
from greybox.cli.reporting import write_report
from greybox.errors import GreyboxError


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
    from greybox.demo import run_demo
    from greybox.rendering.cli import report_line
    from greybox.rendering.demo import demo_answer

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
