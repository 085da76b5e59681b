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


# Standard errors of a difference between models at which it counts in full.
MOST_DEVIATIONS = 10.0


def to_features(measures: Mapping[str, float]) -> dict[str, float]:
    """The measures of an effect's evidence as bounded numbers: what the probability is computed from."""
    size = math.sqrt(max(measures["loss"], TINY))
    deviations = MOST_DEVIATIONS
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
        "curve_fit": _own_form(measures),
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


# Weight of each feature of the evidence.
CERTAINTY_WEIGHTS: Mapping[str, float] = {
    "share": 0.6,
    "loss_t": 0.6,
    "rival_size": 0.3,
    "rival_ratio": 1.3,
    "rival_t": 1.1,
    "rival_parameters": 0.4,
    "curve_size": -1.8,
    "curve_ratio": -0.3,
    "curve_t": -1.1,
    "curve_fit": -1.5,
    "curve_untested": -1.3,
    "untested_left": -3.8,
    "free_size": 2.4,
    "remainder": -2.2,
    "static_size": 0.3,
    "static_t": 0.1,
    "structure": -0.6,
    "left": -2.1,
    "change": -2.6,
    "start": 1.8,
    "several": -1.2,
    "undetermined": -1.3,
}
# Largest argument of the exponential: beyond it nothing changes and nothing overflows.
MOST_SCORE = 30.0


def probability_of(features: Mapping[str, float], policy: CertaintyPolicy) -> float:
    """The probability that an effect with these features is right: a logistic function."""
    score = policy.intercept + sum(CERTAINTY_WEIGHTS.get(name, 0.0) * value for name, value in features.items())
    return 1 / (1 + math.exp(-_clip(score, -MOST_SCORE, MOST_SCORE)))


# Probability from which an effect is established. Of the effects of the study (docs/certainty.md) from there on nineteen of twenty are
# right before any single test speaks.
CERTAINTY_ESTABLISHED = 0.8
# Probability from which an effect is probable; below it is a stand-in.
CERTAINTY_PROBABLE = 0.5
# The best rival must be behind by this share of `most_deviations`: three standard errors. So must be, of an effect with memory, a curve
# in its place, and of one of many constants a power law.
LEAST_RIVAL = 0.3
# What a flexible curve beside the effect takes more, over what the effect takes, in rms.
MOST_FORM = 0.5
# By how much a flexible curve beside the effect may lower the rms error (as a difference of logarithms): a tenth. More than that, and
# more than chance (`least_rival`), is another form.
MOST_GAIN = 0.11
# What a curve over the effect's own variable, beside it or in its place, takes more on the records it was fitted to, over what the effect
# takes, in rms. A curve beside the right form takes what its heights take from noise and, as no model is complete, a little more.
MOST_OWN_FORM = 0.04
# Root of the relative difference by which a free curve in the effect's place must cost more, wherever it is and whatever it is over: 4 %.
# Where one does as well, the place or the name is open.
LEAST_FREE = 0.2
# What the effect leaves over its own variable, over its signal, in rms. Much of a weak signal is noise: what is no noise, the curve
# beside the effect takes.
MOST_REMAINDER = 0.6
# Share of the error that an effect must take.
CERTAINTY_LEAST_SHARE = 0.05
# Relative change of the effect's constants from one half of the records to the other: an imposter is fitted anew to each.
MOST_CHANGE = 0.4
# What is left beyond noise, over what the effect takes, in rms: an imposter leaves more of the effect whose place it takes.
MOST_LEFT = 0.3
# What is left beyond noise, over what the effect takes, in rms, for an effect whose form no curve can test (play, a delay).
MOST_UNTESTED = 0.1


def grade_effect(probability: float, features: Mapping[str, float], has_equal: bool) -> Grade:
    """The grade of an effect: established only where, beside the probability, no single test speaks against it.

    An effect that another one equals (``has_equal``), of which a parameter is not determined, or whose refit from another start ends
    elsewhere, is probable at most.
    """
    contradicted = (
        has_equal
        or features["undetermined"] > 0
        or features["rival_t"] < LEAST_RIVAL
        or features["static_t"] < LEAST_RIVAL
        or features["curve_size"] > MOST_FORM
        or (
            features["curve_ratio"] > MOST_GAIN
            and features["curve_t"] > LEAST_RIVAL
            and features["curve_size"] > MOST_OWN_FORM
        )
        or features["curve_fit"] > MOST_OWN_FORM
        or features["free_size"] < LEAST_FREE
        or features["remainder"] > MOST_REMAINDER
        or features["share"] < CERTAINTY_LEAST_SHARE
        or features["change"] > MOST_CHANGE
        or features["start"] < 1
        or features["left"] > MOST_LEFT
        or (features["curve_untested"] > 0 and features["left"] > MOST_UNTESTED)
    )
    if probability >= CERTAINTY_ESTABLISHED and not contradicted:
        return Grade.ESTABLISHED
    return Grade.PROBABLE if probability >= CERTAINTY_PROBABLE else Grade.STAND_IN


def _clip(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _gain(loss: float) -> float:
    """By how much a relative difference of mean square errors lowers the logarithm of the rms error; 0 where nobody looked."""
    return _clip(-0.5 * math.log(max(1 + loss, TINY)), 0, 1) if math.isfinite(loss) else 0.0


# By how much such a curve may lower the logarithm of the rms error of those records by chance: beside the right form it is half a
# percent.
CHANCE_GAIN = 0.02
# Standard errors from which such a curve does worse on the validation records than the effect alone.
LEAST_WORSE = 1.0


def _own_form(measures: Mapping[str, float]) -> float:
    """What a curve beside the effect takes more of the records it was fitted to, over what the effect takes, in rms.

    A few heights take up to `CertaintyPolicy.chance_gain` by chance. The validation records may leave the range in which the curve was
    fitted: one that is better within is another form even if it is no better there. 0 where it does worse there: what it takes is
    not seen again.
    """
    gain = measures.get("curve_gain", 0.0)
    if gain < CHANCE_GAIN or measures["curve_t"] > LEAST_WORSE:
        return 0.0
    gained = 1 - math.exp(-2 * gain)
    return _clip(math.sqrt(gained / max(measures["loss"], TINY)), 0, 1)


def _signed_root(value: float) -> float:
    return math.copysign(math.sqrt(abs(value)), value)
