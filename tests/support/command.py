"""The command as tests call it: each message on stderr is one line again, as it was before it was wrapped at the terminal's width."""

from __future__ import annotations

import re
from typing import Any

import click.testing

from greybox.base.texts import LINE_WIDTH
from greybox.show.printers.text import MOST_LINES

# What gives a result: without --details it stands on a screen. Lists (models, schema, help, signals of a file) are printed whole.
RESULTS = (
    "fit",
    "discover",
    "compare",
    "check",
    "simulate",
    "export",
    "changed",
    "design",
    "campaign",
    "fleet",
    "robot",
    "demo",
)
IN_FULL = ("--details", "--json", "--help", "--write-study")


def unwrap(told: str) -> str:
    """Messages on stderr, each a line: what goes on with two spaces in front belongs to the line before."""
    return re.sub(r"(?<=\S)\n  (?=\S)", " ", told)


class CliRunner(click.testing.CliRunner):
    """Runs a command in this process."""

    def invoke(self, cli: Any, args: Any = None, *more: Any, **settings: Any) -> click.testing.Result:
        """What it printed, its exit code and what it raised."""
        result = super().invoke(cli, args, *more, **settings)
        told = (result.stderr_bytes or b"").decode()
        for message in re.findall(r"^.+\n(?:  \S.*\n)+", told, re.MULTILINE):
            result.output_bytes = result.output_bytes.replace(message.encode(), unwrap(message).encode())
        result.stderr_bytes = unwrap(told).encode()
        words = args.split() if isinstance(args, str) else [*(args or ())]
        if words and words[0] in RESULTS and not {*words} & {*IN_FULL} and "  may be\n" not in result.stdout:
            _stands_on_a_screen(result.stdout)
        return result


def _stands_on_a_screen(printed: str) -> None:
    """An answer has few lines, none wider than the terminal but for a word that is; pictures that somebody asked for count apart."""
    lines = printed.splitlines()
    pictures = sum(".png" in line for line in lines)
    assert len(lines) - pictures <= MOST_LINES, printed
    assert all(len(line) <= LINE_WIDTH or len(max(line.split(), key=len)) > LINE_WIDTH - 20 for line in lines), printed
