"""`greybox changed`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.base.errors import GreyboxError
from greybox.shell.inputs import check_skipped_rows, load_fit_with_model, print_record_notes, refuse_repeated_records
from greybox.shell.options import Cluster, Json, NoReport, Workers, check_writable
from greybox.shell.progress import show_search_progress
from greybox.shell.terminal import Command, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation.result import Fit
    from greybox.extensions.changes.result import ChangeDetection


def changed(
    reference: Annotated[Path, typer.Argument(metavar="FIT", help="fit.json of the machine as it was.")],
    new: Annotated[
        list[Path],
        typer.Argument(metavar="NEW", help="Records of today, or folders of records: CSV, MAT, MF4, TDMS and others."),
    ],
    *,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            "--validate",
            metavar="FILE",
            help="A further record of today that an effect must explain as well; may be repeated. [default: the last of NEW]",
        ),
    ] = None,
    population: Annotated[
        bool,
        typer.Option("--population", help="Each NEW is another machine of the same kind: which of them falls out?"),
    ] = False,
    chart: Annotated[
        bool,
        typer.Option(
            "--chart", help="Each record is one point in time, in the order of their names: when did it change?"
        ),
    ] = False,
    no_effects: Annotated[
        bool,
        typer.Option("--no-effects", help="Do not look for an effect where the constants do not explain the records."),
    ] = False,
    skip: Annotated[
        int, typer.Option("--skip", metavar="N", min=0, help="Rows at the start of validation records left out.")
    ] = 0,
    sampling_time: Annotated[
        float | None,
        typer.Option("--sampling-time", metavar="SECONDS", help="Seconds between rows, for records without a time."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option("--model", metavar="MODEL", help="The model of FIT, or its file, if it is not found by its name."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the results. [default: results/MODEL-changed]"),
    ] = None,
    workers: Workers = 0,
    cluster: Cluster = "",
    no_report: NoReport = False,
    json: Json = False,
) -> None:
    """Tell what has changed in a machine since FIT, from records of today.

    The same model is fitted to NEW, and its constants are compared with those of FIT, corrected for looking at many: of a hundred
    machines that are as they were, one is called changed. Where constants alone do not explain the records, the effect that has appeared is
    looked for, as greybox discover does. The verdict is "unchanged", "changed" or "cannot tell": the records do not excite what
    could have changed. Writes DIR/changed.json and DIR/index.html, a page for the browser.

    Exit code 0: there is a verdict. 2: bad input, nothing was written.
    """
    known = load_fit_with_model(reference, model)
    folder = check_writable(output or Path("results") / f"{known.model.name}-changed")
    if population and chart:
        raise GreyboxError("--population and --chart exclude each other: several machines, or one over time; keep one")
    if skip and not validate:
        raise GreyboxError("--skip has no effect here: it leaves out rows of validation records; add --validate FILE")
    if validate and (population or chart or no_effects):
        raise GreyboxError("--validate has no effect here: no effect is looked for; leave it out")
    if (workers > 1 or cluster) and (population or chart or no_effects):
        given = f"--cluster {cluster}" if cluster else f"--workers {workers}"
        raise GreyboxError(f"{given} has no effect here: no effect is looked for; leave it out")
    result = (
        _survey(known, new, sampling_time)
        if population
        else _chart(known, new, sampling_time)
        if chart
        else _detect(known, new, validate or [], skip, sampling_time, not no_effects, workers, cluster)
    )
    _write(result, folder, json=json, page=not no_report)


def _detect(
    known: Fit,
    new: Sequence[Path],
    validate: Sequence[Path],
    skip: int,
    sampling_time: float | None,
    search_effects: bool,
    workers: int,
    cluster: str,
) -> ChangeDetection:
    from greybox.base.parallel.jobs import open_workers
    from greybox.data.formats import list_record_files
    from greybox.extensions.changes.detect import detect_changes

    files = list_record_files(new)
    records = read_like(known, files, sampling_time)
    refuse_repeated_records(files, records)
    validation = read_like(known, validate, sampling_time) if validate else ()
    if skip:
        check_skipped_rows("--skip", skip, validation)
    print_record_notes(records, validation)
    with open_workers(workers, cluster) as executor, show_search_progress() as (say, report):
        return detect_changes(
            known,
            records,
            validation=validation,
            skip=skip,
            search_effects=search_effects,
            executor=executor,
            workers=workers,
            on_message=say,
            on_refit=report,
        )


def _survey(known: Fit, new: Sequence[Path], sampling_time: float | None) -> ChangeDetection:
    from greybox.data.formats import list_record_files
    from greybox.extensions.changes.survey import survey_population

    machines = {str(path): read_like(known, list_record_files([path]), sampling_time) for path in new}
    refuse_repeated_records(new, (record for records in machines.values() for record in records))
    print_record_notes(*machines.values())
    return survey_population(known, machines)


def _chart(known: Fit, new: Sequence[Path], sampling_time: float | None) -> ChangeDetection:
    from greybox.data.formats import list_record_files
    from greybox.extensions.changes.survey import chart_changes

    files = list_record_files(new)
    records = read_like(known, files, sampling_time)
    refuse_repeated_records(files, records)
    print_record_notes(records)
    return chart_changes(known, records)


def read_like(known: Fit, files: Sequence[Path], sampling_time: float | None) -> tuple[Experiment, ...]:
    """Records as those of the fit were read: with their hold, and conditions from each file. Raises GreyboxError."""
    from greybox.data.read import read_experiments

    first = next(iter(known.traces), None)
    layout: dict = {} if sampling_time is None else {"sampling_time": sampling_time}
    if first is not None:
        layout |= {"hold": first.hold, "conditions": dict.fromkeys(first.conditions)}
    return read_experiments(files, known.model, **layout)


def _write(result: ChangeDetection, folder: Path, *, json: bool, page: bool) -> None:
    from greybox.show.sentences.shell import report_line, written

    saved = result.save(folder / "changed.json")
    report = write_report(result, folder / "index.html") if page else None
    if json:
        typer.echo(saved.read_text(encoding="utf-8"), nl=False)
        return
    typer.echo(str(result))
    typer.echo(f"\n{written([saved])}")
    if report:
        typer.echo(report_line(report))


CHANGED = Command(
    changed,
    "Tell what has changed in a machine since its fit.",
    (
        "greybox changed results/rig-fit/fit.json today.csv",
        "greybox changed results/rig-fit/fit.json today.csv --validate today2.csv --model my/rig.py",
        "greybox changed results/rig-fit/fit.json machines/* --population",
        "greybox changed results/rig-fit/fit.json months/ --chart",
    ),
)

PRINTS = {"changed": ("greybox.extensions.changes.result:ChangeDetection",)}
"""Command -> types of what it prints with ``--json``."""
