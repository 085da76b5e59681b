"""`greybox design`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base import DataError, ExitCode, GreyboxError
from greybox.base.texts import to_word
from greybox.shell import inputs, options
from greybox.shell.study import Answer, Command, Idle, Option, Study
from greybox.shell.study_values import Choice, Count, Names, Numbers, Quantity, Word
from greybox.shell.terminal import exit_with_error, print_findings, print_note, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.estimation import Fit, FitOptions
    from greybox.extensions.design.problem import Design
    from greybox.model import Model


class DesignStudy(Study):
    """The options of `greybox design` and `greybox campaign`."""

    # A table: an option is a row or two.
    # fmt: off
    hold = Option(Choice(("zero", "first", "band-limited")), "--hold", "records.hold",
        "The generator between samples: zero holds, first and band-limited are smooth.")
    goal = Option(Choice(("precision", "discrimination", "detection")), "--goal", "goal",
        "precision: narrow intervals. discrimination: tell explanations apart. detection: effects that may hide.")
    criterion = Option(Choice(("D", "A", "E")), "--criterion", "criterion",
        "For precision: D volume of the region, A mean variance, E worst combination.")
    counted = Option(Names(), "--constant NAME", "constants", "For precision: a parameter that counts; may be repeated. [default: all]")
    rivals = Option(Names(), "--rival EFFECT[+EFFECT]", "rivals",
        "For discrimination: effects of the model that are another explanation; none is the plain model.")
    sensors = Option(Numbers("OUTPUT=STD", "x=2e-7"), "--sensor OUTPUT=STD", "sensors.",
        "A sensor that could be added, with the standard deviation of its noise.")
    # A program that is run is no part of a study: a study file alone runs none.
    rig = Option(Word(), "--rig COMMAND", "",
        "Program that plays a CSV file of inputs and writes a record: {input}, {record} and {number} are put in. Without it the"
        " campaign waits for each record.")
    experiments = Option(Count(1, 3), "--experiments N", "experiments", "Records that may be taken.")
    width = Option(Quantity(), "--width SHARE", "width",
        "Go on until the 95 % interval of each parameter is this share of its value to each side. [default: until one"
        " explanation is left]")
    # fmt: on


def design(study: DesignStudy) -> Answer:
    """Design the next record: the input, within the limits of the rig, that brings most.

    Tries sweeps, steps, PRBS and multisines at the largest amplitude that keeps every limit, under every explanation and for what is
    not known of the parameters, and improves the best one sample by sample. Writes DIR/input.csv, which greybox simulate and a rig can
    play, DIR/design.json and DIR/report.html.

    Exit code 0: done. 2: bad input, or limits that cannot be met; nothing was written.
    """
    from greybox.base import format_json, to_json_data
    from greybox.estimation.result import Fit
    from greybox.extensions.design.next_record import design as design_record

    known, plain, rivals = read_source(study)
    folder = inputs.result_folder(study, (known.model if isinstance(known, Fit) else known).name)
    result = design_record(
        known,
        limits=inputs.limits_of(study),
        duration=study.duration or None,
        sampling_time=study.sampling_time or None,
        goal=study.goal,
        criterion=study.criterion,
        constants=list(study.counted),
        rivals=[*rivals, *study.rivals],
        plain=plain,
        effects=study.effects,
        noise=dict(study.noise),
        sensors=dict(study.sensors),
        hold=study.hold,  # type: ignore[arg-type]
        options=_options(study) if study.at_rest else None,  # None: those of the fit
    )
    written = result.save(folder)
    planned = study.model or (result.model.name if study.source.endswith(".json") else study.source)
    return Answer(
        result,
        lambda _: format_json(to_json_data(result)),
        [folder / "input.csv", written],
        lambda: write_report(result, folder / "report.html"),
        kept=f"the design is in {written}",
        next=study.then(
            "simulate",
            *(planned, folder / "input.csv", *_set(result), "--output", "planned.csv"),
            holds=(*options.IN_RESULT, *options.IN_RECORD),
        ),
    )


def _set(result: Design) -> list[str]:
    """The effects and parameters of a design's model, as options of a simulation."""
    model = result.model
    effects = [word for e in model.effects for word in ("--effect", e.name)]
    return [*effects, *(word for q in model.free_parameters for word in ("--set", f"{q.name}={q.value:.6g}"))]


