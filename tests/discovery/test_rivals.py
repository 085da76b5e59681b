"""Which rivals an answer is held against, with refits that are given: nothing is simulated."""

from types import SimpleNamespace

import pytest

import greybox as gb
from greybox.discovery import rivals
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


def test_a_rival_that_is_far_behind_is_not_refitted_to_the_end(monkeypatch):
    finished = []
    monkeypatch.setattr(rivals, "_converge", lambda search, fit: finished.append(fit.cost))
    known = {
        frozenset([name]): candidate(cost, name)
        for name, cost in {"cubic_damping": 900.0, "backlash": 20.0, "sensor_lag": 300.0, "cogging": 24.0}.items()
    }
    search = SimpleNamespace(selected=candidate(1.0, "coulomb_friction"), known=known, candidates=())
    rivals._refit_others(search, "coulomb_friction", candidate(1e4))
    assert finished == [20.0, 24.0]
