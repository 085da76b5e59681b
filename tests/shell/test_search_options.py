"""`greybox fit` with a transcription, arcs and many starts."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from greybox.estimation.findings import EstimationCode
from greybox.estimation.transcription.problem import TranscriptionReason
from greybox.simulation.simulate import simulate, write_csv
from models.micro_actuator import micro_actuator
from tests.oracles.independent import multisine

Run = Callable[..., Result]
KNOWN = ["--fix", "M=0.01", "--fix", "Ra=8", "--noise", "x=2e-7", "--noise", "i=5e-3", "--at-rest"]
# Arcs begin anywhere, and not at rest.
MOVING = [option for option in KNOWN if option != "--at-rest"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(1)
    inputs = {"time": 2.5e-4 * np.arange(800), "u": multisine(rng, 800, 2.5e-4, 5, 800, 2.0)}
    record = simulate(micro_actuator, inputs).record({"x": 2e-7, "i": 5e-3}, rng)
    write_csv(record, micro_actuator, folder / "train.csv")
    again = simulate(micro_actuator, inputs).record({"x": 2e-7, "i": 5e-3}, rng)
    write_csv(again, micro_actuator, folder / "again.csv")
    return folder / "train.csv"


@pytest.mark.slow
def test_many_starts_print_and_save_where_each_ended(run: Run, data: Path, tmp_path: Path) -> None:
    result = run("fit", "micro_actuator", data, *KNOWN, "--starts", 4, "--seed", 3, "--output", "out", "--no-report")
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "out" / "fit.json").read_text())
    (starts,) = (finding for finding in saved["findings"] if finding["code"] == EstimationCode.STARTS)
    assert sum(starts["values"]["counts"]) + starts["values"]["without_result"] == 4
    assert starts["values"]["ratios"][0] == pytest.approx(1.0, abs=0.1)
    assert len(saved["ends"]) == 4
    ratios = [end["noise_ratio"] for end in saved["ends"]]
    assert ratios == sorted(ratios)
    assert set(saved["ends"][0]["start"]) == set(saved["ends"][0]["values"]) == {"B", "K", "Kf", "Kv", "La"}
    words = ["--starts", 4, "--seed", 3, "--workers", 1, "--no-report", "-q", "--output", "again"]
    again = run("fit", "micro_actuator", data, *KNOWN, *words)
    repeated = json.loads((tmp_path / "again" / "fit.json").read_text())
    assert [end["values"] for end in repeated["ends"]] == [end["values"] for end in saved["ends"]]
    assert again.exit_code == 0


@pytest.mark.parametrize(
    ("options", "transcription", "values"),
    [
        (["--transcription", "multiple"], "multiple", {"segments": 40, "reason": ""}),
        (["--arc-length", "0.05"], "arcs", {"arcs": 4, "arc_length": 0.05, "reason": ""}),
        ([], "single", {"reason": TranscriptionReason.STABLE}),
    ],
)
def test_the_transcription_stands_in_the_result_with_its_reason(
    run: Run, data: Path, tmp_path: Path, options: list[str], transcription: str, values: dict[str, object]
) -> None:
    result = run("fit", "micro_actuator", data, *MOVING, *options, "--output", "out")
    assert result.exit_code == 0, result.output
    search = json.loads((tmp_path / "out" / "fit.json").read_text())["search"]
    assert search["subject"] == transcription and search["values"].items() >= values.items()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--seed", "3"], "--seed 3 has no effect: there are no random starts; give --starts N too"),
        (["--transcription", "arcs"], "transcription 'arcs' needs their length"),
        (["--transcription", "single", "--arc-length", "1"], "transcription 'single' has no arcs"),
        (["--arc-length", "1e-4"], "give at least 0.00075 s"),
        (["--transcription", "lifted"], "--transcription lifted: there is no such choice"),
        (["--starts", "0"], "--starts 0: give 1 or more"),
    ],
)
def test_bad_choices_end_with_2_and_nothing_is_written(
    run: Run, data: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    result = run("fit", "micro_actuator", data, *MOVING, *options, "--output", "out")
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_discovery_keeps_ties_and_counts_priors(run: Run, data: Path, tmp_path: Path) -> None:
    options = [*KNOWN, "--tie", "Kv=Kf", "--prior", "B=20+-1e-5", "--effects", "input_offset", "--no-report"]
    # A model that misses by far is searched for long: short records will do.
    for name in ("train", "again"):
        lines = (data.parent / f"{name}.csv").read_text().splitlines(keepends=True)
        (tmp_path / f"{name}.csv").write_text("".join(lines[:151]))
    result = run("discover", "micro_actuator", "train.csv", "--validate", "again.csv", *options, "--output", "out")
    assert result.exit_code == 0, result.output
    parameters = json.loads((tmp_path / "out" / "discovery.json").read_text())["parameters"]
    assert "Kv" not in parameters and "Kf" in parameters
    assert parameters["B"]["value"] == pytest.approx(20, abs=0.1)  # far off: the prior counts
