"""`greybox fleet`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from greybox.base.errors import ExitCode, GreyboxError
from greybox.shell.options import (
    Cluster,
    Fixed,
    Json,
    NoReport,
    SensorNoise,
    Start,
    Workers,
    check_writable,
    read_noise,
)
from greybox.shell.progress import show_progress
from greybox.shell.study import HoldName
from greybox.shell.terminal import Command, exit_with_error, write_report

JOURNAL = "fleet.jsonl"
"""Records that are done, of a command that was interrupted, in its output folder."""


def fleet(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Name of a model, or a model file: my/rig.py.")],
    records: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDS", help="Records, folders of records, or Parquet files of many records."),
    ],
    *,
    record: Annotated[
        str,
        typer.Option("--record", metavar="COLUMN", help="Column of a Parquet file that names the record of each row."),
    ] = "",
    fixed: Fixed,
    start: Start,
    noise: SensorNoise,
    at_rest: Annotated[
        bool, typer.Option("--at-rest", help="Every record begins in the state that the model declares.")
    ] = False,
    hold: Annotated[HoldName, typer.Option("--hold", help="How the input moves between samples.")] = HoldName.zero,
    sampling_time: Annotated[
        float | None,
        typer.Option("--sampling-time", metavar="SECONDS", help="Seconds between rows, for records without a time."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the results. [default: results/MODEL-fleet]"),
    ] = None,
    workers: Workers = 0,
    cluster: Cluster = "",
    no_report: NoReport = False,
    json: Json = False,
) -> None:
    """Fit MODEL to each record by itself: a line's test bench, a fleet of machines, a machine over years.

    Writes DIR/fleet.csv (and fleet.parquet where pyarrow is installed), a row for each record: constants with standard deviation and 95 %
    interval, misfit over noise, status, findings. DIR/fleet.json has the population of the constants, DIR/report.html shows it.

    A record that cannot be read or fitted is named with its reason, and the others are done. What is done is kept: after Ctrl-C the same
    command goes on from it.

    Exit code 0: every record has a result. 1: some have none. 2: bad input, or no record has a result. 130: Ctrl-C.
    """
    from importlib.util import find_spec

    from greybox.base.parallel.jobs import open_workers
    from greybox.estimation.options import FitOptions
    from greybox.extensions.design.command import build_plain_model
    from greybox.extensions.fleet.batch import fit_each
    from greybox.extensions.fleet.records import find_records
    from greybox.show.sentences.shell import report_line, written

    plant = build_plain_model(model, fixed, start)
    folder = check_writable(output or Path("results") / f"{plant.name}-fleet")
    references = find_records(records, record=record, hold=hold.value, sampling_time=sampling_time)
    journal = folder / JOURNAL
    with open_workers(workers, cluster) as executor, show_progress() as show:
        result = fit_each(
            plant,
            references,
            noise=read_noise(noise) or None,
            options=FitOptions(at_rest=at_rest),
            executor=executor,
            workers=workers,
            report=lambda done, total: show(f"{plant.title}: {done} of {total} records done", done / total),
            journal=journal,
        )
    if not result.left and not any(r.success for r in result.records):
        journal.unlink(missing_ok=True)
        first = result.records[0]
        raise GreyboxError(f"none of {len(result.records)} records has a result; {first.name}: {first.reason}")
    saved = [result.save(folder / "fleet.json"), result.save_table(folder / "fleet.csv")]
    if find_spec("pyarrow"):
        saved.append(result.save_table(folder / "fleet.parquet"))
    report = None if no_report else write_report(result, folder / "report.html")
    if json:
        typer.echo(saved[0].read_text(encoding="utf-8"), nl=False)
    else:
        typer.echo("\n".join([str(result), "", written(saved), *([report_line(report)] if report else [])]))
    if result.left:
        exit_with_error(
            f"interrupted; {len(result.records)} records are done, the same command goes on from them",
            ExitCode.INTERRUPTED,
        )
    journal.unlink(missing_ok=True)
    if result.without_result:
        raise typer.Exit(ExitCode.UNSUCCESSFUL)


FLEET = Command(
    fleet,
    "Fit a model to each of many records.",
    (
        "greybox fleet micro_actuator bench/ --fix M=0.01 --fix Ra=8 --noise x=2e-7",
        "greybox fleet my/rig.py bench.parquet --record serial_number --output results/bench",
    ),
)

PRINTS = {"fleet": ("greybox.extensions.fleet.result:FleetResult",)}
"""Command -> types of what it prints with ``--json``."""
