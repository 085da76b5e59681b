"""The numbers by which identifiability is judged, and by which random experiments are made to judge it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ExcitationPolicy:
    """When an input is rich enough."""

    max_order: int = 40
    """Highest order of persistent excitation that is looked for; no model of an actuator needs more coefficients."""
    segments: int = 8
    """Parts of a record of which the median order counts, so that a single step in a long record does not."""
    min_segment_rows: int = 60
    """Fewest rows of a part; shorter records have fewer parts."""
    order_threshold: float = 1e-3
    """Size of a direction of the lagged inputs, over the largest one, from which it counts."""
    band_power: float = 0.999
    """Share of an input's movement that lies below its band."""
    min_band_share: float = 0.5
    """Band over the model's fastest motion, below which that motion hardly shows."""


@dataclass(frozen=True)
class RandomExperimentPolicy:
    """How a model is driven where there is no record: constants and inputs at random, so that nothing special is true."""

    seed: int = 1
    """Seed of the simulated record that stands in for data."""
    noise_share: float = 0.01
    """Noise of each output of that record, over its movement."""
    min_rows: int = 1000
    """Fewest rows of that record."""
    max_rows: int = 12000
    """Most rows; of a stiffer model the slow end counts, and what is faster is integrated between the samples."""
    slow_time_constants: float = 10.0
    """Length of that record in the slowest time constants of the model."""
    samples_per_time_constant: float = 2.0
    """Samples in the fastest time constant of the model."""

    constant_spread: float = math.log(2.0)
    """Free constants are drawn within a factor ``exp`` of this about their values: two."""
    tries: int = 20
    """Draws of constants before the values themselves are taken, where rules leave no room."""
    bound_margin: float = 1e-6
    """Distance of a state from its bound, as a share of its movement, from which it touches it."""

    run_rows: int = 600
    """Rows of each run whose slopes are computed."""
    run_samples_per_time_constant: float = 3.0
    """Samples in the fastest time constant of such a run."""
    run_slow_time_constants: float = 5.0
    """Slowest time constants in such a run."""
    longest_step: float = 20.0
    """Longest step of such a run in fastest time constants: a leak that takes a year is left to its beginning."""
    amplitudes: tuple[float, ...] = (1.0, 0.3, 3.0)
    """Amplitudes of the input, in its unit, one after the other."""
    large_amplitudes: tuple[float, ...] = (30.0, 1e3, 1e5, 1e7)
    """Further ones for constants that show at none of the first: a dead zone, a saturation."""
    tries_per_point: int = 3
    """Other constants that are tried where a run overflows."""
    switched_on_share: float = 0.1
    """Share of the outputs' movement that an effect makes which is off, such as a friction of zero, once it is switched on."""
    switching_rounds: int = 4
    """Rounds of switching on: some constants show only after others are on."""
    state_offset: float = 0.05
    """Share of its start value by which an initial state is off."""
    substep_factor: int = 4
    """Times as many substeps of a second run, which tells small singular values from integration error."""
    integration_doubt: float = 1e-6
    """Singular values up to this may be integration error."""
    recheck_below: float = 1e-5
    """Singular values up to this are looked at again with finer steps: integration error shrinks."""
    bound_doubt: float = 1e-3
    """Singular values up to this are doubtful where a state touches its bound."""
    interpreted_operations: int = 100
    """Directions times substeps that CasADi's virtual machine runs in less time than it takes to compile them."""

    pole_decades: float = 1.0
    """Random frequencies of a linear model reach this many decades beyond its fastest and slowest pole."""
    free_responses: int = 2
    """Free responses of a linear model, each with initial states of its own."""


@dataclass(frozen=True)
class IdentifiabilityPolicy:
    """When a constant is determined, and how far the search for formulas and remedies goes."""

    points: int = 3
    """Random points at which the rank is computed: what holds at all of them holds nearly everywhere."""
    max_relative_interval: float = 0.5
    """Half width of a 95 % interval, over the value, beyond which a constant is not determined."""
    interval_stds: float = 1.96
    """Standard deviations in half a 95 % interval."""
    prior_spread: float = math.log(10.0)
    """What is known without data, as a standard deviation of the logarithm: the order of magnitude."""
    direction_weight: float = 0.3
    """Weight of a constant in a direction of length one, from which it takes part."""

    max_subsets: int = 20000
    """Sets of constants that are tried for the sparsest directions."""
    largest_exponent: int = 6
    """Largest exponent of a combination that people would write."""
    max_terms: int = 60
    """Most terms of a coefficient of a transfer function; longer ones are unwieldy as formulas."""
    max_closing_sets: int = 5000
    """Sets of constants to fix that are tried."""
    max_relations: int = 3
    """Relations between two constants that a remedy names."""

    excitation: ExcitationPolicy = field(default_factory=ExcitationPolicy)
    """When an input is rich enough."""
    experiment: RandomExperimentPolicy = field(default_factory=RandomExperimentPolicy)
    """How a model is driven where there is no record."""


IDENTIFIABILITY_POLICY = IdentifiabilityPolicy()
EXCITATION_POLICY = IDENTIFIABILITY_POLICY.excitation
RANDOM_EXPERIMENT_POLICY = IDENTIFIABILITY_POLICY.experiment
