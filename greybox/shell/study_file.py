"""Study files: a study as TOML, for reading, changing and repeating it.

Reading a study file runs nothing: it is checked field by field against `greybox.shell.study`. A model file that it names is a
program: it runs only where the user names it too (`greybox.shell.options.confirm_model`).
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from greybox.base.errors import GreyboxError, nearest
from greybox.base.files import write_file
from greybox.shell.study import CHECK, SPECS, STUDY_COMMANDS, Spec, Study, fields_of
from greybox.shell.study_values import Files, Table

SUFFIX = ".toml"
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def is_model_path(model: str) -> bool:
    """Whether a model is given as a file and not by its name."""
    from greybox.shell.project import is_model_path as is_path

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


# A study as a Python program: the same computation with the verbs of the library, for reading, changing and repeating it.

FOLDER = "HERE"
"""What the program calls its own folder."""


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
        for name in (
            "at_rest",
            "method",
            "substeps",
            "loss",
            "per_experiment",
            "common_noise",
            "transcription",
            "arc_length",
        )
        if (value := getattr(chosen, name)) != getattr(usual, name)
    }
    texts = _data(study)
    if options:
        texts["options"] = f"gb.FitOptions({_keywords(options).removeprefix(', ')})"
    given = "".join(f", {name}={text}" for name, text in texts.items())
    return [f"result = gb.fit(model, records{given})", "print(result)", f'result.save({FOLDER} / "fit.json")']


def _discover_lines(study: Study) -> list[str]:
    given = "".join(f", {name}={text}" for name, text in _data(study).items())
    rest = ", options=gb.FitOptions(at_rest=True)" if study.at_rest else ""
    journal = f', journal={FOLDER} / "journal.jsonl"'
    return [
        f"discovery = gb.discover(plain, records{given}{rest}{journal})",
        "print(discovery)",
        f'discovery.save({FOLDER} / "discovery.json")',
    ]
