"""A comparison in plain text, within a hundred columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping

from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore
from greybox.result.summary import format_number, format_table
from greybox.units import format_unit

WIDTH, WIDEST_NAME = 100, 42  # columns of the whole text, and of a model's name in it
MOST_RECORDS = 5  # records with a column of their own


def format_comparison(comparison: Comparison) -> str:
    """Errors by output, best first, on validation and training records; what each model is; the verdict."""
    lines: list[str] = []
    groups = (("validation", comparison.validation), ("training", comparison.training))
    for group, records in groups:
        if records:
            for output, unit in comparison.outputs.items():
                lines += [*_errors(comparison, group, output, format_unit(unit)), ""]
    lines += [*_by_record(comparison), *_models(comparison), ""]
    lines += [f"{e.name}: {', '.join(dict.fromkeys(e.structure.values()))}" for e in comparison.entries]
    said = [*comparison.verdict, *(f"note: {note}" for note in comparison.notes)]
    said += [f"note: {e.name}: {note}" for e in comparison.entries for note in e.notes]
    lines += ["", *(textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False) for line in said)]
    return "\n".join(lines)


def _errors(comparison: Comparison, group: str, output: str, unit: str) -> Iterator[str]:
    scores: dict[str, ComparisonScore] = {}
    for entry in comparison.entries:
        found: Mapping[str, ComparisonScore] = getattr(entry, group)
        if output in found:
            scores[entry.name] = found[output]
    further = sorted({k for s in scores.values() for k in s.ahead_rmse})
    rows = [
        [
            _short(name), comparison[name].kind, _cell(s.rmse), f"{s.best_fit_percent:.2f} %", _cell(s.one_step_rmse),
            *(_cell(s.ahead_rmse.get(k, math.nan)) for k in further),
        ]
        for name, s in sorted(scores.items(), key=lambda item: _rank(item[1].rmse))
    ]  # fmt: skip
    title = f"{group}: {output} [{unit}]" if unit else f"{group}: {output}"
    yield from format_table([title, "box", "free run", "best fit", "one step", *(f"{k} ahead" for k in further)], rows)


def _by_record(comparison: Comparison) -> Iterator[str]:
    """Best fit of each validation record, where there are several."""
    shown = comparison.validation[:MOST_RECORDS]
    if len(comparison.validation) < 2:
        return
    for output in comparison.outputs:
        rows = [[_short(e.name), *(_fit_cell(e, record, output) for record in shown)] for e in comparison.entries]
        left_out = len(comparison.validation) - len(shown)
        title = f"best fit [%], {output}" + (f" ({left_out} more records in the file)" if left_out else "")
        yield from format_table([title, *(_short(name, 14) for name in shown)], rows)
        yield ""


def _fit_cell(entry: ComparisonEntry, record: str, output: str) -> str:
    scores = entry.records.get(record, {})
    return f"{scores[output].best_fit_percent:.2f}" if output in scores else "-"


def _models(comparison: Comparison) -> Iterator[str]:
    rows = [
        [
            _short(e.name), e.kind, str(e.parameters), "-" if not math.isfinite(e.bic) else f"{e.bic:.0f}",
            "yes" if e.stable else "no",
            ", ".join(f"{format_number(v, 3)}" for v in e.feedthrough.values()) or "none", f"{e.seconds:.1f} s" if e.seconds else "-",
        ]
        for e in comparison.entries
    ]  # fmt: skip
    yield from format_table(["model", "box", "numbers", "BIC", "stable", "feed-through", "time"], rows)


def _rank(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _cell(value: float) -> str:
    if math.isnan(value):
        return "-"
    return format_number(value, 4) if math.isfinite(value) else "grows away"


def _short(name: str, most: int = WIDEST_NAME) -> str:
    return name if len(name) <= most else f"{name[: most - 3]}..."
