"""The schema of the result files, read strictly: every key that is written is described."""

from __future__ import annotations

from functools import cache
from typing import Any

from jsonschema import Draft202012Validator

from greybox.base.json_shape import make_definitions


def find_schema(kind: Any) -> dict[str, Any]:
    """The schema of a kind of file, whole in itself."""
    (schema,), definitions = make_definitions(kind)
    return {**schema, "$defs": definitions}


def strict(schema: Any) -> Any:
    """``schema`` without further keys wherever it names some."""
    if isinstance(schema, list):
        return [strict(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    inner = {key: strict(value) for key, value in schema.items()}
    if "properties" in inner and "type" in inner:
        inner.setdefault("additionalProperties", False)
    return inner


@cache
def strict_validator(kind: Any) -> Draft202012Validator:
    schema = find_schema(kind)
    return Draft202012Validator({**schema, "$defs": strict(schema["$defs"])})


def strict_offences(data: Any, kind: Any) -> list[str]:
    """Everything in ``data`` that the schema does not describe or allow."""
    return [f"{error.json_path}: {error.message[:200]}" for error in strict_validator(kind).iter_errors(data)]
