"""What `greybox discover` writes, how an interrupted search goes on, and that refits elsewhere give the same."""

import json
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.discovery import pipeline
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.localisation import estimate_residual_spectrum
from greybox.discovery.pipeline import discover
from greybox.discovery.result import Discovery
from greybox.shell.commands import app
from greybox.shell.project import find_model
from greybox.simulation.simulate import write_csv
from models.micro_actuator import micro_actuator
from tests.support.command import CliRunner
from tests.support.hidden_rigs import ACTUATOR, AT_REST, plain_model, simulate_records
from tests.support.result_schema import strict_offences

pytestmark = pytest.mark.rest

NOISE = {"x": 2e-7, "i": 5e-3}


@pytest.fixture(scope="module")
def rig():
    return simulate_records(micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, tuple(NOISE.values()), rows=200)


@pytest.fixture(scope="module")
def written(rig, tmp_path_factory):
    """A discovery from the command line with two candidates, and its folder."""
    folder = tmp_path_factory.mktemp("discover")
    for name, record in zip(("train", "test"), rig, strict=True):
        write_csv(record, micro_actuator, folder / f"{name}.csv")
    command = [
        "discover",
        "micro_actuator",
        str(folder / "train.csv"),
        "--validate",
        str(folder / "test.csv"),
        "--at-rest",
        "--effects",
        "coulomb_friction,cubic_stiffness",
        "--noise",
        "x=2e-7",
        "--noise",
        "i=5e-3",
        "--output",
        str(folder),
        *(f"--fix={n}={ACTUATOR[n]}" for n in ("M", "Ra")),
        *(f"--start={n}={v}" for n, v in (("B", 0.35), ("K", 4300), ("Kf", 1.1), ("Kv", 1.8), ("La", 8e-4))),
        "--figures",
    ]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    return folder


def test_the_command_writes_answer_model_figures_and_journal(written):
    answer = json.loads((written / "discovery.json").read_text())
    assert answer["verdict"] == "named"
    assert strict_offences(answer, Discovery) == []
    assert gb.discovery.load_discovery(written / "discovery.json") == answer
    assert answer["effects"][0]["name"] == "coulomb_friction"
    assert answer["sites"][0]["name"] == "force" and answer["sites"][0]["set"] == 0
    assert {"start", "end", "share"} <= set(answer["when"][0])
    assert answer["regions"][0]["variable"] == "v"
    assert (written / "journal.jsonl").read_text().count("\n") >= 3
    for name in ("missing-coulomb_friction", "residuals", "candidates", "gap"):
        for kind in ("png", "svg"):
            assert (written / f"{name}.{kind}").stat().st_size > 2000


@pytest.mark.rest
def test_the_model_that_was_written_is_one_that_greybox_fits(written, rig):
    model = find_model(str(written / "model.py"))
    assert [e.name for e in model.effects] == ["coulomb_friction"]
    assert model.values["Fc"] == pytest.approx(0.05, rel=0.05)
    fit = gb.fit(model, rig[0], noise=NOISE, options=AT_REST)
    assert fit.misfit["x"].noise_ratio < 1.1


def test_a_search_goes_on_where_it_was_interrupted(rig, written, tmp_path, monkeypatch):
    """It ends with the constants of the search that the command ran from beginning to end, in the same records."""
    effects = [gb.effect(n) for n in ("coulomb_friction", "cubic_stiffness")]
    journal = tmp_path / "journal.jsonl"

    def run():
        return discover(
            plain_model(micro_actuator),
            rig[0],
            validation=rig[1],
            noise=NOISE,
            options=AT_REST,
            effects=effects,
            journal=journal,
        )

    class Interrupted(pipeline.RefitJournal):
        def add(self, key, outcome):
            super().add(key, outcome)
            if len(self.known) == 2:
                raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "RefitJournal", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        run()
    monkeypatch.undo()
    with journal.open("a") as file:
        file.write('{"key": "cut sho')  # the power went while a line was written
    (whole,) = json.loads((written / "discovery.json").read_text())["effects"]
    assert run().best.parameters["Fc"].value == pytest.approx(whole["parameters"]["Fc"]["value"], rel=1e-6)


def test_a_file_that_is_no_journal_is_refused(rig, tmp_path):
    (tmp_path / "journal.jsonl").write_text("time,x\n1,2\n3,4\n")
    with pytest.raises(DataError, match="line 1 is not a journal entry"):
        discover(plain_model(micro_actuator), rig[0], validation=rig[1], journal=tmp_path / "journal.jsonl")


@pytest.mark.slow
def test_refits_in_other_processes_give_the_same(rig):
    effects = [gb.effect(n) for n in ("coulomb_friction", "cubic_stiffness", "lugre_friction")]

    def run(executor):
        return discover(
            plain_model(micro_actuator),
            rig[0],
            validation=rig[1],
            noise=NOISE,
            options=AT_REST,
            effects=effects,
            executor=executor,
        )

    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        there = run(pool)
    here = run(None)
    assert [r.effects for r in here.ranking] == [r.effects for r in there.ranking]
    assert [r.misfit for r in here.ranking] == pytest.approx([r.misfit for r in there.ranking], rel=1e-6)


@pytest.mark.slow
def test_what_is_outside_the_catalogue_gets_a_curve(rig):
    found = discover(
        plain_model(micro_actuator),
        rig[0],
        validation=rig[1],
        noise=NOISE,
        options=AT_REST,
        effects=[gb.effect("quadratic_stiffness")],
    )
    assert found.verdict == "unknown"
    assert found.sites[0] == "balance force"
    assert found.surrogate.variable == "v"
    assert found.surrogate.explained_fraction > 0.4
    assert found.extended is found.surrogate.fit
    # dry friction steps down where the velocity passes zero
    z, curve = found.surrogate.values, found.surrogate.curve
    assert np.interp(0.2 * z.max(), z, curve) < np.interp(0.2 * z.min(), z, curve)
    # The curve explains more than what was tried, which does no better than the plain model and is said behind it.
    ends = [DiscoveryCode.SURROGATE_FITTED, DiscoveryCode.NO_LOOK_ALIKE]
    assert [finding.code for finding in found.conclusion][-2:] == ends and not found.effects
    floor = estimate_residual_spectrum(found.base, "i", coloured=False).floor
    assert np.sqrt(np.sum(floor**2)) == pytest.approx(found.base.noise.std["i"], rel=0.02)
