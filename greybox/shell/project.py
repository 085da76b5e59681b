"""Folders: the root of a project, and the template that travels with the library."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import os
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from greybox.base import ExtensionKind, GreyboxError, ModelError, Printable, load_extensions, nearest
from greybox.base.files import is_output_of, list_foreign
from greybox.data.file_kinds import record_suffixes
from greybox.model import Model
from greybox.shell.plants import find_plant_kind
from greybox.shell.study_values import split_model_path
from greybox.simulation.kernel.c_compiler import find_cache_folder
from greybox.simulation.plant import as_model, is_plant

# The folder of a project with effects of its own.
EFFECTS = "effects"
PACKAGE = Path(__file__).resolve().parents[1]


def project_root(start: Path | None = None, *, named: bool = False) -> Path | None:
    """The project around a folder: the nearest folder upwards with ``models/`` whose files use greybox.

    The files of a project are run, and whoever works below a folder did not choose them. The search therefore ends at the user's
    home, at the border of the file system and at a folder of another user, and a project with files of another user is none.

    Parameters
    ----------
    start
        Where the search begins; None for the working folder.
    named
        The user named a file there, so that its project may belong to somebody else.

    Returns
    -------
    Path or None
        The root of the project; None where there is none.
    """
    for folder in _searched_folders((start or Path.cwd()).resolve(), named):
        if any(map(_uses_greybox, model_files(folder))):
            return folder if named or _belongs_to_user(folder) else None
    return None


def template_root() -> Path:
    """The folder with the shipped ``models/`` and ``fits/``: inside the installed package, or the repository itself."""
    installed = PACKAGE / "_template"
    return installed if installed.is_dir() else PACKAGE.parent


def model_files(root: Path) -> list[Path]:
    """Files in ``models/`` of a project, in alphabetical order."""
    return [path for path in sorted((root / "models").glob("*.py")) if path.name != "__init__.py"]


def _searched_folders(first: Path, named: bool) -> Iterator[Path]:
    """``first`` and the folders above it, up to the user's home, another file system or another user's folder."""
    device, home = _device(first), _home()
    for folder in (first, *first.parents):
        if _device(folder) != device or not (named or _is_users_own(folder)):
            return
        yield folder
        if folder == home:
            return


def _belongs_to_user(root: Path) -> bool:
    """Whether everything that would be run in a project is the user's own."""
    folders = [root / "models", *(folder for folder in (root / EFFECTS,) if folder.is_dir())]
    return all(map(_is_users_own, (root, *folders, *(file for folder in folders for file in folder.glob("**/*.py")))))


def _is_users_own(path: Path) -> bool:
    """Whether a file or folder belongs to the user; with ``sudo`` also to who called it. Windows has no such owner."""
    if not hasattr(os, "geteuid"):
        return True
    users = {os.geteuid()}
    if os.geteuid() == 0 and os.environ.get("SUDO_UID", "").isdecimal():
        users.add(int(os.environ["SUDO_UID"]))
    try:
        return path.stat().st_uid in users
    except OSError:
        return False


def _device(folder: Path) -> int | None:
    try:
        return folder.stat().st_dev
    except OSError:  # a folder that is not there has nothing above it to be searched either
        return None


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except (RuntimeError, OSError):  # no HOME, and a user whom the machine does not know
        return None


def _uses_greybox(path: Path) -> bool:
    try:
        return b"greybox" in path.read_bytes()
    except OSError:  # a file that may not be read makes no project
        return False


# Importing a user's file: one module and one identity for each, and errors told with file and line.

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
    # A user's file may raise whatever it likes, and call sys.exit.
    except BaseException as error:
        raise _model_error(error, file) from error


def import_standalone(file: Path) -> ModuleType:
    """The module in ``file`` as it stands now, under a name of its own; it may import from its project, and from its folder."""
    # By what the file says, not by its path alone: a model that was written anew is another one.
    try:
        text = file.read_bytes()
    except OSError as error:
        raise _model_error(error, file) from error
    name = f"_greybox_file_{hashlib.sha256(str(file).encode() + text).hexdigest()[:12]}"
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
        # From these very bytes: kept bytecode goes by the second and the size of a file, and a refit may leave both.
        exec(compile(text, str(file), "exec", dont_inherit=True), vars(module))
    # A user's file may raise whatever it likes, and call sys.exit.
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, KeyboardInterrupt):
            raise
        raise _model_error(error, file) from error
    return module


