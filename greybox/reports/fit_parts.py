"""What several pages say of a fit: whether to believe it, and its constants."""

from __future__ import annotations

import math
from collections.abc import Iterator

from greybox.plots.parameters import relative_half_width
from greybox.rendering.result import to_constant_rows
from greybox.reports.page import Table, Text, Tone
from greybox.reports.typography import as_sentence, count_noun, join_names, typeset_number, typeset_unit
from greybox.result import Fit

# A misfit up to this many times the noise is called good.
GOOD = 1.2
# Notes of the fit that stand with the verdict.
LEADING = 3


def verdict(fit: Fit) -> Text:
    """In plain words whether the fit succeeded and what to know before trusting it."""
    if not fit.success:
        said = [
            f"This fit did not succeed: {fit.solver.status_message}.",
            "The numbers below are where the search stopped. They are shown to find the reason, not to be used.",
        ]
        return Text([*said, *(as_sentence(typeset_number(n)) for n in fit.notes[:LEADING])], "bad")
    worst = max((m.noise_ratio for m in fit.misfit.values() if math.isfinite(m.noise_ratio)), default=math.nan)
    loose = [n for n in fit.uncertainty.free if n in fit.parameters and not fit.parameters[n].determined]
    fine = worst <= GOOD and not loose
    tone: Tone = "good" if fine else "caution"
    said = [_followed(fit, worst), _determined(fit, loose), *_judged(fit)]
    further = [n for n in fit.notes if not n.startswith("not determined")]
    return Text([*filter(None, said), *(as_sentence(typeset_number(n)) for n in further[:LEADING])], tone)


def _followed(fit: Fit, worst: float) -> str:
    sizes = join_names([f"{m.noise_ratio:.3g} times the noise in {name}" for name, m in fit.misfit.items()])
    if not math.isfinite(worst):
        return "The model follows the fitted records; the noise is not known, so nothing tells whether well enough."
    if worst <= GOOD:
        return f"The model explains the fitted records: what it leaves over is {sizes}."
    return (
        f"The model does not explain the fitted records: what it leaves over is {sizes}. Either it lacks something, which"
        " greybox discover looks for, or the noise is larger than was assumed."
    )


def _determined(fit: Fit, loose: list[str]) -> str:
    if not fit.uncertainty.free:
        return "No constant was fitted."
    if loose:
        return (
            f"The records do not determine {join_names(loose)}: the 95 % interval reaches further than half the value."
        )
    sides = [half for name in fit.uncertainty.free if (half := relative_half_width(fit.parameters[name])) is not None]
    known = f" to ± {typeset_number(f'{max(sides):.2g}')} % or better" if sides else ""
    if len(fit.uncertainty.free) == 1:
        return f"{fit.uncertainty.free[0]} is determined{known}."
    return f"All {len(fit.uncertainty.free)} fitted constants are determined{known}, with 95 % confidence."


def _judged(fit: Fit) -> Iterator[str]:
    if fit.validation:
        sizes = join_names([f"{m.noise_ratio:.3g} times the noise in {n}" for n, m in fit.validation.misfit.items()])
        yield f"On {count_noun(len(fit.validation.traces), 'record')} that the fit has not seen it leaves over {sizes}."
    else:
        yield "It was not judged on other records; a second record would tell whether the constants hold there."


def constants_table(fit: Fit, note: str = "") -> Table:
    """The constants of a fit as a table."""
    rows = [
        [name, typeset_number(value), typeset_number(limits), typeset_unit(unit) if unit else "", remark]
        for name, value, limits, unit, remark in to_constant_rows(fit)
    ]
    title = "Constants with their standard deviations and 95 % intervals"
    return Table(title, ["constant", "value", "95 % interval", "unit", "remark"], rows, note)
