"""`greybox export`."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from greybox.base.errors import GreyboxError
from greybox.base.extensions import ExtensionKind, extension_names, load_extension
from greybox.extensions.export.target import ExportTarget
from greybox.shell.inputs import load_fit_with_model
from greybox.shell.options import NoReport, Texts, check_writable
from greybox.shell.study import FIT, SPECS
from greybox.shell.study_values import parse_numbers
from greybox.shell.terminal import Command, print_note, write_report

if TYPE_CHECKING:
    from greybox.estimation.linear.linearisation import Linearisation
    from greybox.estimation.linear.model_family import ModelFamily
    from greybox.estimation.result import Fit
    from greybox.extensions.export.page import Export
    from greybox.shell.answers import CodeAnswer, LinearAnswer


if TYPE_CHECKING:
    Target = StrEnum
else:
    # The choices of --to: the targets of this package, then those of others. Their modules are loaded when one is chosen.
    Target = StrEnum("Target", {name: name for name in extension_names(ExtensionKind.EXPORTS)})


class Sampling(StrEnum):
    """How a linear model is sampled."""

    zoh = "zoh"
    tustin = "tustin"


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

    kind: ExportTarget = load_extension(ExtensionKind.EXPORTS, to.value)
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
    _refuse_idle(to.value, kind, dt, method, given, substeps, observer)
    if noise and not observer:
        raise GreyboxError("--process-noise has no effect without --observer")
    result = load_fit_with_model(fit, model)
    name = to_identifier(result.model.name)
    ending = kind.ending or (f"_observer{kind.suffix}" if observer else kind.suffix)
    target = _target(output or Path("results") / f"{name}-export" / f"{name}{ending}", to.value, kind, fit)
    answer: Any
    if kind.linear:
        answer, made = _linear(result, kind, target, point, dt, method or Sampling.zoh, delay, minimal, samples, seed)
    else:
        answer, made = _code(result, kind, target, dt, substeps, noise if observer else None)
    report = None if no_report else write_report(made, target.with_name(f"{target.name}.html"))
    if json:
        typer.echo(_as_json(made, to.value, report))
    else:
        typer.echo("\n".join([str(answer), *([report_line(report)] if report else [])]))


def _as_json(made: Export, to: str, report: Path | None) -> str:
    from greybox.base.json_shape import format_json, to_json_data
    from greybox.estimation.linear.plant import to_plant
    from greybox.extensions.export.linear_files import LinearFile, PrintedExport

    printed: PrintedExport = {
        "target": to,
        "files": [str(file) for file in made.files],
        "report": str(report) if report else None,
        "linear": LinearFile(made.linear, to_plant(made.fit), made.family) if made.linear else None,
    }
    return format_json(to_json_data(printed))


def _linear(
    fit: Fit,
    kind: ExportTarget,
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
    from greybox.extensions.export.page import Export
    from greybox.shell.answers import LinearAnswer

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
    written = _write(kind, linear, target, plant=plant, family=drawn)
    # Findings of the whole model went to stderr above; those of the reduction belong to what is shown.
    shown = replace(linear, findings=linear.findings[len(whole.findings) :])
    family = None if drawn is None else replace(drawn, findings=())
    return LinearAnswer(shown, family, written), Export(fit, kind.description, written, linear, drawn)


def _code(
    fit: Fit,
    kind: ExportTarget,
    target: Path,
    dt: float | None,
    substeps: int,
    observer_noise: Mapping[str, float] | None = None,
) -> tuple[CodeAnswer, Export]:
    """``observer_noise``: process noise of an observer, empty for that of the fit; None for the model itself."""
    from greybox.estimation.linear.plant import to_plant
    from greybox.extensions.export.observer import design_observer
    from greybox.extensions.export.page import Export
    from greybox.shell.answers import CodeAnswer

    for finding in to_plant(fit).findings:
        print_note(f"warning: {finding}")
    if observer_noise is not None:
        observer = design_observer(fit, dt, process_noise=observer_noise or None, substeps=substeps)
        files = _write(kind, observer, target)
        what = f"{kind.description.replace('model file', 'file')}, its Kalman filter"
        return CodeAnswer(fit.model.title, what, observer.dt, "step", files), Export(fit, what, files)
    given = {"dt": dt, "substeps": substeps}
    files = _write(kind, fit, target, **{name: given[name] for name in given if name in kind.options})
    step = dt if dt is not None or not kind.stepped else to_plant(fit).sampling_time
    answer = CodeAnswer(fit.model.title, kind.description, step, kind.stepped or "step", files)
    return answer, Export(fit, kind.description, files)


def _write(kind: ExportTarget, source: Any, target: Path, **options: Any) -> tuple[Path, ...]:
    target.parent.mkdir(parents=True, exist_ok=True)  # whoever writes a target need not think of it
    files = kind.write(source, target, **options)
    return (files,) if isinstance(files, Path) else files


def _refuse_idle(
    to: str,
    kind: ExportTarget,
    dt: float | None,
    method: Sampling | None,
    given: Mapping[str, object],
    substeps: int,
    observer: bool = False,
) -> None:
    """Refuse options that would change nothing."""
    idle = [name for name, value in given.items() if value] if not kind.linear else []
    is_sampled = "dt" in kind.options or observer
    idle += ["--dt"] if dt is not None and not kind.linear and not is_sampled else []
    idle += ["--substeps"] if substeps and not is_sampled else []
    idle += ["--observer"] if observer and "observer" not in kind.options else []
    if kind.linear and given["--samples"] and "samples" not in kind.options:
        idle += ["--samples"]
    if idle:
        raise GreyboxError(
            f"{', '.join(idle)}: no effect with --to {to}; leave {'it' if len(idle) == 1 else 'them'} out"
        )
    if method is not None and dt is None:
        raise GreyboxError(f"--method {method.value} samples the model; give --dt SECONDS too")
    if given["--seed"] and not given["--samples"]:
        raise GreyboxError("--seed has no effect without --samples N")


def _target(path: Path, to: str, kind: ExportTarget, fit: Path) -> Path:
    """``path`` with its suffix, unless it cannot be written or is the file that is read."""
    if path.is_dir():
        raise GreyboxError(f"--output {path}: it is a folder; give a file that ends in {kind.suffix}")
    if path.suffix and path.suffix != kind.suffix:
        raise GreyboxError(f"--output {path}: --to {to} writes {kind.suffix}; give a file with that suffix")
    target = path.with_suffix(kind.suffix)
    if target.exists() and target.samefile(fit):
        raise GreyboxError(f"--output {path}: it is the input file, which would be overwritten; give another file")
    check_writable(target.parent)
    return target


EXPORT = Command(
    export,
    "Export a fitted model for controller design, or as code.",
    (
        "greybox export results/micro_actuator-fit/fit.json --to mat --dt 2.5e-4 --delay 1e-4 --samples 100",
        "greybox export fit.json --to control --at u=1",
        "greybox export fit.json --to c --output firmware/plant.c",
    ),
)

PRINTS = {"export": ("greybox.extensions.export.linear_files:PrintedExport",)}
"""Command -> types of what it prints with ``--json``."""
