"""The terminal: how a command begins and ends, and errors, warnings and mistakes in what was typed, each told in one line."""

from __future__ import annotations

import difflib
import functools
import math
import re
import shlex
import shutil
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import click

from greybox.base.errors import ExitCode, GreyboxError, OutputError, WorkersLostError, nearest
from greybox.base.extensions import ExtensionKind, describe_failures
from greybox.base.texts import LINE_WIDTH, to_lines, to_message, wrap

if TYPE_CHECKING:
    from greybox.base import Finding


# What the command line has to say about a study beside the result itself.


class CommandCode(StrEnum):
    """Codes of the findings of the command line."""

    SPLIT_WITHOUT_EFFECT = "split_without_effect"
    RECORD_SPLIT = "record_split"
    PIECES_AT_REST = "pieces_at_rest"
    SUBSTEPS_WITHOUT_EFFECT = "substeps_without_effect"
    FILES_REPLACED = "files_replaced"
    STUDY_FIELDS_UNUSED = "study_fields_unused"
    OTHER_MODEL_IN_STUDY = "other_model_in_study"
    UNUSED_PARAMETER = "unused_parameter"
    STARTS_AS_DECLARED = "starts_as_declared"


# Ctrl-C during a command: what it has found is kept.


def treat_as_interrupts() -> None:
    """Take a request to end, as batch systems and ``kill`` send it, for Ctrl-C: what is finished is kept, workers end.

    A signal that is ignored stays ignored (``nohup``).
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, lambda *_: signal.raise_signal(signal.SIGINT))


# Errors and warnings of the library as a person at a terminal gets them: one message, an exit code, no traceback.


def exit_on_error(command: Callable[..., None]) -> Callable[..., None]:
    """``command`` with bad input as exit code 2 and Ctrl-C as 130, each with a message on stderr."""

    @functools.wraps(command)
    def run(*args: Any, **options: Any) -> None:
        with warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: print_note(f"warning: {message}")
            asked = threading.Event()

            def end(number: int, frame: FrameType | None) -> None:
                asked.set()
                signal.default_int_handler(number, frame)

            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGINT, end)
                treat_as_interrupts()
            try:
                try:
                    command(*args, **options)
                except Exception as error:  # raised again
                    # Inside a library the interrupt is swallowed, and what it makes of it fails somewhere else.
                    if asked.is_set() and not isinstance(error, click.exceptions.Exit):
                        raise KeyboardInterrupt from error
                    raise
            except OutputError as error:  # the computation is done, and its result has no place
                exit_with_error(str(error), ExitCode.UNSUCCESSFUL)
            except WorkersLostError as error:
                exit_with_error(f"{error}; the same command goes on from them", ExitCode.UNSUCCESSFUL)
            except GreyboxError as error:
                exit_with_error(str(error), ExitCode.BAD_INPUT)
            except MemoryError:
                exit_with_error(
                    "not enough memory for this; give shorter or fewer records, fewer --workers, or a machine with more",
                    ExitCode.UNSUCCESSFUL,
                )
            except BrokenPipeError:  # the reader of the pipe has closed it: nobody is left to read a message
                raise
            except OSError as error:
                exit_with_error(f"{error.filename or 'a file'}: {error.strerror or error}", ExitCode.BAD_INPUT)
            except KeyboardInterrupt:
                exit_with_error("interrupted", ExitCode.INTERRUPTED)

    return run


def exit_with_error(message: str, code: ExitCode) -> NoReturn:
    """End with ``message`` on stderr."""
    print_note(f"error: {message}")
    raise click.exceptions.Exit(code)


def is_terminal(stream: TextIO | None) -> bool:
    """Whether somebody reads a stream on a terminal; it is None where the shell has closed it."""
    return stream is not None and stream.isatty()


def terminal_width(stream: TextIO | None) -> int:
    """Columns of the terminal that ``stream`` goes to, and of a usual one where it goes elsewhere."""
    return shutil.get_terminal_size((LINE_WIDTH, 24)).columns if is_terminal(stream) else LINE_WIDTH


def print_note(message: str) -> None:
    """A message on stderr, so that stdout stays what was asked for: its first line, and those that go on with two spaces in front."""
    click.echo("\n".join(wrap(to_message(message), terminal_width(sys.stderr), "  ")), err=True)


def print_answer(text: str) -> None:
    """What was asked for, on stdout."""
    click.echo(to_lines(text))


def print_findings(findings: Iterable[Finding]) -> None:
    """A line on stderr for each finding, with its severity in front."""
    from greybox.show.sentences import sentence

    for finding in findings:
        print_note(f"{finding.severity}: {sentence(finding)}")


# The page that every command leaves for those who would rather look than read.


def write_report(value: Any, target: Path, **more: Any) -> Path:
    """Write the report of a result as ``target``; ``more`` goes to the builder of the page."""
    from greybox.show import report

    return report(value, target, command=typed_command(), **more)


def typed_command() -> str:
    """The command as it was typed, for repeating it; empty where the program was not called as a command."""
    name = Path(sys.argv[0])
    called = name.stem == "greybox" or (name.name == "__main__.py" and "greybox" in name.parts)
    return shlex.join(["greybox", *sys.argv[1:]]) if called else ""


# What was typed wrongly, told as the program's other errors are: subject, value, rule, remedy, the nearest name.

CHOICE = re.compile(r"'(.*)' is not one of (.*?)\.?$")
# What the reader of options says of a number, and what to do.
NUMBERS = (
    (re.compile(r"greater than or equal to (\S+)$|is not in the range x>=(\S+)\.$"), "give {} or more"),
    (re.compile(r"valid integer"), "write a whole number"),
    (re.compile(r"valid number|valid float"), "write a number without a unit"),
)


class PlainArgument(click.Argument):
    """An argument with a line in the help."""

    def __init__(self, *args: Any, place: str, text: str, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.place, self.text = place, text


class PlainCommand(click.Command):
    """A command whose help lists its arguments too, and whose errors are one line that says what to do."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write arguments, then options."""
        arguments = [(p.place, p.text) for p in self.params if isinstance(p, PlainArgument)]
        if arguments:
            with formatter.section("Arguments"):
                formatter.write_dl(arguments)
        options = [p.get_help_record(ctx) for p in self.get_params(ctx) if isinstance(p, click.Option)]
        with formatter.section("Options"):
            formatter.write_dl([record for record in options if record])

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """The arguments by parameter; ends with exit code 2 where they cannot be understood."""
        typed = list(args)
        try:
            rest = super().parse_args(ctx, args)
        except click.UsageError as error:
            exit_with_error(describe_usage_error(error, ctx, typed), ExitCode.BAD_INPUT)
        if not ctx.resilient_parsing:  # while Tab completes, words are unfinished
            self._refuse_empty_words(ctx, typed)
            self._refuse_infinite_numbers(ctx)
        return rest

    def _refuse_empty_words(self, ctx: Any, typed: Sequence[str]) -> None:
        """An unset variable of the shell gives an empty word, and as a path that would be the working folder."""
        if not all(typed):
            place = typed.index("")
            before = typed[place - 1] if place else ctx.command_path
            exit_with_error(
                f"an empty word stands after {before}; give a value, or leave it out; see {ctx.command_path} --help",
                ExitCode.BAD_INPUT,
            )

    def _refuse_infinite_numbers(self, ctx: Any) -> None:
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if isinstance(value, float) and not math.isfinite(value):
                exit_with_error(
                    f"{max(parameter.opts, key=len)} {value:g}: give a finite number; see {ctx.command_path} --help",
                    ExitCode.BAD_INPUT,
                )


