"""Study files: a study as TOML, for reading, changing and repeating it.

Reading a study file runs nothing: it is checked field by field against `greybox.cli.study`. A model file that it names is a
program: it runs only where the user names it too (`greybox.cli.options.confirm_model`).
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from greybox.cli.policy import COMMANDS
from greybox.cli.study import CHECK, SPECS, STUDY_COMMANDS, Spec, Study, fields_of
from greybox.cli.study_values import Files, Table
from greybox.errors import GreyboxError, nearest
from greybox.files import write_file

SUFFIX = ".toml"
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def is_model_path(model: str) -> bool:
    """Whether a model is given as a file and not by its name."""
    from greybox.project import is_model_path as is_path

    return is_path(model)


def is_study_file(name: str) -> bool:
    """Whether the argument MODEL names a study file."""
    return name.lower().endswith(SUFFIX)


def read_study(path: Path, command: str) -> Study:
    """The study in ``path``, for ``command``.

    Keys at the top and in the tables of the file count for every command; tables called like a command (``[fit]``,
    ``[fit.estimation]``) for that command only. Paths are relative to the folder of the file.

    Raises
    ------
    GreyboxError
        If the file cannot be read, is no TOML, holds an unknown key, or a value of the wrong kind. The message names the file
        and the key.
    """
    document = _read_toml(path)
    scopes = {name: document.pop(name) for name in STUDY_COMMANDS if name in document}
    values: dict[str, Any] = {}
    unused: list[str] = []
    for scope, tables in (("", document), *scopes.items()):
        if not isinstance(tables, dict):
            raise GreyboxError(f"{path}: {scope}: must be a table, as in [{scope}]")
        for name, place, data in _entries(path, scope, tables):
            spec = SPECS[name]
            if command == CHECK and command not in spec.commands and not scope:
                unused.append(place)  # a check comes before a fit: what only the fit needs does no harm
                continue
            if command not in spec.commands and (not scope or scope == command):
                raise _unused(path, place, spec, command)
            if scope and scope not in spec.commands:
                raise _unused(path, place, spec, scope)
            value = spec.kind.from_toml(f"{path}, {place}", data)
            if scope in ("", command):
                if name in values and not isinstance(spec.kind, Table):
                    raise GreyboxError(f"{path}, {place}: given twice, for all commands and for {scope}; keep one")
                values[name] = spec.kind.merge(values[name], value) if name in values else value
    values = {name: _from_folder(path.parent, SPECS[name], value) for name, value in values.items()}
    return Study(**values, file=path, from_file=frozenset(values), unused=tuple(unused))


def write_study(study: Study, path: Path, command: str) -> Path:
    """Write ``study`` as a file from which ``command`` computes the same. Paths become relative to the folder of the file.

    Raises
    ------
    GreyboxError
        If there is such a file already, or the folder cannot be written to.
    """
    if path.exists():
        raise GreyboxError(f"--write-study {path}: the file exists; give another name, or delete it first")
    if not is_study_file(path.name):
        raise GreyboxError(
            f"--write-study {path}: a study file ends in {SUFFIX}; write --write-study {path.stem}{SUFFIX}"
        )
    return write_file(path, study_text(study, path, command))


def study_text(study: Study, path: Path, command: str) -> str:
    """The text of the study file: fields that differ from their defaults, in the order of `Study`."""
    top: list[str] = []
    tables: dict[str, list[str]] = {}
    for name, spec in fields_of(command).items():
        value = getattr(study, name)
        if value == spec.kind.empty:
            continue
        value = _to_folder(study, path, spec, value)
        data = spec.kind.to_toml(value)
        if not spec.key:
            tables[spec.table] = [f"{_key(k)} = {_toml(v)}" for k, v in data.items()]
            continue
        table = spec.table or (command if spec.commands == (command,) else "")
        (tables.setdefault(table, []) if table else top).append(f"{spec.key} = {_toml(data)}")
    head = [
        f"# Run with: greybox {command} {path.name}",
        "# Paths are relative to this file; numbers are in the units of the model.",
    ]
    parts = [[*head], top, *([f"[{table}]", *lines] for table, lines in tables.items())]
    return "\n\n".join("\n".join(part) for part in parts if part) + "\n"


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        size = path.stat().st_size
        if size > COMMANDS.maximum_study_bytes:
            raise GreyboxError(
                f"{path}: {size} bytes, too long for a study file; at most {COMMANDS.maximum_study_bytes} bytes are read"
            )
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        beside = sorted(file.name for file in path.parent.glob(f"*{SUFFIX}")) if path.parent.is_dir() else []
        raise GreyboxError(f"{path}: file not found; {nearest(path.name, beside)}") from None
    except OSError as error:
        raise GreyboxError(f"{path}: cannot be read ({error.strerror}); give a study file") from None
    except UnicodeDecodeError:
        raise GreyboxError(f"{path}: not a text in UTF-8; a study file is TOML, see docs/study_files.md") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise GreyboxError(f"{path}: not TOML: {error}; correct that line") from None


def _entries(path: Path, scope: str, tables: Mapping[str, Any]) -> list[tuple[str, str, Any]]:
    """Each field of ``tables``: its name, its place and its value. Raises GreyboxError for an unknown key."""
    whole = {spec.table: name for name, spec in SPECS.items() if not spec.key}
    keyed = {(spec.table, spec.key): name for name, spec in SPECS.items() if spec.key}
    sections = {table for table, _ in keyed if table}
    entries: list[tuple[str, str, Any]] = []
    for key, data in tables.items():
        prefix = f"{scope}." if scope else ""
        if key in whole:
            entries.append((whole[key], f"[{prefix}{key}]", data))
        elif key in sections:
            if not isinstance(data, dict):
                raise GreyboxError(f"{path}, {key}: must be a table, as in [{prefix}{key}]")
            for inner, value in data.items():
                if (key, inner) not in keyed:
                    known = [k for table, k in keyed if table == key]
                    raise GreyboxError(f"{path}, [{prefix}{key}] {inner}: no such key; {nearest(inner, known)}")
                entries.append((keyed[key, inner], f"[{prefix}{key}] {inner}", value))
        elif ("", key) in keyed:
            entries.append((keyed["", key], f"[{scope}] {key}" if scope else key, data))
        else:
            known = [
                *(k for table, k in keyed if not table),
                *sorted({*whole, *sections}),
                *([] if scope else STUDY_COMMANDS),
            ]
            where = f"{path}, [{scope}]" if scope else f"{path}"
            raise GreyboxError(
                f"{where}: {key}: no such {'table' if isinstance(data, dict) else 'key'}; {nearest(key, known)}"
            )
    return entries


def _unused(path: Path, place: str, spec: Spec, command: str) -> GreyboxError:
    users = [name for name in STUDY_COMMANDS if name in spec.commands]
    home = f"[{users[0]}{f'.{spec.table}' if spec.table else ''}]"
    return GreyboxError(
        f"{path}, {place}: greybox {command} does not use it, {' and '.join(users)} {'do' if len(users) > 1 else 'does'};"
        f" leave it out, or move it to the table {home}, which only greybox {users[0]} reads"
    )


def _from_folder(folder: Path, spec: Spec, value: Any) -> Any:
    """Paths of the file as seen from the working folder."""
    if isinstance(spec.kind, Files):
        return tuple(folder / path for path in value)
    if spec is SPECS["model"] and is_model_path(value):
        return str(folder / value)
    return value


def _to_folder(study: Study, path: Path, spec: Spec, value: Any) -> Any:
    """Paths as seen from the folder of the file that is written; absolute ones stay."""
    if isinstance(spec.kind, Files):
        return tuple(_relative(file, path.parent) for file in value)
    if spec is SPECS["model"] and is_model_path(value):
        file, colon, name = value.rpartition(".py:")
        return (
            f"{_relative(Path(f'{file}.py'), path.parent).as_posix()}:{name}"
            if colon
            else (_relative(Path(value), path.parent).as_posix())
        )
    return value


def _relative(file: Path, folder: Path) -> PurePosixPath:
    if file.is_absolute():
        return PurePosixPath(file.as_posix())
    return PurePosixPath(Path(os.path.relpath(file, folder)).as_posix())


def _key(name: str) -> str:
    return name if BARE_KEY.fullmatch(name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _toml(value: Any) -> str:
    """A value as TOML; numbers with all digits, so that reading gives the same bits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_toml(item)}" for name, item in value.items()) + " }"
    return "[" + ", ".join(map(_toml, value)) + "]"


def with_overrides(study: Study, given: Mapping[str, Any]) -> Study:
    """``study`` with fields that were ``given`` on the command line as well: tables name by name, all else in its place."""
    merged = {name: SPECS[name].kind.merge(getattr(study, name), value) for name, value in given.items()}
    return replace(study, **merged, from_file=study.from_file - set(given))