def read_source(study: DesignStudy) -> tuple[Model | Fit, Fit | None, list[str]]:
    """The best explanation, the fit of the plain model where it is another one, and the rivals by their effects. Raises GreyboxError."""
    source, data = study.source, study.estimation
    if source.endswith(".json"):
        if not inputs.describes_discovery(Path(source)):
            if data or study.fixed or study.start:
                raise GreyboxError(
                    f"{source}: a fit knows its records and parameters; leave out DATA, --fix and --start"
                )
            return inputs.load_fit_with_model(Path(source), study.model), None, []
        if study.fixed or study.start:
            raise GreyboxError(f"{source}: a discovery knows its parameters; leave out --fix and --start")
        return _from_discovery(Path(source), data, study)
    plant = build_plain_model(study, "source")
    if not data:
        return plant, None, []
    records = read_data(data, plant, study, study.sampling_time)
    return _fit(plant, records, dict(study.noise), _options(study)), None, []


def build_plain_model(study: Study, holder: str = "model") -> Model:
    """The model with parameters fixed and started. Raises GreyboxError."""
    return inputs.set_parameters(inputs.find_plain_model(study, holder), study)


def read_data(
    paths: Sequence[Path], model: Model, study: Study, sampling_time: float = 0.0, loss: str = "squares", **like: Any
) -> tuple[Experiment, ...]:
    """The records, ``like`` those of a result; what is to be said of them goes to stderr. Raises GreyboxError."""
    from greybox.data.identity import refuse_repeated
    from greybox.shell.inputs import print_record_notes, read_files, split_as_told

    # --hold is that of the generator, and the sampling time one of the record to be designed: it counts for these where they have no time.
    like = {"hold": "auto", **like, "sampling_time": sampling_time or None}
    try:
        records = read_files(study, paths, model, **like)
    except DataError:
        if not sampling_time:
            raise
        records = read_files(study, paths, model, **{**like, "sampling_time": None})
    refuse_repeated(records)
    (records,) = split_as_told(study, [records], [paths])
    print_record_notes(records, loss=loss)
    return records


def _options(study: Study) -> FitOptions:
    from greybox.estimation.options import FitOptions

    return FitOptions(at_rest=study.at_rest)


def _fit(model: Model, records: Sequence[Experiment], noise: dict[str, float], fitting: FitOptions) -> Fit:
    from greybox.estimation.fit import fit

    result = fit(model, records, noise=noise, options=fitting)
    if not result.success:
        raise GreyboxError(f"{model.title}: the fit to the records did not end at an optimum; try other --start values")
    return result


