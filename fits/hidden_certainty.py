"""How probable is an effect that `greybox.discover` puts into a model? Weights and reliability from the answers of `fits.hidden_study`.

Every effect of every answer is one observation: what its evidence was, and whether it is right, or one of those that the answer calls
its equals. The weights of `greybox.discovery.CertaintyPolicy` are a logistic regression on these; the reliability on the page is that of
cases that were left out of the fit. It is not out of sample: a ridge draws each fold towards the library's weights, which were fitted to
earlier answers of the same study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.optimize import minimize
from scipy.special import expit

from greybox.discovery.certainty import (
    CERTAINTY_ESTABLISHED,
    CERTAINTY_WEIGHTS,
    Grade,
    grade_effect,
    probability_of,
    to_features,
)
from greybox.discovery.policy import CertaintyPolicy

RIDGE = 1.0  # inverse variance of the prior of each weight
FOLDS, BINS = 10, 10
LARGEST = 1e300  # in the place of an infinite measure
Row = Mapping[str, Any]


def list_effects(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """One entry for each effect of each answer."""
    return [
        {
            "right_or_equal": effect["right"],
            **effect,
            "case": row["name"],
            "plant": row["plant"],
            "left_out": answer["left_out"],
        }
        for row in rows
        for answer in row["answers"]
        for effect in answer["effects"]
    ]


def compute_features(effect: Row, policy: CertaintyPolicy) -> dict[str, float]:
    """The features of an effect as the library computes them."""
    measures = {n: math.nan if v is None else v for n, v in effect["measures"].items()}
    # JSON has no infinity: a test that was made has one where its number is missing.
    for loss, deviations in (("loss", "loss_t"), ("rival_loss", "rival_t")):
        measures |= {name: LARGEST for name in (loss, deviations) if math.isnan(measures[name])}
    for loss, deviations in (("curve_loss", "curve_t"), ("static_loss", "static_t")):
        if math.isfinite(measures[loss]) and math.isnan(measures[deviations]):
            measures[deviations] = LARGEST
    return to_features(measures)


def fit_weights(features: np.ndarray, right: np.ndarray, mean: np.ndarray, ridge: float = RIDGE) -> np.ndarray:
    """Intercept and weights (1 + n,) of a logistic regression.

    A normal prior about ``mean``, the weights of the library, keeps what the cases do not decide.
    """
    x = np.column_stack([np.ones(len(features)), features])

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the logarithm of the posterior, and its gradient."""
        score, distance = x @ w, w - mean
        value = np.sum(np.logaddexp(0, score) - right * score) + 0.5 * ridge * distance @ distance
        return float(value), x.T @ (expit(score) - right) + ridge * distance

    return minimize(cost, mean, jac=True, method="L-BFGS-B").x


def cross_validate(effects: Sequence[Row], policy: CertaintyPolicy) -> np.ndarray:
    """The probability (N,) of each effect from weights fitted without its case."""
    features, right = _tabulate(effects, policy)
    cases = sorted({e["case"] for e in effects})
    fold = np.array([cases.index(e["case"]) % FOLDS for e in effects])
    result = np.zeros(len(effects))
    for k in range(FOLDS):
        w = fit_weights(features[fold != k], right[fold != k], _library_weights(policy))
        result[fold == k] = expit(w[0] + features[fold == k] @ w[1:])
    return result


def format_weights(rows: Sequence[Row]) -> str:
    """Intercept and weights that the rows ask for, as lines of the policy."""
    effects, policy = list_effects(rows), CertaintyPolicy()
    w = fit_weights(*_tabulate(effects, policy), _library_weights(policy))
    return "\n".join(
        [f"intercept: {w[0]:.2f}", *(f'"{n}": {v:.2f},' for n, v in zip(CERTAINTY_WEIGHTS, w[1:], strict=True))]
    )


