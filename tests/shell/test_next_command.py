"""What is proposed next carries every option that was given and that the command understands, and nothing that its arguments hold."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from greybox.base import Finding
from greybox.data.findings import RecordCode
from greybox.discovery.result import Discovery
from greybox.estimation import Fit
from greybox.shell import command_line, compare
from greybox.shell.commands import COMMANDS
from greybox.shell.discover import _next
from greybox.shell.fit import next_command
from greybox.shell.options import IN_MODEL, IN_RECORD, IN_RESULT
from greybox.shell.study import NextCommand, Study
from greybox.shell.study_file import spell_following
from greybox.shell.study_values import Switch
from greybox.show.printers.text import wrap_command

# A value of every option that belongs to a study, as it is typed.
GIVEN = {
    "columns": "w=speed",
    "headers": "time,u,w",
    "sampling_time": "0.001",
    "read_limit": "2",
    "first_time": "1.5",
    "last_time": "3",
    "hold": "first",
    "interpolation": "u=zero",
    "before": "u=2",
    "fixed": "R=1.5",
    "start": "J=0.0001",
    "free": "Kt",
    "conditions": "load=1,2",
    "noise": "w=0.1",
    "effects": "coulomb_friction",
    "ties": "B=2*J",
    "method": "rk4",
    "substeps": "3",
    "priors": "J=1+-0.1",
    "per_experiment": "B",
    "schedules": "B=load@1",
    "process_noise": "w",
    "quiet": "still.csv",
    "validation": "other.csv",
    "skip": "4",
    "beginning": "7",
    "loss": "huber:2",
    "transcription": "single",
    "arc_length": "0.5",
    "starts": "5",
    "seed": "3",
    "predict": "4",
    "profiles": "J",
    "bootstrap": "100",
    "time_limit": "60",
    "candidates": "play",
    "without": "play",
    "without_family": "play",
    "has": "gear",
    "lacks": "fluid",
    "test": "third.csv",
    "outputs": "w",
    "criterion": "D",
}


def parse(name: str, words: list[str]) -> Study:
    """The study that a command line states."""
    command = command_line.make_command(name, COMMANDS[name], COMMANDS)
    with command.make_context(name, words) as context:
        return command_line._read_study(context, name, COMMANDS[name], COMMANDS)


def give_all(name: str, *arguments: str) -> Study:
    """A study with a value for every option of a command that is part of a study."""
    words = list(arguments)
    for option in list_options(name).values():
        words.append(option.flags[0])
        if not isinstance(option.kind, Switch):
            words.append(GIVEN[option.name])
    return parse(name, words)


def list_options(command: str) -> dict[str, Any]:
    return {n: o for n, o in COMMANDS[command].table.items() if o.flags and o.place}


def check_carried(study: Study, following: NextCommand, *held: Any) -> None:
    """What ``following`` is typed as says the same of every option that both understand."""
    words = shlex.split(following.spell(COMMANDS))
    assert words[:2] == ["greybox", following.command]
    again, known = parse(following.command, words[2:]), list_options(following.command)
    both = set(list_options(study.command)) & set(known)
    carried = both - {option.name for option in held}
    assert carried, "nothing is left to carry"
    assert {n: again.values[n] for n in carried} == {n: study.values[n] for n in carried}
    assert not {n for n in both - carried if n in again.values}, "said twice: by the file and by the option"


def make_fit(**others: Any) -> Fit:
    values = {
        "success": True,
        "explains_records": False,
        "parameters": {},
        "findings": (),
        "model": SimpleNamespace(has_equations=True),
    }
    return cast("Fit", SimpleNamespace(**values | others))


def make_discovery(*effects: str) -> Discovery:
    return cast("Discovery", SimpleNamespace(effects=effects))


FILES = ("rig.py", "a.csv")


def test_discover_after_a_fit() -> None:
    study = give_all("fit", *FILES)
    following = next_command(study, make_fit(), Path("fit.json"))
    check_carried(study, following)
    assert {"--hold first", "--effect coulomb_friction"} <= set(re.findall(r"--\S+ \S+", following.spell(COMMANDS)))


def test_a_check_or_a_comparison_after_a_fit() -> None:
    study = give_all("fit", *FILES)
    check_carried(study, next_command(study, make_fit(success=False), Path("fit.json")))
    elsewhere = make_fit(explains_records=True, model=SimpleNamespace(has_equations=False))
    check_carried(study, next_command(study, elsewhere, Path("fit.json")))


def test_other_starts_after_a_fit_at_a_bound() -> None:
    study = parse("fit", [*FILES, "--loss", "huber"])
    bounded = make_fit(parameters={"J": SimpleNamespace(at_bound=True)})
    assert next_command(study, bounded, Path("f")).spell(COMMANDS) == "greybox fit rig.py a.csv --loss huber --starts 8"


def test_other_starts_after_a_bad_fit_with_an_effect_that_was_added():
    """A dead zone beside the flow of a pump has two optima; a search for a second effect began at the worse one."""
    added = parse("fit", [*FILES, "--effect", "input_dead_zone"])
    typed = next_command(added, make_fit(), Path("f")).spell(COMMANDS)
    assert typed == "greybox fit rig.py a.csv --effect input_dead_zone --starts 8"
    again = parse("fit", [*FILES, "--effect", "input_dead_zone", "--starts", "8"])
    assert next_command(again, make_fit(), Path("f")).spell(COMMANDS).startswith("greybox discover")


def test_a_robust_loss_after_a_fit_that_glitches_swamp():
    glitched = make_fit(findings=(Finding(RecordCode.SENSOR_SPIKES, subject="w"),))
    assert (
        next_command(parse("fit", [*FILES]), glitched, Path("f")).spell(COMMANDS)
        == "greybox fit rig.py a.csv --loss huber"
    )
    again = next_command(parse("fit", [*FILES, "--loss", "huber"]), glitched, Path("f")).spell(COMMANDS)
    assert again == "greybox discover rig.py a.csv --validate ANOTHER_RECORD.csv --loss huber"


@pytest.mark.parametrize("start", range(44, 72, 3))
def test_a_line_of_a_command_never_ends_inside_quotes(start):
    command = f"greybox fit {'m' * (start - 20)}.py --column 'th [turn/8192]=ENC [counts of it]' --loss huber"
    lines = wrap_command(command, 80)
    assert [word for line in lines for word in shlex.split(line.removesuffix("\\"))] == shlex.split(command)


def test_an_export_after_a_fit_says_nothing_that_its_file_holds() -> None:
    following = next_command(give_all("fit", *FILES), make_fit(explains_records=True), Path("fit.json"))
    assert following.spell(COMMANDS) == "greybox export fit.json --to control --model rig.py"


def test_a_fit_after_a_check() -> None:
    study = give_all("check", *FILES)
    check_carried(study, study.then("fit", study.model, *study.estimation))


def test_a_fit_or_a_design_after_a_discovery() -> None:
    study = give_all("discover", *FILES)
    check_carried(study, _next(study, make_discovery("play"), Path("model.py")), *IN_MODEL, Study.time_limit)
    check_carried(study, _next(study, make_discovery(), Path("model.py")), *IN_RESULT)


@pytest.mark.parametrize(
    ("given", "effects", "typed"),
    [
        # A limit on the time of a search has no effect on a fit from one start.
        (["rig.py"], ["play"], "greybox fit out/model.py a.csv --validate b.csv"),
        (
            ["rig.py", "--starts", "4"],
            ["play"],
            "greybox fit out/model.py a.csv --validate b.csv --starts 4 --time 9.0",
        ),
        # A model that only its file tells, and how its records are split.
        (["rig.py", "--split-holes"], [], "greybox design out/discovery.json a.csv --split-holes --model rig.py"),
        (["my.fmu"], [], "greybox design out/discovery.json a.csv --model my.fmu"),
        (["emps"], [], "greybox design out/discovery.json a.csv"),
        # A generator holds, or moves along straight lines; what is measured may be a mean.
        (["emps", "--hold", "first"], [], "greybox design out/discovery.json a.csv --hold first"),
        (["emps", "--hold", "mean"], [], "greybox design out/discovery.json a.csv"),
    ],
)
def test_a_search_is_followed_by_what_the_next_command_takes(given, effects, typed):
    model, *options = given
    words = [model, "a.csv", "--validate", "b.csv", "--time", "9", *options]
    study = parse("fit" if "--starts" in words else "discover", words)
    following = _next(study, make_discovery(*effects), Path("out/model.py")).spell(COMMANDS)
    assert sorted(shlex.split(following)) == sorted(shlex.split(typed))
    name, *rest = shlex.split(following)[1:]
    COMMANDS[name].check(parse(name, rest))


def test_a_search_after_a_fit_without_a_second_record_has_a_placeholder():
    following = next_command(parse("fit", [*FILES]), make_fit(), Path("f")).spell(COMMANDS)
    assert following == "greybox discover rig.py a.csv --validate ANOTHER_RECORD.csv"
    judged = next_command(parse("fit", [*FILES, "--validate", "b.csv"]), make_fit(), Path("f")).spell(COMMANDS)
    assert judged == "greybox discover rig.py a.csv --validate b.csv"


@pytest.mark.parametrize("command", ["discover", "compare"])
def test_a_list_of_effects_that_is_given_twice_holds_both(command):
    words = [*FILES, "--validate", "b.csv", "--effects", "play", "--effects", "cogging,backlash"]
    study = parse(command, words)
    assert study.candidates == ("play", "cogging", "backlash")
    assert parse("fit", [*FILES, "--columns", "time,u", "--columns", "w"]).headers == ("time", "u", "w")


def test_a_fit_after_a_simulation_moves_its_inputs_alike() -> None:
    study = parse(
        "simulate", ["rig.py", "a.csv", "--hold", "first", "--fix", "R=1", "--column", "u=U", "--noise", "w=1"]
    )
    words = study.then("fit", study.model, "b.csv", holds=IN_RECORD).spell(COMMANDS)
    assert words == "greybox fit rig.py b.csv --fix R=1.0 --hold first"


def test_every_option_of_a_fit_is_in_a_discovery_or_is_none_of_a_search() -> None:
    none_of_a_search = {"bootstrap", "per_experiment", "predict", "process_noise", "profiles", "seed", "starts"}
    assert set(list_options("fit")) - set(list_options("discover")) == none_of_a_search


@pytest.mark.parametrize(
    ("best", "typed"),
    [
        ("rig", "greybox fit rig.py a.csv --effect input_offset"),
        ("rig + cogging", "greybox fit rig.py a.csv --effect input_offset --effect cogging"),
        ("arx", "greybox discover rig.py a.csv --validate ANOTHER_RECORD.csv --effect input_offset"),
    ],
)
def test_after_a_comparison_a_fit_adds_what_was_added_and_not_what_the_model_has(monkeypatch, best, typed):
    monkeypatch.setattr("greybox.show.documents.comparison.best_model", lambda _: SimpleNamespace(name=best))
    study = parse("compare", [*FILES, "--effect", "input_offset", "--effects", "cogging"])
    added = {"rig": (), "rig + cogging": ("cogging",)}
    assert compare._next(study, cast("Any", None), added).spell(COMMANDS).startswith(typed)


@pytest.mark.parametrize(
    ("written", "there", "following", "folder"),
    [
        ("results/rig-fit/fit.json", [], "discover", ""),
        ("results/rig-fit/fit.json", ["results/rig-fit/fit.json"], "fit", "results/rig-fit-2"),
        ("results/rig-discover/discovery.json", ["results/rig-fit/fit.json"], "fit", "results/rig-fit-2"),
        (
            "results/rig-check/check.json",
            ["results/rig-fit/fit.json", "results/rig-fit-2/fit.json"],
            "fit",
            "results/rig-fit-3",
        ),
        ("results/rig-fit/fit.json", ["results/other-discover/discovery.json"], "discover", ""),
        ("mine/fit.json", ["results/rig-discover/discovery.json"], "discover", "mine-discover"),
        ("results/rig-simulated.csv", ["results/rig-fit/fit.json"], "fit", "results/rig-simulated-fit"),
        ("plan.csv", ["results/rig-fit/fit.json"], "fit", "results/plan-fit"),
        ("results/rig-fit/fit.json", ["results/rig-export/rig.h"], "export", ""),
    ],
)
def test_what_is_proposed_replaces_no_result_that_is_there(tmp_path, monkeypatch, written, there, following, folder):
    monkeypatch.chdir(tmp_path)
    for path in map(Path, there):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
    name = Path(written).parent.name.rpartition("-")[2] if "-" in written else "fit"
    command = "simulate" if written.endswith(".csv") else name if name in COMMANDS else "fit"
    study = parse(command, [*FILES, *(["--validate", "b.csv"] if command == "discover" else [])])
    typed = study.then(following, *FILES).keeping([Path(written)]).spell(COMMANDS)
    assert typed.partition(" --output ")[2] == folder
    assert following == "export" or parse(following, shlex.split(typed)[2:])


def test_what_follows_a_study_file_is_the_file_with_what_was_typed_beside_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(
        'model = "emps"\n[records]\nestimation = ["a.csv"]\n[fixed]\nM = 3.0\n[noise]\nq = 0.1\n'
    )
    study = parse("fit", ["study.toml", "--noise", "q=0.2", "--loss", "huber"])
    typed = spell_following(next_command(study, make_fit(), Path("fit.json")), COMMANDS)
    assert typed == "greybox discover study.toml --noise q=0.2 --validate ANOTHER_RECORD.csv --loss huber"
    assert parse("discover", shlex.split(typed)[2:]).values.items() >= study.but(noise={"q": 0.2}).values.items()
    # An export is of the fit, other records are not those of the file, and what a search refuses in the file is spelled out.
    explained = next_command(study, make_fit(explains_records=True), Path("fit.json"))
    assert spell_following(explained, COMMANDS) == explained.spell(COMMANDS)
    others = next_command(parse("fit", ["study.toml", "b.csv"]), make_fit(), Path("fit.json"))
    assert spell_following(others, COMMANDS).startswith("greybox discover emps b.csv --fix M=3.0")
    Path("study.toml").write_text('model = "emps"\n[records]\nestimation = ["a.csv"]\n[estimation]\npredict = [4]\n')
    refused = next_command(parse("fit", ["study.toml"]), make_fit(), Path("fit.json"))
    assert spell_following(refused, COMMANDS) == "greybox discover emps a.csv --validate ANOTHER_RECORD.csv"
    # A search after a comparison is one among all effects: the file would narrow it again.
    Path("study.toml").write_text(
        'model = "emps"\ncandidates = ["backlash"]\n[records]\nestimation = ["a.csv"]\nvalidation = ["b.csv"]\n'
    )
    compared = parse("compare", ["study.toml"])
    assert compared.candidates == ("backlash",)
    among_all = compared.but(candidates=()).then("discover", compared.model, *compared.estimation)
    assert spell_following(among_all, COMMANDS) == "greybox discover emps a.csv --validate b.csv"
