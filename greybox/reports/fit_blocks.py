"""What several pages say of a fit: whether to believe it, and its parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable

from greybox.estimation.findings import EstimationCode
from greybox.findings import Finding
from greybox.plots.parameters import relative_half_width
from greybox.rendering.english import phrase
from greybox.rendering.reports import PageText
from greybox.rendering.result import to_constant_rows
from greybox.reports.page import PageTable, Paragraphs, Text, Tone
from greybox.reports.policy import REPORT
from greybox.reports.typography import typeset_number, typeset_unit
from greybox.result import Fit

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
    # The verdict names undetermined parameters itself.
    further = [f for f in fit.findings if f.code not in UNDETERMINED]
    return Paragraphs(
        [_misfit(fit), _determined(fit, undetermined), *_validated(fit), *further[:leading]],
        Tone.GOOD if is_good else Tone.CAUTION,
    )


def statements(texts: Iterable[Text]) -> list[Text]:
    """Sentences of other packages, findings or strings, as texts of a page."""
    return [text if isinstance(text, Finding) else phrase(PageText.STATEMENT, text=text) for text in texts]


def _misfit(fit: Fit) -> Finding:
    ratios = {name: m.noise_ratio for name, m in fit.misfit.items()}
    known = [ratio for ratio in ratios.values() if math.isfinite(ratio)]
    if not known:
        return phrase(PageText.NOISE_UNKNOWN)
    good = max(known) <= REPORT.good_misfit
    return phrase(PageText.RESIDUAL_IS_NOISE if good else PageText.RESIDUAL_EXCEEDS_NOISE, ratios=ratios)


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
    ratios = {name: m.noise_ratio for name, m in fit.validation.misfit.items()}
    return [phrase(PageText.VALIDATED, records=len(fit.validation.traces), ratios=ratios)]


def parameters_table(fit: Fit, note: Text = "") -> PageTable:
    """The parameters of a fit as a table."""
    rows = [
        [name, typeset_number(value), typeset_number(limits), typeset_unit(unit) if unit else "", remark]
        for name, value, limits, unit, remark in to_constant_rows(fit)
    ]
    return PageTable(phrase(PageText.PARAMETERS), ["parameter", "value", "95 % interval", "unit", "remark"], rows, note)
