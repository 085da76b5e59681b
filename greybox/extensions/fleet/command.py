"""`greybox fleet`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from greybox.base import ExitCode, GreyboxError
from greybox.shell import options
from greybox.shell.inputs import find_plain_model, layout_of, result_folder, set_parameters
from greybox.shell.progress import show_progress
from greybox.shell.study import Answer, Command, NextCommand, Option, Study
from greybox.shell.study_values import Word
from greybox.shell.terminal import write_report

if TYPE_CHECKING:
    from greybox.extensions.fleet.records import RecordCollection
    from greybox.extensions.fleet.result import FleetResult

JOURNAL = "fleet.jsonl"
"""Records that are done, of a command that was interrupted, in its output folder."""


class FleetStudy(Study):
    """The options of `greybox fleet`."""

    record = Option(Word(), "--record COLUMN", "record", "Column of a Parquet file that names the record of each row.")


def fleet(study: FleetStudy) -> Answer:
    """Fit MODEL to each record by itself: a line's test bench, a fleet of machines, a machine over years.

    Writes DIR/fleet.csv (and fleet.parquet where pyarrow is installed), a row for each record: constants with standard deviation and 95 %
    interval, misfit over noise, status, findings. DIR/fleet.json has the population of the constants, DIR/report.html shows it.

    A record that cannot be read or fitted is named with its reason, and the others are done. What is done is kept: after Ctrl-C the same
    command goes on from it.

    Exit code 0: every record has a result. 1: some have none. 2: bad input, or no record has a result. 130: Ctrl-C.
    """
    from importlib.util import find_spec

    from greybox.base.parallel.jobs import open_workers
    from greybox.estimation.options import FitOptions
    from greybox.extensions.fleet.batch import fit_each
    from greybox.extensions.fleet.records import find_records

    plant = set_parameters(find_plain_model(study), study)
    folder = result_folder(study, plant.name)
    references = find_records(study.estimation, record=study.record, hold=study.hold, **layout_of(study))
    journal = folder / JOURNAL
    with open_workers(study.workers, study.cluster) as executor, show_progress() as show:
        result = fit_each(
            plant,
            references,
            noise=dict(study.noise) or None,
            options=FitOptions(at_rest=study.at_rest),
            executor=executor,
            workers=study.workers,
            report=lambda done, total: show(f"{plant.title}: {done} of {total} records done", done / total),
            journal=journal,
        )
    if not result.left and not any(r.success for r in result.records):
        journal.unlink(missing_ok=True)
        first = result.records[0]
        raise GreyboxError(f"none of {len(result.records)} records has a result; {first.name}: {first.reason}")
    saved = [result.save(folder / "fleet.json"), result.save_table(folder / "fleet.csv")]
    if find_spec("pyarrow"):
        saved.append(result.save_table(folder / "fleet.parquet"))
    done = f"{len(result.records)} records are done, the same command goes on from them"
    if not result.left:
        journal.unlink(missing_ok=True)
    return Answer(
        result,
        files=saved,
        page=lambda: write_report(result, folder / "report.html"),
        kept=f"the results are in {saved[0]}",
        next=_next(study, result, references),
        failure=f"interrupted; {done}" if result.left else "",
        code=ExitCode.INTERRUPTED
        if result.left
        else ExitCode.UNSUCCESSFUL
        if result.without_result or not result.usable
        else ExitCode.SUCCESS,
    )


def _next(study: FleetStudy, result: FleetResult, references: RecordCollection) -> NextCommand | str:
    """The record that the model follows worst is looked at by itself, where it has a file of its own."""
    ratios = {r.name: max((m.noise_ratio for m in r.misfit.values()), default=0.0) for r in result.records if r.success}
    worst = max(ratios, key=ratios.__getitem__, default="")
    files = [r.path for r in references.references if r.name == worst and r.rows is None]
    return study.then("fit", study.model, *files[:1]) if files else ""


FLEET = Command(
    fleet,
    "Fit a model to each of many records.",
    (
        *(Study.model, Study.fixed, Study.noise, FleetStudy.record, *options.SHARING, *options.SHOWING),
        Study.estimation.but(
            usage="RECORDS", help="Records, folders of records, or Parquet files of many records.", required=True
        ),
        Study.start.but(help="Value of a parameter of MODEL."),
        Study.hold,
        Study.at_rest.but(help="Every record begins in the state that the model declares."),
        *options.READING_LIKE,
        Study.sampling_time.but(help="Seconds between rows, for records without a time."),
        Study.output.but(help="Folder for the results. [default: results/MODEL-fleet]"),
    ),
    (
        "greybox fleet micro_actuator bench/ --fix M=0.01 --fix Ra=8 --noise x=2e-7",
        "greybox fleet my/rig.py bench.parquet --record serial_number --output results/bench",
    ),
    (options.LAYOUT,),
    study=FleetStudy,
)

PRINTS = {"fleet": ("greybox.extensions.fleet.result:FleetResult",)}
"""Command -> types of what it prints with ``--json``."""
