"""`greybox compare`."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.cli import completion
from greybox.cli import constraints as c
from greybox.cli import options as o
from greybox.cli import predicted as p
from greybox.cli import searching as s
from greybox.cli.exits import INTERRUPTED, exit_with_error
from greybox.cli.progress import ShowProgress, describe_progress, share_done, show_progress
from greybox.cli.records import SplitHoles, print_record_notes
from greybox.cli.reporting import NoReport, report_line, write_report

if TYPE_CHECKING:
    from greybox.comparison import Comparison
    from greybox.comparison.compare import NamedModel
    from greybox.estimation.options import FitProgress
    from greybox.experiment import Experiment
    from greybox.findings import Finding
    from greybox.model import Model
    from greybox.result import Fit

# Time that the scan of each kind takes beside the others, as a rule.
SCAN_TIMES = {"arx": 8, "armax": 40, "output error": 33, "box-jenkins": 6, "hammerstein": 13}

Rivals = Annotated[
    str,
    typer.Option(
        "--effects",
        metavar="NAME,...",
        autocompletion=completion.effects,
        help="Also fit MODEL with each of these effects of the catalogue; A+B is one model with both.",
    ),
]


def compare(
    model: o.ModelName,
    train: Annotated[
        list[Path],
        typer.Argument(metavar="TRAIN", help="Records to fit: CSV, TSV, MAT, NPZ or Parquet, headers 'name [unit]'."),
    ],
    *,
    fix: o.Fix,
    start: o.Start,
    free: o.Free,
    effect: o.Effects,
    effects: Rivals = "",
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
        typer.Option("--validate", metavar="FILE", default_factory=list, help="A record to judge by; may be repeated."),
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
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", metavar="DIR", help="Folder for compare.json and figures. [default: results/MODEL-compare]"
        ),
    ] = None,
    silent: Annotated[bool, typer.Option("--quiet-output", "-q", help="Print nothing but errors.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON instead of text.")] = False,
    no_report: NoReport = False,
) -> None:
    """Does the physics pay? Fit MODEL and the usual black boxes to the same records, and judge them on others.

    The black boxes are ARX, ARMAX, output error, Box-Jenkins and Hammerstein models, each chosen by a scan of its own over
    orders, delays and offset, and Monte-Carlo smoothing where a record is a single step. Prints the errors of the free run
    and one sample ahead, best fit, number of constants, BIC, stability, feed-through and time, and says which is best and
    by how much. Writes DIR/compare.json, a figure for each judging record, and DIR/report.html, a page with everything.

    Exit code 0: there is a comparison. 2: bad input, nothing was written. 130: Ctrl-C, nothing was written.
    """
    from greybox.comparison.black_box_candidates import check_sampling_times
    from greybox.comparison.compare import NamedModel, compare_named
    from greybox.estimation import FitOptions
    from greybox.experiment import read_experiments
    from greybox.project import find_model

    plain = p.apply_process_noise(
        o.change_model(c.apply_schedule(find_model(model), schedule), effects=effect), process_noise
    )
    plain = o.change_model(plain, fix=fix, start=start, free=free)
    rivals = [tuple(name.strip() for name in part.split("+")) for part in effects.split(",") if part.strip()]
    plants = [c.apply_priors_and_ties(_extended(plain, names), prior, tie) for names in ((), *rivals)]
    o.check_substeps(plants[0], method, substeps)
    folder = o.check_writable(output or Path("results") / f"{plain.name}-compare")
    said, columns = o.parse_numbers("--noise", noise), o.parse_pairs("--column", column) or None
    how: dict[str, Any] = {"columns": columns, "hold": hold.value}
    records, judges = c.read_records(
        condition, plain, train, validate, split=split_holes, at_rest=at_rest, **how, allow_constant_input=free_decay
    )
    hushed = read_experiments(quiet, plain, **how, allow_constant_input=True) if quiet else ()
    o.check_skip(skip, judges)
    p.check_prediction_steps(predict, records, judges)
    check_sampling_times(records, judges, [q.name for q in plain.outputs])
    if not silent:
        print_record_notes(records, judges)
    options = FitOptions(
        at_rest=at_rest, method=method.value, substeps=substeps, loss=loss, per_experiment=c.parse_names(per_experiment),
        transcription=transcription.value, arc_length=arc_length,
    )  # fmt: skip
    seed = s.check_seed(starts, seed)
    with show_progress() as show:
        given = {"noise": said, "quiet": hushed, "options": options}
        fitted = [_fitted(plants[0], records, show, starts, seed, given)]
        for names, plant in zip(rivals, plants[1:], strict=True):
            grown = _grown(fitted[0][0], names, plants[0], show) if starts == 1 else None
            fitted.append(grown or _fitted(plant, records, show, starts, seed, given))
        black, findings = _boxes(plain, records, at_rest, show)
        show("judging")
        grey = [NamedModel(fit.model.title, fit, seconds) for fit, seconds in fitted]
        result = compare_named(
            [*grey, *black],
            judges,
            records,
            skip=skip,
            steps=[k for k in predict if k],
            options=options,
            findings=findings,
        )
    fits = None if no_report else {fit.model.title: fit for fit, _ in fitted}
    _tell(result, folder, records, judges, fits, quiet=silent, json=json)


def _extended(model: Model, names: Sequence[str]) -> Model:
    """``model`` with these effects of the catalogue."""
    from greybox.effects import effect

    for name in names:
        model = model + effect(name)
    return model


def _grown(first: Fit, names: Sequence[str], plain: Model, show: ShowProgress) -> tuple[Fit, float] | None:
    """``first`` refitted with these effects, each from where the records would show it, and the seconds it took.

    An effect's own values leave it absent, and a search from there may end anywhere. None where a refit of free runs is not what
    was asked for, or the extended model overflows from every start.
    """
    from greybox.discovery import try_effect
    from greybox.errors import DataError

    plainly = first.provenance.options.get("transcription") == "automatic" and first.solver.statistics.get(
        "free_run", True
    )
    if (
        not (first.success and plainly)
        or first.prediction.process_noise
        or first.constraints.per_experiment
        or first.robust.name
    ):
        return None
    began, fit = time.perf_counter(), first
    for name in names:
        show(f"{fit.model.title} + {name}")
        try:
            fit = try_effect(fit, name, nominal=plain).larger
        except DataError:
            return None
    return fit, time.perf_counter() - began


def scan_share(what: str, share: float, outputs: Sequence[str]) -> float:
    """Share of all scans that is done, when ``share`` of ``what`` ("armax of x") is, by the time that each kind takes as a rule."""
    kind, _, output = what.rpartition(" of ")
    kinds = list(SCAN_TIMES)
    before = sum(SCAN_TIMES[k] for k in kinds[: kinds.index(kind)])
    return (outputs.index(output) + (before + share * SCAN_TIMES[kind]) / sum(SCAN_TIMES.values())) / len(outputs)


def _fitted(
    plant: Model, records: Sequence[Experiment], show: ShowProgress, starts: int, seed: int, given: Mapping[str, Any]
) -> tuple[Fit, float]:
    """The fit, and the seconds it took."""
    from greybox.estimation import fit, multistart

    def report(progress: FitProgress) -> None:
        show(f"{plant.title}: {describe_progress(progress)}", share_done(progress))

    def tally(done: int, jobs: int) -> None:
        show(f"{plant.title}: {done} of {jobs} starts done", done / jobs)

    began = time.perf_counter()
    if starts > 1:
        result = multistart(plant, records, starts=starts, seed=seed, report=tally, **given).best
    else:
        result = fit(plant, records, report=report, **given)
    return result, time.perf_counter() - began


def _boxes(
    plain: Model, records: Sequence[Experiment], at_rest: bool, show: ShowProgress
) -> tuple[tuple[NamedModel, ...], tuple[Finding, ...]]:
    """The black boxes of every output of ``plain`` that the records measure, and what is to be said about them."""
    from greybox.comparison.black_box_candidates import fit_black_boxes

    measured = [q for q in plain.outputs if any(q.name in e.outputs for e in records)]
    outputs = [q.name for q in measured]
    return fit_black_boxes(
        records, outputs, [i.name for i in plain.inputs], at_rest=at_rest,
        units={i.name: i.unit for i in plain.inputs} | {q.name: q.unit for q in measured},
        report=lambda what, done, of: show(f"{what}: structure {done} of {of}", scan_share(what, done / of, outputs)),
    )  # fmt: skip


def _tell(
    result: Comparison,
    folder: Path,
    records: Sequence[Experiment],
    judges: Sequence[Experiment],
    fits: Mapping[str, Fit] | None,
    *,
    quiet: bool,
    json: bool,
) -> None:
    from greybox.comparison import save_comparison
    from greybox.estimation.fit import read_versions
    from greybox.experiment import collect_record_findings
    from greybox.plots import draw_comparison
    from greybox.rendering import sentences

    known = sentences(collect_record_findings([*records, *judges]))
    prints = {e.name: e.fingerprint for e in (*records, *judges)}
    saved = save_comparison(
        result, folder / "compare.json", {"data": prints, "remarks": known, "versions": read_versions()}
    )
    if json:
        typer.echo(saved.read_text(encoding="utf-8"), nl=False)
    elif not quiet:
        typer.echo(str(result))
    try:
        figures = draw_comparison(result, folder)
        report = (
            None if fits is None else write_report(result, folder / "report.html", fits=fits, data=prints, known=known)
        )
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; the comparison is in {saved}", INTERRUPTED)
    if not (quiet or json):
        typer.echo(f"\nwritten: {saved}, {', '.join(map(str, figures))}")
        if report:
            typer.echo(report_line(report))
