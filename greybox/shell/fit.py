"""`greybox fit`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.base.errors import ExitCode, FitError, GreyboxError
from greybox.shell.inputs import (
    build_model,
    check_intervals,
    check_prediction_steps,
    check_skip,
    check_substeps,
    check_workers,
    constrain,
    fit_options,
    print_record_notes,
    read_quiet_records,
    read_records,
    read_time_limit,
    seed_of,
    with_delays_of_records,
)
from greybox.shell.options import (
    STARTS_FILE,
    Cluster,
    Figures,
    Json,
    NoReport,
    Silent,
    Workers,
    check_writable,
    takes_study,
)
from greybox.shell.plants import plant_kind
from greybox.shell.progress import show_fit_progress, show_progress
from greybox.shell.study import FIT, Study
from greybox.shell.terminal import exit_with_error, hold_interrupts, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation.residuals import ResidualTests
    from greybox.estimation.result import Fit
    from greybox.estimation.result_parts import Trace
    from greybox.estimation.uncertainty import Bootstrap, Profile
    from greybox.shell.answers import FitAnswer, RecordMisfit


@takes_study(FIT)
def fit(
    study: Study,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for fit.json and the report. [default: results/MODEL-fit]"
        ),
    ] = None,
    workers: Workers = 0,
    cluster: Cluster = "",
    silent: Silent = False,
    json: Json = False,
    figures: Figures = False,
    no_report: NoReport = False,
) -> None:
    """Fit the parameters of MODEL to records, and validate the fit.

    Prints the equations, the parameters with 95 % intervals, the misfit on the estimation and the validation records, and
    notes on their validity. Writes DIR/fit.json and DIR/report.html, a report for the browser that draws its own
    figures.

    MODEL may be an FMU of FMI 2 or 3, plant.fmu: its parameters are fitted by runs of it.

    greybox fit study.toml runs a study file; --write-study writes one from these options.

    Exit code 0: the fit succeeded. 1: it did not. 2: bad input, nothing was written. 130: Ctrl-C, the best point so far
    was saved.
    """
    if silent and json:
        raise GreyboxError("--quiet-output and --json contradict each other; leave out one of the two")
    if kind := plant_kind(study.model):
        kind.fit(study, output, json=json)
        return
    from greybox.base.json_file import write_json
    from greybox.base.parallel.jobs import open_workers
    from greybox.estimation.fit import fit as fit_model
    from greybox.estimation.multistart import multistart

    model = constrain(build_model(study), study)
    check_substeps(study, model)
    folder = check_writable(output or Path("results") / f"{model.name}-fit")
    records, validation = read_records(study, model)
    model = with_delays_of_records(model, records)
    quiet = read_quiet_records(study, model)
    check_skip(study, validation)
    check_prediction_steps(study, records, validation)
    shared = {"--starts N": study.starts > 1, "--profile NAME": study.profiles, "--bootstrap N": study.bootstrap}
    check_workers(workers, cluster, shared)
    if not silent:  # notes on the fitted records stand in the result, but for JSON
        print_record_notes(*((records, validation) if json else (validation,)))
    seed, profiled = seed_of(study), check_intervals(study, model)
    time_limit = read_time_limit(study)
    if study.time_limit and study.starts == 1:
        raise GreyboxError(
            f"{study.label('time_limit')} {study.time_limit:g} has no effect: there is one start; give --starts N too"
        )
    given: dict[str, Any] = {
        "noise": dict(study.noise),
        "quiet": quiet,
        "validation": validation,
        "skip": study.skip,
        "beginning": study.beginning,
        "options": fit_options(study),
    }
    with open_workers(workers, cluster) as executor:
        if study.starts > 1:
            journal = folder / STARTS_FILE
            with show_progress(silent) as show:
                many = multistart(
                    model,
                    records,
                    starts=study.starts,
                    seed=seed,
                    report=lambda done, jobs: show(f"{model.title}: {done} of {jobs} starts done", done / jobs),
                    executor=executor,
                    workers=workers,
                    journal=journal,
                    time_limit=time_limit,
                    **given,
                )
            result, interrupted = many.best, many.interrupted
            if not interrupted and len(many.start_results) == study.starts:
                journal.unlink(missing_ok=True)
        else:
            with hold_interrupts() as interrupt, show_fit_progress(model.title, interrupt, silent) as report:
                result = fit_model(model, records, report=report, **given)
            interrupted = interrupt.requested
        with hold_interrupts():
            saved = result.save(folder / "fit.json")
        tests = None if interrupted else _residual_tests(result)
        intervals: dict[str, Any] = {}
        if (profiled or study.bootstrap) and result.success and not interrupted:
            intervals = _intervals(result, profiled, study.bootstrap, _share(executor, workers))
        # Scores and remedies take as long as the fit: a quiet command, whose reader is a script, leaves them out.
        short = interrupted or (silent and not study.predict)
        answer = _answer(result, tests, study, validation, intervals, short=short)
        with hold_interrupts():
            # Once more, with what took its time: a number that is printed stands in the file.
            write_json(saved, answer)
        if json:
            typer.echo(saved.read_text(encoding="utf-8"), nl=False)
        elif not silent:
            typer.echo(str(answer))
    if interrupted or result.status == "interrupted":
        older = ", those there are of an earlier fit" if (saved.parent / "report.html").exists() else ""
        exit_with_error(
            f"interrupted; the best point so far is in {saved} (no figures, no report{older})", ExitCode.INTERRUPTED
        )
    _draw(result, tests, saved, study.uncounted, quiet=silent or json, page=not no_report, pictures=figures)
    if not result.success:
        exit_with_error(f"no success: {result.solver.status_message}", ExitCode.UNSUCCESSFUL)


def _answer(
    result: Fit,
    tests: ResidualTests | None,
    study: Study,
    validation: Sequence[Experiment],
    intervals: Mapping[str, Any],
    *,
    short: bool,
) -> FitAnswer:
    """The fit with everything that was asked for, ``intervals`` among it; ``short`` without what takes further computation."""
    from greybox.estimation.identifiability.practical import recommend_after_fit
    from greybox.shell.answers import FitAnswer

    tables: dict[str, Any] = {
        "tests": tests,
        "misfits": _misfits(result, result.traces, 0),
        "validation_misfits": _misfits(result, result.validation.traces, study.uncounted),
    }
    if short:
        return FitAnswer(result, **intervals, **tables)
    return FitAnswer(
        result, remedies=tuple(recommend_after_fit(result)), **intervals, **_scores(result, study, validation), **tables
    )


def _residual_tests(result: Fit) -> ResidualTests | None:
    """The tests of the residual; none of a fit that did not succeed, or whose run is not a free one."""
    from greybox.estimation.optimum import has_free_run
    from greybox.estimation.residuals import residual_tests

    testable = result.success and (has_free_run(result) or result.prediction.process_noise)
    return residual_tests(result) if testable else None


def _misfits(result: Fit, traces: Sequence[Trace], skip: int) -> list[RecordMisfit]:
    """The misfit of each record without its first ``skip`` rows, where there are several records."""
    from greybox.estimation.optimum import compute_record_misfits
    from greybox.shell.answers import RecordMisfit

    if len(traces) < 2:
        return []
    return [
        RecordMisfit(t.name, output, misfit)
        for t in traces
        for output, misfit in compute_record_misfits(result, t, skip).items()
    ]


ShareWork = Callable[[Callable[[Any, Any], Any], Any, Sequence[Any]], list[Any]]
"""Does ``job(common, item)`` for every item, here or in workers. Raises FitError where a job fails."""


def _share(executor: Executor | None, workers: int) -> ShareWork:
    """Where several computations run: in workers where the user asked for them, else here one after the other."""
    if executor is None and workers < 2:
        return lambda job, common, items: [job(common, item) for item in items]

    def share(job: Callable[[Any, Any], Any], common: Any, items: Sequence[Any]) -> list[Any]:
        from greybox.base.parallel.jobs import run_jobs

        results, interrupted = run_jobs(job, common, items, executor=executor, workers=workers)
        if interrupted:
            raise KeyboardInterrupt
        failed = [result.error for result in results if result is not None and result.error]
        if failed:
            raise FitError("; ".join(dict.fromkeys(failed)))
        return [result.value for result in results if result is not None]

    return share


# Seed of the bootstrap's draws: the same command prints the same intervals.
BOOTSTRAP_SEED = 0


def _compute_interval(result: Fit, asked: tuple[str, int]) -> Profile | Bootstrap:
    """The profile of a parameter, or, without a name, a bootstrap with so many replicates."""
    import numpy as np

    from greybox.estimation.uncertainty import bootstrap, profile

    name, replicates = asked
    draws = np.random.default_rng(BOOTSTRAP_SEED)
    return profile(result, name) if name else bootstrap(result, draws, replicates=replicates)


def _intervals(result: Fit, profiled: Iterable[str], replicates: int, share: ShareWork) -> dict[str, Any]:
    """The profiles and the bootstrap that were asked for; why there are none, where the fit has none to give."""
    intervals: dict[str, Any] = {}
    try:
        labels = list(_labels(result, profiled))
        zero = [n for n in labels if n in result.model.noise_parameters and result.model.values[n] == 0]
        intervals["zero_noise"] = tuple(zero)
        asked = [(name, 0) for name in labels if name not in zero]
        computed = share(_compute_interval, result, asked + [("", replicates)] * bool(replicates))
        intervals["profiles"] = tuple(computed[: len(asked)])
        if replicates:
            intervals["bootstrap"] = computed[-1]
    except FitError as error:
        intervals["refusal"] = str(error)
    return intervals


def _labels(result: Fit, names: Iterable[str]) -> Iterator[str]:
    """A parameter that each record has for itself is one parameter for each of them."""
    per_record = result.constraints.per_experiment
    for name in names:
        yield from [f"{name} ({title})" for title in per_record[name]] if name in per_record else [name]


# Rows up to which the error one sample ahead is shown without being asked for: longer records would make the user wait.
UNASKED_PREDICTION_ROWS = 50000


def _scores(result: Fit, study: Study, validation: Sequence[Experiment]) -> dict[str, Any]:
    """Free run and predictions so many samples ahead; without being asked one sample, where the records are not too long."""
    from greybox.estimation.residuals import score

    rows = sum(len(t.time) for t in result.traces) + sum(e.rows for e in validation)
    unasked = [1] if rows <= UNASKED_PREDICTION_ROWS else []
    steps = sorted({k for k in study.predict if k}) if study.predict else unasked
    if not steps or not result.success:
        return {}
    tables = {"scores": score(result, steps=steps)}
    if validation:
        tables["validation_scores"] = score(result, validation, steps=steps, skip=study.uncounted)
    return tables


def _draw(
    result: Fit, tests: ResidualTests | None, saved: Path, skip: int, *, quiet: bool, page: bool, pictures: bool
) -> None:
    """The figures as pictures and the report, as far as they are wanted, with the lines that say so."""
    from greybox.show.sentences.shell import report_line, written

    try:
        figures = _draw_pictures(result, tests, saved.parent, skip) if pictures else []
        report = write_report(result, saved.parent / "report.html", tests=tests, skip=skip) if page else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the fit is in {saved}", ExitCode.INTERRUPTED)
    if not quiet:
        typer.echo(f"\n{written([saved, *figures])}")
        if report:
            typer.echo(report_line(report))


def _draw_pictures(result: Fit, tests: ResidualTests | None, folder: Path, skip: int) -> list[Path]:
    from greybox.show.figures.pictures import draw_fit, draw_residual_tests

    figures = draw_fit(result, folder, skip=skip)
    return figures + (draw_residual_tests(tests, folder, title=result.model.title) if tests else [])