def _from_discovery(path: Path, data: Sequence[Path], study: Study) -> tuple[Fit, Fit, list[str]]:
    """The best explanation of a discovery fitted again to the records, the fit of its plain model, and the alternatives."""
    from greybox.base import read_json
    from greybox.discovery.result import Discovery
    from greybox.estimation.options import FitOptions
    from greybox.estimation.result import join_definition
    from greybox.extensions.design.next_record import fit_explanation

    content = read_json(path, Discovery)
    if not data:
        raise GreyboxError(
            f"{path}: a discovery does not hold its records; give them too, as in greybox design {to_word(str(path))} train.csv"
        )
    plain = inputs.find_model_of(path, content["model"], study.model)
    stated = {
        "equations": content.get("plain_equations", ""),
        "declared": content.get("declared", {}),
        "parameters": content["plain_parameters"],
    }
    try:
        print_findings(join_definition(stated, plain, insist=bool(study.model)))
    except DataError as error:
        raise DataError(f"{path}: {error}") from None
    parameters = {n: e for n, e in content["parameters"].items() if n in plain.values and e["value"] is not None}
    plain = plain.free(*(n for n, e in parameters.items() if not e.get("fixed")))
    plain = plain.start(**{n: e["value"] for n, e in parameters.items()})
    plain = plain.fix(*(n for n, e in parameters.items() if e.get("fixed")))
    like = {"hold": content.get("hold", "auto"), "conditions": dict.fromkeys(content.get("conditions", ()))}
    fitting = FitOptions.from_data(content.get("options", {}))
    records = read_data(data, plain, study, loss=fitting.loss, **like)
    base = _fit(plain, records, {n: s for n, s in content["noise"].items() if s}, fitting)
    best = "+".join(e["name"] for e in content["effects"])
    alternatives = ["+".join(a) or "none" for a in content["alternatives"]]
    print_note(
        f"note: {len(records)} record{'s' * (len(records) != 1)} fitted again, with each explanation of {path.name}"
    )
    return (fit_explanation(base, best) if best else base), base, alternatives


# `greybox campaign`.


def campaign(study: DesignStudy) -> Answer:
    """Design a record, measure it, fit, discover, and design the next one, until one explanation is left.

    DIR holds a folder for each experiment, with input.csv, record.csv, their results and pages, and report.html with all of them. Without
    --rig, play DIR/01/input.csv, put the record at DIR/01/record.csv and run the same command again. What is in DIR is not done again:
    a campaign that was interrupted goes on.

    No record is played that breaks a limit under an explanation that is left, with a margin for what is not known.

    Exit code 0: done, or a record is to be taken. 1: the budget is spent, or the rig broke a limit. 2: bad input, or a rig that fails.
    """
    from dataclasses import replace

    from greybox.base import format_json, to_json_data
    from greybox.base.parallel.jobs import open_workers
    from greybox.extensions.design.campaign import CampaignPlan, CampaignStatus, run_campaign
    from greybox.extensions.design.problem import CAMPAIGN_POLICY, DesignProblem
    from greybox.extensions.design.rig import check_command
    from greybox.model.effects.catalogue import effect

    plain = build_plain_model(study)
    folder = inputs.result_folder(study, plain.name)
    plan = CampaignPlan(
        plain,
        inputs.limits_of(study),
        study.duration,
        study.sampling_time,
        dict(study.noise),
        read_data(study.estimation, plain, study) if study.estimation else (),
        study.width or None,
        study.effects,
        study.hold,  # type: ignore[arg-type]
        _options(study),
        replace(CAMPAIGN_POLICY, experiments=study.experiments),
    )
    # Whatever is wrong with the question is said before a folder is made.
    for name in plan.effects:
        plain + effect(name)
    if study.rig:
        check_command(study.rig)
    DesignProblem((plain,), plan.limits, plan.duration, plan.sampling_time, plan.noise, plan.records, hold=plan.hold)

    def write_page(path: Path, value: Any) -> None:
        if not study.no_report:
            write_report(value, path)

    try:
        with open_workers(study.workers, study.cluster) as executor:
            result = run_campaign(
                plan,
                folder,
                rig=study.rig,
                on_step=write_page,
                on_message=print_note,
                executor=executor,
                workers=study.workers,
            )
    except KeyboardInterrupt:
        exit_with_error(f"interrupted; what is finished is in {folder}, the same command goes on", ExitCode.INTERRUPTED)
    except DataError as error:
        raise GreyboxError(str(error)) from error
    is_open = result.status in (CampaignStatus.BUDGET_SPENT, CampaignStatus.LIMIT_BROKEN)
    return Answer(
        result,
        lambda _: format_json(to_json_data(result)),
        page=lambda: write_report(result, folder / "report.html"),
        kept=f"the campaign is in {folder}",
        next=study.then("campaign", study.model, "--output", folder)
        if result.status is CampaignStatus.MEASURING
        else "",
        code=ExitCode.UNSUCCESSFUL if is_open else ExitCode.SUCCESS,
    )