def write_certainty(rows: Sequence[Row], docs: Path) -> None:
    """``certainty.md`` and ``figures/certainty.svg`` in ``docs``."""
    effects, policy = list_effects(rows), CertaintyPolicy()
    right = np.array([e["right_or_equal"] for e in effects], float)
    stated = np.array([probability_of(compute_features(e, policy), policy) for e in effects])
    predicted = cross_validate(effects, policy)
    (docs / "figures").mkdir(parents=True, exist_ok=True)
    _figure(predicted, right).savefig(docs / "figures" / "certainty.svg", metadata={"Date": None})
    runs = sum(len(row["answers"]) for row in rows)
    without = sum(answer["left_out"] for row in rows for answer in row["answers"])
    plants = sorted({e["plant"] for e in effects})
    sure = [
        effect
        for effect, probability in zip(effects, stated, strict=True)
        if grade_effect(probability, compute_features(effect, policy), bool(effect.get("alike"))) is Grade.ESTABLISHED
    ]
    wrong = [e for e in sure if not e["right"]]
    text = [
        "# How certain is an established effect?",
        f"Each effect of an answer has a probability of being right. Here it is held against the truth: {len(effects)} effects in"
        f" {runs} answers to {len(rows)} simulated cases on {len(plants)} plants ({', '.join(plants)}); in {without} of the answers the"
        " true effect and its family had been taken away from the candidates. The probabilities are those of weights fitted without the"
        " case in question, yet drawn towards the library's weights, which were fitted to earlier answers of the same study: the table is"
        " not out of sample, and on other cases the errors may be larger. Written by `python -m fits.hidden_study FOLDER --page`.",
        _reliability_table(predicted, right),
        "![Predicted probability against observed frequency](figures/certainty.svg)",
        f"Brier score: {np.mean((predicted - right) ** 2):.3f} (with the weights of the library:"
        f" {np.mean((stated - right) ** 2):.3f}).",
        f"The grade asks for more than a probability of {CERTAINTY_ESTABLISHED:g}: no single test may speak against the effect, no stand-in"
        " for a larger part of the error may stand beside it, and it must not be the same at every output. With the library's weights and"
        f" tests {len(sure)} of these effects pass on their own evidence, {len(wrong)} of them wrong"
        + (": " + "; ".join(f"`{e['name']}` in {e['case']}" for e in wrong) if wrong else "")
        + ". Cases that were answered before a test was added have not taken that test.",
    ]
    (docs / "certainty.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")


def _tabulate(effects: Sequence[Row], policy: CertaintyPolicy) -> tuple[np.ndarray, np.ndarray]:
    """Features (N, n) and outcomes (N,)."""
    features = [compute_features(e, policy) for e in effects]
    return np.array([[f[n] for n in CERTAINTY_WEIGHTS] for f in features]), np.array(
        [e["right_or_equal"] for e in effects], float
    )


def _library_weights(policy: CertaintyPolicy) -> np.ndarray:
    return np.array([policy.intercept, *CERTAINTY_WEIGHTS.values()])


def _bins(predicted: np.ndarray) -> np.ndarray:
    return np.minimum((predicted * BINS).astype(int), BINS - 1)


def _reliability_table(predicted: np.ndarray, right: np.ndarray) -> str:
    lines = ["| predicted | effects | mean prediction | right |", "|---|---|---|---|"]
    for k in range(BINS):
        chosen = _bins(predicted) == k
        if chosen.any():
            lines.append(
                f"| {k / BINS:.1f} to {(k + 1) / BINS:.1f} | {chosen.sum()} | {predicted[chosen].mean():.2f} | {right[chosen].mean():.2f} |"
            )
    return "\n".join(lines)


def _figure(predicted: np.ndarray, right: np.ndarray) -> Figure:
    figure = Figure(figsize=(4.5, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="0.7")
    for k in range(BINS):
        chosen = _bins(predicted) == k
        if chosen.any():
            size = 3 + chosen.sum() ** 0.5
            axis.plot(predicted[chosen].mean(), right[chosen].mean(), "o", color="C0", markersize=size)
    axis.set_xlabel("predicted probability of being right")
    axis.set_ylabel("share that is right")
    return figure
