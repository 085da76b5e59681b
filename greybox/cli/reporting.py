"""The page that every command leaves for those who would rather look than read."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any


def write_report(value: Any, target: Path, **more: Any) -> Path:
    """Write the report of a result as ``target``; ``more`` goes to the builder of the page."""
    from greybox.reports import report

    return report(value, target, command=typed_command(), **more)


def typed_command() -> str:
    """The command as it was typed, for repeating it; empty where the program was not called as a command."""
    name = Path(sys.argv[0])
    called = name.stem == "greybox" or (name.name == "__main__.py" and "greybox" in name.parts)
    return shlex.join(["greybox", *sys.argv[1:]]) if called else ""
