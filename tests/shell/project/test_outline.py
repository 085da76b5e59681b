"""Model files read as text: the same names as running them gives, and nothing runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from greybox.shell.completion import find_outline, list_outlines, read_outlines
from greybox.shell.project import list_models

TRAP = """
from pathlib import Path
from greybox import Input, Model, Output, Parameter, State

Path(__file__).with_name("ran").touch()
rig = Model(
    "rig",
    states=[State("x", "m")],
    inputs=[Input("F", "N")],
    outputs=[Output("x", "m")],
    parameters=[Parameter("k", "N/m", 10.0, (1, 100), description="spring")],
    balances=lambda x, u, p: [],
    description="a trap",
)
stiff = rig.start(k=50)
"""


def test_outlines_list_the_models_that_running_the_files_gives():
    outlines = {outline.name: outline for outline in list_outlines()}
    for entry in list_models().models:
        outline = outlines[entry.name]
        assert set(outline.parameters) >= {q.name for q in entry.model.parameters}
        assert set(outline.inputs) >= {i.name for i in entry.model.inputs}
        assert set(outline.outputs) >= {o.name for o in entry.model.outputs}
    assert outlines.keys() == {entry.name for entry in list_models().models}


def test_reading_an_outline_runs_nothing(tmp_path: Path):
    file = tmp_path / "rig.py"
    file.write_text(TRAP)
    first, second = read_outlines(file)
    assert (first.name, first.description, second.name) == ("rig", "a trap", "stiff")
    assert find_outline(f"{file}:stiff").parameters["k"].value == "10"
    assert find_outline(str(file)).name == "rig"
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    "text", ["(", "\0", "x = " + "(" * 5000, "rig = Model(*things)", "rig = Model(name=3)\nrig = rig(rig)"]
)
def test_a_file_that_cannot_be_read_offers_nothing_or_little(tmp_path: Path, text: str):
    file = tmp_path / "rig.py"
    file.write_text(text)
    assert all(not outline.parameters for outline in read_outlines(file))
    assert find_outline(str(tmp_path / "missing.py")) is None
