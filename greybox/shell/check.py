"""`greybox check`."""

from __future__ import annotations

import json as json_format
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from greybox.base.errors import GreyboxError
from greybox.shell.inputs import build_model, check_substeps, constrain, fit_options, layout_of, read_records
from greybox.shell.options import Json, NoReport, check_writable, takes_study
from greybox.shell.plants import plant_kind
from greybox.shell.study import CHECK, Study, fields_of
from greybox.shell.terminal import write_report


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

    A file in the place of MODEL is looked at without a model: signals, units, rates, holes, doubtful sensors, and the columns to
    name. Nothing is written.
    """
    from greybox.base.json_shape import format_json
    from greybox.estimation.check import check as check_model
    from greybox.show.sentences.shell import report_line

    if is_record(study.model):
        if output is not None or no_report:
            flag = "--no-report" if output is None else "--output"
            raise GreyboxError(f"{flag}: no effect on a look at a file, which writes nothing; leave it out")
        look_at_files(study, json)
        return
    if not study.estimation:
        _refuse_idle(study, READING, "a check without records")
    if kind := plant_kind(study.model):
        result, folder = kind.check(study, output)
    else:
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
    saved = result.save(folder / "check.json")
    report = None if no_report else write_report(result, folder / "report.html")
    typer.echo(format_json(result.as_dict()) if json else f"{result}\n\nwritten: {saved}")
    if report and not json:
        typer.echo(report_line(report))


READING = ("columns", "headers", "sampling_time", "read_limit", "hold", "interpolation", "split_holes", "free_decay")
"""Fields that say how records are read."""


def _refuse_idle(study: Study, names: Iterable[str], what: str) -> None:
    """Options that would change nothing. Raises GreyboxError."""
    plain = Study(model=study.model)
    idle = [study.label(name) for name in names if getattr(study, name) != getattr(plain, name)]
    if idle:
        raise GreyboxError(f"{', '.join(idle)}: no effect on {what}; leave {'it' if len(idle) == 1 else 'them'} out")


def is_record(name: str) -> bool:
    """Whether a file that records are read from stands in the place of the model."""
    from greybox.data.formats import record_suffixes

    return Path(name).suffix.lower() in record_suffixes()


def look_at_files(study: Study, json: bool) -> None:
    """Print what is in the files that the command names. Raises GreyboxError."""
    from greybox.data.policy import READING_POLICY
    from greybox.data.survey import survey_file

    used = {"model", "estimation", "headers", "sampling_time", "read_limit"}
    _refuse_idle(study, (name for name in fields_of(CHECK) if name not in used), "a look at a file")
    layout = layout_of(study)
    surveys = [
        survey_file(
            file,
            names=list(study.headers) or None,
            sampling_time=study.sampling_time or None,
            reading=layout.get("reading", READING_POLICY),
        )
        for file in (Path(study.model), *study.estimation)
    ]
    data = [survey.as_dict() for survey in surveys]
    typer.echo(
        json_format.dumps(data if len(data) > 1 else data[0], indent=2) if json else "\n\n".join(map(str, surveys))
    )
