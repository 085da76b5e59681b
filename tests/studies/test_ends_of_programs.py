"""Programs that fit and end at random moments: ``fits/benchmarks/ends.py`` runs as many as are asked for."""

import pytest

from fits.benchmarks import ends


@pytest.mark.slow
def test_none_of_a_hundred_programs_ends_in_the_wrong_way():
    assert ends.main(["--programs", "100", "--seed", "1"]) == 0
