"""Codes of what a black-box model has to say about itself."""

from __future__ import annotations

from enum import StrEnum


class BlackBoxFinding(StrEnum):
    """Findings about a black-box model; their sentences are in `greybox.rendering.blackbox`."""

    WEAK_EXCITATION = "weak_excitation"
    """An input is persistently exciting of a lower order than the structure needs."""
    UNSTABLE = "black_box_unstable"
    """A pole lies on or outside the unit circle."""
    SEARCH_UNFINISHED = "black_box_search_unfinished"
    """The search used up its iterations before it converged."""
    SMOOTHING_FEEDTHROUGH = "smoothing_feedthrough"
    """The smoothed step response jumps at the step, as a delayed one does in its first rows."""
    SMOOTHING_AT_INTERVAL_END = "smoothing_at_interval_end"
    """The best draw of a constant is the outermost of its interval."""
    SMOOTHING_ABOVE_SPECIFICATION = "smoothing_above_specification"
    """The mean square error exceeds the specification."""
