"""A finished selection, judged: the plain and the extended model on the records that neither was fitted to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from greybox.base import Check
from greybox.discovery.decision import visible_rms_limit
from greybox.discovery.holdout import VISIBLE_RMS, HoldoutError, HoldoutScores, worst_output
from greybox.discovery.laws.terms import claimed_name
from greybox.discovery.problem import FittedCandidate
from greybox.discovery.residual_noise import is_shape_correction
from greybox.discovery.selection import StepwiseSelection
from greybox.discovery.table import FitTable
from greybox.estimation import Fit
from greybox.model import Effect, Model


@dataclass(frozen=True)
class JudgedSelection:
    """A finished selection and its error on the validation records.

    Parameters
    ----------
    selection
        The selection with its candidates and its path.
    selected
        The model that it ended with, before its shape was corrected.
    rivals
        Models that explain the records equally well.
    base, best
        The plain and the extended model as fits that were validated.
    holdout
        Error of both on the validation records, by output.
    table
        The sets that are weighed on these records.
    plain
        The model as the user gave it.
    checks
        Every check of the selection and of the rejection on the validation records.
    """

    selection: StepwiseSelection
    selected: FittedCandidate
    rivals: Sequence[FittedCandidate]
    base: Fit
    best: Fit
    holdout: Mapping[str, HoldoutError]
    table: FitTable
    plain: Model
    checks: tuple[Check, ...]

    @property
    def scores(self) -> HoldoutScores:
        """The validation records, with every candidate that was run there."""
        return self.table.scores

    @property
    def baseline(self) -> FittedCandidate:
        """The fit of the plain model."""
        return self.selection.baseline

    @property
    def corrected(self) -> FittedCandidate:
        """The selected model with the shape of its effects corrected, where the records asked for that."""
        return self.selection.shape_corrections.get(frozenset(self.selected.effects), self.selected)

    @property
    def explained_fraction(self) -> float:
        """Share of the gap that the extended model explains, in the output that the plain model misses most."""
        return self.holdout[worst_output(self.holdout)].explained_fraction

    @cached_property
    def noise_limits(self) -> dict[str, float]:
        """Rms over noise that noise and the uncertainty of the constants hardly ever exceed on the validation records, by output."""
        return self.limit_noise(self.scores)

    def limit_noise(self, scores: HoldoutScores) -> dict[str, float]:
        """The same on the records of ``scores``."""
        candidate = self.corrected if self.selected.effects else self.baseline
        run, drift, noise = scores.run(candidate), scores.measure_drift(candidate), self.baseline.problem.noise
        if run is None:
            return dict.fromkeys(self.holdout, VISIBLE_RMS)
        colours = dict(zip(noise.outputs, noise.colour, strict=True))
        return {
            name: math.hypot(
                visible_rms_limit(misfit.samples, colours[name]),
                math.sqrt(drift.get(name, 0.0)) / self.base.noise.std[name],
            )
            for name, misfit in run.misfit.items()
        }


def list_added_effects(judged: JudgedSelection) -> list[Effect]:
    """The effects of the extended model that the plain one has not."""
    given = {e.name for e in judged.base.model.effects}
    return [e for e in judged.best.model.effects if e.name not in given]


def list_named_effects(judged: JudgedSelection) -> list[str]:
    """Those that have a name, without curves that correct them, as they are called in claims."""
    return [claimed_name(e) for e in list_added_effects(judged) if not is_shape_correction(e.name)]
