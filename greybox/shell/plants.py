"""Plants that are no model file: what stands in the place of MODEL, such as an FMU, and how each command runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.base.extensions import ExtensionKind, load_extensions


@dataclass(frozen=True)
class PlantDiscovery:
    """A ``discovery`` at such a plant, its ``text`` for the terminal, the ``folder`` for it, and what ``save`` s the fit of the plant."""

    discovery: Any
    text: str
    folder: Path
    save: Callable[[], Path]


@dataclass(frozen=True)
class PlantKind:
    """One kind of plant, known by the ending of its files.

    Attributes
    ----------
    suffixes
        Endings of its files, in small letters.
    fit
        ``fit(study, output, json=...)`` fits, prints and writes; it ends with an exit code of its own.
    check
        ``check(study, output) -> (result, folder)``.
    compare
        ``compare(study, output) -> (comparison, records, validation records, folder)``.
    discover
        ``discover(study, output, without, **options) -> PlantDiscovery``; the options are those of `greybox.discover`.
    """

    suffixes: tuple[str, ...]
    fit: Callable[..., None]
    check: Callable[..., Any]
    compare: Callable[..., Any]
    discover: Callable[..., Any]


def plant_kind(model: str) -> PlantKind | None:
    """The kind of plant that a file ``model`` holds; None for a model of this library."""
    suffix = Path(model).suffix.lower()
    # Names of models have no ending: nothing is looked up for them.
    if not suffix or suffix in (".py", ".toml"):
        return None
    kinds = load_extensions(ExtensionKind.PLANTS).values()
    return next((kind for kind in kinds if suffix in kind.suffixes), None)
