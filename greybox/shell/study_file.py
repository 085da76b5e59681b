"""Study files: a study as TOML, for reading, changing and repeating it.

Reading a study file runs nothing: it is checked field by field against `greybox.shell.study`. A model file that it names is a
program: it runs only where the user names it too (`greybox.shell.command_line.confirm_model`).
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from greybox.base import GreyboxError, nearest, write_file
from greybox.base.texts import escape_line, to_word
from greybox.shell.study import Command, NextCommand, Option, Study
from greybox.shell.study_values import Table

SUFFIX = ".toml"
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def is_study_file(name: str) -> bool:
    """Whether the argument MODEL names a study file."""
    return name.lower().endswith(SUFFIX)


def study_commands(commands: Mapping[str, Command]) -> dict[str, Command]:
    """The commands with tables of their own in a study file."""
    return {name: command for name, command in commands.items() if command.reads_studies and not command.like}


def users_of(option: Option[Any], commands: Mapping[str, Command]) -> list[str]:
    """The commands that use what stands in the place of ``option``."""
    return [
        name
        for name, command in study_commands(commands).items()
        if any(other.place == option.place for other in command.table.values())
    ]


def read_study(path: Path, name: str, commands: Mapping[str, Command]) -> Study:
    """The study in ``path``, for the command called ``name``.

    Keys at the top and in the tables of the file count for every command; tables called like a command (``[fit]``,
    ``[fit.estimation]``) for that command only. Paths are relative to the folder of the file.

    Raises
    ------
    GreyboxError
        If the file cannot be read, is no TOML, holds an unknown key, or a value of the wrong kind. The message names the file
        and the key.
    """
    document = _read_toml(path)
    definition = _read_definition(path, document.pop(DEFINITION, {}))
    readers = study_commands(commands)
    scopes = {scope: document.pop(scope) for scope in readers if scope in document}
    values: dict[str, Any] = {}
    unused: list[str] = []
    for scope, tables in (("", document), *scopes.items()):
        if not isinstance(tables, dict):
            raise GreyboxError(f"{path}: {scope}: must be a table, as in [{scope}]")
        reader = scope or name
        used = {option.place: option for option in readers[reader].table.values() if option.place}
        for option, place, data in _entries(path, scope, tables, used, readers):
            if option.place not in used:
                if not readers[reader].lenient or scope:
                    raise _unused(path, place, option, reader, readers)
                unused.append(place)
                continue
            value = option.kind.from_toml(f"{path}, {place}", data)
            if reader == name:
                if option.name in values and not isinstance(option.kind, Table):
                    raise GreyboxError(f"{path}, {place}: given twice, for all commands and for {scope}; keep one")
                values[option.name] = option.kind.merge(values.get(option.name, option.kind.empty), value)
    command = readers[name]
    values = {n: command.table[n].kind.moved(value, lambda file: path.parent / file) for n, value in values.items()}
    origin: dict[str, Any] = {
        "command": name,
        "options": command.table,
        "file": path,
        "from_file": values,
        "unused": unused,
        "definition": definition,
    }
    return command.study(**origin, **values)


def spell_following(following: NextCommand, commands: Mapping[str, Command]) -> str:
    """What follows a command, as it is typed: after one on a study file with that file, and with what was typed beside it."""
    study, command = following.study, commands[following.command]
    # What the proposal does without would come back with the file.
    is_kept = all(study.sets(option) for name, option in study.options.items() if name in study.from_file)
    is_of_file = {"model", "estimation"} <= study.from_file and command.reads_studies and is_kept
    if study.file is None or not is_of_file or tuple(following.arguments) != (study.model, *study.estimation):
        return following.spell(commands)
    try:
        read = read_study(study.file, command.like or following.command, commands)
        command.check(read)
    except GreyboxError:
        # It refuses the file, for what another command alone reads there.
        return following.spell(commands)
    return following.spell(commands, read)


def write_study(study: Study, path: Path, name: str, commands: Mapping[str, Command]) -> Path:
    """Write ``study`` as a file from which the command ``name`` computes the same. Paths become relative to the folder of the file.

    Raises
    ------
    GreyboxError
        If there is such a file already, or the folder cannot be written to.
    """
    if path.exists():
        raise GreyboxError(f"--write-study {path}: the file exists; give another name, or delete it first")
    if not is_study_file(path.name):
        raise GreyboxError(
            f"--write-study {path}: a study file ends in {SUFFIX}; write --write-study {to_word(path.stem + SUFFIX)}"
        )
    return write_file(path, study_text(study, path, name, commands))


def study_text(study: Study, path: Path, name: str, commands: Mapping[str, Command]) -> str:
    """The text of the study file: options that differ from their defaults, in the order of the table."""
    top: list[str] = []
    tables: dict[str, list[str]] = {}
    for option in commands[name].in_study().values():
        value = getattr(study, option.name)
        if value == option.kind.empty:
            continue
        # Paths as seen from the folder of the file that is written; absolute ones stay.
        moved = option.kind.moved(value, lambda p: p if p.is_absolute() else Path(os.path.relpath(p, path.parent)))
        data = option.kind.to_toml(moved)
        if not option.key:
            tables[option.table] = [f"{_key(k)} = {_toml(v)}" for k, v in data.items()]
            continue
        # A key at the top would be refused by the commands that do not know it.
        table = option.table or (name if users_of(option, commands) == [name] else "")
        (tables.setdefault(table, []) if table else top).append(f"{option.key} = {_toml(data)}")
    head = [
        f"# Run with: greybox {name} {to_word(path.name)}",
        "# Paths are relative to this file; numbers are in the units of the model.",
    ]
    parts = [[*head], top, *([f"[{table}]", *lines] for table, lines in tables.items())]
    equations, declared = study.definition
    if equations:
        parts.append([f"# The model {study.model} as it was: one that was edited since is refused.", f"[{DEFINITION}]"])
        parts[-1] += ["equations = [", *(f"  {_quoted(line)}," for line in equations.splitlines()), "]"]
        parts[-1] += [f"{_quoted(name)} = {_quoted(line)}" for name, line in declared.items()]
    return "\n\n".join("\n".join(part) for part in parts if part) + "\n"


# The table of a study file that keeps what its model states.
DEFINITION = "definition"


def _read_definition(path: Path, table: Any) -> tuple[str, dict[str, str]]:
    """The equations and the other lines of that table. Raises GreyboxError where it is none."""
    lines = dict(table) if isinstance(table, dict) else {"": table}
    equations = lines.pop("equations", [])
    if not (isinstance(equations, list) and all(isinstance(text, str) for text in (*equations, *lines.values()))):
        raise GreyboxError(
            f"{path}, [{DEFINITION}]: must hold lines of text, as --write-study has written them; leave the table out"
        )
    return "\n".join(equations), lines


# Size of a study file: a thousand times what a long one has.
MAXIMUM_STUDY_BYTES = 1000000


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        size = path.stat().st_size
        if size > MAXIMUM_STUDY_BYTES:
            raise GreyboxError(
                f"{path}: {size} bytes, too long for a study file; at most {MAXIMUM_STUDY_BYTES} bytes are read"
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


def _entries(
    path: Path, scope: str, tables: Mapping[str, Any], used: Mapping[str, Option[Any]], readers: Mapping[str, Command]
) -> list[tuple[Option[Any], str, Any]]:
    """What stands in ``tables``: option, place and value; ``used`` options go before those of others.

    Raises GreyboxError for an unknown key.
    """
    others = {option.place: option for reader in readers.values() for option in reader.in_study().values()}
    known = {**others, **used}
    sections = {option.table for option in known.values() if option.key and option.table}
    entries: list[tuple[Option[Any], str, Any]] = []
    for key, data in tables.items():
        prefix = f"{scope}." if scope else ""
        if f"{key}." in known:
            entries.append((known[f"{key}."], f"[{prefix}{key}]", data))
        elif key in sections:
            if not isinstance(data, dict):
                raise GreyboxError(f"{path}, {key}: must be a table, as in [{prefix}{key}]")
            for inner, value in data.items():
                if f"{key}.{inner}" not in known:
                    near = nearest(inner, [option.key for option in known.values() if option.table == key])
                    raise GreyboxError(f"{path}, [{prefix}{key}] {inner}: no such key; {near}")
                entries.append((known[f"{key}.{inner}"], f"[{prefix}{key}] {inner}", value))
        elif key in known:
            entries.append((known[key], f"[{scope}] {key}" if scope else key, data))
        else:
            top = [option.key for option in used.values() if not option.table]
            tops = [*top, *sorted({option.table for option in used.values()} - {""}), *([] if scope else readers)]
            where = f"{path}, [{scope}]" if scope else f"{path}"
            raise GreyboxError(
                f"{where}: {key}: no such {'table' if isinstance(data, dict) else 'key'}; {nearest(key, tops)}"
            )
    return entries


def _unused(path: Path, place: str, option: Option[Any], name: str, readers: Mapping[str, Command]) -> GreyboxError:
    users = users_of(option, readers)
    home = f"[{users[0]}{f'.{option.table}' if option.table else ''}]"
    agreed = f"{', '.join(users[:-1])} and {users[-1]} do" if len(users) > 1 else f"{users[0]} does"
    return GreyboxError(
        f"{path}, {place}: greybox {name} does not use it, {agreed};"
        f" leave it out, or move it to the table {home}, which only greybox {users[0]} reads"
    )


def _key(name: str) -> str:
    return name if BARE_KEY.fullmatch(name) else _quoted(name)


def _quoted(text: str) -> str:
    return f'"{escape_line(text)}"'


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
    """``study`` with options that were ``given`` on the command line as well: tables name by name, all else in its place."""
    merged = {n: study.options[n].kind.merge(getattr(study, n), value) for n, value in given.items()}
    return study.but(**merged, from_file=study.from_file - set(given))
