"""The cases of the study: what is hidden shows in the records, in every record anew where it is random."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from fits.studies.hidden_cases import FOREIGN, PERIOD, make
from fits.studies.hidden_page import knows_place
from fits.studies.rig_twins import simulate


@cache
def run_plain(rig: str, base: tuple[tuple[str, float], ...], u: tuple[float, ...]) -> np.ndarray:
    """Outputs without an effect: the cases of one seed share constants and inputs."""
    return np.array(simulate(rig, dict(base), {}, np.array(u), PERIOD[rig], 20))


@pytest.mark.parametrize("rig", FOREIGN)
@pytest.mark.parametrize("effect", FOREIGN["micro_actuator"])
def test_an_effect_that_the_catalogue_does_not_have_moves_the_records(rig: str, effect: str) -> None:
    case = make(3, "foreign", rows=80, effects=(effect,), rig=rig)
    moved = []
    for record in (case.estimation, case.validation):
        u = record.inputs["u"]
        with_effect = np.array(simulate(rig, case.base, case.effects, u, PERIOD[rig], 20))
        without = run_plain(rig, tuple(case.base.items()), tuple(u))
        assert np.isfinite(with_effect).all()
        moved.append((with_effect - without)[:, 0])
    assert all(np.abs(change).max() > 0 for change in moved)


def test_a_random_disturbance_is_another_one_in_each_record() -> None:
    case = make(3, "foreign", rows=80, effects=("random_disturbance",), rig="micro_actuator")
    silence = np.zeros(80)
    records = [silence + 1e-3, silence + 2e-3]
    runs = [np.array(simulate(case.model, case.base, case.effects, u, 2.5e-4, 20))[:, 0] for u in records]
    plain = [np.array(simulate(case.model, case.base, {}, u, 2.5e-4, 20))[:, 0] for u in records]
    first, second = (run - base for run, base in zip(runs, plain, strict=True))
    assert np.corrcoef(first, second)[0, 1] < 0.99


@pytest.mark.parametrize(
    ("sites", "effects", "expected"),
    [(["balance force", "input u"], [], True), (["sensor of s"], [], False), ([], ["u"], True)],
)
def test_a_place_is_known_by_its_label_or_by_what_acts_there(
    sites: list[str], effects: list[str], expected: bool
) -> None:
    answer = {"left_out": True, "sites": sites, "effects": [{"site": site} for site in effects]}
    assert knows_place({"answers": [answer], "true_sites": ["u"]}) is expected
