"""The numbers by which a residual is tested."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ResidualTestPolicy:
    """Rules of the residual tests."""

    alarm_level: float = 0.01
    """p-value below which a test raises an alarm: one false alarm in a hundred good fits for each test."""
    whiteness_lags: tuple[int, ...] = (5, 10, 20)
    """Samples over which the residual must be uncorrelated: short, medium and long memory."""
    samples_per_whiteness_lag: int = 5
    """The test over some lags needs more samples than this many for each of them; with fewer its statistic is not chi-square."""
    input_lags: int = 20
    """Samples that an input may act before the residual."""
    samples_per_input_lag: int = 10
    """The independence test needs more samples than this many for each lag."""
    blocks: int = 8
    """Parts of all records over which variance and mean must be equal: enough for drift, few enough to be sure of each."""
    min_block_values: int = 10
    """Fewest values of a part; smaller parts are left out."""


RESIDUAL_TEST_POLICY = ResidualTestPolicy()
