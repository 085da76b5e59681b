"""Results as JSON: readable, and without loss but for infinities and NaN, which become null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from types import NoneType
from typing import Any

import numpy as np


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


def to_json_data(value: Any) -> Any:
    """``value`` as JSON data: arrays become lists, dataclasses dictionaries, NaN and infinities None."""
    kind = type(value)
    if kind in (str, bool, int, NoneType):  # most values: asking for abstract classes is slow
        return value
    if kind is float:
        return value if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return to_json_data(value.tolist())
    if isinstance(value, Mapping):
        return {str(k): to_json_data(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json_data(v) for v in value]
    if isinstance(value, (bool, str)) or value is None:
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return to_json_data({f.name: getattr(value, f.name) for f in fields(value)})
