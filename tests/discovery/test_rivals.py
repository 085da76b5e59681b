"""Which rivals an answer is held against: with refits that are given, and one whose form the records do not show."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import greybox as gb
from greybox.discovery import rivals
from greybox.discovery.candidates import estimate_scales
from greybox.discovery.decision import Grade
from greybox.discovery.execution import FailureLog
from greybox.discovery.problem import DiscoveryProblem
from greybox.discovery.rivals import RivalSearch
from greybox.discovery.surrogate_effects import LINEAR_DYNAMICS
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


@pytest.mark.rest
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


def looped(seed, in_loop=True):
    """A rotor whose armature follows late, its voltage set from the reading before; both lags exactly, the noise of the reading told.

    ``w' = 20 i - 2 w``, ``i' = (u - i) / 0.1``; not ``in_loop`` the voltage is drawn beforehand.
    """
    generator, period, rows = np.random.default_rng(seed), 0.02, 400
    advance = expm(period * np.array([[-2.0, 20.0, 0.0], [0.0, -10.0, 10.0], [0.0, 0.0, 0.0]]))
    time = period * np.arange(rows)
    reference = 7.0 + 3.0 * np.sin(2.1 * time + seed) + 2.0 * np.sin(5.3 * time)
    drawn = np.repeat(generator.uniform(0.3, 1.2, rows // 10), 10)
    w = current = before = 0.0
    voltages, readings = [], []
    for k in range(rows):
        voltage = 0.3 * (reference[k] - before) if in_loop else drawn[k]
        before = w + 0.05 * generator.standard_normal()
        voltages.append(voltage)
        readings.append(before)
        w, current, _ = advance @ (w, current, voltage)
    return gb.Experiment(f"run {seed}", time, {"u": np.array(voltages)}, {"w": np.array(readings)})


def rotor_search(*records):
    """The problem of a rotor without an armature, and the search for the rivals of its plain model."""
    model = gb.Model(
        "rotor",
        states=[gb.State("w", "rad/s", 0.0)],
        inputs=[gb.Input("u", "V")],
        outputs=[gb.Output("w", "rad/s")],
        parameters=[
            gb.Parameter("k", "rad/(s^2*V)", 15.0, (1e-3, 1e4)),
            gb.Parameter("b", "1/s", 3.0, (1e-4, 1e3)),
        ],
        balances=lambda x, u, p: [gb.Balance("torque", "rad/s^2", 1, "w", drive=p.k * u.u, damping=-p.b * x.w)],
    )
    problem = DiscoveryProblem(model, records, {"w": 0.05}, (), gb.FitOptions(at_rest=True))
    plain = problem.baseline
    scales = estimate_scales(plain)
    return problem, RivalSearch(problem, scales, (), plain, plain, {}, ())


def test_in_a_loop_any_linear_path_from_its_input_is_a_rival():
    problem, search = rotor_search(looped(1))
    rivals._refit_linear_paths(search)
    best = min(problem.fitted, key=lambda fit: fit.cost)
    assert best.effects == (f"{LINEAR_DYNAMICS}_to_w",)
    # The armature is a second lag: the rotor and a path of the first order are any linear plant of the second.
    assert search.baseline.per_sample > 5 and best.per_sample < 1.3
    rates = sorted((best.model.values["b"], best.model.values[best.model.names_of(best.effects[0])["a"]]))
    assert rates == pytest.approx([2.0, 10.0], rel=0.1)


def test_without_a_loop_no_linear_path_is_a_rival():
    problem, search = rotor_search(looped(1, in_loop=False))
    rivals._refit_linear_paths(search)
    assert not problem.fitted and search.baseline.per_sample > 5
