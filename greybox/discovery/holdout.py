"""The held-out veto: a model that explains the records it was fitted to, and no others, explains nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.discovery import decision
from greybox.discovery.problem import CandidateFit, DiscoveryProblem
from greybox.estimation import validate
from greybox.experiment import Experiment

# Other sets of effects that are judged instead, likeliest first.
JUDGED = 8


def reject_on_validation(
    bench: DiscoveryProblem,
    base: CandidateFit,
    chosen: CandidateFit,
    tried: Sequence[CandidateFit],
    judges: Sequence[Experiment],
    skip: int = 0,
) -> CandidateFit:
    """``chosen``; or, where it closes less than half of the gap on the ``judges``, the likeliest of ``tried`` that closes most of it.

    If no other does, ``chosen`` it remains: it will be called unknown.
    """
    before = score_holdout(bench, base, judges, skip)
    if before <= decision.VISIBLE or _closed(bench, chosen, judges, skip, before) >= decision.PARTLY:
        return chosen
    others = [t for t in sorted(tried, key=lambda t: t.criterion) if t.effects and t.effects != chosen.effects]
    for trial in others[:JUDGED]:
        again = bench.best(trial.model, [trial.model.values], keep=1, like=trial)
        better = again if again is not None and again.cost < trial.cost else trial
        if _closed(bench, better, judges, skip, before) >= decision.HELD_OUT:
            return better
    return chosen


def score_holdout(bench: DiscoveryProblem, trial: CandidateFit, judges: Sequence[Experiment], skip: int = 0) -> float:
    """Free-run misfit over noise on the judging records, all outputs together."""
    quick = replace(bench.options, progressive=False, thorough=False)
    found = validate(trial.model, judges, noise=bench.noise_std, skip=skip, options=quick)
    return float(np.sqrt(np.mean([m.noise_ratio**2 for m in found.misfit.values()])))


def _closed(
    bench: DiscoveryProblem, trial: CandidateFit, judges: Sequence[Experiment], skip: int, before: float
) -> float:
    """Share of the gap to the noise that a model closes on the judging records; not finite where it runs away."""
    after = score_holdout(bench, trial, judges, skip)
    return (before - after) / (before - 1) if np.isfinite(after) else -np.inf
