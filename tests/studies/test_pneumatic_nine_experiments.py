"""The study of the nine pneumatic experiments: its stand-in against CVODES and Table 10.2, and its verdicts in short."""

import numpy as np
import pytest

from fits.papers import pneumatic_nine_experiments as study
from greybox.simulation.simulate import simulate_twin
from models.pneumatic_full import pneumatic_full

# Table 10.2: largest and smallest voltage, variance (N - 1), of each input over 100 s.
TABLE = {"u1": (4.5, -3.9878, 4.3770), "u2": (4.5, -3.9308, 3.5645), "u3": (3.5, -3.1562, 2.5637)}


@pytest.fixture(scope="module")
def truth():
    return pneumatic_full.free("b")


@pytest.mark.parametrize("name", TABLE)
def test_inputs_have_the_statistics_of_table_10_2(name):
    u = study.command(name) - study.TRIM[name]
    assert len(u) == 10001
    assert (u.max(), u.min(), u.var(ddof=1)) == pytest.approx(TABLE[name], abs=5e-5)


def test_the_stand_in_agrees_with_cvodes(truth):
    u = study.command("u2", 3.0)
    fine = study.Rig(truth).run(u)
    other = simulate_twin(truth, {"u": u}, study.SAMPLING_TIME).outputs
    np.testing.assert_allclose(fine["s"], other["s"], atol=1e-6)
    np.testing.assert_allclose(fine["p_a"], other["p_a"], atol=20.0)


def test_the_stand_in_sticks_and_slides_to_the_square_of_its_step():
    u = study.command("u3", 5.0)
    runs = [study.Rig(study.dead_band, steps).run(u)["s"] for steps in (10, 25, 200)]
    assert np.ptp(runs[-1]) > 0.02
    assert (np.diff(runs[-1]) == 0).sum() > 50  # within the dead band the piston stands still
    assert np.abs(runs[1] - runs[2]).max() < 1e-5


@pytest.mark.rest
@pytest.mark.parametrize(
    ("noisy", "measured"),
    [
        pytest.param(False, "position", marks=pytest.mark.slow),
        (False, "pressures too"),
        (True, "position"),
        pytest.param(True, "pressures too", marks=pytest.mark.slow),
    ],
)
def test_constants_come_back_from_short_records(truth, noisy, measured):
    records = study.experiments(truth, duration=10.0, repeats=1, noisy=noisy, inputs=("u1", "u2"))
    found = study.recovered(truth, study.position_only(records) if measured == "position" else records)
    assert found.success
    if noisy:
        assert study.worst_deviation(found, truth) < 3
        assert 0.9 < found.misfit["s"].noise_ratio < 1.1
        assert study.at_raised_supply(found, truth, duration=10.0, repeats=1) < 2
    else:
        assert study.worst_error(found, truth) < 0.01


@pytest.mark.slow
def test_critical_ratio_dead_band_and_friction_come_back_together():
    truth = study.dead_band.free("b")
    records = study.experiments(truth, duration=10.0, repeats=1)
    found = study.recovered(truth, records, seed=0)
    assert found.success
    assert set(found.uncertainty.free) == {"C", "b", "d", "f_v", "Fc"}
    assert study.worst_error(found, truth) < study.TOGETHER


@pytest.mark.slow
def test_the_whole_study():
    told = []
    study.main(told.append)
    assert any("of 20 starts" in line for line in told)
