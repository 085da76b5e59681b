"""What the shell offers when Tab is pressed: models, effects, parameters, outputs. A mistake in what was typed so far offers nothing.

Model files are read as text (`greybox.shell.outline`): Tab runs nothing that lies around.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from glob import escape, glob
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import click

from greybox.base.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.shell.outline import ModelOutline

Offer = tuple[str, str]  # what to type, and what it is


def models(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Names of models, and model files that begin so."""
    from greybox.shell.outline import list_outlines

    offers = [(item.name, item.description) for item in list_outlines()]
    files = sorted(Path(text) for text in glob(f"{escape(incomplete)}*")) if incomplete else []
    near = [(f"{path}/", "a folder") if path.is_dir() else (str(path), "a model file") for path in files]
    return _beginning([*offers, *(offer for offer in near if offer[0].endswith(("/", ".py")))], incomplete)


def commands(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Commands that print JSON."""
    from greybox.shell.printed import list_printed

    return _beginning(((name, "") for name in list_printed()), incomplete)


def effects(ctx: click.Context, incomplete: str) -> list[Offer]:
    """Effects of the catalogue; after a comma or plus the next one."""
    from greybox.model.effects.catalogue import all_effects

    before = incomplete[: max(incomplete.rfind(","), incomplete.rfind("+")) + 1]
    return _beginning(((before + e.name, e.equation) for e in all_effects()), incomplete)


def constants(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the parameters of the model that was named, with those of its effects."""
    return _offered(ctx, incomplete, _constants)


def constant_names(ctx: click.Context, incomplete: str) -> list[Offer]:
    """`constants` without ``=``."""
    return [(name.rstrip("="), what) for name, what in constants(ctx, incomplete)]


def outputs(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's outputs."""
    return _offered(ctx, incomplete, lambda m: _signals(m, "outputs"))


def states(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's states."""
    return _offered(ctx, incomplete, lambda m: _signals(m, "states"))


def signals(ctx: click.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of what a record holds: time, inputs and outputs."""
    return _offered(ctx, incomplete, lambda m: [("time=", "[s]"), *_signals(m, "inputs"), *_signals(m, "outputs")])


def _constants(model: ModelOutline) -> Iterator[Offer]:
    for q in model.parameters.values():
        yield f"{q.name}=", " ".join(filter(None, (q.value, f"{q.unit},", q.description)))


def _signals(model: ModelOutline, group: str) -> Iterator[Offer]:
    for s in getattr(model, group).values():
        yield f"{s.name}=", f"[{s.unit}] {s.description}"


def _offered(ctx: click.Context, incomplete: str, offers: Callable[[ModelOutline], Iterable[Offer]]) -> list[Offer]:
    from greybox.shell.outline import SignalOutline, find_outline

    # A line that ends in an option without its value is not taken apart: the words are left in args.
    name = ctx.params.get("model") or next(iter(ctx.args), None)
    model = find_outline(name) if name is not None else None
    if model is None:
        return []
    words = os.environ.get("COMP_WORDS", "").split()
    added = [value for option, value in pairwise(words) if option == "--effect"]
    if added:
        from greybox.model.effects.catalogue import effect

        try:
            for entry in map(effect, added):
                for q in entry.parameters:
                    model.parameters.setdefault(q.name, SignalOutline(q.name, q.unit, f"{q.value:g}", q.description))
                for s in entry.states:
                    model.states.setdefault(s.name, SignalOutline(s.name, s.unit, "", s.description))
        except GreyboxError:  # no effect of that name: nothing to offer
            return []
    return _beginning(offers(model), incomplete)


def _beginning(offers: Iterable[Offer], incomplete: str) -> list[Offer]:
    return [(text, what) for text, what in offers if text.startswith(incomplete)]
