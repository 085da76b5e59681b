"""The JSON files that greybox writes, as one JSON Schema (draft 2020-12), and how they are read."""

from greybox.schemas.commands import PRINTED, schema_of_command
from greybox.schemas.json_file import ResultKind, find_offence, parse_json, read_json, read_schema

__all__ = ["PRINTED", "ResultKind", "find_offence", "parse_json", "read_json", "read_schema", "schema_of_command"]
