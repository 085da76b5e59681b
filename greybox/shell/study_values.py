"""The kinds of values that an option holds, each with its two spellings: as words of the command line and as TOML.

A kind reads both spellings into the same Python value and writes the value as TOML, so that a study that was written from
options gives the same numbers as the options, to the last bit.
"""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import click

from greybox.base import GreyboxError, ModelError, nearest

PLUS_MINUS = re.compile(r"\+-|\+/-|±")
T = TypeVar("T")


class Kind(Generic[T]):
    """How the values of one option are written.

    Attributes
    ----------
    empty
        The value of an option that nobody has set.
    type
        What the reader of the command line makes of one word.
    repeated
        Whether the option may be given several times.
    """

    empty: T
    type: Any = click.STRING
    repeated = False

    def from_option(self, option: str, raw: Any) -> T:
        """The value that was given with ``option``. Raises GreyboxError."""
        return raw

    def from_toml(self, place: str, data: Any) -> T:
        """The value that stands at ``place`` in a study file. Raises GreyboxError."""
        return text_in_file(place, data)  # type: ignore[return-value]

    def to_toml(self, value: T) -> Any:
        """The value as TOML can hold it: a string, number, truth value, list or mapping of these."""
        return list(value) if isinstance(value, tuple) else value

    def merge(self, in_file: T, given: T) -> T:
        """The value of an option that is set in a study file and on the command line: the command line wins."""
        return given

    def moved(self, value: T, move: Callable[[Path], Path]) -> T:
        """The value with its paths as seen from another folder."""
        return value

    def is_set(self, value: T) -> bool:
        """Whether the value asks for something."""
        return value != self.empty

    def spell(self, value: T) -> str:
        """What a message names beside the option: the value where it is one word, the first of several names, else nothing."""
        return "" if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)

    def typed(self, value: T) -> list[str]:
        """What stands behind the option when it is typed, once for each time; numbers with all digits."""
        return [str(item) for item in value] if isinstance(value, tuple) else [str(value)]


@dataclass(frozen=True)
class Switch(Kind[bool]):
    """On or off."""

    empty: bool = False
    type = click.BOOL

    def from_toml(self, place: str, data: Any) -> bool:
        if not isinstance(data, bool):
            raise _wrong(place, data, "must be true or false")
        return data


@dataclass(frozen=True)
class Count(Kind[int]):
    """A whole number from ``least`` up; it asks for something where it is neither ``empty`` nor ``idle``."""

    least: int = 0
    empty: int = 0
    idle: int | None = None
    most: int | None = None

    @property
    def type(self) -> click.ParamType:
        return click.IntRange(min=self.least, max=self.most)

    def from_toml(self, place: str, data: Any) -> int:
        if isinstance(data, bool) or not isinstance(data, int):
            raise _wrong(place, data, "must be a whole number")
        if data < self.least:
            raise _wrong(place, data, f"give {self.least} or more")
        return data

    def is_set(self, value: int) -> bool:
        return value not in (self.empty, self.idle)


@dataclass(frozen=True)
class Seed(Count):
    """A seed; none where it is left to the program."""

    empty: int | None = None  # type: ignore[assignment]


@dataclass(frozen=True)
class Counts(Kind[tuple[int, ...]]):
    """Several whole numbers from ``least`` up."""

    least: int = 0
    empty: tuple[int, ...] = ()
    repeated = True

    @property
    def type(self) -> click.ParamType:
        return click.IntRange(min=self.least)

    def from_toml(self, place: str, data: Any) -> tuple[int, ...]:
        return tuple(Count(self.least).from_toml(place, item) for item in as_list(place, data))


@dataclass(frozen=True)
class Quantity(Kind[float]):
    """A number above zero; zero where it is not given."""

    empty: float = 0.0
    type = click.FLOAT

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
class Number(Kind[float]):
    """Any finite number."""

    empty: float = 0.0
    type = click.FLOAT

    def from_toml(self, place: str, data: Any) -> float:
        return number_in_file(place, data)


@dataclass(frozen=True)
class MaybeNumber(Kind[float | None]):
    """Any finite number, or none."""

    empty: float | None = None
    type = click.FLOAT

    def from_toml(self, place: str, data: Any) -> float | None:
        return number_in_file(place, data)


