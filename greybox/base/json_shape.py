"""Results as JSON: one declaration beside each class, and the three functions of it: writing, reading, and the schema.

A dataclass is an object with its fields as keys, in their order. A class whose file differs says so in ``KEYS``, a text with one word for
each key in the order of the file:

======================  =================================================================================
``unit``                the attribute of that name: a field, or a property with an annotation
``moved=shift``         the attribute ``shift`` under the older key ``moved``
``cost=solver.cost``    an attribute of an attribute: the file is flatter than the value
``notes=str(findings)`` the sentence of each finding of a list or a mapping, or of the one value: empty for None
``memory?``             left out where it is empty
``models!``             always there, though it is no field without a default: a reader may rely on it
``*``                   all fields, in their order
``fit.*``               all keys of the value of the field ``fit``
======================  =================================================================================

What is read back are the fields; a property, and what is behind one, is only written. Types say what may stand there. JSON has no NaN and
no infinity: both are null. Null is read as NaN where the type is ``float``; the types below say it where that is not so. Descriptions in
the schema are the docstrings: the sections of the class for its fields, the first paragraph for a property.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import secrets
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    NotRequired,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import numpy as np

from greybox.base.numerics import ROWS_AT_A_TIME


@dataclass(frozen=True)
class Null:
    """What null in a file stands for; None: null may not stand there."""

    value: float | None = None


@dataclass(frozen=True)
class Axes:
    """How many axes an array has; one where nothing is said."""

    count: int


Finite = Annotated[float, Null()]
"""A number that is never null in a file."""
Unbounded = Annotated[float, Null(math.inf)]
"""A number that is infinite where the file has null."""
Interval = tuple[Annotated[float, Null(-math.inf)], Annotated[float, Null(math.inf)]]
"""Lower and upper end; null in a file where that side is open."""
FiniteArray = Annotated[np.ndarray, Null()]
"""Numbers (N,) without a gap."""
UnboundedArray = Annotated[np.ndarray, Null(math.inf)]
"""Numbers (N,), infinite where the file has null."""
Matrix = Annotated[np.ndarray, Axes(2)]
"""Rows of numbers (N, M)."""
ComplexArray = Annotated[np.ndarray, complex]
"""Complex numbers (N,), in a file each with its real and its imaginary part."""


@dataclass(frozen=True)
class FileKind:
    """A kind of result file: a class with one as ``FILE`` is the content of such a file.

    Parameters
    ----------
    title
        What messages call it: ``a fit``.
    source
        What to give in the place of another file: ``fit.json that greybox fit has written``.
    version
        Its format; within one keys are added and none changes. None for what is printed or a line of a file, and has no version.
    refusal
        What an unreadable one is called in messages, where that is not ``not TITLE that can be read``.
    """

    title: str
    source: str = ""
    version: int | None = 1
    refusal: str = ""


class Key(NamedTuple):
    """One key of a file: the attributes that lead to its value, whether that is written as text, left out where empty, always there."""

    name: str
    path: tuple[str, ...]
    as_text: bool = False
    may_lack: bool = False
    is_sure: bool = False


_WORD = re.compile(r"(\w+)([?!]?)(?:=(str\()?([\w.]+)\)?)?")


@cache
def list_keys(kind: Any) -> tuple[Key, ...]:
    """The keys of a class in the order of its file, without ``format``."""
    keys: list[Key] = []
    for word in getattr(kind, "KEYS", "*").split():
        if word == "*":
            names = _hints(kind) if is_typeddict(kind) else [field.name for field in fields(kind)]
            keys += (Key(name, (name,)) for name in names)
            continue
        if word.endswith(".*"):
            field = word.removesuffix(".*")
            keys += (key._replace(path=(field, *key.path)) for key in list_keys(_hints(kind)[field]))
            continue
        match = _WORD.fullmatch(word)
        if match is None:
            raise ValueError(f"{kind.__name__}.KEYS: {word!r} is no key")
        name, mark, as_text, path = match.groups()
        keys.append(Key(name, tuple((path or name).split(".")), bool(as_text), mark == "?", mark == "!"))
    return tuple(keys)


# Writing.


def to_json_data(value: Any, convert_array: Callable[[np.ndarray], Any] | None = None) -> Any:
    """``value`` as JSON data: arrays become lists, dataclasses dictionaries, NaN and infinities None.

    ``convert_array``: what becomes of arrays instead.
    """
    kind: Any = type(value)
    if kind in (str, bool, int, types.NoneType):  # most values: asking for abstract classes is slow
        return value
    if kind is float:
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return convert_array(value) if convert_array else to_json_data(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): to_json_data(v, convert_array) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json_data(v, convert_array) for v in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, complex):
        return [to_json_data(value.real), to_json_data(value.imag)]
    file: FileKind | None = getattr(kind, "FILE", None)
    data: dict[str, Any] = {} if file is None or file.version is None else {"format": file.version}
    for name, each in _look_up(value):
        data[name] = to_json_data(each, convert_array)
    return data


def to_values(value: Any) -> Any:
    """What a value says under the keys of its file, without its arrays: what the sentence of a finding needs."""
    if is_dataclass(value):
        return {name: to_values(each) for name, each in _look_up(value) if not isinstance(each, np.ndarray)}
    if isinstance(value, Mapping):
        return {name: to_values(each) for name, each in value.items()}
    return [*map(to_values, value)] if isinstance(value, (list, tuple)) else value


def _look_up(value: Any) -> Iterator[tuple[str, Any]]:
    """The keys that a value is written under, each with what stands there."""
    for name, path, as_text, may_lack, _ in list_keys(value.__class__):
        each = value
        for attribute in path:
            each = None if each is None else getattr(each, attribute)
        if as_text and isinstance(each, Mapping):
            each = {key: str(one) for key, one in each.items()}
        elif as_text:
            each = [*map(str, each)] if isinstance(each, (list, tuple)) else "" if each is None else str(each)
        if not may_lack or (each is not None and (len(each) if hasattr(each, "__len__") else each)):
            yield name, each


def format_json(data: Mapping[str, Any]) -> str:
    """JSON with a line for each entry of the two outer levels: readable, and long arrays stay on one line."""
    rows = []
    for key, value in data.items():
        if isinstance(value, dict) and value:
            inner = ",\n".join(f"  {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in value.items())
            rows.append(f" {json.dumps(key)}: {{\n{inner}\n }}")
        else:
            rows.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n" + ",\n".join(rows) + "\n}"


def iterate_json(value: Any) -> Iterator[str]:
    """The text of ``format_json(to_json_data(value))`` in parts, so that long arrays need not be in memory as text."""
    mark, arrays = secrets.token_hex(16), list[np.ndarray]()

    def put_aside(array: np.ndarray) -> Any:
        if array.ndim != 1 or len(array) <= ROWS_AT_A_TIME:
            return to_json_data(array.tolist())
        arrays.append(array)
        return mark

    between, *others = (format_json(to_json_data(value, put_aside)) + "\n").split(f'"{mark}"')
    yield between
    for array, text in zip(arrays, others, strict=True):
        for first in range(0, len(array), ROWS_AT_A_TIME):
            part = to_json_data(array[first : first + ROWS_AT_A_TIME].tolist())
            yield f"{', ' if first else '['}{json.dumps(part, allow_nan=False)[1:-1]}"
        yield f"]{text}"


# Reading.

Read = TypeVar("Read")


def from_json_data(kind: type[Read], data: Mapping[str, Any], given: Mapping[str, Any] | None = None) -> Read:
    """The value that wrote ``data``, which its schema has been held against.

    Parameters
    ----------
    kind
        Its class.
    data
        The content of the file. A key that it lacks has the default of its field; one that ``kind`` does not know is passed over.
    given
        Values that are not in the file, or are in it in another form, by path: ``model``, ``solver.statistics``.

    Returns
    -------
    Read
        The value.
    """
    values: dict[str, Any] = {}
    shape: Any = kind
    for key, restore in _read_plan(shape):
        if key.name in data:
            _put(values, key.path, restore(data[key.name]))
    for name, value in (given or {}).items():
        _put(values, tuple(name.split(".")), value)
    return _build(kind, values)


@cache
def _read_plan(kind: Any) -> list[tuple[Key, Callable[[Any], Any]]]:
    """Each key that is read back, with the function that makes its value."""
    ends = ((key, [*_follow(kind, key.path)]) for key in list_keys(kind))
    return [(k, _restorer(a[-1].hint)) for k, a in ends if not k.as_text and all(each.is_field for each in a)]


def _put(values: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    *groups, last = path
    for group in groups:
        values = values.setdefault(group, {})
    values[last] = _Leaf(value)


class _Leaf(NamedTuple):
    value: Any


def _build(kind: type[Read], values: Mapping[str, Any]) -> Read:
    """A value from those of its fields; a group of them is the value of a field's own class."""
    shape: Any = kind
    hints = _hints(shape)
    return kind(**{n: v.value if isinstance(v, _Leaf) else _build(hints[n], v) for n, v in values.items()})


