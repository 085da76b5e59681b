"""What several pages say of a fit: whether to believe it, and its parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from greybox.estimation.findings import EstimationCode
from greybox.findings import Finding
from greybox.plots.parameters import relative_half_width
from greybox.rendering.english import phrase
from greybox.rendering.reports import PageText
from greybox.rendering.result import to_constant_rows
from greybox.reports.page import PageTable, Paragraphs, Text, Tone
from greybox.reports.policy import REPORT
from greybox.reports.typography import typeset_number, typeset_unit
from greybox.result import Fit, Misfit

UNDETERMINED = (EstimationCode.PARAMETER_UNDETERMINED, EstimationCode.DIRECTION_UNDETERMINED)


def fit_verdict(fit: Fit) -> Paragraphs:
    """Whether the fit succeeded, and what to know before trusting it."""
    leading = REPORT.leading_findings
    if not fit.success:
        failure = (
            phrase(PageText.FIT_FAILED, reason=fit.solver.status_message),
            phrase(PageText.FIT_NUMBERS_OF_FAILURE),
        )
        return Paragraphs([*failure, *fit.findings[:leading]], Tone.BAD)
    free = [name for name in fit.uncertainty.free if name in fit.parameters]
    undetermined = [name for name in free if not fit.parameters[name].determined]
    known = [m.noise_ratio for m in fit.misfit.values() if math.isfinite(m.noise_ratio)]
    is_good = bool(known) and max(known) <= REPORT.good_misfit and not undetermined
    return Paragraphs(
        [_misfit(fit), _determined(fit, undetermined), *_validated(fit), *_further(fit)[:leading]],
        Tone.GOOD if is_good else Tone.CAUTION,
    )


def findings_below(fit: Fit) -> list[Finding]:
    """What the page says of a fit beside its residual: findings that neither the verdict nor the parameters say already."""
    # The verdict of a fit that failed has the first ones already, of any kind.
    return [*(_further(fit) if fit.success else fit.findings)[REPORT.leading_findings :]]


def _further(fit: Fit) -> list[Finding]:
    """Findings that say something else than sentences of the page: what is above the noise, open, or widened stands there once."""
    known = {EstimationCode.MISFIT_ABOVE_NOISE} if _misfit(fit).code is PageText.RESIDUAL_EXCEEDS_NOISE else set()
    if fit.uncertainty.kind == "sandwich" and fit.uncertainty.inflation:
        known.add(EstimationCode.RESIDUAL_CORRELATED)  # the note below the parameters
    return [f for f in fit.findings if f.code not in known.union(UNDETERMINED)]


def statements(texts: Iterable[Text]) -> list[Text]:
    """Sentences of other packages, findings or strings, as texts of a page."""
    return [text if isinstance(text, Finding) else phrase(PageText.STATEMENT, text=text) for text in texts]


def _misfit(fit: Fit) -> Finding:
    known = [ratio for m in fit.misfit.values() if math.isfinite(ratio := m.noise_ratio)]
    if not known:
        return phrase(PageText.NOISE_UNKNOWN)
    good = max(known) <= REPORT.good_misfit
    return phrase(
        PageText.RESIDUAL_IS_NOISE if good else PageText.RESIDUAL_EXCEEDS_NOISE, **_over_noise(fit, fit.misfit)
    )


def _over_noise(fit: Fit, misfit: Mapping[str, Misfit]) -> dict[str, Any]:
    """Residual over noise by output, and the outputs whose noise is only bounded: there it is at least that."""
    ceilings = {
        name: bound.level
        for name in misfit
        if (bound := fit.noise.bound(name)) is not None and bound.floor is None and bound.ceiling
    }
    ratios = {name: m.rmse / ceilings[name] if name in ceilings else m.noise_ratio for name, m in misfit.items()}
    return {"ratios": ratios, "at_least": list(ceilings)}


def _determined(fit: Fit, undetermined: list[str]) -> Finding:
    free = list(fit.uncertainty.free)
    if not free:
        return phrase(PageText.NOTHING_FITTED)
    if undetermined:
        return phrase(PageText.PARAMETERS_OPEN, open=undetermined)
    widths = [half for name in free if (half := relative_half_width(fit.parameters[name])) is not None]
    return phrase(PageText.PARAMETERS_DETERMINED, free=free, widest=max(widths, default=None))


def _validated(fit: Fit) -> list[Finding]:
    if not fit.validation:
        return [phrase(PageText.NOT_VALIDATED)]
    over_noise = _over_noise(fit, fit.validation.misfit)
    return [phrase(PageText.VALIDATED, records=len(fit.validation.traces), **over_noise)]


def parameters_table(fit: Fit, note: Text = "") -> PageTable:
    """The parameters of a fit as a table."""
    rows = [
        [name, typeset_number(value), typeset_number(limits), typeset_unit(unit) if unit else "", remark]
        for name, value, limits, unit, remark in to_constant_rows(fit)
    ]
    return PageTable(phrase(PageText.PARAMETERS), ["parameter", "value", "95 % interval", "unit", "remark"], rows, note)
