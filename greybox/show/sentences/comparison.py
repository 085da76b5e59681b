"""A comparison of models in words, within a hundred columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from greybox.base.findings import Finding
from greybox.base.units import format_unit
from greybox.comparison.findings import ComparisonFinding
from greybox.show.sentences.estimation import status_text
from greybox.show.sentences.registry import register, renders, sentences
from greybox.show.sentences.wording import format_number, format_table

if TYPE_CHECKING:
    from greybox.comparison.result import Comparison, ComparisonEntry, ComparisonScore

MEASURE = {"free_run": "free run", "one_step": "one sample ahead"}
RECORDS = {
    "validation": "on the validation records",
    "training": "on the estimation records, where every error is optimistic",
}


def _best_model(finding: Finding) -> str:
    values = finding.values
    unit = format_unit(values["unit"])
    error = f"{format_number(values['error'], 4)} {unit}".rstrip()
    text = (
        f"{finding.subject}, {MEASURE[values['measure']]} {RECORDS[values['records']]}: {_model_name(values['model'])} is best,"
        f" {error}"
    )
    if "rival" not in values:
        return f"{text}. There is no {values['other_kind']} box to compare with."
    rival = _model_name(values["rival"])
    if values["equally_good"]:
        return f"{text}. {rival} is equally good within {100 * values['tolerance']:.0f} %."
    least, other = values["error"], values["rival_error"]
    if least > 0:
        return f"{text}. The best {values['other_kind']} box, {rival}, has {other / least:.3g} times the error."
    return f"{text}. The best {values['other_kind']} box, {rival}, has {format_number(other, 4)} {unit}".rstrip() + "."


def _model_name(model: Mapping[str, Any]) -> str:
    count = model["parameters"]
    return f"{model['name']} ({model['kind']} box, {count} parameter{'' if count == 1 else 's'})"


def _listed(template: str) -> Any:
    return lambda finding: template.format(models=", ".join(finding.values["models"]))


def _bic_of_different_outputs(finding: Finding) -> str:
    listing = "; ".join(f"{name}: {', '.join(outputs)}" for name, outputs in finding.values["outputs"].items())
    return (
        f"BIC is summed over the outputs of each model ({listing}). Compare it only between models of the same outputs."
    )


register(
    {
        ComparisonFinding.BEST_MODEL: _best_model,
        ComparisonFinding.UNSTABLE_MODELS: _listed("Unstable: {models}."),
        ComparisonFinding.FEEDTHROUGH_MODELS: _listed(
            "Direct feed-through within one sample: {models}. A plant with inertia has none; it represents a delay or the input"
            " between the samples."
        ),
        ComparisonFinding.BIC_OF_DIFFERENT_OUTPUTS: _bic_of_different_outputs,
        ComparisonFinding.FAILED_FITS: _listed("The fit failed: {models}. Do not judge the model by these errors."),
        ComparisonFinding.FIT_FAILED: lambda finding: f"the fit failed: {status_text(finding.values['status'])}",
        ComparisonFinding.PREDICTION_FILTER: "predictions are corrected by {filter}",
        ComparisonFinding.NO_BLACK_BOX: "{reason}",
        ComparisonFinding.NO_STATE_SPACE: "no state-space model of all inputs and outputs ({reason})",
        ComparisonFinding.RECORD_RESAMPLED: (
            "{subject}: resampled to {sampling_time:.6g} s for the black boxes, which need a uniform sampling time"
        ),
        ComparisonFinding.MEASURED_ROWS_ONLY: (
            "{subject}: the black boxes use only the measured rows, every {sampling_time:.6g} s"
        ),
        ComparisonFinding.NO_SMOOTHING: "{subject}: no Monte-Carlo smoothing ({reason})",
    }
)


@renders("Comparison")
def comparison_text(comparison: Comparison) -> str:
    """Errors by output, best first, on validation and estimation records; what each model is; the verdict."""
    lines: list[str] = []
    groups = (("validation", comparison.validation), ("training", comparison.training))
    for group, records in groups:
        if records:
            for output, unit in comparison.outputs.items():
                lines += [*_error_table(comparison, group, output, format_unit(unit)), ""]
    lines += [*_record_tables(comparison), *_model_table(comparison), ""]
    lines += [f"{e.name}: {', '.join(dict.fromkeys(e.structure.values()))}" for e in comparison.entries]
    paragraphs = [*sentences(comparison.verdict), *(f"note: {note}" for note in sentences(comparison.findings))]
    paragraphs += [f"note: {e.name}: {note}" for e in comparison.entries for note in sentences(e.findings)]
    wrapped = [textwrap.fill(text, 100, subsequent_indent="  ", break_on_hyphens=False) for text in paragraphs]
    return "\n".join([*lines, "", *wrapped])


def _error_table(comparison: Comparison, group: str, output: str, unit: str) -> Iterator[str]:
    scores: dict[str, ComparisonScore] = {}
    for entry in comparison.entries:
        of_group: Mapping[str, ComparisonScore] = getattr(entry, group)
        if output in of_group:
            scores[entry.name] = of_group[output]
    steps = sorted({k for s in scores.values() for k in s.ahead_rmse})
    rows = [
        [
            _shorten(name),
            str(comparison[name].kind),
            _error_cell(s.rmse),
            f"{s.best_fit_percent:.2f} %",
            _error_cell(s.one_step_rmse),
            *(_error_cell(s.ahead_rmse.get(k, math.nan)) for k in steps),
        ]
        for name, s in sorted(scores.items(), key=lambda item: _finite_or_last(item[1].rmse))
    ]
    title = f"{group}: {output} [{unit}]" if unit else f"{group}: {output}"
    yield from format_table([title, "box", "free run", "best fit", "one step", *(f"{k} ahead" for k in steps)], rows)


def _record_tables(comparison: Comparison) -> Iterator[str]:
    """Best fit of each validation record, where there are several."""
    shown = comparison.validation[:5]
    if len(comparison.validation) < 2:
        return
    for output in comparison.outputs:
        rows = [[_shorten(e.name), *(_fit_cell(e, record, output) for record in shown)] for e in comparison.entries]
        left_out = len(comparison.validation) - len(shown)
        title = f"best fit [%], {output}" + (f" ({left_out} more records in the file)" if left_out else "")
        yield from format_table([title, *(_shorten(name, 14) for name in shown)], rows)
        yield ""


def _fit_cell(entry: ComparisonEntry, record: str, output: str) -> str:
    scores = entry.records.get(record, {})
    return f"{scores[output].best_fit_percent:.2f}" if output in scores else "-"


def _model_table(comparison: Comparison) -> Iterator[str]:
    rows = [
        [
            _shorten(e.name),
            str(e.kind),
            str(e.parameters),
            f"{e.bic:.0f}" if math.isfinite(e.bic) else "-",
            "yes" if e.stable else "no",
            ", ".join(f"{format_number(v, 3)}" for v in e.feedthrough.values()) or "none",
            f"{e.seconds:.1f} s" if e.seconds else "-",
        ]
        for e in comparison.entries
    ]
    yield from format_table(["model", "box", "parameters", "BIC", "stable", "feed-through", "time"], rows)


def _finite_or_last(value: float) -> float:
    return value if math.isfinite(value) else math.inf


def _error_cell(value: float) -> str:
    if math.isnan(value):
        return "-"
    return format_number(value, 4) if math.isfinite(value) else "diverges"


def _shorten(name: str, width: int = 42) -> str:
    return name if len(name) <= width else f"{name[: width - 3]}..."
