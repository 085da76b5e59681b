"""Faces of packages: the names that a package offers, each imported when it is first asked for."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any


def lazy_face(package: str) -> tuple[Callable[[str], Any], list[str], Callable[[], list[str]]]:
    """``__getattr__``, ``__all__`` and ``__dir__`` of a package whose modules are dear to import.

    A command or a reader of the package is found without its algorithms, and these are loaded by the first use of a name. What the
    package imports under ``if TYPE_CHECKING`` is what it offers: one list, for type checkers and for users.

    Parameters
    ----------
    package
        Its name, ``__name__``.

    Returns
    -------
    tuple
        What to assign to ``__getattr__``, ``__all__`` and ``__dir__``.
    """
    tree = ast.parse(sys.modules[package].__loader__.get_source(package))  # type: ignore[union-attr]
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imports = [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
    home = {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    # Constants, classes, functions: the order in which a reference lists them.
    names = sorted(home, key=lambda name: (not name.isupper(), name[0].islower(), name))
    return load, names, lambda: names
