"""What a comparison comes to, in plain sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.result.summary import format_number
from greybox.units import format_unit

EQUAL = 0.02  # relative difference of two errors that is none


def judge_comparison(comparison: Comparison) -> tuple[str, ...]:
    """Best model of each output in the free run and one sample ahead, by how much, and what to keep in mind of the winners."""
    said: list[str] = []
    where = "on the validation records" if comparison.validation else "on the fitted records, which judge too kindly"
    for output, unit in comparison.outputs.items():
        for what, error in (("free run", _rmse), ("one sample ahead", _one_step)):
            said += _best(comparison, output, format_unit(unit), f"{what} {where}", error)
    return (*said, *_remarks(comparison))


def _rmse(score: ComparisonScore) -> float:
    return score.rmse


def _one_step(score: ComparisonScore) -> float:
    return score.one_step_rmse


def _best(
    comparison: Comparison, output: str, unit: str, where: str, error: Callable[[ComparisonScore], float]
) -> Iterator[str]:
    ranked = [
        (error(comparison.judged(e)[output]), e)
        for e in comparison.entries
        if output in comparison.judged(e) and np.isfinite(error(comparison.judged(e)[output]))
    ]
    ranked.sort(key=lambda pair: pair[0])
    if not ranked:
        return
    least, first = ranked[0]
    text = f"{output}, {where}: {_called(first)} is best, {format_number(least, 4)} {unit}".rstrip()
    other = "black" if first.kind == "grey" else "grey"
    rivals = [(value, entry) for value, entry in ranked if entry.kind == other]
    if not rivals:
        yield f"{text}; there is no {other} box beside it"
        return
    value, rival = rivals[0]
    if value <= (1 + EQUAL) * least:
        yield f"{text}; {_called(rival)} is as good within {100 * EQUAL:.0f} %"
        return
    times = f"{value / least:.3g} times as much" if least > 0 else f"{format_number(value, 4)} {unit}".rstrip()
    yield f"{text}; {_called(rival)}, the best {other} box, makes {times}"


def _called(entry: ComparisonEntry) -> str:
    box = "grey box" if entry.kind == "grey" else "black box"
    return f"{entry.name} ({box}, {entry.parameters} numbers)"


def _remarks(comparison: Comparison) -> Iterator[str]:
    unstable = [e.name for e in comparison.entries if not e.stable]
    if unstable:
        yield f"unstable: {', '.join(unstable)}"
    direct = [e.name for e in comparison.entries if e.feedthrough]
    if direct:
        yield (
            f"feed-through within one sample: {', '.join(direct)}; nothing with a mass or a volume does that, it stands for a delay"
            " or for what the input does between samples"
        )
    counted = {e.name: ", ".join(sorted(e.training)) for e in comparison.entries if np.isfinite(e.bic)}
    if len(set(counted.values())) > 1:
        told = "; ".join(f"{name} {outputs}" for name, outputs in counted.items())
        yield f"BIC is a sum over different outputs ({told}): compare it only between models of the same ones"
    failed = [e.name for e in comparison.entries if any(n.startswith("the fit did not succeed") for n in e.notes)]
    if failed:
        yield f"the fit did not succeed: {', '.join(failed)}; their errors say nothing about the model"
