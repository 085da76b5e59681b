"""Numbers that the catalogue decides with: where a search for an effect begins, and at which values an effect is absent."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StartingValues:
    """Where a search for an effect begins, measured by the `Scales` of a record."""

    visible_share: float = 0.02
    """Share of the largest force: an effect of this size is visible in a good record and small enough to be nearly linear."""
    friction_ratios: tuple[float, float, float] = (1.2, 1.6, 2.4)
    """Friction at standstill over friction while sliding: about 1.2 for dry metal, up to 2.5 for seals and grease."""
    mean_load: float = 0.5
    """Mean of the transmitted force over the largest one."""
    second_mass: float = 0.04
    """Of the moving mass: a second mass of this size is visible but small."""
    second_damping: float = 0.02
    """Damping of a second mode as a ratio of critical damping: metal structures have 0.002 to 0.03."""
    overflow_edges: tuple[float, ...] = (0.95, 0.8, 0.65, 0.5, 0.35, 0.25)
    """Edges over which a tank may run, as shares of the highest level of the record, the faintest first."""
    overflow_rate: float = 0.1
    """Rate of an overflow to start from, per sampling period."""
    fastest_overflow: float = 4.0
    """Largest rate of an overflow, per sampling period: faster than the samples follow, an edge is an edge."""
    longest_delay: float = 16.0
    """Longest delay that is considered, in sampling periods: a longer one is seen with the naked eye."""
    gain_share: float = 0.2
    """Difference of the gain by sign that a search starts from beside a constant load, as a share."""
    stop_edges: tuple[float, ...] = (0.85, 0.6, 0.3)
    """Where an end stop may begin, as shares of the way from the middle of the travel to its end, the faintest first."""
    stop_depth: float = 0.3
    """Share of the travel that a body goes into a stop of visible size."""
    nearest_stop: float = 0.05
    """Share of the travel within which no stop is looked for about zero, and beyond its ends."""
    cogging_periods: tuple[float, ...] = (2, 2.33, 2.67, 3, 3.5, 4, 4.5, 5, 6, 7, 8, 9, 10, 12, 14, 16)
    """Periods of a periodic force over the travel of the record that a search starts from. A refit finds the pitch only next to its start,
    so they are close."""
    seen_pitches: tuple[float, ...] = (1.0, 0.99, 1.01, 0.98, 1.02)
    """Pitches that it starts from where the residual repeats over the position, over the period seen: each refit stays at the minimum next
    to its start."""
    fewest_cogging_periods: float = 1.5
    """Fewest periods over the travel: with fewer a sinusoid imitates any curve of the position."""
    laminar_share: float = 1e-3
    """Share of the largest pressure below which a leak is laminar: the root has no slope at zero."""
    zero_celsius: float = 273.15
    """Zero of the Celsius scale (K)."""
    warmest_celsius: float = 200.0
    """A temperature whose peak is below this is in degrees Celsius: nothing that is modelled here runs that cold in kelvin."""
    least_excess: float = 1e-3
    """Share of the largest temperature below which convection counts as proportional: its power has no slope at zero excess."""
    ripples: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
    """Periods of a torque a revolution that a search starts from: an unbalance, pairs of poles, slots."""
    brush_current: float = 0.02
    """Share of the largest current within which the drop of a contact builds up."""
    bounds_reach: float = 1000.0
    """How far the bounds of a shape parameter reach beyond its start values, as a factor either way."""
    rows: int = 5000
    """Rows of a record that the scales are taken from, evenly spread."""


@dataclass(frozen=True)
class NeutralValues:
    """Values at which an effect is absent that has no natural zero."""

    coupling: float = 1e-9
    """Stiffness (N/m) and damping (N s/m) between two bodies that do not feel each other. Positive, so that a refit sees a change of mass,
    stiffness and damping by the same factor as a straight line."""
    least_coupling: float = 1e-12
    """Lower bound of that stiffness and damping."""
    lag: float = 1e-8
    """Time constant (s) of a lag that no record shows."""
    out_of_reach: float = 1e6
    """A limit, in the unit of the signal, that no record reaches."""


@dataclass(frozen=True)
class FlowLimits:
    """What keeps the equations of a valve and two chambers finite where a trial step of a fit leaves the physical range."""

    laminar: float = 0.01
    """Square of the flow function below which the flow is laminar: the root has no slope where both pressures are equal."""
    least_volume: float = 0.01
    """Smallest volume of a chamber, as a share of half the total volume."""
    least_pressure: float = 0.01
    """Smallest pressure of a chamber, as a share of the ambient pressure."""


START = StartingValues()
NEUTRAL = NeutralValues()
FLOW_LIMITS = FlowLimits()
UNTAILORED_DELAY = (0.0, 5e-3)
"""Bounds of a delay (s) before a record says how it is sampled."""
