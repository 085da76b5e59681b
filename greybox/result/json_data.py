"""Results as JSON: readable, and without loss but for infinities and NaN, which become null."""

from __future__ import annotations

import json
import math
import secrets
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from types import NoneType
from typing import Any

import numpy as np

from greybox.numerics import ROWS_AT_A_TIME


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


def iterate_json(data: Mapping[str, Any]) -> Iterator[str]:
    """The text of ``format_json(to_json_data(data))`` in parts, so that long arrays need not be in memory as text."""
    mark, arrays = secrets.token_hex(16), list[np.ndarray]()

    def put_aside(array: np.ndarray) -> Any:
        if array.ndim != 1 or len(array) <= ROWS_AT_A_TIME:
            return to_json_data(array.tolist())
        arrays.append(array)
        return mark

    between, *others = (format_json(to_json_data(data, put_aside)) + "\n").split(f'"{mark}"')
    yield between
    for array, text in zip(arrays, others, strict=True):
        for first in range(0, len(array), ROWS_AT_A_TIME):
            part = to_json_data(array[first : first + ROWS_AT_A_TIME].tolist())
            yield f"{', ' if first else '['}{json.dumps(part, allow_nan=False)[1:-1]}"
        yield f"]{text}"


def to_json_data(value: Any, convert_array: Callable[[np.ndarray], Any] | None = None) -> Any:
    """``value`` as JSON data: arrays become lists, dataclasses dictionaries, NaN and infinities None.

    ``convert_array``: what becomes of arrays instead.
    """
    kind = type(value)
    if kind in (str, bool, int, NoneType):  # most values: asking for abstract classes is slow
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
    return to_json_data({f.name: getattr(value, f.name) for f in fields(value)}, convert_array)
