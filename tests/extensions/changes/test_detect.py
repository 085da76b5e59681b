"""What has changed is named, what has not is left alone, and what cannot be told is said to be so."""

from __future__ import annotations

import json

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.base.json_shape import to_json_data
from greybox.extensions.changes.result import ChangeCode, ChangeDetection, ChangeVerdict
from greybox.extensions.changes.survey import chart_changes, survey_population
from greybox.model.effects.catalogue import effect
from models.silverbox import silverbox
from tests.oracles.independent import linear_record, multisine
from tests.support.oscillator import oscillator
from tests.support.result_schema import strict_offences

PERIOD = 1.6384e-3
NOISE = {"y": 1e-3}


def measure(seed: int, rows: int = 300, name: str = "today", noise: float = 1e-3, **values: float) -> gb.Experiment:
    u = multisine(np.random.default_rng(100 + seed), rows, PERIOD, 5, 200, 0.1)
    return linear_record(silverbox.start(**values), u, PERIOD, noise={"y": noise}, seed=seed, name=name)


@pytest.fixture(scope="module")
def reference() -> gb.Fit:
    return gb.fit(silverbox, measure(1), noise=NOISE)


def codes(change) -> list[str]:
    return [finding.code for finding in change.conclusion]


def test_a_machine_as_it_was_is_unchanged(reference) -> None:
    change = gb.detect_changes(reference, measure(2))
    assert change.verdict is ChangeVerdict.UNCHANGED and codes(change) == [ChangeCode.NOTHING_CHANGED]
    assert not change.moved and change.effects == [] and change.p_value > 0.01
    for name, constant in change.constants.items():
        assert constant.interval[0] < silverbox.values[name] - constant.before < constant.interval[1] or name == "b"
        assert 0 < constant.smallest < 0.05 * constant.before


def test_a_constant_that_has_moved_is_named_with_its_change(reference) -> None:
    change = gb.detect_changes(reference, measure(2, d=46.0))
    assert change.verdict is ChangeVerdict.CHANGED and change.moved == ("d",)
    low, high = change.constants["d"].interval
    assert low < 46.0 - silverbox.values["d"] < high and high - low < 1.0
    assert codes(change) == [ChangeCode.CONSTANT_MOVED]


def test_a_noisier_sensor_is_no_effect(reference) -> None:
    change = gb.detect_changes(reference, measure(3, noise=2e-3), search_effects=False)
    assert change.verdict is ChangeVerdict.CHANGED and codes(change) == [ChangeCode.NOISE_GREW]
    assert change.conclusion[0].values["ratio"] == pytest.approx(2.0, abs=0.2)


def test_records_that_hardly_move_the_machine_cannot_tell(reference) -> None:
    still = measure(4, rows=120)
    weak = linear_record(silverbox, 0.002 * still.inputs["u"], PERIOD, noise=NOISE, seed=4, name="weak")
    change = gb.detect_changes(reference, weak)
    assert change.verdict is ChangeVerdict.CANNOT_TELL and codes(change) == [ChangeCode.CANNOT_TELL]
    assert {f.subject for f in change.findings if f.code == ChangeCode.CONSTANT_NOT_SEEN} >= {"d", "b"}


@pytest.mark.slow
def test_an_effect_that_has_appeared_is_found(reference) -> None:
    plant = silverbox + effect("cubic_stiffness")
    (name,) = (n for n in plant.values if n not in silverbox.values)
    plant = plant.start(**{name: 2e5 * 40})
    records = []
    for seed in (5, 6):
        u = 3 * multisine(np.random.default_rng(seed), 200, PERIOD, 5, 200, 0.1)
        run = gb.simulate(plant, {"time": PERIOD * np.arange(len(u)), "u": u})
        records.append(run.record(NOISE, np.random.default_rng(seed)))
    change = gb.detect_changes(
        reference, records, effects=[effect("cubic_stiffness"), effect("input_offset")], workers=1
    )
    assert change.verdict is ChangeVerdict.CHANGED
    assert [e["name"] for e in change.effects] == ["cubic_stiffness"]
    assert codes(change)[0] == ChangeCode.EFFECT_APPEARED and change.moved == ()
    assert strict_offences(to_json_data(change), ChangeDetection) == []


def test_what_is_written_is_as_the_schema_says(reference, tmp_path) -> None:
    change = gb.detect_changes(reference, measure(2, d=46.0))
    saved = change.save(tmp_path / "changed.json")
    assert strict_offences(json.loads(saved.read_text()), ChangeDetection) == []
    assert gb.changes.load_changes(saved)["constants"]["d"]["moved"] is True


def test_a_record_of_the_fit_is_no_record_of_today(reference) -> None:
    change = gb.detect_changes(reference, measure(1))
    assert change.findings[0].code == ChangeCode.SAME_RECORD


