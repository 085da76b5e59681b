"""The decision numbers of a search for laws."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawPolicy:
    """Which terms are built, how many are tried, and when one of them is the law."""

    most_degree: int = 3
    """Degree of the largest product of several variables."""
    most_power: int = 5
    """Highest power of one variable alone."""
    shape_places: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)
    """Where constants of shape are tried, in multiples of the variable's rms: a term changes little between neighbours."""
    threshold_places: tuple[float, ...] = (0.15, 0.35, 0.5, 0.65, 0.85)
    """Where thresholds are tried, as quantiles of the variable."""
    lag_places: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
    """Where time constants of memory are tried, as shares of the record."""
    memory_complexity: int = 2
    """Largest complexity of a term that is tried with memory."""
    least_reciprocal: float = 0.05
    """Least size of a variable over its largest from which one over it is a term: beyond that it is singular within the record."""
    intensities: tuple[float, ...] = (0.01, 0.1, 1.0, 10.0)
    """Process noise of the observer that is tried, in standard deviations of a state over the whole record: the likeliest is taken."""
    finer_intensities: tuple[float, ...] = (1e-4, 1e-3, 0.01, 0.1, 1.0)
    """The same once a term is in the model, which may leave nothing to the process noise."""
    constant_spread: float = 0.4
    """Standard deviation of the plain model's constants before the records are seen, over their values: the observer does not take them
    further than the records ask."""
    unknown_spread: float = 100.0
    """The same for constants of which nothing is known, over their values and at least over 1."""
    settled_decrease: float = 0.5
    """Decrease of minus twice the log-likelihood below which the observer's constants stand still."""
    terms_at_once: int = 1000
    """Terms that are propagated through the observer at once: what fits into the cache and into memory."""
    most_substeps: int = 8
    """Runge-Kutta steps a row that the observer takes at most."""
    simple_complexity: int = 4
    """Complexity up to which a term counts as simple: such terms have a third of the places that are run through the observer."""
    observer_steps: int = 4
    """Gauss-Newton steps of the plain model's constants in the observer."""
    term_steps: int = 3
    """The same with a term in the model."""
    unseen_draws: int = 12
    """Where a state has no sensor: other constants and first states from which the terms are ranked as well."""
    unseen_spread: float = 0.5
    """Standard deviation of the first states that are drawn, over their values."""
    unseen_steps: int = 10
    """Gauss-Newton steps in the observer with a term in the model where a state has no sensor: its start is a guess."""
    most_rows: int = 600
    """Rows of a record that the observer runs over; of longer records every second, third... row."""
    most_driven_rows: int = 1500
    """The same of a record with inputs: between rows that are skipped their mean acts, which a fast part of the plant does not believe."""
    observed_terms: tuple[int, ...] = (18, 24)
    """Terms that are run through the observer after the linear ranking, those that promise most first; the next batch only where none of
    the one before leaves mere noise."""
    leading_decrease: float = 100.0
    """Of these a term is refitted only if its objective there (minus twice the log-likelihood) is within this of the best."""
    rival_decrease: float = 30.0
    """The same once a term leaves only noise: others are refitted that may do so as well."""
    refitted_terms: int = 10
    """Terms that are refitted by simulation after that."""
    refit_iterations: int = 40
    """Iterations of such a refit."""
    starting_laws: int = 1
    """Single terms beside which a second one is looked for."""
    second_terms: int = 4
    """Second terms that are refitted beside each of these."""
    finished_laws: int = 6
    """Laws that are refitted to the end and judged on the validation records."""
    finish_iterations: int = 80
    """Iterations of that."""
    complexity_cost: float = 4.0
    """What one unit of complexity costs in Schwarz's criterion: of the many terms that could be written, complicated ones fit by chance."""
    clean_score: float = 1.15
    """Rms error over noise on the validation records, constants moved within their uncertainty, up to which a law leaves only noise."""
    same_error: float = 0.1
    """Laws whose error on the validation records is within this share of the least do as well."""
    least_share: float = 0.5
    """Share of the plain model's error on the validation records that a law must take away."""
    established_share: float = 0.9
    """The same for a law that counts as established where it does not reach the noise."""
    curve_heights: int = 9
    """Heights of the free curve that stands in the place of a law's factor."""
    curve_iterations: int = 25
    """Iterations of its refit."""
    curve_gain: float = 0.25
    """Share of the law's error on the validation records that a free curve must take away to beat it."""
