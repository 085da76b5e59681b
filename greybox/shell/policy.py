"""Limits and defaults of the command line that decide what is accepted and what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class CommandPolicy:
    """What a command accepts, and what it adds without being asked."""

    unasked_prediction_rows: int = 50_000
    """Rows up to which the error one sample ahead is shown without being asked for: longer records would make the user wait."""
    minimum_validation_rows: int = 10
    """Rows of a validation record that must be left after ``--skip``: fewer give no meaningful error."""
    minimum_replicates: int = 100
    """Replicates of a bootstrap: with fewer, each end of a 95 % interval rests on two or three of them."""
    bootstrap_seed: int = 0
    """Seed of the bootstrap's draws: the same command prints the same intervals."""
    maximum_study_bytes: int = 1_000_000
    """Size of a study file: a thousand times what a long one has."""
    maximum_simulated_rows: int = 10_000_000
    """Rows of a simulated test signal; more would fill the memory before a word is written."""


@dataclass(frozen=True)
class ProgressPolicy:
    """What the line that shows the progress expects of a command. It decides nothing else."""

    patience: float = 1.0
    """Seconds before the line appears: short commands stay quiet."""
    line_seconds: float = 10.0
    """Seconds between two lines where there is no terminal: a log says that the command lives, and is not filled."""
    usual_iterations: int = 15
    """Iterations that a stage of a fit usually takes."""
    usual_refits: int = 40
    """Refits that a discovery usually takes."""
    minimum_share: float = 0.02
    """Share that must be done before the time left is shown: below it the extrapolation is a guess."""
    scan_times: Mapping[str, float] = field(
        default_factory=lambda: {"arx": 8, "armax": 40, "output error": 33, "box-jenkins": 6, "hammerstein": 13}
    )
    """Relative time that the scan of each kind of black box usually takes."""


COMMANDS = CommandPolicy()
PROGRESS = ProgressPolicy()
