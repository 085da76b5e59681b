"""Which errors end a run: those that no model, solver or compiler raises, in lines of the library itself."""

import json
import zlib
from functools import partial

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


def fail_in_compiled_code():
    """Called in a line of the library."""
    nearest("gain", Undecodable())


class Undecodable:
    """Names that fail as compiled code does, which has no line of its own."""

    __iter__ = staticmethod(partial(zlib.decompress, b"damaged"))


CASES = [(raise_own, True), (refuse, False), (fail_outside, False), (fail_in_compiled_code, False)]


@pytest.mark.parametrize(("run", "is_bug"), CASES)
def test_a_bug_is_told_from_what_models_and_other_libraries_raise(run, is_bug):
    with pytest.raises((TypeError, DataError, zlib.error)) as caught:
        run()
    assert is_own_bug(caught.value) is is_bug
