"""What the shell offers when Tab is pressed: models, effects, parameters, outputs. A mistake in what was typed so far offers nothing."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from glob import escape, glob
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from greybox.errors import GreyboxError

if TYPE_CHECKING:
    from greybox.model import Model

Offer = tuple[str, str]  # what to type, and what it is


def models(incomplete: str) -> list[Offer]:
    """Names of models, and model files that begin so."""
    from greybox.project import list_models

    offers = [(item.name, item.model.description) for item in list_models().models]
    files = sorted(Path(text) for text in glob(f"{escape(incomplete)}*")) if incomplete else []
    near = [(f"{path}/", "a folder") if path.is_dir() else (str(path), "a model file") for path in files]
    return _beginning([*offers, *(offer for offer in near if offer[0].endswith(("/", ".py")))], incomplete)


def effects(incomplete: str) -> list[Offer]:
    """Effects of the catalogue; after a comma or plus the next one."""
    from greybox.effects import CATALOGUE

    before = incomplete[: max(incomplete.rfind(","), incomplete.rfind("+")) + 1]
    return _beginning(((before + e.name, e.equation) for e in CATALOGUE), incomplete)


def constants(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the parameters of the model that was named, with those of its effects."""
    return _offered(ctx, incomplete, _constants)


def constant_names(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """`constants` without ``=``."""
    return [(name.rstrip("="), what) for name, what in constants(ctx, incomplete)]


def outputs(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's outputs."""
    return _offered(ctx, incomplete, lambda m: ((f"{o.name}=", f"[{o.unit}] {o.description}") for o in m.outputs))


def states(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of the model's states."""
    return _offered(ctx, incomplete, lambda m: ((f"{s.name}=", f"[{s.unit}] {s.description}") for s in m.all_states))


def signals(ctx: typer.Context, incomplete: str) -> list[Offer]:
    """``NAME=`` of what a record holds: time, inputs and outputs."""
    return _offered(ctx, incomplete, _signals)


def _constants(model: Model) -> Iterator[Offer]:
    for q in model.all_parameters:
        yield f"{q.name}=", f"{q.value:g} {q.unit}, {q.description}"


def _signals(model: Model) -> Iterator[Offer]:
    yield "time=", "[s]"
    yield from ((f"{i.name}=", f"[{i.unit}] {i.description}") for i in model.inputs)
    yield from ((f"{o.name}=", f"[{o.unit}] {o.description}") for o in model.outputs)


def _offered(ctx: typer.Context, incomplete: str, offers: Callable[[Model], Iterable[Offer]]) -> list[Offer]:
    from greybox.effects import effect
    from greybox.project import find_model

    # A line that ends in an option without its value is not taken apart: the words are left in args.
    name = ctx.params.get("model") or next(iter(ctx.args), None)
    if name is None:
        return []
    words = (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()
    try:
        model = find_model(name)
        for option, value in pairwise(words):
            model = model + effect(value) if option == "--effect" else model
    except GreyboxError:  # nothing of that name: nothing to offer
        return []
    return _beginning(offers(model), incomplete)


def _beginning(offers: Iterable[Offer], incomplete: str) -> list[Offer]:
    return [(text, what) for text, what in offers if text.startswith(incomplete)]
