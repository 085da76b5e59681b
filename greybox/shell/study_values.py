"""The kinds of values that a study holds, each with its two spellings: as an option of the command line and as TOML.

A kind reads both spellings into the same Python value and writes the value as TOML, so that a study that was written from
options gives the same numbers as the options, to the last bit.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from greybox.base.errors import GreyboxError, nearest

PLUS_MINUS = re.compile(r"\+-|\+/-|±")


class Kind(ABC):
    """How the values of one field are written.

    Attributes
    ----------
    annotation
        The type that the reader of the command line works with.
    default
        What the reader of the command line gives where the option is absent.
    empty
        The value of a field that nobody has set.
    """

    annotation: Any
    default: Any
    empty: Any

    @abstractmethod
    def from_option(self, option: str, raw: Any) -> Any:
        """The value that was given with ``option``. Raises GreyboxError."""

    @abstractmethod
    def from_toml(self, place: str, data: Any) -> Any:
        """The value that stands at ``place`` in a study file. Raises GreyboxError."""

    def to_toml(self, value: Any) -> Any:
        """The value as TOML can hold it: a string, number, truth value, list or mapping of these."""
        return value

    def merge(self, in_file: Any, given: Any) -> Any:
        """The value of a field that is set in a study file and on the command line: the command line wins."""
        return given


@dataclass(frozen=True)
class Switch(Kind):
    """On or off."""

    annotation = bool
    default = empty = False

    def from_option(self, option: str, raw: bool) -> bool:
        return raw

    def from_toml(self, place: str, data: Any) -> bool:
        if not isinstance(data, bool):
            raise _wrong(place, data, "must be true or false")
        return data


@dataclass(frozen=True)
class Count(Kind):
    """A whole number from ``least`` up; ``unset`` where the field may be left to the program."""

    least: int = 0
    unset: int | None = 0
    annotation = int

    @property
    def default(self) -> int | None:
        return self.unset

    empty = default

    def from_option(self, option: str, raw: int | None) -> int | None:
        return raw

    def from_toml(self, place: str, data: Any) -> int:
        if isinstance(data, bool) or not isinstance(data, int):
            raise _wrong(place, data, "must be a whole number")
        if data < self.least:
            raise _wrong(place, data, f"give {self.least} or more")
        return data


@dataclass(frozen=True)
class Counts(Kind):
    """Several whole numbers from ``least`` up."""

    least: int = 0
    annotation = list[int]
    default = ()
    empty = ()

    def from_option(self, option: str, raw: Sequence[int]) -> tuple[int, ...]:
        return tuple(raw)

    def from_toml(self, place: str, data: Any) -> tuple[int, ...]:
        return tuple(Count(self.least).from_toml(place, item) for item in as_list(place, data))

    def to_toml(self, value: tuple[int, ...]) -> list[int]:
        return list(value)


@dataclass(frozen=True)
class Quantity(Kind):
    """A number above zero; the field is zero where it is not given."""

    annotation = float
    default = empty = 0.0

    def from_option(self, option: str, raw: float) -> float:
        if raw <= 0:
            raise GreyboxError(f"{option} {raw:g}: give a number above 0")
        return raw

    def from_toml(self, place: str, data: Any) -> float:
        number = number_in_file(place, data)
        if number <= 0:
            raise _wrong(place, data, "give a number above 0")
        return number


@dataclass(frozen=True)
class Word(Kind):
    """A text that the library itself checks."""

    start: str = ""
    annotation = str

    @property
    def default(self) -> str:
        return self.start

    empty = default

    def from_option(self, option: str, raw: str) -> str:
        return raw

    def from_toml(self, place: str, data: Any) -> str:
        return text_in_file(place, data)


@dataclass(frozen=True)
class Choice(Kind):
    """One of the values of ``choices``, of which the first is the default."""

    choices: type[StrEnum]

    @property
    def annotation(self) -> type[StrEnum]:
        return self.choices

    @property
    def default(self) -> str:
        return next(iter(self.choices)).value

    empty = default

    def from_option(self, option: str, raw: str) -> str:
        return self.choices(raw).value

    def from_toml(self, place: str, data: Any) -> str:
        known = [choice.value for choice in self.choices]
        if data not in known:
            raise GreyboxError(f"{place}: there is no choice {data!r}; {nearest(str(data), known)}")
        return str(data)


@dataclass(frozen=True)
class Names(Kind):
    """Names: an option given several times; with ``split`` several names after one option as well."""

    split: bool = False
    annotation = list[str]
    default = ()
    empty = ()

    def from_option(self, option: str, raw: Sequence[str]) -> tuple[str, ...]:
        return parse_names(raw) if self.split else tuple(raw)

    def from_toml(self, place: str, data: Any) -> tuple[str, ...]:
        return tuple(text_in_file(place, item) for item in as_list(place, data))

    def to_toml(self, value: tuple[str, ...]) -> list[str]:
        return list(value)


@dataclass(frozen=True)
class CommaNames(Kind):
    """Names after one option, separated by commas."""

    annotation = str
    default = ""
    empty = ()

    def from_option(self, option: str, raw: str) -> tuple[str, ...]:
        return tuple(name.strip() for name in raw.split(",") if name.strip())

    def from_toml(self, place: str, data: Any) -> tuple[str, ...]:
        return Names().from_toml(place, data)

    def to_toml(self, value: tuple[str, ...]) -> list[str]:
        return list(value)


@dataclass(frozen=True)
class Headers(Kind):
    """Headers after one option, separated by commas; blanks and brackets belong to them: ``time [ms],u,-,x [um]``."""

    annotation = str
    default = ""
    empty = ()

    def from_option(self, option: str, raw: str) -> tuple[str, ...]:
        headers = tuple(name.strip() for name in raw.split(","))
        if not all(headers):
            raise GreyboxError(f"{option} {raw}: a name is empty; write '-' for a column that is not wanted")
        return headers

    def from_toml(self, place: str, data: Any) -> tuple[str, ...]:
        if isinstance(data, dict):
            raise _wrong(
                place,
                data,
                'must be a list of all columns in their order, as in ["time", "u", "x"]; headers of single signals stand under [columns]',
            )
        return Names().from_toml(place, data)

    def to_toml(self, value: tuple[str, ...]) -> list[str]:
        return list(value)


@dataclass(frozen=True)
class Files(Kind):
    """Paths of files. Those in a study file are relative to its folder."""

    annotation = list[Path]
    default = ()
    empty = ()

    def from_option(self, option: str, raw: Sequence[Path] | None) -> tuple[Path, ...]:
        return tuple(raw or ())

    def from_toml(self, place: str, data: Any) -> tuple[Path, ...]:
        return tuple(Path(text_in_file(place, item)) for item in as_list(place, data))

    def to_toml(self, value: tuple[Path, ...]) -> list[str]:
        return [path.as_posix() for path in value]


@dataclass(frozen=True)
class Table(Kind):
    """Something for each name: an option ``NAME=...`` given several times, or a table of the file.

    ``shape`` and ``example`` show how the option is written; ``bare`` is the word that stands in the file for a name without
    a value, None where a value must follow.
    """

    shape: str = "NAME=VALUE"
    example: str = "M=0.01"
    bare: str | None = None
    annotation = list[str]
    default = ()

    @property
    def empty(self) -> Mapping[str, Any]:
        return {}

    def from_option(self, option: str, raw: Sequence[str]) -> dict[str, Any]:
        alone = [text.strip() for text in raw if "=" not in text] if self.bare is not None else []
        pairs = parse_pairs(option, (t for t in raw if self.bare is None or "=" in t), self.shape, self.example)
        values = {name: self.value_of(option, name, text) for name, text in pairs.items()}
        twice = [name for name in alone if name in values]
        if twice:
            raise GreyboxError(f"{option} {twice[0]}: given with values and {self.without_value}; keep one")
        return {**dict.fromkeys(alone), **values}

    def from_toml(self, place: str, data: Any) -> dict[str, Any]:
        return {
            name: None
            if self.bare is not None and value == self.bare
            else self.entry(f"{place}, {name}" if place else name, name, value)
            for name, value in as_table(place, data).items()
        }

    def to_toml(self, value: Mapping[str, Any]) -> dict[str, Any]:
        return {name: self.bare if one is None else self.entry_to_toml(one) for name, one in value.items()}

    def merge(self, in_file: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
        """Name by name."""
        return {**in_file, **given}

    without_value = "without one"

    def value_of(self, option: str, name: str, text: str) -> Any:
        """The value that stands after the ``=`` of an option."""
        return text

    def entry(self, place: str, name: str, data: Any) -> Any:
        """The value that stands at ``place`` in the file."""
        return text_in_file(place, data)

    def entry_to_toml(self, value: Any) -> Any:
        """One value as TOML."""
        return value


@dataclass(frozen=True)
class Numbers(Table):
    """A number for each name."""

    def value_of(self, option: str, name: str, text: str) -> float:
        return parse_number(f"{option} {name}={text}", text, f"{option} {name}=0.01")

    def entry(self, place: str, name: str, data: Any) -> float:
        return number_in_file(place, data, self.bare)


@dataclass(frozen=True)
class Priors(Table):
    """Mean and standard deviation for each name: ``M=0.0100+-0.0001``, or ``M = {mean = 0.01, std = 1e-4}``."""

    shape: str = "NAME=MEAN+-STD"
    example: str = "M=0.0100+-0.0001"

    def value_of(self, option: str, name: str, text: str) -> tuple[float, float]:
        parts = PLUS_MINUS.split(text)
        example = f"{option} {name}=0.0100+-0.0001"
        if len(parts) != 2:
            raise GreyboxError(f"{option} {name}={text}: write mean and standard deviation, as in {example}")
        mean, std = (parse_number(f"{option} {name}={text}", part.strip(), example) for part in parts)
        return mean, std

    def entry(self, place: str, name: str, data: Any) -> tuple[float, float]:
        inside = entries(place, data, ("mean", "std"), (), f"{name} = {{ mean = 0.0100, std = 0.0001 }}")
        return number_in_file(f"{place}, mean", inside["mean"]), number_in_file(f"{place}, std", inside["std"])

    def entry_to_toml(self, value: tuple[float, float]) -> dict[str, float]:
        return {"mean": value[0], "std": value[1]}


@dataclass(frozen=True)
class Schedules(Table):
    """What a parameter follows, and the value at which it holds: ``K2=P_S@8e5``, or ``K2 = {by = "P_S", at = 8e5}``."""

    shape: str = "NAME=CONDITION@VALUE"
    example: str = "K=u@2"

    def value_of(self, option: str, name: str, text: str) -> tuple[str, float | None]:
        by, at, value = (part.strip() for part in text.partition("@"))
        example = f"{option} {name}={by}@2"
        return by, parse_number(f"{option} {name}={text}", value, example) if at else None

    def entry(self, place: str, name: str, data: Any) -> tuple[str, float | None]:
        inside = entries(place, data, ("by",), ("at",), f'{name} = {{ by = "P_S", at = 8e5 }}')
        at = number_in_file(f"{place}, at", inside["at"]) if "at" in inside else None
        return text_in_file(f"{place}, by", inside["by"]), at

    def entry_to_toml(self, value: tuple[str, float | None]) -> dict[str, Any]:
        return {"by": value[0]} | ({} if value[1] is None else {"at": value[1]})


@dataclass(frozen=True)
class Conditions(Table):
    """One number for each record, for each name; without numbers, each record's file says it."""

    shape: str = "NAME=V1,V2,..."
    bare: str | None = "from the file"
    without_value = "from the files"

    def value_of(self, option: str, name: str, text: str) -> tuple[float, ...]:
        values = (part.strip() for part in text.split(","))
        return tuple(parse_number(f"{option} {name}={part}", part, f"{option} {name}=0.01") for part in values)

    def entry(self, place: str, name: str, data: Any) -> tuple[float, ...]:
        return tuple(number_in_file(place, item, self.bare) for item in (data if isinstance(data, list) else [data]))

    def entry_to_toml(self, value: tuple[float, ...]) -> list[float]:
        return list(value)


