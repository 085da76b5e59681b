"""Which errors end a run: those that no model, solver or compiler raises, in lines of the library itself."""

import json

import pytest

from greybox.base.errors import DataError, is_own_bug, nearest


def raise_own():
    """A sequence is asked for, in a line of the library."""
    nearest("gain", None)


def refuse():
    raise DataError("record 'a': too short")


def fail_outside():
    """In a line of another library."""
    json.loads(None)


@pytest.mark.parametrize(("run", "is_bug"), [(raise_own, True), (refuse, False), (fail_outside, False)])
def test_a_bug_is_told_from_what_models_and_other_libraries_raise(run, is_bug):
    with pytest.raises((TypeError, DataError)) as caught:
        run()
    assert is_own_bug(caught.value) is is_bug