@dataclass(frozen=True)
class Word(Kind[str]):
    """A text that the library itself checks."""

    empty: str = ""


@dataclass(frozen=True)
class Moment(Word):
    """A time of a record: seconds, or a date or a time of day."""

    def from_toml(self, place: str, data: Any) -> str:
        if isinstance(data, str | datetime.date | datetime.time):
            return str(data)
        return f"{number_in_file(place, data):.17g}"


@dataclass(frozen=True)
class Choice(Kind[str]):
    """One of ``choices``, of which the first is the default unless ``empty`` names another."""

    choices: tuple[str, ...]
    start: str | None = None

    @property
    def empty(self) -> str:  # type: ignore[override]
        return self.choices[0] if self.start is None else self.start

    @property
    def type(self) -> click.ParamType:
        return click.Choice(self.choices)

    def from_toml(self, place: str, data: Any) -> str:
        if data not in self.choices:
            raise GreyboxError(f"{place}: there is no choice {data!r}; {nearest(str(data), self.choices)}")
        return str(data)


@dataclass(frozen=True)
class Names(Kind[tuple[str, ...]]):
    """Names: an option given several times; with ``split`` several names after one option as well."""

    split: bool = False
    empty: tuple[str, ...] = ()
    repeated = True

    def from_option(self, option: str, raw: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for text in raw for name in text.replace(",", " ").split()) if self.split else tuple(raw)

    def from_toml(self, place: str, data: Any) -> tuple[str, ...]:
        return tuple(text_in_file(place, item) for item in as_list(place, data))

    def spell(self, value: tuple[str, ...]) -> str:
        return value[0]


@dataclass(frozen=True)
class CommaNames(Names):
    """Names after one option, separated by commas; those of an option that is given several times belong together."""

    def from_option(self, option: str, raw: Sequence[str]) -> tuple[str, ...]:
        return tuple(name.strip() for text in raw for name in text.split(",") if name.strip())

    def typed(self, value: tuple[str, ...]) -> list[str]:
        return [",".join(value)]


@dataclass(frozen=True)
class Headers(CommaNames):
    """Headers after one option, separated by commas; blanks and brackets belong to them: ``time [ms],u,-,x [um]``."""

    def from_option(self, option: str, raw: Sequence[str]) -> tuple[str, ...]:
        headers = tuple(name.strip() for text in raw for name in text.split(","))
        if not all(headers):
            raise GreyboxError(f"{option} {','.join(raw)}: a name is empty; write '-' for a column that is not wanted")
        return headers

    def from_toml(self, place: str, data: Any) -> tuple[str, ...]:
        if isinstance(data, dict):
            raise _wrong(
                place,
                data,
                'must be a list of all columns in their order, as in ["time", "u", "x"]; headers of single signals stand under [columns]',
            )
        return super().from_toml(place, data)


PATH = click.Path(path_type=Path)  # whether a file is there says whoever reads it


@dataclass(frozen=True)
class Files(Kind[tuple[Path, ...]]):
    """Paths of files. Those in a study file are relative to its folder."""

    empty: tuple[Path, ...] = ()
    type = PATH
    repeated = True

    def from_toml(self, place: str, data: Any) -> tuple[Path, ...]:
        return tuple(Path(text_in_file(place, item)) for item in as_list(place, data))

    def to_toml(self, value: tuple[Path, ...]) -> list[str]:
        return [path.as_posix() for path in value]

    def moved(self, value: tuple[Path, ...], move: Callable[[Path], Path]) -> tuple[Path, ...]:
        return tuple(map(move, value))

    def spell(self, value: tuple[Path, ...]) -> str:
        return str(value[0])


@dataclass(frozen=True)
class File(Kind[Path | None]):
    """The path of one file or folder, relative to the folder of a study file that names it."""

    empty: Path | None = None
    type = PATH

    def from_toml(self, place: str, data: Any) -> Path:
        return Path(text_in_file(place, data))

    def to_toml(self, value: Path | None) -> str:
        return "" if value is None else value.as_posix()

    def moved(self, value: Path | None, move: Callable[[Path], Path]) -> Path | None:
        return None if value is None else move(value)


