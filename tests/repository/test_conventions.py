"""Conventions that keep the library findable: what is a setting, what names say, what public docstrings hold."""

from __future__ import annotations

import ast
import inspect
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import greybox
from tests.support.sources import ROOT, nodes, parsed

pytestmark = pytest.mark.usefixtures("read_sources")
LIBRARY = sorted((ROOT / "greybox").rglob("*.py"))

# Settings of the whole library; whoever adds one asks first who turns it.
MOST_SETTINGS = 150
# Names that say nothing of what they hold.
VAGUE = {"found", "said", "told", "there", "here", "own", "ways"}


def is_number(node: ast.AST) -> bool:
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    if isinstance(node, ast.Tuple | ast.List):
        return bool(node.elts) and all(map(is_number, node.elts))
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def assigned(statement: ast.stmt) -> Iterator[tuple[str, ast.AST]]:
    """Name and value of each assignment that a statement makes."""
    if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name) and statement.value:
        yield statement.target.id, statement.value
    for target in statement.targets if isinstance(statement, ast.Assign) else ():
        if isinstance(target, ast.Name):
            yield target.id, statement.value
        elif isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
            names = [e.id for e in target.elts if isinstance(e, ast.Name)]
            yield from zip(names, statement.value.elts, strict=False)


def policies() -> dict[str, list[str]]:
    """Class of settings -> its fields that are no group of settings themselves."""
    return {
        node.name: [
            field.target.id
            for field in node.body
            if isinstance(field, ast.AnnAssign)
            and not re.search(r"Policy|Budget", ast.unparse(field.annotation).replace("PolicyName", ""))
        ]
        for path in LIBRARY
        for node in parsed(path).body
        if isinstance(node, ast.ClassDef) and re.search(r"(Policy|Budget)$", node.name)
    }


def given_names(path: Path) -> set[str]:
    """Every name that some call gives by keyword, and every name that stands as a text in the library (limits that one factor raises)."""
    if path.suffix == ".md":
        return set(re.findall(r"(\w+)=", path.read_text(encoding="utf-8")))
    names: set[str] = set()
    of_library = path.is_relative_to(ROOT / "greybox")
    for node in nodes(path):
        if isinstance(node, ast.Call):
            names |= {k.arg for k in node.keywords if k.arg}
        elif of_library and isinstance(node, ast.Constant) and isinstance(node.value, str):
            names.add(node.value)
    return names


def idle_names(names: set[str]) -> set[str]:
    """Those that nothing gives: a file that does not hold a name that is left needs no look at its calls."""
    left = set(names)
    for folder, kind in (("docs", "*.md"), ("greybox", "*.py"), ("tests", "*.py"), ("fits", "*.py")):
        for path in sorted((ROOT / folder).rglob(kind)):
            text = path.read_text(encoding="utf-8")
            if any(name in text for name in left):
                left -= given_names(path)
    return left


def test_a_setting_is_turned_by_somebody() -> None:
    """A number that no caller, study or test turns is a constant above the function that it steers."""
    settings = policies()
    left = idle_names({name for names in settings.values() for name in names})
    idle = [f"{policy}.{name}" for policy, names in settings.items() for name in names if name in left]
    assert not idle, f"settings that nobody turns; make them constants: {', '.join(idle)}"
    assert sum(map(len, settings.values())) <= MOST_SETTINGS
    assert idle_names({"a_" + "setting_of_nobody"})  # what nothing gives is seen


