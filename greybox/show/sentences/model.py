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
from greybox.model.parts import PARTS, Occurrence
from greybox.model.sites import NEEDED
from greybox.show.sentences import renders

if TYPE_CHECKING:
    from greybox.model import Effect, Model, Parameter
    from greybox.model.effects import Placement, SignalRole


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


# The catalogue of effects as text and as a page, and where its effects find a place in a model.

HEAD = """# Catalogue of effects

These effects are tried by `greybox discover` and added to a model by `--effect NAME` or `model + gb.effect("NAME")`. An added effect
changes nothing while its amplitude is zero. `greybox effects MODEL` lists those that find a place in a model. Where a model has
several sites (bodies, inputs, outputs), the name alone means the first, and `NAME_at_SITE` another one. If yours is missing, write
[your own](own_effect.md).

In equations `x` and `v` are displacement and velocity of a body, `u` is the input and `y` the output at the site. Units in braces are
those of the model: `{force}` is that of its balance.
"""

PARTS_HEAD = """
## Parts of a rig, and what is usual

Records alone cannot refuse an effect with memory: it follows whatever is left. Knowledge of the rig can. A model says what the rig has
in one line, `Model(..., has=("gear", "fluid"), lacks=("spring",))`, a study file as `has` and `lacks`, the command line as
`--has gear --lacks spring`. Effects whose parts the rig lacks are not tried; what nobody has said is possible. Some follows from the
model: without an input there is no motor, and a body that nothing drives or holds hangs on no spring. What is said counts before what
follows. A model that lists its `candidates` has said what may hide; only parts that it is told to lack leave one of them out.

The classes below ({classes}) are a judgement on the counts of 109
published, shipped or fitted models of rigs, good to a factor of two: which share of the rigs with the part lacks the effect in its
plain model, at one place. They order what does equally well on the records, and never make a name
more certain. An effect of your own counts as common.

"""

ROLES_HEAD = """# Roles

A role says what a signal or a parameter is physically; names are yours. Effects of the catalogue ask for roles, so that one Coulomb
friction serves every body:

```text
State("w", "rad/s", role="velocity")
Input("Ta", "K", role="ambient_temperature")
Parameter("Ra", "ohm", 8.0, role="resistance")
```

Most of it goes without: a balance in N or N m of a state in m/s or rad/s is that of a body, the state whose rate is this velocity its
displacement; a balance in V of a state in A is that of a current, and so on; an input without a role is a drive. The only temperature
among the inputs and parameters of a heat balance is the ambient one, the only constant in ohm in the balance of a current its resistance.

`greybox check MODEL` shows the role of each signal, the effects that find a place, and what would open the others; `greybox effects
MODEL` lists the same effect by effect. Several signals may have one role: each body has its own velocity, each tank its own level. Where
an effect asks for a role and its site does not tell which is meant, it is the first.
"""

ROLES_TAIL = """Beside these, the effects at `pressure_a` and `upper_level` look for balances of these names, as the [pneumatic
chain](tutorial_pneumatic.md) and the cascaded tanks have them. What an effect needs stands with it in the [catalogue](catalogue.md).

## Plants to start from

`greybox init DIR --plant NAME` writes a model with all roles: `rotary-drive` (velocity, current, resistance, inductance),
`two-mass` (two bodies on a shaft), `stage` (displacement and velocity), `cylinder` (pressure and valve), `thermal` (temperature
and ambient temperature), `tanks` and `tank-chain` (levels), `chamber` (pressure of a vessel), `circuit` (current, inductance).
"""


def write_catalogue_page(entries: Sequence[Effect]) -> str:
    """The page of the documentation: all effects by where they act, then a section for each."""
    at_site: dict[str, list[str]] = {}
    for e in entries:
        at_site.setdefault(e.site, []).append(e.name)
    lines = [HEAD, *(f"- {site}: {_names(names, ', ')}" for site, names in at_site.items())]
    classes = ", ".join(f"{kind} {kind.probability:g}" for kind in Occurrence)
    lines += [PARTS_HEAD.format(classes=classes) + "| part | what it is |", "|---|---|"]
    lines += [f"| `{p.name}` | {p.meaning} |" for p in PARTS]
    for e in entries:
        needed = NEEDED.get(e.site, f"the balance `{e.site}`")
        parts = f", of a rig with {' or '.join(f'`{name}`' for name in e.needs)}" if e.needs else ""
        usual = ", ".join([e.occurs, *(f"with `{name}` {kind}" for name, kind in e.occurs_with.items())])
        lines += ["", f"## {e.name}", "", f"`{e.equation}`", "", f"Needs {needed}{parts}; {usual}.", ""]
        lines += [f"- `{q.name}` [{_plain(q.unit)}]: {q.description}" for q in e.parameters]
        lines += [""] if e.parameters else []
        if e.parents:
            lines += [f"Contains {_names(e.parents)}.", ""]
        if e.approaches:
            lines += [f"Approaches {_names(e.approaches)} at the end of its range.", ""]
        if e.stands_for:
            lines += [f"Says the same as {_names(e.stands_for, ' with ')}, and is no candidate where these are.", ""]
        lines += [f"Tell it apart: {e.tells_apart}", "", f"Source: {e.source}."]
    return "\n".join(lines) + "\n"


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


def write_roles_page(roles: Sequence[SignalRole]) -> str:
    """The page of the documentation: every role with units, meaning and what it opens."""
    lines = [ROLES_HEAD, "| role | of | units | what it is | opens |", "|---|---|---|---|---|"]
    lines += [
        f"| `{r.name}` | {', '.join(r.owners)} | {', '.join(r.units)} | {r.meaning} | {r.needed_for} |" for r in roles
    ]
    return "\n".join([*lines, "", ROLES_TAIL])


def _names(names: Sequence[str], word: str = " and ") -> str:
    return word.join(f"[{name}](#{name})" for name in names)


def write_units(parameters: Sequence[Parameter]) -> str:
    """``Fc [N], vs [m/s]``."""
    return ", ".join(f"{q.name} [{_plain(q.unit)}]" for q in parameters)


def _plain(unit: str) -> str:
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