def _restorer(hint: Any) -> Callable[[Any], Any]:
    """What makes the value of a type from JSON data."""
    hint, marks = _strip(hint)
    origin, arguments = get_origin(hint), get_args(hint)
    null = next((mark.value for mark in marks if isinstance(mark, Null)), math.nan)
    if hint is float:
        return lambda value: null if value is None else value
    if hint is np.ndarray:
        return partial(_to_array, null=null, axes=_axes(marks))
    if origin in (Union, types.UnionType):
        inner = [_restorer(each) for each in arguments if each is not types.NoneType]
        # Of several classes none is read back.
        return (lambda value: None if value is None else inner[0](value)) if len(inner) == 1 else lambda value: value
    if isinstance(origin, type) and issubclass(origin, Mapping):
        name, each = int if arguments[0] is int else str, _restorer(arguments[1])
        return lambda value: {name(k): each(v) for k, v in value.items()}
    if origin is tuple and arguments[-1] is not Ellipsis:
        parts = [_restorer(each) for each in arguments]
        return lambda value: tuple(part(v) for part, v in zip(parts, value, strict=True))
    if isinstance(origin, type) and issubclass(origin, Sequence):
        each = _restorer(arguments[0])
        return (lambda value: [*map(each, value)]) if origin is list else lambda value: tuple(map(each, value))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return hint
    if isinstance(hint, type) and is_dataclass(hint):
        return partial(from_json_data, hint)
    return lambda value: value


