"""How probable it is that an effect has the right name, from what its evidence shows, and what may be said because of that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum

from greybox.base.numerics import TINY
from greybox.discovery.policy import CertaintyPolicy


class Grade(StrEnum):
    """What may be said of an effect in a model."""

    ESTABLISHED = "established"
    """It is there: nothing else in its place comes near, and its form was tested."""
    PROBABLE = "probable"
    """It explains a part of the error, and another effect might do so as well."""
    STAND_IN = "stand_in"
    """It represents something that has another form."""


def to_features(measures: Mapping[str, float], policy: CertaintyPolicy) -> dict[str, float]:
    """The measures of an effect's evidence as bounded numbers: what the probability is computed from."""
    size = math.sqrt(max(measures["loss"], TINY))
    deviations = policy.most_deviations
    curve, curve_t = measures["curve_loss"], measures["curve_t"]
    is_tested = math.isfinite(curve)
    static = measures.get("static_loss", math.nan)  # of an effect without memory there is none
    free = measures.get("free_loss", math.nan)  # of what would not be established anyway there is none
    change = measures["change"]
    return {
        "share": _clip(measures["share"], 0, 1),
        "loss_t": _clip(measures["loss_t"] / deviations, -1, 1),
        "rival_size": _clip(_signed_root(measures["rival_loss"]) / size, -1, 1),
        "rival_ratio": _clip(0.25 * math.log(max(1 + measures["rival_loss"], TINY)), -1, 1),
        "rival_t": _clip(measures["rival_t"] / deviations, -1, 1),
        "rival_parameters": _clip(measures.get("rival_parameters", 0.0) / 2, -1, 1),
        "curve_size": _clip(math.sqrt(max(-curve, 0.0)) / size, 0, 1) if is_tested else 0.0,
        "curve_ratio": _gain(curve),
        "curve_t": _clip(-curve_t / deviations, 0, 1) if is_tested else 0.0,
        "curve_fit": _own_form(measures, policy),
        "curve_untested": float(not is_tested),
        "untested_left": 0.0 if is_tested else _clip(measures["structure"] / size, 0, 1),
        "static_size": _clip(_signed_root(static) / size, -1, 1) if math.isfinite(static) else 1.0,
        "static_t": _clip(measures.get("static_t", math.nan) / deviations, -1, 1) if math.isfinite(static) else 1.0,
        "free_size": _clip(_signed_root(free), -1, 1) if math.isfinite(free) else 1.0,
        "remainder": measures["remainder"],
        "structure": measures["structure"],
        "left": _clip(measures["structure"] / size, 0, 1),
        "change": _clip(change, 0, 1) if math.isfinite(change) else 1.0,
        "start": measures["start"],
        "several": float(measures["effects"] > 1),
        "undetermined": measures["undetermined"],
    }


def probability_of(features: Mapping[str, float], policy: CertaintyPolicy) -> float:
    """The probability that an effect with these features is right: a logistic function."""
    score = policy.intercept + sum(policy.weights.get(name, 0.0) * value for name, value in features.items())
    return 1 / (1 + math.exp(-_clip(score, -policy.most_score, policy.most_score)))


def grade_effect(probability: float, features: Mapping[str, float], has_equal: bool, policy: CertaintyPolicy) -> Grade:
    """The grade of an effect: established only where, beside the probability, no single test speaks against it.

    An effect that another one equals (``has_equal``), of which a parameter is not determined, or whose refit from another start ends
    elsewhere, is probable at most.
    """
    contradicted = (
        has_equal
        or features["undetermined"] > 0
        or features["rival_t"] < policy.least_rival
        or features["static_t"] < policy.least_rival
        or features["curve_size"] > policy.most_form
        or (
            features["curve_ratio"] > policy.most_gain
            and features["curve_t"] > policy.least_rival
            and features["curve_size"] > policy.most_own_form
        )
        or features["curve_fit"] > policy.most_own_form
        or features["free_size"] < policy.least_free
        or features["remainder"] > policy.most_remainder
        or features["share"] < policy.least_share
        or features["change"] > policy.most_change
        or features["start"] < 1
        or features["left"] > policy.most_left
        or (features["curve_untested"] > 0 and features["left"] > policy.most_untested)
    )
    if probability >= policy.established and not contradicted:
        return Grade.ESTABLISHED
    return Grade.PROBABLE if probability >= policy.probable else Grade.STAND_IN


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _gain(loss: float) -> float:
    """By how much a relative difference of mean square errors lowers the logarithm of the rms error; 0 where nobody looked."""
    return _clip(-0.5 * math.log(max(1 + loss, TINY)), 0, 1) if math.isfinite(loss) else 0.0


def _own_form(measures: Mapping[str, float], policy: CertaintyPolicy) -> float:
    """What a curve beside the effect takes more of the records it was fitted to, over what the effect takes, in rms.

    A few heights take up to `CertaintyPolicy.chance_gain` by chance. The validation records may leave the range in which the curve was
    fitted: one that is better within is another form even if it is no better there. 0 where it does worse there: what it takes is
    not seen again.
    """
    gain = measures.get("curve_gain", 0.0)
    if gain < policy.chance_gain or measures["curve_t"] > policy.least_worse:
        return 0.0
    gained = 1 - math.exp(-2 * gain)
    return _clip(math.sqrt(gained / max(measures["loss"], TINY)), 0, 1)


def _signed_root(value: float) -> float:
    return math.copysign(math.sqrt(abs(value)), value)
