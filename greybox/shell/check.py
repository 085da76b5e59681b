"""`greybox check`."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.shell import inputs, options
from greybox.shell.plants import find_plant_kind
from greybox.shell.study import Answer, Command, Idle, NextCommand, Study
from greybox.shell.terminal import write_report

if TYPE_CHECKING:
    from greybox.data.survey import FileSurvey


def check(study: Study) -> Answer:
    """Check MODEL before a fit: equations, units, integration, and which parameters can be determined.

    Prints how many parameters the records in DATA determine and how well, near the start values and if the model is right, and which
    sensor or known parameter would determine the others; --details adds equations, integration, excitation and effects.
    Without DATA, the check simulates a record with a random input. Writes DIR/check.json and DIR/report.html.

    A file in the place of MODEL is looked at without a model: signals, units, rates, holes, doubtful sensors, and the columns to
    name. Nothing is written.
    """
    from greybox.base import format_json
    from greybox.estimation.check import check as check_model

    if is_record(study):
        return look_at_files(study)
    model = inputs.constrain(inputs.build_model(study), study)
    inputs.check_substeps(study, model)
    records = inputs.read_records(study, model).estimation
    folder = inputs.result_folder(study, model.name)
    result = check_model(
        model, records, noise=dict(study.noise), outputs=list(study.outputs) or None, options=inputs.fit_options(study)
    )
    saved = result.save(folder / "check.json")
    return Answer(
        result,
        lambda _: format_json(result.as_dict()),
        [saved],
        lambda: write_report(result, folder / "report.html"),
        next=study.then("fit", study.model, *(study.estimation or ["RECORD.csv"])),
    )


def is_record(study: Study) -> bool:
    """Whether a file that records are read from stands in the place of the model."""
    from greybox.data.file_kinds import NO_TABLES, record_suffixes
    from greybox.shell.project import list_models

    path = Path(study.model)
    if path.suffix.lower() in record_suffixes():
        return True
    # A file of another ending may be a text, unless it is a model or has the name of one.
    may_be_model = path.suffix.lower() in NO_TABLES or find_plant_kind(study.model) is not None
    return path.is_file() and not may_be_model and all(study.model != model.name for model in list_models().models)


def look_at_files(study: Study) -> Answer:
    """What is in the files that the command names. Raises GreyboxError."""
    from greybox.data.policy import READING_POLICY
    from greybox.data.survey import survey_file
    from greybox.shell.template import plant_names
    from greybox.show.printers.text import wrap

    surveys = [
        survey_file(
            file,
            names=list(study.headers) or None,
            columns=study.columns,
            sampling_time=study.sampling_time or None,
            reading=inputs.layout_of(study).get("reading", READING_POLICY),
        )
        for file in (Path(study.model), *study.estimation)
    ]
    data = [survey.as_dict() for survey in surveys]
    shown = data if len(data) > 1 else data[0]
    text, following = "\n\n".join(map(str, surveys)), _next(study, surveys[0])
    if following is None:
        lines = wrap(f"a model to start from, PLANT: {', '.join(plant_names())}", 80, "  ")
        text = "\n".join([text, "", *lines])
    proposed = following or "greybox init my_rig --plant PLANT"
    return Answer(text, lambda _: json_format.dumps(shown, indent=2), next=proposed)


def _next(study: Study, survey: FileSurvey) -> NextCommand | None:
    """The check of a model whose signals are all in the file; None where there is no such model."""
    from greybox.shell.project import list_models

    present = {signal.name for signal in survey.signals}
    for entry in list_models().models:
        if {*(i.name for i in entry.model.inputs), *(o.name for o in entry.model.outputs)} <= present:
            return study.then("check", entry.name, study.model, *study.estimation)
    return None


USED = (*options.ESTIMATING, *options.INTEGRATING, Study.priors, Study.schedules, Study.process_noise, Study.outputs)
LOOKED_AT = (Study.model, Study.estimation, Study.columns, Study.headers, Study.sampling_time, Study.read_limit)
UNUSED = tuple(option for option in USED if option not in LOOKED_AT)

CHECK = Command(
    check,
    "Check a model before a fit: units, integration, identifiability.",
    (
        *(*USED, Study.estimation.but(help="Records; without them the model is simulated.")),
        Study.output.but(help="Folder for check.json and report.html. [default: results/MODEL-check]"),
        *options.SHOWING,
    ),
    ("greybox check micro_actuator", "greybox check micro_actuator record.csv --fix M=0.01"),
    (
        Idle(UNUSED, "on a look at a file", is_record),
        Idle((Study.output, Study.no_report), "on a look at a file, which writes nothing", is_record),
        Idle(options.READING, "on a check without records", lambda study: not (study.estimation or is_record(study))),
        *(options.LAYOUT, options.SUBSTEPS),
    ),
    lenient=True,
)
