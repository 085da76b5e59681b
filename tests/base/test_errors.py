"""Which errors end a run: those that no model, solver or compiler raises, and in lines of the library itself a wrong shape."""

import json
import zlib
from functools import partial

import numpy as np
import pytest
from scipy import linalg

from greybox.base.errors import DataError, is_numerical, is_own_bug, nearest
from greybox.base.linear_algebra import are_independent, decompose_columns


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


def test_a_wrong_shape_in_lines_of_the_library_is_a_bug_and_no_result():
    cases = (np.zeros(3), decompose_columns, "unpack"), ([[1.0], [1.0, 2.0]], are_independent, "inhomogeneous")
    for matrix, library, words in cases:
        with pytest.raises(ValueError, match=words) as caught:
            library(matrix)
        assert not is_numerical(caught.value), library


@pytest.mark.parametrize(
    "run",
    [
        partial(decompose_columns, np.full((2, 2), np.nan)),
        partial(linalg.cho_factor, np.full((2, 2), np.nan)),
        partial(np.asarray_chkfinite, [np.inf]),
        partial(linalg.solve, np.zeros((2, 2)), np.zeros(3)),
        partial(float, "of a user's function"),
        refuse,
    ],
)
def test_what_numbers_and_the_functions_of_users_raise_is_a_result(run):
    with pytest.raises((ValueError, DataError)) as caught:
        run()
    assert is_numerical(caught.value)
