"""Formulas of constants as text: ``2*Kf``, ``C0*(1 + c*(ps/p0 - 1))``. Read into expressions, and written so that they read back."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import casadi as ca

from greybox.errors import GreyboxError, ModelError, nearest
from greybox.expressions.operations import OPERATIONS
from greybox.expressions.printer import FORMULA

OPERATORS: dict[type[ast.operator], Callable[[ca.SX, ca.SX], ca.SX]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
# As people write them (abs, min, max) and as CasADi calls them (fabs, fmin, fmax).
FUNCTIONS = {
    name: row
    for row in OPERATIONS.values()
    if row.formula and row.name.isidentifier()
    for name in (row.formula.partition("(")[0], row.name)
}
REMEDY = "write it with names of parameters, numbers, + - * / ^ and brackets, as in 'Kf' or '2*Kf'"


class Values(Protocol):
    """Values by name."""

    def __contains__(self, name: str) -> bool: ...

    def __getitem__(self, name: str) -> Any: ...

    @property
    def names(self) -> list[str]:
        """Every name that can be asked for."""


def evaluate_formula(subject: str, text: str, p: Values) -> ca.SX:
    """The formula ``text`` with the values of ``p`` (symbols or numbers) for its names.

    ``subject`` begins the message of a ModelError, which is raised for text that is no formula and for an unknown name.
    """
    return _evaluate(_parse(subject, text), subject, text, p)


def list_formula_names(subject: str, text: str) -> list[str]:
    """The names that a formula contains, each once, in their order."""

    def names(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Name | ast.Attribute):
            yield ast.unparse(node)
        else:
            for child in node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node):
                yield from names(child)

    return list(dict.fromkeys(names(_parse(subject, text))))


def format_formula(subject: str, value: ca.SX | float) -> str:
    """A CasADi expression of constants as text that `evaluate_formula` reads back.

    Raises ModelError for an operation that a formula does not have.
    """
    try:
        return FORMULA.write(value).text
    except ModelError:
        raise
    except GreyboxError:
        raise ModelError(f"{subject}: {value} cannot be written as a formula; {REMEDY}") from None


def _parse(subject: str, text: str) -> ast.expr:
    try:
        return ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError):
        raise ModelError(f"{subject}: {text!r} is not a formula; {REMEDY}") from None


def _evaluate(node: ast.expr, subject: str, text: str, p: Values) -> ca.SX:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return ca.SX(node.value)
    if isinstance(node, ast.Name | ast.Attribute):  # an effect's constant may be called 'creep.K'
        name = ast.unparse(node)
        if name not in p:
            raise ModelError(f"{subject}: no parameter {name!r}; {nearest(name, p.names)}")
        return ca.SX(p[name])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _evaluate(node.operand, subject, text, p)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        left, right = (_evaluate(operand, subject, text, p) for operand in (node.left, node.right))
        return OPERATORS[type(node.op)](left, right)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = node.func.id
        if name not in FUNCTIONS:
            raise ModelError(f"{subject}: no function {name!r}; {nearest(name, FUNCTIONS)}")
        row = FUNCTIONS[name]
        if len(node.args) != row.arity:
            raise ModelError(f"{subject}: {text!r} gives {name} {len(node.args)} numbers; {REMEDY}")
        return ca.SX(getattr(ca, row.name)(*(_evaluate(a, subject, text, p) for a in node.args)))
    raise ModelError(f"{subject}: {ast.unparse(node)!r} in {text!r} is not part of a formula; {REMEDY}")
