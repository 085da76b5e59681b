"""What every result value shares: contents that nobody changes by accident, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from html import escape
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from greybox.base.document import Document


class Printable:
    """A result: ``describe()`` gives what is said of it as a `Document`, ``str(value)`` prints that as plain text.

    Sentences and figures stand in `greybox.show`, which looks the class up by its name. This is the one import of the library that points
    upward. It runs when somebody prints, never when a module is loaded.
    """

    def __str__(self) -> str:
        from greybox.show.describe import text

        return text(self)

    def describe(self, **options: Any) -> Document:
        """What is said of it: facts, sentences, tables, equations and figures.

        Parameters
        ----------
        **options
            What its page shows beside it, such as ``command``, the command that made it.
        """
        from greybox.show.describe import describe

        return describe(self, **options)

    def _repr_html_(self) -> str:
        """What a notebook shows: the plain text."""
        return f"<pre>{escape(str(self))}</pre>"


class ReadOnly:
    """A frozen dataclass whose mappings and arrays are read-only views; it can still be pickled and copied."""

    def __post_init__(self) -> None:
        for f in fields(self):  # type: ignore[arg-type]
            object.__setattr__(self, f.name, _protected(getattr(self, f.name)))

    def __reduce__(self) -> tuple[Any, ...]:
        values = {f.name: _open(getattr(self, f.name)) for f in fields(self) if f.init}  # type: ignore[arg-type]
        return _rebuilt, (type(self), values)


def _rebuilt(kind: type, values: Mapping[str, Any]) -> Any:
    return kind(**values)


def _protected(value: Any) -> Any:
    if isinstance(value, dict):
        return MappingProxyType({name: _protected(each) for name, each in value.items()})
    if hasattr(value, "setflags"):  # an array; asking NumPy itself would load it for every command's help
        if not value.flags.writeable:
            return value  # itself and no view of it: who owns its memory need not be copied again
        view = value.view()
        view.setflags(write=False)
        return view
    return value


def _open(value: Any) -> Any:
    """Read-only mappings as dictionaries: they cannot be pickled."""
    return {name: _open(each) for name, each in value.items()} if isinstance(value, MappingProxyType) else value
