"""Study files: a study as TOML, for reading, changing and repeating it.

Reading a study file runs nothing: it is checked field by field against `greybox.shell.study`. A model file that it names is a
program: it runs only where the user names it too (`greybox.shell.command_line.confirm_model`).
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from greybox.base import GreyboxError, nearest, write_file
from greybox.shell.study import Command, Option, Study
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
    }
    return command.study(**origin, **values)


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
            f"--write-study {path}: a study file ends in {SUFFIX}; write --write-study {path.stem}{SUFFIX}"
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
        f"# Run with: greybox {name} {path.name}",
        "# Paths are relative to this file; numbers are in the units of the model.",
    ]
    parts = [[*head], top, *([f"[{table}]", *lines] for table, lines in tables.items())]
    return "\n\n".join("\n".join(part) for part in parts if part) + "\n"


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
    """``study`` with options that were ``given`` on the command line as well: tables name by name, all else in its place."""
    merged = {n: study.options[n].kind.merge(getattr(study, n), value) for n, value in given.items()}
    return study.but(**merged, from_file=study.from_file - set(given))


# A study as a Python program: the same computation with the verbs of the library, for reading, changing and repeating it.

# What the program calls its own folder.
FOLDER = "HERE"


def study_script(study: Study, path: Path, *, searched: Study | None = None) -> str:
    """The text of a program ``path`` that fits as ``greybox fit`` does with ``study``.

    ``searched`` is the study of the plain model, where the program is to look for the effect that it lacks as well.
    """
    folder = path.absolute().parent
    body = [*_model_lines(study, folder), "", *_record_lines(study, folder), ""]
    if any(effect_has_delay(name) for name in study.effects):
        body += ["longest = max(float(np.median(record.intervals)) for record in records)"]
        body += ["model = gb.effects.bound_delays(model, longest)", ""]
    body += _fit_lines(study)
    if searched is not None:
        body += ["", *_model_lines(searched, folder, "plain"), "", *_discover_lines(searched)]
    text = "\n".join(body)
    imports = ["from dataclasses import replace"] * ("replace(" in text) + ["from pathlib import Path", ""]
    imports += ["import numpy as np", ""] * ("np." in text) + [
        "import greybox as gb",
        "from greybox.shell.project import find_model",
    ]
    imports += ["from greybox.shell.own_effects import find_effect"] * ("find_effect(" in text)
    head = [f'"""Repeats a study. Run with: python {path.name}. Numbers are in the units of the model."""', ""]
    return "\n".join([*head, *imports, "", f"{FOLDER} = Path(__file__).resolve().parent", "", text, ""])


def effect_has_delay(name: str) -> bool:
    """Whether an effect of the catalogue delays an input, so that the records bound how long it may be."""
    from greybox.model.effects.catalogue import all_effects
    from greybox.model.effects.placement import AT

    return any(e.delay is not None for e in all_effects() if e.name == name.partition(AT)[0])


def _is_shipped(name: str) -> bool:
    """Whether an effect is one of the catalogue, and none of the project."""
    from greybox.model.effects.catalogue import all_effects
    from greybox.model.effects.placement import AT

    return name.partition(AT)[0] in {e.name for e in all_effects()}


def _model_lines(study: Study, folder: Path, variable: str = "model") -> list[str]:
    from greybox.shell.project import is_model_path

    model = study.model
    if is_model_path(model):
        file, colon, name = model.rpartition(".py:")
        place = _place(Path(f"{file}.py") if colon else Path(model), folder)
        lines = [
            f'{variable} = find_model(f"{{{place}}}:{name}")' if colon else f"{variable} = find_model(str({place}))"
        ]
    else:
        lines = [f"{variable} = find_model({model!r})"]
    for name, (by, at) in study.schedules.items():
        about = "" if at is None else f", about={at!r}"
        lines.append(f"{variable} = {variable}.schedule({name!r}, by={by!r}{about})")
    for name in study.effects:
        lines.append(f"{variable} = {variable} + {'gb.effect' if _is_shipped(name) else 'find_effect'}({name!r})")
    steps = [
        _call("with_process_noise", study.process_noise),
        _call("free", dict.fromkeys(study.free)),
        _call("start", study.start),
        _call("fix", study.fixed),
        _call("prior", study.priors),
    ]
    lines += [f"{variable} = {variable}.{step}" for step in steps if step]
    if study.ties:
        lines.append(f"{variable} = {variable}.with_ties({dict(study.ties)!r})")
    return lines


def _call(verb: str, values: Mapping[str, Any]) -> str:
    """``fix("Ra", M=0.01)``: names without a value first; empty where there is none."""
    names = [repr(name) for name, value in values.items() if value is None]
    pairs = [f"{name}={value!r}" for name, value in values.items() if value is not None]
    return f"{verb}({', '.join([*names, *pairs])})" if values else ""


def _record_lines(study: Study, folder: Path) -> list[str]:
    given = {name: values for name, values in study.conditions.items() if values is not None}
    from_files = {name: None for name, values in study.conditions.items() if values is None}
    layout = {
        "columns": list(study.headers) or dict(study.columns) or None,
        "sampling_time": study.sampling_time or None,
        "interpolation": dict(study.interpolation) or None,
    }
    how = {
        "hold": study.hold if study.hold != "zero" else None,
        "conditions": from_files or None,
        "allow_constant_input": study.free_decay or None,
        "split": study.split_holes or None,
    }
    lines = [_read("records", study.estimation, folder, layout | how)]
    if study.validation:
        lines.append(_read("validation", study.validation, folder, layout | how))
    names = ["records", *(["validation"] if study.validation else [])]
    for name, values in given.items():
        counts = {"records": len(study.estimation), "validation": len(study.validation)}
        begin = 0
        for group in names:
            part = values[begin : begin + counts[group]]
            begin += counts[group]
            if part:
                lines.append(
                    f"{group} = [replace(r, conditions={{**r.conditions, {name!r}: v}}) for r, v in zip({group}, {list(part)!r})]"
                )
    if study.split_holes:
        lines += [f"{group} = [piece for r in {group} for piece in r.split_at_time_gaps()]" for group in names]
    if study.test:
        lines.append(_read("test", study.test, folder, layout | how))
    if study.quiet:
        lines.append(_read("quiet", study.quiet, folder, {**layout, "allow_constant_input": True}))
    return lines


def _read(name: str, files: Iterable[Path], folder: Path, options: Mapping[str, Any]) -> str:
    places = ", ".join(_place(file, folder) for file in files)
    return f"{name} = gb.read_experiments([{places}], model{_keywords(options)})"


def _place(file: Path, folder: Path) -> str:
    """A file as seen from the folder of the program."""
    if file.is_absolute() and folder not in file.parents:
        return f"Path({file.as_posix()!r})"
    relative = Path(os.path.relpath(file.absolute(), folder)).as_posix()
    return f"{FOLDER} / {relative!r}"


def _keywords(options: Mapping[str, Any]) -> str:
    return "".join(f", {name}={value!r}" for name, value in options.items() if value is not None)


def _data(study: Study) -> dict[str, str]:
    """What both verbs take, as text; names of variables and values alike."""
    texts = {"validation": "validation" if study.validation else "", "quiet": "quiet" if study.quiet else ""}
    texts["noise"] = repr(dict(study.noise)) if study.noise else ""
    texts["skip"] = repr(study.skip) if study.skip else ""
    texts["beginning"] = repr(study.beginning) if study.beginning else ""
    return {name: text for name, text in texts.items() if text}


def _fit_lines(study: Study) -> list[str]:
    from greybox.estimation.options import FitOptions
    from greybox.shell.inputs import fit_options

    chosen, usual = fit_options(study), FitOptions()
    options = {
        name: str(value) if isinstance(value, str) else value
        for name, value in vars(chosen).items()
        if value != getattr(usual, name)
    }
    texts = _data(study)
    if options:
        texts["options"] = f"gb.FitOptions({_keywords(options).removeprefix(', ')})"
    given = "".join(f", {name}={text}" for name, text in texts.items())
    return [f"result = gb.fit(model, records{given})", "print(result)", f'result.save({FOLDER} / "fit.json")']


def _discover_lines(study: Study) -> list[str]:
    given = "".join(f", {name}={text}" for name, text in _data(study).items())
    rest = f"{', test=test' if study.test else ''}{', options=gb.FitOptions(at_rest=True)' if study.at_rest else ''}"
    journal = f', journal={FOLDER} / "journal.jsonl"'
    return [
        f"discovery = gb.discover(plain, records{given}{rest}{journal})",
        "print(discovery)",
        f'discovery.save({FOLDER} / "discovery.json")',
    ]
