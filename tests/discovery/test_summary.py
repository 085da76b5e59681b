"""The conclusion as findings, from an answer that is given: nothing is simulated."""

from types import SimpleNamespace

import numpy as np
import pytest

from greybox.discovery.claims import NO_GROUNDS
from greybox.discovery.decision import Conclusion, Verdict
from greybox.discovery.findings import DiscoveryCode
from greybox.discovery.holdout import HoldoutError
from greybox.discovery.policy import DiscoveryPolicy
from greybox.discovery.summary import summarise as summarise_answer

LOCATION = SimpleNamespace(
    is_missing=True,
    likeliest=("sensor of s",),
    sites=[SimpleNamespace(size=1e-3, unit="m")],
    dependences=(),
)


def summarise(effects, surrogate_share, look_alike_share=0.5):
    """The codes, and the values of the missing signal, of an answer without an established effect."""
    error = HoldoutError(1.0, 1 - look_alike_share, 0.01, "m")
    answer = SimpleNamespace(
        added=[SimpleNamespace(name=name) for name in effects],
        named=effects,
        holdout={"s": error},
        search=SimpleNamespace(policy=DiscoveryPolicy()),
        decided=Conclusion(Verdict.UNKNOWN, ()),
        claims=(),
        rejected="",
        grounds=NO_GROUNDS,
    )
    surrogate = None
    if surrogate_share is not None:
        surrogate = SimpleNamespace(
            site="input u",
            unit="V",
            variable="u",
            tone=None,
            beside=(),
            share=surrogate_share,
            explained_fraction=surrogate_share,
            signal=SimpleNamespace(value=np.array([3.0, -3.0])),
            to_values=lambda: {"site": "input u"},
        )
    findings = summarise_answer(answer, (), {}, LOCATION, surrogate, {})
    missing = next(f for f in findings if f.code == DiscoveryCode.MISSING_SIGNAL)
    return [f.code for f in findings], missing


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (0.9, ["unknown_effect", "missing_signal", "surrogate_fitted", "nearest_look_alike", "error_reduced"]),
        (0.3, ["unknown_effect", "nearest_look_alike", "error_reduced", "missing_signal", "surrogate_fitted"]),
        (None, ["unknown_effect", "nearest_look_alike", "error_reduced", "missing_signal"]),
    ],
    ids=["the curve explains more", "the effect explains more", "no curve"],
)
def test_what_explains_more_of_the_error_comes_first(share, expected):
    assert summarise(["supply_droop"], share)[0] == expected


def test_the_missing_signal_is_where_the_curve_explains_most_of_it():
    _, missing = summarise([], 0.9, look_alike_share=0.0)
    assert (missing.subject, missing.values["size"], missing.values["unit"]) == ("input u", 3.0, "V")
    assert missing.values["variable"] == "u"
    _, missing = summarise([], 0.3, look_alike_share=0.0)
    assert (missing.subject, missing.values["size"], missing.values["unit"]) == ("sensor of s", 1e-3, "m")
