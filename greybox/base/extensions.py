"""Extensions: what this package and others add to the core, found through entry points; and versions.

A package adds a kind of file, an export target, a kind of plant, a command or an effect by an entry point in one of five groups. The
core names no extension; it asks for what is there. An entry that cannot be loaded is kept with its reason and hurts nothing else.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import Any

from greybox.base.errors import GreyboxError, nearest

# The distribution whose entries come first.
OWN = "greybox-sysid"


class ExtensionKind(StrEnum):
    """What can be added; the group of its entry points is ``greybox.`` and the kind."""

    READERS = "readers"
    """Kinds of files that records are read from: a `greybox.data.file_kinds.FileFormat`."""
    EXPORTS = "exports"
    """Targets of an export: a `greybox.extensions.export.ExportTarget`."""
    PLANTS = "plants"
    """What may stand in the place of a model: a `greybox.simulation.plant.Plant`, or the `greybox.shell.plants.PlantKind` of a file."""
    COMMANDS = "commands"
    """Commands of the terminal: a `greybox.shell.study.Command`."""
    EFFECTS = "effects"
    """Effects of the catalogue: a `greybox.Effect`, or several."""


# Class of the value of an entry, by its name: the layers above define them.
VALUES = {
    ExtensionKind.READERS: "FileFormat",
    ExtensionKind.EXPORTS: "ExportTarget",
    ExtensionKind.PLANTS: "PlantKind",
    ExtensionKind.COMMANDS: "Command",
    ExtensionKind.EFFECTS: "Effect",
}
_reserved: dict[ExtensionKind, set[str]] = {}


def reserve(kind: ExtensionKind, names: Iterable[str]) -> None:
    """Keep names for the core: an entry, or an effect, of one of them is not loaded."""
    _reserved.setdefault(kind, set()).update(names)


@dataclass(frozen=True)
class Extension:
    """One entry: its name, where it is, and which distribution brought it. ``value`` is None where ``failure`` says why."""

    kind: ExtensionKind
    name: str
    place: str
    distribution: str
    version: str
    value: Any = None
    failure: str = ""


@cache
def list_extensions(kind: ExtensionKind) -> tuple[Extension, ...]:
    """All entries of a kind, this package's own first, each loaded once.

    Parameters
    ----------
    kind
        The kind.

    Returns
    -------
    tuple of Extension
        Those that failed among them, with the reason.
    """
    result: list[Extension] = []
    # Name -> who has it. An effect is known by its own name, whatever its entry is called.
    owners = dict.fromkeys(_reserved.get(kind, ()), OWN)
    for entry in _sorted_entries(kind):
        of = _distribution(entry), entry.dist.version if entry.dist else ""
        entered = Extension(kind, entry.name, entry.value, *of)
        try:
            value = entry.load()
            given = value if kind is ExtensionKind.EFFECTS and isinstance(value, list | tuple) else (value,)
            for each in given:
                by_class = any(base.__name__ == VALUES[kind] for base in type(each).__mro__)
                # What has the one method of a plant is one, whatever its class.
                is_plant = kind is ExtensionKind.PLANTS and hasattr(each, "simulate") and not isinstance(each, type)
                if not (by_class or is_plant):
                    raise GreyboxError(f"its value is a {type(each).__name__}; the class {VALUES[kind]} is needed")
            names = [each.name for each in given] if kind is ExtensionKind.EFFECTS else [entry.name]
            for name in names:
                if name in owners:
                    raise GreyboxError(f"{owners[name]} has the name {name!r} already; choose another one")
            owners |= dict.fromkeys(names, entered.distribution)
            entered = replace(entered, value=value)
        # A stranger's module may raise anything while it is imported, and its values while they are asked for a name: it must hurt nobody
        # else. A bug of ours is not an extension that is missing.
        except Exception as error:
            if entered.distribution == OWN:
                raise
            reason = str(error) if isinstance(error, GreyboxError) else f"{type(error).__name__}: {error}"
            entered = replace(entered, failure=reason)
        result.append(entered)
    return tuple(result)


def extension_names(kind: ExtensionKind) -> tuple[str, ...]:
    """The names of the entries of a kind, in order; nothing is loaded."""
    return tuple(dict.fromkeys(entry.name for entry in _sorted_entries(kind)))


def load_extensions(kind: ExtensionKind) -> Mapping[str, Any]:
    """Name -> value of the entries of a kind that could be loaded."""
    return {entry.name: entry.value for entry in list_extensions(kind) if not entry.failure}


def load_extension(kind: ExtensionKind, name: str) -> Any:
    """The value of one entry. Raises GreyboxError where it is not there, with the nearest names and what could not be loaded."""
    values = load_extensions(kind)
    if name not in values:
        raise GreyboxError(
            f"{name}: none of the {kind} has this name; {nearest(name, values)}{describe_failures(kind)}"
        )
    return values[name]


def describe_failures(kind: ExtensionKind) -> str:
    """A half sentence that names the entries of a kind that could not be loaded, or nothing."""
    failed = [f"{e.name} of {e.distribution} ({e.failure})" for e in list_extensions(kind) if e.failure]
    if not any(_distribution(entry) == OWN for entry in _sorted_entries(ExtensionKind.READERS)):
        return f"; what {OWN} ships is not found, because it is not installed or was installed before: pip install -e . in its folder"
    return f"; not loaded: {', '.join(failed)}" if failed else ""


_entries = cache(entry_points)  # reads the metadata of every installed distribution, once


def _sorted_entries(kind: ExtensionKind) -> list[EntryPoint]:
    """By name, own entries first, so that nobody's package takes the place of what is shipped."""
    # In whatever order an installer has written them.
    return sorted(_entries().select(group=f"greybox.{kind}"), key=lambda e: (_distribution(e) != OWN, e.name))


def _distribution(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist else ""


# Which programs computed a result.


def read_versions() -> dict[str, str]:
    """Versions of what computed a result."""
    import casadi  # slow to import, and a command's help needs neither
    import numpy

    return {
        "greybox": read_greybox_version(),
        "casadi": casadi.__version__,
        "numpy": numpy.__version__,
        "python": platform.python_version(),
    }


@cache
def read_greybox_version(without: str = "not installed") -> str:
    """Of the installed package, from its files, read once; ``without`` where it was not installed."""
    try:
        return version(OWN)
    except PackageNotFoundError:
        return without
