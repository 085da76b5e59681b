"""Where models are found, what a broken file says, and the project that `write_project` writes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from greybox import GreyboxError, Model
from greybox.base.errors import ModelError
from greybox.shell.project import find_model, find_shipped_model, list_models, project_root, template_root
from greybox.shell.template import FOLDERS, STUDIES, write_project

RIG = """
from greybox import Balance, Input, Model, Output, Parameter, State


def balances(x, u, p):
    return [
        Balance("position", "m/s", 1, "x", velocity=x.v),
        Balance("force", "N", p.m, "v", drive=u.F, spring=-p.k * x.x),
    ]


{name} = Model(
    "{name}",
    states=[State("x", "m"), State("v", "m/s")],
    inputs=[Input("F", "N")],
    outputs=[Output("x", "m")],
    parameters=[Parameter("m", "kg", 1.0, (0.1, 10)), Parameter("k", "N/m", 10.0, (1, 100))],
    balances=balances,
)
"""
Write = Callable[..., Path]


def rig(*names: str) -> str:
    return "\n".join(RIG.format(name=name) for name in names)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder; what is imported from it is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = dict(sys.modules)
    yield tmp_path
    for name in [n for n in sys.modules if n.split(".")[0] == "models" or n.startswith("_greybox_file_")]:
        del sys.modules[name]
    sys.modules.update(
        {n: m for n, m in before.items() if n.split(".")[0] == "models" or n.startswith("_greybox_file_")}
    )


@pytest.fixture
def write(folder: Path) -> Write:
    def write(name: str, text: str) -> Path:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_outside_a_project_the_shipped_models_are_found(folder: Path) -> None:
    assert project_root() is None
    assert find_model("micro_actuator").name == "micro_actuator"
    assert find_model("micro_actuator_no_inductance").name == "micro_actuator_no_inductance"
    assert {f.name for f in list_models().models} >= {"micro_actuator", "pneumatic_cylinder", "silverbox"}
    assert all("shipped" in f.where for f in list_models().models)


def test_a_project_is_found_from_below_and_its_models_come_first(folder: Path, write: Write, monkeypatch) -> None:
    write("models/rig.py", rig("rig", "rig_two"))
    write("models/micro_actuator.py", rig("micro_actuator"))
    (folder / "deep" / "down").mkdir(parents=True)
    monkeypatch.chdir(folder / "deep" / "down")
    assert project_root() == folder
    assert find_model("rig").name == "rig"
    assert find_model("rig_two").name == "rig_two"
    assert len(find_model("micro_actuator").states) == 2
    assert len(find_shipped_model("micro_actuator").states) == 3
    assert find_model("pneumatic_cylinder").name == "pneumatic_cylinder"
    where = {f.name: f.where for f in list_models().models}
    assert where["micro_actuator"].endswith("micro_actuator.py")
    assert "shipped" not in where["micro_actuator"]
    assert "shipped" in where["silverbox"]


def test_there_is_one_module_and_one_identity(folder: Path, write: Write) -> None:
    write("models/rig.py", rig("rig"))
    model = find_model("rig")
    import models.rig

    assert models.rig.rig is model
    assert find_model("models/rig.py") is model
    assert find_model(str(folder / "models" / "rig.py:rig")) is model


def test_another_project_has_other_models(folder: Path, write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    write("one/models/rig.py", rig("rig"))
    write("two/models/rig.py", rig("rig").replace("10.0", "20.0"))
    values = []
    for name in ("one", "two", "one"):
        monkeypatch.chdir(folder / name)
        values.append(find_model("rig").values["k"])
    assert values == [10.0, 20.0, 10.0]


def test_a_folder_called_models_without_greybox_is_no_project(folder: Path, write: Write) -> None:
    write("models/fashion.py", "names = []")
    assert project_root() is None


def test_a_file_outside_a_project_may_import_its_neighbour(write: Write) -> None:
    write("my/constants_of_the_rig.py", "k = 33.0")
    text = "from constants_of_the_rig import k\n" + rig("rig").replace("10.0", "k")
    assert find_model(str(write("my/rig.py", text))).values["k"] == 33.0


def test_a_file_that_was_written_anew_is_read_anew(write: Write) -> None:
    # Within one second and as long as before, as a refit writes its constants.
    file = write("refit.py", rig("rig"))
    assert find_model(str(file)).values["k"] == 10.0
    write("refit.py", rig("rig").replace('"N/m", 10.0', '"N/m", 20.0'))
    assert find_model(str(file)).values["k"] == 20.0


def test_a_model_that_is_only_imported_is_not_the_files_own(folder: Path, write: Write) -> None:
    write("models/rig.py", rig("rig"))
    write("models/a_variant.py", "from greybox import Model\nfrom models.rig import rig\nstiff = rig.start(k=50)\n")
    assert find_model("models/a_variant.py").values["k"] == 50
    assert [f.where for f in list_models().models if f.name == "rig"] == [str(Path("models") / "rig.py")]


SPEECHLESS = "class E(Exception):\n    def __str__(self): raise ValueError\n"


@pytest.mark.parametrize(
    ("file", "text", "wanted", "message"),
    [
        ("my/rig.py", rig("one", "two"), "my/rig.py", r"holds 2 models: one, two; pick one, as in my/rig.py:one"),
        ("my/rig.py", rig("rig"), "my/rig.py:rog", r"holds no model 'rog'; did you mean 'rig'"),
        ("my/rig.py", "x = 1", "my/rig.py", r"holds no model; it needs one, as in rig = Model"),
        ("my/rig.py", rig("rig"), "my/rg.py", r"my/rg.py: file not found; did you mean 'rig.py'"),
        ("my/rig.py", rig("rig"), "yours/rig.py", r"there is no folder 'yours'"),
        ("my/rig.txt", rig("rig"), "my/rig.txt", r"not a model file"),
        ("rig.py", rig("rig"), "rig", r"no model 'rig'; .*or give the path rig.py"),
        ("my/rig.py", "\n\nm = (", "my/rig.py", r"my/rig.py, line 3: SyntaxError"),
        ("my/rig.py", "\nimport not_there_at_all", "my/rig.py", r"my/rig.py, line 2: ModuleNotFoundError"),
        ("my/rig.py", rig("rig").replace("x.x", "x.y"), "my/rig.py", r"my/rig.py, line 8: no state 'y'"),
        ("my/rig.py", rig("rig").replace("p.k *", "p.m *"), "my/rig.py", r"my/rig.py, line \d+: .*spring.*expected N"),
        ("my/rig.py", "raise SystemExit(3)", "my/rig.py", r"my/rig.py, line 1: SystemExit: 3"),
        ("my/rig.py", "raise GeneratorExit", "my/rig.py", r"my/rig.py, line 1: GeneratorExit"),
        ("my/rig.py", "class E(BaseException): pass\nraise E('odd')", "my/rig.py", r"my/rig.py, line 2: E: odd"),
        ("my/rig.py", SPEECHLESS + "raise E", "my/rig.py", r"my/rig.py, line 3: E: an error without a text"),
        (
            "models/rig.py",
            "import greybox\n" + SPEECHLESS + "raise E",
            "models/rig.py",
            r"line 4: E: an error without a text",
        ),
        (
            "my/rig.py",
            "import greybox\nm = object.__new__(greybox.Model)",
            "my/rig.py",
            r"m is a model that was never stated",
        ),
    ],
)
def test_what_cannot_be_used_says_where_and_why(write: Write, file: str, text: str, wanted: str, message: str) -> None:
    write(file, text)
    with pytest.raises(ModelError, match=message):
        find_model(wanted)


def test_an_unknown_name_lists_the_nearest(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"no model 'micro_actuatr'; did you mean 'micro_actuator'"):
        find_model("micro_actuatr")


def test_a_broken_file_does_not_hide_the_others(folder: Path, write: Write) -> None:
    write("models/a_broken.py", "import greybox\nx = 1 / 0\n")
    write("models/rig.py", rig("rig", "second"))
    assert find_model("rig").name == "rig"
    assert find_model("second").name == "second"
    listing = list_models()
    assert "rig" in {f.name for f in listing.models}
    assert len(listing.problems) == 1
    assert "a_broken.py, line 2: ZeroDivisionError" in listing.problems[0]
    with pytest.raises(ModelError, match=r"no model 'third'(.|\n)*not read: .*a_broken.py, line 2"):
        find_model("third")
    with pytest.raises(ModelError, match="ZeroDivisionError"):
        find_model("a_broken")


def test_a_broken_file_is_not_replaced_by_the_shipped_model(folder: Path, write: Write) -> None:
    write("models/rigs.py", rig("micro_actuator").replace("p.k *", "p.kk *"))
    with pytest.raises(ModelError, match=r"rigs.py, line 8: no parameter 'kk'"):
        find_model("micro_actuator")
    assert find_model("silverbox").name == "silverbox"
    write("models/good.py", rig("emps"))
    assert len(find_model("emps").parameters) == 2
    write("models/emps.py", "import greybox\n1 / 0\n")
    with pytest.raises(ModelError, match=r"emps.py, line 2: ZeroDivisionError"):
        find_model("emps")


def test_a_model_made_of_a_neighbours_parts_is_found(folder: Path, write: Write) -> None:
    write("models/parts.py", rig("base"))
    write("models/stiff.py", "from models.parts import base\n\nstiff = base.start(k=50)\n")
    assert find_model("stiff").values["k"] == 50
    assert {"base", "stiff"} <= {f.name for f in list_models().models}


def test_init_writes_a_project_that_works_by_itself(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = write_project(folder / "rig")
    assert {p.relative_to(folder / "rig").parts[0] for p in written} >= {"models", "README.md"}
    assert {p.name for p in written if p.parent.name == "fits"} == set(STUDIES)
    studies = [p.read_text(encoding="utf-8") for p in written if p.parent.name == "fits"]
    needed = {name for text in studies for name in re.findall(r"(?:from|import) fits\.(\w+)", text)}
    assert {f"{name}.py" for name in needed} <= set(STUDIES)
    assert len(written) <= 20  # a project to read, and not the library's own workshop
    assert not list((folder / "rig").rglob("__pycache__"))
    for path in written:
        if path.name != "README.md":
            inside, *rest = path.relative_to(folder / "rig").parts
            assert path.read_bytes() == (template_root() / FOLDERS[inside]).joinpath(*rest).read_bytes()
    monkeypatch.chdir(folder / "rig")
    assert project_root() == folder / "rig"
    assert isinstance(find_model("micro_actuator"), Model)
    assert Path(sys.modules["models.micro_actuator"].__file__).parent == folder / "rig" / "models"


def test_init_overwrites_nothing_unless_told_to(folder: Path) -> None:
    own = folder / "models" / "silverbox.py"
    own.parent.mkdir()
    own.write_text("mine")
    with pytest.raises(GreyboxError, match=r"already holds models/silverbox.py; .*--force"):
        write_project(folder)
    assert own.read_text() == "mine"
    assert [p.name for p in folder.rglob("*")] == ["models", "silverbox.py"]
    write_project(folder, force=True)
    assert own.read_text() != "mine"
    with pytest.raises(GreyboxError, match="is a file"):
        write_project(own)