def models_in(module: ModuleType) -> dict[str, Model]:
    """The models and plants that a module makes, by variable; private names and those it only imports are left out.

    Raises ModelError for one that has no content.
    """
    plants = {name: as_model(value) for name, value in values_in(module, object).items() if is_plant(value)}
    models = {**values_in(module, Model), **plants}
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
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _is_own_module(frame.filename, file)]
        if frames:
            place, line = Path(frames[-1].filename), frames[-1].lineno or 0
    kind = "" if isinstance(error, GreyboxError) else f"{type(error).__name__}: "
    try:
        message = error.msg if isinstance(error, SyntaxError) else str(error)
    # A user's own class of error, whose text may fail.
    except Exception:
        message = "an error without a text"
    return ModelError(f"{display_path(place)}{f', line {line}' if line else ''}: {kind}{message}")


def _is_own_module(filename: str, file: Path) -> bool:
    """Whether a frame lies in the user's own files: the file itself, or one below its project or folder."""
    root = project_root(file.parent, named=True) or file.parent
    library = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if filename.startswith("<"):  # the import system's own frames
        return False
    path = os.path.abspath(filename)
    return path == str(file) or (
        Path(path).is_relative_to(root) and not path.startswith(library) and "site-packages" not in path
    )


# From a name or a path to a model.


@dataclass(frozen=True)
class ModelEntry:
    """A model under the ``name`` that finds it, and ``where`` it is written."""

    name: str
    model: Model
    where: str


@dataclass(frozen=True)
class ModelListing(Printable):
    """Every model that a name finds here, and files that could not be read, with the reason."""

    models: tuple[ModelEntry, ...]
    problems: tuple[str, ...]


def find_model(name: str) -> Model:
    """Find a model by its name or its file.

    Parameters
    ----------
    name
        The name of a file in ``models/`` of the project, or of a model in one of them, else the name of a shipped model, or of a plant
        of the entry points ``greybox.plants``. A path, ``my/rig.py``, gives the model or plant (`greybox.simulation.plant.Plant`) named
        like the file or the only one in it; ``my/rig.py:name`` selects one. The project is that around the working folder.

    Returns
    -------
    Model
        The same object for the same file in one process.

    Raises
    ------
    ModelError
        For an unknown name, with the nearest ones; for the name of a record; for a file that cannot be run, with the line.

    Examples
    --------
    >>> find_model("micro_actuator").title
    'micro_actuator'
    """
    if Path(name).suffix.lower() in record_suffixes():
        names = ", ".join(f.name for f in list_models().models)
        raise ModelError(
            f"{name}: a record, not a model file; MODEL comes first, as in MODEL {name} (known models: {names})"
        )
    if kind := find_plant_kind(name):
        return as_model(kind.read(name))
    if is_model_path(name):
        return _in_file(*split_model_path(name))
    for source in _sources():
        model = source.find(name)
        if model is not None:
            return model
    plants = {n: v for n, v in load_extensions(ExtensionKind.PLANTS).items() if is_plant(v)}
    if name in plants:
        return as_model(plants[name])
    known = list_models()
    close = nearest(name, [*(f.name for f in known.models), *plants])
    as_path = f"; or give the path {name}.py" if Path(f"{name}.py").is_file() else ""
    broken = "".join(f"\n  not read: {problem}" for problem in known.problems)
    raise ModelError(f"no model {name!r}; {close}{as_path}{broken}")


def is_model_path(name: str) -> bool:
    """Whether `find_model` takes ``name`` as a file, and not as the name of a model."""
    is_python = name.endswith(".py") or ".py:" in name or "/" in name or "\\" in name
    return is_python or find_plant_kind(name) is not None


# Digests of the programs that this user has named as models when a study was written, in the folder of the cache.
MODELS_FOLDER = "models"


def remember_program(name: str) -> None:
    """Know the file that ``name`` is, as it stands, for a program that this user runs: a study may name it again."""
    if runs_code(name) and (file := split_model_path(name)[0]).is_file():
        list_foreign({file: ""}, MODELS_FOLDER, find_cache_folder() / MODELS_FOLDER)


def is_remembered(name: str) -> bool:
    """Whether `remember_program` knows the file that ``name`` is, and it has not changed since."""
    file = split_model_path(name)[0]
    return file.is_file() and is_output_of(file, MODELS_FOLDER, find_cache_folder() / MODELS_FOLDER)


