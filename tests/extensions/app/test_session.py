"""The session and what can be done to it, without a server or a page."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import threading
import tomllib
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError, GreyboxError, ModelError
from greybox.base.files import locked
from greybox.extensions.app.command import StudyOnFile
from greybox.extensions.app.jobs import JobKind, _fit
from greybox.extensions.app.session import Session, ValueRange
from greybox.extensions.app.workbench import Workbench
from greybox.model.signals import Parameter
from greybox.shell.commands import COMMANDS
from greybox.shell.inputs import build_model, constrain, fit_options, read_records
from greybox.shell.project import find_model
from greybox.shell.study import Study
from greybox.shell.study_file import read_study
from greybox.show.sentences.wording import ratio_text

NOISE = {"v": 2e-3}


@pytest.fixture
def bench(rig: Path, tmp_path: Path) -> Workbench:
    study = Study(model=str(rig / "carriage.py"), noise=NOISE, at_rest=True)
    model = constrain(build_model(study), study)
    session = Session(model, noise=NOISE, options=fit_options(study))
    bench = Workbench(session, StudyOnFile(study, model), tmp_path / "out", uploads=rig, workers=1)
    bench.load(rig / "train.csv")
    bench.load(rig / "test.csv", validates=True)
    yield bench
    bench.close()


def wait(bench: Workbench) -> None:
    job = bench.job
    if job is not None:
        job.join(120)
    assert bench.job is None


def test_what_the_rig_has_is_said_and_taken_back(bench: Workbench):
    known = {part["name"]: part["known"] for part in bench.show()["parts"]}
    assert set(known.values()) == {""}
    bench.set_part("contact", "lacks")
    bench.set_part("gear", "has")
    bench.set_part("gear", "")
    assert (bench.session.model.has, bench.session.model.lacks) == ((), ("contact",))
    assert {p["name"]: p["known"] for p in bench.show()["parts"]} == known | {"contact": "lacks"}
    bench.undo()
    assert bench.session.model.has == ("gear",)
    with pytest.raises(ModelError, match=r"no part is called 'gaer'.*gear"):
        bench.set_part("gaer", "has")


@pytest.mark.parametrize(
    ("parameter", "low", "high", "logarithmic"),
    [
        (Parameter("K", "N/m", 50.0, (1.0, 1000.0)), 5.0, 500.0, True),
        (Parameter("K", "N/m", 5.0, (1.0, 20.0)), 1.0, 20.0, True),
        (Parameter("F", "N", -2.0), -8.0, 4.0, False),
        (Parameter("F", "N", 0.0, (0.0, np.inf)), 0.0, 1.0, False),
        (Parameter("F", "N", 0.0, (-3.0, 4.0)), -3.0, 4.0, False),
    ],
)
def test_a_slider_reaches_around_the_value_and_stays_within_the_bounds(parameter, low, high, logarithmic) -> None:
    reach = ValueRange.around(parameter)
    assert (reach.low, reach.high, reach.logarithmic) == (pytest.approx(low), pytest.approx(high), logarithmic)
    assert reach.holds(parameter.value)


def test_a_look_at_other_values_is_the_library_s_own_run_and_changes_nothing(bench: Workbench) -> None:
    before = bench.session
    view = bench.show_run(0, {"B": 1.5})
    direct = gb.validate(before.model.start(B=1.5), before.estimation, noise=NOISE, options=before.options)
    assert view["misfit"]["rows"][0][0] == "v"
    assert view["misfit"]["rows"][0][-1] == f"{ratio_text(direct.misfit['v'])} x noise"
    assert bench.session is before and bench.show()["undo"] == 2
    assert json.dumps(view, allow_nan=False)


def test_a_slider_keeps_its_range_until_its_value_leaves_it(bench: Workbench) -> None:
    first = bench.session.ranges["B"]
    bench.set_values({"B": 3.0})
    assert bench.session.ranges["B"] == first
    bench.set_values({"B": 90.0})
    assert bench.session.ranges["B"].holds(90.0) and bench.session.ranges["B"] != first


def test_an_effect_goes_in_visible_and_comes_out_and_every_step_can_be_taken_back(bench: Workbench) -> None:
    bench.add_effect("coulomb_friction")
    assert bench.session.model.values["Fc"] > 0
    assert "coulomb_friction" not in [e["name"] for e in bench.show()["catalogue"]]
    bench.remove_effect("coulomb_friction")
    assert bench.session.model.title == "carriage"
    bench.undo()
    assert bench.session.model.title == "carriage + coulomb_friction"
    for _ in range(3):
        bench.undo()
    assert not bench.session.records
    with pytest.raises(GreyboxError):
        bench.undo()


def test_what_is_refused_changes_nothing(bench: Workbench, rig: Path, tmp_path: Path) -> None:
    before = bench.session
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("time [s],force [N]\n0,1\n0.1,2\n", encoding="utf-8")
    for refused in (
        lambda: bench.set_values({"B": -1.0}),
        lambda: bench.set_values({"Q": 1.0}),
        lambda: bench.set_values({"B": float("nan")}),
        lambda: bench.set_fixed("Q", True),
        lambda: bench.add_effect("frictoin"),
        lambda: bench.remove_effect("coulomb_friction"),
        lambda: bench.load(wrong),
        lambda: bench.forget(7),
        lambda: bench.show_run(-1),
    ):
        with pytest.raises((DataError, ModelError)):
            refused()
    assert bench.session is before


def test_without_records_nothing_is_computed(bench: Workbench) -> None:
    bench.forget(1)
    with pytest.raises(DataError):
        bench.start(JobKind.DISCOVER)
    bench.forget(0)
    for refused in (lambda: bench.start(JobKind.FIT), bench.export):
        with pytest.raises(DataError):
            refused()


def test_the_residual_is_located_where_the_friction_is_missing(bench: Workbench) -> None:
    location = bench.session.localise(0)
    assert location.is_missing and "balance force" in location.likeliest


@pytest.mark.rest
def test_a_fit_gives_the_rig_s_constants_and_its_exports_repeat_it(
    bench: Workbench, tmp_path: Path, monkeypatch
) -> None:
    told: list[dict] = []
    bench.listener = told.append
    bench.add_effect("coulomb_friction")
    bench.start(JobKind.FIT)
    with pytest.raises(GreyboxError):
        bench.start(JobKind.FIT)
    wait(bench)
    fit = bench.session.fit
    assert bench.session.is_fitted and fit.success
    for name, value in {"B": 1.5, "Fc": 0.5}.items():
        assert abs(fit.parameters[name].value - value) < 4 * fit.parameters[name].std
    assert {n["news"] for n in told} == {"progress", "done"}
    bench.undo()  # the start of the fit again: what repeats it
    files = {path.name for path in bench.export()}
    assert files == {"model.py", "study.toml", "repeat.py", "train.csv", "test.csv"}
    study = tomllib.loads((tmp_path / "out" / "study.toml").read_text())
    assert study["effects"] == ["coulomb_friction"] and study["records"]["estimation"] == ["records/train.csv"]
    assert study["start"]["Fc"] == bench.session.model.values["Fc"]
    subprocess.run([sys.executable, "repeat.py"], cwd=tmp_path / "out", check=True, capture_output=True)
    again = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert {n: p["value"] for n, p in again["parameters"].items()} == {n: e.value for n, e in fit.parameters.items()}


@pytest.mark.slow
def test_a_stopped_discovery_changes_nothing_and_keeps_its_refits(bench: Workbench, tmp_path: Path) -> None:
    news: list[str] = []
    journal = tmp_path / "out" / "journal.jsonl"
    journal.parent.mkdir()

    def hear(item) -> None:
        news.append(item["news"])
        if item["news"] == "refit" and item["content"] == 2:  # the first is in the journal by then
            # Whoever holds the journal holds the search, which cannot end before it is asked to.
            with open(journal, "ab") as file, locked(file):
                bench.stop()

    before, bench.listener = bench.session, hear
    bench.start(JobKind.DISCOVER)
    wait(bench)
    assert news[-1] == "stopped" and bench.session is before
    assert journal.stat().st_size > 0


def test_a_stop_asked_for_twice_ends_at_once(bench: Workbench) -> None:
    news: list[str] = []
    before, bench.listener = bench.session, lambda item: news.append(item["news"])
    bench.start(JobKind.DISCOVER)
    bench.stop()
    bench.stop()
    wait(bench)
    assert news[-1] == "stopped" and bench.session is before


def test_a_fit_that_is_stopped_keeps_its_best_point(bench: Workbench) -> None:
    told: list[tuple] = []

    class Pipe:
        def send(self, news: tuple) -> None:
            told.append(news)

    stop = threading.Event()
    stop.set()
    bench.add_effect("coulomb_friction")
    session = bench.session.with_values({"B": 40.0})
    fit = _fit(Pipe(), stop, session.model, session.estimation, noise=NOISE, options=session.options)
    assert fit.status == "interrupted" and fit.parameters["B"].value > 0 and told[0][0] == "progress"


@pytest.mark.slow
def test_what_goes_wrong_in_a_computation_is_told_and_the_next_one_can_begin(bench: Workbench) -> None:
    told: list[dict] = []
    bench.listener = told.append
    bench.session = dataclasses.replace(bench.session, noise={"v": -1.0})
    before = bench.session
    bench.start(JobKind.FIT)
    wait(bench)
    assert told[-1]["news"] == "failed" and "-1" in told[-1]["content"] and bench.session is before
    bench.session = dataclasses.replace(before, noise=NOISE)
    bench.start(JobKind.FIT)
    wait(bench)
    assert told[-1]["news"] == "done"


def test_a_session_that_was_not_exported_is_not_lost(bench: Workbench, tmp_path: Path) -> None:
    bench.set_values({"B": 3.0})
    last = bench.save_last()
    study = tomllib.loads(last.read_text())
    assert study["start"] == {"B": 3.0} and (last.parent / study["records"]["estimation"][0]).is_file()
    bench.export()
    assert bench.save_last() is None


def test_a_model_that_its_effects_do_not_name_goes_with_its_study(bench: Workbench, tmp_path: Path) -> None:
    law = gb.effects.formula_effect(
        "own_law", "force", "k*v**3", [Parameter("k", "N*s**3/m**3", -0.1)], amplitude="k", source="a test"
    )
    bench.session = dataclasses.replace(bench.session, model=bench.session.model + law)
    bench.set_values({"k": -0.2})
    bench.export()
    study = tomllib.loads((tmp_path / "out" / "study.toml").read_text())
    assert study["model"] == "model.py" and "effects" not in study
    again = find_model(str(tmp_path / "out" / "model.py"))
    assert again.values == bench.session.model.values


@pytest.mark.rest
@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"process_noise": {"v": None}}, marks=pytest.mark.slow),
        {"loss": "huber"},
        pytest.param({"priors": {"B": (2.0, 0.1)}}, marks=pytest.mark.slow),
    ],
)
def test_studies_of_other_kinds_are_shown_and_repeated_too(rig: Path, tmp_path: Path, options: dict) -> None:
    study = Study(model=str(rig / "carriage.py"), noise=NOISE, **options)
    model = constrain(build_model(study), study)
    bench = Workbench(Session(model, noise=NOISE), StudyOnFile(study, model), tmp_path / "out")
    bench.load(rig / "train.csv")
    assert bench.show_run(0)["misfit"]["rows"] and bench.show_location(0)["text"]
    bench.export()
    again = read_study(tmp_path / "out" / "study.toml", "fit", COMMANDS)
    assert {name: getattr(again, name) for name in options} == options
    done = subprocess.run([sys.executable, "repeat.py"], cwd=tmp_path / "out", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.rest
def test_a_run_that_overflows_is_shown_as_such(bench: Workbench) -> None:
    law = gb.effects.formula_effect(
        "own_law", "force", "k*v**3", [Parameter("k", "N*s**3/m**3", -0.1)], amplitude="k", source="a test"
    )
    bench.session = dataclasses.replace(bench.session, model=bench.session.model + law)
    assert not bench.show_run(0, {"k": -0.1})["overflows"]
    view = bench.show_run(0, {"k": 1e4})
    assert view["overflows"] and view["misfit"]["rows"] == [["v", "", "", "", ""]]
    bench.set_values({"k": 1e4})
    assert json.dumps([view, bench.show_location(0), bench.show()], allow_nan=False)
    bench.add_effect("coulomb_friction")


@pytest.mark.rest
def test_a_discovery_is_repeated_from_the_model_that_it_began_with(bench: Workbench) -> None:
    fit = gb.fit(bench.session.model + gb.effect("coulomb_friction"), bench.session.estimation, noise=NOISE)
    plain = bench.session.model.start(B=2.5)
    found = gb.discover(
        plain,
        bench.session.estimation,
        validation=bench.session.validation,
        noise=NOISE,
        effects=[gb.effect("coulomb_friction")],
        options=gb.FitOptions(at_rest=True),
    )
    bench.session = bench.session.with_discovery(found, plain)
    assert bench.session.is_fitted and bench.session.fit is found.best
    lines = bench.show()["script"].splitlines()
    assert "plain = plain.start(B=2.5)" in lines and "model = model + gb.effect('coulomb_friction')" in lines
    assert not [line for line in lines if line.startswith("plain") and "coulomb" in line]
    assert [line for line in lines if line.startswith("discovery = gb.discover(plain, records, validation=validation")]
    assert bench.session.with_fit(fit).discovery is found


@pytest.mark.parametrize("name", ["train.csv", "a b.csv", "nul.csv", "train-2.csv"])
def test_an_export_replaces_no_record_of_another_session(
    rig: Path, tmp_path: Path, bench: Workbench, name: str
) -> None:
    uploads, before = tmp_path / "uploads", tmp_path / "out" / "records"
    uploads.mkdir()
    (uploads / name).write_bytes((rig / "test.csv").read_bytes())
    bench.export()
    kept = {file.name: file.read_bytes() for file in before.iterdir()}
    (before / name).write_bytes(kept["train.csv"])  # in every case there is another record of this name
    kept = {file.name: file.read_bytes() for file in before.iterdir()}
    other = Workbench(bench.session, bench.study, tmp_path / "out", uploads=uploads.resolve(), workers=1)
    other.load(uploads / name)
    other.export()
    study = tomllib.loads((tmp_path / "out" / "study.toml").read_text())
    assert {file: (before / file).read_bytes() for file in kept} == kept
    copy = tmp_path / "out" / study["records"]["estimation"][-1]
    assert copy.name != name and copy.read_bytes() == (uploads / name).read_bytes()
    other.export()  # once more: no further copy
    assert len(list(before.iterdir())) == len(kept) + 1


@pytest.mark.parametrize("name", ["model.py", "study.toml", "fit.json", "repeat.py"])
def test_an_export_replaces_nothing_that_the_app_did_not_write(bench: Workbench, tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    bench.export()
    bench.export()  # its own files it replaces, in this session and in another
    Workbench(bench.session, bench.study, out, workers=1).export()
    assert bench.folder == out and not list(tmp_path.glob("out-*"))
    (out / name).write_text("a person's own work")
    bench.export()
    assert (out / name).read_text() == "a person's own work"
    assert bench.folder == tmp_path / "out-2" and (bench.folder / "study.toml").is_file()
    bench.export()
    assert not (tmp_path / "out-3").exists()


def test_an_input_moves_in_the_app_as_in_the_study_that_it_exports(rig: Path, tmp_path: Path) -> None:
    """One record shows an input in steps, the other a smooth one: read together they are one signal, in whatever order they came."""
    time = 0.01 * np.arange(600)
    force = {
        "stepped": np.sign(np.sin(3 * time)),
        "smooth": np.sin(3 * time) + 1e-3 * np.random.default_rng(1).normal(size=600),
    }
    model = find_model(str(rig / "carriage.py"))
    (name,) = (i.name for i in model.inputs)
    for kind, values in force.items():
        run = gb.simulate(model, {"time": time, name: values})
        columns = {"time": time, name: values, **run.outputs}
        np.savetxt(
            rig / f"{kind}.csv",
            np.column_stack(list(columns.values())),
            delimiter=",",
            header=",".join(columns),
            comments="",
        )
    for order in (("stepped", "smooth", "train"), ("smooth", "train", "stepped")):
        study = Study(model=str(rig / "carriage.py"), noise=NOISE)
        session = Session(constrain(build_model(study), study), noise=NOISE, options=fit_options(study))
        bench = Workbench(session, StudyOnFile(study, model), tmp_path / order[0], uploads=rig, workers=1)
        for kind in order:
            bench.load(rig / f"{kind}.csv")
        bench.load(rig / "test.csv", validates=True)
        bench.set_role(1, True)
        bench.export()
        read = read_study(bench.folder / "study.toml", "fit", COMMANDS)
        again = read_records(read, build_model(read))
        shown = [
            {r.name: dict(r.courses) for r in group} for group in (bench.session.estimation, bench.session.validation)
        ]
        assert shown == [{r.name: dict(r.courses) for r in group} for group in again[:2]]
        bench.close()
