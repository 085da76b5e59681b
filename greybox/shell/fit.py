"""`greybox fit`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base import ExitCode, FitError, write_file
from greybox.base.interrupts import hold_interrupts
from greybox.base.values import with_code
from greybox.shell import inputs, options
from greybox.shell.progress import report_starts, show_fit_progress, show_progress
from greybox.shell.study import Answer, Command, NextCommand, Study
from greybox.shell.terminal import write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation import Fit, Trace
    from greybox.estimation.residuals import ResidualTests
    from greybox.estimation.uncertainty import Bootstrap, Profile, ProfilePair
    from greybox.shell.answers import FitAnswer, RecordMisfit


def fit(study: Study) -> Answer:
    """Fit the parameters of MODEL to records, and validate the fit.

    Prints whether the model explains its records, the parameters with 95 % intervals, notes on their validity, and the next
    command; --details adds equations, misfits, predictions and residual tests. Writes DIR/fit.json and DIR/report.html, a
    report for the browser that draws its own figures.

    MODEL may be an FMU of FMI 2 or 3, plant.fmu: its parameters are fitted by runs of it.

    greybox fit study.toml runs a study file; --write-study writes one from these options.

    Exit code 0: the fit succeeded. 1: it did not. 2: bad input, nothing was written. 130: Ctrl-C, the best point so far
    was saved.
    """
    from greybox.base import write_json
    from greybox.base.parallel.jobs import open_workers
    from greybox.estimation.fit import fit as fit_model
    from greybox.estimation.multistart import multistart

    model = inputs.constrain(inputs.build_model(study), study)
    inputs.check_substeps(study, model)
    folder = inputs.result_folder(study, model.name)
    records, validation, _ = inputs.read_records(study, model)
    model = inputs.with_delays_of_records(model, records, study)
    quiet = inputs.read_quiet_records(study, model)
    inputs.check_skip(study, validation)
    inputs.check_prediction_steps(study, records, validation)
    silent, workers = study.silent, study.workers
    if not silent:  # notes on the fitted records stand in the result, but for JSON
        inputs.print_record_notes(*((records, validation) if study.json else (validation,)), loss=study.loss)
    profiled = inputs.check_intervals(study, model)
    given: dict[str, Any] = {
        "noise": dict(study.noise),
        "quiet": quiet,
        "validation": validation,
        "skip": study.skip,
        "beginning": study.beginning,
        "options": inputs.fit_options(study),
    }
    with open_workers(workers, study.cluster) as executor:
        if study.starts > 1:
            journal = folder / inputs.STARTS_FILE
            with show_progress(silent) as show:
                many = multistart(
                    model,
                    records,
                    starts=study.starts,
                    seed=study.seed or 0,
                    report=report_starts(model.title, show),
                    executor=executor,
                    workers=workers,
                    journal=journal,
                    time_limit=study.seconds,
                    **given,
                )
            result, interrupted = many.best, many.interrupted
            if not interrupted and len(many.start_results) == study.starts:
                journal.unlink(missing_ok=True)
        else:
            with hold_interrupts() as interrupt, show_fit_progress(model.title, silent) as report:
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
    if interrupted or result.status == "interrupted":
        older = ", those there are of an earlier fit" if (saved.parent / "report.html").exists() else ""
        failure = f"interrupted; the best point so far is in {saved} (no figures, no report{older})"
        # No line of files: the message names it.
        return Answer(answer, lambda _: saved.read_text(encoding="utf-8"), failure=failure, code=ExitCode.INTERRUPTED)
    failure = "" if result.success else f"no success: {result.solver.status_message}"
    if result.success and result.worse_than_constant:
        lost = ", ".join(result.worse_than_constant)
        failure = f"the model does not explain its records: worse than a constant in {lost}"
    return Answer(
        answer,
        next=next_command(study, result, saved),
        files=[saved],
        page=lambda: _write_page(answer, saved.parent / "report.html", study.uncounted),
        pictures=lambda: _draw_pictures(result, tests, saved.parent, study.uncounted),
        kept=f"the fit is in {saved}",
        failure=failure,
        code=ExitCode.UNSUCCESSFUL if failure else ExitCode.SUCCESS,
    )


def next_command(study: Study, result: Fit, saved: Path) -> NextCommand:
    """What a colleague would type after a fit: what is missing, or where the model goes."""
    from greybox.data.findings import RecordCode
    from greybox.estimation.findings import EstimationCode

    records = (study.model, *study.estimation)
    if not result.success or with_code(result.findings, EstimationCode.NO_FREEDOM):
        return study.then("check", *records)
    if not result.explains_records:
        # Readings that jump for one row swamp what the model lacks.
        if study.loss == "squares" and any(f.code == RecordCode.SENSOR_SPIKES for f in result.findings):
            return study.but(loss="huber").then("fit", *records)
        # A constant that ended at its bound in a bad fit is as often the sign of another optimum as of a missing effect, and so is a bad
        # fit with an effect that was added by name.
        if (study.effects or any(e.at_bound for e in result.parameters.values())) and study.starts <= 1:
            return study.but(starts=8).then("fit", *records)
        return study.then("discover", *records)
    if not result.model.has_equations:
        return study.then("compare", *records)
    return study.then("export", saved, "--to", "control", holds=options.IN_RESULT)


def _write_page(answer: FitAnswer, target: Path, skip: int) -> Path:
    from greybox.show.documents.fit import further_intervals

    return write_report(answer.fit, target, tests=answer.tests, skip=skip, intervals=tuple(further_intervals(answer)))


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
    from greybox.estimation.errors import compute_record_misfits
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


def _compute_interval(result: Fit, asked: tuple[tuple[str, ...], int]) -> Profile | ProfilePair | Bootstrap:
    """The profile of a parameter or of two together, or, without a name, a bootstrap with so many replicates."""
    import numpy as np

    from greybox.estimation.uncertainty import bootstrap, profile, profile_pair

    match asked:
        case (first, second), _:
            return profile_pair(result, first, second)
        case (name,), _:
            return profile(result, name)
        case _, replicates:
            return bootstrap(result, np.random.default_rng(BOOTSTRAP_SEED), replicates=replicates)


def _intervals(result: Fit, profiled: Iterable[str], replicates: int, share: ShareWork) -> dict[str, Any]:
    """The profiles and the bootstrap that were asked for; why there are none, where the fit has none to give."""
    intervals: dict[str, Any] = {}
    try:
        labels = list(_labels(result, profiled))
        noise, values = result.model.noise_parameters, result.model.values
        zero = dict.fromkeys(n for names in labels for n in names if n in noise and values[n] == 0)
        intervals["zero_noise"] = tuple(zero)
        asked = [names for names in labels if not zero.keys() & {*names}]
        jobs = [(names, 0) for names in asked] + [((), replicates)] * bool(replicates)
        computed = share(_compute_interval, result, jobs)
        profiles = list(zip(asked, computed, strict=False))
        intervals["profiles"] = tuple(done for names, done in profiles if len(names) == 1)
        intervals["regions"] = tuple(done for names, done in profiles if len(names) == 2)
        if replicates:
            intervals["bootstrap"] = computed[-1]
    except FitError as error:
        intervals["refusal"] = str(error)
    return intervals


def _labels(result: Fit, profiled: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """One parameter, or two of ``A:B``; one that each record has for itself is one parameter for each of them."""
    per_record = result.constraints.per_experiment
    for name in profiled:
        if name in per_record:
            yield from ((f"{name} ({title})",) for title in per_record[name])
        else:
            yield tuple(name.split(":"))


# Rows up to which the error one sample ahead is shown without being asked for: longer records would make the user wait.
UNASKED_PREDICTION_ROWS = 50000


def _scores(result: Fit, study: Study, validation: Sequence[Experiment]) -> dict[str, Any]:
    """Free run and predictions so many samples ahead; without being asked one sample, where the records are not too long."""
    from greybox.estimation.score import score_fit

    rows = sum(len(t.time) for t in result.traces) + sum(e.rows for e in validation)
    unasked = [1] if rows <= UNASKED_PREDICTION_ROWS else []
    steps = sorted({k for k in study.predict if k}) if study.predict else unasked
    if not steps or not result.success:
        return {}
    fitted, judged = score_fit(result, validation, steps=steps, skip=study.uncounted)
    return {"scores": fitted} | ({"validation_scores": judged} if judged is not None else {})


def _draw_pictures(result: Fit, tests: ResidualTests | None, folder: Path, skip: int) -> list[Path]:
    from greybox.show.documents.tables import parameters_latex
    from greybox.show.figures.pictures import draw_fit, draw_residual_tests

    figures = draw_fit(result, folder, skip=skip)
    figures += draw_residual_tests(tests, folder, title=result.model.title) if tests else []
    return [*figures, write_file(folder / "constants.tex", parameters_latex(result))]


FIT = Command(
    fit,
    "Fit a model's parameters to records.",
    (
        *(*options.FITTING, Study.estimation.but(required=True), Study.time_limit, Study.profiles, Study.bootstrap),
        Study.output.but(help="Folder for fit.json and the report. [default: results/MODEL-fit]"),
        *(*options.SHARING, *options.SHOWING, Study.silent, Study.figures),
    ),
    (
        "greybox fit micro_actuator record.csv --fix M=0.01 --fix Ra=8 --validate other.csv",
        "greybox fit my/rig.py a.csv b.csv --start K=5000 --noise x=2e-7 --output results/rig",
        "greybox fit emps record.csv --effect coulomb_friction --hold first",
    ),
    (*options.FITTING_RULES, *options.sharing(Study.starts, Study.profiles, Study.bootstrap)),
)
