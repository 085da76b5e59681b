"""From the fields of a study to the options of the commands, and the few options that are no part of a study."""

from __future__ import annotations

import functools
import inspect
import tempfile
import typing
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from greybox.base.errors import ExitCode, GreyboxError
from greybox.base.findings import Finding
from greybox.shell import completion
from greybox.shell.study import STUDY_COMMANDS, Spec, Study, fields_of
from greybox.shell.study_file import is_study_file, read_study, with_overrides
from greybox.shell.study_file import write_study as store_study
from greybox.shell.study_values import Count, Numbers
from greybox.shell.terminal import CommandCode, describe_missing_argument, exit_with_error, print_findings

STARTS_FILE = "starts.jsonl"
"""Finished starts of a command that was interrupted, in its output folder."""

Texts = list[str]
NoReport = Annotated[bool, typer.Option("--no-report", help="Do not write report.html.")]
Workers = Annotated[
    int,
    typer.Option(
        "--workers",
        metavar="N",
        min=0,
        help="Processes that share the work, on this machine or in --cluster local. [default: one for each core]",
        show_default=False,
    ),
]
Cluster = Annotated[
    str,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Scheduler of a Dask cluster that does the work, such as tcp://10.0.0.5:8786; local starts one here, to try.",
        show_default=False,
    ),
]


def repeated(*flags: str, metavar: str, text: str, complete: Callable[..., Any] | None = None) -> Any:
    """An option that may be given several times; ``text`` is its help, ``complete`` what a shell completes."""
    return typer.Option(*flags, metavar=metavar, default_factory=list, autocompletion=complete, help=text)


Limits = Annotated[
    Texts,
    repeated(
        "--limit",
        metavar="NAME=LOW:HIGH",
        complete=completion.signals,
        text="Range of an input, output or state, in its unit; an end may be left out, as in --limit x=:1e-4.",
    ),
]
Rates = Annotated[
    Texts, repeated("--rate", metavar="NAME=R", text="Largest change of an input in a second, in its unit.")
]
SensorNoise = Annotated[
    Texts,
    repeated(
        "--noise",
        metavar="OUTPUT=STD",
        complete=completion.outputs,
        text="Standard deviation of the sensor noise of an output. [default: that of the fit]",
    ),
]
Fixed = Annotated[
    Texts,
    repeated(
        "--fix",
        metavar="NAME=VALUE",
        complete=completion.constants,
        text="Fix a known parameter of MODEL at VALUE; NAME alone fixes it at the value in the model.",
    ),
]
Start = Annotated[
    Texts,
    repeated("--start", metavar="NAME=VALUE", complete=completion.constants, text="Value of a parameter of MODEL."),
]
Figures = Annotated[bool, typer.Option("--figures", help="Also write the figures of the report as PNG and SVG.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON instead of text.")]
Silent = Annotated[bool, typer.Option("--quiet-output", "-q", help="Print nothing but errors.")]

MODEL_HELP = "Name of a model (see greybox models), or a model file: my/rig.py, my/rig.py:name."
STUDY_HELP = " A study file, study.toml, replaces MODEL, records and options."
RECORDS = {
    "fit": ("DATA", "Records to fit: CSV, MAT, MF4, TDMS and others, headers 'name [unit]'."),
    "compare": ("TRAIN", "Records to fit: CSV, MAT, MF4, TDMS and others, headers 'name [unit]'."),
    "discover": ("ESTIMATION", "Records to learn from, headers 'name [unit]'."),
    "check": ("DATA", "Records; without them the model is simulated."),
}
"""What the records to fit are called in the help of each command."""
WITHOUT_RECORDS = ("check", "simulate")
"""Commands that need no records."""


def read_noise(given: list[str], flag: str = "--noise") -> dict[str, float]:
    """Standard deviations by output, as ``--noise`` and its like give them. Raises GreyboxError."""
    return Numbers(shape="OUTPUT=STD", example="x=2e-7").from_option(flag, given)


def takes_study(command: str, *, records: bool = True) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator: the function ``command(study, ...)`` gets an argument or option for each field of a study that it uses.

    In a command that reads study files, MODEL may be one; options beside it take the place of what it says. ``--model`` names the
    model in place of the file; ``--write-study`` writes the study and runs nothing. ``records``: whether it needs some.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        specs = fields_of(command)
        hints = typing.get_type_hints(function, include_extras=True)
        further = [p for p in inspect.signature(function).parameters.values() if p.name != "study"]
        parameters = [inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)]
        parameters += [_parameter(name, spec, command) for name, spec in specs.items()]
        parameters += [p.replace(annotation=hints[p.name], kind=inspect.Parameter.KEYWORD_ONLY) for p in further]
        if command in STUDY_COMMANDS:
            parameters += [
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
                for name, annotation in (("named_model", _NAMED_MODEL), ("write_study", _WRITE_STUDY))
            ]

        @functools.wraps(function)
        def run(
            *, ctx: typer.Context, named_model: str | None = None, write_study: Path | None = None, **given: Any
        ) -> None:
            raw = {name: given.pop(name) for name in specs}
            study = _study(command, ctx, raw, records=records)
            if write_study is None or named_model is not None:
                study = confirm_model(study, named_model)
            if write_study is not None:
                _refuse_beside_write_study(ctx, [p.name for p in further])
                from greybox.show.sentences.shell import study_line

                typer.echo(study_line(store_study(study, write_study, command), command))
                return
            function(study, **given)

        vars(run)["__signature__"] = inspect.Signature(parameters)
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate


