"""Profiles and bootstraps are read back as they were saved."""

import json

import numpy as np
import pytest

from greybox.base.errors import DataError
from greybox.estimation.uncertainty import (
    Bootstrap,
    BootstrapPolicy,
    Profile,
    ProfilePolicy,
    load_bootstrap,
    load_profile,
    profile,
)
from tests.estimation.test_intervals import saturation_fit
from tests.support.result_schema import strict_offences


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


def write_changed(path, **changes):
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    return path


def test_files_are_as_the_schema_says(tmp_path):
    one = Profile("a", "m", 1.0, np.array([0.5, 1.0]), np.array([np.inf, 0.0]), 3.84, (0.7, np.inf))
    two = Bootstrap(("a",), np.array([[1.0], [2.0]]), {"a": 0.3}, {"a": (0.9, 1.6)}, 7)
    for value in (one, two):
        assert strict_offences(json.loads(value.save(tmp_path / "x.json").read_text()), type(value)) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": [1.0]}, "1 values and 2 rises"),
        ({"values": ["a", "b"]}, r"values\[0\] is"),
        ({"interval": [1.0]}, "interval is a list of 1"),
        ({"policy": 3}, "policy is 3"),
    ],
)
def test_a_damaged_profile_is_refused(tmp_path, changes, message):
    whole = Profile("a", "m", 1.0, np.array([0.5, 1.0]), np.array([np.inf, 0.0]), 3.84, (0.7, np.inf))
    with pytest.raises(DataError, match=message):
        load_profile(write_changed(whole.save(tmp_path / "a.json"), **changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"samples": [[1.0], [2.0, 3.0]]}, "are not those of its constants"),
        ({"names": ["b"]}, "are not those of its constants"),
        ({"samples": 5}, "samples is 5"),
        ({"std": {"a": "wide"}}, "std.a is"),
    ],
)
def test_a_damaged_bootstrap_is_refused(tmp_path, changes, message):
    whole = Bootstrap(("a",), np.array([[1.0], [2.0]]), {"a": 0.3}, {"a": (0.9, 1.6)}, 7)
    with pytest.raises(DataError, match=message):
        load_bootstrap(write_changed(whole.save(tmp_path / "a.json"), **changes))


@pytest.mark.parametrize("text", ["", "[]", '{"format": 1, "kind": "bootstrap"}', '{"format": 2, "kind": "profile"}'])
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(DataError, match="profile"):
        load_profile(path)
