"""What a residual test says, and the tables of tests and scores."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from greybox.rendering.registry import renders
from greybox.residuals.hypothesis_tests import ResidualTestKind

if TYPE_CHECKING:
    from greybox.residuals import PredictionScores, ResidualTest, ResidualTests

# Kind of test -> the sentence without and with an alarm.
_SENTENCES: dict[ResidualTestKind, tuple[Callable[[ResidualTest], str], Callable[[ResidualTest], str]]] = {
    ResidualTestKind.WHITENESS: (
        lambda t: f"no correlation over {t.lags} samples",
        lambda t: f"correlated over {t.lags} samples ({t.colour})",
    ),
    ResidualTestKind.INPUT_INDEPENDENCE: (
        lambda t: f"independent of the input {t.input}",
        lambda t: f"correlated with the input {t.input}: the model lacks part of its effect",
    ),
    ResidualTestKind.NORMALITY: (
        lambda t: "normally distributed",
        lambda t: "not normal: look for outliers, quantisation or two regimes",
    ),
    ResidualTestKind.EQUAL_VARIANCE: (
        lambda t: "equally large throughout",
        lambda t: "larger in some parts of the record than in others",
    ),
    ResidualTestKind.EQUAL_MEAN: (
        lambda t: "no drift",
        lambda t: "its mean drifts, or an offset changes",
    ),
}


def name_test(test: ResidualTest) -> str:
    """``whiteness, 5 lags`` or ``independence of u``: what tables and figures call a test."""
    if test.kind is ResidualTestKind.WHITENESS:
        return f"whiteness, {test.lags} lags"
    if test.kind is ResidualTestKind.INPUT_INDEPENDENCE:
        return f"independence of {test.input}"
    return test.kind.value.replace("_", " ")


@renders("ResidualTest")
def write_residual_test(test: ResidualTest) -> str:
    """What the test says."""
    return _SENTENCES[test.kind][test.alarm](test)


@renders("ResidualTests")
def write_residual_tests(tests: ResidualTests) -> str:
    """A table with a row for each test."""
    rows = [
        ("output", "test", "statistic", "p", ""),
        *((t.output, name_test(t), f"{t.statistic:.4g}", f"{t.p_value:.2g}", str(t)) for t in tests.tests),
    ]
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    lines = [
        "  ".join([*(cell.ljust(w) for cell, w in zip(row, widths, strict=False)), row[4]]).rstrip() for row in rows
    ]
    if tests.whitened:
        outputs = ", ".join(tests.whitened)
        lines.append(f"the residual of {outputs} was whitened with the noise model before the tests")
    return "\n".join(lines)


@renders("PredictionScores")
def write_prediction_scores(scores: PredictionScores) -> str:
    """A table with a row for each output: errors of the free run and of predictions; infinite where a run overflows."""
    ahead = sorted({k for s in scores.outputs.values() for k in s.prediction})
    head = ["rmse", "free run", *(f"{k} step{'s' if k > 1 else ''} ahead" for k in ahead), "movement", "unit"]
    rows = [
        [name, *(f"{v:.4g}" for v in (s.free_run, *(s.prediction[k] for k in ahead), s.movement)), s.unit]
        for name, s in scores.outputs.items()
    ]
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in [head, *rows]]
    corrections = dict.fromkeys(s.predictor for s in scores.outputs.values())
    return "\n".join([*lines, *(f"corrected by: {text}" for text in corrections)])
