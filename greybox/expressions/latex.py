r"""An expression as LaTeX: ``Kf i - B v`` becomes ``K_{f}\,i - B\,v``, a quotient a fraction, a root a root."""

from __future__ import annotations

import re
from typing import NamedTuple

import casadi as ca

from greybox.expressions.graph import walk
from greybox.expressions.text import FUNCTIONS, number_text

# How tightly a piece holds together; a looser one needs brackets inside a tighter one.
CHOICE, SUM, PRODUCT, POWER, ATOM = range(5)
GREEK = {
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu", "xi", "pi", "rho",
    "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda", "Xi", "Pi", "Sigma", "Phi", "Psi",
    "Omega",
}  # fmt: skip
KNOWN_TO_LATEX = {"exp", "log", "sin", "cos", "tan", "sinh", "cosh", "tanh", "min", "max"}
RELATIONS = {ca.OP_LT: "<", ca.OP_LE: r"\le", ca.OP_EQ: "=", ca.OP_NE: r"\ne", ca.OP_AND: r"\wedge", ca.OP_OR: r"\vee"}
SQUARE = re.compile(r"\{([^{}]+)\}\^\{2\}$")
PARTS = re.compile(r"([A-Za-z]+?)_?(\d+|(?<=[A-Z])[a-z]+)?$")


class Piece(NamedTuple):
    """LaTeX text and how tightly it holds together; ``condition`` is set in the half of an if."""

    text: str
    binding: int
    condition: str = ""

    def within(self, binding: int) -> str:
        """The text, in brackets where it is looser than its surroundings."""
        return self.text if self.binding >= binding else rf"\left({self.text}\right)"


def expression_latex(value: ca.SX | float) -> str:
    """A scalar CasADi expression as LaTeX."""
    return walk(value, lambda name: Piece(symbol_latex(name), ATOM), _constant, _combined).text


def symbol_latex(name: str) -> str:
    r"""A name as a symbol: ``Kf`` -> ``K_{f}``, ``p1`` -> ``p_{1}``, ``tau_e`` -> ``\tau_{e}``, ``friction.Fc`` -> ``F_{c,friction}``."""
    owner, _, own = name.rpartition(".")
    head, _, tail = own.partition("_")
    if not tail and (found := PARTS.match(head)) and head not in GREEK:
        head, tail = found.group(1), found.group(2) or ""
    below = ",".join(part for part in (tail, owner) if part)
    base = rf"\{head}" if head in GREEK else (head if len(head) == 1 else rf"\mathrm{{{_plain(head)}}}")
    return f"{base}_{{{_below(below)}}}" if below else base


def _below(text: str) -> str:
    return text if len(text) == 1 or text.isdigit() else rf"\mathrm{{{_plain(text)}}}"


def _plain(text: str) -> str:
    """Letters and digits as they are; what LaTeX reads as a command becomes a space."""
    return re.sub(r"[^A-Za-z0-9.,']+", r"\\,", text)


def _constant(value: float) -> Piece:
    mantissa, mark, exponent = number_text(value).partition("e")
    text = rf"{mantissa}\cdot 10^{{{exponent}}}" if mark else mantissa.replace("inf", r"\infty")
    return Piece(text, SUM if value < 0 else (PRODUCT if mark else ATOM))


def _combined(node: ca.SX, values: list[Piece]) -> Piece:
    op = node.op()
    if op in OPERATIONS:
        return OPERATIONS[op](values)
    if op in RELATIONS:
        first, second = values
        return Piece(f"{first.within(SUM)} {RELATIONS[op]} {second.within(SUM)}", CHOICE)
    texts = [value.text for value in values]
    if op == ca.OP_NOT:
        return Piece(rf"\neg\left({texts[0]}\right)", ATOM)
    if op == ca.OP_IF_ELSE_ZERO:
        return Piece(_cases((texts[1], texts[0]), ("0", r"\text{otherwise}")), ATOM, texts[0])
    name = FUNCTIONS.get(op, f"operation{op}")
    function = rf"\{name}" if name in KNOWN_TO_LATEX else rf"\operatorname{{{name}}}"
    return Piece(rf"{function}\left({', '.join(texts)}\right)", ATOM)


def _cases(*rows: tuple[str, str]) -> str:
    return r"\begin{cases}" + r" \\ ".join(f"{value} & {when}" for value, when in rows) + r"\end{cases}"


def _add(values: list[Piece]) -> Piece:
    first, second = values
    if first.condition and second.condition == rf"\neg\left({first.condition}\right)":
        value, other = (p.text.removeprefix(r"\begin{cases}").split(" & ", 1)[0] for p in values)
        return Piece(_cases((value, first.condition), (other, r"\text{otherwise}")), ATOM)
    sign = " " if second.text.startswith("-") and second.binding == SUM else " + "
    return Piece(first.within(SUM) + sign + second.within(SUM), SUM)


def _times(values: list[Piece]) -> Piece:
    first, second = (v.within(PRODUCT) for v in values)
    square = SQUARE.match(second)
    if square and (first == square.group(1) or first.endswith(rf"\,{square.group(1)}")):  # x x^2
        base = square.group(1)
        return Piece(f"{first.removesuffix(base)}{{{base}}}^{{3}}", PRODUCT)
    between = r"\cdot " if second[0].isdigit() else r"\,"
    return Piece(first + between + second, PRODUCT)


def _power(values: list[Piece]) -> Piece:
    return Piece(f"{{{values[0].within(ATOM)}}}^{{{values[1].text}}}", POWER)


OPERATIONS = {
    ca.OP_ADD: _add,
    ca.OP_SUB: lambda v: Piece(f"{v[0].within(SUM)} - {v[1].within(PRODUCT)}", SUM),
    ca.OP_NEG: lambda v: Piece(f"-{v[0].within(PRODUCT)}", SUM),
    ca.OP_MUL: _times,
    ca.OP_TWICE: lambda v: _times([Piece("2", ATOM), v[0]]),
    ca.OP_DIV: lambda v: Piece(rf"\frac{{{v[0].text}}}{{{v[1].text}}}", PRODUCT),
    ca.OP_INV: lambda v: Piece(rf"\frac{{1}}{{{v[0].text}}}", PRODUCT),
    ca.OP_SQ: lambda v: _power([v[0], Piece("2", ATOM)]),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: lambda v: Piece(rf"\sqrt{{{v[0].text}}}", ATOM),
    ca.OP_FABS: lambda v: Piece(rf"\left|{v[0].text}\right|", ATOM),
}
