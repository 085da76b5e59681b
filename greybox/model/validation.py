"""How a model is written down: names that can be asked for, balances that are returned, outputs that mean something."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import casadi as ca

from greybox.errors import ModelError, nearest
from greybox.expressions.graph import walk
from greybox.model.balance import Balance
from greybox.model.signals import Input, NamedValues, Output, Parameter, Quantity, State

if TYPE_CHECKING:
    from greybox.model.model import Model

TIME_NAMES = ("time", "t")  # of the column of a record that holds the time
# x.names is a method of `Named`, and not the state of that name.
TAKEN = frozenset(name for name in dir(NamedValues) if not name.startswith("_"))


def check_names(model: Model) -> None:
    """Refuse names under which a signal could not be reached, a column not be read, or a file not be written."""
    if not re.fullmatch(r"[\w-]+", model.name):
        raise ModelError(
            f"model {model.name!r}: its name becomes a file's name; write it with letters, digits, _ and - alone"
        )
    problems = []
    items: tuple[Quantity, ...] = (*model.states, *model.inputs, *model.outputs, *model.parameters)
    for item in items:
        kind = type(item).__name__.lower()
        if not item.name.isidentifier() or item.name.startswith("_"):
            problems.append(f"{kind} {item.name!r}: a name is a letter and then letters, digits and _, as in v_2")
        elif item.name in TAKEN:
            problems.append(f"{kind} {item.name!r}: this name is taken ({', '.join(sorted(TAKEN))}); give another")
        elif isinstance(item, Input | Output) and item.name in TIME_NAMES:
            problems.append(
                f"{kind} {item.name!r}: a column of this name holds the time of a record; give another name"
            )
    if problems:
        raise ModelError(f"model {model.name!r}: {'; '.join(problems)}")


def check_expressions(model: Model) -> None:
    """Refuse balances and outputs that are no expressions: nothing returned, a decision on a symbol, a number lost.

    Raises ModelError whose traceback ends in the line to correct.
    """
    x, u, p = (
        _symbols(kind, items)
        for kind, items in (("state", model.states), ("input", model.inputs), ("parameter", model.parameters))
    )
    title = f"model {model.name!r}"
    for number, balance in enumerate(_balances(title, model.balances, x, u, p), 1):
        if not isinstance(balance, Balance):
            raise ModelError(
                f"{title}: balances returns {balance!r} as number {number} of its list; write Balance(...)"
            )
        for term, value in balance.terms.items():
            _check_number(f"{title}: balance {balance.name!r}, term {term!r}", value)
    for output in model.outputs:
        if output.equation is not None:
            value = _asked(f"{title}: output {output.name!r}", output.equation, x, u, p)
            _check_number(f"{title}: output {output.name!r}", value)
        elif output.name not in x:
            states = [s.name for s in model.states]
            raise ModelError(
                f"{title}: output {output.name!r} has no equation, and there is no state of that name;"
                f" {nearest(output.name, states)}; or give equation=lambda x, u, p: ..."
            )


def unused_parameters(model: Model) -> tuple[str, ...]:
    """Names of the constants that no equation of ``model`` uses."""
    system = model.system
    used = {symbol.name() for symbol in ca.symvar(ca.vertcat(*system.free_run_expressions, system.diffusion))}
    return tuple(name for name in system.parameter_names if name not in used)


def _balances(title: str, balances: Callable[..., Any], *named: NamedValues) -> Iterator[Any]:
    found = _asked(f"{title}: balances", balances, *named)
    if not isinstance(found, list | tuple):
        what = "nothing" if found is None else repr(found)
        raise ModelError(f"{title}: balances returns {what}; end it with return [Balance(...), ...]")
    yield from found


def _asked(subject: str, function: Callable[..., Any], *named: NamedValues) -> Any:
    try:
        return function(*named)
    except RuntimeError as error:
        if "truth value" not in str(error):
            raise
        told = ModelError(
            f"{subject}: a decision on a symbol (if, and, or, min, max), which has no value yet;"
            " write casadi.if_else(condition, then, else), casadi.fmin or casadi.fmax"
        )
        raise told.with_traceback(error.__traceback__) from None


def _check_number(subject: str, value: Any) -> None:
    try:
        expression = ca.SX(value)
    except (NotImplementedError, TypeError, ValueError):
        raise ModelError(f"{subject} is {value!r}; write an expression of x, u and p, or a number") from None
    if walk(expression, lambda symbol: False, math.isnan, lambda node, values: any(values)):
        raise ModelError(
            f"{subject} is not a number; use casadi.sin, casadi.sqrt ... on symbols, math.sin turns them into nan"
        )


def _symbols(kind: str, items: Sequence[State] | Sequence[Input] | Sequence[Parameter]) -> NamedValues:
    every: Sequence[Quantity] = items
    return NamedValues(kind, {i.name: ca.SX.sym(i.name) for i in every}, {i.role: i.name for i in every if i.role})