def test_a_constant_says_what_it_is() -> None:
    """A comment stands above each number at module level, or above the group that it is in; or a docstring below."""
    bare = []
    for path in LIBRARY:
        lines, body = path.read_text(encoding="utf-8").split("\n"), parsed(path).body
        for k, statement in enumerate(body):
            for name, value in assigned(statement):
                if not (re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name) and is_number(value)):
                    continue
                above = statement.lineno - 2
                while above >= 0 and re.match(r"_?[A-Z][A-Z0-9_]*\b.* = ", lines[above]):
                    above -= 1
                told = lines[above].startswith("#") or "#" in lines[statement.lineno - 1]
                # A group of lines without a blank one between them has its words below the last.
                last = k
                while (
                    last + 1 < len(body)
                    and body[last + 1].lineno == body[last].end_lineno + 1
                    and isinstance(body[last], ast.Assign)
                ):
                    last += 1
                below = isinstance(body[last], ast.Expr)
                if not (told or below):
                    bare.append(f"{path.relative_to(ROOT)}:{statement.lineno} {name}")
    assert not bare, "\n".join(["numbers without a word:", *bare])


def test_no_two_classes_share_a_name() -> None:
    """Nor is there a second kind of `Fit`: whatever a plant is, fitting it ends with that one."""
    classes = Counter(node.name for path in LIBRARY for node in nodes(path) if isinstance(node, ast.ClassDef))
    assert not [name for name, count in classes.items() if count > 1]
    assert [name for name in classes if name.endswith("Fit")] == ["Fit"]


def test_variables_say_what_they_hold() -> None:
    vague = [
        f"{path.relative_to(ROOT)}:{node.lineno} {name}"
        for path in LIBRARY
        for node in nodes(path)
        if (name := node.arg if isinstance(node, ast.arg) else getattr(node, "id", "")) in VAGUE
        and not (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load))
    ]
    assert not vague, "\n".join(["names that say nothing of what they hold:", *vague])


@cache
def called_by_users() -> dict[str, object]:
    """The functions at the top of the package and in its namespaces."""
    spaces = (
        "blackbox",
        "discovery",
        "effects",
        "estimation",
        "export",
        "frequency",
        "identifiability",
        "signals",
        "uncertainty",
    )
    names = {name: getattr(greybox, name) for name in greybox.__all__}
    for space in spaces:
        module = getattr(greybox, space)
        public = getattr(module, "__all__", None) or [n for n in vars(module) if not n.startswith("_")]
        names |= {f"{space}.{name}": getattr(module, name) for name in public}
    return {name: value for name, value in names.items() if inspect.isfunction(value)}


@pytest.mark.parametrize("name", sorted(called_by_users()))
def test_a_function_that_users_call_documents_its_parameters(name: str) -> None:
    function = called_by_users()[name]
    text = inspect.getdoc(function) or ""
    if inspect.signature(function).parameters:
        assert re.search(r"^Parameters\n-{10}$", text, re.MULTILINE), f"{name} has no section Parameters"
    assert re.search(r"^(Returns|Yields)\n-+$", text, re.MULTILINE), f"{name} has no section Returns"


WRITERS = {"write_text", "write_bytes", "copyfile", "copy2", "copytree", "to_csv", "to_parquet", "truncate"}
"""Calls that write a file by its name."""
DRAWERS = {"savefig", "savez", "savez_compressed", "savemat"}
"""Calls that write a file by its name, or into an open one."""


def writes_by_name(call: ast.Call) -> bool:
    """Whether a call opens a file for writing and is not given one that `write_file` has opened."""
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    into_open_file = bool(call.args) and getattr(call.args[0], "id", "") == "file"
    if name in ("open", "ZipFile"):
        texts = [a for a in (*call.args, *(k.value for k in call.keywords)) if isinstance(a, ast.Constant)]
        modes = [str(text.value) for text in texts if re.fullmatch(r"[rwaxbt+]{1,3}", str(text.value))]
        return any(set("wax+") & set(mode) for mode in modes) and not into_open_file
    return name in WRITERS or (name in DRAWERS and not into_open_file)


def test_one_module_writes_files() -> None:
    """A result is whole or it is the old one because `greybox.base.files` writes it."""
    elsewhere = [
        f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)[:60]}"
        for path in LIBRARY
        if path != ROOT / "greybox" / "base" / "files.py"
        for node in nodes(path)
        if isinstance(node, ast.Call) and writes_by_name(node)
    ]
    assert not elsewhere, "\n".join(["write with greybox.base.files.write_file or append_line:", *elsewhere])
