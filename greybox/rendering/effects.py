"""The catalogue of effects as text and as a page, and where its effects find a place in a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from greybox.model.sites import NEEDED
from greybox.rendering.registry import renders
from greybox.rendering.tables import format_table
from greybox.units import format_unit

if TYPE_CHECKING:
    from greybox.effects import EffectListing, Placement
    from greybox.model import Effect
    from greybox.model.signals import Parameter

HEAD = """# Catalogue of effects

These effects are tried by `greybox discover` and added to a model by `--effect NAME` or `model + gb.effect("NAME")`. An added effect
changes nothing while its amplitude is zero. `greybox effects MODEL` lists those that find a place in a model. Where a model has
several sites (bodies, inputs, outputs), the name alone means the first, and `NAME_at_SITE` another one. If yours is missing, write
[your own](own_effect.md).

In equations `x` and `v` are displacement and velocity of a body, `u` is the input and `y` the output at the site. Units in braces are
those of the model: `{force}` is that of its balance.
"""


@renders("EffectListing")
def write_effects(listing: EffectListing) -> str:
    """Name, place, equation and units of each effect, and why some have no place."""
    if not listing.model:
        rows = [[e.name, e.site, _write_units(e.parameters), e.equation] for e in listing.entries]
        return "\n".join(format_table(["effect", "acts at", "parameters", "equation"], rows))
    taken = [p for p in listing.placements if p.effect is not None]
    units = {p.name: _write_units(p.parameters) for p in taken}
    rows = [[p.name, p.site, units[p.name], p.effect.equation if p.effect else ""] for p in taken]
    lines = [f"{listing.model} takes {len(taken)} effect{'s' if len(taken) != 1 else ''}:"]
    lines += format_table(["effect", "at", "parameters", "equation"], rows)
    refused = [p for p in listing.placements if p.effect is None]
    if refused:
        lines += ["", "no place for:", *format_table(["effect", "why not"], [[p.name, _shorten(p)] for p in refused])]
    return "\n".join(lines)


def write_catalogue_page(entries: Sequence[Effect]) -> str:
    """The page of the documentation: a table of all effects, then a section for each."""
    lines = [HEAD, "| effect | acts at | equation |", "|---|---|---|"]
    lines += [f"| [{e.name}](#{e.name}) | {e.site} | `{e.equation.replace('|', chr(92) + '|')}` |" for e in entries]
    for e in entries:
        needed = NEEDED.get(e.site, f"the balance `{e.site}`")
        lines += ["", f"## {e.name}", "", f"`{e.equation}`", "", f"Needs {needed}.", ""]
        lines += [f"- `{q.name}` [{_plain(q.unit)}]: {q.description}" for q in e.parameters]
        lines += [""] if e.parameters else []
        if e.parents:
            lines += [f"Contains {_names(e.parents)}.", ""]
        if e.stands_for:
            lines += [f"Says the same as {_names(e.stands_for, ' with ')}, and is no candidate where these are.", ""]
        lines += [f"Tell it apart: {e.tells_apart}", "", f"Source: {e.source}."]
    return "\n".join(lines) + "\n"


def _names(names: Sequence[str], word: str = " and ") -> str:
    return word.join(f"[{name}](#{name})" for name in names)


def _write_units(parameters: Sequence[Parameter]) -> str:
    return ", ".join(f"{q.name} [{_plain(q.unit)}]" for q in parameters)


def _plain(unit: str) -> str:
    return (unit if "{" in unit else format_unit(unit)) or "1"


def _shorten(placement: Placement) -> str:
    """The reason without the sentence that names effect and model again."""
    begin = f"effect {placement.name!r} acts at "
    reason = placement.reason.removeprefix(begin)
    if reason is placement.reason:
        return reason
    site, _, remedy = reason.partition(", which")
    remedy = remedy.partition("; ")[2]
    return remedy if remedy.startswith("it needs") else f"it needs a balance {site}"
