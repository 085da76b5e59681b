"""Base parameters: as many as are published, and all that torques show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from greybox.extensions.robot import RigidBody, find_base_parameters, read_robot
from tests.support.robots import (
    CENTRES,
    DOUBLE_PENDULUM,
    INERTIAS,
    LENGTH,
    MASSES,
    find_description,
    random_states,
    write,
)


def test_a_double_pendulum_has_six_and_they_are_those_of_the_textbook(tmp_path: Path) -> None:
    base = find_base_parameters(read_robot(write(tmp_path / "a.urdf", DOUBLE_PENDULUM)))
    assert dict(zip(base.names, base.units, strict=True)) == {
        **{"mx1": "kg m", "mz1": "kg m", "Iyy1": "kg m^2"},
        **{"mx2": "kg m", "mz2": "kg m", "Iyy2": "kg m^2"},
    }
    (m1, m2), (c1, c2), (i1, i2) = MASSES, CENTRES, INERTIAS
    # Spong: what the torques show of the first link is i1 + m1 c1^2 + m2 l^2 and m1 c1 + m2 l.
    expected = (0, -m1 * c1 - m2 * LENGTH, i1 + m1 * c1**2 + m2 * LENGTH**2, 0, -m2 * c2, i2 + m2 * c2**2)
    np.testing.assert_allclose(sorted(base.values), sorted(expected), rtol=0, atol=1e-12)
    assert base.describe(base.names.index("Iyy1")) == "Iyy1 + 0.25 m2"


@pytest.mark.parametrize(
    ("name", "held", "rank"),
    [
        ("double_pendulum_description/urdf/double_pendulum.urdf", (), 6),
        ("ur_description/urdf/ur5_robot.urdf", (), 36),
        ("panda_description/urdf/panda.urdf", ("panda_finger_joint1",), 43),
    ],
)
def test_there_are_as_many_as_are_published(name: str, held: tuple[str, ...], rank: int) -> None:
    """UR5: Kovincic and others, 2019; Panda: Gaz and others, IEEE Robotics and Automation Letters 4, 2019."""
    robot = read_robot(find_description(name)).lock(dict.fromkeys(held, 0.0))
    base = find_base_parameters(robot)
    assert len(base.names) == rank
    states = random_states(robot)
    Y = RigidBody(robot).compute_regressors(*states)
    np.testing.assert_allclose(Y[:, :, base.columns] @ base.values, Y @ robot.inertial, rtol=0, atol=1e-5)
