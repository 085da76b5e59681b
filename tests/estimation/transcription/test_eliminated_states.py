"""Segments are condensed to the parameters alone."""

import numpy as np

from greybox.estimation.transcription.eliminated_states import LinearisedSegment, condense


def test_segments_next_to_overflow_give_no_step():
    def condensed(slope):
        segment = LinearisedSegment(
            np.ones(2), np.array([[1.0, slope], [0.5, 1.0]]), np.array([[0.3, 0.9]]), np.zeros(1)
        )
        return condense([[segment, segment]], 1)

    assert np.isfinite(condensed(2.0).hessian).all()
    assert condensed(1e160) is None  # a number, but its square is none
