"""`greybox export`."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greybox.base.errors import DataError, GreyboxError, ModelError
from greybox.shell.answers import CodeAnswer, LinearAnswer
from greybox.shell.options import NoReport, Texts, check_writable
from greybox.shell.study import FIT, SPECS
from greybox.shell.study_values import parse_numbers
from greybox.shell.terminal import print_note, write_report

if TYPE_CHECKING:
    from greybox.estimation.linear.linearisation import Linearisation
    from greybox.estimation.linear.model_family import ModelFamily
    from greybox.estimation.result import Fit
    from greybox.extensions.export.page import Export


class Target(StrEnum):
    """What to write."""

    control = "control"
    mat = "mat"
    json = "json"
    numpy = "numpy"
    c = "c"
    fmu = "fmu"
    modelica = "modelica"
    python = "python"
    casadi = "casadi"


class Sampling(StrEnum):
    """How a linear model is sampled."""

    zoh = "zoh"
    tustin = "tustin"


LINEAR = (Target.control, Target.mat, Target.json, Target.numpy)
STEPPED = (Target.c, Target.fmu)
OBSERVED = (Target.c, Target.fmu, Target.python)
SUFFIX = {
    Target.control: ".py",
    Target.mat: ".mat",
    Target.json: ".json",
    Target.numpy: ".npz",
    Target.c: ".c",
    Target.fmu: ".fmu",
    Target.modelica: ".mo",
    Target.python: ".py",
    Target.casadi: ".casadi",
}

KIND = {
    Target.control: "a Python file for python-control",
    Target.mat: "a MATLAB file",
    Target.json: "JSON",
    Target.numpy: "NumPy arrays",
    Target.c: "C",
    Target.fmu: "an FMU 2.0 for co-simulation",
    Target.modelica: "Modelica",
    Target.python: "a Python model file",
    Target.casadi: "a CasADi function",
}


def export(
    fit: Annotated[Path, typer.Argument(metavar="FIT.json", help="The fit.json that greybox fit has written.")],
    *,
    to: Annotated[
        Target,
        typer.Option(
            "--to",
            help="Linear (control: Python file, mat: MATLAB, json, numpy), or the nonlinear one (c, fmu, modelica, python, casadi).",
        ),
    ],
    at: Annotated[
        Texts,
        typer.Option(
            "--at",
            metavar="NAME=VALUE",
            default_factory=list,
            help="A state or input of the operating point, in the model's unit; the other values are solved for.",
        ),
    ],
    dt: Annotated[
        float | None,
        typer.Option(
            "--dt", metavar="SECONDS", help="Sampling time. [default: linear models continuous, else as recorded]"
        ),
    ] = None,
    method: Annotated[
        Sampling | None,
        typer.Option("--method", help="Exact for a held input (zoh) or the trapezoidal rule (tustin). [default: zoh]"),
    ] = None,
    delay: Annotated[
        float,
        typer.Option(
            "--delay", metavar="SECONDS", help="Delay of every input; need not be a multiple of the sampling time."
        ),
    ] = 0.0,
    minimal: Annotated[
        bool, typer.Option("--minimal", help="Remove states that are not controllable or not observable.")
    ] = False,
    samples: Annotated[
        int, typer.Option("--samples", metavar="N", min=0, help="Add N models drawn from the parameters' covariance.")
    ] = 0,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of --samples.")] = 0,
    substeps: Annotated[int, typer.Option("--substeps", metavar="N", min=0, help=SPECS["substeps"].help_for(FIT))] = 0,
    observer: Annotated[
        bool,
        typer.Option(
            "--observer",
            help="With c, fmu and python: write the Kalman filter of the model, extended where it is nonlinear.",
        ),
    ] = False,
    process_noise: Annotated[
        Texts,
        typer.Option(
            "--process-noise",
            metavar="STATE=VALUE",
            default_factory=list,
            help="Process noise for --observer, in the state's unit over sqrt(s). [default: of the fit, or of its records]",
        ),
    ],
    model: Annotated[
        str | None,
        typer.Option(
            "--model", metavar="MODEL", help="The model of the fit, or its file, if it is not found by its name."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="FILE", help="File to write. [default: results/MODEL-export/MODEL.*]"),
    ] = None,
    no_report: NoReport = False,
    json: Annotated[bool, typer.Option("--json", help="Print the matrices and what was written as JSON.")] = False,
) -> None:
    """Export a fitted model for controller design: linear with its uncertainty, or as code.

    Linear models are computed at an operating point (--at; an equilibrium is solved for) and printed with poles, zeros, gain
    and bandwidth. C and FMU contain the sampled nonlinear model exactly, with dry friction, delays and play. Also writes
    FILE.html, a report, for each FILE.

    Exit code 0: written. 2: bad input, nothing was written.
    """
    from greybox.base.texts import to_identifier
    from greybox.show.sentences.shell import report_line

    point = parse_numbers("--at", at)
    given = {
        "--at": point,
        "--method": method,
        "--delay": delay,
        "--minimal": minimal,
        "--samples": samples,
        "--seed": seed,
    }
    noise = parse_numbers("--process-noise", process_noise)
    _refuse_idle(to, dt, method, given, substeps, observer)
    if noise and not observer:
        raise GreyboxError("--process-noise has no effect without --observer")
    result = load_fit_with_model(fit, model)
    name = to_identifier(result.model.name)
    suffix = "_ss.py" if to is Target.control else f"_observer{SUFFIX[to]}" if observer else SUFFIX[to]
    target = _target(output or Path("results") / f"{name}-export" / f"{name}{suffix}", to, fit)
    answer: LinearAnswer | CodeAnswer
    if to in LINEAR:
        answer, made = _linear(result, to, target, point, dt, method or Sampling.zoh, delay, minimal, samples, seed)
    else:
        answer, made = _code(result, to, target, dt, substeps, noise if observer else None)
    report = None if no_report else write_report(made, target.with_name(f"{target.name}.html"))
    if json:
        typer.echo(_as_json(made, to, report))
    else:
        typer.echo("\n".join([str(answer), *([report_line(report)] if report else [])]))


def _as_json(made: Export, to: Target, report: Path | None) -> str:
    from greybox.estimation.linear.plant import to_plant
    from greybox.estimation.result_parts import format_json
    from greybox.extensions.export.linear_files import linear_model_data

    linear = linear_model_data(made.linear, to_plant(made.fit), made.family) if made.linear else None
    files = [str(file) for file in made.files]
    return format_json(
        {"target": to.value, "files": files, "report": str(report) if report else None, "linear": linear}
    )


def _linear(
    fit: Fit,
    to: Target,
    target: Path,
    at: Mapping[str, float],
    dt: float | None,
    method: Sampling,
    delay: float,
    minimal: bool,
    samples: int,
    seed: int,
) -> tuple[LinearAnswer, Export]:
    from dataclasses import replace

    from greybox.estimation.linear.linearisation import minimal_realisation
    from greybox.estimation.linear.linearise import linearise
    from greybox.estimation.linear.model_family import sample_family
    from greybox.estimation.linear.plant import to_plant
    from greybox.extensions.export.linear_files import LINEAR_FORMATS
    from greybox.extensions.export.page import Export

    whole: Linearisation = linearise(fit, at, dt=dt, method=method.value, delay=delay)
    linear = minimal_realisation(whole) if minimal else whole
    drawn: ModelFamily | None = (
        sample_family(fit, at, number=samples, seed=seed, dt=dt, method=method.value, delay=delay, minimal=minimal)
        if samples
        else None
    )
    plant = to_plant(fit)
    for finding in (*whole.findings, *(drawn.findings if drawn else ())):
        print_note(f"warning: {finding}")
    written = LINEAR_FORMATS[to.value](linear, target, plant=plant, family=drawn)
    # Findings of the whole model went to stderr above; those of the reduction belong to what is shown.
    shown = replace(linear, findings=linear.findings[len(whole.findings) :])
    family = None if drawn is None else replace(drawn, findings=())
    return LinearAnswer(shown, family, (written,)), Export(fit, KIND[to], (written,), linear, drawn)


def _code(
    fit: Fit,
    to: Target,
    target: Path,
    dt: float | None,
    substeps: int,
    observer_noise: Mapping[str, float] | None = None,
) -> tuple[CodeAnswer, Export]:
    """``observer_noise``: process noise of an observer, empty for that of the fit; None for the model itself."""
    from greybox.base.files import write_file
    from greybox.estimation.linear.plant import to_plant
    from greybox.extensions.export.c_code import to_c
    from greybox.extensions.export.casadi_model import to_casadi
    from greybox.extensions.export.fmu import to_fmu
    from greybox.extensions.export.modelica import to_modelica
    from greybox.extensions.export.observer import design_observer
    from greybox.extensions.export.page import Export
    from greybox.extensions.export.python_model import to_python

    for finding in to_plant(fit).findings:
        print_note(f"warning: {finding}")
    files: tuple[Path, ...]
    if observer_noise is not None:
        observer = design_observer(fit, dt, process_noise=observer_noise or None, substeps=substeps)
        files = (
            to_c(observer, target)[::-1]
            if to is Target.c
            else ((to_fmu if to is Target.fmu else to_python)(observer, target),)
        )
        kind = f"{KIND[to].replace('model file', 'file')}, its Kalman filter"
        return CodeAnswer(fit.model.title, kind, observer.dt, "step", files), Export(fit, kind, files)
    step = (dt if dt is not None else to_plant(fit).sampling_time) if to in STEPPED else None
    if to is Target.c:
        source, header = to_c(fit, target, dt=dt, substeps=substeps)
        files = (header, source)
    elif to is Target.casadi:
        files = (write_file(target, to_casadi(fit, dt, substeps=substeps).serialize()),)
        step = dt
    elif to is Target.fmu:
        files = (to_fmu(fit, target, dt=dt, substeps=substeps),)
    else:
        files = ((to_modelica if to is Target.modelica else to_python)(fit, target),)
    step_name = "one step of" if to is Target.c else "step"
    return CodeAnswer(fit.model.title, KIND[to], step, step_name, files), Export(fit, KIND[to], files)


def _refuse_idle(
    to: Target,
    dt: float | None,
    method: Sampling | None,
    given: Mapping[str, object],
    substeps: int,
    observer: bool = False,
) -> None:
    """Refuse options that would change nothing."""
    idle = [name for name, value in given.items() if value] if to not in LINEAR else []
    is_sampled = to in (*STEPPED, Target.casadi) or observer
    idle += ["--dt"] if dt is not None and to not in LINEAR and not is_sampled else []
    idle += ["--substeps"] if substeps and not is_sampled else []
    idle += ["--observer"] if observer and to not in OBSERVED else []
    if to is Target.control and given["--samples"]:
        idle += ["--samples"]
    if idle:
        raise GreyboxError(
            f"{', '.join(idle)}: no effect with --to {to.value}; leave {'it' if len(idle) == 1 else 'them'} out"
        )
    if method is not None and dt is None:
        raise GreyboxError(f"--method {method.value} samples the model; give --dt SECONDS too")
    if given["--seed"] and not given["--samples"]:
        raise GreyboxError("--seed has no effect without --samples N")


def _target(path: Path, to: Target, fit: Path) -> Path:
    """``path`` with its suffix, unless it cannot be written or is the file that is read."""
    if path.is_dir():
        raise GreyboxError(f"--output {path}: it is a folder; give a file that ends in {SUFFIX[to]}")
    if path.suffix and path.suffix != SUFFIX[to]:
        raise GreyboxError(f"--output {path}: --to {to.value} writes {SUFFIX[to]}; give a file with that suffix")
    target = path.with_suffix(SUFFIX[to])
    if target.exists() and target.samefile(fit):
        raise GreyboxError(f"--output {path}: it is the input file, which would be overwritten; give another file")
    check_writable(target.parent)
    return target


def load_fit_with_model(path: Path, model: str | None = None) -> Fit:
    """The fit in ``path``. ``model`` names its model or model file (None: the name that the file holds).

    A file that the fit names in place of a model is not run: only the user may name one. Effects of the catalogue that the fit
    has and the model lacks are added. Raises DataError for a file that is no fit, ModelError where its model cannot be found.
    """
    from greybox.base.json_file import ResultKind, read_json
    from greybox.estimation.result import restore_fit
    from greybox.model.effects.catalogue import effect
    from greybox.shell.project import find_model, is_model_path

    data = read_json(path, ResultKind.FIT)
    if model is None and is_model_path(data["model"]):
        raise DataError(
            f"{path}: its model {data['model']!r} is a file, and a fit names its model without a path; give --model MODEL"
        )
    try:
        plant = find_model(model or data["model"])
        present = [e.name for e in plant.effects]
        for name in data["effects"]:
            plant = plant if name in present else plant + effect(name)
    except ModelError as error:
        raise ModelError(f"{path}: its model cannot be found: {error}; name its file with --model my/rig.py") from None
    return restore_fit(data, plant, str(path))
