"""The finding in one paragraph: "consistent with" rather than "is" unless everything agrees."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from greybox.discovery import decision
from greybox.discovery.dependence import WORTH
from greybox.discovery.holdout_error import HoldoutError
from greybox.discovery.localisation import ResidualLocalisation, describe_likeliest_site
from greybox.discovery.problem import CandidateFit
from greybox.discovery.surrogate import Surrogate


def summarise(
    verdict: str,
    chosen: CandidateFit,
    rivals: Sequence[CandidateFit],
    gap: Mapping[str, HoldoutError],
    look: ResidualLocalisation,
    curve: Surrogate | None = None,
) -> str:
    """What was found, how sure it is, and what it closes."""
    name = " + ".join(chosen.effects)
    worst = max(gap, key=lambda o: gap[o].before / gap[o].floor)
    explained_fraction = f"it closes {100 * min(gap[worst].explained_fraction, 1.0):.1f} % of the gap in {worst} on records not used for it"
    if verdict == "complete":
        return "Nothing is missing beyond the noise: the plain model explains the records."
    if verdict == "unknown":
        said = ["Something is missing that no effect of the catalogue explains.", _nearest(name, worst, gap[worst])]
        return " ".join([*filter(None, said), *_unknown(look, curve)])
    if verdict == "ambiguous":
        others = "; ".join(" + ".join(t.effects) for t in rivals)
        return f"The records are consistent with {name} ({explained_fraction}), and as well with: {others}. They cannot tell these apart."
    return f"The records are consistent with {name}: {explained_fraction}."


def _nearest(name: str, output: str, gap: HoldoutError) -> str:
    """The nearest look-alike and how near that is."""
    if not name:
        return ""
    if gap.explained_fraction <= 0:
        return f"Nothing in it does better than the plain model on records not used for it; the nearest on the others is {name}."
    share = f"{'only ' if gap.explained_fraction < decision.PARTLY else ''}{100 * gap.explained_fraction:.3g} %"
    return f"The nearest look-alike, {name}, closes {share} of the gap in {output} on records not used for it."


def _unknown(look: ResidualLocalisation, curve: Surrogate | None) -> Iterator[str]:
    """What is missing, where, as a function of what, and what stands in for it."""
    if not look.missing:
        yield f"It hardly shows in the estimation records: the plain model's misfit there is {look.misfit:.3g} times the noise."
    elif look.where:
        size = f"{look.sites[0].size:.3g} {look.sites[0].unit}".rstrip()
        yield f"The plain model lacks {size} rms at the {describe_likeliest_site(look)}: {_dependence(look, curve)}."
    if curve is not None:
        yield f"As a stand-in, {curve}."


def _dependence(look: ResidualLocalisation, curve: Surrogate | None) -> str:
    """Of what the missing signal is a function; a curve that explains it says more than the first look."""
    if curve is not None and curve.tone is None and curve.explained_fraction >= decision.HELD_OUT and not curve.beside:
        return f"a function of {curve.variable}"
    best = look.dependences[0] if look.dependences else None
    return str(best) if best is not None and best.share + best.loop > WORTH else "no function of any one variable"
