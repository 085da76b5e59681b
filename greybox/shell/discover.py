"""`greybox discover`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from greybox.base import ExitCode
from greybox.base.extensions import ExtensionKind, load_extension
from greybox.shell import inputs, options
from greybox.shell.progress import show_search_progress
from greybox.shell.study import Answer, Command, NextCommand, Study
from greybox.shell.terminal import exit_with_error, write_report

if TYPE_CHECKING:
    from greybox.discovery.result import Discovery

# What ``--effects`` takes for no effect at all.
NO_EFFECTS = "none"


def discover(study: Study) -> Answer:
    """Find the effect that MODEL lacks, add it, and print the errors on the validation records before and after.

    Refits the model with each effect of the catalogue, selects the effects that the ESTIMATION records require, and tests them
    on the --validate records. The verdict is "complete" if no effect is missing, "named" if the effects are established and
    only noise is left, "partly" if some effects are established and more is left, "ambiguous" if the records cannot distinguish
    effects, "unknown" if no effect of the catalogue is established (a fitted curve or a tone may then represent it). The
    --validate records take part in the choice: report the error on a third record (--test). With --laws the equation is looked
    for that no effect of the catalogue is. Effects in the folder effects/ of
    the project are tried beside the catalogue. Writes DIR/discovery.json, the extended model as DIR/model.py (greybox fit
    DIR/model.py ... continues with it), and DIR/report.html, a report for the browser. Every finished
    refit is stored in DIR/journal.jsonl: after Ctrl-C the same command continues from there.

    MODEL may be an FMU, plant.fmu: effects at its inputs and outputs are looked for, and fitted with it (DIR/fit.json in the place of
    DIR/model.py).

    greybox discover study.toml runs a study file; --write-study writes one from these options.

    Exit code 0: there is a verdict. 2: bad input, nothing was written. 130: interrupted.
    """
    from greybox.base.parallel.jobs import open_workers
    from greybox.discovery.candidates import family_of
    from greybox.discovery.pipeline import discover as discover_effects
    from greybox.model.effects.catalogue import effect
    from greybox.shell.own_effects import find_effect, find_own_effects

    model = inputs.constrain(inputs.build_model(study), study)
    folder = inputs.result_folder(study, model.name)
    # Asked for before the search: an answer of minutes must not fail at its last file.
    write_model = load_extension(ExtensionKind.EXPORTS, "python").write
    records, validation, test = inputs.read_records(study, model)
    quiet = inputs.read_quiet_records(study, model)
    inputs.print_record_notes(records, validation, quiet, test, loss=study.loss)
    inputs.check_skip(study, [*validation, *test])
    only_laws = study.candidates == (NO_EFFECTS,)
    relatives = [name for listed in study.without_family for name in family_of(effect(listed).name)]
    candidates = () if only_laws else [find_effect(name) for name in study.candidates] or None
    project_effects = () if only_laws or candidates else find_own_effects()
    journal = folder / "journal.jsonl"
    try:
        with open_workers(study.workers, study.cluster) as executor, show_search_progress() as (say, report):
            result = discover_effects(
                model,
                records,
                validation=validation,
                test=test,
                skip=study.skip,
                beginning=study.beginning,
                noise=dict(study.noise),
                quiet=quiet,
                effects=candidates,
                without=(*study.without, *relatives),
                further=study.further,
                options=inputs.fit_options(study),
                on_message=say,
                journal=journal,
                on_refit=report,
                executor=executor,
                workers=study.workers,
                time_limit=study.seconds,
                beside=project_effects,
                laws=study.laws or only_laws,
            )
    except KeyboardInterrupt:
        kept = f"; finished refits are in {journal}, the same command continues from there" if journal.exists() else ""
        exit_with_error(f"interrupted{kept}", ExitCode.INTERRUPTED)
    saved = result.save(folder / "discovery.json")
    # What is run from outside is no model file: what is gone on with is its fit.
    if result.best.model.has_equations:
        further = write_model(result.extended, folder / "model.py")
    else:
        further = result.best.save(folder / "fit.json")
    return _answer(result, [saved, further], _next(study, result, further))


def _next(study: Study, result: Discovery, further: Path) -> NextCommand:
    """The extended model goes on to a fit of its own; where nothing was found, the next record is designed."""
    if not result.effects:
        return study.then("design", further.parent / "discovery.json", *study.estimation, holds=options.IN_RESULT)
    if further.suffix != ".py":
        return study.then("changed", further, *study.validation, holds=options.IN_RESULT)
    return study.then("fit", further, *study.estimation, holds=options.IN_MODEL)


def _answer(result: Discovery, files: list[Path], following: NextCommand) -> Answer:
    saved = files[0]
    return Answer(
        result,
        files=files,
        page=lambda: write_report(result, saved.parent / "report.html"),
        pictures=lambda: _draw_pictures(result, saved.parent),
        kept=f"the answer is in {saved}",
        next=following,
    )


def _draw_pictures(result: Discovery, folder: Path) -> list[Path]:
    from greybox.show.figures.pictures import draw_discovery

    return draw_discovery(result, folder)


DISCOVER = Command(
    discover,
    "Find the effect that a model lacks.",
    (
        *(
            *options.ESTIMATING,
            Study.candidates,
            Study.without,
            Study.without_family,
            Study.has,
            Study.lacks,
            Study.further,
        ),
        *(Study.laws, Study.priors, Study.quiet, Study.validation, Study.test, Study.skip, Study.beginning),
        *(*options.INTEGRATING, Study.schedules, Study.common_noise, Study.loss, Study.transcription, Study.arc_length),
        Study.validation.but(
            help="A validation record, which is not fitted: another run, or the end of this one; may be repeated.",
            required=True,
        ),
        Study.estimation.but(usage="ESTIMATION", help="Records to learn from, headers 'name [unit]'.", required=True),
        Study.time_limit.but(
            help="End the search after so many seconds, with the best answer so far. The same command continues it."
        ),
        Study.output.but(help="Folder for the results. [default: results/MODEL-discover]"),
        *(*options.SHARING, *options.SHOWING, Study.figures),
    ),
    (
        "greybox discover micro_actuator train.csv --validate test.csv --fix M=0.01 --at-rest",
        "greybox discover emps train.csv --validate test.csv --effects coulomb_friction,constant_load",
    ),
    (options.LAYOUT, options.SUBSTEPS, *options.VALIDATING),
)