def parse_pairs(
    option: str, texts: Iterable[str], shape: str = "NAME=VALUE", example: str = "M=0.01"
) -> dict[str, str]:
    """``["M=1", "K=2"]`` as a dictionary. Raises GreyboxError for text without ``=`` and for names given twice."""
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            lacks = "it has no '='" if not equals else f"nothing stands {'after' if name else 'before'} the '='"
            raise GreyboxError(
                f"{option} {text}: {lacks}; write {option} {shape} without blanks, as in {option} {example}"
            )
        if name in values:
            raise GreyboxError(f"{option} {name}: given twice, as {values[name]} and {value}; keep one")
        values[name] = value
    return values


def parse_numbers(option: str, texts: Iterable[str], example: str = "M=0.01") -> dict[str, float]:
    """`parse_pairs` with finite numbers as values."""
    return Numbers(example=example).from_option(option, list(texts))


def parse_number(given: str, text: str, example: str) -> float:
    """``text``, which is part of what was ``given``, as a finite number. Raises GreyboxError."""
    try:
        number = float(text)
    except ValueError:
        raise GreyboxError(f"{given}: {text!r} is not a number; write it without a unit, as in {example}") from None
    if not math.isfinite(number):
        raise GreyboxError(f"{given}: the value must be finite")
    return number


