"""Several records as witnesses: the constants of an answer over a condition of the records."""

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.discovery.pipeline import follow_conditions
from greybox.estimation.options import FitOptions
from greybox.model.effects.catalogue import effect
from greybox.show import text
from tests.support.stage import STAGE

NOISE = {"x": 1e-5}


def record(seed: int, pressed: float, **conditions: float) -> gb.Experiment:
    """A run with dry friction of 0.2 times what presses the stage on."""
    rng = np.random.default_rng(seed)
    time, force = 5e-3 * np.arange(100), np.repeat(rng.normal(0, 6, 10), 10)
    run = gb.simulate((STAGE + effect("coulomb_friction")).start(Fc=0.2 * pressed), {"time": time, "F": force})
    shown = run.outputs["x"] + 1e-5 * rng.normal(size=100)
    return gb.Experiment(f"run {seed}", time, {"F": force}, {"x": shown}, conditions=conditions)


@pytest.mark.slow
def test_a_friction_that_grows_with_the_load_is_found_to_and_the_rest_is_the_same_in_all_records(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("greybox.discovery.conclusion.fit_stand_in", lambda *_: None)  # it has no part in the trends
    learn = [record(k, load, load=load) for k, load in enumerate((2.0, 8.0))]
    found = gb.discover(
        STAGE,
        learn,
        validation=record(7, 6.0, load=6.0),
        noise=NOISE,
        effects=[effect("coulomb_friction")],
        workers=1,
    )
    assert [e["name"] for e in found.effects] == ["coulomb_friction"]
    trends = {f.subject: f for f in found.findings if f.code == "values_by_record"}
    friction = trends["Fc"].values
    assert friction["condition"] == "load" and friction["kind"] == "proportional"
    assert friction["ratio"] == pytest.approx(4.0, rel=0.1) and "4 times the load" in str(trends["Fc"])
    assert trends["K"].values["kind"] == "alike" and trends["K"].values["records"] == 3
    assert "Fc grows in proportion to load" in " ".join(text(found, details=True).split())


def test_records_without_a_condition_are_not_compared() -> None:
    runs = [record(k, 3.0) for k in range(2)]
    fitted = gb.fit(STAGE + effect("coulomb_friction"), runs, noise=NOISE)
    assert follow_conditions(fitted, runs, FitOptions()) == ()
    same = [replace(run, conditions={"load": 3.0}) for run in runs]
    assert follow_conditions(fitted, same, FitOptions()) == ()
