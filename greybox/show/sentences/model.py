"""Models in plain text: title, equations, parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import TYPE_CHECKING

from greybox.base import format_unit, texts
from greybox.model import equations_text
from greybox.model.effects.catalogue import AT
from greybox.model.effects.roles import ROLES
from greybox.model.effects.signal_path import MISREAD
from greybox.model.expressions.text import number_text
from greybox.model.sites import NEEDED
from greybox.show.sentences import renders

if TYPE_CHECKING:
    from greybox.model import Model, Parameter
    from greybox.model.effects import Placement


@renders("Model")
def _write_model(model: Model) -> str:
    return write_model(model)


def write_model(model: Model, *, in_full: bool = False) -> str:
    """Title, equations and parameters of a model; ``in_full`` with what stands behind the names of blocks."""
    title = f"{model.title}: {model.description}" if model.description else model.title
    parameters = ["  parameters", *_table([_row(q) for q in model.all_parameters])] if model.all_parameters else []
    lines = texts.wrap(title, texts.LINE_WIDTH, "  ")
    return "\n".join([*lines, equations_text(model, texts.LINE_WIDTH, in_full=in_full), *parameters])


def _row(parameter: Parameter) -> tuple[str, ...]:
    low, high = parameter.bounds
    bounded = math.isfinite(low) or math.isfinite(high)
    return (
        parameter.name,
        number_text(parameter.value),
        format_unit(parameter.unit) or "-",
        "fixed" if parameter.fixed else "free",
        f"[{number_text(low)}, {number_text(high)}]" if bounded else "",
        "" if parameter.prior is None else "prior " + " +- ".join(map(number_text, parameter.prior)),
        parameter.source,
    )


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    indent = 4 + sum(width + 2 for width in widths[:-1] if width)
    lines = []
    for row in rows:
        line = "    " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True) if width)
        # Where a value comes from goes on below itself.
        lines += texts.wrap(line.rstrip(), texts.LINE_WIDTH, " " * min(indent, texts.LINE_WIDTH - 30))
    return lines


# Where the effects of the catalogue find a place in a model.


def describe_missing(placement: Placement) -> str:
    """What would open a place for an effect that has none; empty where nothing would."""
    if placement.missing is None:
        return ""
    kind, name = placement.missing
    role = next((role for role in ROLES if role.name == name), None)
    if kind == "site":
        return NEEDED.get(name, f"a balance named `{name}`")
    if role is None:
        return f"a {kind} named `{name}`" if kind != "unit" else f"something named `{name}`"
    owners = " or ".join(f"{'an' if owner == 'input' else 'a'} {owner}" for owner in role.owners)
    return f"{owners} with the role `{name}`"


def write_places(placements: Sequence[Placement]) -> list[str]:
    """Lines: how many effects find a place, which they are, by site, and for the others what the model would have to have."""
    count, misread = sum(p.effect is not None for p in placements), {effect.name for effect in MISREAD}
    # What a record of any plant may have wrong has a place at each of its signals, and is said once.
    of_record = dict.fromkeys(n for p in placements if p.effect and (n := p.name.partition(AT)[0]) in misread)
    placements = [p for p in placements if p.name.partition(AT)[0] not in misread]
    sites = dict.fromkeys(p.site for p in placements if p.effect is not None)
    alike: dict[tuple[str, ...], list[str]] = {}
    for site in sites:
        names = tuple(p.name.partition(AT)[0] for p in placements if p.effect and p.site == site)
        alike.setdefault(names, []).append(site)
    at_site = {", ".join(group): names for names, group in alike.items()}
    head = f"{count} find a place{'; in the record of any signal: ' if of_record else ''}{', '.join(of_record)}"
    lines = [head, *_listed({f"at {site}" if site else "anywhere": names for site, names in at_site.items()})]
    lacking: dict[str, list[str]] = {}
    placed = {p.name.partition(AT)[0] for p in placements if p.effect is not None}
    for p in placements:
        if p.effect is None and p.name not in placed and (needed := describe_missing(p)):
            lacking.setdefault(needed, []).append(p.name)
    if lacking:
        lines += ["the others need", *_listed(lacking)]
    return lines


def _listed(groups: Mapping[str, Sequence[str]]) -> list[str]:
    """A head and names a group, in lines that a terminal holds."""
    return [
        line
        for head, names in groups.items()
        for line in wrap(f"{head}: {', '.join(names)}", 118, initial_indent="  ", subsequent_indent="      ")
    ]


def write_units(parameters: Sequence[Parameter]) -> str:
    """``Fc [N], vs [m/s]``."""
    return ", ".join(f"{q.name} [{write_plain_unit(q.unit)}]" for q in parameters)


def write_plain_unit(unit: str) -> str:
    """A unit in brackets: that of a place as it is written, and 1 for none."""
    return (unit if "{" in unit else format_unit(unit)) or "1"


def shorten_reason(placement: Placement) -> str:
    """The reason without the sentence that names effect and model again."""
    begin = f"effect {placement.name!r} acts at "
    reason = placement.reason.removeprefix(begin)
    if reason is placement.reason:
        return reason
    site, _, remedy = reason.partition(", which")
    remedy = remedy.partition("; ")[2]
    return remedy if remedy.startswith("it needs") else f"it needs a balance {site}"
