"""Importing a user's file: one module and one identity for each, and errors told with file and line."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import os
import sys
import traceback
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from greybox.errors import GreyboxError, ModelError
from greybox.model import Model
from greybox.project.folders import project_root

Value = TypeVar("Value")


def load_model_file(file: Path) -> ModuleType:
    """The module in ``file``: ``models.<name>`` if it belongs to a project's ``models/``, else under a private name.

    Raises ModelError where the file cannot be run, with the line.
    """
    root = project_root(file.parent, named=True)
    if root is not None and file.parent == root / "models":
        return import_from_project(root, file)
    return import_standalone(file)


def import_from_project(root: Path, file: Path) -> ModuleType:
    """``models.<name>`` of the project ``root``, put first on ``sys.path``: what its own imports get too."""
    _first_on_path(root)
    name = f"models.{file.stem}"
    try:
        return importlib.import_module(name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a user's file may raise whatever it likes
        raise _model_error(error, file) from error


def import_standalone(file: Path) -> ModuleType:
    """The module in ``file`` under a name of its own; it may import from its project, and from its folder."""
    name = f"_greybox_file_{hashlib.sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    root = project_root(file.parent, named=True)
    if root is not None:
        _first_on_path(root)
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # last: a neighbour called numpy.py must not stand in for numpy
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ModelError(f"{display_path(file)} is not a Python file; give a file that ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as error:  # a user's file may raise whatever it likes
        del sys.modules[name]
        if isinstance(error, KeyboardInterrupt):
            raise
        raise _model_error(error, file) from error
    return module


def models_in(module: ModuleType) -> dict[str, Model]:
    """The models that a module makes, by variable; private names and those it only imports are left out.

    Raises ModelError for one that has no content.
    """
    models = values_in(module, Model)
    for name, model in models.items():
        if not all(hasattr(model, each.name) for each in fields(Model)):
            place = display_path(Path(module.__file__ or module.__name__))
            raise ModelError(f"{place}: {name} is a model that was never stated; write {name} = Model(...)")
    return models


def values_in(module: ModuleType, kind: type[Value]) -> dict[str, Value]:
    """The values of a kind that a module makes, by variable; private names and those it only imports are left out."""
    elsewhere = _only_imported(Path(module.__file__)) if module.__file__ else set()
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, kind) and not name.startswith("_") and name not in elsewhere
    }


def _only_imported(file: Path) -> set[str]:
    """Names that a file imports and does not assign."""
    body = ast.parse(file.read_bytes()).body
    imported = {alias.asname or alias.name for node in body if isinstance(node, ast.ImportFrom) for alias in node.names}
    targets = [target for node in body if isinstance(node, ast.Assign) for target in node.targets]
    return imported - {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}


def display_path(file: Path) -> str:
    """A file as a person finds it: relative to the working folder if it lies below."""
    working = Path.cwd()
    return str(file.relative_to(working)) if file.is_relative_to(working) else str(file)


def _first_on_path(root: Path) -> None:
    """Put ``root`` first on the search path, and make ``models`` its package, not one imported from elsewhere."""
    text, folder = str(root), root / "models"
    if sys.path[:1] != [text]:
        sys.path[:] = [text, *(entry for entry in sys.path if entry != text)]
    importlib.invalidate_caches()
    known = sys.modules.get("models")
    if known is not None and folder.resolve() in [Path(p).resolve() for p in getattr(known, "__path__", [])]:
        return
    for name in [n for n in sys.modules if n == "models" or n.startswith("models.")]:
        del sys.modules[name]
    if not (folder / "__init__.py").is_file():
        # A folder without __init__.py would give way to any package called models further down the path.
        package = ModuleType("models")
        package.__path__ = [str(folder)]
        sys.modules["models"] = package


def _model_error(error: BaseException, file: Path) -> ModelError:
    """What went wrong in a user's file: the file and line to look at, then the message."""
    place, line = file, 0
    if isinstance(error, SyntaxError) and error.filename:
        place, line = Path(error.filename), error.lineno or 0
    else:
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _is_users_own(frame.filename, file)]
        if frames:
            place, line = Path(frames[-1].filename), frames[-1].lineno or 0
    kind = "" if isinstance(error, GreyboxError) else f"{type(error).__name__}: "
    try:
        message = error.msg if isinstance(error, SyntaxError) else str(error)
    except Exception:  # its own text fails
        message = "an error without a text"
    return ModelError(f"{display_path(place)}{f', line {line}' if line else ''}: {kind}{message}")


def _is_users_own(filename: str, file: Path) -> bool:
    """Whether a frame lies in the user's own files: the file itself, or one below its project or folder."""
    root = project_root(file.parent, named=True) or file.parent
    library = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if filename.startswith("<"):  # the import system's own frames
        return False
    path = os.path.abspath(filename)
    return path == str(file) or (
        Path(path).is_relative_to(root) and not path.startswith(library) and "site-packages" not in path
    )