def test_bad_input_is_refused(reference) -> None:
    with pytest.raises(DataError, match="no record of today"):
        gb.detect_changes(reference, [])
    with pytest.raises(DataError, match="4 at least"):
        survey_population(reference, {"a": [measure(2)]})
    with pytest.raises(DataError, match="4 at least"):
        chart_changes(reference, [measure(2)])
    fixed = gb.fit(silverbox.fix(*silverbox.values), measure(1), noise=NOISE)
    with pytest.raises(DataError, match="nothing to compare"):
        gb.detect_changes(fixed, measure(2))


# --- a model that lacks something


def stiffening(seed: int, input_seed: int, **values: float) -> gb.Experiment:
    """A record of a rig with a stiffening spring, which the model lacks."""
    plant = silverbox + effect("cubic_stiffness")
    (name,) = (n for n in plant.values if n not in silverbox.values)
    u = 2 * multisine(np.random.default_rng(input_seed), 500, PERIOD, 5, 200, 0.1)
    run = gb.simulate(plant.start(**{name: 2e4}, **values), {"time": PERIOD * np.arange(len(u)), "u": u})
    return run.record(NOISE, np.random.default_rng(seed))


@pytest.mark.rest
def test_under_the_same_input_what_the_model_lacks_cancels() -> None:
    reference = gb.fit(silverbox, stiffening(1, 9), noise=NOISE)
    assert reference.misfit["y"].noise_ratio > 4
    healthy = gb.detect_changes(reference, stiffening(2, 9))
    assert healthy.verdict is ChangeVerdict.UNCHANGED
    change = gb.detect_changes(reference, stiffening(3, 9, d=45.0))
    assert change.verdict is ChangeVerdict.CHANGED and "d" in change.moved
    low, high = change.constants["d"].interval
    assert 0 < low < 45.0 - silverbox.values["d"] < high < 4.0


@pytest.mark.slow
def test_under_another_input_such_a_model_cannot_tell_a_change_but_a_large_one() -> None:
    reference = gb.fit(silverbox, stiffening(1, 9), noise=NOISE)
    for seed in range(10, 13):
        change = gb.detect_changes(reference, stiffening(seed, seed))
        assert change.verdict is not ChangeVerdict.CHANGED and change.moved == ()
    change = gb.detect_changes(reference, stiffening(10, 10, d=45.0))
    assert change.verdict is ChangeVerdict.CANNOT_TELL
    assert codes(change) == [ChangeCode.DIFFERENT_INPUT] and change.moved == ()
    # Whatever acts in the model's place, it is about as large as what is left: 40 % more damping is none of it.
    change = gb.detect_changes(reference, stiffening(10, 10, d=60.0))
    assert change.verdict is ChangeVerdict.CHANGED and change.moved == ("d",)
    (beyond,) = [f for f in change.findings if f.code == ChangeCode.BEYOND_MISSING_PART]
    assert beyond.subject == "d" and beyond.values["ratio"] > 1


# --- several machines, and time


def test_machines_that_fall_out_are_named_and_two_do_not_hide_each_other(reference) -> None:
    spread = np.random.default_rng(3).normal(1.0, 0.02, 9)
    machines = {f"m{k}": [measure(20 + k, rows=200, d=43.0 * s)] for k, s in enumerate(spread)}
    machines["m3"] = [measure(23, rows=200, d=60.0)]
    machines["m7"] = [measure(27, rows=200, d=58.0)]
    survey = survey_population(reference, machines)
    assert [m.name for m in survey.machines if "d" in m.outlying] == ["m3", "m7"]
    assert survey.population["d"].mean == pytest.approx(43.0, rel=0.03)
    assert 0.008 < survey.population["d"].spread < 0.04
    assert strict_offences(to_json_data(survey), ChangeDetection) == []


def test_a_jump_is_found_at_its_record(reference) -> None:
    records = [measure(40 + k, rows=200, name=f"day {k + 1}", d=43.0 if k < 6 else 45.0) for k in range(10)]
    course = chart_changes(reference, records)
    assert [(c.constant, c.record, c.number) for c in course.change_points] == [("d", "day 7", 7)]
    assert course.change_points[0].after == pytest.approx(45.0, rel=0.01)
    assert strict_offences(to_json_data(course), ChangeDetection) == []
    steady = chart_changes(reference, records[:6])
    assert steady.verdict is ChangeVerdict.UNCHANGED and codes(steady) == [ChangeCode.NO_CHANGE_POINT]


def test_a_plant_that_is_not_linear() -> None:
    plant = oscillator("rig", 1.0, 25.0, 500.0, 1.0)

    def run(model, seed):
        u = np.random.default_rng(seed).choice([-1.0, 1.0], 60).repeat(5)
        record = gb.simulate(model, {"time": 0.05 * np.arange(300), "u": u})
        return record.record({"x": 1e-3}, np.random.default_rng(seed))

    reference = gb.fit(plant, run(plant, 1), options=gb.FitOptions(at_rest=True))
    assert gb.detect_changes(reference, run(plant, 2), search_effects=False).verdict is ChangeVerdict.UNCHANGED
    assert gb.detect_changes(reference, run(plant.start(c=540.0), 3), search_effects=False).moved == ("c",)
