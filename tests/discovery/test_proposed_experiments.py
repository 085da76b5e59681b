"""What could still be hidden: limits only where there are some."""

import numpy as np
import pytest

import greybox as gb
from greybox import Balance, Input, Model, Output, Parameter, State
from greybox.base.errors import ModelError
from greybox.discovery.findings import DiscoveryCode
from greybox.model.effects.catalogue import effect

HEATED = Model(
    "heated",
    states=[State("T", "K", role="temperature")],
    inputs=[Input("P", "W", role="drive"), Input("Q", "W"), Input("Ta", "K", role="ambient_temperature")],
    outputs=[Output("T", "K")],
    parameters=[Parameter("C", "J/K", 50.0, (1.0, 1e3)), Parameter("h", "W/K", 1.0, (0.01, 100.0))],
    balances=lambda x, u, p: [
        Balance("heat", "W", p.C, "T", heater=u.P, second=u.Q, loss=-p.h * (x.T - u.Ta)),
    ],
)


def record(seed: int, rows: int = 300) -> gb.Experiment:
    rng = np.random.default_rng(seed)
    inputs = {
        "P": np.repeat(rng.uniform(5, 60, rows // 20), 20),
        "Q": np.repeat(rng.normal(size=rows // 20), 20),
        "Ta": 20 + np.linspace(0, 2, rows),
    }
    run = gb.simulate(HEATED, {"time": np.arange(rows) * 1.0, **inputs})
    return gb.Experiment(
        f"run {seed}", np.arange(rows) * 1.0, inputs, {"T": run.outputs["T"] + 0.01 * rng.normal(size=rows)}
    )


def test_an_amplitude_of_which_nothing_shows_at_zero_has_no_limit() -> None:
    """A drive that never changes sign: a dead zone of zero width changes nothing that could be told from an offset."""
    found = gb.discover(
        HEATED,
        record(1),
        validation=record(2),
        noise={"T": 0.01},
        effects=[effect("gain_by_sign"), effect("input_offset")],
        workers=1,
    )
    limits = {f.subject: f.values["limit"] for f in found.findings if f.code is DiscoveryCode.DETECTION_LIMIT}
    assert found.verdict == "complete"
    assert set(limits) == {"input_offset"}
    assert limits["input_offset"] > 0


def test_effects_without_a_place_are_refused_with_what_they_need() -> None:
    with pytest.raises(ModelError, match=r"none of the effects to try.*it needs a balance of a velocity"):
        gb.discover(HEATED, record(1), validation=record(2), effects=[effect("stribeck_friction")], workers=1)