class CommandGroup(click.Group):
    """The main command; for an unknown sub-command it names the nearest one."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the order of the help."""
        return list(self.commands)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """The options before the sub-command; ends with exit code 2 where they cannot be understood."""
        if not args:  # then the help is shown
            return super().parse_args(ctx, args)
        typed = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            exit_with_error(describe_usage_error(error, ctx, typed), ExitCode.BAD_INPUT)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The sub-command that the first of ``args`` names; ends with exit code 2 where there is none."""
        name = args[0]
        if self.get_command(ctx, name) is None and not ctx.resilient_parsing:  # while Tab completes, nothing is told
            exit_with_error(
                f"{name}: there is no such command; {nearest(name, self.list_commands(ctx))}"
                f"{describe_failures(ExtensionKind.COMMANDS)}",
                ExitCode.BAD_INPUT,
            )
        return super().resolve_command(ctx, args)


def describe_usage_error(error: Any, ctx: Any, typed: Sequence[str]) -> str:
    """One line on what cannot be understood of the words ``typed`` after the command of ``ctx``."""
    command, message = ctx.command_path, error.message
    parameter, option = getattr(error, "param", None), getattr(error, "option_name", "")
    if parameter is not None:
        name = max(parameter.opts, key=len) if isinstance(parameter, click.Option) else parameter.place
        return f"{_value(name, message, typed) if message else f'{name} is missing'}; see {command} --help"
    if "o such option" in message:
        return f"{option}: {command} has no such option; {_nearest_option(option, ctx)}see {command} --help"
    if "requires an argument" in message:
        return f"{option}: a value must follow; see {command} --help"
    return f"{command}: {message[:1].lower()}{message[1:].rstrip('.')}; see {command} --help"


def _nearest_option(option: str, ctx: Any) -> str:
    known = [name for p in ctx.command.params if isinstance(p, click.Option) for name in p.opts]
    close = difflib.get_close_matches(option, known, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(close)}? Or " if close else ""


def describe_missing_argument(command: str, order: Sequence[str], missing: str, typed: Sequence[str]) -> str:
    """Which argument is missing, and in which order they come; a record in the place of the model is named as such."""
    from greybox.data.file_kinds import record_suffixes

    usage = f"write {command} {' '.join(order)}; see {command} --help"
    first = next((word for word in typed if not word.startswith("-")), "")
    if order[0] == "MODEL" and Path(first).suffix.lower() in record_suffixes():
        return f"{first}: a record, not a model; MODEL comes first: {usage}"
    return f"{command}: {missing} is missing; {usage}"


def _value(name: str, message: str, typed: Sequence[str]) -> str:
    """What is wrong with the value of an option: the nearest choice, or which number to give."""
    choice = CHOICE.search(message)
    if choice:
        known = re.findall("'(.*?)'", choice[2])
        return f"{name} {choice[1]}: there is no such choice; {nearest(choice[1], known)}"
    values = [word.partition("=")[2] for word in typed if word.startswith(f"{name}=")]
    values += [after for word, after in pairwise(typed) if word == name]
    value = values[-1] if values else "(not given)"
    for pattern, remedy in NUMBERS:
        match = pattern.search(message)
        if match:
            return f"{name} {value}: {remedy.format(*filter(None, match.groups()))}"
    return f"{name} {value}: {message[:1].lower()}{message[1:].rstrip('.')}"
