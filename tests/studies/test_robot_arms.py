"""The study of simulated arms: a few of its runs."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed")
pytest.importorskip("pinocchio", reason="example-robot-data, which comes with pin, is not installed")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["double_pendulum", "ur5", "panda"])
def test_what_hides_in_an_arm_is_named_and_weighed(name: str, tmp_path: Path) -> None:
    from fits.studies.robot_arms import study

    tally = study(name, range(2), tmp_path, hides=True)
    assert tally.named == tally.hidden and tally.wrong_as_certain == 0
    assert tally.payload < 0.02


@pytest.mark.slow
def test_nothing_is_said_of_an_arm_that_hides_nothing(tmp_path: Path) -> None:
    from fits.studies.robot_arms import study

    tally = study("double_pendulum", range(3), tmp_path, hides=False)
    assert tally.wrong == 0 and sum(tally.inside) >= 0.8 * len(tally.inside)


@pytest.mark.slow
def test_what_few_joints_have_is_named_as_well(tmp_path: Path) -> None:
    from fits.studies.robot_arms import study

    tally = study("ur5", range(2), tmp_path, hides=True, rare=True)
    assert tally.named >= 0.9 * tally.hidden and tally.wrong_as_certain == 0
