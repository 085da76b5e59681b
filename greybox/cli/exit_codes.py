"""How a command ends: the codes that scripts rely on."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """How a command ended: a contract with whoever runs it from a script."""

    SUCCESS = 0
    UNSUCCESSFUL = 1
    """The computation ran and did not succeed, for instance a fit that did not converge."""
    BAD_INPUT = 2
    """Something that was typed or read cannot be used; nothing was computed or written."""
    INTERRUPTED = 130
    """Ctrl-C, as shells report it: 128 plus the number of the signal."""
