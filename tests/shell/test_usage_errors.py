"""What was typed wrongly, or asks for more than the records hold, is told in one line: subject, value, rule, remedy, nearest name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click.testing
import numpy as np
import pytest
from click.testing import Result

from greybox import FitOptions, compare, fit, linearise
from greybox.base.errors import DataError
from greybox.data.signals import multisine
from greybox.estimation.linear.exported_model import ExportFinding
from greybox.estimation.score import score
from greybox.shell.commands import app
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from tests.oracles.independent import linear_record
from tests.support.command import CliRunner

Run = Callable[..., Result]
RIG = micro_actuator.fix("M", "Ra")
NOISE = {"x": 2e-7, "i": 5e-3}


def driven(seed=0):
    """300 rows at 4 kHz, held random levels, discretised by scipy, with noise."""
    levels = np.random.default_rng(seed).choice([-2.0, 2.0], 75)
    return linear_record(micro_actuator, np.repeat(levels, 4), 2.5e-4, noise=NOISE, seed=seed)


@pytest.fixture(scope="module")
def fitted():
    return fit(RIG, driven(), noise=NOISE)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    write_csv(driven(), micro_actuator, tmp_path / "data.csv")
    return tmp_path / "data.csv"


SHOW = "greybox fit --help"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("chek", "chek: there is no such command; did you mean 'check'?"),
        ("--versoin", "--versoin: greybox has no such option; did you mean --version? Or see greybox --help"),
        (
            "fit rig d.csv --nosie x=1",
            "--nosie: greybox fit has no such option; did you mean --noise or --tie or --profile?",
        ),
        (
            "fit rig d.csv --method rk5",
            "--method rk5: there is no such choice; did you mean 'rk4'? (known: automatic, exact, rk4, mixed",
        ),
        (
            "export f.json --to contrl",
            "--to contrl: there is no such choice; did you mean 'control'? (known: c, casadi",
        ),
        ("fit rig d.csv --starts 0", f"--starts 0: give 1 or more; see {SHOW}"),
        ("fit rig d.csv --skip=-1", f"--skip -1: give 0 or more; see {SHOW}"),
        ("fit rig d.csv --skip ten", f"--skip ten: write a whole number; see {SHOW}"),
        ("fit rig d.csv --arc-length 1s", f"--arc-length 1s: write a number without a unit; see {SHOW}"),
        ("fit rig d.csv --hold", f"--hold: a value must follow; see {SHOW}"),
        ("fit rig", f"greybox fit: DATA is missing; write greybox fit MODEL DATA; see {SHOW}"),
        ("export", "greybox export: FIT.json is missing; write greybox export FIT.json"),
        ("export f.json", "--to is missing: Linear (control: Python file"),
        ("discover rig d.csv", "--validate FILE is missing: A validation record, which is not fitted"),
        ("init a b", "greybox init: got unexpected extra argument"),
        ("fit data.csv", "data.csv: a record, not a model; MODEL comes first: write greybox fit MODEL DATA"),
        (
            "models data.csv",
            "data.csv: a record, not a model file; MODEL comes first, as in MODEL data.csv (known models: cascaded_tanks",
        ),
        ("simulate ./data.mat --step 1", "./data.mat: a record, not a model file; MODEL comes first"),
        (
            "fit micro_actuator data.csv --schedule K=u@q",
            "--schedule K=u@q: 'q' is not a number; write it without a unit, as in",
        ),
        (
            "fit micro_actuator data.csv --schedule K=u",
            "--schedule K=u: u is an input; give the value at which K is valid, as in",
        ),
        (
            "fit micro_actuator data.csv --tie Kv=",
            "--tie Kv=: nothing stands after the '='; write --tie NAME=FORMULA without",
        ),
        (
            "fit micro_actuator data.csv --fix M=10g",
            "--fix M=10g: M is in kg in the model; write the number in it alone, --fix M=0.01",
        ),
        (
            "check micro_actuator --start K=5N/mm",
            "--start K=5N/mm: K is in N/m in the model; write the number in it alone, --start K=5000",
        ),
        (
            "simulate micro_actuator --step 1 --initial x=2.5e-1mm",
            "--initial x=2.5e-1mm: x is in m in the model; write the number in it alone, --initial x=0.00025",
        ),
        (
            "fit micro_actuator data.csv --noise x=0.2um",
            "--noise x=0.2um: x is in m in the model; write the number in it alone, --noise x=2e-07",
        ),
        (
            "fit micro_actuator data.csv --fix M=10V",
            "--fix M=10V: M is in kg in the model; write the number alone, in that unit (",
        ),
        (
            "fit micro_actuator data.csv --fix Q=10V",
            "--fix Q=10V: write the number alone, in the unit that Q has in the model",
        ),
        ("fit micro_actuator data.csv --prior K=5+-q", "--prior K=5+-q: 'q' is not a number"),
        (
            "fit micro_actuator data.csv --predict 100000",
            "--predict 100000: the longest record has 300 rows, and the first 100000 of each",
        ),
        ("compare micro_actuator data.csv --predict 300", "--predict 300: the longest record has 300 rows"),
        (
            "fit micro_actuator data.csv --arc-length 1",
            "arcs of 1 s: the longest record lasts 0.07475 s, so no record would be divided",
        ),
        (
            "simulate micro_actuator --multisine 2 --band 5:4000 --duration 0.1 --sampling-time 2.5e-4",
            "a multisine up to 4000 Hz: samples every 0.00025 s show only frequencies below 2000 Hz; end it lower, or sample faster",
        ),
    ],
)
def test_a_mistake_is_told_in_one_line(run: Run, data: Path, tmp_path: Path, words: str, message: str) -> None:
    result = run(*words.split())
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: {message}")
    assert result.stderr.count("\n") == 1 and result.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["data.csv"]


def test_a_long_message_is_wrapped_at_80_columns_where_there_is_no_terminal(data: Path) -> None:
    words = "simulate micro_actuator --multisine 2 --band 5:4000 --duration 0.1 --sampling-time 2.5e-4"
    lines = click.testing.CliRunner().invoke(app, words.split()).stderr.splitlines()
    assert len(lines) > 1 and lines[0].startswith("error: ")
    assert all(line.startswith("  ") for line in lines[1:]) and max(map(len, lines)) <= 80


def test_without_a_word_the_command_shows_its_help(run: Run) -> None:
    assert "Commands:" in run().output


def test_a_band_may_end_at_half_the_sampling_frequency() -> None:
    time = 2.5e-4 * np.arange(400)
    u = multisine(time, 5, 2000, 2.0, np.random.default_rng(0))
    assert np.sqrt(np.mean(u**2)) == pytest.approx(2.0)
    with pytest.raises(DataError, match="a multisine up to 2001 Hz"):
        multisine(time, 5, 2001, 2.0, np.random.default_rng(0))


def test_predictions_beyond_every_record_are_refused(fitted) -> None:
    with pytest.raises(DataError, match="steps ahead: 300, but the longest record has 300 rows"):
        score(fitted, steps=[1, 300])
    with pytest.raises(DataError, match="steps ahead: 5000, but the longest record has 300 rows"):
        compare([fitted], driven(1), steps=[5000])
    assert np.isfinite(score(fitted, steps=[200]).outputs["x"].ahead[200])


def test_arcs_that_leave_the_record_whole_are_called_so() -> None:
    result = fit(RIG, driven(), noise=NOISE, options=FitOptions(arc_length=0.06))
    assert "arcs of 0.06 s; no record is divided" in str(result.solver.strategy)


def test_an_operating_point_far_outside_the_records_is_named_with_their_range(fitted) -> None:
    (finding,) = linearise(fitted, {"u": 1e9}).findings
    assert finding.code == ExportFinding.OUTSIDE_RECORDS
    for inside in (linearise(fitted, {"u": 1.5}), linearise(fitted), linearise(RIG, {"u": 1e9})):
        assert inside.findings == ()


def test_completion_is_silent_about_an_unknown_command() -> None:
    words = {"_GREYBOX_COMPLETE": "bash_complete", "COMP_WORDS": "greybox chek ", "COMP_CWORD": "2"}
    result = CliRunner().invoke(app, [], env=words, prog_name="greybox")
    assert "no such command" not in result.output