OWN = DesignStudy
RIG = (Study.limits, Study.rates, Study.duration, Study.fixed, Study.at_rest)
MODEL_VALUES = Study.start.but(help="Value of a parameter of MODEL.")
SENSOR_NOISE = "Standard deviation of the sensor noise of an output."

DESIGN = Command(
    design,
    "Design the next record within what the rig allows.",
    (
        Study.source.but(
            usage="SOURCE",
            help="fit.json or its folder, discovery.json, or a model (its name or file) of which nothing was measured yet.",
        ),
        Study.estimation.but(help="Records taken so far: needed with discovery.json, fitted with a model."),
        *(*RIG, MODEL_VALUES, OWN.goal, OWN.criterion, OWN.counted, OWN.rivals, OWN.sensors),
        Study.noise.but(kind=Numbers("OUTPUT=STD", "x=2e-7"), help=f"{SENSOR_NOISE} [default: that of the fit]"),
        *(*options.READING_LIKE, *options.SPLITTING),
        Study.sampling_time.but(help="Seconds between rows. [default: as measured]"),
        Study.duration.but(help="Duration of the record. [default: as measured]"),
        Study.effects.but(
            help="For detection: an effect that may hide; may be repeated. [default: all that have a place]"
        ),
        OWN.hold,
        Study.at_rest.but(help="Records begin at the initial state of the model. [default: as fitted]"),
        options.model_of("SOURCE"),
        Study.output.but(help="Folder for the results. [default: results/MODEL-design]"),
        *options.SHOWING,
    ),
    (
        "greybox design results/rig-fit/fit.json --limit u=-3:3 --limit x=-1e-4:1e-4 --duration 1",
        "greybox design results/rig-discover/discovery.json train.csv --goal discrimination --limit u=-3:3",
        "greybox design my/rig.py --noise x=2e-7 --limit u=-1:1 --rate u=100 --duration 0.5 --sampling-time 2.5e-4",
    ),
    (
        options.LAYOUT,
        Idle(
            (OWN.criterion, OWN.counted),
            "with --goal {s.goal}: it is for precision",
            lambda study: study.goal != "precision",
        ),
        Idle(
            (Study.effects,),
            "with --goal {s.goal}: it names what may hide",
            lambda study: study.goal != "detection",
            ", or add --goal detection",
        ),
    ),
    study=DesignStudy,
)


CAMPAIGN = Command(
    campaign,
    "Design, measure, fit and discover in turn, in one folder.",
    (
        Study.model.but(help="Name of the plain model, or its file."),
        Study.estimation.but(help="Records that were taken before."),
        *(*RIG, MODEL_VALUES, OWN.rig, OWN.experiments, OWN.width),
        Study.noise.but(
            kind=Numbers("OUTPUT=STD", "x=2e-7"), help=f"{SENSOR_NOISE} Needed for each sensor that is installed."
        ),
        *options.READING_LIKE,
        Study.sampling_time.but(help="Seconds between rows."),
        Study.duration.but(help="Duration of each record."),
        Study.effects.but(help="Try only this effect of the catalogue; may be repeated. [default: all]"),
        OWN.hold,
        Study.at_rest.but(help="Records begin at the initial state of the model."),
        Study.output.but(help="Folder of the campaign. [default: results/MODEL-campaign]"),
        *(*options.SHARING, *options.SHOWING),
    ),
    (
        "greybox campaign my/rig.py --noise x=2e-7 --limit u=-1:1 --duration 0.5 --sampling-time 2.5e-4 --output rig",
        "greybox campaign my/rig.py ... --rig 'python play.py {input} {record}'",
    ),
    (options.LAYOUT,),
    study=DesignStudy,
)

PRINTS = {
    "design": ("greybox.extensions.design.problem:Design",),
    "campaign": ("greybox.extensions.design.campaign:Campaign",),
}
"""Command -> types of what it prints with ``--json``."""
