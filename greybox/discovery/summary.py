"""The conclusion of a search as findings: what is missing and how certain that is, the error it takes, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from greybox.base import Finding
from greybox.base.json_shape import to_values
from greybox.discovery.answer import SearchAnswer
from greybox.discovery.claims import SENSOR_CLASS, Claim, deepest_established, name_claim, place_within_sensor_class
from greybox.discovery.decision import Grade, Verdict, judge_holdout, judge_residual
from greybox.discovery.effect_signal import RemainingError
from greybox.discovery.findings import DiscoveryCode, DiscoveryRule
from greybox.discovery.holdout import PARTIAL_SHARE, VALIDATION_SHARE, HoldoutError, worst_output
from greybox.discovery.laws.terms import Law
from greybox.discovery.localisation import ResidualLocalisation
from greybox.discovery.surrogate import Surrogate, find_missing_sites


def _list_rest(answer: SearchAnswer) -> list[str]:
    """Where the model of an answer leaves more than noise: on ``fitted``, ``judging`` or ``test`` records; a ``correlated`` residual."""
    policy = answer.search.policy.selection
    seen = {
        "fitted": not judge_residual(answer.plain, answer.candidate),
        "judging": not judge_holdout(answer.holdout, answer.noise_limits, policy),
        "test": answer.on_test is not None and not answer.on_test,
        "correlated": any(c.rule == DiscoveryRule.WHITE_RESIDUAL and not c.passed for c in answer.rest.checks),
    }
    return [place for place, is_seen in seen.items() if is_seen]


def summarise(
    answer: SearchAnswer,
    alternatives: Sequence[Sequence[str]],
    left: Mapping[str, RemainingError],
    location: ResidualLocalisation,
    surrogate: Surrogate | None,
    constants: Mapping[str, int],
) -> tuple[Finding, ...]:
    """The conclusion as findings: the effects and how certain they are, the error they take, and what is left.

    ``constants`` counts those of each candidate.
    """
    decided, claims, rejected = answer.decided, answer.claims, answer.rejected
    is_worse = answer.grounds.is_contradicted
    if decided.verdict is Verdict.COMPLETE:
        return (Finding(DiscoveryCode.NOTHING_MISSING),)
    if decided.checks and decided.checks[-1].rule == DiscoveryRule.SETTLED:
        return (Finding(DiscoveryCode.PLAIN_UNSETTLED),)
    effects = answer.named
    name, output = " + ".join(effects), worst_output(answer.holdout)
    error = answer.holdout[output]
    # With what corrects the shape of an effect: the error is that of the whole model.
    fitted = [e.name for e in answer.added]
    made = {e: c for e in effects if (c := name_claim(claims, e)) is not None}
    grades = {e: made[e].grade if e in made else Grade.STAND_IN for e in effects}
    established = [e for e in effects if grades[e] is Grade.ESTABLISHED]
    reduced = _error_reduced(fitted, answer.holdout, VALIDATION_SHARE)
    explained = {"share": error.share, "output": output}
    remaining = [
        Finding(DiscoveryCode.ERROR_LEFT, subject=o, values={**each.to_values(), "before": answer.holdout[o].before})
        for o, each in left.items()
        if o == output or answer.holdout[o].share < PARTIAL_SHARE
    ]
    if decided.verdict is Verdict.NAMED:
        return (Finding(DiscoveryCode.EFFECT_NAMED, subject=name), *reduced)
    if decided.verdict is Verdict.AMBIGUOUS:
        rivals = [" + ".join(names) for names in alternatives]
        counts = [sum(constants.get(e, 0) for e in names) for names in (effects, *alternatives)]
        values = {**explained, "rivals": rivals, "is_simplest": counts[0] < min(counts[1:], default=0)}
        return (Finding(DiscoveryCode.EFFECTS_TIED, subject=name, values=values), *reduced)
    if decided.verdict is Verdict.PARTLY and established:
        others = {e: grades[e] for e in effects if e not in established}
        values = {"established": established, "others": others, "left": _list_rest(answer)}
        return (Finding(DiscoveryCode.EFFECTS_ESTABLISHED, subject=name, values=values), *reduced, *remaining)
    deepest = deepest_established(claims) if decided.verdict is Verdict.PARTLY else None
    headline: list[Finding] = []
    if deepest is not None:
        headline.append(_say_claim(deepest))
    probable = {e: c.probability for e, c in made.items() if c.grade is Grade.PROBABLE}
    if probable and error.share > 0:
        values = {"probabilities": probable, "others": [e for e in effects if e not in probable]}
        return (*headline, Finding(DiscoveryCode.EFFECTS_PROBABLE, subject=name, values=values), *reduced, *remaining)
    look_alike: list[Finding] = []
    if rejected:
        code = DiscoveryCode.WORSE_ON_TEST if is_worse else DiscoveryCode.NO_LOOK_ALIKE
        look_alike.append(Finding(code, subject=rejected))
    elif name:
        look_alike += [Finding(DiscoveryCode.NEAREST_LOOK_ALIKE, subject=name), *reduced, *remaining]
    missing: list[Finding] = []
    if not location.is_missing:
        missing.append(
            Finding(
                DiscoveryCode.HARDLY_VISIBLE,
                values={"misfit": location.misfit, "bounded": location.is_noise_bounded},
            )
        )
    elif location.likeliest:
        missing.append(_missing_signal(answer, location, surrogate))
    if not headline:
        headline.append(Finding(DiscoveryCode.UNKNOWN_EFFECT))
        if (doubted := place_within_sensor_class(claims)) is not None:
            values = {"size": doubted.size, "limit": SENSOR_CLASS}
            headline.append(Finding(DiscoveryCode.WITHIN_SENSOR_CLASS, subject=doubted.output, values=values))
    if surrogate is None:
        return (*headline, *look_alike, *missing)
    missing.append(Finding(DiscoveryCode.SURROGATE_FITTED, subject=surrogate.site, values=to_values(surrogate)))
    says_more = surrogate.share > error.share  # what explains more comes first
    return (*headline, *(missing + look_alike if says_more else look_alike + missing))


def _error_reduced(effects: Sequence[str], holdout: Mapping[str, HoldoutError], least_share: float) -> list[Finding]:
    """From where to where the error falls: of the output that the plain model misses most, and of others where that is worth a word."""
    first = worst_output(holdout)
    return [
        Finding(
            DiscoveryCode.ERROR_REDUCED,
            subject=output,
            values={"before": e.before, "after": e.after, "unit": e.unit, "share": e.share, "effects": list(effects)},
        )
        for output, e in sorted(holdout.items(), key=lambda item: item[0] != first)
        if output == first or e.share >= least_share
    ]


def _missing_signal(answer: SearchAnswer, location: ResidualLocalisation, surrogate: Surrogate | None) -> Finding:
    """How large the missing signal is, where, and of what it is a function; a curve that explains it says more than the localisation."""
    policy = answer.search.policy.selection
    site, labels = location.sites[0], find_missing_sites(location, surrogate)
    values: dict[str, Any] = {
        "size": site.size,
        "unit": site.unit,
        "sites": list(labels),
        "variable": "",
        "dependence": None,
    }
    if surrogate is not None and labels != location.likeliest:
        values["size"], values["unit"] = float(np.sqrt(np.mean(surrogate.signal.value**2))), surrogate.unit
        values["variable"] = surrogate.variable
    elif (
        surrogate is not None
        and not (surrogate.tone or surrogate.beside)
        and surrogate.explained_fraction >= policy.holdout_share
    ):
        values["variable"] = surrogate.variable
    elif location.dependences and location.dependences[0].is_relevant:
        values["variable"] = location.dependences[0].variable
        values["dependence"] = to_values(location.dependences[0])
    return Finding(DiscoveryCode.MISSING_SIGNAL, subject=", ".join(labels), values=values)


def summarise_laws(
    answer: SearchAnswer,
    laws: Sequence[Law],
    alternatives: Sequence[Sequence[str]],
    left: Mapping[str, RemainingError],
) -> tuple[Finding, ...]:
    """The conclusion with the law: what it is, how certain, what it takes of the error."""
    decided, claims = answer.decided, answer.claims
    terms = [{"equation": law.equation, "site": law.site, "unit": law.unit} for law in laws]
    values = {"laws": terms, "rivals": [" + ".join(texts) for texts in alternatives]}
    made = [name_claim(claims, law.claimed) for law in laws]
    is_established = all(claim is not None and claim.is_established for claim in made)
    certain = DiscoveryCode.LAW_ESTABLISHED if is_established else DiscoveryCode.LAW_PROBABLE
    code = DiscoveryCode.LAWS_TIED if alternatives else certain
    output = worst_output(answer.holdout)
    # What is certain comes first.
    deepest = deepest_established(claims) if decided.verdict is Verdict.PARTLY and not is_established else None
    headline = [] if deepest is None else [_say_claim(deepest)]
    reduced = _error_reduced([law.name for law in laws], answer.holdout, VALIDATION_SHARE)
    likeness = [
        Finding(
            DiscoveryCode.LAW_LIKENESS, subject=law.equation, values={"several": len(laws) > 1, **asdict(law.likeness)}
        )
        for law in laws
        if law.likeness is not None
    ]
    remaining = [
        Finding(DiscoveryCode.ERROR_LEFT, subject=o, values={**each.to_values(), "before": answer.holdout[o].before})
        for o, each in left.items()
        if decided.verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS) and o == output
    ]
    return (*headline, Finding(code, values=values), *likeness, *reduced, *remaining)


def _say_claim(claim: Claim) -> Finding:
    return Finding(DiscoveryCode.CLAIM_ESTABLISHED, subject=claim.output, values=to_values(claim))


def list_law_ranges(laws: Sequence[Law]) -> tuple[Finding, ...]:
    """Within what each law was seen."""
    return tuple(
        Finding(
            DiscoveryCode.LAW_RANGE,
            subject=law.equation,
            values={"range": {v: list(ends) for v, ends in law.seen.items()}, "units": dict(law.units)},
        )
        for law in laws
        if law.seen
    )