def split_model_path(name: str) -> tuple[Path, str]:
    """The file of ``my/rig.py:name``, and the name in it; "" where it has none."""
    file, colon, wanted = name.rpartition(".py:")
    return (Path(f"{file}.py"), wanted) if colon else (Path(name), "")


def is_name_of_model(value: str) -> bool:
    """Whether ``value`` is the name of a model, which has no ending, and not its file."""
    return bool(value) and not split_model_path(value)[0].suffix and "/" not in value and "\\" not in value


@dataclass(frozen=True)
class ModelName(Word):
    """A model: its name, or its file, which is a program; or a result that holds one."""

    def moved(self, value: str, move: Callable[[Path], Path]) -> str:
        if is_name_of_model(value):
            return value
        file, name = split_model_path(value)
        return move(file).as_posix() + (f":{name}" if name else "")


@dataclass(frozen=True)
class FrequencyBand(Kind[tuple[float, float] | None]):
    """Two ends, the lower one first: ``5:800``, or ``[5, 800]``."""

    empty: tuple[float, float] | None = None
    example: str = "5:800"

    def from_option(self, option: str, raw: str) -> tuple[float, float]:
        try:
            low, high = (float(part) for part in raw.split(":"))
        except ValueError:
            raise GreyboxError(f"{option} {raw}: write it as LOW:HIGH in Hz, as in {option} {self.example}") from None
        return self._checked(f"{option} {raw}", low, high)

    def from_toml(self, place: str, data: Any) -> tuple[float, float]:
        ends = [number_in_file(place, end) for end in as_list(place, data)]
        if len(ends) != 2:
            raise _wrong(place, data, "write it as [LOW, HIGH] in Hz")
        return self._checked(place, *ends)

    def _checked(self, given: str, low: float, high: float) -> tuple[float, float]:
        if not 0 <= low < high:
            raise GreyboxError(f"{given}: the low end must be at least 0 and below the high end")
        return low, high

    def spell(self, value: tuple[float, float] | None) -> str:
        return ""

    def typed(self, value: tuple[float, float] | None) -> list[str]:
        return [] if value is None else ["{}:{}".format(*value)]


