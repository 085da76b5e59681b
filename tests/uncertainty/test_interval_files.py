"""Profiles and bootstraps are read back as they were saved."""

import numpy as np
import pytest

from greybox.errors import DataError
from greybox.uncertainty import Bootstrap, Profile, load_bootstrap, load_profile, profile
from greybox.uncertainty.policy import BootstrapPolicy, ProfilePolicy
from tests.uncertainty.test_intervals import saturation_fit


def test_a_profile_is_read_back(tmp_path):
    before = profile(saturation_fit(), "b", policy=ProfilePolicy(tolerance=0.02))
    after = load_profile(before.save(tmp_path / "new" / "b.json"))
    np.testing.assert_array_equal(after.values, before.values)
    np.testing.assert_array_equal(after.increase, before.increase)
    for name in ("name", "unit", "best", "threshold", "interval", "policy"):
        assert getattr(after, name) == getattr(before, name)


def test_an_open_side_stays_open(tmp_path):
    open_above = Profile("a", "m", 1.0, np.array([0.5, 1.0, 9.0]), np.array([np.inf, 0.0, 0.1]), 3.84, (0.7, np.inf))
    after = load_profile(open_above.save(tmp_path / "a.json"))
    assert after.interval == (0.7, np.inf) and after.open_sides == (False, True)


def test_a_bootstrap_is_read_back(tmp_path):
    names, samples = ("a", "b"), np.array([[1.0, 2.0], [1.5, 2.5]])
    interval = {"a": (0.9, 1.6), "b": (-np.inf, np.inf)}
    before = Bootstrap(names, samples, {"a": 0.3, "b": 0.3}, interval, 7, BootstrapPolicy(least_blocks=4))
    after = load_bootstrap(before.save(tmp_path / "draws.json"))
    np.testing.assert_array_equal(after.samples, samples)
    assert (after.names, after.std, after.interval, after.block, after.policy) == (
        names,
        before.std,
        interval,
        7,
        before.policy,
    )


@pytest.mark.parametrize("text", ["", "[]", '{"format": 1, "kind": "bootstrap"}', '{"format": 2, "kind": "profile"}'])
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(DataError, match="profile"):
        load_profile(path)
