"""A law written with its constants as numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence

from greybox.discovery.laws.terms import LAW, LawTerm
from greybox.expressions.text import number_text
from greybox.model import Model


def write_equation(model: Model, terms: Sequence[LawTerm]) -> tuple[str, ...]:
    """Each term of a model's law with its constants as numbers: ``-0.6*a*b``."""
    names = [e.name for e in model.effects if e.name.partition("_")[0] == LAW]
    return tuple(_write(model, name, term) for name, term in zip(names, terms, strict=True))


def law_values(model: Model, name: str) -> dict[str, float]:
    """The constants of the effect ``name`` by its own names."""
    bound = next(b for b in model.bound_effects if b.effect.name == name)
    return {inner: model.values[in_model] for inner, in_model in bound.model_names.items() if in_model in model.values}


def _write(model: Model, name: str, term: LawTerm) -> str:
    values = law_values(model, name)
    text = term.formula
    for inner, value in values.items():
        number = number_text(value)
        text = re.sub(rf"\b{re.escape(inner)}\b", f"({number})" if value < 0 else number, text)
    if text.startswith("(-"):  # the amplitude, which comes first
        text = text[1:].replace(")", "", 1)
    lag = values.get(term.constants.lag) if term.has_memory else None
    return text if lag is None else f"lag({text}, {number_text(lag)})"
