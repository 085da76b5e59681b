r"""Expressions as LaTeX: ``Kf i - B v`` becomes ``K_{f}\,i - B\,v``, a quotient a fraction, a root a root."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca

from greybox.expressions.operations import Binding, Operation
from greybox.expressions.printer import CodeDialect, Printed
from greybox.expressions.text import number_text

LETTERS = "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau upsilon phi chi psi omega"
CAPITALS = "Gamma Delta Theta Lambda Xi Pi Sigma Phi Psi Omega"
GREEK = frozenset(f"{LETTERS} {CAPITALS}".split())
SQUARE = re.compile(r"\{([^{}]+)\}\^\{2\}$")
NAME_PARTS = re.compile(r"([A-Za-z]+?)_?(\d+|(?<=[A-Z])[a-z]+)?$")
# A fraction and an exponent hold their operands together themselves, and sums and products are typeset without regard to their order.
NEEDS = {
    ca.OP_ADD: (Binding.SUM, Binding.SUM),
    ca.OP_MUL: (Binding.PRODUCT, Binding.PRODUCT),
    ca.OP_TWICE: (Binding.PRODUCT,),
    ca.OP_DIV: (Binding.CHOICE, Binding.CHOICE),
    ca.OP_INV: (Binding.CHOICE,),
    ca.OP_POW: (Binding.ATOM, Binding.CHOICE),
    ca.OP_CONSTPOW: (Binding.ATOM, Binding.CHOICE),
}


class LatexDialect(CodeDialect):
    """LaTeX for a formula set in mathematics mode."""

    def symbol(self, name: str) -> Printed:
        """A letter with what follows it below the line."""
        return Printed(symbol_latex(name), Binding.ATOM)

    def number(self, value: float) -> Printed:
        """Six digits, a power of ten where that is shorter."""
        mantissa, mark, exponent = number_text(abs(value)).partition("e")
        text = rf"{mantissa}\cdot 10^{{{exponent}}}" if mark else mantissa.replace("inf", self.infinity)
        return self._minus(text) if value < 0 else Printed(text, Binding.PRODUCT if mark else Binding.ATOM)

    def needs(self, row: Operation) -> tuple[Binding, ...]:
        """Fewer brackets than in a program: see `NEEDS`."""
        return NEEDS.get(row.code, row.needs)

    def _fill(self, row: Operation, template: str, operands: Sequence[Printed]) -> Printed:
        if row.code == ca.OP_TWICE:
            return self._times(Printed("2", Binding.ATOM), operands[0])
        if row.code == ca.OP_MUL:
            return self._times(*operands)
        if row.code == ca.OP_ADD and operands[1].binding == Binding.SUM and operands[1].text.startswith("-"):
            return Printed(f"{operands[0].within(Binding.SUM, self.brackets)} - {operands[1].text[1:]}", Binding.SUM)
        return super()._fill(row, template, operands)

    def _times(self, first: Printed, second: Printed) -> Printed:
        left, right = first.within(Binding.PRODUCT, self.brackets), second.within(Binding.PRODUCT, self.brackets)
        square = SQUARE.match(right)
        if square and (left == square.group(1) or left.endswith(rf"\,{square.group(1)}")):  # x x^2
            base = square.group(1)
            return Printed(f"{left.removesuffix(base)}{{{base}}}^{{3}}", Binding.PRODUCT)
        between = r"\cdot " if right[0].isdigit() else r"\,"
        return Printed(left + between + right, Binding.PRODUCT)


LATEX = LatexDialect(
    "LaTeX",
    "latex",
    r"\begin{{cases}}{1} & {0} \\ {2} & \text{{otherwise}}\end{{cases}}",
    r"\infty",
    r"\left({}\right)",
)


def expression_latex(value: ca.SX | float) -> str:
    """A scalar CasADi expression as LaTeX."""
    return LATEX.write(value).text


def symbol_latex(name: str) -> str:
    r"""A name as a symbol: ``Kf`` -> ``K_{f}``, ``p1`` -> ``p_{1}``, ``tau_e`` -> ``\tau_{e}``, ``friction.Fc`` -> ``F_{c,friction}``."""
    owner, _, symbol = name.rpartition(".")
    head, _, tail = symbol.partition("_")
    if not tail and (parts := NAME_PARTS.match(head)) and head not in GREEK:
        head, tail = parts.group(1), parts.group(2) or ""
    below = ",".join(part for part in (tail, owner) if part)
    base = (
        rf"\{head}" if head in GREEK else (head if len(head) == 1 and head.isalnum() else rf"\mathrm{{{_plain(head)}}}")
    )
    return f"{base}_{{{_subscript(below)}}}" if below else base


def _subscript(text: str) -> str:
    return text if text.isalnum() and (len(text) == 1 or text.isdigit()) else rf"\mathrm{{{_plain(text)}}}"


def _plain(text: str) -> str:
    """Letters and digits as they are; what LaTeX reads as a command becomes a space."""
    return re.sub(r"[^A-Za-z0-9.,']+", r"\\,", text)
