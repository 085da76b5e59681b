"""What stands in for effects that the catalogue does not have, and what is said then. The rigs are simulated without greybox."""

import re

import numpy as np
import pytest

import greybox as gb
from greybox.discovery import DiscoveryProblem
from greybox.discovery.localisation import localise_candidate_residual
from greybox.discovery.recommendations import recommend_next_steps, recommend_noise_check
from greybox.discovery.surrogate import fit_curve_surrogate
from greybox.estimation import FitOptions
from greybox.transcription.condensing import LinearisedSegment, condense
from models.micro_actuator import micro_actuator
from models.pneumatic_cylinder import pneumatic_cylinder
from tests.discovery.test_discover import off, records

REST = FitOptions(at_rest=True)


def standing_in(rig, effects, noise, rows):
    """The plain fit, what it leaves over, what stands in for that, and the record to judge by."""
    train, test = records(rig, effects, tuple(noise.values()), rows=rows)
    base = gb.fit(off(rig), train, validation=test, noise=noise, options=REST)
    bench = DiscoveryProblem(off(rig), (train,), noise, (), REST)
    look = localise_candidate_residual(bench.base)
    return base, look, fit_curve_surrogate(bench, bench.base, look, (test,), base), test


def test_a_force_that_repeats_with_the_position_is_told_by_its_period():
    base, look, found, test = standing_in(
        pneumatic_cylinder, {"cogging": {"F": 4.0, "pitch": 0.01}}, {"s": 2e-4}, rows=700
    )
    assert look.where[0] == "balance force"
    assert (look.dependences[0].variable, look.dependences[0].period) == ("s", pytest.approx(0.01, rel=0.02))
    pitch = found.fit.parameters["pitch"]
    assert abs(pitch.value - 0.01) < min(4 * pitch.std, 1e-4)
    assert found.explained_fraction > 0.95
    assert np.abs(found.curve).max() == pytest.approx(4.0, rel=0.05)
    assert re.match(
        r"a sinusoid over s \(every 0\.0[01]\d* m, of [34]\.?\d* N\) at the balance force closes", str(found)
    )
    said = " ".join(recommend_next_steps(base, look, found, (test,)))
    assert "what repeats with the position comes from magnets, teeth" in said
    assert "p_a and p_b" not in said  # enough is known without them


def test_a_stop_is_told_by_the_position_where_it_begins():
    _, _, found, _ = standing_in(
        micro_actuator, {"end_stop": {"gap": 4e-5, "kc": 6000.0}}, {"x": 2e-7, "i": 5e-3}, rows=600
    )
    assert (found.variable, found.explained_fraction > 0.9) == ("x", True)
    assert found.shape.startswith("odd, with a flat middle (to about ")
    assert float(found.shape.split()[-3 if "downwards" in found.shape else -2]) == pytest.approx(4e-5, rel=0.1)


def test_a_record_that_reaches_beyond_what_is_known_is_named():
    base, look, found, test = standing_in(
        pneumatic_cylinder, {"cogging": {"F": 4.0, "pitch": 0.01}}, {"s": 2e-4}, rows=300
    )
    far = gb.Experiment("far", test.time, test.inputs, {"s": 3 * test.outputs["s"]})
    assert "learn from records that cover the whole range" in " ".join(recommend_next_steps(base, look, found, (far,)))
    same = base.traces[0].experiment
    none = " ".join(recommend_next_steps(base, look, None, (same,)))
    assert "measure p_a and p_b as well" in none
    assert "record the same motion slowly and fast" in none
    near = recommend_next_steps(base, look, None, (same,), "coulomb_friction")
    assert near[0].startswith("go on with coulomb_friction and look for what takes a share of the rest")
    assert "slowly and fast" not in " ".join(near)


def test_a_noise_that_nobody_told_is_doubted_where_nothing_seems_missing():
    train, _ = records(pneumatic_cylinder, {}, (2e-4,), rows=300)
    guessed = gb.fit(off(pneumatic_cylinder), train, options=REST)
    assert recommend_noise_check(guessed)[0].startswith("check that the sensors have a noise of ")
    assert recommend_noise_check(gb.fit(off(pneumatic_cylinder), train, noise={"s": 2e-4}, options=REST)) == ()


def test_segments_next_to_overflow_have_no_step():
    def reduced(slope):
        seen = LinearisedSegment(np.ones(2), np.array([[1.0, slope], [0.5, 1.0]]), np.array([[0.3, 0.9]]), np.zeros(1))
        return condense([[seen, seen]], 1)

    assert np.isfinite(reduced(2.0).hessian).all()
    assert reduced(1e160) is None  # a number, but its square is none
