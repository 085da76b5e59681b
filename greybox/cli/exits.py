"""Errors and warnings of the library as a person at a terminal gets them: one message, an exit code, no traceback."""

from __future__ import annotations

import functools
import signal
import threading
import warnings
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NoReturn

import typer

from greybox.cli.exit_codes import ExitCode
from greybox.cli.interrupts import treat_as_interrupts
from greybox.errors import GreyboxError, OutputError, WorkersLostError

if TYPE_CHECKING:
    from greybox.findings import Finding


def exit_on_error(command: Callable[..., None]) -> Callable[..., None]:
    """``command`` with bad input as exit code 2 and Ctrl-C as 130, each with a message on stderr."""

    @functools.wraps(command)
    def run(*args: Any, **options: Any) -> None:
        with warnings.catch_warnings():
            warnings.showwarning = _print_warning
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGINT, signal.default_int_handler)
                treat_as_interrupts()
            try:
                command(*args, **options)
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
    typer.echo(f"error: {message}", err=True)
    raise typer.Exit(code)


def print_note(message: str) -> None:
    """A line on stderr, so that stdout stays what was asked for."""
    typer.echo(message, err=True)


def print_findings(findings: Iterable[Finding]) -> None:
    """A line on stderr for each finding, with its severity in front."""
    from greybox.rendering import sentence

    for finding in findings:
        print_note(f"{finding.severity}: {sentence(finding)}")


def _print_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print_note(f"warning: {message}")
