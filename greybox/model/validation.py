"""How a model is written down: names that can be asked for, balances that are returned, outputs that mean something."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import casadi as ca

from greybox.errors import ModelError, nearest
from greybox.expressions.graph import walk
from greybox.model.balance import Balance
from greybox.model.signals import NamedValues
from greybox.model.system import Item, Statement, named_symbols

TIME_NAMES = ("time", "t")  # of the column of a record that holds the time
# x.names is a property of `NamedValues`, and not the state of that name.
RESERVED_NAMES = frozenset(name for name in dir(NamedValues) if not name.startswith("_"))


def check_names(statement: Statement) -> None:
    """Refuse names under which a signal could not be reached, a column not be read, or a file not be written."""
    title, states, outputs = f"model {statement.name!r}", statement.states, statement.outputs
    if not states or not outputs:
        raise ModelError(f"{title} needs at least one state and one output")
    inner: tuple[Item, ...] = (*states, *statement.inputs, *statement.parameters)
    outer: tuple[Item, ...] = (*statement.inputs, *outputs)
    for names in ([item.name for item in items] for items in (inner, outer)):
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ModelError(f"{title}: the name {twice[0]!r} is used twice; every signal and parameter needs its own")
    if not re.fullmatch(r"[\w-]+", statement.name):
        raise ModelError(f"{title}: its name is used for files; use only letters, digits, _ and -")
    problems = []
    groups: dict[str, Sequence[Item]] = {
        "state": states,
        "input": statement.inputs,
        "output": outputs,
        "parameter": statement.parameters,
    }
    for kind, items in groups.items():
        for name in (item.name for item in items):
            if not name.isidentifier() or name.startswith("_"):
                problems.append(f"{kind} {name!r}: a name is a letter and then letters, digits and _, as in v_2")
            elif name in RESERVED_NAMES:
                problems.append(
                    f"{kind} {name!r}: this name is taken ({', '.join(sorted(RESERVED_NAMES))}); give another"
                )
            elif kind in ("input", "output") and name in TIME_NAMES:
                problems.append(f"{kind} {name!r}: a column of this name holds the time of a record; give another name")
    if problems:
        raise ModelError(f"{title}: {'; '.join(problems)}")


def check_expressions(statement: Statement) -> None:
    """Refuse balances and outputs that are no expressions: nothing returned, a decision on a symbol, a number lost.

    Raises ModelError whose traceback ends in the line to correct.
    """
    x = named_symbols("state", statement.states)
    u = named_symbols("input", statement.inputs)
    p = named_symbols("parameter", statement.parameters)
    title = f"model {statement.name!r}"
    for number, balance in enumerate(_balances(title, statement.balances, x, u, p), 1):
        if not isinstance(balance, Balance):
            raise ModelError(
                f"{title}: balances returns {balance!r} as number {number} of its list; write Balance(...)"
            )
        for term, value in balance.terms.items():
            _check_number(f"{title}: balance {balance.name!r}, term {term!r}", value)
    for output in statement.outputs:
        if output.equation is not None:
            value = _call(f"{title}: output {output.name!r}", output.equation, x, u, p)
            _check_number(f"{title}: output {output.name!r}", value)
        elif output.name not in x:
            states = [s.name for s in statement.states]
            raise ModelError(
                f"{title}: output {output.name!r} has no equation, and there is no state of that name;"
                f" {nearest(output.name, states)}; or give equation=lambda x, u, p: ..."
            )


def _balances(title: str, balances: Callable[..., Any], *named: NamedValues) -> Iterator[Any]:
    returned = _call(f"{title}: balances", balances, *named)
    if not isinstance(returned, list | tuple):
        what = "nothing" if returned is None else repr(returned)
        raise ModelError(f"{title}: balances returns {what}; end it with return [Balance(...), ...]")
    yield from returned


def _call(subject: str, function: Callable[..., Any], *named: NamedValues) -> Any:
    try:
        return function(*named)
    except RuntimeError as error:
        if "truth value" not in str(error):
            raise
        clearer = ModelError(
            f"{subject}: a decision on a symbol (if, and, or, min, max), which has no value yet;"
            " write casadi.if_else(condition, then, else), casadi.fmin or casadi.fmax"
        )
        raise clearer.with_traceback(error.__traceback__) from None


def _check_number(subject: str, value: Any) -> None:
    try:
        expression = ca.SX(value)
    except (NotImplementedError, TypeError, ValueError):
        raise ModelError(f"{subject} is {value!r}; write an expression of x, u and p, or a number") from None
    if walk(expression, lambda symbol: False, math.isnan, lambda node, values: any(values)):
        raise ModelError(
            f"{subject} is not a number; use casadi.sin, casadi.sqrt ... on symbols, math.sin turns them into nan"
        )
