"""A comparison of models in words, within a hundred columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from greybox.base.findings import Finding
from greybox.base.units import format_unit
from greybox.comparison.result import ComparisonFinding
from greybox.show.sentences.estimation import status_text
from greybox.show.sentences.registry import register
from greybox.show.sentences.wording import format_number

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
