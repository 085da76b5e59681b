"""The numbers that steer change detection."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class ChangeTestPolicy:
    """How rarely a machine that is as it was is called changed, and how that rate is shared out."""

    false_alarm_rate: float = 0.01
    """Share of healthy comparisons that are called changed, over everything that is looked at."""

    residual_share: float = 0.2
    """Share of this rate that goes to the tests of the residual (has it grown, is it no longer white); the rest goes to the constants."""

    draws: int = 40_000
    """Draws of the null distribution of the constants' tests: the limit at 1 % is then known to 5 % of itself."""

    counted_draws: int = 20
    """Draws beyond what was seen from which their share counts as the p-value; with fewer it is bounded from the distributions' tails."""

    seed: int = 0
    """Of these draws: the same records give the same p-values."""

    interval_level: float = 0.95
    """Probability that all intervals of a comparison hold together."""

    named_weight: float = 0.1
    """Share of the largest entry of a combination from which a constant is named in it."""

    lags: int = 20
    """Lags at most over which the residual's autocorrelation is summed (Ljung and Box) ..."""

    rows_per_lag: int = 10
    """... with so many rows at least for each lag."""

    adequate_ratio: float = 1.1
    """Misfit over noise up to which a fit leaves only noise, whatever the colour of that: its residual is a yardstick for today's."""


@dataclass(frozen=True)
class SensitivityPolicy:
    """When records say something of a constant."""

    largest_hidden_change: float = 0.5
    """Share of its value by which a constant may have changed unnoticed; beyond it the records cannot tell, as an interval that wide
    determines nothing."""

    power: float = 0.95
    """Probability with which a change of the size that counts as seen is seen."""


@dataclass(frozen=True)
class ScatterPolicy:
    """How the scatter of constants is measured where a model lacks something."""

    pieces: int = 8
    """Pieces of the fit's records at least: their variance is known to half of itself."""

    least_pieces: int = 4
    """Fewer pieces that determine the constants say nothing of their scatter."""

    repeated_input: float = 0.1
    """Rms difference of two inputs over their size up to which one repeats the other: what the model lacks then acts alike in both."""

    least_rows: int = 50
    """Rows of a piece at least; a shorter record stays whole."""


@dataclass(frozen=True)
class PopulationPolicy:
    """Several machines of one kind."""

    least_machines: int = 4
    """Fewer say nothing of a spread."""

    largest_outlying_share: float = 0.34
    """Share of the machines that may fall out; where more would, there is no kind to fall out of."""


@dataclass(frozen=True)
class ChartPolicy:
    """A machine over many records."""

    least_records: int = 4
    """Fewer show no course."""

    least_stretch: int = 1
    """Records in a stretch between change points at least: today's record alone may be the first after a change."""

    draws: int = 4000
    """Courses without a change that are drawn for the distribution of the largest jump."""

    seed: int = 0
    """Of these draws."""


@dataclass(frozen=True)
class ChangePolicy:
    """Everything that steers `detect_changes`, `survey_population` and `chart_changes`."""

    test: ChangeTestPolicy = field(default_factory=ChangeTestPolicy)
    sensitivity: SensitivityPolicy = field(default_factory=SensitivityPolicy)
    scatter: ScatterPolicy = field(default_factory=ScatterPolicy)
    population: PopulationPolicy = field(default_factory=PopulationPolicy)
    chart: ChartPolicy = field(default_factory=ChartPolicy)
