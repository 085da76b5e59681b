"""A study as a Python program: the same computation with the verbs of the library, for reading, changing and repeating it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from greybox.shell.study import Study

# What the program calls its own folder.
FOLDER = "HERE"


def study_script(study: Study, path: Path, *, searched: Study | None = None) -> str:
    """The text of a program ``path`` that fits as ``greybox fit`` does with ``study``.

    ``searched`` is the study of the plain model, where the program is to look for the effect that it lacks as well.
    """
    folder = path.absolute().parent
    body = [*_model_lines(study, folder), "", *_record_lines(study, folder), ""]
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
    imports += ["from greybox.shell.inputs import hold_against"] * ("hold_against(" in text)
    head = [f'"""Repeats a study. Run with: python {path.name}. Numbers are in the units of the model."""', ""]
    return "\n".join([*head, *imports, "", f"{FOLDER} = Path(__file__).resolve().parent", "", text, ""])


def _is_shipped(name: str) -> bool:
    """Whether an effect is one of the catalogue, and none of the project."""
    from greybox.model.effects.catalogue import AT, all_effects

    return name.partition(AT)[0] in {e.name for e in all_effects()}


def _model_lines(study: Study, folder: Path, variable: str = "model") -> list[str]:
    from greybox.shell.project import is_model_path
    from greybox.shell.study_values import split_model_path

    model = study.model
    if is_model_path(model):
        file, name = split_model_path(model)
        place = _place(file, folder)
        lines = [
            f'{variable} = find_model(f"{{{place}}}:{name}")' if name else f"{variable} = find_model(str({place}))"
        ]
    else:
        lines = [f"{variable} = find_model({model!r})"]
    equations, declared = study.definition
    if equations:
        given = sorted({*study.fixed, *study.start, *study.free})
        lines += [
            "# The model as it was; one that was edited since is refused, unless these lines are taken out.",
            "stated = [",
            *(f"    {line!r}," for line in equations.splitlines()),
            "]",
            f"declared = {dict(declared)!r}",
            f'hold_against({variable}, ("\\n".join(stated), declared), {given!r}, __file__, "take out hold_against")',
        ]
    for name, (by, at) in study.schedules.items():
        about = "" if at is None else f", about={at!r}"
        lines.append(f"{variable} = {variable}.schedule({name!r}, by={by!r}{about})")
    for name in study.effects:
        lines.append(f"{variable} = {variable} + {'gb.effect' if _is_shipped(name) else 'find_effect'}({name!r})")
    parts = {key: listed for key in ("has", "lacks") if (listed := list(getattr(study, key)))}
    steps = [
        _call("with_parts", parts),
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
        "before": dict(study.before) or None,
    }
    how = {
        "hold": study.hold if study.hold != "auto" else None,
        "conditions": from_files or None,
        "allow_constant_input": study.free_decay or None,
        "split": study.split_holes or None,
        "window": (study.first_time or None, study.last_time or None) if study.first_time or study.last_time else None,
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
