"""How much figures show, and from where on they show it otherwise."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DrawingPolicy:
    """How much figures show, and from where on they show it otherwise."""

    closer_look: int = 200
    """Rows of the closer look at a record's liveliest stretch."""

    shown_share: float = 0.9995
    """Share of a residual that lies within the limits of a picture: a single outlier does not flatten the rest."""

    signal_on_page: int = 25_000
    """Values of a residual that travel with a page, for the spectrum of a stretch; of a longer one the spectrum stays as it is."""

    all_signals_on_page: int = 100_000
    """The same for all residuals of a page together."""

    ranges_from_measured: float = 2.0
    """A run is cut where it lies further from the measured signal than so many times that signal's range."""

    overflow: float = 1e100
    """From this size on a run has no error worth a number."""

    typical_errors: float = 4.0
    """An axis of errors ends at so many times the largest root mean square: one model that grows away hides no other."""

    log_from: float = 10.0
    """Ratio of the largest to the smallest error from which bars have a logarithmic axis."""

    mark_beside_size: float = 17.0
    """Size of a hollow mark for a second size: a filled one stands inside it where both are equal."""

    mark_on_bar: float = 9.0
    """Size of a hollow mark for a second size, on a bar."""

    mark_of_size: float = 11.0
    """Size of the point that stands in the place of a bar on a logarithmic axis: as visible as the bar would be."""

    room_for_text: float = 0.6
    """Space behind the longest bar for its text, as a share of the bar: ``4.5 × noise`` fits into half the width of a page."""

    candidates: int = 15
    """Best candidates of a discovery that are drawn."""

    signal_in_time: int = 150
    """Values of an effect's signal that a picture shows over time."""

    nothing_missing: float = 1.05
    """Up to so many times the noise a model leaves nothing to explain."""

    correlated: float = 0.95
    """Parameters correlated more than this are called out: the records tell their ratio or product better than each."""

    lags: int = 40
    """Lags of an autocorrelation."""

    input_lags: int = 20
    """Lags of a correlation with an input, to both sides."""

    band_lags: int = 400
    """Lags that the band of a correlation with an input allows for."""

    parts: int = 20
    """Stretches of all records whose mean and spread are drawn."""

    normal_points: int = 2000
    """Points of a plot against the normal distribution."""

    confidence: float = 0.95
    """Of the band around the correlations of a residual that is white."""

    residual_share: float = 0.998
    """Share of a normalised residual within the limits of its axis."""

    uneven: float = 1e-3
    """Relative variation of the sampling time from which a record is not evenly sampled: clocks in files are rounded."""

    frequencies: int = 500
    """Of a frequency response."""

    largest_power_written_out: int = 3
    """Powers of ten up to this one are written out: 40 is read faster than 4·10¹."""

    beyond_poles: float = 20.0
    """A frequency response reaches from the slowest pole divided by this to the fastest one times this."""


DRAWING = DrawingPolicy()
