"""`greybox demo`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import options as o
from greybox.cli.exits import INTERRUPTED, UNSUCCESSFUL, exit_with_error
from greybox.cli.progress import show_search_progress
from greybox.cli.reporting import NoReport, report_line, write_report
from greybox.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.demo import Demo


def demo(
    output: Annotated[
        Path, typer.Option("--output", metavar="DIR", help="Folder for records, results and figures.")
    ] = Path("results/demo"),
    open_: Annotated[bool, typer.Option("--open", help="Show the report in the browser at the end.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the discovery as JSON instead of text.")] = False,
    no_report: NoReport = False,
) -> None:
    """The whole story on a simulated actuator that hides an effect from its model.

    Fits the model (it misses the record by a hundred times the noise), finds and names what it lacks, shows the gap before and
    after on a record that was not used, puts black-box models beside it, and writes the state space for a controller design.
    The rig is simulated by an integrator that the fits do not use. Takes half a minute; the story is in DIR/report.html.
    """
    from greybox.demo import run_demo as run

    if open_ and no_report:
        raise GreyboxError("--open shows the report, which --no-report leaves out; leave out one of the two")
    folder = o.check_writable(output)
    with show_search_progress() as (say, report):
        found = run(folder, say=say, report=report)
    if found.plain.status == "interrupted":
        exit_with_error(f"interrupted; what was done so far is in {folder}", INTERRUPTED)
    page = None if no_report else write_report(found, folder / "report.html")
    if json:
        typer.echo((folder / "discovery.json").read_text(encoding="utf-8"), nl=False)
    else:
        typer.echo("\n\n".join([_told(found, folder), *([report_line(page)] if page else [])]))
    if open_ and page:
        typer.launch(page.resolve().as_uri())
    if not found.fit.success:
        raise typer.Exit(UNSUCCESSFUL)


def _told(found: Demo, folder: Path) -> str:
    from greybox.demo import KNOWN, MODEL, NOISE

    first, second = found.records
    known = " ".join(f"--fix {name}={found.fit.parameters[name].value:g}" for name in KNOWN)
    noise = " ".join(f"--noise {name}={std:g}" for name, std in NOISE.items())
    pair = f"{first} --validate {second} {known} {noise} --at-rest"
    return "\n".join([
        "", found.fit.provenance.equations, "", str(found), "",
        f"{found.seconds:.1f} s; everything is in {folder}:",
        *(f"  {path.name:20s} {what}" for path, what in found.files.items()),
        "", "the same on these records, step by step:",
        f"  greybox fit {MODEL} {pair}",
        f"  greybox discover {MODEL} {pair}",
        f"  greybox export {folder / 'fit.json'} --to control",
    ])  # fmt: skip
