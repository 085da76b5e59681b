"""`greybox campaign`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from greybox.cli import completion
from greybox.cli.design import build_plain_model, read_data
from greybox.cli.exit_codes import ExitCode
from greybox.cli.exits import exit_with_error, print_note
from greybox.cli.limits import parse_limits
from greybox.cli.options import (
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
from greybox.cli.reporting import write_report
from greybox.cli.study import HoldName
from greybox.cli.study_values import parse_names


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

    from greybox.effects import effect
    from greybox.errors import DataError, GreyboxError
    from greybox.estimation import FitOptions
    from greybox.experiment_design import CampaignPlan, CampaignStatus, run_campaign
    from greybox.experiment_design.campaign import campaign_data
    from greybox.experiment_design.policy import CAMPAIGN_POLICY
    from greybox.experiment_design.problem import DesignProblem
    from greybox.experiment_design.rig import check_command
    from greybox.parallel import open_workers
    from greybox.rendering.cli import report_line
    from greybox.result import format_json, to_json_data

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
        typer.echo(format_json(to_json_data(campaign_data(result))))
    else:
        typer.echo("\n".join([str(result), *([report_line(report)] if report else [])]))
    if result.status in (CampaignStatus.BUDGET_SPENT, CampaignStatus.LIMIT_BROKEN):
        raise typer.Exit(ExitCode.UNSUCCESSFUL)
