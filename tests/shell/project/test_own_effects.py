"""A project's own catalogue: effects in its folder `effects/` are candidates, a law is kept there, strangers' files run nothing."""

from __future__ import annotations

import ast
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from greybox.base.errors import DataError, GreyboxError, ModelError
from greybox.shell.own_effects import find_effect, find_own_effects, keep_effect
from greybox.shell.project import project_root
from tests.shell.project.test_foreign_projects import STRANGER, needs_superuser
from tests.shell.project.test_outline import TRAP
from tests.support.hostile import CODE, MARKUP
from tests.support.kept_law import LAW

OWN = """from greybox import Parameter
from greybox.model.effects import formula_effect

drag = formula_effect("drag", "force", "k*abs(v)*v", [Parameter("k", "N*s^2/m^2", -0.3)])
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "rig.py").write_text("import greybox\n")
    (tmp_path / "effects").mkdir()
    (tmp_path / "results" / "rig-discover").mkdir(parents=True)
    empty = {"parameters": {}, "gap": {}, "alternatives": [], "ranking": [], "noise": {}}
    data = {"format": 1, "verdict": "named", "effects": [LAW], "model": "rig", **empty}
    (tmp_path / "results" / "rig-discover" / "discovery.json").write_text(json.dumps(data))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = dict(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - set(before):
        if name.startswith(("_greybox_file_", "models")):
            del sys.modules[name]


def test_effects_of_the_project_come_beside_the_catalogue(project: Path):
    (project / "effects" / "mine.py").write_text(OWN)
    assert [e.name for e in find_own_effects()] == ["drag"]
    assert find_effect("drag").equation == "k*abs(v)*v"
    assert find_effect("coulomb_friction").name == "coulomb_friction"
    with pytest.raises(ModelError, match="an effect"):
        find_effect("drg")


def test_a_law_is_kept_as_an_effect_that_reads_back(project: Path):
    path = keep_effect("soft_stop")
    assert path == project / "effects" / "soft_stop.py"
    (kept,) = find_own_effects()
    assert kept.name == "soft_stop" and kept.site == "force" and kept.equation == LAW["formula"]
    assert {q.name: q.value for q in kept.parameters} == {"k": -4.1e5, "c": 0.121}
    with pytest.raises(ModelError, match="one of this name already"):
        keep_effect("soft_stop")
    with pytest.raises(ModelError, match="letters, digits"):
        keep_effect("end-stop")


def write_law(project: Path, **changes: object) -> None:
    file = project / "results" / "rig-discover" / "discovery.json"
    data = json.loads(file.read_text())
    data["effects"] = [{**LAW, **changes}]
    file.write_text(json.dumps(data))


@pytest.mark.parametrize("text", [*CODE, *MARKUP[:2], "\nimport os\nos.environ['HURT'] = '1'\n"])
@pytest.mark.parametrize("field", ["equation", "range"])
def test_a_law_of_a_stranger_runs_nothing(project: Path, monkeypatch: pytest.MonkeyPatch, text: str, field: str):
    monkeypatch.delenv("HURT", raising=False)
    write_law(project, **{field: text if field == "equation" else {text: [0.0, 1.0]}})
    if "\ud800" in text:  # a half of a character is no JSON
        with pytest.raises(DataError, match="Unicode"):
            keep_effect("soft_stop")
        return
    path = keep_effect("soft_stop")
    kinds = [type(statement).__name__ for statement in ast.parse(path.read_bytes()).body]
    assert kinds == ["Expr", "ImportFrom", "ImportFrom", "Assign"]
    assert [e.equation for e in find_own_effects()] == [LAW["formula"]]
    assert "HURT" not in os.environ


@pytest.mark.parametrize(
    "changes",
    [
        {"formula": "__import__('os').system('true')"},
        {"formula": "k*max("},
        {"formula": ""},
        {"parameters": {}},
        {"parameters": {"k": {"value": None, "unit": "N/m"}}},
        {"parameters": {"k": {"value": 1.0, "unit": "N/m); import os"}}},
        {"parameters": {"k": {"value": 10**400, "unit": "N/m"}}},
        {"parameters": {"k": {"value": 1.0}}},
        {"range": {"x": [1.0]}},
    ],
)
def test_what_is_no_law_is_not_kept(project: Path, changes: dict[str, object]):
    write_law(project, **changes)
    with pytest.raises(GreyboxError, match=r"discovery\.json"):
        keep_effect("soft_stop")
    assert list((project / "effects").iterdir()) == []


def test_two_effects_of_one_name_are_told(project: Path):
    (project / "effects" / "one.py").write_text(OWN)
    (project / "effects" / "two.py").write_text(OWN)
    with pytest.raises(ModelError, match="is in effects"):
        find_own_effects()


@needs_superuser
def test_effects_of_a_stranger_are_not_run(project: Path):
    trap = project / "effects" / "trap.py"
    trap.write_text(TRAP)
    os.chown(trap, STRANGER, STRANGER)
    assert project_root() is None
    assert find_own_effects() == ()
    assert not list(project.rglob("ran"))
