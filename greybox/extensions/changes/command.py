"""`greybox changed`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base.errors import GreyboxError
from greybox.shell import inputs, options
from greybox.shell.progress import show_search_progress
from greybox.shell.study import Answer, Command, Excludes, Idle, NextCommand, Option, Study
from greybox.shell.study_values import Switch
from greybox.shell.terminal import write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation.result import Fit
    from greybox.extensions.changes.result import ChangeDetection


class ChangeStudy(Study):
    """The options of `greybox changed`."""

    # A table: an option is a row or two.
    # fmt: off
    population = Option(Switch(), "--population", "population",
        "Each NEW is another machine of the same kind: which of them falls out?")
    chart = Option(Switch(), "--chart", "chart", "Each record is one point in time, in the order of their names: when did it change?")
    no_effects = Option(Switch(), "--no-effects", "no_effects",
        "Do not look for an effect where the constants do not explain the records.")
    # fmt: on


def changed(study: ChangeStudy) -> Answer:
    """Tell what has changed in a machine since FIT, from records of today.

    The same model is fitted to NEW, and its constants are compared with those of FIT, corrected for looking at many: of a hundred
    machines that are as they were, one is called changed. Where constants alone do not explain the records, the effect that has appeared is
    looked for, as greybox discover does. The verdict is "unchanged", "changed" or "cannot tell": the records do not excite what
    could have changed. Writes DIR/changed.json and DIR/index.html, a page for the browser.

    Exit code 0: there is a verdict. 2: bad input, nothing was written.
    """
    for path in study.estimation:
        if inputs.find_result(str(path)):
            raise GreyboxError(f"{path}: a fit, and no record; FIT is the first argument, NEW what follows")
    known = inputs.load_fit_with_model(Path(study.source), study.model)
    folder = inputs.result_folder(study, known.model.name)
    result = _compare(known, study)
    saved = result.save(folder / "changed.json")
    return Answer(
        result,
        files=[saved],
        page=lambda: write_report(result, folder / "index.html"),
        kept=f"the verdict is in {saved}",
        next=_next(known, result, study),
    )


def _next(known: Fit, result: ChangeDetection, study: ChangeStudy) -> NextCommand | str:
    """What has changed is fitted anew; records that do not tell are followed by a better one."""
    from greybox.estimation.options import FitOptions
    from greybox.extensions.changes.result import ChangeVerdict

    if result.verdict is ChangeVerdict.CANNOT_TELL:
        return study.then("design", study.source, holds=options.IN_RESULT)
    if result.verdict is not ChangeVerdict.CHANGED or study.population or study.chart:
        return ""
    fixed = [f"--fix={name}={e.value:.6g}" for name, e in known.parameters.items() if e.fixed]
    effects = [f"--effect={e.name}" for e in known.model.effects]
    # The new fit begins as the old one did.
    at_rest = ["--at-rest"] if FitOptions.from_data(known.provenance.options).at_rest else []
    return study.then(
        "fit",
        *(study.model or known.model.name, *study.estimation, *effects, *fixed, *at_rest),
        holds=options.IN_RESULT,
    )


def _compare(known: Fit, study: ChangeStudy) -> ChangeDetection:
    from greybox.base.parallel.jobs import open_workers
    from greybox.data.file_kinds import list_record_files
    from greybox.data.identity import mark_fitted, refuse_repeated
    from greybox.extensions.changes.detect import detect_changes
    from greybox.extensions.changes.survey import chart_changes, survey_population

    groups = [[path] for path in study.estimation] if study.population else [study.estimation]
    records = [read_like(known, list_record_files(group), study) for group in groups]
    refuse_repeated(record for each in records for record in each)
    validation = read_like(known, study.validation, study) if study.validation else ()
    validation = mark_fitted(validation, [record for each in records for record in each])
    inputs.check_skip(study, validation)
    inputs.print_record_notes(*records, validation, loss=known.robust.name or "squares")
    if study.population:
        return survey_population(known, dict(zip(map(str, study.estimation), records, strict=True)))
    if study.chart:
        return chart_changes(known, records[0])
    with open_workers(study.workers, study.cluster) as executor, show_search_progress() as (say, report):
        return detect_changes(
            known,
            records[0],
            validation=validation,
            skip=study.skip,
            search_effects=not study.no_effects,
            executor=executor,
            workers=study.workers,
            on_message=say,
            on_refit=report,
        )


def read_like(known: Fit, files: Sequence[Path], study: Study) -> tuple[Experiment, ...]:
    """Records as those of the fit were read: with their hold, and conditions from each file. Raises GreyboxError."""
    like: dict[str, Any] = {"hold": "auto"}
    for trace in known.traces[:1]:
        like = {"hold": trace.hold, "conditions": dict.fromkeys(trace.conditions)}
    return inputs.split_as_told(study, [inputs.read_files(study, files, known.model, **like)], [files])[0]


CHANGED = Command(
    changed,
    "Tell what has changed in a machine since its fit.",
    (
        Study.source.but(help="fit.json of the machine as it was, or its folder."),
        Study.estimation.but(
            usage="NEW", help="Records of today, or folders of records: CSV, MAT, MF4, TDMS and others.", required=True
        ),
        Study.validation.but(
            help="A further record of today that an effect must explain as well; may be repeated. [default: the last of NEW]"
        ),
        *(ChangeStudy.population, ChangeStudy.chart, ChangeStudy.no_effects),
        Study.skip.but(help="Rows at the start of validation records left out."),
        *(*options.READING_LIKE, *options.SPLITTING),
        Study.sampling_time.but(help="Seconds between rows, for records without a time."),
        options.model_of("FIT"),
        Study.output.but(help="Folder for the results. [default: results/MODEL-changed]"),
        *(*options.SHARING, *options.SHOWING),
    ),
    (
        "greybox changed results/rig-fit/fit.json today.csv",
        "greybox changed results/rig-fit/fit.json today.csv --validate today2.csv --model my/rig.py",
        "greybox changed results/rig-fit/fit.json machines/* --population",
        "greybox changed results/rig-fit/fit.json months/ --chart",
    ),
    (
        Excludes(ChangeStudy.population, ChangeStudy.chart, "several machines, or one over time"),
        options.LAYOUT,
        *options.VALIDATING,
        Idle(
            (Study.validation, *options.SHARING),
            "here, where no effect is looked for",
            lambda study: study.population or study.chart or study.no_effects,
        ),
    ),
    study=ChangeStudy,
)

PRINTS = {"changed": ("greybox.extensions.changes.result:ChangeDetection",)}
"""Command -> types of what it prints with ``--json``."""
