"""Decisions of black-box estimation: how hard to search, which structures to try, and what counts as good enough."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from greybox.estimation.optim.policy import GaussNewtonPolicy, TerminationPolicy


@dataclass(frozen=True)
class PredictionErrorPolicy:
    """How hard a prediction-error model is searched for (ARMAX, output error, Box-Jenkins, Hammerstein)."""

    starts: int = 3
    """Starting points that are followed, best first. The linear estimates seldom disagree more than threefold."""
    first_iterations: int = 8
    """Iterations from each start; after these only the best goes on. Enough to tell basins apart."""
    iterations: int = 100
    """Iterations of the final search. A quadratically converging search needs about ten."""
    duplicate: float = 1e-3
    """Relative difference of two starts' sums of squares below which they are the same start."""
    long_order: int = 12
    """Least order of the long ARX model whose innovations and impulse response the starts are made of."""
    long_order_factor: int = 3
    """Order of the long ARX model over that of the structure, where this is larger."""
    rows_per_long_order: int = 10
    """Measured values for each coefficient of the long ARX model, at least: more coefficients would fit noise."""
    filter_passes: int = 8
    """Passes of Steiglitz and McBride's filter."""
    innovation_passes: int = 4
    """Passes of the pseudo-linear regression on the innovations (Hannan and Rissanen 1982)."""
    impulse_rows: int = 60
    """Least number of impulse-response samples that are realised as a state space."""
    impulse_rows_per_pole: int = 12
    """Impulse-response samples for each pole, where this is more."""
    termination: TerminationPolicy = field(
        default_factory=lambda: TerminationPolicy(
            negligible_decrease=1e-12, perfect_noise_ratio=0.0, patience=1, little_gain=1e-12
        )
    )
    """When a search ends: a millionth of a standard deviation gives the coefficients their digits. The errors are in the output's unit, so
    that none is small by itself."""
    damped: GaussNewtonPolicy = field(
        default_factory=lambda: GaussNewtonPolicy(initial_damping=1e-4, max_rejections=10, max_kink_steps=100)
    )
    """How its steps are damped. Starts are far off, and there are no kinks."""


@dataclass(frozen=True)
class StructureScanPolicy:
    """Which structures are tried, on which rows, and which of the good ones is chosen."""

    search: PredictionErrorPolicy = field(
        default_factory=lambda: PredictionErrorPolicy(
            starts=2,
            first_iterations=4,
            iterations=15,
            termination=TerminationPolicy(
                negligible_decrease=1e-2, perfect_noise_ratio=0.0, patience=1, little_gain=1e-6
            ),
        )
    )
    """Search while scanning: enough to rank structures."""
    final_search: PredictionErrorPolicy = field(default_factory=PredictionErrorPolicy)
    """Search for the chosen structure."""
    initial_rows: int = 50
    """Rows of a validation record that determine the initial state, where no ``skip`` is given."""
    as_good: float = 0.005
    """Relative difference of free-run errors within which the simpler structure is chosen."""
    largest_poles: int = 6
    """Most poles of an ARX model, which is a linear problem."""
    largest_searched_poles: int = 4
    """Most poles of a structure that needs an iterative search."""
    first_delays: tuple[int, ...] = (0, 1, 2)
    """Delays in samples that are always tried."""
    largest_delay: int = 40
    """Longest delay in samples that is looked for."""
    rows_per_delay: int = 20
    """Rows of the shortest record for each sample of delay, at least."""
    scanned_rows: int = 20_000
    """Rows of all records that a scan uses; the chosen structure is fitted to all."""
    holdout_share: float = 0.3
    """Share of a single record, its end, that is held out for validation."""
    holdout_excitation: float = 0.3
    """The end of a record validates if an input still moves there by this share of its earlier range."""
    holdout_values: int = 60
    """Measured values that such an end must hold."""
    nonlinearities: Mapping[str, tuple[int, ...]] = field(
        default_factory=lambda: {"polynomial": (2, 3, 5), "piecewise": (3, 5)}
    )
    """Basis sizes that are tried for each shape of a static nonlinearity."""


@dataclass(frozen=True)
class RoundingPolicy:
    """When a model with rounded coefficients still behaves like the original."""

    fewest_digits: int = 2
    """Significant digits below which nobody rounds."""
    most_digits: int = 15
    """Significant digits of a double."""
    response_change: float = 0.01
    """Relative change of the frequency response that rounding may cause."""
    frequencies: int = 200
    """Frequencies at which the response is compared."""
    shortest_record: int = 1000
    """The lowest frequency is one line of a record of at least this many samples."""


@dataclass(frozen=True)
class SmoothingPolicy:
    """How Monte-Carlo smoothing sets its intervals and when it stops adjusting them."""

    fewest_rows: int = 32
    """Rows after the step that are needed for a spectrum and a final value."""
    improvement: float = 0.02
    """Share by which another adjustment of the intervals must lower the mean square error."""
    tail: int = 4
    """The last ``1 / tail`` of the record shows the final value."""
    above_floor: float = 4.0
    """An envelope counts while it is this many times what is left of it at the end."""
    persistent: float = 0.5
    """Share of the largest deviation that an oscillation which does not decay must have."""
    decay_factor: float = 1.6
    """Factor by which the estimated decay may be off either way."""
    ratio_factor: float = 1.25
    """Factor by which the estimated ratio may be off either way."""
    well_inside: float = 0.8
    """Share of an interval within which a best draw allows the interval to be halved."""
    lower_end: float = 1e-9
    """Frequency, decay and ratio stay above this share of their interval's upper end."""
    level_spread: float = 0.01
    """Half width of the amplitude's interval, relative, where the tail is constant."""
    hidden_decay: float = 0.1
    """Least decay, over the inverse of the record's length, where the oscillation does not decay within the record."""
    fewest_periods: int = 3
    """Periods that are needed to see an oscillation decay."""


DEFAULT_SEARCH = PredictionErrorPolicy()
DEFAULT_SCAN = StructureScanPolicy()
DEFAULT_ROUNDING = RoundingPolicy()
DEFAULT_SMOOTHING = SmoothingPolicy()


@dataclass(frozen=True)
class SubspacePolicy:
    """How a state-space model is found by projection."""

    horizon: int = 15
    """Rows of past and of future: several times the order over the number of outputs."""
    least_horizon: int = 3
    """Fewest rows of past and of future that show a state."""
    columns_per_row: int = 3
    """Columns of the data matrices for each of their rows, at least: fewer and noise is projected as well."""
    largest_order: int = 20
    """Highest order that is chosen by itself."""
    zero_share: float = 1e-6
    """A singular value below this share of the first is rounding: records without noise show their order so."""


DEFAULT_SUBSPACE = SubspacePolicy()
