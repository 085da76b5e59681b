"""A study file: it repeats what the options compute to the last bit, and says in one line what is wrong with it."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from hypothesis import given
from hypothesis import strategies as st

from greybox.base.errors import DataError, GreyboxError
from greybox.data.signals import multisine
from greybox.shell.commands import COMMANDS
from greybox.shell.study import Study
from greybox.shell.study_file import read_study, study_commands, study_text
from greybox.shell.study_script import study_script
from greybox.simulation.simulate import simulate, write_csv
from models.micro_actuator import micro_actuator

Run = Callable[..., Result]
NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for seed, name in enumerate(("train", "second", "test")):
        time, generator = 5e-4 * np.arange(400), np.random.default_rng(seed)
        run = simulate(micro_actuator, {"time": time, "u": multisine(time, 5, 800, 2.0, generator)})
        write_csv(run.record(NOISE, generator), micro_actuator, folder / f"{name}.csv")
    return folder


def numbers(value: object) -> object:
    """A result without the time it took and the paths that were typed."""
    if isinstance(value, dict):
        return {name: numbers(item) for name, item in value.items() if name not in ("seconds", "command")}
    return [numbers(item) for item in value] if isinstance(value, list) else value


EVERYTHING = {
    "fit": (
        "fit.json",
        "micro_actuator {d}/train.csv {d}/second.csv --fix M=0.01 --fix Ra --start K=5678.9 --tie Kv=Kf --prior B=0.27+-0.013"
        " --own La --noise x=2.1e-7 --validate {d}/test.csv --skip 13 --at-rest --loss huber:1.7 --predict 3 --hold first --before u=0",
    ),
    "process noise": (
        "fit.json",
        "micro_actuator {d}/train.csv --fix M --fix Ra=8 --process-noise v --process-noise x=1e-9 --effect cubic_stiffness",
    ),
    "discover": (
        "discovery.json",
        "micro_actuator {d}/train.csv --validate {d}/test.csv --fix M=0.01 --fix Ra=8 --at-rest"
        " --effects coulomb_friction,cubic_stiffness",
    ),
    "check": ("check.json", "micro_actuator {d}/train.csv --free M --fix Ra=8.25 --method rk4 --substeps 3"),
}


@pytest.mark.rest
@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=[pytest.mark.slow] * (c in ("process noise", "discover"))) for c in EVERYTHING]
)
def test_a_study_file_repeats_the_options_to_the_last_bit(run: Run, data: Path, tmp_path: Path, case: str) -> None:
    file, line = EVERYTHING[case]
    command = case if case in COMMANDS else "fit"
    words = [command, *line.format(d=data).split()]
    written = run(*words, "--write-study", "there/study.toml")
    assert written.exit_code == 0, written.output
    assert [path.name for path in tmp_path.iterdir()] == ["there"]  # nothing was computed
    one = run(*words, "--no-report", "--output", "one")
    two = run(command, "there/study.toml", "--no-report", "--output", "two")
    assert one.exit_code == two.exit_code == 0, one.output + two.output
    first, second = (json.loads((tmp_path / folder / file).read_text()) for folder in ("one", "two"))
    assert numbers(first) == numbers(second)


def test_a_test_record_of_a_search_stands_in_its_study_and_in_the_program(run: Run, data: Path, tmp_path: Path) -> None:
    (tmp_path / "third.csv").write_text((data / "test.csv").read_text())
    line = (
        f"discover micro_actuator {data}/train.csv --validate {data}/test.csv --test third.csv --write-study study.toml"
    )
    assert run(*line.split()).exit_code == 0
    study = read_study(tmp_path / "study.toml", "discover", COMMANDS)
    assert study.test == (tmp_path / "third.csv",)
    program = study_script(study, tmp_path / "study.py", searched=study)
    assert "third.csv" in program and ", test=test" in program


def test_a_comparison_is_written_and_read_as_the_same_study(run: Run, data: Path, tmp_path: Path) -> None:
    line = f"compare micro_actuator {data}/train.csv --validate {data}/test.csv --effects cubic_stiffness,coulomb_friction+backlash"
    assert run(*line.split(), "--starts", 3, "--seed", 4, "--write-study", "study.toml").exit_code == 0
    study = read_study(tmp_path / "study.toml", "compare", COMMANDS)
    assert study.candidates == ("cubic_stiffness", "coulomb_friction+backlash")
    assert (study.starts, study.seed, study.validation) == (3, 4, (data / "test.csv",))


def test_paths_are_relative_to_the_file(run: Run, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "train.csv").write_text((data / "train.csv").read_text())
    options = ["--fix", "M", "--fix", "Ra", "--no-report"]
    arguments = ["fit", "micro_actuator", "records/train.csv", *options[:-1], "--write-study", "studies/study.toml"]
    assert run(*arguments).exit_code == 0
    assert 'estimation = ["../records/train.csv"]' in (tmp_path / "studies" / "study.toml").read_text()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert run("fit", "../studies/study.toml", "--no-report", "-q").exit_code == 0


def test_options_beside_a_study_file_take_the_place_of_what_it_says(tmp_path: Path, run: Run, data: Path) -> None:
    (tmp_path / "study.toml").write_text(
        f'model = "micro_actuator"\n[records]\nestimation = ["{data}/train.csv"]\nskip = 5\n'
        f'validation = ["{data}/test.csv"]\n[fixed]\nM = 0.01\nRa = 9\n'
    )
    result = run("fit", "study.toml", "--fix", "Ra=8", "--skip", 0, "--write-study", "new.toml")
    assert result.exit_code == 0, result.output
    study = read_study(tmp_path / "new.toml", "fit", COMMANDS)
    assert dict(study.fixed) == {"M": 0.01, "Ra": 8.0}
    assert (study.skip, study.estimation) == (0, (data / "train.csv",))


def test_a_table_of_a_command_counts_for_that_command_only(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        'model = "micro_actuator"\n[records]\nestimation = "a.csv"\n[start]\nK = 5000\n'
        '[fit.start]\nB = 0.2\n[fit.estimation]\nstarts = 4\n[discover]\nfurther = true\ncandidates = ["backlash"]\n'
    )
    fit, discover = (read_study(tmp_path / "study.toml", command, COMMANDS) for command in ("fit", "discover"))
    assert dict(fit.start) == {"K": 5000.0, "B": 0.2} and fit.starts == 4 and not fit.candidates
    assert dict(discover.start) == {"K": 5000.0} and discover.further and discover.candidates == ("backlash",)


def test_a_check_ignores_what_only_a_fit_needs_and_says_so(run: Run, data: Path, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(
        f'model = "micro_actuator"\n[records]\nestimation = ["{data}/train.csv"]\nskip = 5\n[priors]\nM = {{mean = 1, std = 1}}\n'
    )
    result = run("check", "study.toml", "--no-report")
    assert result.exit_code == 0, result.output
    assert result.stderr == "note: study.toml: a check does not use [records] skip\n"


HEAD = 'model = "micro_actuator"\n[records]\nestimation = ["a.csv"]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("model = micro", "study.toml: not TOML: Invalid value (at line 1, column 9); correct that line"),
        (HEAD + "[fixd]\nM = 1", "study.toml: fixd: no such table; did you mean 'fixed'? ("),
        ("modle = 'a'", "study.toml: modle: no such key; did you mean 'model'? ("),
        (HEAD + "at_rset = true", "study.toml, [records] at_rset: no such key; did you mean 'at_rest'?"),
        (HEAD + "[fit]\nprofle = ['K']", "study.toml, [fit]: profle: no such key; did you mean 'profile'? (known"),
        (
            HEAD + "[fixed]\nM = 'ten'",
            "study.toml, [fixed], M: 'ten' must be a number in the unit of the model, or 'as declared'",
        ),
        (HEAD + "[start]\nM = true", "study.toml, [start], M: True must be a number"),
        (HEAD + "[noise]\nx = nan", "study.toml, [noise], x: nan must be finite"),
        (HEAD + "[noise]\nx = 1" + "0" * 400, "[noise], x: 1000000000000000000000000000000000"),
        (HEAD + "skip = -1", "study.toml, [records] skip: -1: give 0 or more"),
        (HEAD + "skip = 1.5", "study.toml, [records] skip: 1.5 must be a whole number"),
        (
            HEAD + "hold = 'second'",
            "study.toml, [records] hold: there is no choice 'second'; known: auto, zero, first, band-limited, mean",
        ),
        (HEAD + "at_rest = 1", "study.toml, [records] at_rest: 1 must be true or false"),
        (HEAD + "quiet = [1]", "study.toml, [records] quiet: 1 must be a text in quotes"),
        (HEAD + "quiet = {a = 1}", "study.toml, [records] quiet: a table must be a list"),
        (HEAD + 'columns = {x = "y"}', "[records] columns: a table must be a list of all columns in their order"),
        (HEAD + "[priors]\nM = 0.01", "study.toml, [priors], M: 0.01: write it as M = { mean = 0.0100, std = 0.0001 }"),
        (HEAD + "[schedule]\nK2 = {at = 1}", "study.toml, [schedule], K2: a table: write it as K2 = { by = "),
        ("fixed = 3\n" + HEAD, "study.toml, [fixed]: 3 must be a table of NAME = VALUE"),
        ("records = 3", "study.toml, records: must be a table, as in [records]"),
        ("fit = 3\n" + HEAD, "study.toml: fit: must be a table, as in [fit]"),
        (HEAD + "[fixed]\nM = 1\n[fixed]\nRa = 1", "not TOML: Cannot declare ('fixed',) twice"),
        (
            HEAD + "skip = 3\n[fit.records]\nskip = 4",
            "study.toml, [fit.records] skip: given twice, for all commands and for fit",
        ),
        (
            "further = true\n" + HEAD,
            "greybox fit does not use it, discover does; leave it out, or move it to the table [discover]",
        ),
        (
            HEAD + "[discover.process_noise]\nv = 0.1",
            "[discover.process_noise]: greybox discover does not use it, fit, compare and check do",
        ),
        ("[records]\nestimation = ['a.csv']", 'study.toml: model is missing; name one, as in model = "micro_actuator"'),
        ('model = "micro_actuator"', "study.toml: [records] estimation is missing; name records"),
        (HEAD, "a.csv: file not found"),
        (
            HEAD + "[fixed]\nM = 0.01\n[start]\nM = 0.02",
            "M: study.toml, [fixed] and study.toml, [start] contradict each other",
        ),
        (HEAD + "\x00", "not TOML"),
    ],
)
def test_a_mistake_in_a_study_file_is_one_line_with_its_place(
    run: Run, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "study.toml").write_text(text)
    result = run("fit", "study.toml")
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    assert message in result.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


def test_a_file_that_is_no_text_too_long_or_not_there_is_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_bytes(b"\xff\xfe\x00")
    assert "not a text in UTF-8" in run("fit", "study.toml").stderr
    (tmp_path / "long.toml").write_text("#" * 1_000_001)
    assert "too long for a study file" in run("fit", "long.toml").stderr
    assert "stduy.toml: file not found; did you mean 'study.toml'" in run("fit", "stduy.toml").stderr
    assert "deep.toml: " in _deep(run, tmp_path)


def _deep(run: Run, folder: Path) -> str:
    (folder / "deep.toml").write_text("model = " + "[" * 5000 + "]" * 5000)
    result = run("fit", "deep.toml")
    assert result.exit_code == 2
    return result.stderr


def test_reading_a_study_file_runs_no_code(tmp_path: Path) -> None:
    (tmp_path / "rig.py").write_text("raise RuntimeError('the model ran')")
    (tmp_path / "study.toml").write_text('model = "rig.py"\n[records]\nestimation = ["a.csv"]\n')
    study = read_study(tmp_path / "study.toml", "fit", COMMANDS)
    assert study.model == str(tmp_path / "rig.py")


COMMAND_LINES = {
    "fit": "micro_actuator {d}/train.csv --start K=5000",
    "check": "micro_actuator {d}/train.csv --start K=5000",
    "discover": "micro_actuator {d}/train.csv --validate {d}/test.csv --effects none --start K=5000",
    "compare": "micro_actuator {d}/train.csv --validate {d}/test.csv --start K=5000",
    "fleet": "micro_actuator {d}/train.csv {d}/second.csv",
    "simulate": "micro_actuator --step 1 --duration 0.1 --sampling-time 0.01",
    "design": "micro_actuator --limit u=-1:1 --duration 0.1 --sampling-time 0.01",
    "campaign": "micro_actuator --limit u=-1:1 --duration 0.1 --sampling-time 0.01 --noise x=1e-6",
}
# What a model states -> how it stood there when the study was written.
WRITTEN = {
    "equations": ("- K x", "- 2 K x"),
    "a unit": ("Ra [ohm]", "Ra [kohm]"),
    "bounds": ("K [N/m] within 10", "K [N/m] within 11"),
    "a constant": ("M = 0.01 kg", "M = 0.02 kg"),
    "a digit": ("position: the numbers 1", "position: the numbers 1.0000001"),
}


@pytest.mark.parametrize("command", COMMAND_LINES)
def test_a_study_of_a_model_that_was_edited_since_is_refused(
    run: Run, data: Path, tmp_path: Path, command: str
) -> None:
    study = tmp_path / "study.toml"
    written = run(command, *COMMAND_LINES[command].format(d=data).split(), "--write-study", "study.toml")
    assert written.exit_code == 0, written.output
    # Constants that the study gives itself are no matter of the model.
    assert ("K = 5895.5 N/m" in study.read_text()) == ("--start" not in COMMAND_LINES[command])
    present, stored = WRITTEN["equations"]
    study.write_text(study.read_text().replace(present, stored))
    refused = run(command, "study.toml", *(["--rig", "true"] if command == "campaign" else []))
    assert refused.exit_code == 2
    assert f"- B v {stored}" in refused.output
    assert f"- B v {present}" in refused.output
    assert "--model micro_actuator" in refused.output


@pytest.mark.parametrize("what", WRITTEN)
def test_a_study_is_held_against_all_that_its_model_states(run: Run, data: Path, tmp_path: Path, what: str) -> None:
    study, (present, stored) = tmp_path / "study.toml", WRITTEN[what]
    assert run("check", "micro_actuator", data / "train.csv", "--write-study", study).exit_code == 0
    assert run("check", study).exit_code == 0
    text = study.read_text()
    assert present in text
    study.write_text(text.replace(present, stored))
    refused, insisted = run("check", study), run("check", study, "--model", "micro_actuator")
    assert refused.exit_code == 2 and stored in refused.output and present in refused.output
    assert insisted.exit_code == 0 and stored in insisted.output
    # A constant that is given beside the file is none of the model's any more; the file that follows keeps what it stated.
    assert run("check", study, "--fix", "M=0.01").exit_code == (0 if what == "a constant" else 2)
    assert run("check", study, "--write-study", tmp_path / "again.toml").exit_code == 0
    assert stored in (tmp_path / "again.toml").read_text()


PROGRAM = """from greybox import Balance, Input, Model, Output, Parameter, State
rig = Model("rig", states=[State("x", "m")], inputs=[Input("u", "V")], outputs=[Output("x", "m")],
    parameters=[Parameter("K", "1/s", 1.0), Parameter("b", "m/(s*V)", 1.0)],
    balances=lambda x, u, p: [Balance("rate", "m/s", 1, "x", drive=p.b * u.u, back={})])
