"""Faces of packages: the names that a package offers, each imported when it is first asked for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def lazy_face(package: str, homes: Mapping[str, Sequence[str]]) -> tuple[Callable[[str], Any], list[str]]:
    """``__getattr__`` and ``__all__`` of a package whose modules are dear to import.

    A command or a reader of the package is found without its algorithms, and these are loaded by the first use of a name.

    Parameters
    ----------
    package
        Its name, ``__name__``.
    homes
        Module -> the names that come from it; a type checker finds them under ``if TYPE_CHECKING``.

    Returns
    -------
    tuple
        What to assign to ``__getattr__`` and ``__all__``.
    """
    home = {name: module for module, names in homes.items() for name in names}

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load, sorted(home)
