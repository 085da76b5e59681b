"""The notebook runs from top to bottom as it stands, and is kept without outputs."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbformat comes with nbclient, in the extra 'test'")
nbclient = pytest.importorskip("nbclient", reason="nbclient comes with the extra 'test'")
pytest.importorskip("ipykernel", reason="ipykernel comes with the extra 'test'")

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs" / "notebooks" / "first_hour.ipynb"
SECONDS = 300  # for one cell, on a slow and busy machine


def test_the_notebook_is_kept_without_outputs() -> None:
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert len(code) > 5
    assert all(not cell.outputs and cell.execution_count is None for cell in code)


@pytest.mark.slow
def test_the_notebook_names_the_hidden_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("MPLBACKEND", "agg")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    end = nbformat.v4.new_code_cell(
        "print(found.verdict, found.best.model.title, plain.misfit['x'].noise_ratio, found.holdout['x'].explained_fraction, plant.nstates)"
    )
    notebook.cells.append(end)
    client = nbclient.NotebookClient(
        notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(NOTEBOOK.parent)}}
    )
    client.execute()
    printed = "".join(
        output["text"] for output in end.outputs if output.get("name") == "stdout"
    )  # it may come in pieces
    verdict, model, _, effect, ratio, closed, states = printed.split()
    assert (verdict, model, effect, states) == ("named", "micro_actuator", "cubic_stiffness", "3")
    assert float(ratio) > 20 and math.isclose(float(closed), 1.0, abs_tol=0.01)