"""


@pytest.mark.rest
def test_a_study_runs_the_model_file_that_was_named_when_it_was_written(run: Run, data: Path, tmp_path: Path) -> None:
    written = PROGRAM.format("-p.K * x.x")
    for place in ("rig.py", "sub/rig.py:rig", "other.py:rig"):
        file = tmp_path / place.partition(":")[0]
        file.parent.mkdir(exist_ok=True)
        file.write_text(written)
        study = tmp_path / f"{file.stem}-{file.parent.name}.toml"
        assert run("check", place, data / "train.csv", "--write-study", study).exit_code == 0
        assert run("check", study).exit_code == 0
        # In another place it is somebody's study.
        copy = tmp_path / "copy" / study.name
        copy.parent.mkdir(exist_ok=True)
        copy.write_text(study.read_text())
        (copy.parent / file.relative_to(tmp_path)).parent.mkdir(exist_ok=True)
        (copy.parent / file.relative_to(tmp_path)).write_text(written)
        assert run("check", copy).exit_code == 2
        # A program that was edited is another one, and so is what it states once it has been named.
        file.write_text(PROGRAM.format("-2 * p.K * x.x"))
        edited = run("check", study)
        assert edited.exit_code == 2 and "a study alone runs none" in edited.stderr
        assert run("check", place, data / "train.csv", "--write-study", study.with_suffix(".new.toml")).exit_code == 0
        refused, insisted = run("check", study), run("check", study, "--model", place)
        assert refused.exit_code == 2 and "- 2 K x" in refused.stderr and "- K x" in refused.stderr
        assert insisted.exit_code == 0 and "- 2 K x" in insisted.output


def test_a_program_refuses_a_model_that_was_edited_since(run: Run, data: Path, tmp_path: Path) -> None:
    model, program = tmp_path / "rig.py", tmp_path / "repeat.py"
    model.write_text(PROGRAM.format("-p.K * x.x"))
    assert (
        run("check", model, data / "train.csv", "--start", "K=2", "--write-study", tmp_path / "s.toml").exit_code == 0
    )
    text = study_script(read_study(tmp_path / "s.toml", "check", COMMANDS), program)
    program.write_text(text.partition("records =")[0])
    assert runpy.run_path(str(program))["model"].values == {"K": 2.0, "b": 1.0}
    model.write_text(PROGRAM.format("-2 * p.K * x.x"))
    edited = tmp_path / "edited" / model.name
    edited.parent.mkdir()
    edited.write_text(model.read_text())
    program = edited.parent / program.name
    program.write_text(text.partition("records =")[0])
    with pytest.raises(DataError, match=r"(?s)take out hold_against.*- K x.*- 2 K x"):
        runpy.run_path(str(program))


def test_a_study_file_is_never_overwritten(run: Run, tmp_path: Path, data: Path) -> None:
    arguments = ["fit", "micro_actuator", data / "train.csv", "--write-study"]
    assert run(*arguments, "study.toml").exit_code == 0
    again = run(*arguments, "study.toml")
    assert again.exit_code == 2 and "the file exists" in again.stderr
    assert "a study file ends in .toml" in run(*arguments, "study.txt").stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_a_command_has_one_place_and_one_flag(name: str) -> None:
    options = COMMANDS[name].table.values()
    places = [option.place for option in options if option.place]
    flags = [flag for option in options for flag in option.flags]
    assert len(set(places)) == len(places) and len(set(flags)) == len(flags)
    assert not {option.table for option in options} & set(study_commands(COMMANDS))


def test_every_command_that_computes_reads_a_study() -> None:
    assert set(study_commands(COMMANDS)) == {
        *("fit", "compare", "discover", "check", "simulate", "design", "campaign", "changed", "export", "fleet"),
        "robot",
    }


finite = st.floats(allow_nan=False, allow_infinity=False)
name = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(str.strip)


@given(
    fixed=st.dictionaries(name, st.none() | finite, max_size=3),
    priors=st.dictionaries(name, st.tuples(finite, finite), max_size=2),
    schedules=st.dictionaries(name, st.tuples(name, st.none() | finite), max_size=2),
    conditions=st.dictionaries(name, st.none() | st.lists(finite, min_size=1).map(tuple), max_size=2),
    ties=st.dictionaries(name, name, max_size=2),
    effects=st.lists(name, max_size=2).map(tuple),
    predict=st.lists(st.integers(0, 10**6), max_size=2).map(tuple),
    arc_length=st.floats(0, allow_nan=False, allow_infinity=False),
)
def test_any_study_is_read_as_it_was_written(tmp_path_factory: pytest.TempPathFactory, **values: object) -> None:
    path = tmp_path_factory.mktemp("study") / "study.toml"
    study = Study(model="rig", estimation=(Path("/a b/ü.csv"),), **values)  # type: ignore[arg-type]
    path.write_text(study_text(study, path, "fit", COMMANDS), encoding="utf-8", newline="")
    assert read_study(path, "fit", COMMANDS).but(file=None, from_file=()) == study


def test_a_study_refuses_what_it_cannot_say(tmp_path: Path) -> None:
    with pytest.raises(GreyboxError, match="file not found"):
        read_study(tmp_path / "none.toml", "fit", COMMANDS)
