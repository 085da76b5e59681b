"""The effects of the catalogue, and where they find a place in a model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from greybox.base.document import Document, Later, TableBlock
from greybox.model.parts import PARTS
from greybox.show.sentences.model import shorten_reason, write_units
from greybox.show.sentences.wording import count_noun

if TYPE_CHECKING:
    from greybox.model.effects import EffectListing

HEAD = ("effect", "at", "parameters", "equation")


def describe_effects(listing: EffectListing) -> Document:
    """How many effects there are, by site; each with its parameters and its equation, and why some have no place."""
    taken = [p for p in listing.placements if p.effect is not None]
    if listing.model:
        answer = (
            f"{listing.model} takes {count_noun(len(taken), 'effect')} of {len(listing.placements)} that are known."
        )
        sites = [(p.site, p.name) for p in taken]
    else:
        answer, sites = (
            f"{count_noun(len(listing.entries), 'effect')} can be added to a model.",
            [(e.site, e.name) for e in listing.entries],
        )
    full = list(_tables(listing))
    if len(sites) == 1:
        return Document("Effects", f"{sites[0][1]} acts at {sites[0][0]}.", table=full[: 1 + bool(listing.model)])
    return Document("Effects", answer, table=[_by_site(sites)], details=Later(lambda: full))


def _by_site(sites: Sequence[tuple[str, str]]) -> TableBlock:
    groups: dict[str, list[str]] = {}
    for site, name in sites:
        groups.setdefault(site, []).append(name)
    return TableBlock(
        "Effects by site",
        ["acts at", "effects"],
        [[site or "anywhere", ", ".join(names)] for site, names in groups.items()],
    )


def _tables(listing: EffectListing) -> Iterator[TableBlock]:
    if not listing.model:
        yield TableBlock(
            "Effects", HEAD, [[e.name, e.site, write_units(e.parameters), e.equation] for e in listing.entries]
        )
        yield TableBlock("Parts that a rig has or lacks", ["part", "what it is"], [[p.name, p.meaning] for p in PARTS])
        return
    rows = [
        [p.name, p.site, write_units(p.parameters), p.effect.equation]
        for p in listing.placements
        if p.effect is not None
    ]
    yield TableBlock("Effects", HEAD, rows)
    refused = [[p.name, shorten_reason(p)] for p in listing.placements if p.effect is None]
    if refused:
        yield TableBlock("Effects without a place", ["effect", "why it has no place"], refused)