def runs_code(name: str) -> bool:
    """Whether `find_model` runs a program in the file that ``name`` is: then nothing but the user may name it.

    The one gate for what comes from study files and results.
    """
    kind = find_plant_kind(name)
    return is_model_path(name) if kind is None else kind.runs_code


def find_shipped_model(name: str) -> Model:
    """The model called ``name`` as the library ships it, whatever the project around the working folder holds.

    Raises
    ------
    ModelError
        If no model of this name is shipped.
    """
    root = template_root().resolve()
    model = _Source(root, named=project_root() in (None, root), shipped=True).find(name)
    if model is None:
        raise ModelError(f"no model {name!r} is shipped; {nearest(name, [file.stem for file in model_files(root)])}")
    return model


def list_models() -> ModelListing:
    """The models of the project around the working folder, then the shipped ones that it does not have.

    Files that cannot be run are listed as problems and do not hide the others.
    """
    entries: dict[str, ModelEntry] = {}
    problems = []
    foreign = project_root(named=True)
    if foreign not in (None, project_root()):
        problems.append(
            f"{foreign}: the project belongs to another user, so its models are not run; if you trust it, give the path of a model file,"
            f" as in {next(iter(model_files(foreign)))}"
        )
    for source in _sources():
        for file, held in source.contents():
            if isinstance(held, ModelError):
                problems.append(str(held))
                continue
            for name, model in held.items():
                entries.setdefault(name, ModelEntry(name, model, source.where(file)))
    return ModelListing(tuple(entries.values()), tuple(problems))


@dataclass(frozen=True)
class _Source:
    """A folder with ``models/``; ``named``: imported as the package ``models``, as its own files import one another."""

    root: Path
    named: bool
    shipped: bool

    def contents(self, first: str = "") -> Iterator[tuple[Path, dict[str, Model] | ModelError]]:
        """Each file with its models by variable, or with what is wrong with it; the file called ``first`` comes first."""
        for file in sorted(model_files(self.root), key=lambda file: file.stem != first):
            try:
                yield file, models_in(import_from_project(self.root, file) if self.named else import_standalone(file))
            except ModelError as error:
                yield file, error

    def where(self, file: Path) -> str:
        return f"models/{file.name}, shipped with greybox" if self.shipped else display_path(file)

    def find(self, name: str) -> Model | None:
        """The model of this name: in the file of this name, else in any other; None if no file could hold it.

        Raises ModelError for a file that cannot be run and speaks of the name: another model must not stand in for it.
        """
        broken: ModelError | None = None
        for file, models in self.contents(name):
            if isinstance(models, ModelError):
                if file.stem == name:
                    raise models
                if broken is None and name.encode() in file.read_bytes():
                    broken = models
                continue
            if file.stem == name and len(models) == 1:
                return next(iter(models.values()))
            for variable, model in models.items():
                if name in (variable, model.name):
                    return model
        if broken is not None:
            raise broken
        return None


def _sources() -> Iterator[_Source]:
    root = project_root()
    shipped = template_root().resolve()
    if root is not None:
        yield _Source(root, named=True, shipped=False)
    if root != shipped and (shipped / "models").is_dir():
        yield _Source(shipped, named=root is None, shipped=True)


def _in_file(path: Path, wanted: str) -> Model:
    if path.is_dir():
        inside = sorted(f.name for f in path.glob("*.py"))
        held = f"give a file in it: {', '.join(inside)}" if inside else "and no model file lies in it"
        raise ModelError(f"{path}: a folder, not a model file; {held}")
    if not path.is_file():
        if not path.parent.is_dir():
            raise ModelError(f"{path}: file not found, there is no folder {str(path.parent)!r}")
        beside = nearest(path.name, sorted(f.name for f in path.parent.glob("*.py")))
        raise ModelError(f"{path}: file not found; {beside}")
    if path.suffix != ".py":
        raise ModelError(
            f"{path} is not a model file; give a file that ends in .py, or the name of a model (see greybox models)"
        )
    file = path.resolve()
    models = models_in(load_model_file(file))
    if not models:
        raise ModelError(f"{path} holds no model; it needs one, as in {file.stem} = Model(...)")
    if wanted:
        if wanted not in models:
            raise ModelError(f"{path} holds no model {wanted!r}; {nearest(wanted, models)}")
        return models[wanted]
    if file.stem in models:
        return models[file.stem]
    if len(models) > 1:
        raise ModelError(
            f"{path} holds {len(models)} models: {', '.join(models)}; pick one, as in {path}:{next(iter(models))}"
        )
    return next(iter(models.values()))
