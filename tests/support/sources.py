"""The sources of the project as syntax trees, each parsed once."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    with _uncollected():
        return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Every node of the syntax tree of a file."""
    with _uncollected():
        return list(ast.walk(parsed(path)))


@contextmanager
def _uncollected() -> Iterator[None]:
    # All trees stay: a collector that walks them again after each file takes longer than parsing does.
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()
