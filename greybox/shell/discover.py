"""`greybox discover`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.base.errors import ExitCode
from greybox.base.extensions import ExtensionKind, load_extension
from greybox.shell.inputs import (
    build_model,
    check_skip,
    constrain,
    print_record_notes,
    read_quiet_records,
    read_records,
    read_time_limit,
)
from greybox.shell.options import Cluster, Figures, Json, NoReport, Workers, check_writable, takes_study
from greybox.shell.plants import PlantKind, plant_kind
from greybox.shell.progress import show_search_progress
from greybox.shell.study import DISCOVER, Study
from greybox.shell.terminal import exit_with_error, write_report

if TYPE_CHECKING:
    from greybox.discovery.result import Discovery

NO_EFFECTS = "none"
"""What ``--effects`` takes for no effect at all."""


@takes_study(DISCOVER)
def discover(
    study: Study,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the results. [default: results/MODEL-discover]"),
    ] = None,
    workers: Workers = 0,
    cluster: Cluster = "",
    json: Json = False,
    figures: Figures = False,
    no_report: NoReport = False,
) -> None:
    """Find the effect that MODEL lacks, add it, and print the errors on the validation records before and after.

    Refits the model with each effect of the catalogue, selects the effects that the ESTIMATION records require, and tests them
    on the --validate records. The verdict is "complete" if no effect is missing, "named" if the effects are established and
    only noise is left, "partly" if some effects are established and more is left, "ambiguous" if the records cannot distinguish
    effects, "unknown" if no effect of the catalogue is established (a fitted curve or a tone may then represent it). Where more
    than noise is left, smaller effects are searched for and selected on the --validate records: then report the error on a
    third record. With --laws the equation is looked for that no effect of the catalogue is. Effects in the folder effects/ of
    the project are tried beside the catalogue. Writes DIR/discovery.json, the extended model as DIR/model.py (greybox fit
    DIR/model.py ... continues with it), and DIR/report.html, a report for the browser. Every finished
    refit is stored in DIR/journal.jsonl: after Ctrl-C the same command continues from there.

    MODEL may be an FMU, plant.fmu: effects at its inputs and outputs are looked for.

    greybox discover study.toml runs a study file; --write-study writes one from these options.

    Exit code 0: there is a verdict. 2: bad input, nothing was written. 130: interrupted.
    """
    from greybox.base.parallel.jobs import open_workers
    from greybox.discovery.pipeline import discover as discover_effects
    from greybox.estimation.options import FitOptions
    from greybox.shell.own_effects import find_effect, find_own_effects

    if kind := plant_kind(study.model):
        _discover_at_plant(kind, study, output, workers, cluster, json=json, page=not no_report, pictures=figures)
        return
    model = constrain(build_model(study), study)
    folder = check_writable(output or Path("results") / f"{model.name}-discover")
    # Asked for before the search: an answer of minutes must not fail at its last file.
    write_model = load_extension(ExtensionKind.EXPORTS, "python").write
    records, validation = read_records(study, model)
    quiet = read_quiet_records(study, model, hold=study.hold)
    print_record_notes(records, validation, quiet)
    check_skip(study, validation)
    time_limit = read_time_limit(study)
    only_laws = study.candidates == (NO_EFFECTS,)
    candidates = () if only_laws else [find_effect(name) for name in study.candidates] or None
    project_effects = () if only_laws or candidates else find_own_effects()
    journal = folder / "journal.jsonl"
    try:
        with open_workers(workers, cluster) as executor, show_search_progress() as (say, report):
            result = discover_effects(
                model,
                records,
                validation=validation,
                skip=study.skip,
                beginning=study.beginning,
                noise=dict(study.noise),
                quiet=quiet,
                effects=candidates,
                without=_left_out(study),
                further=study.further,
                options=FitOptions(at_rest=study.at_rest),
                on_message=say,
                journal=journal,
                on_refit=report,
                executor=executor,
                workers=workers,
                time_limit=time_limit,
                beside=project_effects,
                laws=study.laws or only_laws,
            )
    except KeyboardInterrupt:
        kept = f"; finished refits are in {journal}, the same command continues from there" if journal.exists() else ""
        exit_with_error(f"interrupted{kept}", ExitCode.INTERRUPTED)
    _write(result, folder, write_model, json=json, page=not no_report, pictures=figures)


def _discover_at_plant(
    kind: PlantKind,
    study: Study,
    output: Path | None,
    workers: int,
    cluster: str,
    *,
    json: bool,
    page: bool,
    pictures: bool,
) -> None:
    """The same at a plant that is no model file: the answer, and the fit of the plant with the effects of the answer."""
    from greybox.base.parallel.jobs import open_workers
    from greybox.show.sentences.shell import report_line, written

    try:
        with open_workers(workers, cluster) as executor, show_search_progress() as (say, report):
            answer = kind.discover(
                study,
                output,
                _left_out(study),
                on_message=say,
                on_refit=report,
                executor=executor,
                workers=workers,
                time_limit=read_time_limit(study),
            )
    except KeyboardInterrupt:
        exit_with_error("interrupted", ExitCode.INTERRUPTED)
    folder = answer.folder
    saved = answer.discovery.save(folder / "discovery.json")
    files = [saved, answer.save()]
    typer.echo(saved.read_text(encoding="utf-8") if json else answer.text, nl=not json)
    try:
        files += _draw_pictures(answer.discovery, folder) if pictures else []
        page_file = write_report(answer.discovery, folder / "report.html") if page else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the answer is in {saved}", ExitCode.INTERRUPTED)
    if not json:
        typer.echo(f"\n{written(files)}")
        if page_file:
            typer.echo(report_line(page_file))


def _left_out(study: Study) -> tuple[str, ...]:
    """The effects that are not tried, by name and by family. Raises GreyboxError for an unknown name."""
    from greybox.discovery.candidates import family_of
    from greybox.model.effects.catalogue import effect

    relatives = [name for listed in study.without_family for name in family_of(effect(listed).name)]
    return (*study.without, *relatives)


def _write(
    result: Discovery, folder: Path, write_model: Callable[..., Path], *, json: bool, page: bool, pictures: bool
) -> None:
    from greybox.show.sentences.shell import report_line, written

    saved = result.save(folder / "discovery.json")
    typer.echo(saved.read_text(encoding="utf-8") if json else str(result), nl=not json)
    files = [saved]
    try:
        files.append(write_model(result.extended, folder / "model.py"))
        files += _draw_pictures(result, folder) if pictures else []
        report = write_report(result, folder / "report.html") if page else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the answer is in {saved}", ExitCode.INTERRUPTED)
    if not json:
        typer.echo(f"\n{written(files)}")
        if report:
            typer.echo(report_line(report))


def _draw_pictures(result: Discovery, folder: Path) -> list[Path]:
    from greybox.show.figures.pictures import draw_discovery

    return draw_discovery(result, folder)