@dataclass(frozen=True)
class Table(Kind[Mapping[str, Any]]):
    """Something for each name: an option ``NAME=...`` given several times, or a table of the file.

    ``shape`` and ``example`` show how the option is written; ``bare`` is the word that stands in the file for a name without
    a value, None where a value must follow.
    """

    shape: str = "NAME=VALUE"
    example: str = "M=0.01"
    bare: str | None = None
    repeated = True

    @property
    def empty(self) -> Mapping[str, Any]:  # type: ignore[override]
        return {}

    def spell(self, value: Mapping[str, Any]) -> str:
        return next(iter(value))

    def typed(self, value: Mapping[str, Any]) -> list[str]:
        return [name if one is None else f"{name}={self.typed_value(one)}" for name, one in value.items()]

    def typed_value(self, value: Any) -> str:
        """One value as it is typed."""
        return str(value)

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
class ColumnHeaders(Table):
    """A header for each signal, whose name may carry the unit of the column: ``time [ms]=millis``."""

    shape: str = "NAME=HEADER"
    example: str = "x=Laser"

    def merge(self, in_file: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
        """Signal by signal."""
        from greybox.data.columns import merge_mappings

        return merge_mappings(in_file, given)


@dataclass(frozen=True)
class Numbers(Table):
    """A number for each name."""

    def value_of(self, option: str, name: str, text: str) -> float:
        if quantity := _QUANTITY.fullmatch(text):
            raise ValueWithUnitError(option, name, quantity["number"], quantity["unit"])
        return parse_number(f"{option} {name}={text}", text, f"{option} {name}=0.01")

    def entry(self, place: str, name: str, data: Any) -> float:
        return number_in_file(place, data, self.bare)


# A number and a unit behind it: 165cm^2, 1.5e-3 m, 20 °C.
_QUANTITY = re.compile(
    r"(?P<number>[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?)\s*(?P<unit>(?!e[+-]?\d)[^\d\s.,+-].*)", re.IGNORECASE
)


class ValueWithUnitError(GreyboxError):
    """A value in a unit of its own: ``--fix A2=165cm^2``. Which one the model wants, whoever knows the model says."""

    def __init__(self, option: str, name: str, number: str, unit: str) -> None:
        self.option, self.name, self.number, self.unit = option, name, number, unit
        super().__init__(
            f"{option} {name}={number}{unit}: write the number alone, in the unit that {name} has in the model, as in {option}"
            f" {name}={number}"
        )

    def in_unit(self, unit: str) -> GreyboxError:
        """The message that names the ``unit`` of the model, and the number in it where that of the value converts."""
        from greybox.base import format_unit
        from greybox.data.notation import read_conversion

        given = f"{self.option} {self.name}"
        wanted = f"{given}={self.number}{self.unit}: {self.name} is in {format_unit(unit) or '1'} in the model; write the number"
        try:
            value = float(read_conversion(self.unit, unit, is_told=True)([float(self.number)])[0])
        except ModelError as error:
            return GreyboxError(f"{wanted} alone, in that unit ({error})")
        return GreyboxError(f"{wanted} in it alone, {given}={value:.10g}")


@dataclass(frozen=True)
class NamedLevels(Numbers):
    """A standard deviation for each output, or the name of a level that outputs have in common: ``x=2e-7``, ``x=a``."""

    def value_of(self, option: str, name: str, text: str) -> float | str:  # type: ignore[override]
        return text if text.isidentifier() else super().value_of(option, name, text)

    def entry(self, place: str, name: str, data: Any) -> float | str:  # type: ignore[override]
        return data if isinstance(data, str) and data.isidentifier() else super().entry(place, name, data)


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

    def typed_value(self, value: tuple[float, float]) -> str:
        return "{}+-{}".format(*value)

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

    def typed_value(self, value: tuple[str, float | None]) -> str:
        return value[0] if value[1] is None else "{}@{}".format(*value)

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

    def typed_value(self, value: tuple[float, ...]) -> str:
        return ",".join(map(str, value))

    def entry_to_toml(self, value: tuple[float, ...]) -> list[float]:
        return list(value)


@dataclass(frozen=True)
class Limits(Table):
    """A range for each name, of which an end may be left out: ``u=-3:3``, or ``u = {low = -3, high = 3}``."""

    shape: str = "NAME=LOW:HIGH"
    example: str = "u=-3:3"

    def value_of(self, option: str, name: str, text: str) -> tuple[float, float]:
        low, colon, high = text.partition(":")
        given, example = f"{option} {name}={text}", f"{option} {self.example}"
        if not colon:
            raise GreyboxError(f"{given}: write it as LOW:HIGH, as in {example}")
        ends = (parse_number(given, end, example) if end else None for end in (low, high))
        return _ends(*ends)

    def entry(self, place: str, name: str, data: Any) -> tuple[float, float]:
        inside = entries(place, data, (), ("low", "high"), f"{name} = {{ low = -3.0, high = 3.0 }}")
        return _ends(
            *(number_in_file(f"{place}, {end}", inside[end]) if end in inside else None for end in ("low", "high"))
        )

    def typed_value(self, value: tuple[float, float]) -> str:
        return ":".join(str(end) if math.isfinite(end) else "" for end in value)

    def entry_to_toml(self, value: tuple[float, float]) -> dict[str, float]:
        return {end: limit for end, limit in zip(("low", "high"), value, strict=True) if math.isfinite(limit)}


def _ends(low: float | None, high: float | None) -> tuple[float, float]:
    return -math.inf if low is None else low, math.inf if high is None else high


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


def parse_number(given: str, text: str, example: str) -> float:
    """``text``, which is part of what was ``given``, as a finite number. Raises GreyboxError."""
    try:
        number = float(text)
    except ValueError:
        raise GreyboxError(f"{given}: {text!r} is not a number; write it without a unit, as in {example}") from None
    if not math.isfinite(number):
        raise GreyboxError(f"{given}: the value must be finite")
    return number


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
