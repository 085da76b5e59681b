"""Plants that are no model file: what stands in the place of MODEL, such as an FMU, and how each command runs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.base.errors import GreyboxError
from greybox.base.extensions import ExtensionKind, load_extensions
from greybox.shell.study import Answer, Idle, Option, Study


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
    closed
        What a message calls it where an option changes nothing: "on an FMU, whose equations are closed".
    used
        Command -> the options of a study that it uses with such a plant; ``fit with effects`` where a fit has some.
    model
        ``model(study)`` is the plant of a study as a model, its constants freed, started and fixed as the study has it.
    fit_effects
        ``fit_effects(study) -> Answer`` fits it with effects, and writes.
    check
        ``check(study) -> (result, folder)``.
    compare
        ``compare(study) -> (comparison, records, validation records, folder)``.
    discover
        ``discover(study, without, **options) -> PlantDiscovery``; the options are those of `greybox.discover`.
    """

    suffixes: tuple[str, ...]
    closed: str
    used: Mapping[str, tuple[Option[Any], ...]]
    model: Callable[[Study], Any]
    fit_effects: Callable[[Study], Answer]
    check: Callable[..., Any]
    compare: Callable[..., Any]
    discover: Callable[..., Any]


def plant_kind(study: Study) -> PlantKind | None:
    """The kind of plant that the model of a study is; None for a model of this library.

    Raises GreyboxError for options that change nothing at such a plant.
    """
    suffix = Path(study.model).suffix.lower()
    # Names of models have no ending: nothing is looked up for them.
    if not suffix or suffix in (".py", ".toml"):
        return None
    kinds = [kind for kind in load_extensions(ExtensionKind.PLANTS).values() if isinstance(kind, PlantKind)]
    kind = next((kind for kind in kinds if suffix in kind.suffixes), None)
    if kind is not None:
        with_effects = " with effects" if study.command == "fit" and study.effects else ""
        used = {option.name for option in kind.used[study.command + with_effects]}
        rest = tuple(o for name, o in study.options.items() if o.place and o.flags and name not in used)
        if objection := Idle(rest, kind.closed).objection(study):
            raise GreyboxError(objection)
    return kind