def _refuse_beside_write_study(ctx: typer.Context, names: Sequence[str]) -> None:
    """Options of a run, which are no part of a study, beside one that runs nothing. Raises GreyboxError."""
    chosen = [name for name in names if getattr(ctx.get_parameter_source(name), "name", "DEFAULT") != "DEFAULT"]
    flags = [max(p.opts, key=len) for p in ctx.command.params if p.name in chosen]
    if flags:
        raise GreyboxError(
            f"{', '.join(flags)}: no effect with --write-study, which runs nothing; leave {'it' if len(flags) == 1 else 'them'} out"
        )


def confirm_model(study: Study, named_model: str | None = None) -> Study:
    """``study`` with a model that may be run: a study file alone runs no program.

    Parameters
    ----------
    study
        The study that the command line states.
    named_model
        The model that the user named beside the study file; None where there is none.

    Returns
    -------
    Study
        With ``named_model`` in the place of the file's own.

    Raises
    ------
    GreyboxError
        If the file names a model file, or lies in a project other than that of the working folder, and the user named no model; if
        a model is named twice.
    """
    from greybox.shell.project import is_model_path, project_root

    if named_model is not None:
        if study.file is None or "model" not in study.from_file:
            raise GreyboxError(f"--model {named_model}: the model is {study.model} already; leave out one of the two")
        return replace(study, model=named_model, from_file=study.from_file - {"model"})
    if study.file is None or "model" not in study.from_file:
        return study
    again = f"if you trust it, run the command again with --model {study.model}"
    if is_model_path(study.model):
        raise GreyboxError(
            f"{study.file}: names the model file {study.model}, which is a program; a study alone runs none: {again}"
        )
    root = project_root(study.folder, named=True)
    if root not in (None, project_root()):
        raise GreyboxError(
            f"{study.file}: belongs to the project {root}, whose models are programs; run the command from that folder, or name the"
            f" model, as in --model {root}/models/{study.model}.py"
        )
    return study


_NAMED_MODEL = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="MODEL",
        help="The model, if MODEL is a study file that names a model file: a study alone runs no program.",
        show_default=False,
    ),
]
_WRITE_STUDY = Annotated[
    Path | None,
    typer.Option(
        "--write-study",
        metavar="FILE.toml",
        help="Write model, records and options to a study file, and stop.",
        show_default=False,
    ),
]


def _study(command: str, ctx: typer.Context, raw: dict[str, Any], *, records: bool) -> Study:
    """The study that the command line states: from a file, from options, or from both."""
    specs = fields_of(command)
    name = raw["model"]
    in_file = command in STUDY_COMMANDS and is_study_file(name)
    study = read_study(Path(name), command) if in_file else Study(model=name)
    given: dict[str, Any] = {}
    for field, spec in specs.items():
        source = ctx.get_parameter_source(field)
        if field != "model" and source is not None and source.name != "DEFAULT":
            given[field] = spec.kind.from_option(spec.flag, raw[field])
    study = with_overrides(study, given)
    if study.unused:
        print_findings(
            [Finding(CommandCode.STUDY_FIELDS_UNUSED, subject=str(study.file), values={"places": study.unused})]
        )
    if not study.model:
        raise GreyboxError(f'{study.file}: model is missing; name one, as in model = "micro_actuator"')
    if records and "estimation" in specs and not study.estimation and command not in WITHOUT_RECORDS:
        if study.file is not None:
            raise GreyboxError(
                f'{study.file}: [records] estimation is missing; name records, as in estimation = ["train.csv"]'
            )
        order = ["MODEL", RECORDS[command][0]]
        exit_with_error(describe_missing_argument(ctx.command_path, order, order[1], [name]), ExitCode.BAD_INPUT)
    return study


def _parameter(name: str, spec: Spec, command: str) -> inspect.Parameter:
    """One field of a study as a parameter from which the option is made."""
    kind, default = spec.kind, spec.kind.default
    annotation = kind.annotation
    if name == "model":
        more = STUDY_HELP if command in STUDY_COMMANDS else ""
        info = typer.Argument(
            metavar="MODEL", show_default=False, autocompletion=completion.models, help=MODEL_HELP + more
        )
        return _made(name, Annotated[str, info], inspect.Parameter.empty)
    if name == "estimation":
        metavar, text = RECORDS[command]
        return _made(name, Annotated[list[Path] | None, typer.Argument(metavar=metavar, help=text)], None)
    settings: dict[str, Any] = {"help": spec.help_for(command), "show_default": spec.show_default}
    if spec.metavar:
        settings["metavar"] = spec.metavar
    if spec.complete is not None:
        settings["autocompletion"] = spec.complete
    least = getattr(kind, "least", None)
    if least is not None:
        settings["min"] = least
    if default == ():
        settings["default_factory"] = list
        default = inspect.Parameter.empty
    if isinstance(kind, Count) and default is None:
        annotation = int | None
    if annotation not in (bool, int, float, str) and isinstance(default, str):
        default = annotation(default)
    return _made(name, Annotated[annotation, typer.Option(spec.flag, **settings)], default)


def _made(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def check_writable(path: Path, given: str = "--output") -> Path:
    """``path``, if results can be written there; checked before the computation, and not changed. Raises GreyboxError.

    ``given``: the option or argument that names it.
    """
    try:
        present = next(folder for folder in (path, *path.absolute().parents) if folder.exists())
        if not present.is_dir():
            what = "it is a file" if present == path else f"{present} is a file"
            raise GreyboxError(f"{given} {path}: {what}; give a folder")
        # Another process may be about to make the folder, or to write into it: nothing is made that must be removed.
        with tempfile.TemporaryFile(dir=present):
            pass
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise GreyboxError(f"{given} {path}: cannot be written to ({reason}); give another folder") from error
    return path
