"""Formulas of constants as text: ``2*Kf``, ``C0*(1 + c*(ps/p0 - 1))``. Read into expressions, and written so that they read back."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator

import casadi as ca

from greybox.errors import ModelError, nearest
from greybox.expressions.graph import walk
from greybox.model.signals import Expression, NamedValues

OPERATORS: dict[type[ast.operator], Callable[[ca.SX, ca.SX], ca.SX]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b, ast.Pow: lambda a, b: a**b,
}  # fmt: skip
FUNCTIONS = ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "fabs", "fmin", "fmax")  # fmt: skip
CALLED = {"abs": "fabs", "min": "fmin", "max": "fmax"}  # as people write them
REMEDY = "write it with names of constants, numbers, + - * / ^ and brackets, as in 'Kf' or '2*Kf'"

# Operation -> how it is written, with how tightly that binds: an operand that binds less is put in brackets.
SUM, PRODUCT, POWER, ATOM = 1, 2, 3, 4
INFIX = {ca.OP_ADD: (" + ", SUM), ca.OP_SUB: (" - ", SUM), ca.OP_MUL: ("*", PRODUCT), ca.OP_DIV: ("/", PRODUCT)}
PREFIX = {getattr(ca, f"OP_{name.upper()}"): name for name in FUNCTIONS}
Written = tuple[str, int]


def evaluate_formula(subject: str, text: str, p: NamedValues) -> ca.SX:
    """The formula ``text`` with the values of ``p`` (symbols or numbers) for its names.

    ``subject`` begins the message of a ModelError, which is raised for text that is no formula and for an unknown name.
    """
    return _value(_parsed(subject, text), subject, text, p)


def list_formula_names(subject: str, text: str) -> list[str]:
    """The names that a formula speaks of, each once, in their order."""

    def found(node: ast.AST) -> Iterator[str]:
        if isinstance(node, ast.Name | ast.Attribute):
            yield ast.unparse(node)
        else:
            for child in node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node):
                yield from found(child)

    return list(dict.fromkeys(found(_parsed(subject, text))))


def _parsed(subject: str, text: str) -> ast.expr:
    try:
        return ast.parse(text.strip().replace("^", "**"), mode="eval").body
    except (SyntaxError, ValueError):
        raise ModelError(f"{subject}: {text!r} is no formula; {REMEDY}") from None


def _value(node: ast.expr, subject: str, text: str, p: NamedValues) -> ca.SX:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return ca.SX(node.value)
    if isinstance(node, ast.Name | ast.Attribute):  # an effect's constant may be called 'creep.K'
        name = ast.unparse(node)
        if name not in p:
            raise ModelError(f"{subject}: no constant {name!r}; {nearest(name, p.names)}")
        return ca.SX(p[name])
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _value(node.operand, subject, text, p)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return OPERATORS[type(node.op)](_value(node.left, subject, text, p), _value(node.right, subject, text, p))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        name = CALLED.get(node.func.id, node.func.id)
        if name not in FUNCTIONS:
            raise ModelError(f"{subject}: no function {node.func.id!r}; {nearest(node.func.id, FUNCTIONS)}")
        try:
            return ca.SX(getattr(ca, name)(*(_value(a, subject, text, p) for a in node.args)))
        except (NotImplementedError, TypeError):
            raise ModelError(f"{subject}: {text!r} gives {name} {len(node.args)} numbers; {REMEDY}") from None
    raise ModelError(f"{subject}: {ast.unparse(node)!r} in {text!r} is no part of a formula; {REMEDY}")


def format_formula(subject: str, value: Expression) -> str:
    """A CasADi expression of constants as text that `read` reads back; raises ModelError for an operation without a name."""

    def combined(node: ca.SX, operands: list[Written]) -> Written:
        op = node.op()
        if op in INFIX:
            sign, binds = INFIX[op]
            return (
                f"{_within(operands[0], binds)}{sign}{_within(operands[1], binds + (op in (ca.OP_SUB, ca.OP_DIV)))}",
                binds,
            )
        if op in (ca.OP_POW, ca.OP_CONSTPOW):
            return f"{_within(operands[0], ATOM)}^{_within(operands[1], ATOM)}", POWER
        if op == ca.OP_SQ:
            return f"{_within(operands[0], ATOM)}^2", POWER
        if op == ca.OP_NEG:
            return f"-{_within(operands[0], PRODUCT)}", SUM
        if op == ca.OP_TWICE:
            return f"2*{_within(operands[0], PRODUCT)}", PRODUCT
        if op == ca.OP_INV:
            return f"1/{_within(operands[0], POWER)}", PRODUCT
        if op in PREFIX:
            return f"{PREFIX[op]}({', '.join(text for text, _ in operands)})", ATOM
        raise ModelError(f"{subject}: {node} cannot be written as a formula; {REMEDY}")

    return walk(value, lambda name: (name, ATOM), _number, combined)[0]


def _number(value: float) -> Written:
    return (f"{value:.17g}" if float(f"{value:.12g}") != value else f"{value:.12g}", ATOM if value >= 0 else SUM)


def _within(operand: Written, binds: int) -> str:
    text, own = operand
    return text if own >= binds else f"({text})"
