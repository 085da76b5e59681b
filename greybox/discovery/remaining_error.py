"""What a model leaves on the validation records: how much, where it comes from and what it depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.discovery.dependence import Dependence
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.policy import EvidencePolicy
from greybox.numerics import TINY
from greybox.result import Fit
from greybox.values import Printable


@dataclass(frozen=True)
class RemainingError(Printable):
    """The error that a model leaves in one output.

    Parameters
    ----------
    output, rmse, unit
        Rms error on the validation records, in ``unit``.
    noise_ratio
        The same over the noise; None where nobody knows the noise.
    sites
        Labels of the likeliest sites that it comes from; empty where none explains it.
    dependence
        The missing signal there as a function of the variable that it depends on most; None where it depends on none.
    grows_with_amplitude
        Whether it is larger where the output moves more.
    """

    output: str
    rmse: float
    unit: str
    noise_ratio: float | None
    sites: tuple[str, ...]
    dependence: Dependence | None
    grows_with_amplitude: bool

    def to_values(self) -> dict[str, Any]:
        """What it says, ready for a finding."""
        return {
            "rmse": self.rmse,
            "unit": self.unit,
            "noise_ratio": self.noise_ratio,
            "sites": list(self.sites),
            "dependence": None if self.dependence is None else self.dependence.to_values(),
            "grows_with_amplitude": self.grows_with_amplitude,
        }


def measure_remaining_error(
    fit: Fit,
    holdout: Mapping[str, HoldoutError],
    location: ResidualLocalisation,
    uncounted: int,
    policy: EvidencePolicy,
) -> Mapping[str, RemainingError]:
    """By output what a model leaves.

    Parameters
    ----------
    fit, holdout
        The validated fit, and its errors on the validation records.
    location
        That of its residual on the estimation records.
    uncounted
        Rows at the start of each validation record that do not count.
    policy
        From when on an error grows with the amplitude.
    """
    relevant = next((d for d in location.dependences if d.is_relevant), None)
    return {
        name: RemainingError(
            name,
            error.after,
            error.unit,
            error.after / error.floor if error.is_floor_known else None,
            location.likeliest,
            relevant,
            _grows_with_amplitude(fit, name, uncounted, policy),
        )
        for name, error in holdout.items()
    }


def _grows_with_amplitude(fit: Fit, output: str, uncounted: int, policy: EvidencePolicy) -> bool:
    """Whether the error of blocks of the validation records rises with the movement of the output there."""
    errors, movements = [], []
    for trace in (t for t in fit.validation.traces if output in t.measured):
        residual, measured = trace.residual(output)[uncounted:], trace.measured[output][uncounted:]
        pieces = max(policy.blocks // max(len(fit.validation.traces), 1), 2)
        for part, signal in zip(np.array_split(residual, pieces), np.array_split(measured, pieces), strict=True):
            present = np.isfinite(part)
            if present.sum() > 1:
                errors.append(float(np.sqrt(np.mean(part[present] ** 2))))
                movements.append(float(np.std(signal[present])))
    if len(errors) < policy.least_blocks or max(movements) < policy.amplitude_range * max(min(movements), TINY):
        return False
    ranks = np.array([np.argsort(np.argsort(values)) for values in (errors, movements)], float)
    return bool(np.corrcoef(ranks)[0, 1] > policy.amplitude_correlation)
