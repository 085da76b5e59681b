"""From the table of options to the command line: a command's options, the study that was typed, and its answer on the terminal."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from greybox.base import ExitCode, Finding, GreyboxError, ModelError
from greybox.base.files import OUTPUTS_FOLDER, list_foreign, watch_replaced
from greybox.base.texts import to_word, wrap
from greybox.shell.study import Answer, Command, Option, Study
from greybox.shell.study_file import is_study_file, read_study, spell_following, with_overrides, write_study
from greybox.shell.study_values import Choice, Count, File, ModelName, Number, Switch, ValueWithUnitError, Word
from greybox.shell.terminal import (
    CommandCode,
    PlainArgument,
    PlainCommand,
    describe_missing_argument,
    exit_on_error,
    exit_with_error,
    print_answer,
    print_findings,
    terminal_width,
)

STUDY_HELP = " A study file, study.toml, replaces {}, records and options."
# fmt: off
NAMED_MODEL = Option(ModelName(), "--model MODEL", "",
    "The model, if MODEL is a study file that names a model file: a study alone runs no program.", name="named_model")
WRITE_STUDY = Option(File(), "--write-study FILE.toml", "",
    "Write model, records and options to a study file, and stop.", name="write_study")
# fmt: on


def make_command(name: str, command: Command, commands: Mapping[str, Command]) -> PlainCommand:
    """The command as click runs it; ``commands``: all of them, which a study file may have tables for."""
    options = dict(command.table)
    if command.reads_studies:
        first = command.arguments[0]
        options[first.name] = first.but(help=f"{first.help}{STUDY_HELP.format(first.usage)}")
        options |= {o.name: o for o in (NAMED_MODEL, WRITE_STUDY) if "--model" not in o.flags or first.name == "model"}

    def run(**_: Any) -> None:
        ctx = click.get_current_context()
        study = _read_study(ctx, name, command, commands)
        named, target = (ctx.params.get(option.name) for option in (NAMED_MODEL, WRITE_STUDY))
        if target is None or named is not None:
            study = confirm_model(study, named)
        command.check(study)
        if target is not None:
            _write_study(ctx, study, target, command.like or name, commands)
            return
        from greybox.simulation.kernel.c_compiler import find_cache_folder

        with watch_replaced() as written:
            try:
                answer = command.run(study)
                if answer is not None:
                    _show(answer, study, commands)
            finally:
                cache = find_cache_folder()
                outputs = {path: before for path, before in written.items() if cache not in path.parents}
                files = list_foreign(outputs, f"{name} {sorted(ctx.params.items())}", cache / OUTPUTS_FOLDER)
                if files and not study.silent:
                    print_findings([Finding(CommandCode.FILES_REPLACED, values={"files": files})])

    lines = "\n".join(f"  {line}" for line in command.examples)
    return PlainCommand(
        name,
        params=[_parameter(option) for option in options.values()],
        callback=exit_on_error(run),
        help=inspect.cleandoc(command.run.__doc__ or ""),
        short_help=command.short_help,
        epilog=f"Examples:\n\n\b\n{lines}" if lines else None,  # lines to copy
    )


def _parameter(option: Option[Any]) -> click.Parameter:
    """An option as click has it. What it gives where nothing is typed is never read: a study knows what is set."""
    kind, required = option.kind, "  [required]" * option.required
    shared: dict[str, Any] = {"type": kind.type, "metavar": option.metavar or None}
    if (complete := option.complete) is not None:
        shared["shell_complete"] = lambda ctx, _, word: [
            CompletionItem(t, help=what) for t, what in complete(ctx, word)
        ]
    if not option.flags:
        nargs, typed = (-1, f"{option.usage}...") if kind.repeated else (1, option.usage)
        shared["metavar"] = typed if option.required else f"[{typed}]"
        text = option.help + required
        return PlainArgument([option.name], nargs=nargs, required=False, place=option.usage, text=text, **shared)
    shown = isinstance(kind, Count | Choice | Word | Number) and kind.empty not in ("", None)
    shown = shown and "[default: " not in option.help
    if isinstance(kind, Switch):
        shared = {"is_flag": True}
    return click.Option(
        [*option.flags, option.name],
        multiple=kind.repeated,
        default=kind.empty if shown else None,
        show_default=shown,
        help=option.help + required,
        **shared,
    )


def _typed(ctx: click.Context, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _read_study(ctx: click.Context, name: str, command: Command, commands: Mapping[str, Command]) -> Study:
    """The study that the command line states: from a file, from options, or from both."""
    first = str(ctx.params[command.arguments[0].name] or "") if command.arguments else ""
    try:
        given = {n: o.kind.from_option(o.flag, ctx.params[n]) for n, o in command.table.items() if _typed(ctx, n)}
    except ValueWithUnitError as error:
        raise _name_unit(error, first) from None
    study = command.study(command=name, options=command.table)
    if command.reads_studies and is_study_file(first):
        read = read_study(Path(first), command.like or name, commands)
        origin = {name: getattr(read, name) for name in ("file", "from_file", "unused", "definition")}
        study = study.but(**origin, **read.values)
        del given[command.arguments[0].name]
    study = with_overrides(study, given)
    if study.unused:
        print_findings(
            [Finding(CommandCode.STUDY_FIELDS_UNUSED, subject=str(study.file), values={"places": study.unused})]
        )
    _refuse_missing(ctx, study, [option for option in command.table.values() if option.required], first)
    return study


def _name_unit(error: ValueWithUnitError, model: str) -> GreyboxError:
    """``error`` with the unit that the ``model`` wants; as it is where model or quantity are not found."""
    from greybox.shell.project import find_model

    try:
        plant = find_model(model)
    except ModelError:
        return error
    units = {q.name: q.unit for group in (plant.outputs, plant.inputs, plant.all_states) for q in group}
    units |= {q.name: q.unit for q in plant.all_parameters}
    return error.in_unit(units[error.name]) if error.name in units else error


# Option -> what to do where a study file lacks it.
MISSING = {
    "model": 'name one, as in model = "micro_actuator"',
    "source": 'name one, as in source = "results/rig-fit/fit.json"',
    "estimation": 'name records, as in estimation = ["train.csv"]',
}


def _refuse_missing(ctx: click.Context, study: Study, required: list[Option[Any]], first: str) -> None:
    """Refuse a study without what its command cannot do without. Raises GreyboxError."""
    for option in required:
        if study.sets(option):
            continue
        if study.file is not None:
            remedy = MISSING.get(option.name, f"give it, or add {option.usage}")
            raise GreyboxError(f"{study.file}: {option.label} is missing; {remedy}")
        message = f"{option.usage} is missing: {option.help} See {ctx.command_path} --help"
        if not option.flags:
            order = [o.usage for o in study.options.values() if not o.flags]
            message = describe_missing_argument(ctx.command_path, order, option.usage, [first])
        exit_with_error(message, ExitCode.BAD_INPUT)


def _write_study(ctx: click.Context, study: Study, target: Path, name: str, commands: Mapping[str, Command]) -> None:
    from greybox.shell.inputs import state_in_study
    from greybox.shell.project import find_model, remember_program
    from greybox.show.sentences.shell import study_line

    idle = [option.flag for n, option in study.options.items() if not option.place and _typed(ctx, n)]
    if idle:
        it = "it" if len(idle) == 1 else "them"
        raise GreyboxError(f"{', '.join(idle)}: no effect with --write-study, which runs nothing; leave {it} out")
    # A model that only the file names is a program that the user has not asked for: what the file says of it is kept as it is.
    holder = "source" if study.source and not study.source.endswith(".json") else "model"
    if (model := getattr(study, holder)) and holder not in study.from_file:
        study = study.but(definition=state_in_study(find_model(model), study))
        remember_program(model)
    print_answer(study_line(write_study(study, target, name, commands), name))


def confirm_model(study: Study, named_model: str | None = None) -> Study:
    """``study`` with a model that may be run: a study file alone runs no program but one that this user named when a study was written.

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
        If the file names a model file or a plant that runs code and is new or edited, or lies in a project other than that of the working
        folder, and the user named no model; if a model is named twice.
    """
    from greybox.shell.inputs import find_result
    from greybox.shell.project import is_remembered, project_root, runs_code

    # The folder of a fit stands for its fit.json.
    if result := find_result(study.source):
        study = study.but(source=str(result))
    # A command that starts from a result has an option for its model; where its source is a model, that option names the source.
    holder = "model"
    if study.source and not study.source.endswith(".json"):
        holder = "source"
        if study.model and "model" not in study.from_file:
            named_model, study = study.model, study.but(model="")
    model = getattr(study, holder)
    if named_model is not None:
        if holder not in study.from_file:
            raise GreyboxError(f"--model {named_model}: the model is {model} already; leave out one of the two")
        return study.but(**{holder: named_model}, from_file=study.from_file - {holder})
    # The file may hold both, and which of them a command takes is its own affair.
    for name in (getattr(study, field) for field in ("model", "source") if field in study.from_file):
        if runs_code(name) and not (name == study.source and name.endswith(".json")) and not is_remembered(name):
            raise GreyboxError(
                f"{study.file}: names the model file {name}, which is a program; a study alone runs none but one that was named here when a"
                f" study was written and has not changed since: if you trust it, run the command again with --model {to_word(name)}"
            )
    if study.file is None or holder not in study.from_file:
        return study
    root = project_root(study.folder, named=True)
    if root not in (None, project_root()):
        raise GreyboxError(
            f"{study.file}: belongs to the project {root}, whose models are programs; run the command from that folder, or name the"
            f" model, as in --model {to_word(f'{root}/models/{model}.py')}"
        )
    return study


def _list_files(files: Sequence[Path]) -> str:
    """The written files; of many in one folder the folder once."""
    folders = {file.parent for file in files}
    if len(files) > 3 and len(folders) == 1:
        return f"files in {folders.pop()}: {', '.join(file.name for file in files)}"
    return f"files: {', '.join(map(str, files))}"


def _show(answer: Answer, study: Study, commands: Mapping[str, Command]) -> None:
    """Print an answer as text or JSON, write what goes with it, and end with its exit code."""
    width = terminal_width(sys.stdout)
    is_text = not (study.silent or study.json)
    # What is typed next, and the files.
    below: list[str] = []
    if is_text:
        from greybox.show import text
        from greybox.show.printers.text import MOST_LINES, wrap_command

        following = answer.next
        if not isinstance(following, str):
            following = spell_following(following.keeping(answer.files), commands)
        below = wrap_command(f"next: {following}", width) if following else []
        # Page and pictures are drawn once the answer is there to read: their names take a line more.
        drawn = bool(answer.page and not study.no_report) + bool(answer.pictures and study.figures)
        listed = len(wrap(_list_files(answer.files), width, "  ")) if answer.files else 0
        room = MOST_LINES - len(below) - listed - drawn - bool(below or listed or drawn)
        shown = answer.text
        print_answer(shown if isinstance(shown, str) else text(shown, width, details=study.details, lines=room))
    try:
        pictures = answer.pictures() if answer.pictures and study.figures else []
        page = answer.page() if answer.page and not study.no_report else None
    except KeyboardInterrupt:
        exit_with_error(f"interrupted while drawing; {answer.kept}", ExitCode.INTERRUPTED)
    if study.json:
        click.echo(answer.as_json(page).removesuffix("\n"))
    elif is_text:
        if files := [*answer.files, *pictures, *([page] if page else [])]:
            below += wrap(_list_files(files), width, "  ")
        if below:
            print_answer("\n".join(["", *below]))
    if answer.failure:
        exit_with_error(answer.failure, answer.code)
    if answer.code:
        raise click.exceptions.Exit(answer.code)
