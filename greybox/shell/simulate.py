"""`greybox simulate`."""

from __future__ import annotations

import json as json_format
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.base.errors import ExitCode, GreyboxError
from greybox.base.findings import Finding
from greybox.shell import completion
from greybox.shell.inputs import add_effects, check_substeps, layout_of, parse_limits, refuse_broken_limits
from greybox.shell.options import NoReport, Texts, check_writable, read_noise, repeated, takes_study
from greybox.shell.study import SIMULATE, Study
from greybox.shell.study_values import Numbers
from greybox.shell.terminal import CommandCode, exit_with_error, print_findings, print_note, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.model.model import Model
    from greybox.simulation.simulate import Simulation

Values = Annotated[
    Texts,
    repeated(
        "--set",
        "--fix",
        "--start",
        metavar="NAME=VALUE",
        complete=completion.constants,
        text="Value of a parameter, in its unit.",
    ),
]
Initial = Annotated[
    Texts,
    repeated(
        "--initial",
        metavar="STATE=VALUE",
        complete=completion.states,
        text="Initial value of a state, in its unit.",
    ),
]
AddedNoise = Annotated[
    Texts,
    repeated(
        "--noise",
        metavar="OUTPUT=STD",
        complete=completion.outputs,
        text="Standard deviation of white noise added to an output, in its unit.",
    ),
]


@takes_study(SIMULATE)
def simulate(
    study: Study,
    inputs: Annotated[
        Path | None,
        typer.Argument(metavar="INPUT", help="File with time and the model's inputs; or select a test signal."),
    ] = None,
    *,
    step: Annotated[
        float | None, typer.Option("--step", metavar="HEIGHT", help="Test signal: a step at the first row.")
    ] = None,
    multisine: Annotated[
        float | None,
        typer.Option(
            "--multisine", metavar="RMS", help="Test signal: sines of equal amplitude and random phase in --band."
        ),
    ] = None,
    chirp: Annotated[
        float | None,
        typer.Option("--chirp", metavar="AMPLITUDE", help="Test signal: a sine swept through --band."),
    ] = None,
    band: Annotated[
        str | None, typer.Option("--band", metavar="LOW:HIGH", help="Band of a multisine or chirp in Hz.")
    ] = None,
    offset: Annotated[float, typer.Option("--offset", metavar="VALUE", help="Offset added to the test signal.")] = 0.0,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="SECONDS", help="Duration of the test signal.")
    ] = None,
    sampling_time: Annotated[
        float | None,
        typer.Option(
            "--sampling-time",
            metavar="SECONDS",
            help="Sampling time of the test signal, or of an INPUT without a time column.",
        ),
    ] = None,
    set_: Values,
    initial: Initial,
    noise: AddedNoise,
    limit: Annotated[
        Texts,
        repeated(
            "--limit",
            metavar="NAME=LOW:HIGH",
            complete=completion.signals,
            text="Range of an input, output or state: a run that leaves it ends with exit code 1, as a rig's emergency stop would.",
        ),
    ],
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Seed of the noise and of the phases of --multisine.")
    ] = 0,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="FILE", help="CSV file to write. [default: results/MODEL-simulated.csv]"),
    ] = None,
    no_report: NoReport = False,
    json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON instead of text.")] = False,
) -> None:
    """Simulate MODEL with the inputs of a file or with a test signal, and write a CSV file that greybox fit reads.

    A test signal drives the first input; the other inputs are zero. The simulation starts at the initial state of the model.
    With --output FILE.csv, also writes FILE.html, a report with the run, the states and the equations.

    Exit code 0: done. 1: the simulation overflows or leaves a --limit, nothing was written. 2: bad input, nothing was written.
    """
    import numpy as np

    from greybox.base.units import format_unit
    from greybox.data.findings import RecordCode
    from greybox.data.sampling import find_longest_time_gap
    from greybox.shell.project import find_model
    from greybox.show.sentences.shell import report_line
    from greybox.simulation.simulate import read_inputs, write_csv
    from greybox.simulation.simulate import simulate as simulate_model

    plant = add_effects(find_model(study.model), study.effects).start(**Numbers().from_option("--set", set_))
    target = _target(output or Path("results") / f"{plant.name}-simulated.csv", inputs)
    check_substeps(study, plant)
    noise_std = read_noise(noise)
    generator = np.random.default_rng(seed)
    shapes = {"--step": step, "--multisine": multisine, "--chirp": chirp}
    shaping = {"--band": band, "--offset": offset, "--duration": duration}
    layout = layout_of(study)
    chosen = _one_drive(plant, inputs, shapes, shaping, study)
    if seed and not noise_std and multisine is None:
        raise GreyboxError(f"--seed {seed} has no effect: nothing here is random; give --noise or --multisine too")
    if inputs is not None:
        layout |= {} if sampling_time is None else {"sampling_time": sampling_time}
        experiment = read_inputs(inputs, plant, hold=study.hold, **layout)  # type: ignore[arg-type]
        gap = find_longest_time_gap(experiment.time, code=RecordCode.INPUT_HELD_THROUGH_GAP)
        if gap is not None:
            print_note(f"note: {experiment.source}: {gap}")
    else:
        experiment = _signal(plant, chosen, band, offset, duration, sampling_time, study.hold, generator)
    start = Numbers(shape="STATE=VALUE", example="x=0.001").from_option("--initial", initial)
    run = simulate_model(plant, experiment, initial=start, method=study.method, substeps=study.substeps)
    if run.overflow is not None:
        exit_with_error(
            f"{plant.title}: the simulation overflows {run.overflow:.4g} s after its start; nothing was written",
            ExitCode.UNSUCCESSFUL,
        )
    refuse_broken_limits(run, parse_limits("--limit", limit))
    replaced = target.exists()
    write_csv(run.record(noise_std, generator), plant, target)
    if replaced:
        print_findings([Finding(CommandCode.FILE_OVERWRITTEN, subject=str(target))])
    report = None
    if output is not None and not no_report:
        units = {q.name: format_unit(q.unit) for q in plant.outputs}
        added = ", ".join(f"{name} {std:g} {units[name]}".rstrip() for name, std in noise_std.items())
        report = write_report(run, target.with_suffix(".html"), model=plant, noise=added)
    if json:
        typer.echo(_as_json(run, target, report))
    else:
        from greybox.shell.answers import SimulationAnswer

        typer.echo("\n".join([str(SimulationAnswer(run, target)), *([report_line(report)] if report else [])]))


