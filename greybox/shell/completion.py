"""What the shell offers when Tab is pressed: models, effects, parameters, outputs. A mistake in what was typed so far offers nothing.

Model files are read as text: Tab runs nothing that lies around.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from glob import escape, glob
from itertools import pairwise
from pathlib import Path

import click

from greybox.base import GreyboxError

Offer = tuple[str, str]  # what to type, and what it is


def models(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Names of models, and model files that begin so."""
    offers = [(item.name, item.description) for item in list_outlines()]
    files = sorted(Path(text) for text in glob(f"{escape(incomplete)}*")) if incomplete else []
    near = [(f"{path}/", "a folder") if path.is_dir() else (str(path), "a model file") for path in files]
    return _beginning([*offers, *(offer for offer in near if offer[0].endswith(("/", ".py")))], incomplete)


def commands(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Commands that print JSON."""
    from greybox.shell.printed import list_printed

    return _beginning(((name, "") for name in list_printed()), incomplete)


def effects(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Effects of the catalogue; after a comma or plus the next one."""
    from greybox.model.effects.catalogue import all_effects

    before = incomplete[: max(incomplete.rfind(","), incomplete.rfind("+")) + 1]
    return _beginning(((before + e.name, e.equation) for e in all_effects()), incomplete)


def parts(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Parts that a rig may have."""
    from greybox.model.parts import PARTS

    return _beginning(((part.name, part.meaning) for part in PARTS), incomplete)


def constants(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the parameters of the model that was named, with those of its effects."""
    return _offered(ctx, incomplete, _constants)


def constant_names(ctx: click.Context, incomplete: str) -> list[Offer]:
    """`constants` without ``=``."""
    return [(name.rstrip("="), what) for name, what in constants(ctx, incomplete)]


def outputs(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's outputs."""
    return _offered(ctx, incomplete, lambda m: _signals(m, "outputs"))


def states(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's states."""
    return _offered(ctx, incomplete, lambda m: _signals(m, "states"))


def signals(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of what a record holds: time, inputs and outputs."""
    return _offered(ctx, incomplete, lambda m: [("time=", "[s]"), *_signals(m, "inputs"), *_signals(m, "outputs")])


def _constants(model: ModelOutline) -> Iterator[Offer]:
    for q in model.parameters.values():
        yield f"{q.name}=", " ".join(filter(None, (q.value, f"{q.unit},", q.description)))


def _signals(model: ModelOutline, group: str) -> Iterator[Offer]:
    for s in getattr(model, group).values():
        yield f"{s.name}=", f"[{s.unit}] {s.description}"


def _offered(ctx: click.Context, incomplete: str, offers: Callable[[ModelOutline], Iterable[Offer]]) -> list[Offer]:
    # A line that ends in an option without its value is not taken apart: the words are left in args.
    name = ctx.params.get("model") or next(iter(ctx.args), None)
    model = find_outline(name) if name is not None else None
    if model is None:
        return []
    words = os.environ.get("COMP_WORDS", "").split()
    added = [value for option, value in pairwise(words) if option == "--effect"]
    if added:
        from greybox.model.effects.catalogue import effect

        try:
            for entry in map(effect, added):
                for q in entry.parameters:
                    model.parameters.setdefault(q.name, SignalOutline(q.name, q.unit, f"{q.value:g}", q.description))
                for s in entry.states:
                    model.states.setdefault(s.name, SignalOutline(s.name, s.unit, "", s.description))
        except GreyboxError:  # no effect of that name: nothing to offer
            return []
    return _beginning(offers(model), incomplete)


def _beginning(offers: Iterable[Offer], incomplete: str) -> list[Offer]:
    return [(text, what) for text, what in offers if text.startswith(incomplete)]


# What a model file says of itself, read as text: nothing in it is run. For the shell's Tab, which must not run what lies around.


SIGNALS = {"State": "states", "Input": "inputs", "Output": "outputs", "Parameter": "parameters"}
TEXT_POSITIONS = {"name": 0, "unit": 1}


@dataclass(frozen=True)
class SignalOutline:
    """A signal or parameter as its call states it; what is computed there is left empty."""

    name: str
    unit: str
    value: str
    description: str


@dataclass
class ModelOutline:
    """A model as its file states it, as far as that can be read without running the file.

    ``name`` finds the model; ``names`` are all that do. A signal that is made in a loop or taken from elsewhere is not seen.
    """

    name: str
    names: tuple[str, ...]
    description: str = ""
    states: dict[str, SignalOutline] = field(default_factory=dict)
    inputs: dict[str, SignalOutline] = field(default_factory=dict)
    outputs: dict[str, SignalOutline] = field(default_factory=dict)
    parameters: dict[str, SignalOutline] = field(default_factory=dict)


def list_outlines() -> list[ModelOutline]:
    """The models of the project around the working folder, then the shipped ones that it does not have."""
    from greybox.shell.project import model_files, project_root, template_root  # loads models, which no help needs

    outlines: dict[str, ModelOutline] = {}
    for root in dict.fromkeys(filter(None, (project_root(), template_root().resolve()))):
        for file in model_files(root):
            for outline in read_outlines(file):
                outlines.setdefault(outline.name, outline)
    return list(outlines.values())


def find_outline(name: str) -> ModelOutline | None:
    """The model that ``name`` finds: a name, or a file as `greybox.shell.project.find_model` takes it; None where there is none."""
    path, colon, wanted = name.rpartition(".py:")
    if colon or name.endswith(".py"):
        file = Path(f"{path}.py") if colon else Path(name)
        outlines = read_outlines(file)
        wanted = wanted if colon else file.stem
        return next((o for o in outlines if wanted in o.names), outlines[0] if len(outlines) == 1 else None)
    return next((outline for outline in list_outlines() if name in outline.names), None)


def read_outlines(file: Path) -> list[ModelOutline]:
    """The models in ``file``; none where it cannot be read as Python."""
    module = _read_module(file.resolve())
    outlines = []
    for variable, value in module.items():
        call = _find_model_call(file.resolve(), value)
        if variable.startswith("_") or call is None:
            continue
        stated = _text(call, "name", 0)
        names = tuple(dict.fromkeys(name for name in (variable, stated) if name))
        outline = ModelOutline(variable, names, _text(call, "description"))
        for node in _walk_definitions(file.resolve(), value):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in SIGNALS:
                signal = _read_signal(node)
                getattr(outline, SIGNALS[node.func.id]).setdefault(signal.name, signal)
        for group in SIGNALS.values():
            getattr(outline, group).pop("", None)
        outlines.append(outline)
    return outlines


@lru_cache(maxsize=64)
def _read_module(file: Path) -> dict[str, ast.AST]:
    """What stands at the top of a file, by the name that it gets: assignments, functions, classes, imports."""
    try:
        body = ast.parse(file.read_bytes()).body
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return {}
    module: dict[str, ast.AST] = {}
    for node in body:
        if isinstance(node, ast.Assign):
            module |= {target.id: node.value for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
            module[node.target.id] = node.value
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            module[node.name] = node
        elif isinstance(node, ast.ImportFrom):
            module |= {alias.asname or alias.name: node for alias in node.names}
    return module


def _find_model_call(file: Path, value: ast.AST) -> ast.Call | None:
    """The call of ``Model`` that an assigned value comes from: itself, changed, added to, or made by a function."""
    if not isinstance(value, ast.Call | ast.BinOp):
        return None
    for node in _walk_definitions(file, value):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Model":
            return node
    return None


def _walk_definitions(file: Path, value: ast.AST) -> Iterator[ast.AST]:
    """Every node of ``value`` and of what it names, in this file and in the files of its project that it imports from."""
    waiting, seen = [(file, value)], set()
    while waiting:
        place, node = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, ast.ImportFrom):
            # The file beside this one that the import takes names from.
            neighbour = place.with_name(f"{(node.module or '').rpartition('.')[2]}.py")
            if neighbour.is_file():
                waiting += [
                    (neighbour, _read_module(neighbour)[a.name])
                    for a in node.names
                    if a.name in _read_module(neighbour)
                ]
            continue
        for inner in ast.walk(node):
            yield inner
            if isinstance(inner, ast.Name) and inner.id in _read_module(place):
                waiting.append((place, _read_module(place)[inner.id]))


def _read_signal(call: ast.Call) -> SignalOutline:
    value = _argument(call, "value", 2)
    try:
        number = "" if value is None else f"{float(ast.literal_eval(value)):g}"
    except (
        ValueError,
        TypeError,
        SyntaxError,
        RecursionError,
        MemoryError,
    ):  # computed: only running the file would tell
        number = ""
    texts = {name: _text(call, name, position) for name, position in TEXT_POSITIONS.items()}
    return SignalOutline(**texts, value=number, description=_text(call, "description"))


def _text(call: ast.Call, keyword: str, position: int | None = None) -> str:
    value = _argument(call, keyword, position)
    return value.value if isinstance(value, ast.Constant) and isinstance(value.value, str) else ""


def _argument(call: ast.Call, keyword: str, position: int | None) -> ast.expr | None:
    if position is not None and position < len(call.args):
        return call.args[position]
    return next((k.value for k in call.keywords if k.arg == keyword), None)
