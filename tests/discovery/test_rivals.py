"""Which rivals an answer is held against: with refits that are given, and one whose form the records do not show."""

from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.discovery import rivals
from greybox.discovery.decision import Grade
from greybox.discovery.execution import FailureLog
from models.micro_actuator import micro_actuator
from tests.support.fake_candidates import candidate


@pytest.mark.parametrize(
    ("name", "expected"),
    [("lugre_friction", "prepare_curve"), ("stribeck_friction", "prepare_power"), ("coulomb_friction", None)],
)
def test_what_stands_in_the_place_of_an_effect_is_simpler(monkeypatch, name, expected):
    model = micro_actuator + gb.effect(name)
    asked, refitted = [], []
    for prepare in ("prepare_curve", "prepare_power"):
        monkeypatch.setattr(rivals, prepare, lambda *_, prepare=prepare: asked.append(prepare) or prepare)
    search = SimpleNamespace(
        signals=[SimpleNamespace(effect=name)],
        selected=SimpleNamespace(model=model, effects=(name,)),
        problem=SimpleNamespace(failures=FailureLog(), refit_all=refitted.extend),
    )
    rivals._refit_simpler(search, gb.effect(name), SimpleNamespace())
    assert asked == refitted == ([expected] if expected else [])


def test_a_rival_that_is_far_behind_is_not_refitted_to_the_end():
    finished = []
    problem = SimpleNamespace(converge=lambda fit, iterations: finished.append(fit.cost))
    known = {
        frozenset([name]): candidate(cost, name)
        for name, cost in {"cubic_damping": 900.0, "backlash": 20.0, "sensor_lag": 300.0, "cogging": 24.0}.items()
    }
    search = SimpleNamespace(selected=candidate(1.0, "coulomb_friction"), known=known, candidates=(), problem=problem)
    rivals._refit_others(search, "coulomb_friction", candidate(1e4))
    assert finished == [20.0, 24.0]


def test_a_dead_zone_that_the_input_never_crosses_is_no_more_than_a_constant():
    lag = gb.Model(
        "lag",
        states=[gb.State("x", "V", 0.0, (-5.0, 5.0))],
        inputs=[gb.Input("u", "V", role="drive")],
        outputs=[gb.Output("y", "V", lambda x, u, p: x.x)],
        parameters=[gb.Parameter("k", "1/s", 2.0, (0.1, 10.0))],
        balances=lambda x, u, p: [gb.Balance("rate", "V/s", 1, "x", decay=-p.k * x.x, drive=p.k * u.u)],
    )

    def record(seed, lowest):
        """A first-order lag behind a dead zone of 0.2 V, stepped exactly: x -> w + (x - w) exp(-k T)."""
        rng = np.random.default_rng(seed)
        u, x, y = np.repeat(rng.uniform(lowest, 2.0, 15), 20), 0.0, []
        for value in u:
            y.append(x)
            through = np.sign(value) * max(abs(value) - 0.2, 0.0)
            x = through + (x - through) * np.exp(-2.0 * 0.02)
        measured = np.array(y) + 2e-3 * rng.standard_normal(300)
        return gb.Experiment(f"run {seed}", 0.02 * np.arange(300), {"u": u}, {"y": measured})

    def grade(lowest):
        records = [record(seed, lowest) for seed in (1, 2)]
        found = gb.discover(
            lag, records[0], validation=records[1], noise={"y": 2e-3}, effects=[gb.effect("input_dead_zone")], workers=1
        )
        assert [e["name"] for e in found.effects] == ["input_dead_zone"]
        return found.effects[0]["grade"]

    assert grade(-2.0) is Grade.ESTABLISHED
    assert grade(0.5) is not Grade.ESTABLISHED
