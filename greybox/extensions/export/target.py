"""What an export target is: how a plant is handed over to another program, in one value; and the texts that such targets fill in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from string import Template


@dataclass(frozen=True)
class ExportTarget:
    """One language or file format in which a plant is handed over: ``greybox export --to NAME``.

    Attributes
    ----------
    description
        What is written, in a few words: ``a MATLAB file``.
    suffix
        Ending of the file.
    write
        Of a linear target ``write(linearisation, path, plant=..., family=...)``, else ``write(plant, path, **options)`` with a fit, a
        model or an observer. It returns the path of the file, or several.
    linear
        Whether it takes a linear model.
    options
        Which options change what it writes: of a linear target ``samples``, else ``dt``, ``substeps`` and ``observer``.
    stepped
        Whether the file holds one step of a fixed length; what such a step is called in the answer.
    ending
        What the default name of the file ends with, where that is more than the suffix.
    """

    description: str
    suffix: str
    write: Callable[..., Path | tuple[Path, ...]]
    linear: bool = False
    options: frozenset[str] = frozenset()
    stepped: str = ""
    ending: str = ""


def read_template(name: str, /, **values: object) -> str:
    """The text of a file beside this one; ``values`` take the places of ``$NAME`` in it."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return Template(text).substitute(values) if values else text
