"""Reading the JSON files that greybox writes: each is checked against the schema of its class, and the first offence is named."""

from __future__ import annotations

import json
import math
import os
import re
import secrets
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np

from greybox.base.errors import DataError, shorten
from greybox.base.files import write_file
from greybox.base.json_shape import FileKind, iterate_json, make_definitions, to_json_data

_LONE_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


# Bytes of a file: the fit of a record of ten million rows.
LARGEST_FILE = 1000000000


class StoredResult:
    """A result that is written to a file of its own, under the keys of its class."""

    def as_dict(self) -> dict[str, Any]:
        """The content of its file as numbers, texts, lists and dictionaries; what is not finite is None."""
        data: dict[str, Any] = to_json_data(self)
        return data

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it as JSON.

        Parameters
        ----------
        path
            The file; folders are made. Numbers that are not finite become null.

        Returns
        -------
        Path
            The file that was written.
        """
        return write_json(path, self)


def write_json(path: str | os.PathLike[str], value: Any) -> Path:
    """Write a result to its file, under the keys of its class. Folders are made; numbers that are not finite become null."""
    return write_file(path, iterate_json(value))


def read_json(path: str | Path, kind: type[Any]) -> dict[str, Any]:
    """The content of a result file, checked.

    Parameters
    ----------
    path
        The file.
    kind
        The class whose values are written so.

    Returns
    -------
    dict
        What the schema says of this kind, in any version so far. A list of very many numbers is an array (N,), NaN for null.

    Raises
    ------
    DataError
        If it cannot be read, is no JSON, comes from a later version, or is not as the schema says: with the first offence.
    """
    source = Path(path)
    file: FileKind = vars(kind)["FILE"]
    title, remedy, newest = file.title, file.source, file.version or math.inf
    refusal = f"{source}: not {title} that can be read"
    try:
        if source.exists() and not source.is_file():
            raise DataError(f"{source}: not a file; give the {remedy}")
        if source.stat().st_size > LARGEST_FILE:
            size = f"{source.stat().st_size / 1e6:.0f} MB"
            raise DataError(f"{source}: {size}, at most {LARGEST_FILE / 1e6:.0f} MB are read; give the {remedy}")
        with source.open("rb") as stream:
            data = _parse_stream(stream)
    except OSError as error:
        raise DataError(f"{refusal} ({error.strerror}); give the {remedy}") from None
    except ValueError as error:
        raise DataError(f"{refusal} (not JSON: {shorten(str(error), 100)}); give the {remedy}") from None
    version = data.get("format", 1) if isinstance(data, dict) else 1
    if isinstance(version, int) and version > newest:
        raise DataError(
            f"{source}: {title} of format {version}, written by a later version; this one reads up to {newest}"
        )
    offence = find_offence(data, kind)
    if offence:
        raise DataError(f"{source}: not {title} of this program: {offence}; give the {remedy}")
    return data


def parse_json(text: bytes) -> Any:
    """JSON by the letter: UTF-8, finite numbers, every character valid. Raises ValueError."""
    try:
        data = json.loads(text.decode("utf-8-sig"), parse_constant=_refuse_constant)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if _LONE_SURROGATE.search(text):
        try:
            json.dumps(data, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("a text in it is not valid Unicode") from None
    return data


# Bytes that are read at once, and from which on a list of numbers is read as an array: as a list, with its text, it would take twenty times
# the memory.
CHUNK = 1 << 20
# What a list of numbers and nulls is written with; anything else in it ends such a list.
_FLAT_LIST_ENDS = re.compile(rb"[^-+0-9.eE,nul \t\r\n]")
_QUOTE_OR_LIST, _STRING_ENDS = re.compile(rb'["\[]'), re.compile(rb'["\\]')


def _parse_stream(stream: BinaryIO) -> Any:
    """`parse_json` of a file whose long lists of numbers become arrays on the way: they are never in memory as text."""
    mark, arrays = secrets.token_hex(16), list[np.ndarray]()
    # All of the text but those lists, each of which has its mark there.
    text, numbers = bytearray(), _NumberList()
    in_string = False
    while chunk := stream.read(CHUNK):
        at = 0
        while at < len(chunk):
            if numbers.open:
                end = _FLAT_LIST_ENDS.search(chunk, at)
                numbers.add(chunk[at : end.start() if end else len(chunk)])
                at = end.start() if end else len(chunk)
                if end and end.group() == b"]" and numbers.values:
                    arrays.append(numbers.finish())
                    text += f'"{mark}{len(arrays) - 1}"'.encode()
                    at += 1
                elif end:
                    text += numbers.give_up()
            elif in_string:
                end = _STRING_ENDS.search(chunk, at)
                stop = end.end() if end else len(chunk)
                if end and end.group() == b"\\":
                    # What stands behind it ends no text, even where it is a quotation mark.
                    chunk += stream.read(1) if stop == len(chunk) else b""
                    stop += 1
                in_string = not (end and end.group() == b'"')
                text += chunk[at:stop]
                at = stop
            else:
                begin = _QUOTE_OR_LIST.search(chunk, at)
                stop = begin.start() if begin else len(chunk)
                text += chunk[at:stop]
                at = stop + bool(begin)
                if begin and begin.group() == b"[":
                    numbers.begin()
                elif begin:
                    text += b'"'
                    in_string = True
    if numbers.open:
        text += numbers.give_up()
    data = parse_json(bytes(text))
    return _put_back(data, {f"{mark}{k}": array for k, array in enumerate(arrays)}) if arrays else data


class _NumberList:
    """A list of numbers as it is read: its ``text`` so far, of which that of many numbers has become ``values``."""

    def __init__(self) -> None:
        self.open, self.text, self.values = False, bytearray(), array("d")

    def begin(self) -> None:
        self.open, self.text, self.values = True, bytearray(), array("d")

    def add(self, text: bytes) -> None:
        self.text += text
        if len(self.text) > CHUNK // 2 and (last := self.text.rfind(b",")) >= 0:
            self._convert(last)
            del self.text[: last + 1]

    def _convert(self, end: int) -> None:
        if not (part := bytes(self.text[:end])).strip():
            raise ValueError("a list lacks a number between two commas")
        values = np.array(json.loads(b"[" + part + b"]", parse_constant=_refuse_constant), float)
        self.values.frombytes(values.tobytes())

    def finish(self) -> np.ndarray:
        """All its numbers (N,), NaN for null."""
        self._convert(len(self.text))
        self.open = False
        return np.frombuffer(self.values)

    def give_up(self) -> bytes:
        """It as text: it is short, or holds something else than numbers."""
        self.open = False
        before = "".join(f"{'null' if math.isnan(value) else value!r}," for value in self.values)
        return b"[" + before.encode() + bytes(self.text)


def _put_back(data: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """``data`` with its arrays in the place of their marks."""
    if isinstance(data, dict):
        return {name: _put_back(value, arrays) for name, value in data.items()}
    if isinstance(data, list):
        return [_put_back(value, arrays) for value in data]
    return arrays.get(data, data) if isinstance(data, str) else data


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number; what is not finite is written as null")


def find_offence(data: Any, kind: type[Any]) -> str:
    """Place and rule of the first value that is not as the schema says; "" where all is right."""
    of: Any = kind
    error = next(_validator(of).iter_errors(data), None)
    return "" if error is None else _describe(error)


@cache
def _validator(kind: Any) -> Any:
    from jsonschema import Draft202012Validator
    from jsonschema.validators import extend

    quick = extend(
        Draft202012Validator,
        {"items": _quick_items(Draft202012Validator.VALIDATORS["items"])},
        type_checker=Draft202012Validator.TYPE_CHECKER.redefine(
            "array", lambda _, value: isinstance(value, (list, np.ndarray))
        ),
    )
    (schema,), definitions = make_definitions(kind)
    return quick({**schema, "$defs": definitions})


def _quick_items(check: Callable[..., Iterator[Any] | None]) -> Callable[..., Iterator[Any]]:
    """The rule ``items`` with a way around for long lists of numbers: a record has a hundred thousand of them."""
    numbers = {f"#/$defs/{name}": nothing for name, nothing in (("number", ()), ("number_or_null", (type(None),)))}

    def check_items(validator: Any, items: Any, instance: Any, schema: Any) -> Iterator[Any]:
        nothing = numbers.get(str(items.get("$ref"))) if isinstance(items, dict) else None
        if isinstance(instance, np.ndarray):
            # null was read as NaN, and a number beyond all doubles as infinity.
            if nothing is not None and not np.isinf(instance).any() and (nothing or not np.isnan(instance).any()):
                return
            instance = [None if math.isnan(value) else value for value in instance.tolist()]
        plain = nothing is not None and isinstance(instance, list) and {*map(type, instance)} <= {float, *nothing}
        if not (plain and math.inf not in instance and -math.inf not in instance):
            yield from check(validator, items, instance, schema) or ()

    return check_items


_RULES: Mapping[str, Callable[[Any], str]] = {
    "enum": lambda e: f"must be one of {', '.join(map(str, e.validator_value))}",
    "minimum": lambda e: f"must be at least {e.validator_value:g}",
    "maximum": lambda e: f"must be at most {e.validator_value:g}",
    "minItems": lambda e: f"must have at least {e.validator_value} entries",
    "maxItems": lambda e: f"must have at most {e.validator_value} entries",
}
_TYPES = {
    "object": "an object",
    "array": "a list",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "boolean": "true or false",
    "null": "null",
}


def _describe(error: Any) -> str:
    """``parameters.K.value is 'abc' and must be a number``."""
    place = shorten(_write_place(list(error.absolute_path)), 120)
    if error.validator == "required":
        missing = next(name for name in error.validator_value if name not in error.instance)
        return f"{f'{place} lacks' if place else 'it lacks'} the key {missing!r}"
    if error.validator == "type":
        kinds = [error.validator_value] if isinstance(error.validator_value, str) else error.validator_value
        rule = f"must be {' or '.join(_TYPES[kind] for kind in kinds)}"
    else:
        rule = _RULES.get(error.validator, lambda e: shorten(e.message, 100))(error)
    return f"{place or 'the file'} is {_write_value(error.instance)} and {rule}"


def _write_place(path: Sequence[str | int]) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


def _write_value(value: Any) -> str:
    if isinstance(value, dict | list | np.ndarray):
        return "an object" if isinstance(value, dict) else f"a list of {len(value)}"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**15:
        return "a number out of range"
    return shorten(json.dumps(value, ensure_ascii=False), 60)
