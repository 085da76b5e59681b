"""`greybox design`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.base.errors import DataError, ExitCode, GreyboxError, ModelError
from greybox.shell import completion
from greybox.shell.inputs import load_fit_with_model, parse_limits
from greybox.shell.options import (
    Cluster,
    Fixed,
    Json,
    Limits,
    NoReport,
    Rates,
    SensorNoise,
    Start,
    Texts,
    Workers,
    check_writable,
    read_noise,
    repeated,
)
from greybox.shell.study import HoldName
from greybox.shell.study_values import Numbers, parse_names
from greybox.shell.terminal import Command, exit_with_error, print_note, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation.options import FitOptions
    from greybox.estimation.result import Fit
    from greybox.model.model import Model


class GoalChoice(StrEnum):
    """What the record is to bring."""

    precision = "precision"
    discrimination = "discrimination"
    detection = "detection"


class CriterionChoice(StrEnum):
    """What of the covariance is made small."""

    D = "D"
    A = "A"
    E = "E"


def design(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="fit.json, discovery.json, or a model (its name or file) of which nothing was measured yet.",
        ),
    ],
    data: Annotated[
        list[Path] | None,
        typer.Argument(metavar="DATA", help="Records taken so far: needed with discovery.json, fitted with a model."),
    ] = None,
    *,
    goal: Annotated[
        GoalChoice,
        typer.Option(
            "--goal",
            help="precision: narrow intervals. discrimination: tell explanations apart. detection: effects that may hide.",
        ),
    ] = GoalChoice.precision,
    criterion: Annotated[
        CriterionChoice,
        typer.Option(
            "--criterion", help="For precision: D volume of the region, A mean variance, E worst combination."
        ),
    ] = CriterionChoice.D,
    limit: Limits,
    rate: Rates,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="SECONDS", help="Duration of the record. [default: as measured]"),
    ] = None,
    sampling_time: Annotated[
        float | None,
        typer.Option("--sampling-time", metavar="SECONDS", help="Seconds between rows. [default: as measured]"),
    ] = None,
    constant: Annotated[
        Texts,
        repeated(
            "--constant",
            metavar="NAME",
            text="For precision: a parameter that counts; may be repeated. [default: all]",
        ),
    ],
    rival: Annotated[
        Texts,
        repeated(
            "--rival",
            metavar="EFFECT[+EFFECT]",
            text="For discrimination: effects of the model that are another explanation; none is the plain model.",
        ),
    ],
    effect: Annotated[
        Texts,
        repeated(
            "--effect",
            metavar="NAME",
            complete=completion.effects,
            text="For detection: an effect that may hide; may be repeated. [default: all that have a place]",
        ),
    ],
    noise: SensorNoise,
    sensor: Annotated[
        Texts,
        repeated(
            "--sensor",
            metavar="OUTPUT=STD",
            text="A sensor that could be added, with the standard deviation of its noise.",
        ),
    ],
    hold: Annotated[
        HoldName,
        typer.Option("--hold", help="The generator between samples: zero holds, first and band-limited are smooth."),
    ] = HoldName.zero,
    fixed: Fixed,
    start: Start,
    at_rest: Annotated[
        bool, typer.Option("--at-rest", help="Records begin at the initial state of the model. [default: as fitted]")
    ] = False,
    model: Annotated[
        str | None,
        typer.Option(
            "--model", metavar="MODEL", help="The model of SOURCE, or its file, if it is not found by its name."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the results. [default: results/MODEL-design]"),
    ] = None,
    no_report: NoReport = False,
    json: Json = False,
) -> None:
    """Design the next record: the input, within the limits of the rig, that brings most.

    Tries sweeps, steps, PRBS and multisines at the largest amplitude that keeps every limit, under every explanation and for what is
    not known of the parameters, and improves the best one sample by sample. Writes DIR/input.csv, which greybox simulate and a rig can
    play, DIR/design.json and DIR/report.html.

    Exit code 0: done. 2: bad input, or limits that cannot be met; nothing was written.
    """
    from greybox.base.json_shape import format_json, to_json_data
    from greybox.estimation.result import Fit
    from greybox.extensions.design.next_record import design as design_record

    if effect and goal is not GoalChoice.detection:
        raise GreyboxError("--effect has no effect with this goal: it names what may hide; add --goal detection")
    precise = [f"--criterion {criterion}"] * (criterion is not CriterionChoice.D) + [
        f"--constant {c}" for c in constant
    ]
    if precise and goal is not GoalChoice.precision:
        raise GreyboxError(
            f"{precise[0]} has no effect with --goal {goal}: it is for precision; leave out one of the two"
        )
    known, plain, rivals = read_source(source, data or [], model, fixed, start, noise, at_rest, sampling_time)
    name = (known.model if isinstance(known, Fit) else known).name
    folder = check_writable(output or Path("results") / f"{name}-design")
    result = design_record(
        known,
        limits=parse_limits("--limit", limit, rate),
        duration=duration,
        sampling_time=sampling_time,
        goal=goal.value,
        criterion=criterion.value,
        constants=constant,
        rivals=[*rivals, *rival],
        plain=plain,
        effects=parse_names(effect),
        noise=read_noise(noise),
        sensors=read_noise(sensor, "--sensor"),
        hold=hold.value,
        options=_options(at_rest) if at_rest else None,  # None: those of the fit
    )
    written = result.save(folder)
    report = None if no_report else write_report(result, folder / "report.html")
    if json:
        typer.echo(format_json(to_json_data(result)))
        return
    from greybox.show.sentences.shell import report_line
    from greybox.show.sentences.shell import written as written_line

    lines = [str(result), "", written_line([folder / "input.csv", written])]
    typer.echo("\n".join([*lines, *([report_line(report)] if report else [])]))


def read_source(
    source: str,
    data: Sequence[Path],
    model: str | None,
    fixed: Sequence[str],
    start: Sequence[str],
    noise: list[str],
    at_rest: bool,
    sampling_time: float | None = None,
) -> tuple[Model | Fit, Fit | None, list[str]]:
    """The best explanation, the fit of the plain model where it is another one, and the rivals by their effects. Raises GreyboxError."""
    if source.endswith(".json"):
        kind = _kind_of(Path(source))
        if kind == "fit":
            if data or fixed or start:
                raise GreyboxError(
                    f"{source}: a fit knows its records and parameters; leave out DATA, --fix and --start"
                )
            return load_fit_with_model(Path(source), model), None, []
        if fixed or start:
            raise GreyboxError(f"{source}: a discovery knows its parameters; leave out --fix and --start")
        return _from_discovery(Path(source), data, model)
    if model is not None:
        raise GreyboxError(f"--model {model}: the model is {source} already; leave out one of the two")
    plant = build_plain_model(source, fixed, start)
    if not data:
        return plant, None, []
    records = read_data(data, plant, sampling_time)
    levels = read_noise(noise)
    return _fit(plant, records, levels, _options(at_rest)), None, []


def build_plain_model(name: str, fixed: Sequence[str], start: Sequence[str]) -> Model:
    """The model with parameters fixed and started. Raises GreyboxError."""
    from greybox.shell.project import find_model

    known = Numbers(bare="as declared").from_option("--fix", fixed)
    values = {n: v for n, v in known.items() if v is not None}
    started = Numbers().from_option("--start", start)
    both = sorted(values.keys() & started.keys())
    if both:
        raise GreyboxError(f"{', '.join(both)}: --fix and --start contradict each other; keep one")
    return find_model(name).start(**started).fix(*[n for n, v in known.items() if v is None], **values)


def read_data(paths: Sequence[Path], model: Model, sampling_time: float | None = None) -> tuple[Experiment, ...]:
    """The records; what is to be said of them goes to stderr. Raises GreyboxError."""
    from greybox.data.read import read_experiments
    from greybox.shell.inputs import print_record_notes, refuse_repeated_records

    layout = {} if sampling_time is None else {"sampling_time": sampling_time}
    try:
        records = read_experiments(paths, model, **layout)  # type: ignore[arg-type]
    except DataError:
        if not layout:
            raise
        records = read_experiments(paths, model)
    refuse_repeated_records(paths, records)
    print_record_notes(records)
    return records


def _options(at_rest: bool) -> FitOptions:
    from greybox.estimation.options import FitOptions

    return FitOptions(at_rest=at_rest)


def _fit(model: Model, records: Sequence[Experiment], noise: dict[str, float], options: FitOptions) -> Fit:
    from greybox.estimation.fit import fit

    result = fit(model, records, noise=noise, options=options)
    if not result.success:
        raise GreyboxError(f"{model.title}: the fit to the records did not end at an optimum; try other --start values")
    return result


def _kind_of(path: Path) -> str:
    """``fit`` or ``discovery``: a discovery has a verdict. What else is wrong with the file is said by whoever reads it."""
    from greybox.base.json_file import parse_json

    if not path.is_file():  # a pipe would be waited for
        return "fit"
    try:
        data: Any = parse_json(path.read_bytes())
    except (OSError, ValueError):
        return "fit"
    return "discovery" if isinstance(data, dict) and "verdict" in data else "fit"


def _from_discovery(path: Path, data: Sequence[Path], name: str | None) -> tuple[Fit, Fit, list[str]]:
    """The best explanation of a discovery fitted again to the records, the fit of its plain model, and the alternatives."""
    from greybox.base.json_file import ResultKind, read_json
    from greybox.estimation.options import FitOptions
    from greybox.extensions.design.next_record import fit_explanation
    from greybox.shell.project import find_model, is_model_path

    content = read_json(path, ResultKind.DISCOVERY)
    if not data:
        raise GreyboxError(
            f"{path}: a discovery does not hold its records; give them too, as in greybox design {path} train.csv"
        )
    if name is None and is_model_path(content["model"]):
        raise DataError(f"{path}: its model is a file; give --model MODEL")
    try:
        plain = find_model(name or content["model"])
    except ModelError as error:
        raise ModelError(f"{path}: its model cannot be found: {error}; name its file with --model my/rig.py") from None
    parameters = {n: e for n, e in content["parameters"].items() if n in plain.values and e["value"] is not None}
    plain = plain.free(*(n for n, e in parameters.items() if not e.get("fixed")))
    plain = plain.start(**{n: e["value"] for n, e in parameters.items()})
    plain = plain.fix(*(n for n, e in parameters.items() if e.get("fixed")))
    records = read_data(data, plain)
    options = FitOptions.from_data(content.get("options", {}))
    base = _fit(plain, records, {n: s for n, s in content["noise"].items() if s}, options)
    best = "+".join(e["name"] for e in content["effects"])
    alternatives = ["+".join(a) or "none" for a in content["alternatives"]]
    print_note(
        f"note: {len(records)} record{'s' * (len(records) != 1)} fitted again, with each explanation of {path.name}"
    )
    return (fit_explanation(base, best) if best else base), base, alternatives


# `greybox campaign`.


def campaign(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Name of the plain model, or its file.")],
    data: Annotated[list[Path] | None, typer.Argument(metavar="DATA", help="Records that were taken before.")] = None,
    *,
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            metavar="COMMAND",
            help="Program that plays a CSV file of inputs and writes a record: {input}, {record} and {number} are put in. Without it the"
            " campaign waits for each record.",
        ),
    ] = "",
    limit: Limits,
    rate: Rates,
    duration: Annotated[float, typer.Option("--duration", metavar="SECONDS", help="Duration of each record.")] = 0.0,
    sampling_time: Annotated[
        float, typer.Option("--sampling-time", metavar="SECONDS", help="Seconds between rows.")
    ] = 0.0,
    noise: SensorNoise,
    experiments: Annotated[
        int, typer.Option("--experiments", metavar="N", min=1, help="Records that may be taken.")
    ] = 3,
    width: Annotated[
        float | None,
        typer.Option(
            "--width",
            metavar="SHARE",
            help="Go on until the 95 % interval of each parameter is this share of its value to each side. [default: until one"
            " explanation is left]",
        ),
    ] = None,
    effects: Annotated[
        Texts,
        repeated(
            "--effect",
            metavar="NAME",
            complete=completion.effects,
            text="Try only this effect of the catalogue; may be repeated. [default: all]",
        ),
    ],
    hold: Annotated[HoldName, typer.Option("--hold", help="The generator between samples.")] = HoldName.zero,
    fixed: Fixed,
    start: Start,
    at_rest: Annotated[
        bool, typer.Option("--at-rest", help="Records begin at the initial state of the model.")
    ] = False,
    workers: Workers = 0,
    cluster: Cluster = "",
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder of the campaign. [default: results/MODEL-campaign]"),
    ] = None,
    no_report: NoReport = False,
    json: Json = False,
) -> None:
    """Design a record, measure it, fit, discover, and design the next one, until one explanation is left.

    DIR holds a folder for each experiment, with input.csv, record.csv, their results and pages, and report.html with all of them. Without
    --rig, play DIR/01/input.csv, put the record at DIR/01/record.csv and run the same command again. What is in DIR is not done again:
    a campaign that was interrupted goes on.

    No record is played that breaks a limit under an explanation that is left, with a margin for what is not known.

    Exit code 0: done, or a record is to be taken. 1: the budget is spent, or the rig broke a limit. 2: bad input, or a rig that fails.
    """
    from dataclasses import replace

    from greybox.base.errors import DataError, GreyboxError
    from greybox.base.json_shape import format_json, to_json_data
    from greybox.base.parallel.jobs import open_workers
    from greybox.estimation.options import FitOptions
    from greybox.extensions.design.campaign import CampaignPlan, CampaignStatus, run_campaign
    from greybox.extensions.design.problem import CAMPAIGN_POLICY, DesignProblem
    from greybox.extensions.design.rig import check_command
    from greybox.model.effects.catalogue import effect
    from greybox.show.sentences.shell import report_line

    if width is not None and not width > 0:
        raise GreyboxError(f"--width {width:g}: give a share above 0, as in --width 0.05")
    plain = build_plain_model(model, fixed, start)
    folder = check_writable(output or Path("results") / f"{plain.name}-campaign")
    plan = CampaignPlan(
        plain,
        parse_limits("--limit", limit, rate),
        duration,
        sampling_time,
        read_noise(noise),
        read_data(data, plain) if data else (),
        width,
        parse_names(effects),
        hold.value,
        FitOptions(at_rest=at_rest),
        replace(CAMPAIGN_POLICY, experiments=experiments),
    )
    # Whatever is wrong with the question is said before a folder is made.
    for name in plan.effects:
        plain + effect(name)
    if rig:
        check_command(rig)
    DesignProblem((plain,), plan.limits, duration, sampling_time, plan.noise, plan.records, hold=plan.hold)

    def write_page(path: Path, value: Any) -> None:
        if not no_report:
            write_report(value, path)

    try:
        with open_workers(workers, cluster) as executor:
            result = run_campaign(
                plan, folder, rig=rig, on_step=write_page, on_message=print_note, executor=executor, workers=workers
            )
    except KeyboardInterrupt:
        exit_with_error(f"interrupted; what is finished is in {folder}, the same command goes on", ExitCode.INTERRUPTED)
    except DataError as error:
        raise GreyboxError(str(error)) from error
    report = None if no_report else write_report(result, folder / "report.html")
    if json:
        typer.echo(format_json(to_json_data(result)))
    else:
        typer.echo("\n".join([str(result), *([report_line(report)] if report else [])]))
    if result.status in (CampaignStatus.BUDGET_SPENT, CampaignStatus.LIMIT_BROKEN):
        raise typer.Exit(ExitCode.UNSUCCESSFUL)


DESIGN = Command(
    design,
    "Design the next record within what the rig allows.",
    (
        "greybox design results/rig-fit/fit.json --limit u=-3:3 --limit x=-1e-4:1e-4 --duration 1",
        "greybox design results/rig-discover/discovery.json train.csv --goal discrimination --limit u=-3:3",
        "greybox design my/rig.py --noise x=2e-7 --limit u=-1:1 --rate u=100 --duration 0.5 --sampling-time 2.5e-4",
    ),
)


CAMPAIGN = Command(
    campaign,
    "Design, measure, fit and discover in turn, in one folder.",
    (
        "greybox campaign my/rig.py --noise x=2e-7 --limit u=-1:1 --duration 0.5 --sampling-time 2.5e-4 --output rig",
        "greybox campaign my/rig.py ... --rig 'python play.py {input} {record}'",
    ),
)

PRINTS = {
    "design": ("greybox.extensions.design.result:Design",),
    "campaign": ("greybox.extensions.design.campaign:Campaign",),
}
"""Command -> types of what it prints with ``--json``."""
