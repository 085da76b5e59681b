"""The JSON files that greybox writes, as one JSON Schema (draft 2020-12), and how they are read."""

from greybox.schemas.json_file import ResultKind, find_offence, parse_json, read_json, read_schema

__all__ = ["ResultKind", "find_offence", "parse_json", "read_json", "read_schema"]
