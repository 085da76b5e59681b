"""How a model is written down: names that can be asked for, balances that are returned, outputs that mean something."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from greybox.base import DataError, ModelError, format_unit, nearest
from greybox.model.balance import Balance, ClosedBalances
from greybox.model.expressions.graph import walk
from greybox.model.signals import NamedValues
from greybox.model.system import Item, Statement, named_symbols

# Rules: what physics demands of several constants together, and of what a sensor may show.


@dataclass(frozen=True)
class Rule:
    """Something that must hold beyond the bounds of one parameter: of several parameters together, or of a measured output.

    Parameters
    ----------
    name
        What must hold, as the message says it.
    unit
        Of the margin.
    margin
        Positive where the rule holds. Without an output ``margin(p)`` is a number, and the rule is checked whenever a model is made. With
        one ``margin(value, p)`` takes and returns arrays (N,), and the rule is checked against records; gaps (NaN) pass.
    remedy
        What to do where it is broken.
    output
        Name of the measured output that it is about; empty for a rule about parameters.

    Examples
    --------
    >>> absolute = Rule("supply above ambient", "Pa", lambda p: p.P_S - p.P_a, "give P_S in absolute pressure")
    >>> inside = Rule("piston within its stroke", "m", lambda s, p: p.stroke / 2 - abs(s), "check the zero of the sensor", "s")
    """

    name: str
    unit: str
    margin: Callable[..., Any]
    remedy: str
    output: str = ""


def check_constants(title: str, rules: Sequence[Rule], p: NamedValues) -> None:
    """Refuse parameters that break a rule: ModelError with every broken one, its values and the remedy."""
    broken = []
    for rule in rules:
        if rule.output:
            continue
        recorder = _AccessRecorder(p)
        margin = float(rule.margin(recorder))
        if not margin > 0:
            missed = f"({margin:.4g} {format_unit(rule.unit)}, must be above 0)"
            broken.append(f"{rule.name}: {recorder.listing} {missed}; {rule.remedy}")
    if broken:
        raise ModelError(f"model {title!r} breaks a rule: {'; '.join(broken)}")


# Rows that a message names.
ROWS_SHOWN = 5


def check_measured(title: str, rules: Sequence[Rule], measured: Mapping[str, np.ndarray], p: NamedValues) -> None:
    """Refuse measured signals, name -> (N,), that break a rule: DataError with rows, worst value and the remedy."""
    broken = []
    for rule in rules:
        if rule.output not in measured:
            continue
        value = np.asarray(measured[rule.output], float)
        with np.errstate(invalid="ignore"):
            margin = np.broadcast_to(rule.margin(value, p), value.shape)
            rows = np.flatnonzero(~(margin > 0) & np.isfinite(value))
        if len(rows):
            worst = rows[np.argmin(margin[rows])]
            shown = ", ".join(str(row + 1) for row in rows[:ROWS_SHOWN])
            rest = f" and {len(rows) - ROWS_SHOWN} more" if len(rows) > ROWS_SHOWN else ""
            broken.append(
                f"output {rule.output!r} breaks the rule '{rule.name}' at row{'s' * (len(rows) > 1)} {shown}{rest}"
                f" (row {worst + 1}: {value[worst]:.6g} {format_unit(rule.unit)}); {rule.remedy}"
            )
    if broken:
        raise DataError(f"{title}: {'; '.join(broken)}")


def check_outputs_known(title: str, rules: Sequence[Rule], outputs: Sequence[str]) -> None:
    """Refuse a rule about an output that the model does not have."""
    for rule in rules:
        if rule.output and rule.output not in outputs:
            raise ModelError(
                f"model {title!r}: rule {rule.name!r} is about an unknown output; {nearest(rule.output, outputs)}"
            )


class _AccessRecorder:
    """Parameters that remember which of them a rule asked for, so that the message can name them."""

    def __init__(self, p: NamedValues) -> None:
        self._p, self._values = p, dict[str, float]()

    def __getattr__(self, name: str) -> float:
        self._values[name] = float(self._p[name])
        return self._values[name]

    @property
    def listing(self) -> str:
        """``P_S = 5e5, P_a = 6e5``."""
        return ", ".join(f"{name} = {value:.6g}" for name, value in self._values.items())


TIME_NAMES = ("time", "t")  # of the column of a record that holds the time
# x.names is a property of `NamedValues`, and not the state of that name.
RESERVED_NAMES = frozenset(name for name in dir(NamedValues) if not name.startswith("_"))


def check_names(statement: Statement) -> None:
    """Refuse names under which a signal could not be reached, a column not be read, or a file not be written."""
    title, states, outputs = f"model {statement.name!r}", statement.states, statement.outputs
    # What is run from outside may keep its states to itself.
    if not outputs or not (states or isinstance(statement.balances, ClosedBalances)):
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
        if not (balance.terms or any(s.name == balance.state and s.noise for s in statement.states)):
            raise ModelError(
                f"{title}: balance {balance.name!r} has no terms; name at least one, as in Balance(..., spring=-p.K * x.x), or make its"
                f" state a random walk, State({balance.state!r}, ..., noise=0.1)"
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
