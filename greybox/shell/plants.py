"""Plants that are no model file: what stands in the place of MODEL, such as an FMU, and what every command takes it as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from greybox.base import ExtensionKind, load_extensions

if TYPE_CHECKING:
    from greybox.shell.study import Option, Study


@dataclass(frozen=True)
class PlantKind:
    """One kind of plant, known by the ending of its files.

    Attributes
    ----------
    suffixes
        Endings of its files, in small letters.
    closed
        What a message calls it where an option changes nothing: "on an FMU, whose equations are closed".
    unused
        The options of a study that change nothing with such a plant.
    read
        ``read(path)`` is the plant in a file as a model. Raises GreyboxError.
    set_parameters
        ``set_parameters(model, study)`` is that with its constants freed, started and fixed as the study has it. Raises GreyboxError.
    runs_code
        Whether reading or running such a file runs a program that lies in it. Then a file that names one is not enough: the user has to.
    """

    suffixes: tuple[str, ...]
    closed: str
    unused: tuple[Option[Any], ...]
    read: Callable[[str], Any]
    set_parameters: Callable[[Any, Study], Any]
    # A kind that does not say it is taken for one that does.
    runs_code: bool = True


def find_plant_kind(path: str) -> PlantKind | None:
    """The kind of plant that a file is; None for a model of this library."""
    suffix = Path(path).suffix.lower()
    # Names of models have no ending: nothing is looked up for them.
    if not suffix or suffix in (".py", ".toml"):
        return None
    kinds = [kind for kind in load_extensions(ExtensionKind.PLANTS).values() if isinstance(kind, PlantKind)]
    return next((kind for kind in kinds if suffix in kind.suffixes), None)
