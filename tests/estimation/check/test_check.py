"""What `check` says before a fit agrees with what a fit finds, and with what is known about the plants."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from greybox import Balance, Input, Model, Output, Parameter, State, fit
from greybox.base.errors import DataError, ModelError
from greybox.data.signals import multisine
from greybox.estimation.check import check
from greybox.estimation.identifiability.sensitivity import IdentifiabilityCode as Code
from greybox.shell.commands import app
from greybox.simulation.simulate import simulate
from models.cascaded_tanks import cascaded_tanks
from models.emps import emps
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from models.silverbox import silverbox
from tests.support.command import CliRunner

NOISE = {"x": 2e-7, "i": 5e-3}


def test_without_data_the_common_scale_of_the_actuator_is_found() -> None:
    found = check(micro_actuator)
    assert found.linear
    assert found.assumed
    assert len(found.open_directions) == 1
    assert found.open_directions[0].names == ("M", "B", "K", "Kf") and found.open_directions[0].scaling
    assert {name for name, c in found.constants.items() if c.std is None} == {"M", "B", "K", "Kf"}
    weighed = check(micro_actuator.fix("M"))
    assert weighed.open_directions == ()
    assert all(c.std is not None for c in weighed.constants.values())


def test_without_the_current_more_is_open() -> None:
    time = 2.5e-4 * np.arange(2000)
    run = simulate(micro_actuator, {"time": time, "u": multisine(time, 5, 800, 2, np.random.default_rng(0))})
    record = run.record(NOISE, np.random.default_rng(1))
    alone = replace(record, outputs={"x": record.outputs["x"]})
    found = check(micro_actuator, alone, noise={"x": 2e-7})
    # Seven constants, four coefficients of the transfer function (eq. 16.1): three directions stay open.
    assert len(found.open_directions) == 3
    assert found.noise == {"x": 2e-7}


def test_the_expected_standard_deviation_is_what_a_fit_gives() -> None:
    model = micro_actuator.fix("M", "Ra")
    time = 2.5e-4 * np.arange(2000)
    run = simulate(model, {"time": time, "u": multisine(time, 5, 800, 2, np.random.default_rng(0))})
    record = run.record(NOISE, np.random.default_rng(1))
    expected = check(model, record, noise=NOISE).constants
    found = fit(model, record, noise=NOISE).parameters
    for name, constant in expected.items():
        assert constant.std == pytest.approx(found[name].std, rel=0.1), name


@pytest.mark.crossed(3)
@pytest.mark.rest
@pytest.mark.parametrize("model", [cascaded_tanks, emps, pneumatic_cylinder, silverbox], ids=lambda m: m.name)
def test_every_other_plant_is_determined_as_it_is_stated(model: Model) -> None:
    found = check(model)
    assert found.open_directions == ()
    assert found.failure is None
    assert set(found.constants) == {q.name for q in model.free_parameters}
    assert model.name in str(found)


@pytest.mark.rest
def test_an_upper_tank_of_free_scale_is_noticed() -> None:
    found = check(cascaded_tanks.free("k2"))
    assert len(found.open_directions) == 1
    assert {"k1", "k2", "k4"} <= set(found.open_directions[0].names)
    sensor = found.structure.recommendations[0]
    assert (sensor.code, sensor.values["signals"], sensor.values["rank"]) == (Code.ADD_SENSOR, ["x1"], 4)


def test_what_if_only_one_output_is_measured() -> None:
    found = check(micro_actuator, outputs=["x"])
    assert list(found.noise) == ["x"]
    assert len(found.open_directions) == 3
    measure = found.structure.recommendations[0]
    assert (measure.code, measure.values["signals"], measure.values["rank"]) == (Code.MEASURE_OUTPUT, ["i"], 6)
    with pytest.raises(ModelError, match="no output 'y'"):
        check(micro_actuator, outputs=["y"])
    time = 0.01 * np.arange(50)
    record = simulate(silverbox, {"time": time, "u": np.sin(time)}).record()
    with pytest.raises(DataError, match="none of the outputs"):
        check(micro_actuator, replace(record, outputs={"i": np.zeros(50)}), outputs=["x"])


def test_findings_as_json() -> None:
    found = json.loads(json.dumps(check(micro_actuator).as_dict(), allow_nan=False))
    assert found["structure"]["rank"] == 6
    assert found["structure"]["directions"][0]["weights"] == {"M": 1.0, "B": 1.0, "K": 1.0, "Kf": 1.0}
    assert found["data"]["constants"]["Ra"]["determined"] is True
    assert found["data"]["constants"]["M"]["std"] is None
    assert found["complete"] is False
    # Keys that other programs read, with sentences beside the findings.
    assert set(found) >= {
        "model",
        "linear",
        "discretisation",
        "kernel",
        "records",
        "assumed",
        "noise",
        "structure",
        "data",
    }
    assert {"remedies", "verdict", "directions", "determined"} <= set(found["structure"])
    assert {"constants", "combinations", "remarks", "failure", "excitation"} <= set(found["data"])
    assert found["data"]["excitation"][0]["warnings"] == []


def runaway(growth: float) -> Model:
    return Model(
        "runaway",
        states=[State("x", "m", 1.0)],
        inputs=[Input("u", "m/s")],
        outputs=[Output("x", "m")],
        parameters=[Parameter("a", "1/(m**2*s)", growth, (1e-3, 50.0))],
        balances=lambda x, u, p: [Balance("growth", "m/s", 1, "x", cubic=p.a * x.x**3, input=u.u)],
    )


def test_a_model_that_overflows_is_told_and_nothing_is_made_up() -> None:
    with pytest.raises(DataError, match="overflows after"):
        check(runaway(5.0))
    time = 0.01 * np.arange(400)
    record = simulate(runaway(1e-3), {"time": time, "u": np.sin(time)}).record()
    found = check(runaway(5.0), record)
    assert (found.failure.code, found.failure.subject) == (Code.MODEL_OVERFLOWS, "record 1")
    assert found.constants == {}


def test_nothing_free_is_said() -> None:
    found = check(silverbox.fix(*silverbox.values))
    assert found.failure.code == Code.NO_FREE_CONSTANT


def command(*arguments: str) -> str:
    """What `greybox check` prints."""
    done = CliRunner().invoke(app, ["check", *arguments])
    assert (done.exit_code, done.stderr) == (0, "")
    return done.stdout


def test_the_command_asks_what_if(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # where it writes its results
    page = " ".join(command("micro_actuator", "--outputs", "x", "--details", "--output", "one").split())
    assert "from u to x, 4 combinations of the 7 free parameters can be determined, 3 directions stay open" in page
    found = json.loads(command("micro_actuator", "--outputs", "x,i", "--fix", "M", "--json"))
    assert found["complete"] is True
    assert found["structure"]["verdict"] == "complete"
