"""A campaign names what a rig hides, keeps its limits, goes on where it was stopped, and says what is wrong with a rig."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.base.files import hold_file
from greybox.base.json_file import read_json
from greybox.data.signals import SignalLimit
from greybox.discovery.result import Discovery
from greybox.estimation.result import load_fit
from greybox.extensions.design.campaign import (
    MODEL_ERROR,
    UNPROVEN_SHARE,
    Campaign,
    CampaignPlan,
    CampaignStatus,
    Knowledge,
    choose_shares,
    run_campaign,
)
from greybox.extensions.design.problem import CAMPAIGN_POLICY, DesignPolicy
from greybox.shell.commands import app
from greybox.show import describe_page
from tests.support.command import CliRunner
from tests.support.result_schema import strict_offences

pytestmark = pytest.mark.rest

# Seconds to wait for another process; a busy machine takes long to start one.
PATIENCE = 60

PROGRAM = Path(__file__).parents[2] / "support" / "rig_program.py"
POLICY = DesignPolicy()
QUICK = replace(
    POLICY,
    bands=2,
    iterations=5,
    rounds=1,
    starts=1,
    refined_scenarios=1,
    crest_iterations=40,
    scenarios=2,
)


def make_mass(felt=lambda v: v) -> gb.Model:
    """A mass on a spring, whose damper feels the velocity as ``felt`` has it."""
    return gb.Model(
        "mass",
        [gb.State("x", "m", role="displacement"), gb.State("v", "m/s", role="velocity")],
        [gb.Input("F", "N", role="drive")],
        [gb.Output("x", "m")],
        [
            gb.Parameter("m", "kg", 1.0, (0.1, 10.0), role="mass"),
            gb.Parameter("d", "N*s/m", 0.5, (1e-3, 10.0)),
            gb.Parameter("k", "N/m", 10.0, (0.1, 100.0), role="stiffness"),
        ],
        lambda x, u, p: [
            gb.Balance("position", "m/s", 1, "x", velocity=x.v),
            gb.Balance("force", "N", p.m, "v", drive=u.F, damping=-p.d * felt(x.v), spring=-p.k * x.x),
        ],
    )


MASS = make_mass()
PLAN = CampaignPlan(
    MASS,
    {"F": SignalLimit(-3, 3), "x": SignalLimit(-0.3, 0.3)},
    20.0,
    0.05,
    {"x": 1e-3},
    effects=("cubic_stiffness", "quadratic_damping"),
    options=gb.FitOptions(at_rest=True),
    design_policy=QUICK,
)


def rig(mode: str = "good") -> str:
    return f"'{sys.executable}' '{PROGRAM}' {mode} {{input}} {{record}} {{number}}"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("campaign")
    return run_campaign(PLAN, folder, rig=rig(), workers=1)


def test_it_names_the_hidden_effect_within_the_limits(finished) -> None:
    assert finished.status is CampaignStatus.DONE and len(finished.steps) <= 3
    assert finished.steps[-1].effects == ("cubic_stiffness",) and not finished.steps[-1].alternatives
    data = json.loads((finished.folder / "campaign.json").read_text())
    assert strict_offences(data, Campaign) == [] and data["status"] == "done"
    for record in finished.folder.glob("*/record.csv"):
        signals = gb.read_csv(record, MASS)
        assert np.abs(signals.outputs["x"]).max() < 0.3 + 5e-3 and np.abs(signals.inputs["F"]).max() <= 3
    page = gb.report(finished, finished.folder / "report.html").read_text(encoding="utf-8")
    assert finished.describe().answer.startswith(f"{MASS.title}, {len(finished.steps)} experiment")
    assert "one explanation is left: cubic_stiffness" in page
    steps, _, _ = describe_page(finished).sections
    widths = next(block for block in steps.blocks if block.caption.startswith("Half width of the 95 % interval"))
    (value,) = [row[-1] for row in widths.rows if row[0] == "K3"]
    discovered = read_json(finished.folder / f"{len(finished.steps):02d}" / "discovery.json", Discovery)
    assert float(value.split()[0]) == pytest.approx(discovered["parameters"]["K3"]["value"], rel=1e-4)


@pytest.mark.rest
def test_what_it_writes_is_read_back_and_refitted_to_the_same_errors(finished) -> None:
    folder = finished.folder / f"{len(finished.steps):02d}"
    records = [gb.read_csv(file, MASS) for file in sorted(finished.folder.glob("*/record.csv"))]
    written = load_fit(folder / "fit.json", MASS + gb.effect("cubic_stiffness"))
    # The model with the effect that it names, added by hand and begun anew, on the records that lie in the folder.
    again = gb.fit(MASS + gb.effect("cubic_stiffness"), records, noise=PLAN.noise, options=PLAN.options)
    assert again.misfit["x"].rmse == pytest.approx(written.misfit["x"].rmse, rel=0.01)
    for name, estimate in written.parameters.items():
        assert again.parameters[name].value == pytest.approx(estimate.value, rel=0.01), name


def test_it_goes_on_where_it_was_stopped(tmp_path) -> None:
    waiting = run_campaign(PLAN, tmp_path)
    assert waiting.status is CampaignStatus.MEASURING and waiting.findings[0].values["record"].endswith("record.csv")
    asked = (tmp_path / "01" / "input.csv").read_bytes()
    with pytest.raises(
        DataError, match="ended with exit code 3 in experiment 1: the amplifier is off; nothing was kept"
    ):
        run_campaign(PLAN, tmp_path, rig=rig("fail"))
    assert not (tmp_path / "01" / "record.csv").exists()
    once = replace(PLAN, policy=replace(CAMPAIGN_POLICY, experiments=1))
    spent = run_campaign(once, tmp_path, rig=rig())
    assert spent.status is CampaignStatus.BUDGET_SPENT and (tmp_path / "01" / "input.csv").read_bytes() == asked
    record = (tmp_path / "01" / "record.csv").read_bytes()
    more = run_campaign(replace(PLAN, policy=replace(CAMPAIGN_POLICY, experiments=2)), tmp_path)
    assert more.status is CampaignStatus.MEASURING and len(more.steps) == 2
    assert more.steps[0] == run_campaign(PLAN, tmp_path).steps[0]  # read, not computed again
    assert (tmp_path / "01" / "record.csv").read_bytes() == record
    with pytest.raises(DataError, match="begun with another limits"):
        run_campaign(replace(PLAN, limits={"F": SignalLimit(-2, 2)}), tmp_path)
    # The model of another day, under the same name: its damper doubled, its spring in other units, a wider bound.
    doubled = make_mass(lambda v: 2 * v)
    wider = MASS.bound(d=(1e-6, 10.0))
    for edited in (doubled, wider):
        with pytest.raises(DataError, match=r"begun with another model; .* -> "):
            run_campaign(replace(PLAN, model=edited), tmp_path)


@pytest.mark.slow
def test_the_plain_model_is_left_only_after_a_record_that_looks_for_what_hides(tmp_path) -> None:
    plain = run_campaign(PLAN, tmp_path, rig=rig("plain"), workers=1)
    assert plain.status is CampaignStatus.DONE and plain.steps[-1].verdict == "complete"
    assert [step.goal for step in plain.steps] == ["precision", "precision", "detection"]


def test_a_contradicted_model_is_not_trusted_far_from_where_the_rig_has_been(finished) -> None:
    record = gb.read_csv(finished.folder / "01" / "record.csv", MASS)
    plain = gb.fit(MASS, record, noise={"x": 1e-3}, options=PLAN.options)
    strict = replace(PLAN, policy=replace(CAMPAIGN_POLICY, contradiction=0.9 * plain.misfit["x"].noise_ratio))
    tolerant = replace(PLAN, policy=replace(CAMPAIGN_POLICY, contradiction=1.1 * plain.misfit["x"].noise_ratio))
    known = Knowledge(plain, plain)
    caution = 1 + MODEL_ERROR * known.unexplained
    assert caution > 1
    moved = {"x": np.abs(record.outputs["x"]).max() / 0.3, "F": np.abs(record.inputs["F"]).max() / 3}
    for name, share in choose_shares(strict, known, [record]).items():
        assert share == pytest.approx(min(moved[name], UNPROVEN_SHARE) / caution, rel=0.05)
    assert moved["x"] < UNPROVEN_SHARE
    for share in choose_shares(tolerant, known, [record]).values():
        assert share == pytest.approx(UNPROVEN_SHARE / caution, rel=1e-9)


def test_a_rig_that_passes_a_limit_stops_the_campaign_and_the_record_stays(tmp_path) -> None:
    broken = run_campaign(PLAN, tmp_path, rig=rig("wild"))
    assert broken.status is CampaignStatus.LIMIT_BROKEN and abs(broken.steps[0].broken["x"]) > 0.3
    assert (tmp_path / "01" / "record.csv").exists()
    assert len(run_campaign(PLAN, tmp_path).steps) == 2


RIGS = [
    (rig("hang"), "did not end within"),
    (rig("silent"), "wrote no record in experiment 1"),
    (rig("other"), "another record: its input F differs from input.csv by"),
    ("/nowhere/rig", "'/nowhere/rig': cannot be run"),
    ("'unfinished", "cannot be read as a command"),
]


def test_what_is_wrong_with_a_rig_is_said_in_one_sentence(tmp_path) -> None:
    impatient = replace(CAMPAIGN_POLICY, rig_timeout=-19.5)
    run_campaign(PLAN, tmp_path)
    for command, message in RIGS:
        hangs = "hang" in command
        with pytest.raises(gb.GreyboxError, match=message) as caught:
            run_campaign(replace(PLAN, policy=impatient) if hangs else PLAN, tmp_path, rig=command)
        assert "\n" not in str(caught.value)
        (tmp_path / "01" / "record.csv").unlink(missing_ok=True)


def test_the_command_waits_for_a_record_and_refuses_what_cannot_be(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    base = ["campaign", "silverbox", "--duration", "0.1", "--sampling-time", "1.5e-3", "--no-report"]
    for more, message in (
        (["--limit", "u=-0.1:0.1"], "the noise of no output is known"),
        (["--limit", "u=-0.1:0.1", "--noise", "y=1e-3", "--width", "-1"], "--width -1"),
        (["--noise", "y=1e-3"], "input 'u' has no limits"),
        (["--limit", "u=-0.1:0.1", "--noise", "y=1e-3", "--effect", "nope"], "nope"),
    ):
        done = CliRunner().invoke(app, [*base, *more])
        assert done.exit_code == 2 and message in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
    done = CliRunner().invoke(app, [*base, "--limit", "u=-0.1:0.1", "--noise", "y=1e-3", "--output", "here"])
    assert done.exit_code == 0, done.output
    assert "run the same command again" in done.stdout and Path("here/01/input.csv").exists()


def test_a_twin_stands_for_a_rig_with_limits(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    played = ["simulate", "silverbox", "--step", "0.1", "--duration", "0.1", "--sampling-time", "1e-3", "--no-report"]
    stopped = CliRunner().invoke(app, [*played, "--limit", "y=-1e-3:1e-3", "--output", "record.csv"])
    assert stopped.exit_code == 1 and "leaves its limits of -0.001 to 0.001" in stopped.stderr
    assert not Path("record.csv").exists()
    assert CliRunner().invoke(app, [*played, "--limit", "y=-9:9", "--output", "record.csv"]).exit_code == 0
    unknown = CliRunner().invoke(app, [*played, "--limit", "z=-9:9"])
    assert unknown.exit_code == 2 and "no such signal" in unknown.stderr


def test_a_folder_in_which_a_campaign_is_at_work_is_refused(tmp_path) -> None:
    with hold_file(tmp_path / "campaign.lock"), pytest.raises(DataError, match="at work here"):
        run_campaign(PLAN, tmp_path, rig=rig())
    assert [path.name for path in tmp_path.iterdir()] == ["campaign.lock"]


@pytest.mark.skipif(sys.platform == "win32", reason="locks and signals of POSIX")
def test_a_rig_that_outlives_its_campaign_keeps_the_folder(tmp_path) -> None:
    program = "import os, pathlib, time; pathlib.Path('pid').write_text(str(os.getpid())); time.sleep(60)"
    command = f"{sys.executable} -c {shlex.quote(program)} {{input}}"
    script = f"""
import os, pathlib
from greybox.extensions.design.problem import CAMPAIGN_POLICY
from greybox.extensions.design.rig import run_rig
from greybox.base.files import hold_file
os.chdir({str(tmp_path)!r})
with hold_file("campaign.lock") as held:
    run_rig({command!r}, pathlib.Path("a"), pathlib.Path("b"), 1, 9.0, CAMPAIGN_POLICY.rig_timeout, held)
"""
    campaign = subprocess.Popen([sys.executable, "-c", script])
    note, deadline = tmp_path / "pid", time.monotonic() + PATIENCE
    while not (note.exists() and note.read_text()):
        assert time.monotonic() < deadline and campaign.poll() is None
        time.sleep(0.05)
    campaign.kill()
    campaign.wait()
    try:
        with hold_file(tmp_path / "campaign.lock") as held:
            assert held is None
    finally:
        os.kill(int(note.read_text()), signal.SIGKILL)
    # A wait of its own: on a busy machine the program may have taken most of the first one to begin.
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        with hold_file(tmp_path / "campaign.lock") as held:
            if held is not None:
                return
        time.sleep(0.05)
    pytest.fail("the lock outlived the rig")