def _as_json(run: Simulation, target: Path, report: Path | None) -> str:
    return json_format.dumps(
        {
            "file": str(target),
            "rows": len(run.time),
            "inputs": list(run.inputs),
            "outputs": list(run.outputs),
            "discretisation": run.discretisation,
            "report": str(report) if report else None,
        },
        indent=2,
    )


def _target(path: Path, inputs: Path | None) -> Path:
    """``path``, unless it cannot be written or is the file that is read."""
    if path.is_dir():
        raise GreyboxError(f"--output {path}: it is a folder; give a file that ends in .csv")
    if path.suffix.lower() != ".csv":
        raise GreyboxError(f"--output {path}: the record is written as CSV; give a file that ends in .csv")
    if inputs is not None and path.exists() and inputs.exists() and path.samefile(inputs):
        raise GreyboxError(f"--output {path}: it is the input file, which would be overwritten; give another file")
    check_writable(path.parent)
    return path


def _one_drive(
    model: Model,
    inputs: Path | None,
    shapes: Mapping[str, float | None],
    shaping: Mapping[str, object],
    study: Study,
) -> dict[str, float]:
    """The test signal that is wanted, none beside a file of inputs; refuses two drives, and options that would change nothing."""
    chosen = {name: size for name, size in shapes.items() if size is not None}
    if (inputs is not None) + len(chosen) != 1 and model.inputs:
        raise GreyboxError(f"{model.title}: give either a file with inputs or one of {', '.join(shapes)}")
    banded = "--multisine" in chosen or "--chirp" in chosen
    idle = [
        name for name, value in shaping.items() if value and (inputs is not None or (name == "--band" and not banded))
    ]
    if inputs is None:
        idle += [study.label(name) for name in ("columns", "headers", "read_limit") if getattr(study, name)]
    if idle:
        beside = "this test signal" if inputs is None else "a file of inputs"
        raise GreyboxError(
            f"{', '.join(idle)}: no effect beside {beside}; leave {'it' if len(idle) == 1 else 'them'} out"
        )
    return chosen


# Rows of a simulated test signal; more would fill the memory before a word is written.
MAXIMUM_SIMULATED_ROWS = 10000000


def _signal(
    model: Model,
    chosen: dict[str, float],
    band: str | None,
    offset: float,
    duration: float | None,
    sampling_time: float | None,
    hold: str,
    generator: object,
) -> Experiment:
    """The test signal on the first input, at the wanted pace."""
    import numpy as np

    from greybox.data.experiment import Experiment
    from greybox.data.signals import chirp, multisine

    if not duration or not sampling_time or duration <= 0 or sampling_time <= 0:
        raise GreyboxError("a test signal needs --duration and --sampling-time, both above 0 seconds")
    rows = round(duration / sampling_time)
    if not 2 <= rows <= MAXIMUM_SIMULATED_ROWS:
        raise GreyboxError(
            f"--duration {duration:g} over --sampling-time {sampling_time:g} gives {rows} rows; give 2 to {MAXIMUM_SIMULATED_ROWS}"
        )
    time = sampling_time * np.arange(rows)
    u = np.full(rows, offset)
    for shape, size in chosen.items():
        if shape == "--step":
            u += size
        elif shape == "--chirp":
            u += chirp(time, *_band(band), size)
        else:
            u += multisine(time, *_band(band), size, generator)  # type: ignore[arg-type]
    inputs = {i.name: u if k == 0 else np.zeros(rows) for k, i in enumerate(model.inputs)}
    return Experiment("simulated", time, inputs, {}, hold)  # type: ignore[arg-type]


def _band(text: str | None) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in (text or "").split(":"))
    except ValueError:
        raise GreyboxError(f"--band {text or '(not given)'}: write it as LOW:HIGH in Hz, as in --band 5:800") from None
    if not 0 <= low < high:
        raise GreyboxError(f"--band {text}: the low end must be at least 0 and below the high end")
    return low, high
