"""The command as tests call it: each message on stderr is one line again, as it was before it was wrapped at the terminal's width."""

from __future__ import annotations

import re
from typing import Any

import click.testing


def unwrap(told: str) -> str:
    """Messages on stderr, each a line: what goes on with two spaces in front belongs to the line before."""
    return re.sub(r"(?<=\S)\n  (?=\S)", " ", told)


class CliRunner(click.testing.CliRunner):
    """Runs a command in this process."""

    def invoke(self, *arguments: Any, **settings: Any) -> click.testing.Result:
        """What it printed, its exit code and what it raised."""
        result = super().invoke(*arguments, **settings)
        told = (result.stderr_bytes or b"").decode()
        for message in re.findall(r"^.+\n(?:  \S.*\n)+", told, re.MULTILINE):
            result.output_bytes = result.output_bytes.replace(message.encode(), unwrap(message).encode())
        result.stderr_bytes = unwrap(told).encode()
        return result
