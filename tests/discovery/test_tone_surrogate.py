"""A disturbance that is a tone in time gets a generator as its surrogate. The rig is simulated without greybox."""

import json

import numpy as np
import pytest

import greybox as gb
from greybox.base.errors import DataError
from greybox.discovery.decision import Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.pipeline import discover
from greybox.discovery.problem import DiscoveryProblem
from greybox.estimation.options import FitOptions
from greybox.estimation.validate import validate
from greybox.extensions.export.python_model import to_python
from greybox.shell.project import find_model
from greybox.show import report, text
from greybox.show.figures.pictures import draw_discovery
from models.micro_actuator import micro_actuator
from tests.support.hidden_rigs import AT_REST, plain_model, simulate_records
from tests.support.stand_in import find_stand_in

NOISE = {"x": 2e-7, "i": 5e-3}
FORCE, FREQUENCY = 0.05, 50.0
# One search for all of them, which takes seconds.
pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def rig():
    """Records with a hum; the second one begins at another phase of it."""
    first, second = simulate_records(
        micro_actuator, {"mains_hum": {"F": FORCE, "f": FREQUENCY}}, tuple(NOISE.values()), rows=700
    )
    return first, second.window(37, second.rows)


@pytest.fixture(scope="module")
def found(rig):
    return discover(
        plain_model(micro_actuator),
        rig[0],
        validation=rig[1],
        noise=NOISE,
        effects=[gb.effect("input_offset")],
        options=FitOptions(),
    )


def test_a_hum_is_a_tone_at_its_site_and_explains_the_gap(found):
    assert found.verdict is Verdict.UNKNOWN
    surrogate = found.surrogate
    assert (surrogate.site, surrogate.variable, surrogate.unit) == ("balance force", "time", "N")
    assert surrogate.tone.frequency == pytest.approx(FREQUENCY, abs=min(4 * surrogate.tone.std, 0.05))
    assert list(surrogate.tone.amplitude.values()) == pytest.approx([FORCE], rel=0.01)
    # Once it is steady, a force at one frequency and a wrong reading at that frequency are the same.
    assert surrogate.tone.alike == ("sensor of x",)
    # Amplitude and phase come from the first 0.083 s of the validation record; the rest is not used.
    assert surrogate.tone.beginning == pytest.approx(0.083, abs=1e-3)
    assert surrogate.explained_fraction > 0.98
    assert np.abs(surrogate.curve).max() == pytest.approx(FORCE, rel=0.01)
    # The tone explains more than what was tried of the catalogue, which does no better than the plain model and is said behind it.
    tone, beside = found.conclusion[-2:]
    assert (tone.code, beside.code) == (
        DiscoveryCode.SURROGATE_FITTED,
        DiscoveryCode.NO_LOOK_ALIKE,
    ) and not found.effects
    assert tone.values["tone"]["alike"] == ["sensor of x"]


def test_the_mains_are_suspected(found):
    codes = [step.code for step in found.next_steps]
    assert codes[-2:] == [DiscoveryCode.SUSPECT_MAINS, DiscoveryCode.USE_TONE_MODEL]
    assert found.next_steps[-2].values["mains"] == 50.0
    assert DiscoveryCode.STATE_NOISE not in codes  # it was given
    assert str(found.next_steps[0]) in " ".join(text(found, details=True).split())


def test_the_model_with_the_tone_is_fitted_to_records_at_rest_from_its_file(found, rig, tmp_path):
    model = find_model(str(to_python(found.extended, tmp_path / "model.py")))
    assert [s.name for s in model.all_states if s.free_start] == ["z1", "z2"]
    fit = gb.fit(model, rig[0], noise=NOISE, options=AT_REST)
    assert fit.misfit["x"].noise_ratio < 1.1
    begin = fit.traces[0].initial_state
    assert np.hypot(begin["z1"], begin["z2"]) == pytest.approx(FORCE, rel=0.01)
    assert (begin["x"], begin["v"]) == (0.0, 0.0)


@pytest.mark.slow
def test_a_tone_is_found_at_rest_too_and_not_where_there_is_none(rig):
    # At rest the way the tone sets in shows its site.
    model = plain_model(micro_actuator)
    hum = find_stand_in(DiscoveryProblem(model, (rig[0],), NOISE, (), AT_REST), rig[1])
    assert (hum.site, hum.tone.alike) == ("balance force", ())
    assert hum.tone.frequency == pytest.approx(FREQUENCY, abs=0.02)
    rubbing, test = simulate_records(
        micro_actuator, {"coulomb_friction": {"Fc": 0.05}}, tuple(NOISE.values()), rows=400
    )
    assert find_stand_in(DiscoveryProblem(model, (rubbing,), NOISE, (), AT_REST), test).tone is None


@pytest.mark.slow
def test_the_tone_is_written_drawn_and_reported(found, tmp_path):
    saved = json.loads(found.save(tmp_path / "discovery.json").read_text())["stand_in"]
    assert saved["tone"]["frequency"] == found.surrogate.tone.frequency
    assert (saved["variable"], saved["variable_unit"]) == ("time", "s")
    assert tmp_path / "missing-unknown.png" in draw_discovery(found, tmp_path)
    assert "a tone of" in report(found, tmp_path / "report.html").read_text()


def test_rows_that_tell_the_initial_state_are_there(found, rig):
    with pytest.raises(
        DataError, match="initial_rows: 9999 rows, but the shortest validation record has 663; take fewer rows"
    ):
        validate(found.base.model, rig[1], initial_rows=9999)
