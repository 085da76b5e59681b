"""The gap between model and data on records that no constant has seen, before and after."""

from __future__ import annotations

from dataclasses import dataclass

from greybox.result import Fit, Misfit


@dataclass(frozen=True)
class HoldoutError:
    """Rms free-run misfit of one output on the validation records, before and after, beside the noise floor, in ``unit``."""

    before: float
    after: float
    floor: float
    unit: str

    @property
    def explained_fraction(self) -> float:
        """Share of the gap to the floor that was closed."""
        return (self.before - self.after) / max(self.before - self.floor, 1e-12 * self.before)

    def __str__(self) -> str:
        return f"{self.before:.4g} -> {self.after:.4g} {self.unit}".rstrip() + f" (noise {self.floor:.4g})"


def compare_holdout_errors(base: Fit, best: Fit) -> dict[str, HoldoutError]:
    """By output, from two fits judged on the same records."""
    return {name: _gap(base.validation.misfit[name], best.validation.misfit[name]) for name in base.validation.misfit}


def _gap(before: Misfit, after: Misfit) -> HoldoutError:
    return HoldoutError(before.rmse, after.rmse, before.rmse / before.noise_ratio, before.unit)
