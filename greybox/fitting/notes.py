"""What a reader should know before trusting a fit: likely causes of a failure, active bounds, open directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from greybox.fitting.solve import Solution
from greybox.fitting.uncertainty import Uncertainty
from greybox.optimiser import Status
from greybox.result import Estimate, Misfit, Trace

# Misfit over noise from which something other than noise is left.
VISIBLE = 1.3
# Sample-to-sample correlation of the residual from which white-noise intervals are too narrow, if there is a residual at all.
COLOURED, LITTLE = 0.3, 0.1

CAUSES = {
    Status.NO_START: (
        "start values far from physical ones",
        "an unstable model over a long record",
        "a missing bound (for example a level below zero)",
    ),
    Status.ITERATION_LIMIT: ("constants that the data do not determine: fix one", "start values far off: give others with start", "too few iterations"),
    Status.STUCK: ("constants that the data do not determine: fix one", "an effect that is not smooth in its constants", "bounds that exclude the optimum"),
    Status.FAILED: ("start values far from physical ones", "an unstable model over a long record", "bounds that exclude the optimum"),
}


def meaning(solution: Solution, misfit: Mapping[str, Misfit]) -> str:
    """The status in plain words, with misfit over noise beside it: a wrong model converges too."""
    text = solution.status.value
    if solution.status in CAUSES:
        causes = "; ".join(f"({k + 1}) {cause}" for k, cause in enumerate(CAUSES[solution.status]))
        text += f". Likely causes, in order: {causes}"
    if solution.evaluation.failed:
        text += f". {_where(solution)}"
    elif misfit:
        worst = max(misfit, key=lambda name: misfit[name].noise_ratio)
        text += f"; misfit {misfit[worst].noise_ratio:.3g} times the noise in {worst}"
    return text


def notes(solution: Solution, found: Uncertainty, estimates: Mapping[str, Estimate], misfit: Mapping[str, Misfit], runs: Sequence[Trace]) -> tuple[str, ...]:
    """Sentences in order of importance."""
    result = []
    for direction in found.open_directions:
        result.append(f"not determined by these data: {describe(direction)}")
    at_bound = [name for name, e in estimates.items() if e.at_bound]
    if at_bound:
        result.append(f"stopped by a bound: {', '.join(at_bound)}; widen the bound, or the model needs something else there")
    wide = [n for n, e in estimates.items() if e.std is not None and not e.at_bound and e.std > 0.5 * abs(e.value)]
    if wide:
        result.append(f"poorly determined (standard deviation over half the value): {', '.join(wide)}")
    if any(m.noise_ratio > VISIBLE for m in misfit.values()):
        result.append("the misfit exceeds the noise: the model lacks something, and the constants may imitate it")
    coloured = [n for n, m in misfit.items() if m.noise_ratio > LITTLE and correlation(runs, n) > COLOURED]
    if coloured:
        result.append(f"the residual of {', '.join(coloured)} is correlated from sample to sample: the intervals assume white noise and are too narrow")
    coarse = [n for n, e in zip(misfit, solution.integration_error, strict=False) if e > 0.1 and e > 0.01 * misfit[n].noise_ratio]
    if coarse:
        result.append(f"integration error above a tenth of the noise in {', '.join(coarse)}: raise the number of substeps")
    return tuple(result)


def describe(direction: Mapping[str, float]) -> str:
    """An undetermined direction in words: ``Kf, La, Ra scale together: fix one, or measure more``."""
    names = list(direction)
    if len(names) == 1:
        return f"{names[0]} has no influence on the measured outputs"
    return f"{', '.join(names)} can change together without changing the outputs: fix one of them, or measure another output"


def correlation(runs: Sequence[Trace], output: str) -> float:
    """Correlation of one output's residual with the sample before, over all records."""
    products, squares = 0.0, 0.0
    for run in runs:
        if output in run.measured:
            r = run.residual(output)
            pair = np.isfinite(r[1:]) & np.isfinite(r[:-1])
            products += float(r[1:][pair] @ r[:-1][pair])
            squares += float(r[np.isfinite(r)] @ r[np.isfinite(r)])
    return products / squares if squares > 0 else 0.0


def _where(solution: Solution) -> str:
    experiment, sample = solution.evaluation.failed or (0, 0)
    record = solution.problem.records[experiment]
    time = float(record.h[:sample].sum())
    return f"The simulation of experiment {experiment + 1} overflows {time:.4g} s after its start (row {sample + 1})"
