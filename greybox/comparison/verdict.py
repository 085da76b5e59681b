"""What a comparison comes to: the best model of each output, and what to keep in mind of the others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from greybox.comparison.findings import ComparisonFinding
from greybox.comparison.result import BoxKind, Comparison, ComparisonEntry
from greybox.findings import Finding, Severity, with_code

MEASURES = {"free_run": "rmse", "one_step": "one_step_rmse"}  # what is compared -> the field of a score


def judge_comparison(comparison: Comparison) -> tuple[Finding, ...]:
    """Best model of each output in the free run and one sample ahead, by how much, and what to keep in mind.

    Parameters
    ----------
    comparison
        Models with their scores.

    Returns
    -------
    tuple of Finding
        One `ComparisonFinding.BEST_MODEL` for each output and measure, then the remarks.
    """
    best = [
        finding
        for output in comparison.outputs
        for measure in MEASURES
        if (finding := _find_best(comparison, output, measure)) is not None
    ]
    return (*best, *_remarks(comparison))


def _find_best(comparison: Comparison, output: str, measure: str) -> Finding | None:
    ranked = []
    for entry in comparison.entries:
        scores = comparison.deciding_scores(entry)
        if output in scores and np.isfinite(error := getattr(scores[output], MEASURES[measure])):
            ranked.append((error, entry))
    if not ranked:
        return None
    ranked.sort(key=lambda pair: pair[0])
    least, best = ranked[0]
    other_kind = BoxKind.BLACK if best.kind == BoxKind.GREY else BoxKind.GREY
    values = {
        "measure": measure,
        "records": "validation" if comparison.validation else "training",
        "unit": comparison.outputs[output],
        "model": _identify(best),
        "error": least,
        "other_kind": str(other_kind),
    }
    rivals = [(error, entry) for error, entry in ranked if entry.kind == other_kind]
    if rivals:
        error, rival = rivals[0]
        equal = bool(error <= (1 + comparison.policy.equally_good) * least)
        values |= {
            "rival": _identify(rival),
            "rival_error": error,
            "equally_good": equal,
            "tolerance": comparison.policy.equally_good,
        }
    return Finding(ComparisonFinding.BEST_MODEL, subject=output, values=values)


def _identify(entry: ComparisonEntry) -> dict[str, str | int]:
    return {"name": entry.name, "kind": str(entry.kind), "parameters": entry.parameters}


def _remarks(comparison: Comparison) -> Iterator[Finding]:
    entries = comparison.entries
    unstable = [e.name for e in entries if not e.stable]
    if unstable:
        yield Finding(ComparisonFinding.UNSTABLE_MODELS, Severity.WARNING, values={"models": unstable})
    direct = [e.name for e in entries if e.feedthrough]
    if direct:
        yield Finding(ComparisonFinding.FEEDTHROUGH_MODELS, Severity.WARNING, values={"models": direct})
    outputs = {e.name: sorted(e.training) for e in entries if np.isfinite(e.bic)}
    if len(set(map(tuple, outputs.values()))) > 1:
        yield Finding(ComparisonFinding.BIC_OF_DIFFERENT_OUTPUTS, Severity.WARNING, values={"outputs": outputs})
    failed = [e.name for e in entries if with_code(e.findings, ComparisonFinding.FIT_FAILED)]
    if failed:
        yield Finding(ComparisonFinding.FAILED_FITS, Severity.WARNING, values={"models": failed})
