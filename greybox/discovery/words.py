"""The finding in one paragraph: "consistent with" rather than "is" unless everything agrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from greybox.discovery.bench import Trial
from greybox.discovery.gap import Gap
from greybox.discovery.look import Unexplained, where_told
from greybox.discovery.stand_in import StandIn


def story(
    verdict: str,
    chosen: Trial,
    rivals: Sequence[Trial],
    gap: Mapping[str, Gap],
    look: Unexplained,
    curve: StandIn | None = None,
) -> str:
    """What was found, how sure it is, and what it closes."""
    name = " + ".join(chosen.effects)
    worst = max(gap, key=lambda o: gap[o].before / gap[o].floor)
    closed = f"it closes {100 * min(gap[worst].closed, 1.0):.1f} % of the gap in {worst} on records not used for it"
    if verdict == "complete":
        return "Nothing is missing beyond the noise: the plain model explains the records."
    if verdict == "unknown":
        nearest = f"; the nearest look-alike is {name} ({closed})" if name else ""
        shape = f" It looks like {look.regions[0]}, at the {where_told(look)}." if look.regions else ""
        drawn = f" As a stand-in, {curve}." if curve else ""
        return f"Something is missing that no effect of the catalogue explains{nearest}.{shape}{drawn}"
    if verdict == "ambiguous":
        others = "; ".join(" + ".join(t.effects) for t in rivals)
        return f"The records are consistent with {name} ({closed}), and as well with: {others}. They cannot tell these apart."
    return f"The records are consistent with {name}: {closed}."