def _to_array(values: list[Any] | np.ndarray, null: float | None, axes: int) -> np.ndarray:
    array = np.asarray(values, dtype=float)  # None becomes NaN
    if null == math.inf:
        array = np.where(np.isnan(array), null, array)
    return array if array.ndim == axes else array.reshape(len(values), *(0,) * (axes - 1))


# The schema.

DRAFT = "https://json-schema.org/draft/2020-12/schema"
# Largest finite number, and largest integer that every reader of JSON holds without loss of its last digit.
LARGEST_NUMBER = 1.7976931348623157e308
LARGEST_INTEGER = 10**15

_RANGE = {"minimum": -LARGEST_NUMBER, "maximum": LARGEST_NUMBER}
# The two definitions that every schema has.
NUMBERS: dict[str, Any] = {
    "number": {"description": "A finite number.", "type": "number", **_RANGE},
    "number_or_null": {
        "description": "A finite number; null where it is NaN or infinite.",
        "type": ["number", "null"],
        **_RANGE,
    },
}


def make_definitions(*kinds: Any) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The schema of each of these types, and the definitions that they refer to as ``#/$defs/NAME``."""
    definitions: dict[str, Any] = {}
    schemas = [_describe(kind, definitions) for kind in kinds]
    return schemas, definitions | NUMBERS


