"""What the repository as a whole promises: clean text, a documented and typed public surface, a wheel that installs."""

from __future__ import annotations

import ast
import re
import subprocess
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from pkgutil import resolve_name

import pytest
import yaml

from greybox.base.extensions import ExtensionKind
from greybox.shell.template import STUDIES
from tests.support.sources import ROOT, parsed

pytestmark = pytest.mark.usefixtures("read_sources")
Function = ast.FunctionDef | ast.AsyncFunctionDef

# Each pattern has a letter in brackets, so that it does not match its own line.
UNWANTED = {
    "a path of one machine": r"(?<![\w.])/(?:wor[k]|hom[e]|roo[t]|User[s])/",
    "the address of a package registry": r"index[-_]ur[l]|find[-_]link[s]|(?:pypi|pythonhosted|npmjs)\.or[g]",
    "a note of unfinished work": r"\b(?:TOD[O]|FIXM[E]|XX[X])\b",
}


def files() -> list[Path]:
    """What git tracks or would track; in an unpacked archive, everything outside hidden folders."""
    if (ROOT / ".git").exists():
        command = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\0")
        return [path for name in names if name and (path := ROOT / name).is_file()]
    parts = ((path, path.relative_to(ROOT).parts) for path in ROOT.rglob("*") if path.is_file())
    return [path for path, names in parts if not any(n.startswith(".") or n == "__pycache__" for n in names[:-1])]


@cache
def texts() -> list[tuple[Path, str]]:
    """Each text file of the project with its content; what is not UTF-8 is a figure or an archive."""
    read = []
    for path in files():
        with suppress(UnicodeDecodeError):
            read.append((path.relative_to(ROOT), path.read_text(encoding="utf-8")))
    return read


@pytest.mark.parametrize("what", UNWANTED)
def test_text_is_free_of(what: str) -> None:
    pattern = re.compile(UNWANTED[what])
    found = [
        f"{path}:{number}: {match.group()}"
        for path, text in texts()
        for number, line in enumerate(text.splitlines(), 1)
        if (match := pattern.search(line))
    ]
    assert not found, "\n".join([f"{what} has no place in the project:", *found])


# A place in backticks of a page, a docstring or a comment: a path of this project, or a name that Python imports.
PLACE = re.compile(r"`((?:greybox|models|plants|fits|tests|docs)/[\w./-]*\w)`|`(greybox(?:\.[A-Za-z_]\w*)+)`")


def test_every_place_that_a_text_names_exists() -> None:
    groups = {f"greybox.{kind}" for kind in ExtensionKind}  # of entry points: names that nothing imports
    found = [
        f"{path}:{number}: {match.group()}"
        for path, text in texts()
        if path.suffix in {".md", ".py"} and path.parts[0] != "tests" and path.name != "CHANGELOG.md"
        for number, line in enumerate(text.splitlines(), 1)
        for match in PLACE.finditer(line)
        if not ((match[1] and (ROOT / match[1]).exists()) or (match[2] and (match[2] in groups or _is_name(match[2]))))
    ]
    assert not found, "\n".join(found)


# Pages for contributors: what they call by its name alone is of this project, too.
FOR_CONTRIBUTORS = ("CONTRIBUTING.md", "docs/architecture.md", "docs/decisions/")


def test_every_file_and_function_that_contributors_are_sent_to_exists() -> None:
    names = {path.name for path in files()}
    pages = {path.as_posix(): text for path, text in texts() if path.as_posix().startswith(FOR_CONTRIBUTORS)}
    gone = [
        f"{page}: {name}"
        for page, text in pages.items()
        for name in re.findall(r"`(\w+\.py)`", text)
        if name not in names
    ]
    sources = "\n".join(text for path, text in texts() if path.parts[0] == "greybox" and path.suffix == ".py")
    defined = set(re.findall(r"^ *(?:(?:def|class) )?(\w+)(?=[:( ])", sources, re.MULTILINE))
    places = pages["docs/architecture.md"].partition("## Where is")[2].partition("\n## ")[0]
    gone += [name for name in re.findall(r"`(?:[A-Z]\w+\.)?(\w+)`", places) if name not in defined]
    assert len(pages) > len(FOR_CONTRIBUTORS) and not gone, "\n".join(gone)


@pytest.mark.parametrize(("name", "is_there"), [("greybox.base.units.Unit", True), ("greybox.base.nothing", False)])
def test_a_place_is_a_module_or_a_name_in_one(name: str, is_there: bool) -> None:
    assert _is_name(name) is is_there


@cache
def _is_name(dotted: str) -> bool:
    """Whether Python finds the module, or what hangs on one."""
    with suppress(AttributeError, ImportError):
        return resolve_name(dotted) is not None
    return False


@pytest.mark.parametrize(
    ("what", "example"),
    [
        ("a path of one machine", "see /hom{}/ann/rig.csv".format("e")),
        ("the address of a package registry", "pip install --index-ur{} x".format("l")),
        ("a note of unfinished work", "# TOD{}: the other sign".format("O")),
    ],
)
def test_the_text_rules_find_what_they_forbid(what: str, example: str) -> None:
    assert re.search(UNWANTED[what], example)


