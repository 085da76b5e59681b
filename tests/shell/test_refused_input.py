"""Options that would change nothing, numbers that are none, and words that were left empty are refused before anything is written."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from greybox import FitOptions, fit, simulate
from greybox.shell.commands import app
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner

NOISE = {"x": 2e-7, "i": 5e-3}
SIGNAL = "simulate micro_actuator --step 1 --duration 0.1 --sampling-time 1e-3"
QUESTION = "micro_actuator --limit u=-1:1 --duration 0.1 --sampling-time 2.5e-4 --noise x=1e-7"


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a record, a copy of it, another record, a fit, and a folder with a model file."""
    folder = tmp_path_factory.mktemp("prepared")
    data = {"time": 2.5e-4 * np.arange(200), "u": np.random.default_rng(1).normal(0, 1, 200)}
    for seed, name in enumerate(("a.csv", "b.csv")):
        record = simulate(micro_actuator, data).record(NOISE, np.random.default_rng(seed))
        write_csv(record, micro_actuator, folder / name)
    (folder / "copy.csv").write_bytes((folder / "a.csv").read_bytes())
    (folder / "rigs").mkdir()
    (folder / "rigs" / "mine.py").write_text("", encoding="utf-8")
    plain = micro_actuator.fix("M", "Ra")
    fit(plain, record, noise=NOISE, options=FitOptions(at_rest=True)).save(folder / "fit.json")
    return folder


REFUSED = [
    # a number that is none, a word that is empty
    (f"{SIGNAL} --offset nan", "--offset nan: give a finite number"),
    ("simulate micro_actuator --step 1 --duration inf --sampling-time 1e-3", "--duration inf: give a finite number"),
    ("simulate micro_actuator --step 1 --duration 1 --sampling-time nan", "--sampling-time nan: give a finite number"),
    ("changed fit.json a.csv --sampling-time nan", "--sampling-time nan: give a finite number"),
    (f"campaign {QUESTION} --width inf", "--width inf: give a finite number"),
    ("init ''", "an empty word stands after greybox init; give a value, or leave it out"),
    ("fit micro_actuator a.csv --output ''", "an empty word stands after --output"),
    ("fit micro_actuator a.csv --sampling-time 0", "--sampling-time 0: give a number above 0"),
    ("fit micro_actuator a.csv --read-limit 0", "--read-limit 0: give a number above 0"),
    ("simulate micro_actuator --multisine -1 --band 5:60 --duration 1 --sampling-time 1e-3", "an RMS value of -1"),
    # options without an effect
    (
        f"{SIGNAL} --seed 3",
        "--seed 3 has no effect: nothing here is random; give --noise OUTPUT=STD or --multisine RMS too",
    ),
    (
        "effects --effect coulomb_friction",
        "--effect coulomb_friction has no effect: there is no model to add it to; give MODEL too",
    ),
    ("effects keep soft_stop --json", "--json: no effect with keep"),
    ("effects micro_actuator soft_stop", "soft_stop: no effect without keep"),
    ("check a.csv --fix M=1 --noise x=1", "--fix, --noise: no effect on a look at a file; leave them out"),
    ("check a.csv --output here", "--output: no effect on a look at a file, which writes nothing"),
    ("check micro_actuator --column x=y", "--column: no effect on a check without records; leave it out"),
    ("fit micro_actuator a.csv --quiet-output --json", "--quiet-output and --json exclude each other"),
    (
        "fit micro_actuator a.csv --write-study s.toml --json",
        "--json: no effect with --write-study, which runs nothing",
    ),
    ("compare micro_actuator a.csv --quiet-output --json", "--quiet-output and --json exclude each other"),
    (
        "changed fit.json a.csv --validate b.csv --no-effects",
        "--validate: no effect here, where no effect is looked for",
    ),
    ("changed fit.json a.csv --validate b.csv --skip 199", "--skip 199: the shortest validation record has 200 rows"),
    (f"design {QUESTION} --goal detection --constant K", "--constant: no effect with --goal detection"),
    (f"design {QUESTION} --goal detection --criterion A", "--criterion: no effect with --goal detection"),
    (f"design {QUESTION} --fix M=0.01 --start M=0.02", "M: --fix and --start contradict each other"),
    # what would count twice
    ("fit micro_actuator a.csv a.csv", "a.csv: given twice; its data would count twice"),
    ("fit micro_actuator a.csv copy.csv", "copy.csv: the same data as a.csv; its data would count twice"),
    ("app micro_actuator a.csv copy.csv --no-browser", "copy.csv: the same data as a.csv; its data would count twice"),
    (
        "fit micro_actuator a.csv --effect nope",
        "did you mean 'end_stop' or 'end_stops' or 'input_offset'? (71 are known)",
    ),
    ("changed fit.json a.csv copy.csv", "copy.csv: the same data as a.csv; its data would count twice"),
    ("changed fit.json a.csv --population", "1 machine: a population needs"),
    # a rig program that could not be run, an effect without a place
    (f"campaign {QUESTION} --rig /none/program", "rig '/none/program': no such program"),
    (f'campaign {QUESTION} --rig "ls {{input}}"', "rig 'ls': {input} is put in and {record} is not; give both"),
    (
        f'campaign {QUESTION} --rig "ls {{input}} {{output}}"',
        "rig 'ls': nothing is put in for {output}; known: {input}",
    ),
    (f"campaign {QUESTION} --effect chamber_leakage", "effect 'chamber_leakage' acts at 'pressure_a'"),
    # the wrong thing in a place
    (f"{SIGNAL} --output run.mat", "--output run.mat: the record is written as CSV; give a file that ends in .csv"),
    (f"{SIGNAL} --set M", "--set M: it has no '='"),
    ("models rigs", "no model 'rigs'"),
    ("models ./rigs", "rigs: a folder, not a model file; give a file in it: mine.py"),
    ("effects keep", "effects keep: NAME is missing"),
    ("init a.csv/rig", "a.csv is a file; give a folder"),
]


@pytest.mark.parametrize(("words", "message"), REFUSED, ids=[words for words, _ in REFUSED])
def test_it_is_refused_in_one_line_and_nothing_is_written(
    prepared: Path, monkeypatch: pytest.MonkeyPatch, words: str, message: str
) -> None:
    monkeypatch.chdir(prepared)
    before = sorted(prepared.rglob("*"))
    result = run(*shlex.split(words))
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert result.stderr.count("\n") == 1 and result.stdout == ""
    assert sorted(prepared.rglob("*")) == before


@pytest.mark.rest
def test_effects_may_be_given_with_commas(prepared: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(prepared)
    together = run("effects", "micro_actuator", "--effect", "coulomb_friction,cubic_stiffness")
    apart = run("effects", "micro_actuator", "--effect", "coulomb_friction", "--effect", "cubic_stiffness")
    assert together.exit_code == 0 and together.stdout == apart.stdout
    assert together.stdout != run("effects", "micro_actuator").stdout


def run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words), prog_name="greybox")
