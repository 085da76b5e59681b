"""The equations of a model, typeset: one line a balance, then what holds, delays, sets and measures."""

from __future__ import annotations

import re
from collections.abc import Iterator

import casadi as ca

from greybox.base.document import Equation, EquationList
from greybox.base.units import format_unit
from greybox.model.algebraic import stores_nothing
from greybox.model.balance import Balance
from greybox.model.equations import equations_text
from greybox.model.expressions.operations import Binding
from greybox.model.expressions.text import LATEX, expression_latex, symbol_latex
from greybox.model.model import Model


def typeset_equations(model: Model) -> EquationList:
    """The equations of ``model`` with every effect written out, and the same as text."""
    return EquationList(
        [*_balances(model), *_standstill(model), *_updates(model), *_outputs(model)], equations_text(model)
    )


def _balances(model: Model) -> Iterator[Equation]:
    for balance in model.system.stated_balances:
        yield Equation(balance.name, format_unit(balance.unit), f"{_storage(balance)} = {_terms(balance)}")


def _storage(balance: Balance) -> str:
    if stores_nothing(balance):
        return "0"
    rate = rf"\frac{{\mathrm{{d}}{symbol_latex(balance.state)}}}{{\mathrm{{d}}t}}"
    factor = LATEX.write(balance.storage)
    return rate if factor.text == "1" else rf"{factor.within(Binding.NEGATION, LATEX.brackets)}\,{rate}"


def _terms(balance: Balance) -> str:
    """The terms with their names below."""
    text = ""
    for name, value in balance.terms.items():
        term = LATEX.write(value)
        sign = "-" if term.opposite else ("+" if text else "")
        text += rf" {sign} \underset{{\text{{{_words(name)}}}}}{{{term.opposite or term.text}}}"
    return text.strip()


def _standstill(model: Model) -> Iterator[Equation]:
    for dry in model.system.dry:
        if dry.static.element_hash() != dry.sliding.element_hash():
            unit = next(b.unit for b in model.system.balances if b.name == dry.balance)
            yield Equation(
                f"{_words(dry.effect)} holds at standstill up to", format_unit(unit), expression_latex(dry.static)
            )


def _updates(model: Model) -> Iterator[Equation]:
    for update in model.system.updates:
        state = model.all_states[update.state]
        yield Equation(
            f"{state.name} after each step",
            format_unit(state.unit),
            rf"{symbol_latex(state.name)} = {expression_latex(update.value)}",
        )


def _outputs(model: Model) -> Iterator[Equation]:
    system = model.system
    outputs = system.outputs if system.stated_outputs is None else system.stated_outputs
    for k, output in enumerate(model.outputs):
        value: ca.SX = outputs[k]
        yield Equation(
            f"measured {output.name}",
            format_unit(output.unit),
            rf"{symbol_latex(output.name)}^\ast = {expression_latex(value)}",
        )


def _words(name: str) -> str:
    """A name as text within a formula: what LaTeX or a page would read as a command becomes a space."""
    return re.sub(r"[^\w .,:;()'+*/=<>|!?°-]|_", " ", name)
