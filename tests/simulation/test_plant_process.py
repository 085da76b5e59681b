"""Machine code of others ends the process that it runs in, and no other."""

import os
import sys

import numpy as np
import pytest

import greybox as gb
from greybox.base import packing
from greybox.base.errors import GreyboxError
from greybox.simulation.plant_process import PlantProcess

pytestmark = [pytest.mark.rest, pytest.mark.skipif(sys.platform == "win32", reason="aborts differ")]


class Brittle:
    """A decay whose code aborts for records that begin above 5 V, and where it decays faster than 20 per second."""

    name = "brittle"
    inputs = ()
    outputs = (gb.Output("y", "V"),)
    parameters = (gb.Parameter("rate", "1/s", 1.0, (0.01, 100.0)),)
    is_native = True

    def simulate(self, record, values):
        if record.outputs["y"][0] > 5 or values["rate"] > 20:
            os.abort()
        return {"y": record.outputs["y"][0] * np.exp(-values["rate"] * record.time)}


def record(name, first=1.0, rows=31):
    time = np.linspace(0.0, 3.0, rows)
    return gb.Experiment(name, time, {}, {"y": first * np.exp(-2 * time)})


def test_a_record_that_ends_its_process_is_named():
    with pytest.raises(GreyboxError, match="ended its process in the run over 'bad'"):
        gb.fit(Brittle(), [record("good"), record("bad", 9.0)], noise={"y": 1e-3})


def test_constants_that_end_it_are_drawn_back_from():
    begun = gb.fit(Brittle(), record("good"), noise={"y": 1e-3})
    assert begun.parameters["rate"].value == pytest.approx(2.0, rel=1e-6)
    assert begun.solver.statistics["failed_runs"] <= 2


def test_a_validation_that_cannot_be_run_is_said():
    fit = gb.fit(Brittle(), record("good"), validation=record("bad", 9.0), noise={"y": 1e-3})
    assert not fit.explains_records
    assert "it cannot be run over 1 validation record" in str(fit).replace("\n", " ")


def test_a_run_does_not_look_for_the_functions_of_a_project(monkeypatch):
    """Among some thousand modules that takes longer than a short run: only the plant, which may hold some, is sent with them."""
    plant, looked = Brittle(), []
    monkeypatch.setattr(packing, "_local_packages", lambda: looked.append(1) or [])
    process = PlantProcess(plant)
    try:
        for rate in (1.0, 2.0, 3.0):
            run = process.simulate(record("good"), {"rate": rate})
            assert run["y"] == pytest.approx(np.exp(-rate * record("good").time))
    finally:
        process.end()
    assert looked == [1]
