"""`greybox simulate`."""

from __future__ import annotations

import json as json_format
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from greybox.base import ExitCode, GreyboxError
from greybox.shell import inputs, options
from greybox.shell.study import Answer, Command, Idle, Needs, Study
from greybox.shell.study_values import Numbers
from greybox.shell.terminal import CommandCode, exit_with_error, print_findings, print_note, write_report

if TYPE_CHECKING:
    from greybox.data.experiment import Experiment
    from greybox.model import Model
    from greybox.simulation.simulate import Simulation


def simulate(study: Study) -> Answer:
    """Simulate MODEL with the inputs of a file or with a test signal, and write a CSV file that greybox fit reads.

    A test signal drives the first input; the other inputs are zero. The simulation starts at the initial state of the model, unless
    --initial or --settled says otherwise. A fit, its fit.json or its folder, can stand in the place of MODEL: it has the fitted values.
    With --output FILE.csv, also writes FILE.html, a report with the run, the states and the equations.

    Exit code 0: done. 1: the simulation overflows or leaves a --limit, nothing was written. 2: bad input, nothing was written.
    """
    import numpy as np

    from greybox.base import format_unit
    from greybox.data.findings import RecordCode
    from greybox.data.sampling import find_longest_time_gap
    from greybox.simulation.simulate import read_inputs, write_csv
    from greybox.simulation.simulate import simulate as simulate_model

    plant = inputs.set_parameters(inputs.add_effects(inputs.find_plain_model(study), study.effects), study)
    target = _target(study.output or Path("results") / f"{plant.name}-simulated.csv", study.input)
    inputs.check_substeps(study, plant)
    noise_std = dict(study.noise)
    generator = np.random.default_rng(study.draws)
    chosen = _one_drive(plant, study)
    if study.input is not None:
        experiment = read_inputs(study.input, plant, hold=study.hold, **inputs.layout_of(study))  # type: ignore[arg-type]
        gap = find_longest_time_gap(experiment.time, code=RecordCode.INPUT_HELD_THROUGH_GAP)
        if gap is not None:
            print_note(f"note: {experiment.source}: {gap}")
        _say_where_it_begins(plant, study)
    else:
        experiment = _signal(plant, chosen, study, generator)
    run = simulate_model(
        plant,
        experiment,
        initial=dict(study.initial),
        settled=study.settled,
        method=study.method,
        substeps=study.substeps,
    )
    if run.overflow is not None:
        exit_with_error(
            f"{plant.title}: the simulation overflows {run.overflow:.4g} s after its start; nothing was written",
            ExitCode.UNSUCCESSFUL,
        )
    inputs.refuse_broken_limits(run, inputs.limits_of(study))
    write_csv(run.record(noise_std, generator), plant, target)
    from greybox.shell.answers import SimulationAnswer

    units = {q.name: format_unit(q.unit) for q in plant.outputs}
    added = ", ".join(f"{name} {std:g} {units[name]}".rstrip() for name, std in noise_std.items())
    return Answer(
        SimulationAnswer(run, plant, added),
        lambda report: _as_json(run, target, report),
        [target],
        # What was simulated to be seen, with the inputs of a file, is a prediction: a fit to it would find the model again.
        next=study.then("fit", study.model, target, holds=options.IN_RECORD)
        if plant.free_parameters and study.input is None
        else "",
        page=(lambda: write_report(run, target.with_suffix(".html"), model=plant, noise=added))
        if study.output
        else None,
    )


# States that are named where a run begins.
NAMED_STATES = 6


def _say_where_it_begins(plant: Model, study: Study) -> None:
    """Say from which state a run with the inputs of a file begins, where nobody has chosen it."""
    from greybox.base import Finding, format_unit
    from greybox.simulation.simulate import declared_initial_state

    states = [s for s in plant.all_states if s.name not in study.initial]
    if study.settled or not states:
        return
    begin = dict(zip((s.name for s in plant.all_states), declared_initial_state(plant, study.initial), strict=True))
    named = [f"{s.name} = {begin[s.name]:.4g} {format_unit(s.unit)}".rstrip() for s in states]
    listed = ", ".join(named[:NAMED_STATES]) + f" and {len(named) - NAMED_STATES} more" * (len(named) > NAMED_STATES)
    print_findings([Finding(CommandCode.STARTS_AS_DECLARED, subject=states[0].name, values={"states": listed})])


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


def _target(path: Path, source: Path | None) -> Path:
    """``path``, unless it cannot be written or is the file that is read."""
    if path.is_dir():
        raise GreyboxError(f"--output {path}: it is a folder; give a file that ends in .csv")
    if path.suffix.lower() != ".csv":
        raise GreyboxError(f"--output {path}: the record is written as CSV; give a file that ends in .csv")
    if source is not None and path.exists() and source.exists() and path.samefile(source):
        raise GreyboxError(f"--output {path}: it is the input file, which would be overwritten; give another file")
    inputs.check_writable(path.parent)
    return path


