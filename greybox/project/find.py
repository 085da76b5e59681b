"""From a name or a path to a model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from greybox.errors import ModelError, nearest
from greybox.experiment.formats import SUFFIXES
from greybox.model import Model
from greybox.project.folders import find_foreign_project, model_files, project_root, template_root
from greybox.project.load import display_path, import_from_project, import_standalone, load_model_file, models_in
from greybox.values import Printable


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


def find_model(name: str, folder: Path | None = None) -> Model:
    """Find a model by its name or its file.

    Parameters
    ----------
    name
        The name of a file in ``models/`` of the project, or of a model in one of them, else the name of a shipped model. A path,
        ``my/rig.py``, gives the model named like the file or the only one in it; ``my/rig.py:name`` selects one.
    folder
        Where the project is looked for, upwards; the working folder if left out or where there is none.

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
    if Path(name).suffix.lower() in SUFFIXES:
        names = ", ".join(f.name for f in list_models().models)
        raise ModelError(
            f"{name}: a record, not a model file; MODEL comes first, as in MODEL {name} (known models: {names})"
        )
    path, colon, wanted = name.rpartition(".py:")
    if colon:
        return _in_file(Path(f"{path}.py"), wanted)
    if is_model_path(name):
        return _in_file(Path(name), "")
    for source in _sources(folder):
        model = source.find(name)
        if model is not None:
            return model
    known = list_models(folder)
    close = nearest(name, [f.name for f in known.models])
    as_path = f"; or give the path {name}.py" if Path(f"{name}.py").is_file() else ""
    broken = "".join(f"\n  not read: {problem}" for problem in known.problems)
    raise ModelError(f"no model {name!r}; {close}{as_path}{broken}")


def is_model_path(name: str) -> bool:
    """Whether `find_model` takes ``name`` as a file, which it runs, and not as the name of a model."""
    return name.endswith(".py") or ".py:" in name or "/" in name or "\\" in name


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


def list_models(folder: Path | None = None) -> ModelListing:
    """The models of the project around ``folder`` (the working folder), then the shipped ones that it does not have.

    Files that cannot be run are listed as problems and do not hide the others.
    """
    entries: dict[str, ModelEntry] = {}
    foreign = find_foreign_project(folder)
    problems = [] if foreign is None else [_refuse_foreign(foreign)]
    for source in _sources(folder):
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


def _sources(folder: Path | None = None) -> Iterator[_Source]:
    root = project_root(folder) or project_root()
    shipped = template_root().resolve()
    if root is not None:
        yield _Source(root, named=True, shipped=False)
    if root != shipped and (shipped / "models").is_dir():
        yield _Source(shipped, named=root is None, shipped=True)


def _refuse_foreign(root: Path) -> str:
    return (
        f"{root}: the project belongs to another user, so its models are not run; if you trust it, give the path of a model file,"
        f" as in {next(iter(model_files(root)))}"
    )


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