def _describe(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """The schema of a type; what it refers to is added to ``definitions``."""
    describe = partial(_describe, definitions=definitions)
    hint, marks = _strip(hint)
    origin, arguments = get_origin(hint), get_args(hint)
    if hint in (float, np.ndarray, complex):
        null = next((mark.value for mark in marks if isinstance(mark, Null)), math.nan)
        number: dict[str, Any] = {"$ref": f"#/$defs/{'number' if null is None else 'number_or_null'}"}
        if hint is complex or complex in marks:  # real and imaginary part
            number = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
        for _ in range(_axes(marks) if hint is np.ndarray else 0):
            number = {"type": "array", "items": number}
        return number
    if origin in (Union, types.UnionType):
        inner = [describe(each) for each in arguments if each is not types.NoneType]
        if len(inner) == len(arguments):
            return {"anyOf": inner}
        return _or_null(inner[0], definitions) if len(inner) == 1 else {"anyOf": [*inner, {"type": "null"}]}
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": describe(arguments[1])}
    if origin is tuple and arguments[-1] is not Ellipsis:
        items = {json.dumps(each): each for each in map(describe, arguments)}
        item = next(iter(items.values())) if len(items) == 1 else {"anyOf": [*items.values()]}
        return {"type": "array", "items": item, "minItems": len(arguments), "maxItems": len(arguments)}
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return {"type": "array", "items": describe(arguments[0])}
    if origin is Literal:
        return {"enum": [*arguments]}
    if isinstance(hint, type) and issubclass(hint, Enum):
        return {"enum": [*(each.value for each in hint), *getattr(hint, "former_names", dict)()]}
    if is_dataclass(hint) or is_typeddict(hint):
        name = definition_name(hint)
        if name not in definitions:
            definitions[name] = {}  # a class may hold values of its own kind
            definitions[name] |= _describe_class(hint, definitions)
        return {"$ref": f"#/$defs/{name}"}
    plain = {str: "string", bool: "boolean", dict: "object", Mapping: "object", list: "array"}
    if hint is int:
        return {"type": "integer", "minimum": -LARGEST_INTEGER, "maximum": LARGEST_INTEGER}
    return {"type": plain[hint]} if hint in plain else {}


def definition_name(kind: Any) -> str:
    """``Misfit`` is ``misfit``, ``NoiseBound`` ``noise_bound``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower()


def _describe_class(kind: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """An object with the keys of a class; needed are those whose fields have no default."""
    properties: dict[str, Any] = {}
    needed = []
    for key in list_keys(kind):
        attributes = [*_follow(kind, key.path)]
        hint = attributes[-1].hint
        if key.as_text:
            schema: dict[str, Any] = {"type": "string"}
            if isinstance(get_origin(hint), type) and issubclass(get_origin(hint), Sequence):
                schema = {"type": "array", "items": schema}
            elif isinstance(get_origin(hint), type) and issubclass(get_origin(hint), Mapping):
                schema = {"type": "object", "additionalProperties": schema}
        else:
            schema = _describe(hint, definitions)
        # With the sentence of the class where the attribute has none.
        text = attributes[-1].description or definitions.get(schema.get("$ref", "").rpartition("/")[2], {}).get(
            "description", ""
        )
        properties[key.name] = {"description": text, **schema}
        if key.is_sure or not (key.as_text or key.may_lack or any(not a.is_needed for a in attributes)):
            needed.append(key.name)
    file: FileKind | None = getattr(kind, "FILE", None)
    if file is not None and file.version is not None:
        sentence = "Version of this kind of file; 1 where it is missing."
        version = {"description": sentence, "type": "integer", "minimum": 1, "maximum": file.version}
        properties = {"format": version} | properties
    text = _first_paragraph(kind)
    return {"description": text, "type": "object", "properties": properties, "required": needed}


def _or_null(schema: dict[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    """The schema of a value that may be missing."""
    name = schema.get("$ref", "").rpartition("/")[2]
    if name in NUMBERS:
        return {"$ref": "#/$defs/number_or_null"}
    if name:  # in place, so that an offence is named by its own rule
        schema = definitions[name]
    if "enum" in schema:
        return {**schema, "enum": [*schema["enum"], None]}
    return {**schema, "type": [schema["type"], "null"]} if "type" in schema else schema


# What a class says of its attributes.


class _Attribute(NamedTuple):
    hint: Any
    description: str
    is_field: bool = False
    is_needed: bool = False


def _follow(kind: Any, path: Sequence[str]) -> Iterator[_Attribute]:
    """The attributes of a path, each of the class that the one before it is of."""
    for name in path:
        if is_typeddict(kind):
            hint = _hints(kind)[name]
            may_lack = get_origin(hint) is NotRequired
            hint = get_args(hint)[0] if may_lack else hint
            attribute = _Attribute(hint, _describe_fields(kind).get(name, ""), True, not may_lack)
        elif (field := kind.__dataclass_fields__.get(name)) is not None:
            is_needed = field.default is MISSING and field.default_factory is MISSING
            attribute = _Attribute(_hints(kind)[name], _describe_fields(kind).get(name, ""), True, is_needed)
        else:
            member = inspect.getattr_static(kind, name, None)
            getter = getattr(member, "fget", None) or getattr(member, "func", None)
            if getter is None:
                raise TypeError(f"{kind.__name__}.KEYS: {'.'.join(path)} leads to no field and no property")
            hint = get_type_hints(getter, include_extras=True).get("return", Any)
            attribute = _Attribute(hint, _first_paragraph(getter))
        yield attribute
        kind = _strip(_without_none(attribute.hint))[0]


@cache
def _hints(kind: Any) -> Mapping[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _strip(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without its marks, and these; a class of mappings is written as the mapping that it is."""
    hint, marks = (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())
    mappings = (base for base in getattr(hint, "__orig_bases__", ()) if get_origin(base) is Mapping)
    return next(mappings, hint), marks


def _without_none(hint: Any) -> Any:
    """The one class that a value is of, where it is there."""
    classes = [each for each in get_args(hint) if each is not types.NoneType]
    return classes[0] if get_origin(hint) in (Union, types.UnionType) and len(classes) == 1 else hint


def _axes(marks: Sequence[Any]) -> int:
    return next((mark.count for mark in marks if isinstance(mark, Axes)), 1)


def _first_paragraph(described: Any) -> str:
    return " ".join((inspect.getdoc(described) or "").partition("\n\n")[0].split())


_SECTION = re.compile(r"^(?:Parameters|Attributes)\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)", re.MULTILINE | re.DOTALL)
_ENTRY = re.compile(r"^([\w$][\w$, ]*)(?: :.*)?\n((?:[ ]+.*\n?|\n)+)", re.MULTILINE)


@cache
def _describe_fields(kind: Any) -> Mapping[str, str]:
    """What the docstring of a class says of each field, those of its bases included."""
    texts: dict[str, str] = {}
    for each in (kind,) if is_typeddict(kind) else reversed(kind.__mro__):
        for section in _SECTION.findall(inspect.cleandoc(each.__doc__ or "")):
            for names, text in _ENTRY.findall(section + "\n"):
                texts |= dict.fromkeys(re.split(r",\s*", names.strip()), " ".join(text.split()))
    return texts
