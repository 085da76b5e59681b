"""The page that every command leaves for those who would rather look than read."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

NoReport = Annotated[bool, typer.Option("--no-report", help="Write no report.html.")]


def write_report(value: Any, target: Path, **more: Any) -> Path:
    """The report of what a command found, as ``target``; ``more`` goes to its builder. Says that it is there with
    `describe_process_noise`."""
    from greybox.reports import report

    return report(value, target, command=typed_command(), **more)


def report_line(path: Path) -> str:
    """The last line of a command that has left a report."""
    return f"report: {path} (open it in a browser; it needs no network)"


def typed_command() -> str:
    """The command as it was typed, for repeating it; empty where the program was not called as a command."""
    name = Path(sys.argv[0])
    called = name.stem == "greybox" or (name.name == "__main__.py" and "greybox" in name.parts)
    return shlex.join(["greybox", *sys.argv[1:]]) if called else ""
