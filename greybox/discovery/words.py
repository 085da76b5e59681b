"""The finding in one paragraph: "consistent with" rather than "is" unless everything agrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from greybox.discovery.bench import Trial
from greybox.discovery.result import Gap


def story(verdict: str, chosen: Trial, rivals: Sequence[Trial], gap: Mapping[str, Gap]) -> str:
    """What was found, how sure it is, and what it closes."""
    name = " + ".join(chosen.effects)
    worst = max(gap, key=lambda o: gap[o].before / gap[o].floor)
    closed = f"it closes {100 * gap[worst].closed:.1f} % of the gap in {worst} on records not used for it"
    if verdict == "complete":
        return "Nothing is missing beyond the noise: the plain model explains the records."
    if verdict == "unknown" and not name:
        return "Something is missing, and no effect of the catalogue explains it."
    if verdict == "unknown":
        return f"Something is missing that the catalogue does not explain; the nearest look-alike is {name} ({closed})."
    if verdict == "ambiguous":
        others = "; ".join(" + ".join(t.effects) for t in rivals)
        return f"The records are consistent with {name} ({closed}), and as well with: {others}. They cannot tell these apart."
    return f"The records are consistent with {name}: {closed}."
