"""From a fit to a prediction: its file or its folder stands in the place of the model, and the run says where it begins."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

LAG = """
from greybox import Balance, Input, Model, Output, Parameter, State

lag = Model(
    "lag", [State("x", "K", start=0.5)], [Input("u", "K")], [Output("x", "K")],
    [Parameter("T", "s", 1.0, (0.01, 100.0)), Parameter("G", "1", 1.0, (0.01, 100.0)), Parameter("C", "K", 0.0, fixed=True)],
    lambda x, u, p: [Balance("heat", "K", p.T, "x", loss=-x.x, drive=p.G * u.u, offset=p.C)],
)
"""


def plain(text: str) -> str:
    return re.sub(r"\s+", " ", text)


@pytest.fixture
def folder(run, tmp_path: Path) -> Path:
    """A fit of a lag of 2 s with gain 3, of the exact answer to a step at 0 s, and a plan."""
    (tmp_path / "lag.py").write_text(LAG)
    time = 0.1 * np.arange(200)
    u = np.where(time > 10, 0.0, 1.0)
    up, down = 3 * (1 - np.exp(-time / 2)) + 0.5 * np.exp(-time / 2), np.exp(-(time - 10.1) / 2)
    x = np.where(time <= 10.1, up, up[101] * down) + 1e-3 * np.random.default_rng(1).normal(size=200)
    rows = (f"{t:.1f},{v:g},{y:.6f}" for t, v, y in zip(time, u, x, strict=True))
    (tmp_path / "rows.csv").write_text("\n".join(["time [s],u [K],x [K]", *rows]))
    (tmp_path / "plan.csv").write_text("time [s],u [K]\n" + "\n".join(f"{k},{k % 3}" for k in range(40)))
    result = run("fit", "lag.py", "rows.csv", "--output", "f", "--no-report", "--hold", "zero")
    assert result.exit_code == 0, result.output
    return tmp_path


def test_a_fit_or_its_folder_stands_in_the_place_of_its_model(run, folder: Path) -> None:
    (folder / "models").mkdir()
    (folder / "lag.py").rename(folder / "models/lag.py")
    runs = {}
    for source in ("f/fit.json", "f", "lag"):
        result = run("simulate", source, "plan.csv", "--output", "p.csv", "--no-report")
        assert result.exit_code == 0, result.output
        # A fit to a prediction would find the model again.
        assert "next:" not in result.output
        runs[source] = np.loadtxt(folder / "p.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(runs["f"], runs["f/fit.json"])
    # The exact answer of a lag of 2 s with gain 3 that begins at 0.5 K, to inputs that are held for a second each.
    x, exact = 0.5, []
    for k in range(40):
        exact.append(x)
        x = 3 * (k % 3) + (x - 3 * (k % 3)) * np.exp(-0.5)
    assert np.abs(runs["f"][:, 2] - exact).max() < 0.01 < np.abs(runs["lag"][:, 2] - exact).max()
    checked = run("check", "f", "rows.csv", "--no-report", "--json")
    assert checked.exit_code == 0
    constants = json.loads(checked.stdout)["data"]["constants"]
    assert constants["G"]["value"] == pytest.approx(3, rel=1e-2)


def test_where_a_run_begins_is_said_unless_it_was_chosen(run, folder: Path) -> None:
    result = run("simulate", "lag.py", "plan.csv", "--no-report")
    assert "the run begins at the initial state of the model, x = 0.5 K" in plain(result.stderr)
    assert "--initial x=VALUE" in plain(result.stderr) and "--settled" in plain(result.stderr)
    for chosen in (["--settled"], ["--initial", "x=1"]):
        assert "the run begins" not in plain(run("simulate", "lag.py", "plan.csv", *chosen, "--no-report").stderr)


def test_a_fit_whose_model_is_in_no_project_says_what_to_type(run, folder: Path) -> None:
    values = json.loads((folder / "f/fit.json").read_text())["parameters"]
    result = run("simulate", "f", "plan.csv")
    assert result.exit_code == 2
    typed = plain(result.stderr).partition("these values: ")[2].split()
    assert typed[:3] == ["greybox", "simulate", "lag.py"]
    typed_values = {word.partition("=")[0]: float(word.partition("=")[2]) for word in typed if "=" in word}
    assert typed_values == pytest.approx({name: estimate["value"] for name, estimate in values.items()}, rel=1e-8)
    assert run("simulate", "lag.py", "plan.csv", *typed[3:], "--no-report").exit_code == 0