def parse_names(texts: Iterable[str]) -> tuple[str, ...]:
    """``["B,K", "M"]`` as names."""
    return tuple(name for text in texts for name in text.replace(",", " ").split())


def number_in_file(place: str, data: Any, bare: str | None = None) -> float:
    """A finite number that stands at ``place``. Raises GreyboxError."""
    if isinstance(data, bool) or not isinstance(data, int | float):
        raise _wrong(place, data, f"must be a number in the unit of the model{f', or {bare!r}' if bare else ''}")
    try:
        value = float(data)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise _wrong(place, data, "must be finite")
    return value


def text_in_file(place: str, data: Any) -> str:
    """A text that stands at ``place``. Raises GreyboxError."""
    if not isinstance(data, str) or not data.strip():
        raise _wrong(place, data, "must be a text in quotes")
    return data


def as_list(place: str, data: Any) -> list[Any]:
    """The list at ``place``; a single value counts as a list of one. Raises GreyboxError for a table."""
    if isinstance(data, dict):
        raise _wrong(place, data, "must be a list, as in [...]")
    return data if isinstance(data, list) else [data]


def as_table(place: str, data: Any) -> dict[str, Any]:
    """The table at ``place``. Raises GreyboxError for anything else."""
    if not isinstance(data, dict):
        raise _wrong(place, data, "must be a table of NAME = VALUE")
    return data


def entries(place: str, data: Any, needed: Sequence[str], more: Sequence[str], example: str) -> dict[str, Any]:
    """A table at ``place`` that holds exactly the ``needed`` keys, and perhaps ``more``. Raises GreyboxError."""
    if not isinstance(data, dict) or not set(needed) <= set(data) <= {*needed, *more}:
        raise _wrong(place, data, f"write it as {example}")
    return data


def _wrong(place: str, data: Any, rule: str) -> GreyboxError:
    text = "a table" if isinstance(data, dict) else "a list" if isinstance(data, list) else repr(data)[:60]
    return GreyboxError(f"{place}: {text}: {rule}" if rule.startswith(("give", "write")) else f"{place}: {text} {rule}")
