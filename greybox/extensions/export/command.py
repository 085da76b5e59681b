"""`greybox export`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base import GreyboxError, Severity
from greybox.base.extensions import ExtensionKind, extension_names, load_extension
from greybox.base.texts import to_word
from greybox.extensions.export.target import ExportTarget
from greybox.shell import options
from greybox.shell.inputs import check_writable, load_fit_with_model
from greybox.shell.study import Answer, Command, Idle, Needs, Option, Study
from greybox.shell.study_values import Choice, Count, MaybeNumber, Number, Numbers, Switch
from greybox.shell.terminal import print_note, write_report

if TYPE_CHECKING:
    from greybox.estimation.linear.linearisation import Linearisation
    from greybox.estimation.linear.model_family import ModelFamily
    from greybox.estimation.result import Fit
    from greybox.extensions.export.document import Export
    from greybox.shell.answers import CodeAnswer, LinearAnswer


class ExportStudy(Study):
    """The options of `greybox export`."""

    # A table: an option is a row or two.
    # fmt: off
    # The choices: the targets of this package, then those of others. Their modules are loaded when one is chosen.
    to = Option(Choice(extension_names(ExtensionKind.EXPORTS), start=""), "--to", "to",
        "Linear (control: Python file, mat: MATLAB, json, numpy), or the nonlinear one (c, fmu, modelica, python, casadi).", required=True)
    at = Option(Numbers(), "--at NAME=VALUE", "at.",
        "A state or input of the operating point, in the model's unit; the other values are solved for.")
    dt = Option(MaybeNumber(), "--dt SECONDS", "dt", "Sampling time. [default: linear models continuous, else as recorded]")
    sampling = Option(Choice(("zoh", "tustin"), start=""), "--method", "method",
        "Exact for a held input (zoh) or the trapezoidal rule (tustin). [default: zoh]")
    delay = Option(Number(), "--delay SECONDS", "delay", "Delay of every input; need not be a multiple of the sampling time.")
    minimal = Option(Switch(), "--minimal", "minimal", "Remove states that are not controllable or not observable.")
    samples = Option(Count(), "--samples N", "samples", "Add N models drawn from the parameters' covariance.")
    sample_seed = Option(Count(), "--seed N", "seed", "Seed of --samples.")
    observer = Option(Switch(), "--observer", "observer",
        "With c, fmu and python: write the Kalman filter of the model, extended where it is nonlinear.")
    observer_noise = Option(Numbers("STATE=VALUE", "v=1e-3"), "--process-noise STATE=VALUE", "observer_noise.",
        "Process noise for --observer, in the state's unit over sqrt(s). [default: of the fit, or of its records]")
    # fmt: on


def export(study: ExportStudy) -> Answer:
    """Export a fitted model for controller design: linear with its uncertainty, or as code.

    Linear models are computed at an operating point (--at; an equilibrium is solved for) and printed with poles, zeros, gain
    and bandwidth. C and FMU contain the sampled nonlinear model exactly, with dry friction, delays and play. Also writes
    FILE.html, a report, for each FILE.

    Exit code 0: written. 2: bad input, nothing was written.
    """
    from greybox.base import to_identifier

    kind = _kind(study)
    result = load_fit_with_model(Path(study.source), study.model)
    name = to_identifier(result.model.name)
    ending = kind.ending or (f"_observer{kind.suffix}" if study.observer else kind.suffix)
    # With the suffix of its kind, unless it cannot be written or is the file that is read.
    path = study.output or Path("results") / f"{name}-export" / f"{name}{ending}"
    if path.is_dir():
        raise GreyboxError(f"--output {path}: it is a folder; give a file that ends in {kind.suffix}")
    if path.suffix and path.suffix != kind.suffix:
        raise GreyboxError(f"--output {path}: --to {study.to} writes {kind.suffix}; give a file with that suffix")
    target = path.with_suffix(kind.suffix)
    if target.exists() and target.samefile(study.source):
        raise GreyboxError(f"--output {path}: it is the input file, which would be overwritten; give another file")
    check_writable(target.parent)
    answer, made = _linear(result, kind, target, study) if kind.linear else _code(result, kind, target, study)
    first = to_word(str(made.files[0]))
    return Answer(
        answer,
        lambda report: _as_json(made, study.to, report),
        made.files,
        next=next(
            (command.format(first) for ending, command in USES.items() if str(made.files[0]).endswith(ending)), ""
        ),
        page=lambda: write_report(made, target.with_name(f"{target.name}.html")),
    )


# Ending of what was written -> the command that shows that it works.
USES = {".py": "python {}", ".fmu": "greybox check {}", ".c": "cc -std=c99 -c {}", ".h": "cc -std=c99 -fsyntax-only {}"}


def _kind(study: ExportStudy) -> ExportTarget:
    kind: ExportTarget = load_extension(ExtensionKind.EXPORTS, study.to)
    return kind


def _as_json(made: Export, to: str, report: Path | None) -> str:
    from greybox.base import format_json, to_json_data
    from greybox.estimation.linear.exported_model import to_plant
    from greybox.extensions.export.linear_files import LinearFile, PrintedExport

    printed: PrintedExport = {
        "target": to,
        "files": [str(file) for file in made.files],
        "report": str(report) if report else None,
        "linear": LinearFile(made.linear, to_plant(made.fit, with_equations=False), made.family)
        if made.linear
        else None,
    }
    return format_json(to_json_data(printed))


def _linear(fit: Fit, kind: ExportTarget, target: Path, study: ExportStudy) -> tuple[LinearAnswer | CodeAnswer, Export]:
    from dataclasses import replace

    from greybox.estimation.linear.exported_model import to_plant
    from greybox.estimation.linear.linearisation import minimal_realisation
    from greybox.estimation.linear.linearise import linearise
    from greybox.estimation.linear.model_family import sample_family
    from greybox.extensions.export.document import Export
    from greybox.shell.answers import LinearAnswer

    at, samples = dict(study.at), study.samples
    sampled: dict[str, Any] = {"dt": study.dt, "method": study.sampling or "zoh", "delay": study.delay}
    whole: Linearisation = linearise(fit, at, **sampled)
    linear = minimal_realisation(whole) if study.minimal else whole
    drawn: ModelFamily | None = (
        sample_family(fit, at, number=samples, seed=study.sample_seed, minimal=study.minimal, **sampled)
        if samples
        else None
    )
    plant = to_plant(fit, with_equations=False)
    for finding in (*whole.findings, *(drawn.findings if drawn else ())):
        # The file is written whatever is doubtful: an error of the fit is a warning here.
        print_note(f"{'note' if finding.severity is Severity.NOTE else 'warning'}: {finding}")
    written = _write(kind, linear, target, plant=plant, family=drawn)
    # Findings of the whole model went to stderr above; those of the reduction belong to what is shown.
    shown = replace(linear, findings=linear.findings[len(whole.findings) :])
    family = None if drawn is None else replace(drawn, findings=())
    return LinearAnswer(shown, family), Export(fit, kind.description, written, linear, drawn)


def _code(fit: Fit, kind: ExportTarget, target: Path, study: ExportStudy) -> tuple[LinearAnswer | CodeAnswer, Export]:
    from greybox.estimation.linear.exported_model import to_plant
    from greybox.extensions.export.document import Export
    from greybox.extensions.export.observer import design_observer
    from greybox.shell.answers import CodeAnswer

    for finding in to_plant(fit).findings:
        print_note(f"warning: {finding}")
    dt, substeps = study.dt, study.substeps
    if study.observer:
        observer = design_observer(fit, dt, process_noise=dict(study.observer_noise) or None, substeps=substeps)
        files = _write(kind, observer, target)
        what = f"{kind.description.replace('model file', 'file')}, its Kalman filter"
        return CodeAnswer(fit.model.title, what, observer.dt, "step"), Export(fit, what, files)
    given = {"dt": dt, "substeps": substeps}
    files = _write(kind, fit, target, **{name: given[name] for name in given if name in kind.options})
    step = dt if dt is not None or not kind.stepped else to_plant(fit).sampling_time
    answer = CodeAnswer(fit.model.title, kind.description, step, kind.stepped or "step")
    return answer, Export(fit, kind.description, files)


def _write(kind: ExportTarget, source: Any, target: Path, **given: Any) -> tuple[Path, ...]:
    target.parent.mkdir(parents=True, exist_ok=True)  # whoever writes a target need not think of it
    files = kind.write(source, target, **given)
    return (files,) if isinstance(files, Path) else files


def _unless(has: Callable[[ExportTarget, ExportStudy], bool]) -> Callable[[ExportStudy], bool]:
    return lambda study: not has(_kind(study), study)


def _is_sampled(kind: ExportTarget, study: ExportStudy) -> bool:
    return "dt" in kind.options or study.observer


OWN = ExportStudy
LINEAR = (OWN.at, OWN.sampling, OWN.delay, OWN.minimal, OWN.samples, OWN.sample_seed)

EXPORT = Command(
    export,
    "Export a fitted model for controller design, or as code.",
    (
        *(Study.source.but(usage="FIT.json"), OWN.to, OWN.dt, *LINEAR, Study.substeps),
        *(OWN.observer, OWN.observer_noise),
        options.model_of("the fit"),
        Study.output.but(usage="--output FILE", help="File to write. [default: results/MODEL-export/MODEL.*]"),
        *options.SHOWING,
    ),
    (
        "greybox export results/micro_actuator-fit/fit.json --to mat --dt 2.5e-4 --delay 1e-4 --samples 100",
        "greybox export fit.json --to control --at u=1",
        "greybox export fit.json --to c --output firmware/plant.c",
    ),
    (
        Idle(LINEAR, "with --to {s.to}", _unless(lambda kind, _: kind.linear)),
        Idle((OWN.dt,), "with --to {s.to}", _unless(lambda kind, study: kind.linear or _is_sampled(kind, study))),
        Idle((Study.substeps,), "with --to {s.to}", _unless(_is_sampled)),
        Idle((OWN.observer,), "with --to {s.to}", _unless(lambda kind, _: "observer" in kind.options)),
        Idle((OWN.samples,), "with --to {s.to}", _unless(lambda kind, _: "samples" in kind.options)),
        Needs(OWN.sampling, (OWN.dt,), "it samples the model"),
        Needs(OWN.sample_seed, (OWN.samples,), "no models are drawn"),
        Needs(OWN.observer_noise, (OWN.observer,), "it is the noise of a Kalman filter"),
    ),
    study=ExportStudy,
)

PRINTS = {"export": ("greybox.extensions.export.linear_files:PrintedExport",)}
"""Command -> types of what it prints with ``--json``."""
