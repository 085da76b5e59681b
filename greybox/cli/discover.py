"""`greybox discover`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.cli import completion
from greybox.cli import constraints as c
from greybox.cli import options as o
from greybox.cli.exits import INTERRUPTED, exit_with_error
from greybox.cli.progress import show_search_progress
from greybox.cli.records import SplitHoles, print_record_notes
from greybox.cli.reporting import NoReport, report_line, write_report

if TYPE_CHECKING:
    from greybox.discovery import Discovery


def discover(
    model: o.ModelName,
    estimation: Annotated[
        list[Path], typer.Argument(metavar="ESTIMATION", help="Records to learn from, headers 'name [unit]'.")
    ],
    *,
    validate: Annotated[
        list[Path],
        typer.Option("--validate", metavar="FILE", default_factory=list, help="A record to judge by; may be repeated."),
    ],
    fix: o.Fix,
    start: o.Start,
    free: o.Free,
    condition: c.Condition,
    noise: o.Noise,
    quiet: o.Quiet,
    hold: o.Hold = o.HoldName.zero,
    at_rest: o.AtRest = False,
    split_holes: SplitHoles = False,
    column: o.Columns,
    effects: Annotated[
        str,
        typer.Option(
            "--effects",
            metavar="NAME,...",
            autocompletion=completion.effects,
            help="Only these effects of the catalogue. [default: all]",
        ),
    ] = "",
    further: Annotated[
        bool,
        typer.Option(
            "--further",
            help="Go on after the answer: effects that take a share of what is left, however small. For measured records, which"
            " hardly ever reach the noise.",
        ),
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for what is found. [default: results/MODEL-discover]"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the discovery as JSON instead of text.")] = False,
    no_report: NoReport = False,
) -> None:
    """Find which effect MODEL lacks, name it, add it, and show the gap shrink on records not used for it.

    Refits the model with each effect of the catalogue, keeps what the ESTIMATION records demand, and judges it on the
    --validate records. Says "complete" when nothing is missing, "ambiguous" when the records cannot tell, "unknown" when
    the catalogue does not explain what is missing (a fitted curve, or a tone, stands in for it). --further looks for what
    comes after the answer and chooses it by the --validate records: quote the misfit on a third record then. Writes
    DIR/discovery.json, the extended model as DIR/model.py (greybox fit DIR/model.py ... goes on with it), figures as PNG
    and SVG, and DIR/report.html, a page with the whole story. Every finished refit is kept in DIR/journal.jsonl: after
    Ctrl-C the same command goes on where it was.

    Exit code 0: there is an answer. 2: bad input, nothing was written. 130: interrupted.
    """
    from greybox.discovery import discover as find
    from greybox.discovery import refine
    from greybox.effects import effect
    from greybox.estimation import FitOptions
    from greybox.experiment import read_experiments
    from greybox.project import find_model

    plant = o.change_model(find_model(model), fix=fix, start=start, free=free)
    folder = o.check_writable(output or Path("results") / f"{plant.name}-discover")
    said, columns = o.parse_numbers("--noise", noise), o.parse_pairs("--column", column) or None
    records, judges = c.read_records(
        condition, plant, estimation, validate, split=split_holes, at_rest=at_rest, columns=columns, hold=hold.value
    )
    silent = (
        read_experiments(quiet, plant, columns=columns, hold=hold.value, allow_constant_input=True) if quiet else ()
    )
    print_record_notes(records, judges, silent)
    chosen = [effect(name.strip()) for name in effects.split(",") if name.strip()] or None
    journal = folder / "journal.jsonl"
    try:
        with show_search_progress() as (say, report):
            found = find(
                plant, records, validation=judges, noise=said, quiet=silent, effects=chosen,
                options=FitOptions(at_rest=at_rest), say=say, journal=journal, report=report,
            )  # fmt: skip
            if further:
                refinement = refine(
                    found.best, judges, plain=plant, effects=chosen, say=say, journal=journal, report=report
                )
                found = replace(found, refinement=refinement)
    except KeyboardInterrupt:
        kept = f"; finished refits are in {journal}, the same command goes on from there" if journal.exists() else ""
        exit_with_error(f"interrupted{kept}", INTERRUPTED)
    _write(found, folder, json=json, page=not no_report)


def _write(found: Discovery, folder: Path, *, json: bool, page: bool) -> None:
    from greybox.export import to_python
    from greybox.plots import draw_discovery

    saved = found.save(folder / "discovery.json")
    typer.echo(saved.read_text(encoding="utf-8") if json else str(found), nl=not json)
    files = [saved]
    try:
        files.append(to_python(found.extended, folder / "model.py"))
        files += draw_discovery(found, folder)
        report = write_report(found, folder / "report.html") if page else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the answer is in {saved}", INTERRUPTED)
    if not json:
        typer.echo(f"\nwritten: {', '.join(map(str, files))}")
        if report:
            typer.echo(report_line(report))