@pytest.mark.parametrize("name", ["README.md", "CHANGELOG.md", "LICENSE", "Makefile", ".ci/run", "greybox/py.typed"])
def test_file_exists(name: str) -> None:
    assert (ROOT / name).is_file()


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_changelog_speaks_of_this_version(project: dict) -> None:
    assert project["version"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_console_script_leads_to_a_function(project: dict) -> None:
    assert list(project["scripts"]) == ["greybox"]
    assert callable(EntryPoint("greybox", project["scripts"]["greybox"], "console_scripts").load())


def public(body: list[ast.stmt], prefix: str = "") -> Iterator[tuple[str, Function | ast.ClassDef]]:
    """Public functions, classes and methods; what is defined inside a function is its own affair."""
    for node in body:
        if isinstance(node, ast.If | ast.Try):
            yield from public([*node.body, *node.orelse], prefix)
        elif isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_"):
            yield f"{prefix}{node.name}", node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body, f"{node.name}.")


@cache
def public_surface() -> list[tuple[str, Function | ast.ClassDef]]:
    """Where each public function, class and method stands; a method that a base class in the same file describes is left out."""
    surface = []
    for path in sorted((ROOT / "greybox").rglob("*.py")):
        module = parsed(path)
        described = inherited(module)
        surface += [
            (f"{path.relative_to(ROOT)}:{node.lineno}: {name}", node)
            for name, node in public(module.body)
            if name not in described
        ]
    return surface


def inherited(module: ast.Module) -> set[str]:
    """``Class.method`` of each method whose meaning a base class of the module states."""
    classes = {node.name: node for node in module.body if isinstance(node, ast.ClassDef)}

    def described(name: str) -> set[str]:
        node = classes.get(name)
        if node is None:
            return set()
        here = {f.name for f in node.body if isinstance(f, Function) and ast.get_docstring(f)}
        attributes = set(re.findall(r"^    (\w+)$", ast.get_docstring(node, clean=False) or "", re.MULTILINE))
        return here | attributes | bases(node)

    def bases(node: ast.ClassDef) -> set[str]:
        plain = (base.value if isinstance(base, ast.Subscript) else base for base in node.bases)  # Kind[int] is Kind
        return set().union(*(described(base.id) for base in plain if isinstance(base, ast.Name)))

    return {f"{name}.{method}" for name, node in classes.items() for method in bases(node)}


def decorators(node: Function | ast.ClassDef) -> set[str]:
    return {ast.unparse(d).rpartition(".")[2] for d in node.decorator_list}


def unannotated(function: Function) -> list[str]:
    """Arguments without a type, and ``return`` where the result has none; ``self`` and ``cls`` need none."""
    every = function.args
    named = [*every.posonlyargs, *every.args, *every.kwonlyargs, *filter(None, [every.vararg, every.kwarg])]
    bare = [a.arg for a in named if a.annotation is None and a.arg not in ("self", "cls")]
    return bare if function.returns else [*bare, "return"]


def test_public_surface_is_documented() -> None:
    documented_elsewhere = {"overload", "setter", "override"}
    silent = [
        where
        for where, node in public_surface()
        if not decorators(node) & documented_elsewhere and not (ast.get_docstring(node) or "").strip()
    ]
    assert not silent, "\n".join(["without a docstring:", *silent])


def test_public_functions_are_fully_annotated() -> None:
    bare = [
        f"{where}: {', '.join(missing)}"
        for where, node in public_surface()
        if isinstance(node, Function) and (missing := unannotated(node))
    ]
    assert not bare, "\n".join(["without a type:", *bare])


def test_wheel_installs_one_package_with_the_project_as_its_template(tmp_path: Path, project: dict) -> None:
    wheel = pytest.importorskip("hatchling.builders.wheel", reason="hatchling comes with the extra 'test'")
    (built,) = wheel.WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    names = set(zipfile.ZipFile(built).namelist())
    assert {name.partition("/")[0] for name in names} == {"greybox", f"greybox_sysid-{project['version']}.dist-info"}
    ours = [path.relative_to(ROOT) for path in files()]
    given = {Path("fits", study) for study in STUDIES}
    template = [
        Path("greybox/_template") / path
        for path in ours
        if path.parts[0] in ("models", "plants") or path.parts[:2] == ("docs", "notebooks") or path in given
    ]
    library = [path for path in ours if path.parts[0] == "greybox"]
    carried = {name for name in names if name.startswith("greybox/")}
    assert carried == {path.as_posix() for path in (*library, *template)}


def test_the_conda_recipe_and_the_badges_say_what_the_project_says() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(text)
    assert recipe["context"]["version"] == project["version"]
    assert project["requires-python"] == f">={recipe['context']['python_min']}"
    needed = {name.replace("matplotlib>", "matplotlib-base>") for name in project["dependencies"]}
    assert needed == {line.replace(" ", "") for line in recipe["requirements"]["run"] if not line.startswith("python ")}
    assert "://" not in text
    assert f">{project['version']}<" in (ROOT / "docs/figures/badges/version.svg").read_text(encoding="utf-8")
