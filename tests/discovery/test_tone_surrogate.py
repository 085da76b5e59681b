"""A disturbance that is a tone in time gets a generator as a stand-in. The rig is simulated without greybox."""

import json

import numpy as np
import pytest

import greybox as gb
from greybox.discovery import DiscoveryProblem, discover
from greybox.discovery.localisation import localise_candidate_residual, to_candidate_fit
from greybox.discovery.tone_surrogate import fit_tone_surrogate
from greybox.errors import DataError
from greybox.estimation import FitOptions, validate
from greybox.export import to_python
from greybox.plots import draw_discovery
from greybox.project import find_model
from greybox.reports import report
from models.micro_actuator import micro_actuator
from tests.discovery.test_discover import off, records

NOISE = {"x": 2e-7, "i": 5e-3}
FORCE, FREQUENCY = 0.05, 50.0
REST = FitOptions(at_rest=True)


@pytest.fixture(scope="module")
def rig():
    """Records with a hum; the second one begins at another phase of it."""
    first, second = records(
        micro_actuator, {"mains_hum": {"F": FORCE, "f": FREQUENCY}}, tuple(NOISE.values()), rows=700
    )
    return first, second.window(37, second.rows)


@pytest.fixture(scope="module")
def found(rig):
    return discover(
        off(micro_actuator), rig[0], validation=rig[1], noise=NOISE, effects=[gb.effect("input_offset")],
        options=FitOptions(),
    )  # fmt: skip


def test_a_hum_is_told_as_a_tone_at_its_place_and_closes_the_gap(found):
    assert found.verdict == "unknown"
    surrogate = found.surrogate
    assert (surrogate.site, surrogate.variable, surrogate.unit) == ("balance force", "time", "N")
    assert surrogate.tone.frequency == pytest.approx(FREQUENCY, abs=min(4 * surrogate.tone.std, 0.05))
    assert list(surrogate.tone.amplitude.values()) == pytest.approx([FORCE], rel=0.01)
    # once it is steady, a force at one frequency and a wrong reading at that frequency are the same
    assert surrogate.tone.alike == ("sensor of x",)
    # of the judging record only the first 0.083 s tell the phase; the rest has never been seen
    assert surrogate.tone.beginning == pytest.approx(0.083, abs=1e-3)
    assert surrogate.explained_fraction > 0.98
    assert np.abs(surrogate.curve).max() == pytest.approx(FORCE, rel=0.01)
    assert (
        "at the balance force (or the sensor of x: these records cannot tell), of amplitude 0.05 N, closes"
        in found.story
    )


def test_what_to_do_next_is_said(found):
    said = " ".join(found.next_steps)
    assert "the mains have 50 Hz and its multiples: look at grounding" in said
    assert "the model with the generator is what an observer" in said
    assert "noise" not in said  # it was given
    assert f"next: {found.next_steps[0]}" in str(found)


def test_the_model_with_the_tone_is_fitted_to_records_at_rest_from_its_file(found, rig, tmp_path):
    model = find_model(str(to_python(found.extended, tmp_path / "model.py")))
    assert [s.name for s in model.all_states if s.free_start] == ["z1", "z2"]
    fit = gb.fit(model, rig[0], noise=NOISE, options=REST)
    assert fit.misfit["x"].noise_ratio < 1.1
    begin = fit.traces[0].initial_state
    assert np.hypot(begin["z1"], begin["z2"]) == pytest.approx(FORCE, rel=0.01)
    assert (begin["x"], begin["v"]) == (0.0, 0.0)


def test_a_tone_is_found_at_rest_too_and_not_where_there_is_none(rig):
    def standing_in(fit):
        trial = to_candidate_fit(fit)
        return fit_tone_surrogate(DiscoveryProblem.of(fit), trial, localise_candidate_residual(trial), (rig[1],), fit)

    # at rest the way the tone sets in tells its place
    hummed = standing_in(gb.fit(off(micro_actuator), rig[0], validation=rig[1], noise=NOISE, options=REST))
    assert (hummed.site, hummed.tone.alike) == ("balance force", ())
    assert hummed.tone.frequency == pytest.approx(FREQUENCY, abs=0.02)
    rubbing, judge = records(micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, tuple(NOISE.values()), rows=400)
    assert standing_in(gb.fit(off(micro_actuator), rubbing, validation=judge, noise=NOISE, options=REST)) is None


def test_the_tone_is_written_drawn_and_reported(found, tmp_path):
    saved = json.loads(found.save(tmp_path / "discovery.json").read_text())["stand_in"]
    assert saved["tone"]["frequency"] == found.surrogate.tone.frequency
    assert (saved["variable"], saved["variable_unit"]) == ("time", "s")
    assert tmp_path / "missing-unknown.png" in draw_discovery(found, tmp_path)
    assert "a tone of" in report(found, tmp_path / "report.html").read_text()


def test_rows_that_tell_the_initial_state_are_there(found, rig):
    with pytest.raises(
        DataError, match="beginning: 9999 rows, but the shortest validation record has 663; take fewer rows"
    ):
        validate(found.base.model, rig[1], initial_rows=9999)