def _one_drive(model: Model, study: Study) -> Mapping[str, float]:
    """The test signal that is wanted, none beside a file of inputs; refuses two drives."""
    sizes = {option.name: getattr(study, option.name) for option in SHAPES}
    chosen = {name: size for name, size in sizes.items() if size is not None}
    if (study.input is not None) + len(chosen) != 1 and model.inputs:
        flags = ", ".join(option.flag for option in SHAPES)
        raise GreyboxError(f"{model.title}: give either a file with inputs or one of {flags}")
    return chosen


# Rows of a simulated test signal; more would fill the memory before a word is written.
MAXIMUM_SIMULATED_ROWS = 10000000


def _signal(model: Model, chosen: Mapping[str, float], study: Study, generator: object) -> Experiment:
    """The test signal on the first input, at the wanted pace."""
    import numpy as np

    from greybox.data.experiment import Experiment
    from greybox.data.signals import chirp, multisine

    duration, sampling_time = study.duration, study.sampling_time
    if not duration or not sampling_time:
        raise GreyboxError("a test signal needs --duration and --sampling-time, both above 0 seconds")
    rows = round(duration / sampling_time)
    if not 2 <= rows <= MAXIMUM_SIMULATED_ROWS:
        raise GreyboxError(
            f"--duration {duration:g} over --sampling-time {sampling_time:g} gives {rows} rows; give 2 to {MAXIMUM_SIMULATED_ROWS}"
        )
    time = sampling_time * np.arange(rows)
    u = np.full(rows, study.offset)
    for shape, size in chosen.items():
        if shape == "step":
            u += size
            continue
        if study.band is None:
            raise GreyboxError("--band (not given): write it as LOW:HIGH in Hz, as in --band 5:800")
        u += chirp(time, *study.band, size) if shape == "chirp" else multisine(time, *study.band, size, generator)  # type: ignore[arg-type]
    driven = {i.name: u if k == 0 else np.zeros(rows) for k, i in enumerate(model.inputs)}
    # The plant was at rest in the offset before the signal began, and in zero on the other inputs.
    before = {i.name: study.offset if k == 0 else 0.0 for k, i in enumerate(model.inputs)} | dict(study.before)
    return Experiment("simulated", time, driven, {}, study.hold, before=before)  # type: ignore[arg-type]


SHAPES = (Study.step, Study.multisine, Study.chirp)
SHAPING = (Study.offset, Study.duration)


SIMULATE = Command(
    simulate,
    "Simulate a model and write a record.",
    (
        *(Study.model, Study.input, Study.effects, Study.hold, Study.interpolation, Study.before, Study.columns),
        *(Study.headers, Study.read_limit, Study.method, Study.substeps, *SHAPES, Study.band, Study.offset),
        *(Study.initial, Study.settled, Study.draws),
        Study.duration.but(help="Duration of the test signal."),
        Study.sampling_time.but(help="Sampling time of the test signal, or of an INPUT without a time column."),
        Study.start.but(usage="--set --start NAME=VALUE", help="Value of a parameter, in its unit."),
        Study.fixed.but(help="Value of a parameter, in its unit."),
        Study.noise.but(
            kind=Numbers("OUTPUT=STD", "x=2e-7"),
            help="Standard deviation of white noise added to an output, in its unit.",
        ),
        Study.limits.but(
            help="Range of an input, output or state: a run that leaves it ends with exit code 1, as a rig's emergency stop would."
        ),
        Study.output.but(usage="--output FILE", help="CSV file to write. [default: results/MODEL-simulated.csv]"),
        *options.SHOWING,
    ),
    (
        "greybox simulate micro_actuator --step 1 --duration 0.2 --sampling-time 2.5e-4",
        "greybox simulate micro_actuator --multisine 2 --band 5:800 --duration 1.5 --sampling-time 2.5e-4 \\",
        "    --noise x=2e-7 --noise i=5e-3 --seed 1 --output record.csv",
        "greybox simulate my/rig.py input.csv --set K=5000 --output simulated.csv",
        "greybox simulate results/micro_actuator-fit input.csv --output predicted.csv",
    ),
    (
        *(options.LAYOUT, options.SUBSTEPS),
        Idle((Study.band, *SHAPING), "beside a file of inputs", lambda study: study.input is not None),
        Idle((Study.band,), "beside this test signal", lambda study: study.multisine is None and study.chirp is None),
        Idle(
            (Study.columns, Study.headers, Study.read_limit),
            "beside this test signal",
            lambda study: study.input is None,
        ),
        Needs(Study.draws, (Study.noise, Study.multisine), "nothing here is random"),
    ),
)
