"""`greybox fit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.cli import constraints as c
from greybox.cli import intervals as i
from greybox.cli import options as o
from greybox.cli import predicted as p
from greybox.cli import searching as s
from greybox.cli.exits import INTERRUPTED, UNSUCCESSFUL, exit_with_error
from greybox.cli.interrupts import hold_interrupts
from greybox.cli.progress import show_fit_progress
from greybox.cli.records import SplitHoles, misfit_by_record, print_record_notes
from greybox.cli.reporting import NoReport, report_line, write_report

if TYPE_CHECKING:
    from greybox.residuals import ResidualTests
    from greybox.result import Fit


def fit(
    model: o.ModelName,
    data: Annotated[
        list[Path],
        typer.Argument(metavar="DATA", help="Records to fit: CSV, TSV, MAT, NPZ or Parquet, headers 'name [unit]'."),
    ],
    *,
    fix: o.Fix,
    start: o.Start,
    free: o.Free,
    effect: o.Effects,
    prior: c.Prior,
    tie: c.Tie,
    per_experiment: c.Own,
    schedule: c.Schedule,
    condition: c.Condition,
    process_noise: p.ProcessNoise,
    noise: o.Noise,
    quiet: o.Quiet,
    validate: Annotated[
        list[Path],
        typer.Option(
            "--validate", metavar="FILE", default_factory=list, help="A record to judge the fit by; may be repeated."
        ),
    ],
    skip: Annotated[
        int,
        typer.Option("--skip", metavar="N", min=0, help="Rows at the start of --validate records that do not count."),
    ] = 0,
    hold: o.Hold = o.HoldName.zero,
    at_rest: o.AtRest = False,
    free_decay: o.FreeDecay = False,
    split_holes: SplitHoles = False,
    column: o.Columns,
    method: o.Method = o.MethodName.automatic,
    substeps: o.Substeps = 0,
    loss: c.Loss = "squares",
    transcription: s.Transcription = s.TranscriptionName.automatic,
    arc_length: s.ArcLength = 0.0,
    starts: s.Starts = 1,
    seed: s.Seed = None,
    predict: p.Predict,
    profile: i.Profile,
    bootstrap: i.Bootstrap = 0,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for fit.json and figures. [default: results/MODEL-fit]"),
    ] = None,
    silent: Annotated[bool, typer.Option("--quiet-output", "-q", help="Print nothing but errors.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the fit as JSON instead of text.")] = False,
    no_report: NoReport = False,
) -> None:
    """Fit the constants of MODEL to records, and judge the fit.

    Prints the equations, the constants with 95 % intervals, the misfit on the fitted and on the validation records, and
    what to know before trusting them. Writes DIR/fit.json, a figure for each record (PNG and SVG), and DIR/report.html: a
    page with everything, to look at in a browser.

    Exit code 0: the fit succeeded. 1: it did not. 2: bad input, nothing was written. 130: Ctrl-C, the best point so far
    was saved.
    """
    from greybox.estimation import FitOptions
    from greybox.estimation import fit as fit_model
    from greybox.experiment import read_experiments
    from greybox.project import find_model

    plant = p.apply_process_noise(
        o.change_model(c.apply_schedule(find_model(model), schedule), effects=effect), process_noise
    )
    plant = o.change_model(plant, fix=fix, start=start, free=free)
    plant = c.apply_priors_and_ties(plant, prior, tie)
    o.check_substeps(plant, method, substeps)
    folder = o.check_writable(output or Path("results") / f"{plant.name}-fit")
    said, columns = o.parse_numbers("--noise", noise), o.parse_pairs("--column", column) or None
    records, judges = c.read_records(
        condition, plant, data, validate, split=split_holes, at_rest=at_rest, columns=columns, hold=hold.value,
        allow_constant_input=free_decay,
    )  # fmt: skip
    hushed = read_experiments(quiet, plant, columns=columns, allow_constant_input=True) if quiet else ()
    o.check_skip(skip, judges)
    p.check_prediction_steps(predict, records, judges)
    if not silent:  # those of the fitted records stand in the result, but for JSON
        print_record_notes(*((records, judges) if json else (judges,)))
    choice = FitOptions(
        at_rest=at_rest, method=method.value, substeps=substeps, loss=loss, per_experiment=c.parse_names(per_experiment),
        transcription=transcription.value, arc_length=arc_length,
    )  # fmt: skip
    seed, profiled = s.check_seed(starts, seed), i.check_intervals(plant, profile, bootstrap)
    given: dict[str, Any] = {"noise": said, "quiet": hushed, "validation": judges, "skip": skip, "options": choice}
    if starts > 1:
        many = s.fit_from_many_starts(plant, records, starts, seed, **given)
        result, interrupted = many.best, many.interrupted
    else:
        with hold_interrupts() as interrupt, show_fit_progress(plant.title, interrupt) as report:
            result = fit_model(plant, records, report=report, **given)
        interrupted = interrupt.asked
    with hold_interrupts():
        saved = result.save(folder / "fit.json")
    tests = None if interrupted else _tested(result)
    more = (
        []
        if interrupted or silent or json
        else [*i.describe_remedies(result), *i.further_intervals(result, profiled, bootstrap)]
    )
    ahead = [] if interrupted or silent or json else p.prediction_table(result, judges, predict, skip)
    _tell(result, tests, [*more, *ahead], saved, skip, quiet=silent, json=json)
    if interrupted or result.status == "interrupted":
        older = ", those there are of an earlier fit" if (saved.parent / "report.html").exists() else ""
        exit_with_error(f"interrupted; the best point so far is in {saved} (no figures, no report{older})", INTERRUPTED)
    _draw(result, tests, saved, skip, quiet=silent or json, page=not no_report)
    if not result.success:
        exit_with_error(f"no success: {result.solver.status_message}", UNSUCCESSFUL)


def _tell(
    result: Fit, tests: ResidualTests | None, ahead: list[str], saved: Path, skip: int, *, quiet: bool, json: bool
) -> None:
    if json:
        typer.echo(saved.read_text(encoding="utf-8"), nl=False)
    elif not quiet:
        said = [
            "",
            "residual tests (each alone raises a false alarm, p below 0.01, in one fit of a hundred)",
            str(tests),
        ]
        typer.echo(
            "\n".join(
                [
                    result.provenance.equations,
                    "",
                    str(result),
                    *ahead,
                    *(said if tests else []),
                    *misfit_by_record(result, skip),
                ]
            )
        )


def _tested(result: Fit) -> ResidualTests | None:
    """The tests of the residual; none of a fit that did not succeed, or whose run is not a free one."""
    from greybox.estimation.restore import has_free_run
    from greybox.residuals import residual_tests

    return (
        residual_tests(result) if result.success and (has_free_run(result) or result.prediction.process_noise) else None
    )


def _draw(result: Fit, tests: ResidualTests | None, saved: Path, skip: int, *, quiet: bool, page: bool) -> None:
    from greybox.plots import draw_fit, draw_residual_tests

    try:
        figures = draw_fit(result, saved.parent, skip=skip)
        figures += draw_residual_tests(tests, saved.parent, title=result.model.title) if tests else []
        report = write_report(result, saved.parent / "report.html", tests=tests, skip=skip) if page else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the fit is in {saved}", INTERRUPTED)
    if not quiet:
        typer.echo(f"\nwritten: {saved}, {', '.join(map(str, figures))}")
        if report:
            typer.echo(report_line(report))
