"""Imports point one way."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.sources import ROOT, nodes

pytestmark = pytest.mark.usefixtures("read_sources")

# The layers: the folders of greybox/, from the ground up. A layer imports from those before it. Inside a layer modules may import one
# another as long as there is no circle.
LAYERS = (
    *("base", "model", "data", "simulation", "estimation", "comparison", "discovery", "show", "shell", "extensions"),
    *("__init__", "__main__"),  # the front doors: they may import everything, and nothing imports them
)
LEVEL = {layer: level for level, layer in enumerate(LAYERS)}
# Conditions of what is imported for types alone.
TYPES_ONLY = ("TYPE_CHECKING", "typing.TYPE_CHECKING")


class Import(NamedTuple):
    """``module`` is imported in line ``line`` of ``file``, which is the module ``importer``; at its top or inside a function."""

    file: Path
    line: int
    importer: str
    module: str

    @property
    def where(self) -> str:
        return f"{self.file.relative_to(ROOT)}:{self.line}"


def sources(*folders: str, kinds: tuple[str, ...] = (".py",)) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in kinds)


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def running_code(path: Path) -> Iterator[ast.AST]:
    """Every node of a file that runs; what stands under ``if TYPE_CHECKING`` does not run."""
    conditions = (node for node in nodes(path) if isinstance(node, ast.If) and ast.unparse(node.test) in TYPES_ONLY)
    idle = {inner for condition in conditions for part in condition.body for inner in ast.walk(part)}
    return (node for node in nodes(path) if node not in idle)


@cache
def offered(package: str) -> dict[str, str]:
    """The names of a package that imports them at their first use -> the modules that they come from."""
    path = ROOT.joinpath(*package.split("."), "__init__.py")
    if not path.is_file() or "lazy_face(__name__)" not in path.read_text(encoding="utf-8"):
        return {}
    return {
        alias.name: str(node.module) for node in nodes(path) if isinstance(node, ast.ImportFrom) for alias in node.names
    }


def find_imports(path: Path) -> Iterator[Import]:
    importer = module_name(path)
    package = importer if path.name == "__init__.py" else importer.rpartition(".")[0]
    for node in running_code(path):
        if isinstance(node, ast.Import):
            yield from (Import(path, node.lineno, importer, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # `from .. import x` names its module by its distance from here
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            for alias in node.names:
                inside = f"{base}.{alias.name}"
                home = offered(base).get(alias.name, base)  # the module that the face of a package takes the name from
                yield Import(path, node.lineno, importer, inside if is_module(inside) else home)


def layer(module: str) -> str:
    """``greybox.model.effects.friction`` -> ``model``; the package itself is ``__init__``."""
    return module.split(".")[1] if "." in module else "__init__"


def top(module: str) -> str:
    return module.partition(".")[0]


@cache
def all_imports(*folders: str) -> list[Import]:
    if len(folders) > 1:
        return [found for folder in folders for found in all_imports(folder)]
    return [found for path in sources(*folders) for found in find_imports(path)]


def circle(edges: set[tuple[str, str]]) -> list[str]:
    """The names of one circle among ``importer -> imported``, or an empty list."""
    graph: dict[str, set[str]] = {}
    for importer, imported in edges:
        graph.setdefault(importer, set()).add(imported)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def docstrings(path: Path) -> list[ast.AST]:
    return [node.value for node in nodes(path) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]


def test_there_is_a_library_to_look_at() -> None:
    assert len(sources("greybox")) > 10
    assert len(all_imports("greybox")) > 10


def test_every_folder_is_a_layer() -> None:
    unknown = sorted({layer(module_name(path)) for path in sources("greybox")} - set(LEVEL))
    assert not unknown, (
        f"greybox/ has folders that are no layer: {', '.join(unknown)}. Each file belongs to one of {', '.join(LAYERS)}"
    )


def test_imports_point_one_way() -> None:
    upward = [
        f"{found.where}: {layer(found.importer)} imports {found.module}, which belongs to a later layer"
        for found in all_imports("greybox")
        if top(found.module) == "greybox" and LEVEL.get(layer(found.module), 0) > LEVEL.get(layer(found.importer), 0)
    ]
    assert not upward, "\n".join(["move the shared part to an earlier layer:", *upward])


def test_the_front_doors_are_not_imported() -> None:
    inside = [
        f"{found.where}: write the full name, from greybox.<layer> import ..."
        for found in all_imports("greybox")
        if found.module in ("greybox", "greybox.__main__") and layer(found.importer) != "__main__"
    ]
    assert not inside, "\n".join(inside)


def test_the_core_names_no_extension() -> None:
    """Not in an import, and not in a string: what extensions add is found through entry points."""
    named = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources("greybox")
        if layer(module_name(path)) not in ("extensions", "__init__")
        for node in nodes(path)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and "greybox.extensions." in node.value
        if node not in docstrings(path)
    ]
    assert not named, f"the core names an extension: {', '.join(named)}"


def test_no_module_imports_itself_through_others() -> None:
    """Imports inside functions count as well: they hide circles, and do not remove them."""
    local = ("greybox", "models", "fits")
    found = circle({(f.importer, f.module) for f in all_imports(*local) if top(f.module) in local})
    assert not found, f"modules import one another in a circle: {' -> '.join(found)}"


ALLOWED = {
    "greybox": {"greybox"},
    "models": {"greybox", "models", "casadi"},
    "fits": {"greybox", "models", "fits"},
}


def declared(*extras: str) -> set[str]:
    """Distributions that pyproject.toml names, as they are imported."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = project["dependencies"] + [line for extra in extras for line in project["optional-dependencies"][extra]]
    return {re.match(r"[\w-]+", line).group().replace("-", "_") for line in lines}


@pytest.mark.parametrize("folder", ALLOWED)
def test_each_folder_imports_what_it_may(folder: str) -> None:
    third_party = (
        set()
        if folder == "models"
        else declared(
            "parquet", "hdf5", "mdf", "tdms", "ros", "excel", "frames", "fmu", "app", "study", "robots", "bench"
        )
    )
    allowed = ALLOWED[folder] | third_party | set(sys.stdlib_module_names)
    foreign = [f"{found.where}: {found.module}" for found in all_imports(folder) if top(found.module) not in allowed]
    assert not foreign, "\n".join([f"{folder}/ may not import (or pyproject.toml does not declare):", *foreign])


@pytest.mark.parametrize(("package", "owners"), [("matplotlib", ("show",)), ("click", ("shell", "extensions"))])
def test_one_layer_owns_a_package(package: str, owners: tuple[str, ...]) -> None:
    elsewhere = [
        f.where for f in all_imports("greybox") if top(f.module) == package and layer(f.importer) not in owners
    ]
    assert not elsewhere, f"only {' and '.join(owners)} import {package}: {', '.join(elsewhere)}"


def test_one_package_names_the_solver() -> None:
    elsewhere = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources("greybox")
        for node in nodes(path)
        if "nlpsol" in (getattr(node, "id", ""), getattr(node, "attr", ""))
        and not module_name(path).startswith("greybox.estimation.optim")
    ]
    assert not elsewhere, f"only greybox/estimation/optim calls nlpsol: {', '.join(elsewhere)}"
