"""`greybox design`."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.cli import completion
from greybox.cli.exits import print_note
from greybox.cli.export import load_fit_with_model
from greybox.cli.limits import parse_limits
from greybox.cli.options import (
    Fixed,
    Json,
    Limits,
    NoReport,
    Rates,
    SensorNoise,
    Start,
    Texts,
    check_writable,
    read_noise,
    repeated,
)
from greybox.cli.reporting import write_report
from greybox.cli.study import HoldName
from greybox.cli.study_values import Numbers, parse_names
from greybox.errors import DataError, GreyboxError, ModelError

if TYPE_CHECKING:
    from greybox.estimation import FitOptions
    from greybox.experiment import Experiment
    from greybox.model import Model
    from greybox.result import Fit


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
    from greybox.experiment_design import design as design_record
    from greybox.experiment_design.result import design_data
    from greybox.result import Fit, format_json, to_json_data

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
        typer.echo(format_json(to_json_data(design_data(result))))
        return
    from greybox.rendering.cli import report_line
    from greybox.rendering.cli import written as written_line

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
    from greybox.project import find_model

    known = Numbers(bare="as declared").from_option("--fix", fixed)
    values = {n: v for n, v in known.items() if v is not None}
    started = Numbers().from_option("--start", start)
    both = sorted(values.keys() & started.keys())
    if both:
        raise GreyboxError(f"{', '.join(both)}: --fix and --start contradict each other; keep one")
    return find_model(name).start(**started).fix(*[n for n, v in known.items() if v is None], **values)


def read_data(paths: Sequence[Path], model: Model, sampling_time: float | None = None) -> tuple[Experiment, ...]:
    """The records; what is to be said of them goes to stderr. Raises GreyboxError."""
    from greybox.cli.inputs import print_record_notes, refuse_repeated_records
    from greybox.experiment import read_experiments

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
    from greybox.estimation import FitOptions

    return FitOptions(at_rest=at_rest)


def _fit(model: Model, records: Sequence[Experiment], noise: dict[str, float], options: FitOptions) -> Fit:
    from greybox.estimation import fit

    result = fit(model, records, noise=noise, options=options)
    if not result.success:
        raise GreyboxError(f"{model.title}: the fit to the records did not end at an optimum; try other --start values")
    return result


def _kind_of(path: Path) -> str:
    """``fit`` or ``discovery``: a discovery has a verdict. What else is wrong with the file is said by whoever reads it."""
    from greybox.schemas import parse_json

    if not path.is_file():  # a pipe would be waited for
        return "fit"
    try:
        data: Any = parse_json(path.read_bytes())
    except (OSError, ValueError):
        return "fit"
    return "discovery" if isinstance(data, dict) and "verdict" in data else "fit"


def _from_discovery(path: Path, data: Sequence[Path], name: str | None) -> tuple[Fit, Fit, list[str]]:
    """The best explanation of a discovery fitted again to the records, the fit of its plain model, and the alternatives."""
    from greybox.estimation import FitOptions
    from greybox.experiment_design.rivals import fit_explanation
    from greybox.project import find_model, is_model_path
    from greybox.schemas import ResultKind, read_json

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
