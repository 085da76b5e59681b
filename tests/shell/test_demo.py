"""The demonstration keeps its promise: what the rig hides is found and named, and the constants come back."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import numpy as np
import pytest

from greybox import read_csv, report
from greybox.estimation.findings import EstimationCode
from greybox.shell.demonstration import EXTENDED, HIDDEN, KNOWN, NOISE, PLAIN, STRENGTH, Demo, run_demo
from greybox.show import text
from models.micro_actuator import micro_actuator
from tests.support.findings import codes

# One demonstration for all of them, which takes seconds.
pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def announced() -> list[str]:
    return []


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, announced: list[str]) -> Demo:
    return run_demo(tmp_path_factory.mktemp("demo"), say=announced.append, pictures=True)


def test_the_model_alone_misses_the_record_by_far(result: Demo) -> None:
    assert HIDDEN not in {e.name for e in result.plain.model.effects}
    assert result.plain.misfit["x"].noise_ratio > 50
    assert codes(result.plain.findings) & {EstimationCode.MISFIT_ABOVE_NOISE, EstimationCode.MODEL_DOES_NOT_FOLLOW}


def test_the_hidden_effect_is_named_and_closes_the_gap(result: Demo) -> None:
    assert result.discovery.verdict == "named"
    (effect,) = result.discovery.effects
    assert (effect["name"], effect["site"]) == (HIDDEN, "force")
    assert effect["parameters"]["K3"]["value"] == pytest.approx(STRENGTH["K3"], rel=0.01)
    assert result.discovery.holdout["x"].before > 50 * NOISE["x"]
    assert result.discovery.holdout["x"].after == pytest.approx(NOISE["x"], rel=0.08)


def test_the_constants_come_back_from_a_start_forty_percent_off(result: Demo) -> None:
    truth = {n: v for n, v in micro_actuator.values.items() if n not in KNOWN} | dict(STRENGTH)
    assert result.truth == truth
    for name, value in truth.items():
        if name in result.start:
            assert abs(result.start[name] / value - 1) == pytest.approx(0.4)
        assert abs(result.fit.parameters[name].value / value - 1) < 0.02
        assert abs(result.deviations[name]) < 3.5
    assert max(abs(d) for d in result.deviations.values()) > 0.05  # an error of nothing would be no measurement


def test_black_boxes_stand_beside_it(result: Demo) -> None:
    rmse = {e.name: e.validation["x"].rmse for e in result.comparison.entries}
    assert set(rmse) == {PLAIN, EXTENDED, "arx", "output error"}
    assert min(rmse, key=rmse.__getitem__) == EXTENDED
    assert rmse["arx"] > 10 * rmse[EXTENDED] and rmse["output error"] > 10 * rmse[EXTENDED]


def test_the_state_space_is_that_of_the_rig_about_rest(result: Demo) -> None:
    q = micro_actuator.values  # at x = 0 the hidden spring has no slope: the matrices are those of eq. 16.1
    stiffness, coil = q["K"] / q["M"], q["Kf"] / q["M"]
    truth = np.array(
        [
            [0.0, 1.0, 0.0],
            [-stiffness, -q["B"] / q["M"], coil],
            [0.0, -q["Kv"] / q["La"], -q["Ra"] / q["La"]],
        ]
    )
    np.testing.assert_allclose(result.plant.A, truth, rtol=0.02)
    (file,) = (path for path in result.files if path.suffix == ".py")
    np.testing.assert_array_equal(runpy.run_path(str(file))["plant"].A, result.plant.A)


def test_the_records_are_there_to_repeat_it(result: Demo) -> None:
    train, test = (read_csv(path, micro_actuator) for path in result.records)
    assert (train.rows, test.rows) == (800, 400)
    assert train.fingerprint == result.plain.traces[0].fingerprint
    names = {path.name: path for path in result.files}
    assert json.loads(names["discovery.json"].read_text())["verdict"] == "named"
    for name in ("gap.png", "fit-multisine.png", "validation-sweep.png"):
        assert names[name].read_bytes().startswith(b"\x89PNG")
        assert 20_000 < names[name].stat().st_size < 600_000


def test_the_story_is_told_in_order(result: Demo, announced: list[str]) -> None:
    steps = [line.split(":")[0] for line in announced if line[:1].isdigit()]
    assert [step[0] for step in steps] == ["1", "2", "3", "4"]
    short, whole = text(result), text(result, details=True)
    # With what is typed next and the files (three lines and an empty one) no more than 25 lines.
    assert len(short.splitlines()) + len(announced) <= 21 and short.startswith(f"The plain model lacks {HIDDEN}")
    order = [HIDDEN, "parameter", "black box", "rms error on the validation record", "A ="]
    places = [whole.index(words) for words in order]
    assert places == sorted(places)


def test_the_command_leaves_out_the_page_if_told(run, result: Demo, monkeypatch: pytest.MonkeyPatch) -> None:
    contradiction = run("demo", "--open", "--no-report")
    assert contradiction.exit_code == 2 and "--open and --no-report exclude each other" in contradiction.stderr
    monkeypatch.setattr("greybox.shell.demonstration.run_demo", lambda *_, **__: result)
    printed = run("demo", "--no-report", "--output", "there")
    assert printed.exit_code == 0 and "report.html" not in printed.stdout
    assert (
        printed.stdout.splitlines()[0].startswith("The plain model lacks")
        and len(printed.stdout.partition("files in")[0].splitlines()) <= 22
    )
    assert not Path("there", "report.html").exists()


def test_the_page_tells_the_same_story(result: Demo, tmp_path: Path) -> None:
    file = report(result, tmp_path, command="greybox demo --output here")
    # An option within a command stands in an element of its own, which no line breaks.
    text = file.read_text(encoding="utf-8").replace('<span class="whole">--output</span>', "--output")
    assert 1e6 < file.stat().st_size < 6e6
    for words in ("greybox demo --output here", "cubic_stiffness", "output error", "Parameters and true values"):
        assert words in text
